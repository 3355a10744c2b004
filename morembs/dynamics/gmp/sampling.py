"""Equilibria of beams and solids on grids of end angles: which others they are followed from, and how well grids do.

Every equilibrium is followed from the nearest of those found before its batch, so that neither the number of processes
nor a restart changes anything. A grid is measured at points of the next one, which holds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any, Protocol

import numpy as np

from morembs.base import progress
from morembs.base.types import Floats
from morembs.base.worker_pool import WorkerPool
from morembs.dynamics.gmp.chebyshev import ChebyshevTable
from morembs.dynamics.gmp.checkpoint import Checkpoint
from morembs.dynamics.gmp.envelope import Loaded
from morembs.dynamics.gmp.equilibria import Equilibrium, NotFollowedError
from morembs.dynamics.gmp.symmetry import Shaped, Symmetry

# t = reach sin(pi fraction), for both angles.
Key = tuple[Fraction, Fraction]


class TabulatedMember(Loaded, Protocol):
    """A component at work. ``turns`` (2,) are the coordinates of the end angles, ``length`` that of its chord.

    Processes get it by pickle: nothing of a sparse solver is shared.
    """

    turns: Any
    length: float

    @property
    def component(self) -> Shaped: ...

    def straight(self) -> Equilibrium: ...

    def toward(self, X: Floats, modes: Floats, t: Floats) -> Equilibrium:
        """From a known equilibrium to the end angles t (2,); raises NotFollowedError."""

    def sample(self, equilibrium: Equilibrium) -> Any:
        """What the tables hold at an equilibrium."""

    def energy(self, x: Floats) -> float: ...


def places(count: int) -> list[Fraction]:
    """Fractions of the ``count`` Chebyshev points in rising order."""
    return [Fraction(2 * k - (count - 1), 2 * (count - 1)) for k in range(count)]


def grid(count: int) -> list[Key]:
    """All points of a grid, row by row."""
    return [(a, b) for a in places(count) for b in places(count)]


def between(count: int) -> list[Key]:
    """Points of the next grid at which one of ``count`` points is measured: cells at corners, edges and the middle."""
    finer = places(2 * count - 1)
    chosen = [finer[k] for k in sorted({1, count - 2, count, 2 * count - 3})]
    return [(a, b) for a in chosen for b in chosen]


def shells(count: int) -> list[list[Key]]:
    """The points of a grid in batches from the middle outwards."""
    rings: dict[Fraction, list[Key]] = {}
    for key in grid(count):
        rings.setdefault(max(abs(key[0]), abs(key[1])), []).append(key)
    return [rings[ring] for ring in sorted(rings)]


def _follow_task(work: TabulatedMember, task: tuple[Floats, Floats, Floats]) -> Equilibrium | NotFollowedError:
    """A failure is a result, so that a batch has the same first one whichever comes first."""
    try:
        return work.toward(*task)
    except NotFollowedError as error:
        return error


def _sample(work: TabulatedMember, equilibrium: Equilibrium) -> Any:
    return work.sample(equilibrium)


class Sampling:
    """Equilibria of one range, found so far."""

    def __init__(
        self, work: TabulatedMember, pool: WorkerPool, group: Sequence[Symmetry], reach: float, store: Checkpoint | None
    ) -> None:
        self.work, self.pool, self.group, self.reach = work, pool, group, reach
        self.store = store
        self.equilibria: dict[Key, Equilibrium] = {}
        self.samples: dict[Key, Any] = {}
        self.solved = self.restored = 0

    def angles(self, key: Key) -> Floats:
        """t (2,)."""
        return np.array([self.reach * np.sin(np.pi * part.numerator / part.denominator) for part in key])

    def _image(self, symmetry: Symmetry, key: Key) -> Key:
        (a, b), (c, d) = symmetry.turn.tolist()
        return a * key[0] + b * key[1], c * key[0] + d * key[1]

    def ensure(self, keys: Iterable[Key]) -> None:
        """Finds the equilibria of all ``keys``; an equilibrium that is symmetric to another one follows from it.

        Raises:
            NotFollowedError: a range that crosses a bifurcation or has no equilibrium.
        """
        middle = (Fraction(0), Fraction(0))
        if middle not in self.equilibria:
            self.equilibria[middle] = self.work.straight()
        before = {key: self.angles(key) for key in self.equilibria}
        wanted: list[Key] = []
        for key in keys:
            best = max([key, *(self._image(symmetry, key) for symmetry in self.group)])
            if best not in self.equilibria and best not in wanted:
                wanted.append(best)
        new = {key: self._restore(key) for key in wanted}
        open_ = [key for key in wanted if new[key] is None]
        tasks = []
        for key in open_:
            t = self.angles(key)
            near = self.equilibria[min(before, key=lambda p: (round(float(np.hypot(*(before[p] - t))), 12), p))]
            tasks.append((near.X, near.modes, t))
        failures: dict[int, NotFollowedError] = {}
        for number, solution in self.pool.as_ended(_follow_task, tasks):
            if isinstance(solution, NotFollowedError):
                failures[number] = solution
                if self.pool.workers == 1:
                    break
                continue
            new[open_[number]], self.solved = solution, self.solved + 1
            progress.update(f"equilibria: {self.solved + self.restored}")
            if self.store is not None:
                self.store.add(_numbers(open_[number]), **vars(solution))
        if failures:
            raise failures[min(failures)]
        for key, solution in new.items():
            if solution is not None:
                self._take(key, solution)

    def _restore(self, key: Key) -> Equilibrium | None:
        values = None if self.store is None else self.store.equilibria.get(_numbers(key))
        if values is None:
            return None
        self.restored += 1
        return Equilibrium(X=values["X"], W=float(values["W"]), moments=values["moments"], modes=values["modes"])

    def _take(self, key: Key, solution: Equilibrium) -> None:
        self.equilibria[key] = solution
        for g in self.group:
            image = self._image(g, key)
            if image not in self.equilibria:
                self.equilibria[image] = Equilibrium(
                    X=g.move(solution.X), W=solution.W, moments=g.turn @ solution.moments, modes=g.modes(solution.modes)
                )

    def sample(self, keys: Sequence[Key]) -> list[Any]:
        """Samples at equilibria."""
        missing = [key for key in keys if key not in self.samples]
        for number, sample in self.pool.as_ended(_sample, [self.equilibria[key] for key in missing]):
            self.samples[missing[number]] = sample
        return [self.samples[key] for key in keys]

    def errors(self, count: int) -> dict[str, float]:
        """Of tables of ``count`` points, each quantity per its largest: at points between, and of derivatives."""
        inside, outside = grid(count), between(count)
        samples, checks = self.sample(inside), self.sample(outside)
        equilibria = [self.equilibria[key] for key in inside]

        def through(values: Sequence[Any]) -> ChebyshevTable:
            array = np.array(values)
            return ChebyshevTable.through(self.reach, array.reshape(count, count, *array.shape[1:]))

        straight = self.equilibria[Fraction(0), Fraction(0)].X
        X, W = through([s.X - straight for s in equilibria]), through([s.W for s in equilibria])
        laws = {
            name: through([getattr(s, name)[: len(s.H)] if name == "c" else getattr(s, name) for s in samples])
            for name in ("k", "c", "H")
        }
        worst = dict.fromkeys(("shapes", "modes", "energy", "moments", "k", "c", "H"), 0.0)
        sizes = dict.fromkeys(worst, 0.0)

        def record(name: str, value: Any, exact: Any) -> None:
            worst[name] = max(worst[name], float(np.abs(value - exact).max(initial=0.0)))
            sizes[name] = max(sizes[name], float(np.abs(exact).max(initial=0.0)))

        for key in (*inside, *outside):
            t, solution = self.angles(key), self.equilibria[key]
            shape, energy = X.at(t), W.at(t)
            for name, value, exact in (
                ("shapes", shape[0], solution.X - straight),
                ("modes", shape[1].T, solution.modes),
                ("energy", energy[0], solution.W),
                ("moments", energy[1], solution.moments),
            ):
                record(name, value, exact)
        for key, sample in zip(outside, checks, strict=True):
            for name, table in laws.items():
                exact = getattr(sample, name)
                record(name, table.at(self.angles(key))[0], exact[: len(sample.H)] if name == "c" else exact)
        return {name: worst[name] / sizes[name] if sizes[name] else 0.0 for name in worst}


def _numbers(key: Key) -> tuple[int, int, int, int]:
    a, b = key
    return a.numerator, a.denominator, b.numerator, b.denominator
