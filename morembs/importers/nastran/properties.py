"""Solid properties and materials of Nastran bulk data."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.material import Material, isotropic, orthotropic
from morembs.importers.decks.algebra import rotate_stiffness
from morembs.importers.imported import Lacking
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.geometry import Grids, Systems
from morembs.importers.tolerances import TOL

Rows = list[list[str]]
# Nastran orders shear xy, yz, zx; here it is yz, zx, xy.
_MAT9 = (0, 1, 2, 5, 3, 4)


def padded(row: list[str], count: int) -> list[str]:
    """The fields with blank ones behind them."""
    return row + [""] * (count - len(row))


class Materials:
    """PSOLID, MAT1, MAT9 and MAT11 as a material for each property."""

    def __init__(self, file: str, scale: float) -> None:
        self.file, self.scale = file, scale
        self.notes: list[str] = []
        self.warnings: list[str] = []
        self.lacking: dict[str, Lacking] = {}

    def of(
        self, pids: list[int], psolid: Rows, mats: dict[str, Rows], systems: Systems, grids: Grids
    ) -> list[Material]:
        """Materials of the properties ``pids``, their densities times PARAM WTMASS."""
        properties = self._by_number("PSOLID", psolid)
        cards = {name: self._by_number(name, mats[name]) for name in ("MAT1", "MAT9", "MAT11")}
        of: dict[int, str] = {}
        for card, given in cards.items():
            for mid in given:
                if mid in of:
                    raise InputError(f"{self.file} defines the material {mid} as {of[mid]} and as {card}")
                of[mid] = card
        materials = []
        for pid in pids:
            name = f"PSOLID_{pid}"
            if pid not in properties:
                self.lacking[name] = Lacking(sentence=f"the property {pid} of solids is not in the file")
                continue
            row = padded(properties[pid], 8)
            if row[6] and row[6].upper() not in ("SMECH", "0"):
                raise InputError(f"{self.file}: PSOLID {pid} is of the kind {row[6]!r}; expected a structural one")
            mid = integer(row[1], f"{self.file}: PSOLID {pid}")
            if mid not in of:
                what = f"names the material {mid}, which is no {', '.join(cards)} there" if mid else "names no material"
                self.lacking[name] = Lacking(sentence=f"PSOLID {pid} {what}")
            elif of[mid] == "MAT1":
                materials += self._mat1(name, mid, cards["MAT1"][mid])
            else:
                take = self._mat9 if of[mid] == "MAT9" else self._mat11
                C, density = take(mid, cards[of[mid]][mid])
                what = f"{self.file}: {of[mid]} {mid}"
                C = self._along(C, integer(row[2], f"{self.file}: PSOLID {pid}"), what, systems, grids)
                if density:
                    materials.append(Material(set=name, stiffness=C, density=density * self.scale))
                else:
                    like = Material(set=name, stiffness=C, density=1.0)
                    materials += self._without_density(name, f"{of[mid]} {mid}", like)
        return materials

    def _by_number(self, name: str, rows: Rows) -> dict[int, list[str]]:
        cards: dict[int, list[str]] = {}
        for row in rows:
            number = integer(padded(row, 1)[0], f"{self.file}: {name}")
            if number < 1 or number in cards:
                raise InputError(f"{self.file}: {name} {number} is defined twice, or below 1")
            cards[number] = row
        return cards

    def _mat1(self, name: str, mid: int, row: list[str]) -> list[Material]:
        what, row = f"{self.file}: MAT1 {mid}", padded(row, 8)
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
        if not rho:
            return self._without_density(name, f"MAT1 {mid}", isotropic(set=name, young=E, poisson=nu, density=1.0))
        return [isotropic(set=name, young=E, poisson=nu, density=rho * self.scale)]

    def _mat9(self, mid: int, row: list[str]) -> tuple[Floats, float]:
        """Stiffness (6, 6) along the axes of the material, and density."""
        numbers = [real(text, f"{self.file}: MAT9 {mid}") for text in padded(row, 23)[1:23]]
        C = np.zeros((6, 6))
        C[np.triu_indices(6)] = numbers[:21]
        return (C + np.triu(C, 1).T)[np.ix_(np.argsort(_MAT9), np.argsort(_MAT9))], numbers[21]

    def _mat11(self, mid: int, row: list[str]) -> tuple[Floats, float]:
        """Stiffness (6, 6) along the axes of the material, and density."""
        e1, e2, e3, n12, n13, n23, g12, g13, g23, density = (
            real(text, f"{self.file}: MAT11 {mid}") for text in padded(row, 11)[1:11]
        )
        material = orthotropic(
            set="all", young=(e1, e2, e3), poisson=(n12, n13, n23), shear=(g12, g13, g23), density=density or 1.0
        )
        return material.stiffness, density

    def _along(self, C: Floats, system: int, what: str, systems: Systems, grids: Grids) -> Floats:
        """Stiffness along the basic axes of a material along those of a system (CORDM)."""
        if not system:
            return C
        if system < 0:
            raise InputError(f"{what}: its directions are those of each element (CORDM = {system}); expected a system")
        kind, _, axes = systems.frame(system, grids)
        if kind != "R":
            raise InputError(f"{what}: its directions vary (CORDM = {system} is not rectangular); expected CORD2R")
        return rotate_stiffness(C, axes)

    def _without_density(self, name: str, card: str, like: Material) -> list[Material]:
        self.lacking[name] = Lacking(sentence=f"{card} of the set {name} has no density", stiffness=like.stiffness)
        return []


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
