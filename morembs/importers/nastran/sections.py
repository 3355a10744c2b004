"""Properties of shells, shear panels, bars and rods of Nastran bulk data as sections of a deck."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

from morembs.base.errors import InputError
from morembs.importers.decks.tables import Plate, Ply, Section
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.properties import Materials, pad
from morembs.importers.tolerances import TOL

# Profiles of PBARL and PBEAML with how many dimensions they have (Quick Reference Guide, PBARL).
DIMENSIONS = {
    "ROD": 1,
    "TUBE": 2,
    "TUBE2": 2,
    "BAR": 2,
    "HEXA": 3,
    "I1": 4,
    "CHAN": 4,
    "CHAN1": 4,
    "CHAN2": 4,
    "T": 4,
    "T1": 4,
    "T2": 4,
    "H": 4,
    "BOX": 4,
    "CROSS": 4,
    "Z": 4,
    "HAT": 4,
    "L": 4,
    "HAT1": 5,
    "I": 6,
    "BOX1": 6,
}
# Profiles whose shear center is their centroid: beams of others have axes beside their grids.
_CENTRED = ("BAR", "BOX", "CROSS", "H", "I1", "ROD", "TUBE", "TUBE2")
_STATIONS = ("YES", "YESA", "NO")


@dataclass(frozen=True)
class _Row:
    """The fields of a property, that of ``words[0]`` its number."""

    card: str
    set: str
    words: list[str]
    file: str
    materials: Materials

    @property
    def what(self) -> str:
        return f"{self.file}: {self.set.replace('_', ' ')}"

    def real(self, at: int, default: float = 0.0) -> float:
        return real(self.words[at], self.what) if self.words[at] else default

    def nonstructural(self, at: int) -> float:
        return self.real(at) * self.materials.scale

    def material(self, at: int) -> str:
        """Name of the material whose number stands in a field, "" without one or where it is not there."""
        number = integer(self.words[at], self.what) if self.words[at] else 0
        return self.materials.name_of(number, self.set) if number else ""

    def section(self, kind: str, *fields: int, **given: object) -> Section:
        """The section whose material is that of the first of the ``fields`` that is given."""
        at = next((field for field in fields if self.words[field]), fields[0])
        name, lacks = self.material(at), ""
        if not name:
            missing = f"names the material {self.words[at]}, which is not there"
            lacks = f"the set {self.set} {missing if self.words[at] else 'has no material'}"
        code = self.set.replace("_", " ")
        return Section(set=self.set, kind=kind, code=code, material=name, lacks=lacks, **given)  # type: ignore[arg-type]


def section_of(card: str, set_: str, row: list[str], file: str, materials: Materials) -> Section:
    """The section of a property, of the elements of the set ``set_``.

    Raises:
        InputError: fields that are none, or that a section does not have.
    """
    return SECTIONS[card](_Row(card, set_, row, file, materials))


def _pshell(row: _Row) -> Section:
    if row.words[10] or row.words[3] == "-1":
        raise InputError(
            f"{row.what} couples membrane and bending (MID4), or is in plane strain (MID2 = -1), which is not read",
            kind="unsupported",
        )
    if not row.words[2]:
        raise InputError(
            f"{row.what} has no thickness T; expected one, also where elements have their own", kind="missing"
        )
    if not (row.words[1] or row.words[3]):
        raise InputError(f"{row.what} names no material; expected MID1 or MID2", kind="missing")
    plate = Plate(
        membrane=row.material(1),
        bending=row.material(3),
        shear=row.material(5),
        inertia_ratio=row.real(4, 1.0),
        shear_ratio=row.real(6, TOL.shear_thickness),
    )
    is_plain = plate.membrane == plate.bending == plate.shear
    is_plain = is_plain and (plate.inertia_ratio, plate.shear_ratio) == (1.0, TOL.shear_thickness)
    # The mass is that of the first material.
    return row.section(
        "shell", 1, 3, thickness=row.real(2), nonstructural=row.nonstructural(7), plate=None if is_plain else plate
    )


def _pcomp(row: _Row) -> Section:
    laminate = row.words[7].upper()
    if laminate not in ("", "SYM"):
        raise InputError(f"{row.what} is a laminate of the kind {laminate!r}; expected SYM or none", kind="unsupported")
    plies, lacks = list[Ply](), ""
    for mid, thickness, angle in _plies(row):
        name = row.materials.name_of(mid, row.set)
        if not name:
            lacks = f"the set {row.set} names the material {mid}, which is not there"
        plies.append(Ply(material=name, thickness=thickness, angle=angle))
    plies += plies[::-1] if laminate else []
    total = sum(ply.thickness for ply in plies)
    return Section(
        set=row.set,
        kind="shell",
        code=row.set.replace("_", " "),
        lacks=lacks,
        thickness=total,
        plies=tuple(plies),
        offset=row.real(1) + total / 2 if row.words[1] else 0.0,
        nonstructural=row.nonstructural(2),
    )


def _plies(row: _Row) -> list[tuple[int, float, float]]:
    """Material, thickness and angle in degrees of the plies of a PCOMP or PCOMPG; a blank one is as that before."""
    result: list[tuple[int, float, float]] = []
    step, first = (4, 0) if row.card == "PCOMP" else (8, 1)
    for at in range(8, len(row.words), step):
        words = pad(row.words[at : at + step], step)[first : first + 3]
        if any(words):
            before = result[-1] if result else (0, 0.0, 0.0)
            mid = integer(words[0], row.what) or before[0]
            thickness = real(words[1], row.what) if words[1] else before[1]
            if not mid or not thickness > 0:
                raise InputError(f"{row.what} has a ply without material or thickness; complete it", kind="unsupported")
            result.append((mid, thickness, real(words[2], row.what)))
    if not result:
        raise InputError(f"{row.what} has no plies; complete it", kind="unsupported")
    return result


def _pshear(row: _Row) -> Section:
    if row.real(4) or row.real(5):
        raise InputError(
            f"{row.what} gives extensional stiffness (F1, F2), which is not read; give it by rods", kind="unsupported"
        )
    return row.section("shear", 1, thickness=row.real(2), nonstructural=row.nonstructural(3))


def _general(
    row: _Row, A: float, I1: float, I2: float, I12: float, J: float, nsm: int, shear: tuple[float, float]
) -> Section:
    """A bar by its area and moments; that of bending in the plane of its first axis is I1."""
    return row.section(
        "beam",
        1,
        profile="GENERAL",
        dimensions=(A, I2, I12, I1, J),
        shear_factors=shear,
        nonstructural=row.nonstructural(nsm),
    )


def _pbar(row: _Row) -> Section:
    A, I1, I2, J = (row.real(at) for at in range(2, 6))
    return _general(row, A, I1, I2, row.real(18), J, 6, (row.real(16), row.real(17)))


def _shape(row: _Row) -> Section:
    """A bar by the profile of a PBARL, or the first one of a PBEAML."""
    shape = row.words[3].upper()
    if shape not in DIMENSIONS:
        raise InputError(f"{row.what} has the section {shape!r}; expected {', '.join(DIMENSIONS)}")
    count = DIMENSIONS[shape]
    sizes = tuple(row.real(8 + i) for i in range(count))
    return row.section(
        "beam", 1, profile=f"PBARL {shape}", dimensions=sizes, nonstructural=row.nonstructural(8 + count)
    )


def _pbeaml(row: _Row) -> Section:
    section = _shape(row)
    count = DIMENSIONS[row.words[3].upper()]
    if row.words[3].upper() not in _CENTRED:
        raise InputError(
            f"{row.what} has the section {row.words[3].upper()!r}, whose shear center is not its centroid; expected "
            f"{', '.join(_CENTRED)}; give its area and moments by PBAR"
        )
    first, at = row.words[8 : 9 + count], 9 + count
    while any(row.words[at:]):
        values = row.words[at + 2 : at + 3 + count]
        pairs = zip(values, first, strict=False)
        if any(word and real(word, row.what) != real(own, row.what) for word, own in pairs):
            raise _not_constant(row)
        at += 3 + count
    return section


def _pbeam(row: _Row) -> Section:
    A, I1, I2, I12, J, nsm = (row.real(at) for at in range(2, 8))
    at = 8 if row.words[8].upper() in _STATIONS else 16
    while row.words[at].upper() in _STATIONS:
        for own, field in zip((A, I1, I2, I12, J, nsm), range(at + 2, at + 8), strict=True):
            if row.words[field] and row.real(field) != own:
                raise _not_constant(row)
        at += 16 if row.words[at].upper() == "YES" else 8
    if any(row.real(i) for i in (*range(at + 4, at + 6), *range(at + 8, at + 16))):
        raise InputError(
            f"{row.what} has inertia of its own about its axis, or axes beside its grids (M1 to N2), which is not "
            "read; give a PBAR and CONM2",
            kind="unsupported",
        )
    return _general(row, A, I1, I2, I12, J, 7, (row.real(at, 1.0), row.real(at + 1, 1.0)))


def _not_constant(row: _Row) -> InputError:
    return InputError(
        f"{row.what} is not constant along the beam, which is not read; give a constant one to each part",
        kind="unsupported",
    )


def _prod(row: _Row) -> Section:
    return row.section("truss", 1, dimensions=(row.real(2), row.real(3)), nonstructural=row.nonstructural(5))


def _ptube(row: _Row) -> Section:
    outer, wall = row.real(2), row.real(3)
    if row.words[5] and row.real(5) != outer:
        raise InputError(f"{row.what} is tapered (OD2); expected a constant tube")
    inner = outer - 2 * wall if wall else 0.0
    sizes = pi / 4 * (outer**2 - inner**2), pi / 32 * (outer**4 - inner**4)
    return row.section("truss", 1, dimensions=sizes, nonstructural=row.nonstructural(4))


SECTIONS: dict[str, Callable[[_Row], Section]] = {
    "PSHELL": _pshell,
    "PCOMP": _pcomp,
    "PCOMPG": _pcomp,
    "PSHEAR": _pshear,
    "PBAR": _pbar,
    "PBARL": _shape,
    "PBEAM": _pbeam,
    "PBEAML": _pbeaml,
    "PROD": _prod,
    "PTUBE": _ptube,
    "CONROD": _prod,
}
