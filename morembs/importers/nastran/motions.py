"""Motions of grids along their own axes, and equations between them: as they are given, or of one rigid body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import qr

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.constraints import Equations, solved_for_first
from morembs.importers.nastran.cards import integer
from morembs.importers.nastran.geometry import Grids, Systems
from morembs.importers.tolerances import TOL

# A component of a grid along its own axes: row of the grid, 0 to 5.
Motion = tuple[int, int]


def components(text: str, what: str) -> tuple[int, ...]:
    """Components 0 to 5 of digits 1 to 6; blanks between them do not count."""
    text = text.replace(" ", "")
    if not text or not set(text) <= set("123456"):
        raise InputError(f"{what}: {text!r} was given as components; expected digits of 1 to 6")
    return tuple(sorted({int(digit) - 1 for digit in text}))


class Motions:
    """Reads grids with components, and makes equations of them."""

    def __init__(self, grids: Grids, systems: Systems) -> None:
        self.grids, self.systems = grids, systems

    def row(self, text: str, what: str) -> int:
        return int(self.rows([integer(text, what)], what)[0])

    def rows(self, labels: list[int], what: str) -> Ints:
        return self.grids.rows(np.array(labels, dtype=np.int64), what)

    def direction(self, motion: Motion) -> Floats:
        return self.systems.direction(*motion, self.grids)

    def pairs(self, words: list[str], what: str) -> list[Motion]:
        if len(words) % 2:
            raise InputError(f"{what} names a grid without components; expected pairs of them")
        return [
            (self.row(label, what), c)
            for label, text in zip(words[::2], words[1::2], strict=True)
            for c in components(text, what)
        ]

    def rigid_motion(self, motions: Sequence[Motion], x: Floats) -> Floats:
        """Parts (k, 6) of rigid motion about ``x`` in the motions of grids."""
        R = np.array([self.direction(motion) for motion in motions])
        arms = np.array([self.grids.xyz[row] - x for row, _ in motions])
        R[:, 3:] += np.cross(arms, R[:, :3])
        return R

    def rigid_equations(self, what: str, independent: Sequence[Motion], dependent: Sequence[Motion]) -> Equations:
        """Dependent motions of one rigid body, whose six independent ones determine it."""
        if len(independent) != 6 or not dependent or set(independent) & set(dependent):
            raise InputError(
                f"{what} has {len(independent)} independent and {len(dependent)} dependent components; expected six "
                "independent ones, and others that depend on them",
                kind="model",
            )
        x = self.grids.xyz[independent[0][0]]
        R = self.rigid_motion([*independent, *dependent], x)
        rows = [row for row, _ in (*independent, *dependent)]
        size = max(float(np.abs(self.grids.xyz[rows] - x).max()), TOL.least_size)
        scaled = R[:6] / np.array([1.0, 1.0, 1.0, size, size, size])
        if not np.linalg.cond(scaled) < TOL.undetermined_condition:
            raise InputError(
                f"{what}: its independent components do not determine rigid motion; check them", kind="model"
            )
        T = np.linalg.solve(R[:6].T, R[6:].T).T
        return self.solve(what, np.hstack([-T, np.eye(len(dependent))]), [*independent, *dependent], dependent)

    def solve(self, what: str, A: Floats, motions: Sequence[Motion], dependent: Sequence[Motion]) -> Equations:
        """A u = 0 of motions of grids, solved for as many components of the ``dependent`` ones along the basic axes."""
        parts: dict[Motion, Floats] = {}
        for column, motion in zip(A.T, motions, strict=True):
            direction = self.direction(motion)
            for c in np.flatnonzero(np.abs(direction) > TOL.no_part).tolist():
                key = motion[0], c
                parts[key] = parts.get(key, np.zeros(len(A))) + direction[c] * column
        led = [(motion[0], self.direction(motion)) for motion in dependent]
        candidates = {(row, c) for row, part in led for c in np.flatnonzero(np.abs(part) > TOL.no_part).tolist()}
        keys = sorted(parts, key=lambda key: key not in candidates)
        B, count = np.array([parts[key] for key in keys]).T, sum(key in candidates for key in keys)
        # Pivots that are along the axes as given come first, so that plain cards keep their own dependent components.
        _, r, order = qr(B[:, :count], mode="economic", pivoting=True)
        pivots = np.abs(np.diag(r))
        if len(pivots) < len(B) or not pivots[len(B) - 1] > TOL.dependent_pivot * pivots[0]:
            raise InputError(
                f"{what}: its dependent components do not follow from the others; check them", kind="unsupported"
            )
        chosen = order[: len(B)].tolist()
        B = np.linalg.solve(B[:, chosen], B)
        rest = [i for i in range(len(keys)) if i not in set(chosen)]
        tiny = TOL.no_part * np.abs(B).max()
        sums = []
        for line, lead in zip(B, chosen, strict=True):
            terms = [(*keys[lead], 1.0)]
            terms += [(*keys[i], float(line[i])) for i in rest if abs(line[i]) > tiny]
            sums.append((what, terms))
        return solved_for_first(what.rpartition(": ")[2], sums)
