"""Shells, beams and links of ANSYS archives with their sections (Mechanical APDL Element and Command References)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.ansys.elements import Rows
from morembs.importers.ansys.lines import Lines
from morembs.importers.ansys.names import Routine, element_name
from morembs.importers.decks.algebra import unit
from morembs.importers.decks.labels import Labels
from morembs.importers.decks.tables import Plate, Ply, Section
from morembs.importers.tolerances import TOL

# Shells with their nodes, beams with those before the one that turns them.
SHELLS = {Routine.SHELL63: 4, Routine.SHELL181: 4, Routine.SHELL281: 8}
BEAMS = {Routine.BEAM4: 2, Routine.BEAM188: 2, Routine.BEAM189: 3}
LINKS = (Routine.LINK8, Routine.LINK180)
# Where the nodes of a shell with equal third and fourth corners stand in VTK order.
_TRIANGLES = {4: (0, 1, 2), 8: (0, 1, 2, 4, 5, 7)}
_OF_REALS = (Routine.SHELL63, Routine.BEAM4, *LINKS)


@dataclass
class SectionData:
    """What SECTYPE, SECDATA, SECBLOCK, SECOFFSET and SECCONTROL say of each section, as they stand."""

    kinds: dict[int, tuple[str, str]] = field(default_factory=dict)
    rows: dict[int, list[list[str]]] = field(default_factory=dict)
    offsets: dict[int, list[str]] = field(default_factory=dict)
    controls: dict[int, list[str]] = field(default_factory=dict)
    current: int = 0

    def take(self, command: str, fields: list[str], lines: Lines) -> None:
        """One command."""
        if command == "SECTYPE":
            self.current = int(fields[1])
            kind, profile = (*(word.upper() for word in fields[2:4]), "", "")[:2]
            self.kinds[self.current], self.rows[self.current] = (kind, profile), []
            self.offsets.pop(self.current, None)
        elif command == "SECDATA":
            self.rows.setdefault(self.current, []).append(fields[1:])
        elif command == "SECBLOCK" and self.kinds.get(self.current, ("",))[0] == "SHELL":
            for _ in range(int(fields[1])):
                words = lines.take("SECBLOCK").decode("latin-1").split(",")
                self.rows.setdefault(self.current, []).append([word.strip() for word in words])
        elif command == "SECOFFSET":
            self.offsets[self.current] = [word.upper() for word in fields[1:]]
        elif command == "SECCONTROL":
            self.controls[self.current] = fields[1:]


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """Definition of a section: the number of its material, real constants, the section ``number`` of the archive."""

    what: str
    set: str
    routine: int
    keys: dict[int, int]
    material: int
    reals: list[float]
    number: int
    data: SectionData

    def __call__(self) -> Section:
        """The section.

        Raises:
            InputError: data that no section has.
        """
        if self.routine in SHELLS:
            return _shell(self)
        if self.routine in BEAMS:
            return _bar(self) if self.routine == Routine.BEAM4 else _beam(self)
        return _link(self)

    def real(self, at: int) -> float:
        return self.reals[at] if at < len(self.reals) else 0.0

    def section(self, kind: str, **given: object) -> Section:
        code = f"SECTYPE {self.number}" if self.number in self.data.kinds else f"R of {element_name(self.routine)}"
        name = f"material {self.material}"
        return Section(set=self.set, kind=kind, code=code, **{"material": name, **given})  # type: ignore[arg-type]

    def numbers(self) -> list[list[float]]:
        """The data of the section as numbers."""
        try:
            return [[float(word or 0) for word in row] for row in self.data.rows.get(self.number, [])]
        except ValueError as error:
            raise InputError(f"{self.what}: SECTYPE {self.number} has data that are no numbers ({error})") from error


def shapes_of(routine: int, rows: Rows) -> Iterator[tuple[str, str, Ints, Ints]]:
    """Kind, shape, rows of the elements and their nodes (k, n) in VTK order."""
    everything = np.arange(len(rows.ids))
    if routine in SHELLS:
        count = SHELLS[Routine(routine)]
        is_triangle = rows.nodes[:, 2] == rows.nodes[:, 3]
        for shape, own, order in (
            ("quad", everything[~is_triangle], tuple(range(count))),
            ("tri", everything[is_triangle], _TRIANGLES[count]),
        ):
            if len(own):
                yield "shell", f"{shape}{len(order)}", own, rows.nodes[own][:, list(order)]
    elif routine in BEAMS:
        count = BEAMS[Routine(routine)]
        yield "beam", f"line{count}", everything, rows.nodes[:, :count]
    elif routine in LINKS:
        yield "truss", "line2", everything, rows.nodes[:, :2]


def directions_of(routine: int, nodes: Ints, ids: Ints, xyz: Floats, file: str) -> Floats:
    """Directions (k, 3) of the z axes of beams: towards their third node; without one y is along the global x-y plane,
    of beams along the global z axis along y.

    Args:
        nodes: (k, 20) labels.
        ids: labels (n,) of all nodes, whose places are ``xyz`` (n, 3).

    Raises:
        InputError: nodes that are not there.
    """
    labels, at = Labels(ids, file), BEAMS[Routine(routine)]
    line = unit(xyz[labels.rows(nodes[:, 1], "elements name")] - xyz[labels.rows(nodes[:, 0], "elements name")])
    y = np.cross([0.0, 0.0, 1.0], line)
    y[np.linalg.norm(line[:, :2], axis=1) < TOL.across_z] = [0.0, 1.0, 0.0]
    result, led = np.cross(line, y), nodes[:, at] > 0
    result[led] = xyz[labels.rows(nodes[led, at], "elements name")] - xyz[labels.rows(nodes[led, 0], "elements name")]
    return np.asarray(result)


def sections_of(
    routine: int, keys: dict[int, int], rows: Rows, reals: dict[int, list[float]], data: SectionData, file: str
) -> Iterator[tuple[Given, Ints]]:
    """What each section is given, and the rows of its elements."""
    name = element_name(routine)
    triples = np.column_stack([rows.material, rows.real, rows.section])
    for material, real, number in np.unique(triples, axis=0).tolist():
        own = np.flatnonzero((triples == [material, real, number]).all(axis=1))
        by_real = routine in _OF_REALS or number not in data.kinds
        made = f"real constants {real}" if by_real else f"section {number}"
        set_ = f"{name} of material {material}, {made}"
        yield (
            Given(
                what=f"{file}: {set_}",
                set=set_,
                routine=routine,
                keys=keys,
                material=material,
                reals=reals.get(real, []),
                number=0 if by_real else number,
                data=data,
            ),
            own,
        )


def _shell(given: Given) -> Section:
    if given.keys.get(1, 0):
        raise InputError(
            f"{given.what} has KEYOPT(1) = {given.keys[1]}, which is not read: shells resist stretching and bending "
            "here; leave it out",
            kind="unsupported",
        )
    if not given.number:
        return _shell_of_reals(given)
    layers = [(*row, 0.0, 0.0, 0.0)[:3] for row in given.numbers()]
    if any(float(word or 0) for word in given.data.controls.get(given.number, [])[:7]):
        raise InputError(
            f"{given.what} has stiffness or mass by SECCONTROL, which are not read; leave them out", kind="unsupported"
        )
    if not layers or not all(thickness > 0 for thickness, *_ in layers):
        raise InputError(f"{given.what} has no thickness; give it one (SECDATA)", kind="missing")
    total = sum(thickness for thickness, *_ in layers)
    where = (*given.data.offsets.get(given.number, []), "MID")[0] or "MID"
    sides = {"MID": 0.0, "TOP": -0.5, "BOT": 0.5}
    if where not in sides:
        raise InputError(f"{given.what} has the offset SECOFFSET,{where}; expected {', '.join(sides)}")
    offset = sides[where] * total
    plies = tuple(
        Ply(material=f"material {int(number) or given.material}", thickness=thickness, angle=angle)
        for thickness, number, angle in layers
    )
    if len(plies) == 1:
        return given.section("shell", thickness=total, offset=offset, material=plies[0].material)
    return given.section("shell", thickness=total, offset=offset, plies=plies, material="")


def _shell_of_reals(given: Given) -> Section:
    """SHELL63, and SHELL181 of old archives: thicknesses at I, J, K, L; of SHELL63 behind EFS and THETA 12 I / t^3."""
    thick = [given.real(i) for i in range(4)]
    if thick[1:] != [0.0] * 3 and len(set(thick)) > 1:
        raise InputError(
            f"{given.what} varies in thickness over its nodes, which is not supported; give it one thickness",
            kind="unsupported",
        )
    if not thick[0] > 0:
        raise InputError(f"{given.what} has no thickness; give it one (R or SECDATA)", kind="missing")
    plate, name = None, f"material {given.material}"
    if given.routine == Routine.SHELL63:
        if given.real(4):
            raise InputError(
                f"{given.what} has a foundation (EFS), which is not read; leave it out", kind="unsupported"
            )
        # Kirchhoff's plate does not shear.
        plate = Plate(membrane=name, bending=name, inertia_ratio=given.real(6) or 1.0)
    return given.section("shell", thickness=thick[0], plate=plate)


def _beam(given: Given) -> Section:
    """BEAM188 and 189; the first axis of their profiles is z, to which the third node points."""
    profile, sizes = given.data.kinds.get(given.number, ("", ""))[1], [v for row in given.numbers() for v in row]
    if (*given.data.offsets.get(given.number, []), "")[0] not in ("", "CENT"):
        raise InputError(
            f"{given.what} has an offset (SECOFFSET), which is not read; expected CENT", kind="unsupported"
        )
    sizes += [0.0] * 12
    known = {
        "RECT": ("RECT", (sizes[1], sizes[0])),
        "CSOLID": ("CIRC", (sizes[0],)),
        "CTUBE": ("PIPE", (sizes[1], sizes[1] - sizes[0])),
        # A, Iyy, Iyz, Izz, Iw, J, and the places of centroid and shear center.
        "ASEC": ("GENERAL", (sizes[0], sizes[3], -sizes[2], sizes[1], sizes[5])),
    }
    if profile not in known or (profile == "ASEC" and any(sizes[6:10])) or not known[profile][1][0] > 0:
        raise InputError(
            f"{given.what} has the profile {profile or 'none'}, or one off its axis; expected {', '.join(known)} "
            "(SECTYPE, SECDATA)"
        )
    name, dimensions = known[profile]
    return given.section("beam", profile=name, dimensions=dimensions)


def _bar(given: Given) -> Section:
    """BEAM4: AREA, IZZ, IYY, TKZ, TKY, THETA, ISTRN, IXX, SHEARZ, SHEARY, SPIN, ADDMAS."""
    area, Izz, Iyy = (given.real(i) for i in range(3))
    if not area > 0 or given.real(5):
        raise InputError(
            f"{given.what} has no area or is turned (THETA), which is not read; turn its third node", kind="missing"
        )
    shear = tuple(1 / given.real(i) if given.real(i) else 0.0 for i in (8, 9))
    sizes = (area, Izz, 0.0, Iyy, given.real(7) or Iyy + Izz)
    return given.section("beam", profile="GENERAL", dimensions=sizes, shear_factors=shear, nonstructural=given.real(11))


def _link(given: Given) -> Section:
    sizes = [value for row in given.data.rows.get(given.number, []) for value in row] if given.number else []
    area = float(sizes[0] or 0) if sizes else given.real(0)
    if not area > 0:
        raise InputError(f"{given.what} has no area; give it one (R)", kind="missing")
    mass = given.real(1) if given.routine == Routine.LINK180 else 0.0
    return given.section("truss", dimensions=(area,), nonstructural=mass)
