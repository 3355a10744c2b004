"""Properties and materials of Nastran bulk data, rigid elements and concentrated masses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_materials import turned
from morembs.importers.imported import Lacking, PointMass
from morembs.importers.nastran_cards import integer, real
from morembs.importers.nastran_geometry import Grids, Systems
from morembs.model.constraints import AverageElement, RigidElement
from morembs.model.material import Material, isotropic

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Rows = list[list[str]]
_ALL = (0, 1, 2, 3, 4, 5)
# Nastran orders shear xy, yz, zx; here it is yz, zx, xy.
_MAT9 = (0, 1, 2, 5, 3, 4)


def padded(row: list[str], count: int) -> list[str]:
    """The fields with blank ones behind them."""
    return row + [""] * (count - len(row))


class Materials:
    """PSOLID, MAT1 and MAT9 as a material for each property."""

    def __init__(self, file: str, scale: float) -> None:
        self.file, self.scale = file, scale
        self.notes: list[str] = []
        self.lacking: dict[str, Lacking] = {}

    def of(
        self, pids: list[int], psolid: Rows, mats: dict[str, Rows], systems: Systems, grids: Grids
    ) -> list[Material]:
        """Materials of the properties ``pids``, their densities times PARAM WTMASS."""
        properties = self._by_number("PSOLID", psolid)
        cards = {"MAT1": self._by_number("MAT1", mats["MAT1"]), "MAT9": self._by_number("MAT9", mats["MAT9"])}
        both = set(cards["MAT1"]) & set(cards["MAT9"])
        if both:
            raise InputError(f"{self.file} defines the material {min(both)} as MAT1 and as MAT9")
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
            if not mid:
                self.lacking[name] = Lacking(sentence=f"PSOLID {pid} names no material")
            elif mid in cards["MAT1"]:
                materials += self._mat1(name, mid, cards["MAT1"][mid])
            elif mid in cards["MAT9"]:
                materials += self._mat9(
                    name, mid, cards["MAT9"][mid], integer(row[2], f"{self.file}: PSOLID {pid}"), systems, grids
                )
            else:
                raise InputError(f"{self.file}: PSOLID {pid} names the material {mid}, which is no MAT1 or MAT9 there")
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
        if sum(given) < 2:
            raise InputError(f"{what} gives {sum(given)} of E, G and NU; expected two")
        if all(given) and G and abs(E / (2 * G) - 1 - nu) > 1e-2 * (1 + abs(nu)):
            raise InputError(f"{what}: E = {E:g}, G = {G:g} and NU = {nu:g} contradict each other; give two of them")
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

    def _mat9(self, name: str, mid: int, row: list[str], system: int, systems: Systems, grids: Grids) -> list[Material]:
        what = f"{self.file}: MAT9 {mid}"
        numbers = [real(text, what) for text in padded(row, 23)[1:23]]
        C = np.zeros((6, 6))
        C[np.triu_indices(6)] = numbers[:21]
        C = (C + np.triu(C, 1).T)[np.ix_(np.argsort(_MAT9), np.argsort(_MAT9))]
        if system:
            if system < 0:
                raise InputError(
                    f"{what}: its directions are those of each element (CORDM = {system}); expected a system"
                )
            kind, _, axes = systems.frame(system, grids)
            if kind != "R":
                raise InputError(f"{what}: its directions vary (CORDM = {system} is not rectangular); expected CORD2R")
            C = turned(C, axes)
        if not numbers[21]:
            return self._without_density(name, f"MAT9 {mid}", Material(set=name, stiffness=C, density=1.0))
        return [Material(set=name, stiffness=C, density=numbers[21] * self.scale)]

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


def components(text: str, what: str) -> tuple[int, ...]:
    """Components 0 to 5 of digits 1 to 6."""
    if not text or not set(text) <= set("123456"):
        raise InputError(f"{what}: {text!r} was given as components; expected digits of 1 to 6")
    return tuple(sorted({int(digit) - 1 for digit in text}))


class Ties:
    """RBE2, RBE3, RBAR and CONM2 as rows of grids."""

    def __init__(self, grids: Grids, systems: Systems, scale: float) -> None:
        self.grids, self.systems, self.scale = grids, systems, scale
        self.rigid: list[RigidElement] = []
        self.average: list[AverageElement] = []
        self.masses: list[PointMass] = []
        self.notes: list[str] = []

    def _rows(self, labels: list[int], what: str) -> Ints:
        return self.grids.rows(np.array(labels, dtype=np.int64), what)

    def _refuse_turned(self, rows: Ints, which: tuple[int, ...], what: str) -> None:
        """Some components only, along axes that are not those of the model."""
        if which not in (_ALL, (0, 1, 2)) and self.grids.cd[rows].any():
            raise InputError(f"{what} ties some directions of turned axes (CD of its grids); expected 123 or 123456")

    def rbe2(self, row: list[str]) -> None:
        what = f"{self.grids.file}: RBE2 {padded(row, 1)[0]}"
        texts = row[3:]
        if texts and "." in texts[-1]:
            self.notes.append(f"RBE2 {row[0]}: its thermal expansion {texts[-1]} is not carried over.")
            texts = texts[:-1]
        which = components(padded(row, 3)[2], what)
        master = int(self._rows([integer(padded(row, 2)[1], what)], what)[0])
        slaves = np.unique(self._rows(labels_of(texts, what, self.grids.ids), what))
        self._add_rigid(what, f"RBE2_{row[0]}", master, slaves, which)

    def rbar(self, row: list[str]) -> None:
        row = padded(row, 7)
        what = f"{self.grids.file}: RBAR {row[0]}"
        a, b = self._rows([integer(row[1], what), integer(row[2], what)], what).tolist()
        kept = ["".join(sorted(text)) for text in row[3:5]]
        if "123456" not in kept or any(kept[1 - kept.index("123456")]):
            raise InputError(f"{what}: CNA = {row[3]!r}, CNB = {row[4]!r} was given; expected 123456 at one end only")
        first = kept[0] == "123456"
        master, slave = (a, b) if first else (b, a)
        text = row[6] if first else row[5]
        self._add_rigid(what, f"RBAR_{row[0]}", master, np.array([slave]), components(text, what) if text else _ALL)

    def _add_rigid(self, what: str, name: str, master: int, slaves: Ints, which: tuple[int, ...]) -> None:
        if not len(slaves) or (slaves == master).any():
            raise InputError(f"{what} ties no grids, or a grid to itself; check its fields")
        self._refuse_turned(slaves, which, what)
        self.rigid.append(RigidElement(name=name, master=master, slaves=slaves, components=which))

    def rbe3(self, row: list[str]) -> None:
        row = padded(row, 7)
        what = f"{self.grids.file}: RBE3 {row[0]}"
        reference = int(self._rows([integer(row[2], what)], what)[0])
        which = components(row[3], what)
        self._refuse_turned(np.array([reference]), which, what)
        weight = np.zeros(len(self.grids.ids))
        inside = np.zeros(len(weight), dtype=bool)
        i, texts = 4, row
        while i < len(texts) and texts[i].upper() not in ("UM", "ALPHA"):
            if not texts[i]:
                i += 1
                continue
            w, moving = real(texts[i], what), components(padded(texts, i + 2)[i + 1], what)
            if "." not in texts[i] or moving[:3] != (0, 1, 2):
                raise InputError(
                    f"{what} gives the weight {texts[i]!r} to the components {padded(texts, i + 2)[i + 1]!r}; expected "
                    "a real number and 123 or 123456"
                )
            end = i + 2
            while end < len(texts) and "." not in texts[end] and texts[end].upper() not in ("UM", "ALPHA"):
                end += 1
            rows = self._rows(labels_of(texts[i + 2 : end], what, self.grids.ids), what)
            weight[rows] += w
            inside[rows] = True
            i = end
        if i < len(texts) and texts[i].upper() == "UM":
            raise InputError(f"{what} names dependent components (UM), which is not supported; leave UM out")
        nodes = np.flatnonzero(inside)
        if not len(nodes) or not (weight[nodes] >= 0).all() or not weight.sum() > 0 or inside[reference]:
            raise InputError(f"{what} has no grids with positive weights, or its own reference among them")
        if any(len(text) == 6 for text in texts[5:6]):
            self.notes.append(f"RBE3 {row[0]} averages rotations of grids as well; those of solids have none.")
        self.average.append(
            AverageElement(
                name=f"RBE3_{row[0]}", reference=reference, nodes=nodes, weights=weight[nodes], components=which
            )
        )

    def conm2(self, row: list[str]) -> None:
        row = padded(row, 14)
        what = f"{self.grids.file}: CONM2 {row[0]}"
        node = int(self._rows([integer(row[1], what)], what)[0])
        system = integer(row[2], what)
        mass, *offset = (real(text, what) for text in row[3:7])
        i11, i21, i22, i31, i32, i33 = (real(text, what) for text in row[8:14])
        # The card gives int x1 x2 dm, which is the negative entry of the inertia.
        J = np.array([[i11, -i21, -i31], [-i21, i22, -i32], [-i31, -i32, i33]])
        x = np.array(offset)
        if mass < 0 or np.linalg.eigvalsh(J)[0] < -1e-9 * np.abs(J).max():
            raise InputError(f"{what} has a negative mass or inertia; expected none")
        if system < 0:
            x = x - self.grids.xyz[node]
        elif system:
            kind, _, axes = self.systems.frame(system, self.grids)
            if kind != "R":
                raise InputError(f"{what} is given in the system {system}, which is not rectangular; expected one")
            x, J = x @ axes, axes.T @ J @ axes
        self.masses.append(
            PointMass(name=f"CONM2_{row[0]}", node=node, mass=mass * self.scale, inertia=J * self.scale, offset=x)
        )
