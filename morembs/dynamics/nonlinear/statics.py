"""Static equilibrium of nonlinear components by Newton's method, with continuation in the load or in held motions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs.base.arguments import checked
from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.dynamics.nonlinear.tolerances import TOL


class Factor:
    """Factors of a symmetric sparse matrix; ``negative`` counts its negative eigenvalues (Sylvester's law)."""

    def __init__(self, K: sp.spmatrix) -> None:
        try:
            self._lu = spl.splu(
                sp.csc_matrix(K), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            raise SolverError(f"the tangent stiffness of the interior is singular ({error})") from None
        if np.array_equal(self._lu.perm_r, self._lu.perm_c):
            self.negative = int(np.sum(self._lu.U.diagonal() < 0))
        else:  # a row was exchanged, so the signs of the pivots say nothing
            self.negative = int(np.sum(np.linalg.eigvalsh(K.toarray()) < 0))

    def solve(self, right: Floats) -> Floats:
        return np.asarray(self._lu.solve(np.ascontiguousarray(right)))


def newton(
    component: NonlinearComponent,
    x: Floats,
    free: Ints,
    load: Floats | None = None,
    *,
    tolerance: float = TOL.static_step,
) -> tuple[Floats, Factor]:
    """Equilibrium f(x) = load on the ``free`` coordinates, from x (N,) on; the others stay.

    Ends when the last step is below ``tolerance`` of the size of the component (rotations: of 1 rad). Returns x and
    the factors of the tangent there.

    Raises:
        SolverError: no convergence, a singular tangent.
    """
    x = np.array(x)
    scale = max(1.0, float(np.abs(component.reference).max()))
    size, last = np.inf, np.inf
    for _ in range(TOL.static_iterations):
        residual = component.force(x) if load is None else component.force(x) - load
        factor = Factor(component.tangent(x)[free][:, free])
        step = -factor.solve(residual[free])
        size = float(np.abs(step).max(initial=0.0))
        if not np.isfinite(size) or size > 1e3 * scale:
            break
        x[free] += step
        # Close to the end Newton's steps fall to round-off at once; what then no longer falls is round-off.
        if size <= tolerance * scale or (size < 1e-8 * scale and size > 0.1 * last):
            return x, factor
        last = size
    raise SolverError(f"Newton's method does not converge (last step {size:.2g} in m and rad)")


@checked
def equilibrium(
    component: NonlinearComponent,
    *,
    held: Ints,
    load: Floats | None = None,
    motion: Floats | None = None,
    x: Floats | None = None,
    steps: int = 10,
) -> Floats:
    """Coordinates (N,) in equilibrium under a dead ``load`` (N,) with ``held`` coordinates moved by ``motion``.

    Load and motion grow together from ``x`` (by default the reference) in ``steps``; a step that does not converge
    is halved.

    Args:
        component: the nonlinear component.
        held: numbers of the prescribed coordinates.
        load: (N,) in N and Nm, zero by default.
        motion: values of ``held``, in m and rad, zero by default.
        x: (N,) start, by default the reference.
        steps: number of load steps.

    Raises:
        InputError: wrong shapes, no equilibrium or only an unstable one on the way.
    """
    start = component.reference if x is None else np.array(x, dtype=float)
    held = np.asarray(held, dtype=np.int64)
    force = np.zeros(component.size) if load is None else np.asarray(load, dtype=float)
    shift = np.zeros(len(held)) if motion is None else np.asarray(motion, dtype=float)
    if force.shape != (component.size,) or shift.shape != held.shape or start.shape != (component.size,):
        raise InputError(
            f"load {force.shape}, motion {shift.shape}, x {start.shape} were given; expected ({component.size},), "
            f"{held.shape}, ({component.size},)",
            keyword="load",
        )
    if steps < 1 or not (np.isfinite(force).all() and np.isfinite(shift).all()):
        raise InputError("load, motion and steps of an equilibrium: expected finite numbers and at least one step")
    free = np.setdiff1d(np.arange(component.size), held)

    def solve_step(at: Floats, before: float, now: float) -> Floats:
        moved = np.array(at)
        moved[held] = start[held] + now * shift
        state, factor = newton(component, moved, free, now * force)
        if factor.negative:
            raise SolverError("the equilibrium is not stable, the load is beyond that of buckling")
        return state

    return follow(solve_step, start, 1 / steps, "the load")


def follow(solved: Callable[[Floats, float, float], Floats], x: Floats, step: float, what: str) -> Floats:
    """Follows ``solved(x, before, now)`` from 0 to 1, with smaller steps where it fails.

    Raises:
        InputError: not even the smallest step converges.
    """
    at, smallest = 0.0, step * TOL.least_static_load_step
    while at < 1:
        now = min(1.0, at + step)
        if now > 1 - TOL.negligible_step:
            now = 1.0
        try:
            x, at = solved(x, at, now), now
        except SolverError as error:
            step /= 4
            if step < smallest:
                raise error.restate(
                    f"no equilibrium beyond {at:.3g} of {what}: {error}. Take a smaller one, or more support; "
                    "a limit point or a bifurcation may lie there"
                ) from None
    return x
