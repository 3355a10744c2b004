"""Properties and materials of Nastran bulk data as cards for MYSTRAN.

What MYSTRAN 18 has otherwise than the deck means is written so that it comes out right, or refused: masses of laminates
go into their NSM (MYSTRAN leaves out a ply), tubes become rods, beams of constant section bars.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from math import pi

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.fem.material import Material, isotropic
from morembs.importers.decks.options import unused_material
from morembs.importers.engines.mystran.cards import system_card
from morembs.importers.imported import Lacking
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.importer import is_full
from morembs.importers.nastran.properties import by_number, padded
from morembs.importers.nastran.text_of_cards import Field, card
from morembs.importers.tolerances import TOL

# What the properties of each kind of elements may be.
CARDS = {
    "solid": ("PSOLID",),
    "shell": ("PSHELL", "PCOMP", "PCOMPG"),
    "shear": ("PSHEAR",),
    "bar": ("PBAR", "PBARL"),
    "beam": ("PBEAM", "PBEAML"),
    "rod": ("PROD",),
    "tube": ("PTUBE",),
    "conrod": (),
}
# The field of the density of each kind of material, and how many fields it has.
_MATERIALS = {"MAT1": (4, 5), "MAT2": (7, 8), "MAT8": (7, 8), "MAT9": (22, 23)}
# Dimensions of sections whose area and moments MYSTRAN has right (18.0: wrong for BOX1, CHAN1, CHAN2, HAT, HEXA).
_SECTIONS = {
    "BAR": 2,
    "BOX": 4,
    "CHAN": 4,
    "CROSS": 4,
    "H": 4,
    "I": 6,
    "I1": 4,
    "ROD": 1,
    "T": 4,
    "T1": 4,
    "T2": 4,
    "TUBE": 2,
    "TUBE2": 2,
}
_CENTRED = ("BAR", "BOX", "CROSS", "H", "I1", "ROD", "TUBE", "TUBE2")
_STATIONS = ("YES", "YESA", "NO")


class Sections:
    """The properties that elements use, numbered from 1 in the order in which they are named.

    ``sets`` are the names of these, such as PSHELL_3. ``materials`` are isotropic ones of sets, or "all" of these,
    whose own ones are not there; their densities count behind the mass scale ``scale`` of the deck.
    """

    def __init__(self, bulk: Bulk, materials: Sequence[Material], scale: float) -> None:
        self.bulk, self.file = bulk, bulk.file
        self._given = {material.set: _isotropic_row(material, scale) for material in materials}
        self.sets: list[str] = []
        self.warnings: list[str] = []
        # Names of the given materials that were needed, and of sets whose own ones give no mass and are replaced.
        self._used: set[str] = set()
        self._replaced: set[str] = set()
        self._numbers: dict[tuple[str, int], int] = {}
        self._rows: list[tuple[str, list[str], str]] = []
        self._properties = {
            kind: {name: by_number(self.file, name, bulk.rows[name]) for name in names} for kind, names in CARDS.items()
        }
        self._materials = {name: by_number(self.file, name, bulk.rows[name]) for name in _MATERIALS}

    def number(self, kind: str, pid: int, what: str, own: Sequence[str] = (), element: str = "") -> int:
        """The number of a property of a ``kind``; ``own`` are its fields where an element has none but itself."""
        key = (kind + element, pid)
        if key not in self._numbers:
            if own:
                matches = [("CONROD", list(own))]
            else:
                matches = [(name, rows[pid]) for name, rows in self._properties[kind].items() if pid in rows]
            if not matches and kind == "solid":
                # Solids need no more than a material, which may be given.
                matches = [("PSOLID", [str(pid)])]
            if len(matches) != 1:
                expected = " or ".join(CARDS[kind])
                raise InputError(f"{what} names the property {pid}; expected one {expected} with that number")
            name, row = matches[0]
            self._numbers[key] = len(self.sets) + 1
            self.sets.append(f"{name}_{pid}")
            self._rows.append((name, row, element))
        return self._numbers[key]

    def lacking(self) -> dict[str, Lacking]:
        """Sets without any mass, by name."""
        bare = {}
        for name, (kind, row, _) in zip(self.sets, self._rows, strict=True):
            mids = self._mass_of(kind, row)
            missing = [mid for mid in mids or [0] if not self._is_there(mid, name)]
            if missing and (kind == "PSOLID" or mids):
                what = f"names the material {missing[0]}, which is not there" if missing[0] else "has no material"
                bare[name] = Lacking(sentence=f"the set {name} {what}")
            elif mids and not self._nsm(kind, row) and not any(self._density(mid, name) for mid in mids):
                sentence = f"{self.material(mids[0], self.file, name)[0]} {mids[0]} of the set {name} has no density"
                if self._given.keys() & {name, "all"}:
                    self._replaced.add(name)
                    self.warnings.append(f"{sentence}; the material that was given took its place")
                else:
                    bare[name] = Lacking(sentence=sentence, stiffness=np.eye(6))
        return bare

    def cards(self, densities: Mapping[str, float], without: Collection[str]) -> list[tuple[str, ...]]:
        """The cards of each property and of all that it names, with ``densities`` of sets; none of sets ``without`` a
        material.

        Raises:
            DeckError: what MYSTRAN has not, or has wrong.
        """
        self.densities = dict(densities)
        result: list[tuple[str, ...]] = []
        for i, (name, (kind, row, element)) in enumerate(zip(self.sets, self._rows, strict=True)):
            with self.bulk.problems.collected():
                if name in without:
                    continue
                property_ = _Property(self, i + 1, f"{self.file}: {name.replace('_', ' ')}", row, densities.get(name))
                result.append(property_.cards(kind, element))
        return result

    def shear_mass(self, number: int) -> float:
        """Mass per area of the PSHEAR with a number."""
        name, (_, row, _) = self.sets[number - 1], self._rows[number - 1]
        what, row = f"{self.file}: {name.replace('_', ' ')}", padded(row, 5)
        density = self.densities.get(name, self._density(integer(row[1], what), name))
        return density * real(row[2], what) + real(row[3], what)

    def _is_there(self, mid: int, name: str) -> bool:
        return any(mid in rows for rows in self._materials.values()) or name in self._given or "all" in self._given

    def material(self, mid: int, what: str, name: str) -> tuple[str, list[str]]:
        """Name and fields of a material card, of the set ``name`` the one that was given where there is none."""
        for card_, rows in self._materials.items():
            if mid in rows and name not in self._replaced:
                return card_, padded(rows[mid], _MATERIALS[card_][1])
        owner = name if name in self._given else "all"
        if owner not in self._given:
            raise InputError(f"{what} names the material {mid}; expected one of {', '.join(_MATERIALS)}")
        self._used.add(owner)
        return "MAT1", self._given[owner]

    def misgiven(self) -> list[str]:
        """A sentence on each given material of a set that is not there, or that nothing needed."""
        return [
            unused_material(name)
            if name in (*self.sets, "all")
            else f"--material was given for the set {name!r}, which the deck does not have; {nearest(name, self.sets)}"
            for name in self._given
            if name not in self._used
        ]

    def _density(self, mid: int, name: str) -> float:
        card_, row = self.material(mid, self.file, name)
        return real(row[_MATERIALS[card_][0]], f"{self.file}: {card_} {mid}")

    def _mass_of(self, kind: str, row: list[str]) -> list[int]:
        """Materials that give mass."""
        if kind in ("PCOMP", "PCOMPG"):
            return [mid for mid, _, _ in plies(kind, row, self.file)]
        texts = [padded(row, 4)[1]] if kind != "PSHELL" else [padded(row, 4)[1], padded(row, 4)[3]]
        return [integer(text, self.file) for text in texts if text and text != "-1"][:1]

    def _nsm(self, kind: str, row: list[str]) -> float:
        at = {
            "PSHELL": 7,
            "PCOMP": 2,
            "PCOMPG": 2,
            "PSHEAR": 3,
            "PBAR": 6,
            "PROD": 5,
            "PTUBE": 4,
            "PBEAM": 7,
            "CONROD": 5,
        }.get(kind)
        if kind in ("PBARL", "PBEAML"):
            at = 8 + _SECTIONS.get(padded(row, 4)[3].upper(), 1000)
        return real(padded(row, at + 1)[at], self.file) if at is not None else 0.0


def _isotropic_row(material: Material, scale: float) -> list[str]:
    """The fields of MAT1: number, E, G, NU, density before it is scaled."""
    C = material.stiffness
    lam, mu = float(C[0, 1]), float(C[3, 3])
    young, poisson = mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
    like = isotropic(set=material.set, young=young, poisson=poisson, density=material.density)
    if not np.allclose(like.stiffness, C, rtol=TOL.isotropic_stiffness, atol=0.0):
        raise InputError(f"the material of the set {material.set!r} is not isotropic, which MYSTRAN is given here")
    return ["0", repr(young), "", repr(poisson), repr(material.density / scale)]


def plies(kind: str, row: list[str], what: str) -> list[tuple[int, float, float]]:
    """Material, thickness and angle in degrees of the plies of a PCOMP or PCOMPG; a blank one is as that before."""
    result: list[tuple[int, float, float]] = []
    step, first = (4, 0) if kind == "PCOMP" else (8, 1)
    for at in range(8, len(row), step):
        words = padded(row[at : at + step], step)[first : first + 3]
        if any(words):
            before = result[-1] if result else (0, 0.0, 0.0)
            mid = integer(words[0], what) or before[0]
            thickness = real(words[1], what) if words[1] else before[1]
            if not mid or not thickness > 0:
                raise InputError(f"{what} has a ply without material or thickness; complete it")
            result.append((mid, thickness, real(words[2], what)))
    if not result:
        raise InputError(f"{what} has no plies; complete it")
    return result


class _Property:
    """Writes one property under its new number, and its materials beside it."""

    def __init__(self, of: Sections, number: int, what: str, row: list[str], density: float | None) -> None:
        self.of, self.number, self.what, self.density = of, number, what, density
        self.set = of.sets[number - 1]
        self.row = padded(row, 64)
        self.beside: dict[str, None] = {}
        self._mats = 0

    def cards(self, kind: str, element: str) -> tuple[str, ...]:
        """All cards; ``element`` is the card of the elements of a PSOLID."""
        if kind == "PSOLID":
            own = self._psolid(element)
        else:
            writers: dict[str, Callable[[], str]] = {
                "PSHELL": self._pshell,
                "PSHEAR": self._pshear,
                "PBAR": self._pbar,
                "PBARL": self._pbarl,
                "PBEAM": self._pbeam,
                "PBEAML": self._pbeaml,
                "PROD": self._prod,
                "CONROD": self._prod,
                "PTUBE": self._ptube,
                "PCOMP": lambda: self._pcomp("PCOMP"),
                "PCOMPG": lambda: self._pcomp("PCOMPG"),
            }
            own = writers[kind]()
        return own, *self.beside

    def _real(self, at: int, default: float = 0.0) -> float:
        return real(self.row[at], self.what) if self.row[at] else default

    def _material(self, text: str, density: float | None = None) -> int:
        """The number under which a material is written for this property alone."""
        mid = integer(text, self.what) if text else 0
        name, words = self.of.material(mid, self.what, self.set)
        if name == "MAT1" and sum(bool(word) for word in words[1:4]) < 2:
            raise InputError(f"{self.of.file}: MAT1 {mid} gives less than two of E, G and NU; expected two")
        at, count = _MATERIALS[name]
        values: list[Field] = [real(word, f"{self.of.file}: {name} {mid}") if word else "" for word in words[1:count]]
        if density is not None:
            values[at - 1] = density
        self._mats += 1
        number = 100 * self.number + self._mats
        self.beside[card(name, [number, *values])] = None
        return number

    def _psolid(self, element: str) -> str:
        quadratic, tets = element.endswith("2"), element.startswith("CTETRA")
        order = {"2": "2", "TWO": "2", "3": "3", "THREE": "3"}.get(self.row[3].upper(), "")
        # With two points along each edge quadratic elements have modes without energy in MYSTRAN.
        order = "" if tets else "3" if quadratic else order or "2"
        full = "1" if is_full(self.row) and not tets else ""
        system = integer(self.row[2], self.what)
        if system:
            self.beside[system_card(self.of.bulk, system)] = None
        return card("PSOLID", [self.number, self._material(self.row[1], self.density), system, order, "", full])

    def _pshell(self) -> str:
        if self.row[10] or self.row[3] == "-1":
            raise InputError(
                f"{self.what} couples membrane and bending (MID4), or is in plane strain (MID2 = -1), "
                "which MYSTRAN has not"
            )
        if not self.row[2]:
            raise InputError(f"{self.what} has no thickness T; expected one, also where elements have their own")
        if not (self.row[1] or self.row[3]):
            raise InputError(f"{self.what} names no material; expected MID1 or MID2")
        mids: list[Field] = []
        for at in (1, 3, 5):
            # The mass is that of the first material.
            density = self.density if at == 1 or (at == 3 and not self.row[1]) else None
            mids.append(self._material(self.row[at], density) if self.row[at] else "")
        fields = [
            self.number,
            mids[0],
            self._real(2),
            mids[1],
            self._real(4, 1.0),
            mids[2],
            self._real(6, TOL.shear_thickness),
            self._real(7),
        ]
        return card("PSHELL", fields)

    def _pcomp(self, kind: str) -> str:
        laminate = self.row[7].upper()
        if laminate not in ("", "SYM"):
            raise InputError(f"{self.what} is a laminate of the kind {laminate!r}; MYSTRAN has SYM and none")
        layers, twice = plies(kind, self.row, self.what), 2 if laminate else 1
        masses = [
            thickness * (self.density if self.density is not None else self._density(mid))
            for mid, thickness, _ in layers
        ]
        fields: list[Field] = [
            self.number,
            self._real(1) if self.row[1] else "",
            self._real(2) + twice * sum(masses),
            "",
            "",
            "",
            "",
            laminate,
        ]
        numbers: dict[int, int] = {}
        for mid, thickness, angle in layers:
            if mid not in numbers:
                numbers[mid] = self._material(str(mid), 0.0)
            fields += [numbers[mid], thickness, angle, "NO"]
        return card("PCOMP", fields)

    def _density(self, mid: int) -> float:
        name, words = self.of.material(mid, self.what, self.set)
        return real(words[_MATERIALS[name][0]], self.what)

    def _pshear(self) -> str:
        if self._real(4) or self._real(5):
            raise InputError(f"{self.what} gives extensional stiffness (F1, F2), which MYSTRAN has not")
        return card("PSHEAR", [self.number, self._material(self.row[1], self.density), self._real(2)])

    def _bar(self, A: float, I1: float, I2: float, J: float, nsm: float, shear: Sequence[float], I12: float) -> str:
        factors: list[Field] = [factor or "" for factor in shear]
        if I12 and any(shear):
            self.of.warnings.append(
                f"{self.what} has I12 and shear factors K1, K2, which MYSTRAN leaves out beside I12: its bars are "
                "stiff in shear [formulation-differs]"
            )
        head: list[Field] = [self.number, self._material(self.row[1], self.density), A, I1, I2, J, nsm]
        return card("PBAR", [*head, *[""] * 9, *factors, I12])

    def _pbar(self) -> str:
        A, I1, I2, J, nsm = (self._real(at) for at in range(2, 7))
        return self._bar(A, I1, I2, J, nsm, (self._real(16), self._real(17)), self._real(18))

    def _shaped(self, names: Sequence[str]) -> str:
        """PBARL of the first section of this PBARL or PBEAML."""
        shape = self.row[3].upper()
        if shape not in names:
            raise InputError(
                f"{self.what} has the section {shape!r}; MYSTRAN has {', '.join(names)} right; give its area and "
                "moments by PBAR"
            )
        count = _SECTIONS[shape]
        values = [self._real(8 + i) for i in range(count + 1)]
        fields: list[Field] = [self.number, self._material(self.row[1], self.density), "", shape, "", "", "", ""]
        return card("PBARL", [*fields, *values])

    def _pbarl(self) -> str:
        return self._shaped(list(_SECTIONS))

    def _pbeaml(self) -> str:
        text = self._shaped(_CENTRED)
        count = _SECTIONS[self.row[3].upper()]
        first, at = self.row[8 : 9 + count], 9 + count
        while any(self.row[at:]):
            values = self.row[at + 2 : at + 3 + count]
            if any(
                word and real(word, self.what) != real(own, self.what) for word, own in zip(values, first, strict=False)
            ):
                self._not_constant()
            at += 3 + count
        return text

    def _pbeam(self) -> str:
        A, I1, I2, I12, J, nsm = (self._real(at) for at in range(2, 8))
        at = 8 if self.row[8].upper() in _STATIONS else 16
        while self.row[at].upper() in _STATIONS:
            for own, field in zip((A, I1, I2, I12, J, nsm), range(at + 2, at + 8), strict=True):
                if self.row[field] and self._real(field) != own:
                    self._not_constant()
            at += 16 if self.row[at].upper() == "YES" else 8
        factors = self._real(at, 1.0), self._real(at + 1, 1.0)
        if any(self._real(i) for i in (*range(at + 4, at + 6), *range(at + 8, at + 16))):
            raise InputError(
                f"{self.what} has inertia of its own about its axis, or axes beside its grids (M1 to N2); "
                "a bar of MYSTRAN has not"
            )
        return self._bar(A, I1, I2, J, nsm, factors, I12)

    def _not_constant(self) -> None:
        raise InputError(
            f"{self.what} is not constant along the beam; MYSTRAN assembles no CBEAM, and a CBAR is constant"
        )

    def _rod(self, A: float, J: float, nsm: float) -> str:
        return card("PROD", [self.number, self._material(self.row[1], self.density), A, J, 0.0, nsm])

    def _prod(self) -> str:
        return self._rod(self._real(2), self._real(3), self._real(5))

    def _ptube(self) -> str:
        outer, wall = self._real(2), self._real(3)
        if self.row[5] and self._real(5) != outer:
            raise InputError(f"{self.what} is tapered (OD2); expected a constant tube")
        inner = outer - 2 * wall if wall else 0.0
        return self._rod(pi / 4 * (outer**2 - inner**2), pi / 32 * (outer**4 - inner**4), self._real(4))
