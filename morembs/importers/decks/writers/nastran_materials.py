"""Materials and coordinate systems of a ``Deck`` as Nastran cards."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.importers.decks.tables import DeckTables, ElasticMaterial, Section
from morembs.importers.decks.writers.axes import is_isotropic
from morembs.importers.nastran.text_of_cards import Field, card
from morembs.importers.tolerances import TOL

# Names of the constants of MAT1, MAT8 and MAT2 in the order of their fields.
_CONSTANTS = {
    "MAT1": ("E", "G", "NU"),
    "MAT8": ("E1", "E2", "NU12", "G12", "G1Z", "G2Z"),
    "MAT2": ("G11", "G12", "G13", "G22", "G23", "G33"),
}
# Nastran orders shear xy, yz, zx.
_ORDER = [0, 1, 2, 5, 3, 4]


@dataclass(eq=False)
class MaterialText:
    """Materials in ``cards`` and ``systems`` of axes, each written once; ``warnings`` say what differs in the text.

    Raises:
        InputError: what bulk data cannot say.
    """

    deck: DeckTables
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.cards: list[str] = []
        self.systems: list[str] = []
        self._systems: dict[bytes, int] = {}
        self._materials: dict[tuple[object, ...], int] = {}
        self._material_count = 0

    def _what(self, section: Section) -> str:
        of = "" if section.set == section.code.replace(" ", "_") else f" of the set {section.set}"
        return f"{self.deck.name}: {section.code or 'the section'}{of}"

    def _elastic(self, section: Section, name: str) -> ElasticMaterial:
        """A material of shells, beams or rods.

        Raises:
            InputError: it is not there or has no linear stiffness.
        """
        given = self.deck.materials.get(name)
        if given is None or (given.stiffness is None and _card_of(given) is None):
            raise InputError(
                f"{self._what(section)} has no material of one linear stiffness; give it one", kind="missing"
            )
        return given

    def _plane(self, section: Section, name: str, density: float | None) -> int:
        """The number of a material of shells, beams or rods."""
        given = self._elastic(section, name)
        if _card_of(given) is None and not is_isotropic(given.stiffness):
            if section.kind != "shell":
                raise InputError(
                    f"{self._what(section)} has a material that is not isotropic, which MAT1 is", kind="unsupported"
                )
            given = replace(given, constants=_plane_constants(self._what(section), given.stiffness))
        return self._material(given, density)

    def _material(self, given: ElasticMaterial, density: float | None) -> int:
        """The number of a material, whose card is written once."""
        name, C = _card_of(given), given.stiffness
        own = tuple(given.constants.items()) if name else b"" if C is None else np.asarray(C).tobytes()
        key = name, own, density
        if key in self._materials:
            return self._materials[key]
        self._material_count += 1
        number = self._materials[key] = self._material_count
        mass: Field = "" if density is None else float(density)
        if name is not None:
            constants: list[Field] = [given.constants.get(word, "") for word in _CONSTANTS[name]]
            self.cards.append(card(name, [number, *constants, mass]))
        elif C is not None and is_isotropic(C):
            lam, mu = float(C[0, 1]), float(C[3, 3])
            young, poisson = mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
            self.cards.append(card("MAT1", [number, young, "", poisson, mass]))
        elif C is not None:
            upper = C[np.ix_(_ORDER, _ORDER)][np.triu_indices(6)]
            self.cards.append(card("MAT9", [number, *map(float, upper), mass]))
        return number

    def _system(self, axes: Floats) -> int:
        """The number of a rectangular system along the rows of ``axes`` (3, 3)."""
        key = axes.tobytes()
        if key not in self._systems:
            number = self._systems[key] = len(self._systems) + 1
            points = np.concatenate([np.zeros(3), axes[2], axes[0]])
            self.systems.append(card("CORD2R", [number, 0, *map(float, points)]))
        return self._systems[key]


def _card_of(material: ElasticMaterial) -> str | None:
    """The card that says the constants of a material as they stand; None where its stiffness has to."""
    keys = set(material.constants)
    least = {"MAT1": 2, "MAT8": 4, "MAT2": 1}
    return next((name for name, words in _CONSTANTS.items() if len(keys) >= least[name] and keys <= {*words}), None)


def _plane_constants(what: str, C: Floats | None) -> dict[str, float]:
    """Constants of MAT8 of an orthotropic stiffness (6, 6) along its axes.

    Raises:
        InputError: it is not orthotropic.
    """
    S = np.linalg.inv(np.asarray(C))
    coupling = np.abs(S) * np.sqrt(np.outer(1 / np.diag(S), 1 / np.diag(S)))
    coupling[:3, :3] = 0.0
    if np.abs(coupling - np.diag(np.diag(coupling))).max() > TOL.isotropic_stiffness:
        raise InputError(
            f"{what} has a material that is not orthotropic along its axes, which MAT8 is", kind="unsupported"
        )
    names = {"E1": S[0, 0], "E2": S[1, 1], "G12": S[5, 5], "G1Z": S[4, 4], "G2Z": S[3, 3]}
    return {name: float(1 / value) for name, value in names.items()} | {"NU12": float(-S[0, 1] / S[0, 0])}
