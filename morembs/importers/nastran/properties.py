"""Solid properties, and materials of Nastran bulk data."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.material import isotropic, orthotropic
from morembs.importers.decks.algebra import rotate_stiffness
from morembs.importers.decks.tables import ElasticMaterial, Section
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.geometry import Grids, Systems
from morembs.importers.tolerances import TOL

Rows = list[list[str]]
# Nastran orders shear xy, yz, zx; here it is yz, zx, xy.
_MAT9 = (0, 1, 2, 5, 3, 4)
_OF_SOLIDS = ("MAT1", "MAT9", "MAT11")


def pad(row: list[str], count: int) -> list[str]:
    """The fields with blank ones behind them."""
    return row + [""] * (count - len(row))


def by_number(file: str, name: str, rows: Rows) -> dict[int, list[str]]:
    """Cards of a ``name`` by their first field.

    Raises:
        InputError: a number twice, or below 1.
    """
    cards: dict[int, list[str]] = {}
    for row in rows:
        number = integer(pad(row, 1)[0], f"{file}: {name}")
        if number < 1 or number in cards:
            raise InputError(f"{file}: {name} {number} is defined twice, or below 1", kind="conflict")
        cards[number] = row
    return cards


class Materials:
    """Materials by number, and sections of PSOLID; ``known`` has materials that were read, by name; densities
    are times PARAM WTMASS, the ``scale``."""

    def __init__(self, file: str, rows: dict[str, Rows], scale: float) -> None:
        self.file, self.scale = file, scale
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.known: dict[str, ElasticMaterial] = {}
        self._solids = by_number(file, "PSOLID", rows["PSOLID"])
        self._readers = {
            "MAT1": self._mat1,
            "MAT2": self._mat2,
            "MAT8": self._mat8,
            "MAT9": self._mat9,
            "MAT11": self._mat11,
        }
        self._cards: dict[int, tuple[str, list[str]]] = {}
        for card in self._readers:
            for mid, row in by_number(file, card, rows[card]).items():
                if mid in self._cards:
                    raise InputError(
                        f"{file} defines the material {mid} as {self._cards[mid][0]} and as {card}", kind="unsupported"
                    )
                self._cards[mid] = card, row

    def name_of(self, mid: int, set_: str) -> str:
        """Name of the material with a number, which the set ``set_`` needs; "" where there is none."""
        if mid not in self._cards:
            return ""
        card, fields = self._cards[mid]
        name = f"{card} {mid}"
        if name not in self.known:
            self.known[name] = self._readers[card](mid, fields, set_)
        return name

    def of_solids(self, pids: list[int], systems: Systems, grids: Grids) -> list[Section]:
        """Sections of the properties ``pids``."""
        sections = []
        for pid in pids:
            code, set_ = f"PSOLID {pid}", f"PSOLID_{pid}"
            if pid not in self._solids:
                lacks = f"the property {pid} of solids is not in the file"
                sections.append(Section(set=set_, code=code, lacks=lacks))
                continue
            row = pad(self._solids[pid], 8)
            if row[6] and row[6].upper() not in ("SMECH", "0"):
                raise InputError(f"{self.file}: {code} is of the kind {row[6]!r}; expected a structural one")
            mid = integer(row[1], f"{self.file}: {code}")
            name = self.name_of(mid, set_) if self._cards.get(mid, ("",))[0] in _OF_SOLIDS else ""
            if not name:
                missing = f"names the material {mid}, which is no {', '.join(_OF_SOLIDS)} there"
                sections.append(Section(set=set_, code=code, lacks=f"{code} {missing if mid else 'names no material'}"))
                continue
            material = self.known[name]
            system = integer(row[2], f"{self.file}: {code}") if not name.startswith("MAT1 ") else 0
            axes = self._axes(system, f"{self.file}: {name}", systems, grids)
            C, density = material.stiffness, material.density
            sections.append(
                Section(
                    set=set_,
                    code=code,
                    material=name,
                    stiffness=C if axes is None or C is None else rotate_stiffness(C, axes),
                    density=density,
                    lacks="" if density else f"{name} of the set {set_} has no density",
                    axes=axes,
                )
            )
        return sections

    def _mat1(self, mid: int, row: list[str], set_: str) -> ElasticMaterial:
        what, row = f"{self.file}: MAT1 {mid}", pad(row, 8)
        E, G, nu, rho = (real(text, what) for text in row[1:5])
        given = [bool(text) for text in row[1:4]]
        if given == [True, False, False]:
            self.warnings.append(f"MAT1 {mid} gives E only; NU = 0 was taken, as Nastran does")
            given[2] = True
        if sum(given) < 2:
            raise InputError(f"{what} gives {sum(given)} of E, G and NU; expected two")
        if all(given) and G and abs(E / (2 * G) - 1 - nu) > TOL.disagreeing_poisson * (1 + abs(nu)):
            self.warnings.append(
                f"MAT1 {mid}: G = {G:g} does not fit E = {E:g} and NU = {nu:g}, which solids take; check the card"
            )
        if not given[0]:
            E = 2 * G * (1 + nu)
        if not given[2]:
            if not G > 0:
                raise InputError(f"{what}: G = {G:g} was given; expected a positive number")
            nu = E / (2 * G) - 1
        if row[7] and real(row[7], what):
            self.notes.append(f"MAT1 {mid}: the structural damping GE = {row[7]} is not carried over.")
        C = isotropic(set=set_, young=E, poisson=nu, density=1.0).stiffness
        constants = {key: real(text, what) for key, text in zip(("E", "G", "NU"), row[1:4], strict=True) if text}
        return self._material(f"MAT1 {mid}", C, rho, constants)

    def _mat2(self, mid: int, row: list[str], set_: str) -> ElasticMaterial:
        return self._of_shells(f"MAT2 {mid}", ("G11", "G12", "G13", "G22", "G23", "G33"), row)

    def _mat8(self, mid: int, row: list[str], set_: str) -> ElasticMaterial:
        return self._of_shells(f"MAT8 {mid}", ("E1", "E2", "NU12", "G12", "G1Z", "G2Z"), row)

    def _of_shells(self, name: str, names: tuple[str, ...], row: list[str]) -> ElasticMaterial:
        """A material in a plane, whose six constants and density stand behind its number."""
        what, row = f"{self.file}: {name}", pad(row, 8)
        constants = {key: real(text, what) for key, text in zip(names, row[1:7], strict=True) if text}
        return self._material(name, None, real(row[7], what), constants)

    def _mat9(self, mid: int, row: list[str], set_: str) -> ElasticMaterial:
        numbers = [real(text, f"{self.file}: MAT9 {mid}") for text in pad(row, 23)[1:23]]
        C = np.zeros((6, 6))
        C[np.triu_indices(6)] = numbers[:21]
        C = (C + np.triu(C, 1).T)[np.ix_(np.argsort(_MAT9), np.argsort(_MAT9))]
        return self._material(f"MAT9 {mid}", C, numbers[21], {})

    def _mat11(self, mid: int, row: list[str], set_: str) -> ElasticMaterial:
        names = ("E1", "E2", "E3", "NU12", "NU13", "NU23", "G12", "G13", "G23")
        *numbers, density = (real(text, f"{self.file}: MAT11 {mid}") for text in pad(row, 11)[1:11])
        e1, e2, e3, n12, n13, n23, g12, g13, g23 = numbers
        material = orthotropic(
            set=set_, young=(e1, e2, e3), poisson=(n12, n13, n23), shear=(g12, g13, g23), density=1.0
        )
        return self._material(f"MAT11 {mid}", material.stiffness, density, dict(zip(names, numbers, strict=True)))

    def _material(self, name: str, C: Floats | None, density: float, constants: dict[str, float]) -> ElasticMaterial:
        scaled = density * self.scale if density else None
        return ElasticMaterial(name=name, stiffness=C, density=scaled, constants=constants)

    def _axes(self, system: int, what: str, systems: Systems, grids: Grids) -> Floats | None:
        """Directions of a material along those of a system (CORDM), as rows along the basic axes."""
        if not system:
            return None
        if system < 0:
            raise InputError(f"{what}: its directions are those of each element (CORDM = {system}); expected a system")
        kind, _, axes = systems.frame(system, grids)
        if kind != "R":
            raise InputError(f"{what}: its directions vary (CORDM = {system} is not rectangular); expected CORD2R")
        return axes


def labels_of(texts: list[str], what: str, known: Ints) -> list[int]:
    """Labels of a list with THRU; those of a range that are not ``known`` are passed over.

    Raises:
        InputError: no labels, or a range without an end or with one that is below its beginning.
    """
    labels: list[int] = []
    i = 0
    while i < len(texts):
        text = texts[i]
        if text.upper() == "THRU" and labels and i + 1 < len(texts):
            end = integer(texts[i + 1], what) if texts[i + 1] else None
            if end is None or end < labels[-1]:
                given = repr(texts[i + 1]) if texts[i + 1] else "nothing"
                raise InputError(
                    f"{what}: THRU is followed by {given}; expected a label that is not below the one before it"
                )
            low, high = np.searchsorted(known, [labels[-1] + 1, end + 1])
            labels += known[low:high].tolist()
            i += 1
        elif text:
            labels.append(integer(text, what))
        i += 1
    return labels
