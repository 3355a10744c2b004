"""Elements of a ``Deck`` with their properties and materials as Nastran cards, for decks and for programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.algebra import rotate_stiffness
from morembs.importers.decks.formulations import nastran_meaning
from morembs.importers.decks.labels import Labels, in_ranges
from morembs.importers.decks.tables import ElasticMaterial, Elements, Section
from morembs.importers.decks.writers.axes import refuse_own_axes
from morembs.importers.decks.writers.nastran_materials import MaterialText
from morembs.importers.nastran.geometry import SOLIDS, card_of
from morembs.importers.nastran.text_of_cards import Field, card
from morembs.importers.tolerances import TOL

_STRUCTURES = {
    ("shell", "quad4"): "CQUAD4",
    ("shell", "tri3"): "CTRIA3",
    ("shell", "quad8"): "CQUAD8",
    ("shell", "tri6"): "CTRIA6",
    ("shear", "quad4"): "CSHEAR",
    ("beam", "line2"): "CBAR",
    ("truss", "line2"): "CROD",
}
# Profiles of *BEAM SECTION by the names of PBARL, with the dimensions of that: Abaqus gives the first width along the
# first axis of the section, Nastran the height along its y axis behind the width.
_PROFILES: dict[str, tuple[str, Callable[[Sequence[float]], Sequence[float]]]] = {
    "RECT": ("BAR", lambda d: (d[1], d[0])),
    "CIRC": ("ROD", lambda d: (d[0],)),
    "PIPE": ("TUBE", lambda d: (d[0], d[0] - d[1])),
}


@dataclass(eq=False)
class ElementText(MaterialText):
    """Cards of elements, with those of all that they name in ``cards`` and ``systems``.

    Raises:
        InputError: what bulk data cannot say.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.labels = Labels(self.deck.ids, self.deck.name, self.deck.node)
        self.parts = [part for part in self.deck.elements if part.kind not in ("point", "none")]
        self._properties: dict[tuple[int, str, object], int] = {}

    def owners(self, kind: str, ids: Ints) -> Ints:
        """The number of the last section that holds each element (k,) of a kind, -1 for none."""
        owner = np.full(len(ids), -1)
        for number, section in enumerate(self.deck.sections):
            if section.kind == kind:
                owner[in_ranges(ids, self.deck.ranges(section.set))] = number
        return owner

    def element_card(self, part: Elements) -> tuple[str, Ints, bool]:
        """Name of the card, nodes in its order, and whether its property asks for full integration.

        Raises:
            InputError: there is no card for the elements.
        """
        if part.kind != "solid":
            name = _STRUCTURES.get((part.kind, part.shape), "")
            if not name:
                raise InputError(
                    f"{self.deck.name}: bulk data have here no card for {len(part.ids)} {part.code} ({part.kind} of "
                    f"{part.nodes.shape[1]} nodes); leave them out with --skip {part.code}",
                    kind="unsupported",
                )
            if part.code in ("CQUADR", "CTRIAR"):
                self.warnings.append(
                    f"{len(part.ids)} {part.code} are written as {name}, which does not resist rotation about its "
                    "normal [formulation-differs]"
                )
            return name, part.nodes, False
        if part.shape == "hex27":
            raise InputError(f"{self.deck.name}: Nastran has no solid of 27 nodes ({part.code})", kind="missing")
        name = card_of(part.shape)
        low, _, _, order = SOLIDS[name]
        nodes = part.nodes if part.shape == low else part.nodes[:, np.argsort(order)]
        meant = part.meaning.formulation, part.meaning.mass
        theirs = {full: nastran_meaning(name, nodes.shape[1], full=full) for full in (False, True)}
        same = [full for full, meaning in theirs.items() if meaning == part.meaning]
        same += [full for full, meaning in theirs.items() if (meaning.formulation, meaning.mass) == meant]
        if same:
            return name, nodes, same[0]
        full = meant[0] == "full" and part.shape == "hex8"
        own = theirs[full]
        self.warnings.append(
            f"{len(part.ids)} elements {part.code} of {self.deck.program} are written as {name} of Nastran, which "
            f"has the formulation {own.formulation!r} and the mass {own.mass!r} in place of {meant[0]!r} and "
            f"{meant[1]!r} [formulation-differs]"
        )
        return name, nodes, full

    # Properties

    def property(self, part: Elements, number: int, variant: object) -> int:
        """The number of the property of elements in a section (-1: in none), in a ``variant`` of solids."""
        key = number, part.kind, variant
        if key not in self._properties:
            if number < 0 and part.kind != "solid":
                raise InputError(
                    f"{self.deck.name}: {part.code} elements ({part.kind}) are in no section; give them one",
                    kind="unsupported",
                )
            self._properties[key] = len(self._properties) + 1
            section = self.deck.sections[number] if number >= 0 else Section(set="", kind=part.kind)
            self._add_property(section, self._properties[key], variant)
        return self._properties[key]

    def _add_property(self, section: Section, pid: int, variant: object) -> None:
        self.cards += [f"$ {section.set or 'no section'}\n", self._property_card(section, pid, variant)]

    def _property_card(self, section: Section, pid: int, variant: object) -> str:
        if section.kind == "solid":
            return self._solid(section, pid, variant)
        refuse_own_axes(self.deck, section, "Nastran", self._what(section))
        if section.plies:
            return self._laminate(section, pid)
        rest, plate = section.nonstructural, section.plate
        if section.kind == "shell" and plate is not None:
            heavy = self._elastic(section, section.material).density
            names = (plate.membrane, plate.bending, plate.shear)
            mids: list[Field] = [self._plane(section, name, heavy) if name else "" for name in names]
            ratios = plate.inertia_ratio, plate.shear_ratio
            return card(
                "PSHELL", [pid, mids[0], self._thickness(section), mids[1], ratios[0], mids[2], ratios[1], rest]
            )
        mid = self._plane(section, section.material, self._elastic(section, section.material).density)
        if section.kind == "shell":
            fields = [pid, mid, self._thickness(section), mid, 1.0, mid, TOL.shear_thickness, rest]
            return card("PSHELL", fields)
        if section.kind == "shear":
            return card("PSHEAR", [pid, mid, self._thickness(section), rest])
        if section.kind == "truss":
            A, J = (*section.dimensions, 0.0)[:2]
            return card("PROD", [pid, mid, A, J, 0.0, rest])
        return self._beam(section, pid, mid)

    def _solid(self, section: Section, pid: int, variant: object) -> str:
        """PSOLID; with the ``variant`` True it asks for full integration."""
        integration: list[Field] = ["TWO", "", "FULL"] if variant else []
        mid, system = self._solid_material(section)
        return card("PSOLID", [pid, mid, system, *integration] if integration or system else [pid, mid])

    def _solid_material(self, section: Section) -> tuple[int, int]:
        """Numbers of the material of solids and of the system of its axes, 0 for none."""
        if section.stiffness is None:
            if section.set:
                self.warnings.append(f"the set {section.set} has no material: {section.lacks}")
            return 0, 0
        own, axes = self.deck.materials.get(section.material), section.axes
        if own is not None and own.stiffness is not None:
            C = own.stiffness if axes is None else rotate_stiffness(own.stiffness, axes)
            if np.array_equal(C, section.stiffness):
                return self._material(own, section.density), 0 if axes is None else self._system(axes)
        plain = ElasticMaterial(name="", stiffness=section.stiffness)
        return self._material(plain, section.density), 0

    def _laminate(self, section: Section, pid: int) -> str:
        """PCOMP, whose plies have the mass of their materials."""
        fields = self._laminate_head(section, pid, section.nonstructural)
        for ply in section.plies:
            own = self._elastic(section, ply.material)
            fields += [self._plane(section, ply.material, own.density), ply.thickness, ply.angle, "YES"]
        return card("PCOMP", fields)

    def _laminate_head(self, section: Section, pid: int, nonstructural: float) -> list[Field]:
        bottom: Field = section.offset - sum(ply.thickness for ply in section.plies) / 2 if section.offset else ""
        return [pid, bottom, nonstructural, "", "", "", "", ""]

    def _beam(self, section: Section, pid: int, mid: int) -> str:
        rest = section.nonstructural
        if section.profile == "GENERAL":
            A, I11, I12, I22, J = section.dimensions[:5]
            shear: list[Field] = [factor or "" for factor in section.shear_factors or (0.0, 0.0)]
            return card("PBAR", [pid, mid, A, I22, I11, J, rest, *[""] * 9, *shear, I12])
        if section.profile.startswith("PBARL "):
            name, sizes = section.profile.removeprefix("PBARL "), section.dimensions
        elif section.profile == "ELLIPSE" and len(set(section.dimensions)) == 1:
            name, sizes = "ROD", (section.dimensions[0] / 2,)
        elif section.profile in _PROFILES:
            name, dimensions = _PROFILES[section.profile]
            sizes = tuple(dimensions(section.dimensions))
        else:
            raise InputError(
                f"{self._what(section)} has the profile {section.profile!r}; expected {', '.join(_PROFILES)}"
            )
        return card("PBARL", [pid, mid, "", name, "", "", "", "", *map(float, sizes), rest])

    def _thickness(self, section: Section) -> float:
        if "NODAL THICKNESS" in section.code:
            raise InputError(
                f"{self._what(section)} takes the thickness from nodes, which is not read; give it to it",
                kind="unsupported",
            )
        if not section.thickness > 0:
            raise InputError(f"{self._what(section)} has no thickness; give it one", kind="missing")
        return section.thickness

    # Elements

    def tail(self, part: Elements, number: int, i: int) -> list[Field]:
        """What stands behind the nodes of the element in row ``i`` of a part."""
        section = self.deck.sections[number] if number >= 0 else Section(set="", kind=part.kind)
        own = {name: value[i] for name, value in part.values.items() if np.isfinite(value[i]).all()}
        if part.kind == "shell":
            return self._shell_tail(part, section, i, own)
        if part.kind != "beam":
            return []
        direction = own.get("direction", section.direction)
        if direction is None:
            raise InputError(f"{self._what(section)} gives no direction of its first axis; give it one", kind="missing")
        pins: list[Field] = [digits(np.flatnonzero(end)) for end in own.get("released", np.zeros((2, 6)))]
        tail: list[Field] = [*map(float, direction), "", *pins]
        offset = own.get("offset", np.zeros(0))
        return [*tail, *map(float, offset.ravel())] if offset.any() else tail

    def _shell_tail(self, part: Elements, section: Section, i: int, own: dict[str, Floats]) -> list[Field]:
        """THETA or MCID, offset, thicknesses at the corners."""
        angle: Field = ""
        if "angle" in own:
            angle = float(own["angle"])
        elif "direction" in own:
            angle = self._system(_axes_along(own["direction"]))
        elif section.axes is not None:
            angle = self._system(section.axes)
            x = self.deck.xyz[self.labels.rows(part.nodes[i, :3], "elements name")]
            if (
                any(ply.angle % 90 for ply in section.plies)
                and np.cross(x[1] - x[0], x[2] - x[0]) @ section.axes[2] < 0
            ):
                raise InputError(
                    f"{self._what(section)} has layers at angles to axes whose third one is against the normal of "
                    f"{part.code} {part.ids[i]}; turn the element or the orientation",
                    kind="unsupported",
                )
        # The offset of a laminate stands in its property.
        offset = float(own.get("offset", section.offset)) - (section.offset if section.plies else 0.0)
        thick: list[Field] = [*map(float, own.get("thickness", ()))]
        if part.shape == "quad8":
            return [*(thick or [""] * 4), angle, offset or ""]
        if part.shape == "tri6":
            return [angle, offset or "", *thick]
        blank: list[Field] = [""] * (2 if part.shape == "quad4" else 3)
        return [angle, offset or "", *blank, *thick] if thick else [angle, offset or ""]


def _axes_along(direction: Floats) -> Floats:
    """Axes (3, 3) of which the first lies along a direction (3,)."""
    first = direction / np.linalg.norm(direction)
    third = np.cross(first, np.eye(3)[np.abs(first).argmin()])
    third /= np.linalg.norm(third)
    return np.array([first, np.cross(third, first), third])


def digits(components: Sequence[int] | Ints) -> str:
    return "".join(str(component + 1) for component in components)
