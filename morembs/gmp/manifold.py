"""The manifold of static equilibria of a planar component between two turned frames, without axial force.

Its frames ``start`` and ``end`` lie on the chord, at the angles t1 and t2 to it; the end may slide along the chord,
so that its length is the natural one d0(t1, t2). Parameters t = (t1, t2); X(t) are the coordinates in the frame of
the chord (origin at the start). Global modal parameterisation: Bruels, Duysinx, Golinval (2007); Naets, Heirman,
Desmet (2012); the natural chord is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError, SolverError
from morembs.gmp.chebyshev import Table, points
from morembs.nonlinear.component import NonlinearComponent
from morembs.nonlinear.member import ends
from morembs.nonlinear.statics import Factor, newton

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_DIVISIONS = 6
# Largest correction of a guess per length of its step; a longer one may lead to another branch of equilibria.
_CORRECTION = 0.5
# Largest error of the derivatives of the tables; beyond it the grid misses what the equilibria do.
_COARSE = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class Equilibrium:
    """One point: coordinates ``X`` (N,), energy ``W`` (J), moments of the frames ``moments`` (2,) N m and
    ``modes`` (N, 2) = dX/dt, the constraint modes (implicit function theorem, no differences)."""

    X: Floats
    W: float
    moments: Floats
    modes: Floats


class Solver:
    """Equilibria of one component over (t1, t2)."""

    def __init__(self, component: NonlinearComponent) -> None:
        self.component = component
        self.length, _ = ends(component)
        self.first, self.second = component.frames["start"], component.frames["end"]
        self.turns = np.array([self.first[2], self.second[2]])
        held = np.concatenate((self.first, self.second[1:]))
        self.free = np.setdiff1d(np.arange(component.size), held)

    def _found(self, guess: Floats) -> Equilibrium:
        component, free = self.component, self.free
        X, factor = newton(component, guess, free)
        # Newton returns the factors of the last but one point; the modes need those of the last.
        K = component.tangent(X)
        factor = Factor(K[free][:, free])
        if factor.negative:
            raise SolverError(
                f"the equilibrium is not stable ({factor.negative} negative eigenvalue(s) of the tangent stiffness), "
                "a bifurcation was crossed"
            )
        if X[self.second[0]] <= 0.05 * self.length:
            raise SolverError("the ends of the component meet, its chord has no direction")
        modes = np.zeros((component.size, 2))
        modes[self.turns, [0, 1]] = 1
        modes[free] = -factor.solve((K[:, self.turns][free]).toarray())
        force = component.force(X)
        return Equilibrium(X=X, W=component.energy(X), moments=force[self.turns], modes=modes)

    def straight(self) -> Equilibrium:
        """The point t = 0."""
        try:
            return self._found(self.component.reference)
        except SolverError as error:
            raise InputError(f"the component is in no stable equilibrium without load: {error}") from None

    def toward(self, known: Equilibrium, t: Floats) -> Equilibrium:
        """From a known point to t (2,) by continuation; steps that fail are halved.

        Raises:
            InputError: the way crosses a bifurcation, or Newton's method fails even in small steps.
        """
        at, step, now = known.X[self.turns], 1.0, known
        done = 0.0
        while done < 1:
            goal = min(1.0, done + step)
            change = at + goal * (t - at) - now.X[self.turns]
            guess = now.X + now.modes @ change
            guess[self.turns] = at + goal * (t - at)
            try:
                found = self._found(guess)
                moved, corrected = (float(np.abs(found.X - other).max()) for other in (now.X, guess))
                if corrected > _CORRECTION * max(moved, 1e-9):
                    raise SolverError("Newton's method runs to other equilibria, far from the last one")
                now, done = found, goal
            except (SolverError, InputError) as error:
                step /= 2
                if step < 0.5**_DIVISIONS:
                    stuck = now.X[self.turns]
                    raise InputError(
                        f"the static equilibria cannot be followed to t1 = {t[0]:.4g}, t2 = {t[1]:.4g} rad, only to "
                        f"{stuck[0]:.4g}, {stuck[1]:.4g}: {error}. Take a smaller range, or divide the component "
                        "into more members"
                    ) from None
        return now


@dataclass(frozen=True, kw_only=True, eq=False)
class Manifold:
    """Equilibria at all points of a Chebyshev grid on |t1|, |t2| <= ``reach``.

    ``X`` (c, c, N), ``W`` (c, c), ``moments`` (c, c, 2), ``modes`` (c, c, N, 2); tables of X and of W.
    """

    reach: float
    X: Floats
    W: Floats
    moments: Floats
    modes: Floats
    shape: Table
    energy: Table

    def errors(self) -> tuple[float, float]:
        """Largest error, over the grid, of the derivatives of the tables: dX/dt against the constraint modes (per
        largest entry) and dW/dt against the moments of the frames (per largest moment)."""
        grid = points(self.reach, len(self.W))
        mode, moment = 0.0, 0.0
        for i, a in enumerate(grid):
            for j, b in enumerate(grid):
                t = np.array([a, b])
                mode = max(mode, float(np.abs(self.shape.at(t)[1].T - self.modes[i, j]).max()))
                moment = max(moment, float(np.abs(self.energy.at(t)[1] - self.moments[i, j]).max()))
        return mode / float(np.abs(self.modes).max()), moment / float(np.abs(self.moments).max())


def manifold(component: NonlinearComponent, *, reach: float, points_per_angle: int = 9) -> Manifold:
    """All equilibria on a grid, each by continuation from a neighbour that is nearer to the middle.

    Raises:
        InputError: a range that crosses a bifurcation or has no equilibrium, too few points, wrong frames.
    """
    grid, solver = points(reach, points_per_angle), Solver(component)
    if reach >= np.pi:
        raise InputError(f"a range of +-{reach} rad was given; expected less than pi")
    straight = solver.straight()
    found: dict[tuple[int, int], Equilibrium] = {}
    pairs = [(i, j) for i in range(len(grid)) for j in range(len(grid))]
    for i, j in sorted(pairs, key=lambda p: (max(abs(grid[p[0]]), abs(grid[p[1]])), p)):
        t = np.array([grid[i], grid[j]])
        near = min(found, key=lambda p: (np.hypot(grid[p[0]] - t[0], grid[p[1]] - t[1]), p), default=None)
        origin = straight if near is None else found[near]
        found[i, j] = solver.toward(origin, t)
    c = len(grid)

    def grown(name: str) -> Floats:
        return np.array([[getattr(found[i, j], name) for j in range(c)] for i in range(c)])

    X, W = grown("X"), grown("W")
    made = Manifold(
        reach=reach, X=X, W=W, moments=grown("moments"), modes=grown("modes"),
        shape=Table.through(reach, X), energy=Table.through(reach, W, curved=True),
    )  # fmt: skip
    worst = max(made.errors())
    if worst > _COARSE:
        raise InputError(
            f"tables of {points_per_angle} points per angle on +-{reach:g} rad miss the reactions or the motion of the "
            f"component by {worst:.2g}; expected at most {_COARSE}. Take more points or a smaller range"
        )
    return made
