"""Static equilibria of large nonlinear components: Newton's method and continuation with the solvers of morembs.linalg.

One symbolic analysis serves all tangents of a component. ``statics`` does the same for planar components of a few
hundred coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import checked
from morembs.base.closing import Closing
from morembs.base.errors import BudgetError, InputError, SingularMatrixError, SolverError
from morembs.base.limits import Positive, PositiveCount
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.tolerances import TOL
from morembs.linalg.sparse.cost import Forecast
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import Analysis, Factorization, LinearSolver

Load = Floats | Callable[[Floats], Floats]


class Conservative(Protocol):
    """What statics needs of a component: an energy with its first two derivatives, and names of frames.

    A component with rotation vectors may have ``shorten_rotations(x, held)``, the same configuration by vectors below
    half a turn, but for those with a held coordinate; one that can be in an impossible state ``examine(x)``, which
    raises SolverError.
    The geometric part of the tangent takes the stress of the last linear step, as a formulation with stress
    as unknowns does: Newton's method then does not see the false stretch of large turns (Magisano, Leonetti,
    Garcea 2017).
    """

    @property
    def size(self) -> int:
        """Number N of coordinates."""

    @property
    def frames(self) -> Mapping[str, Ints]:
        """Interfaces: numbers of their coordinates."""

    @property
    def reference(self) -> Floats:
        """Coordinates (N,) without load."""

    def energy(self, x: Floats) -> float:
        """Strain energy in J."""

    def force(self, x: Floats) -> Floats:
        """Its first derivative (N,)."""

    def tangent(self, x: Floats, resultants: Floats | None = None) -> sp.csr_matrix:
        """Its second derivative (N, N), with one pattern for all x; for other ``resultants`` in the geometric part."""

    def resultants_after(self, x: Floats, step: Floats) -> Floats:
        """Stress at x plus its linear change by a ``step`` (N,)."""


class Tangents(Closing):
    """Factors of the tangent between ``free`` coordinates; a context manager. One factor lives at a time."""

    def __init__(self, free: Ints, solver: LinearSolver | None = None) -> None:
        self.free, self.solver = free, solver if solver is not None else select_solver()
        self.count = 0
        self._analysis: Analysis | None = None

    def close(self) -> None:
        """Release the analysis and its factor."""
        if self._analysis is not None:
            self._analysis.close()

    @property
    def forecast(self) -> Forecast:
        """What a factor takes, after the first one.

        Raises:
            SolverError: there was none.
        """
        if self._analysis is None:
            raise SolverError("no tangent was factorised yet")
        return self._analysis.forecast

    def factor(self, K: sp.csr_matrix) -> Factorization:
        """Factor of the free part of K (N, N).

        Raises:
            SolverError: it is singular or not finite.
        """
        A = sp.csr_array(K[self.free][:, self.free])
        A.sum_duplicates()
        if not np.isfinite(A.data).all():
            raise SolverError("the tangent stiffness is not finite")
        try:
            if self._analysis is None:
                self._analysis = self.solver.analyse(A, "symmetric", "the tangent stiffness")
            self.count += 1
            return self._analysis.factorize(A, "the tangent stiffness")
        except SingularMatrixError as error:
            raise SolverError(str(error)) from None


@dataclass(frozen=True, kw_only=True, eq=False)
class EquilibriumPath:
    """Coordinates ``x`` (N,) in equilibrium, ``reaction`` (h,) on the held ones (what the support exerts), numbers of
    load steps and of factorisations."""

    x: Floats
    reaction: Floats
    steps: int
    factorisations: int


@checked
def follow_equilibrium(
    component: Conservative,
    *,
    held: Ints,
    load: Load | None = None,
    motion: Floats | None = None,
    x: Floats | None = None,
    steps: PositiveCount = 10,
    tolerance: Positive = TOL.newton_step,
    stable: bool = True,
    solver: LinearSolver | None = None,
) -> EquilibriumPath:
    """Equilibrium under a ``load`` with the ``held`` coordinates moved by ``motion`` (h,).

    Args:
        load: (N,) or a function of x that gives it. The tangent leaves out how a load changes with x, so that Newton's
            method converges linearly then. Moments on rotation vectors are such loads (``SpatialBeam.moment``).
        x: a configuration in equilibrium without load, by default the reference.
        steps: load steps at most of this share; steps that fail are divided and grow again.
        tolerance: last Newton step per size of the component, or rad.
        stable: refuse equilibria at which the tangent has a negative eigenvalue. Take False for moments on rotation
            vectors, which have no potential, so that the tangent of the component alone does not tell.

    Raises:
        InputError: wrong shapes; no equilibrium, or an unstable one, with the share of the load that was reached.
        BudgetError: the memory of the solver is too small.
    """
    start, held, shift, force = _check_input(component, held, load, motion, x)
    free = np.setdiff1d(np.arange(component.size), held)
    with Tangents(free, solver) as tangents:
        newton = Newton(component, tangents, held, force, tolerance, stable)
        at, done, taken = _canonical(component, start, held), 0.0, 0
        share = 1.0 / steps
        while done < 1:
            goal = min(1.0, done + share) if done + share < 1 - TOL.negligible_step else 1.0
            try:
                at = newton.equilibrium(at, (goal - done) * shift, goal)
            except BudgetError:
                raise
            except SolverError as error:
                share /= 4
                if share < TOL.least_load_step / steps:
                    raise error.restate(
                        f"no equilibrium beyond {done:.3g} of the load: {error}. Take a smaller load, or more support; "
                        "a limit point or a bifurcation may lie there"
                    ) from None
                continue
            done, taken = goal, taken + 1
            share = min(share * TOL.load_step_growth, 1.0 / steps)
        return EquilibriumPath(
            x=at, reaction=(component.force(at) - force(at))[held], steps=taken, factorisations=tangents.count
        )


def _check_input(
    component: Conservative, held: Ints, load: Load | None, motion: Floats | None, x: Floats | None
) -> tuple[Floats, Ints, Floats, Callable[[Floats], Floats]]:
    start = component.reference if x is None else np.array(x, dtype=float)
    held = np.asarray(held, dtype=np.int64)
    shift = np.zeros(len(held)) if motion is None else np.asarray(motion, dtype=float)
    if start.shape != (component.size,) or shift.shape != held.shape or not np.isfinite(shift).all():
        raise InputError(
            f"x {start.shape} and motion {shift.shape} were given; expected finite numbers, ({component.size},) and "
            f"{held.shape}"
        )
    inside = np.isin(held, np.arange(component.size)).all()
    if not inside or len(np.unique(held)) < len(held):
        raise InputError(f"held coordinates: expected different numbers from 0 to {component.size - 1}")
    return start, held, shift, _load(component, load)


def _load(component: Conservative, load: Load | None) -> Callable[[Floats], Floats]:
    if callable(load):
        return load
    constant = np.zeros(component.size) if load is None else np.asarray(load, dtype=float)
    if constant.shape != (component.size,) or not np.isfinite(constant).all():
        raise InputError(
            f"a load of shape {constant.shape} was given; expected ({component.size},) finite numbers", keyword="load"
        )
    return lambda x: constant


def _canonical(component: Conservative, x: Floats, held: Ints) -> Floats:
    """Shortened rotation vectors, where the component has any."""
    shorter = getattr(component, "shorten_rotations", None)
    return x if shorter is None else np.asarray(shorter(x, held), dtype=float)


class Newton:
    """Newton's method on the free coordinates of ``tangents``; ``load`` is a function of x (N,)."""

    def __init__(
        self,
        component: Conservative,
        tangents: Tangents,
        held: Ints,
        load: Callable[[Floats], Floats],
        tolerance: float,
        stable: bool,
    ) -> None:
        self.component, self.tangents, self.held, self.load = component, tangents, held, load
        self.tolerance, self.stable = tolerance, stable
        self.scale = max(TOL.tiny, float(np.ptp(component.reference)))

    def equilibrium(self, x: Floats, move: Floats, share: float, resultants: Floats | None = None) -> Floats:
        """Equilibrium near x under a ``share`` of the load, the held coordinates moved by ``move`` in the first, linear
        step; ``resultants`` where x comes from a linear step, see ``Conservative``.

        Raises:
            SolverError: no convergence, a singular tangent, an unstable or impossible equilibrium.
        """
        component, free = self.component, self.tangents.free
        x, last = np.array(x), np.inf
        change = np.zeros(component.size)
        for iteration in range(TOL.newton_iterations):
            K = component.tangent(x, resultants)
            residual = (component.force(x) - share * self.load(x))[free]
            if iteration == 0 and move.any():
                residual += K[free][:, self.held] @ move
                change[self.held] = move
            elif iteration == 1:
                change[self.held] = 0.0
            factor = self.tangents.factor(K)
            step = -factor.solve(residual)
            size = float(np.abs(step).max(initial=0.0))
            if not np.isfinite(size) or size > 1e3 * self.scale:
                break
            change[free] = step
            resultants = component.resultants_after(x, change)
            x = _canonical(component, x + change, self.held)
            # Once steps are small they fall to round-off at once; what then no longer falls is round-off.
            if (iteration or not move.any()) and (
                size <= self.tolerance * self.scale
                or (size < TOL.stalled_step * self.scale and size > TOL.stalled_ratio * last)
            ):
                if self.stable and factor.negative_pivots():
                    raise SolverError("the equilibrium is not stable, the load is beyond that of buckling")
                examine = getattr(component, "examine", None)
                if examine is not None:
                    examine(x)
                return x
            last = size
        raise SolverError(f"Newton's method does not converge (last step {last:.2g} in m and rad)")
