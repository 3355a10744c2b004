"""Grids, coordinate systems and solid elements of Nastran bulk data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.decks.algebra import axes_at, frame_of, points_of
from morembs.importers.decks.labels import Labels
from morembs.importers.decks.tables import System
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.tables import Table
from morembs.importers.tolerances import TOL

# For each card: corner type and count, full type and its nodes in VTK order. Nastran lists the middles of
# bottom edges, of upright edges, of top edges; VTK bottom, top, upright.
_HEX20 = (*range(12), *range(16, 20), *range(12, 16))
_WEDGE15 = (*range(9), *range(12, 15), *range(9, 12))
SOLIDS: dict[str, tuple[str, int, str, tuple[int, ...]]] = {
    "CTETRA": ("tet4", 4, "tet10", tuple(range(10))),
    "CHEXA": ("hex8", 8, "hex20", _HEX20),
    "CPENTA": ("wedge6", 6, "wedge15", _WEDGE15),
}


def card_of(kind: str) -> str:
    """Name of the card of a type of elements."""
    return next(card for card, (low, _, high, _) in SOLIDS.items() if kind in (low, high))


class Systems:
    """Coordinate systems; 0 is the basic one."""

    def __init__(self, file: str) -> None:
        self.file = file
        self._cards: dict[int, tuple[str, list[str]]] = {}
        self._known: dict[int, tuple[str, Floats, Floats]] = {0: ("R", np.zeros(3), np.eye(3))}

    def add(self, name: str, row: list[str]) -> None:
        """A card CORD1R, CORD1C, CORD1S, CORD2R, CORD2C or CORD2S."""
        parts = [row[:4], row[4:8]] if name[4] == "1" else [row]
        for part in parts:
            if any(part):
                number = integer(part[0], f"{self.file}: {name}")
                if number < 1 or number in self._cards:
                    raise InputError(f"{self.file}: {name} {number} is defined twice, or below 1", kind="conflict")
                self._cards[number] = name, part

    @property
    def placed(self) -> dict[str, System]:
        """The systems by number that are used, without the basic one."""
        return {str(n): System(kind=k, origin=x, axes=axes) for n, (k, x, axes) in self._known.items() if n}

    def frame(self, number: int, grids: Grids, above: tuple[int, ...] = ()) -> tuple[str, Floats, Floats]:
        """Kind (R, C, S), origin (3,) and axes (3, 3, as rows) in the basic system."""
        if number in self._known:
            return self._known[number]
        if number not in self._cards:
            raise InputError(f"{self.file} names the coordinate system {number}, which is not defined", kind="unknown")
        if number in above or len(above) > TOL.max_references:
            raise InputError(
                f"{self.file}: the coordinate system {number} is defined by way of itself", kind="conflict"
            )
        name, row = self._cards[number]
        what, above = f"{self.file}: {name} {number}", (*above, number)
        if name[4] == "1":
            labels = [integer(text, what) for text in row[1:4]]
            points = np.array([grids.point(label, self, what, above) for label in [*labels, *[0] * 3][:3]])
        else:
            numbers = [real(text, what) for text in row[2:11]]
            if len(numbers) != 9:
                raise InputError(f"{what} has {len(numbers)} coordinates; expected three points")
            points = self.points(integer(row[1], what), np.array(numbers).reshape(3, 3), grids, above)
        axes = frame_of(points[1] - points[0], points[2] - points[0])
        if axes is None:
            raise InputError(f"{what}: its three points lie on a line", kind="model")
        # The z axis goes to the second point, the third is in the plane of x and z.
        self._known[number] = name[5], points[0], axes[[1, 2, 0]]
        return self._known[number]

    def points(self, number: int, xyz: Floats, grids: Grids, above: tuple[int, ...] = ()) -> Floats:
        """Points (n, 3) given in a system, in the basic one."""
        kind, origin, axes = self.frame(number, grids, above)
        return xyz if number == 0 else points_of(kind, xyz) @ axes + origin

    def axes(self, number: int, x: Floats, grids: Grids) -> Floats:
        """The axes (3, 3) of a system at a point (3,) as rows in the basic system."""
        if number <= 0:
            return np.eye(3)
        kind, origin, axes = self.frame(number, grids)
        return axes_at(kind, axes, x - origin)

    def direction(self, row: int, component: int, grids: Grids) -> Floats:
        """A component, 0 to 5, along the axes (CD) of the grid in a row, as parts (6,) along the basic axes."""
        part, turn = np.zeros(6), 3 * (component // 3)
        part[turn : turn + 3] = self.axes(int(grids.cd[row]), grids.xyz[row], grids)[component % 3]
        return part


@dataclass
class Grids:
    """Grid points; after ``sort`` by label, and after ``place`` in the basic system."""

    file: str
    ids: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    xyz: Floats = field(default_factory=lambda: np.empty((0, 3)))
    cp: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    cd: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    ps: Ints = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    fixed: int = 0
    superelements: int = 0
    repeated: int = 0
    labels: Labels = field(init=False)
    _pieces: list[tuple[Ints, Floats, Ints, Ints]] = field(default_factory=list)
    _systems: list[tuple[NDArray[np.bool_], NDArray[np.bool_]]] = field(default_factory=list)
    _permanent: list[Ints] = field(default_factory=list)

    def add(self, table: Table) -> None:
        """GRID cards: label, CP, three coordinates, CD, PS, SEID."""
        ids = table.integers(0, 1)[:, 0]
        self.superelements += int((table.integers(7, 8) != 0).sum())
        permanent = table.components(6)
        self.fixed += int((permanent != 0).sum())
        self._permanent.append(permanent)
        systems = table.integers(1, 2)[:, 0], table.integers(5, 6)[:, 0]
        self._pieces.append((ids, table.reals(2, 5), *systems))
        self._systems.append((table.are_given(1, 2)[:, 0], table.are_given(5, 6)[:, 0]))

    @property
    def count(self) -> int:
        """Cards that were added."""
        return sum(len(ids) for ids, *_ in self._pieces)

    def sort(self, default: list[str]) -> None:
        """Join what was added, in the order of labels; ``default`` are the fields of GRDSET."""
        if not self._pieces:
            raise InputError(
                f"{self.file} has no GRID cards; expected Nastran bulk data with a mesh", kind="missing", keyword="GRID"
            )
        what = f"{self.file}: GRDSET"
        cp, cd = (integer(default[i], what) if i < len(default) else 0 for i in (1, 5))
        if len(default) > 6 and default[6]:
            self.fixed = max(self.fixed, 1)
        ids, xyz, cps, cds = (np.concatenate(part) for part in zip(*self._pieces, strict=True))
        given_cp, given_cd = (np.concatenate(part) for part in zip(*self._systems, strict=True))
        self._pieces, self._systems = [], []
        order = np.argsort(ids, kind="stable")
        self.ids, self.xyz = ids[order], xyz[order]
        self.cp, self.cd = np.where(given_cp, cps, cp)[order], np.where(given_cd, cds, cd)[order]
        permanent = np.concatenate(self._permanent)[order]
        default_ps = integer(default[6].replace(" ", ""), what) if len(default) > 6 else 0
        self.ps = np.where(permanent == 0, default_ps, permanent)
        twice = np.flatnonzero(np.diff(self.ids) == 0)
        same = (
            (self.xyz[twice] == self.xyz[twice + 1]).all(axis=1)
            & (self.cp[twice] == self.cp[twice + 1])
            & (self.cd[twice] == self.cd[twice + 1])
        )
        if len(twice := twice[same]):
            self.repeated = len(twice)
            for name in ("ids", "xyz", "cp", "cd", "ps"):
                setattr(self, name, np.delete(getattr(self, name), twice, axis=0))
        self.labels = Labels(self.ids, self.file, "grid")

    def place(self, systems: Systems) -> None:
        """Coordinates in the basic system."""
        placed = self.xyz.copy() if self.cp.any() else self.xyz
        for number in np.unique(self.cp).tolist():
            if number:
                chosen = self.cp == number
                placed[chosen] = systems.points(number, self.xyz[chosen], self)
        for number in np.unique(self.cd).tolist():
            if number > 0:
                systems.frame(number, self)
        self.xyz, self.cp = placed, np.zeros_like(self.cp)
        if not (np.abs(self.xyz) < TOL.largest_number).all():
            raise InputError(
                f"{self.file}: coordinates are too large; check the grids and coordinate systems", kind="unsupported"
            )

    def extend(self, ids: Ints, xyz: Floats) -> None:
        """Grids behind all others, along the basic axes."""
        none = np.zeros(len(ids), dtype=np.int64)
        self.ids, self.xyz = np.concatenate([self.ids, ids]), np.concatenate([self.xyz, xyz])
        self.cp, self.cd, self.ps = (np.concatenate([part, none]) for part in (self.cp, self.cd, self.ps))
        self.labels = Labels(self.ids, self.file, "grid")

    def rows(self, labels: Ints, who: str) -> Ints:
        """Rows of labels (any shape)."""
        return self.labels.rows(labels, f"{who.removeprefix(f'{self.file}: ')} names")

    def point(self, label: int, systems: Systems, who: str, above: tuple[int, ...]) -> Floats:
        """Coordinates (3,) of a grid in the basic system."""
        row = int(self.rows(np.array([label]), who)[0])
        return np.asarray(systems.points(int(self.cp[row]), self.xyz[[row]], self, above)[0])


class Solids:
    """Solid elements by type: labels, property ids and grids in VTK order."""

    def __init__(self, file: str) -> None:
        self.file = file
        self._pieces: dict[str, list[tuple[Ints, Ints, Ints]]] = {}

    def add(self, table: Table) -> None:
        """CTETRA, CHEXA or CPENTA cards."""
        low, corners, high, order = SOLIDS[table.name]
        total = len(order)
        filled = table.are_given(2, 2 + total)
        beyond = table.are_given(2 + total, max(table.width, 2 + total))
        numbers = table.integers(0, 2 + total)
        middle = filled[:, corners:]
        wrong = ~filled[:, :corners].all(axis=1) | beyond.any(axis=1)
        if wrong.any():
            at = np.flatnonzero(wrong)[0]
            raise InputError(
                f"{self.file}: {table.name} {numbers[at, 0]} has {int(filled[at].sum())} nodes; expected {corners} "
                f"corners, up to {total - corners} middle nodes, and nothing behind them"
            )
        # A middle node is left out by a blank field or a zero.
        full = (middle & (numbers[:, 2 + corners :] != 0)).any(axis=1)
        for kind, chosen, nodes in ((low, ~full, np.arange(corners)), (high, full, np.array(order))):
            if chosen.any():
                cards = numbers[chosen]
                # A property that is left blank has the number of the element.
                pid = np.where(cards[:, 1] == 0, cards[:, 0], cards[:, 1])
                self._pieces.setdefault(kind, []).append((cards[:, 0], pid, cards[:, 2:][:, nodes]))

    def __bool__(self) -> bool:
        return bool(self._pieces)

    def blocks(self) -> Iterator[tuple[str, Ints, Ints, Ints]]:
        """Type, labels, property ids and labels of grids of each type, 0 for middle nodes that are not there; what was
        added is given up.
        """
        for kind in list(self._pieces):
            ids, pids, nodes = (np.concatenate(part) for part in zip(*self._pieces.pop(kind), strict=True))
            yield kind, ids, pids, nodes
