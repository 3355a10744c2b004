"""Static equilibria of a solid member between two turned frames in the plane, as ``manifold`` has them for beams.

The rigid interfaces ``start`` (at the origin) and ``end`` (on the x axis) lie on the chord, turned about z by t1 and
t2; the end may slide along the chord, which has its natural length then. One symbolic analysis serves all tangents.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs.base.closing import Closing
from morembs.base.errors import BudgetError, InputError, SolverError
from morembs.base.types import Floats
from morembs.dynamics.gmp.equilibria import NotFollowedError, first_share
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.continuation import Newton, Tangents
from morembs.dynamics.nonlinear.solid import NonlinearSolid
from morembs.linalg.columns import fix_signs
from morembs.linalg.sparse.solver import LinearSolver


@dataclass(frozen=True, kw_only=True, eq=False)
class SolidEquilibrium:
    """Coordinates ``X`` (N,), energy ``W`` (J), moments (2,) of the frames about z (N m), ``modes`` (N, 2) = dX/dt
    (implicit function theorem) and the tangent ``K`` (N, N) there."""

    X: Floats
    W: float
    moments: Floats
    modes: Floats
    K: sp.csr_array


class SolidEquilibria(Closing):
    """Equilibria of one solid over t = (t1, t2); a context manager.

    Raises:
        InputError: other rigid interfaces than ``start`` and ``end``, or not at the origin and on the x axis.
    """

    def __init__(self, solid: NonlinearSolid, solver: LinearSolver | None = None) -> None:
        rigid = sorted(name for name, i in solid.interfaces.items() if i.kind.carries)
        if rigid != ["end", "start"]:
            raise InputError(
                f"the solid has the rigid interfaces {rigid}; expected 'start' and 'end'",
                kind="missing",
                keyword="interfaces",
            )
        self.solid, self.first, self.second = solid, solid.frames["start"], solid.frames["end"]
        a, b = solid.reference[self.first[:3]], solid.reference[self.second[:3]]
        self.length = float(b[0])
        if self.length <= 0 or np.abs(np.concatenate((a, b[1:]))).max() > TOL.off_axis * self.length:
            raise InputError(
                f"the interfaces start and end are at {a} and {b}; expected the origin and a point on the x axis. Turn "
                "and shift the mesh",
                keyword="interfaces",
            )
        self.turns = np.array([self.first[5], self.second[5]])
        self.held = np.concatenate((self.first, self.second[1:]))
        self.free = np.setdiff1d(np.arange(solid.size), self.held)
        self.tangents = Tangents(self.free, solver)
        self._newton = Newton(
            solid, self.tangents, self.held, lambda x: np.zeros(solid.size), TOL.solid_newton_step, True
        )
        self._solver = solver

    def __reduce__(self) -> tuple[Callable[..., SolidEquilibria], tuple[NonlinearSolid, LinearSolver | None]]:
        return _elsewhere, (self.solid, self._solver)

    def close(self) -> None:
        """Release the factors."""
        self.tangents.close()

    def _settle(self, guess: Floats, resultants: Floats | None) -> SolidEquilibrium:
        X = self._newton.equilibrium(guess, np.zeros(len(self.held)), 1.0, resultants)
        if X[self.second[0]] <= TOL.least_chord * self.length:
            raise SolverError("the ends of the component meet, its chord has no direction")
        K = self.solid.tangent(X)
        modes = np.zeros((self.solid.size, 2))
        modes[self.turns, [0, 1]] = 1
        # K is symmetric: its rows are its columns.
        modes[self.free] = -self.tangents.factor(K).solve(K[self.turns].toarray().T[self.free])
        force = self.solid.force(X)
        return SolidEquilibrium(X=X, W=self.solid.energy(X), moments=force[self.turns], modes=modes, K=K)

    def straight(self) -> SolidEquilibrium:
        """The point t = 0."""
        try:
            return self._settle(self.solid.reference, None)
        except BudgetError:
            raise
        except SolverError as error:
            raise error.restate(f"the component is in no stable equilibrium without load: {error}") from None

    def toward(self, X: Floats, modes: Floats, t: Floats) -> SolidEquilibrium:
        """From a known point to t (2,) by continuation; steps that fail are halved.

        Raises:
            NotFollowedError: the way crosses a bifurcation, or Newton's method fails even in small steps.
        """
        at, done = X[self.turns], 0.0
        share = longest = first_share(t - at)
        now: SolidEquilibrium | None = None
        while True:
            goal = done + share if done + share < 1 - TOL.negligible_step else 1.0
            step = modes @ (at + goal * (t - at) - X[self.turns])
            try:
                now = self._settle(X + step, self.solid.resultants_after(X, step))
            except BudgetError:
                raise
            except SolverError as error:
                share /= 2
                if share < longest * 0.5**TOL.step_halvings:
                    raise NotFollowedError(
                        f"the static equilibria cannot be followed to t1 = {t[0]:.4g}, t2 = {t[1]:.4g} rad, only to "
                        f"{X[self.turns[0]]:.4g}, {X[self.turns[1]]:.4g} ({done:.2g} of the way): {error}. Take a "
                        "smaller range, or divide the component into more members",
                        X[self.turns],
                    ) from None
                continue
            if goal >= 1:
                return now
            X, modes, done = now.X, now.modes, goal


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneModes:
    """``Psi`` (N, m), zero at the frames; ``squares`` (m,) = Psi' K Psi, the mass along y is one."""

    Psi: Floats
    squares: Floats


def plane_bending_modes(solid: NonlinearSolid, count: int, solver: LinearSolver | None = None) -> PlaneModes:
    """The lowest ``count`` modes of bending along y between held frames, with inertia along y only.

    Without the inertia across the plane the two bendings of a square section have no common frequency, so that they
    do not mix; the modes are shapes, and callers take their whole mass.

    Raises:
        InputError: the solid has fewer, or is not stable without load.
    """
    held = np.concatenate([solid.frames["start"], solid.frames["end"]])
    free = np.setdiff1d(np.arange(solid.size), held)
    if count < 0 or 2 * count + 8 > len(free) // 3:
        raise InputError(
            f"{count} modes were given; expected zero or more, and fewer than the solid can show", keyword="modes"
        )
    if not count:
        return PlaneModes(Psi=np.zeros((solid.size, 0)), squares=np.zeros(0))
    K = solid.tangent(solid.reference)
    sides = [sp.diags_array(np.isin(free, solid.translations[:, axis]).astype(float)) for axis in (1, 2)]
    M = sp.csr_array(solid.M)[free][:, free]
    along, across = (sp.csc_array(side @ M @ side) for side in sides)
    with Tangents(free, solver) as tangents:
        factor = tangents.factor(K)
        if factor.negative_pivots():
            raise InputError("the component is not stable without load; expected a stable reference", kind="model")
        # Inertia over stiffness, which is definite; that of a slender solid falls fast, so that few vectors do.
        tried = 2 * count + 4
        inverse = spl.LinearOperator((len(free),) * 2, matvec=factor.solve)
        start = factor.solve(along @ np.random.default_rng(7).standard_normal(len(free)))
        flexible, shapes = spl.eigsh(along, tried, K[free][:, free].tocsc(), Minv=inverse, which="LA", v0=start)
    shown = flexible > TOL.no_flexibility * flexible.max()
    omega_squared, shapes = 1 / flexible[shown][::-1], shapes[:, shown][:, ::-1]
    shapes = shapes / np.sqrt(np.einsum("ik,ik->k", shapes, along @ shapes))
    bending = np.flatnonzero(np.einsum("ik,ik->k", shapes, across @ shapes) < TOL.out_of_plane_share)[:count]
    if len(bending) < count:
        raise InputError(
            f"{count} modes were given; only {len(bending)} of bending in the plane were found among {tried}"
        )
    Psi = np.zeros((solid.size, count))
    Psi[free] = shapes[:, bending]
    return PlaneModes(Psi=fix_signs(Psi), squares=omega_squared[bending])


def stretch(solid: NonlinearSolid, length: float, solver: LinearSolver | None = None) -> Floats:
    """Linear displacement (N,) of the straight solid, its end moved by ``length`` along x and not turned."""
    first, second = solid.frames["start"], solid.frames["end"]
    free = np.setdiff1d(np.arange(solid.size), np.concatenate((first, second)))
    K, shape = solid.tangent(solid.reference), np.zeros(solid.size)
    shape[second[0]] = length
    with Tangents(free, solver) as tangents:
        shape[free] = -tangents.factor(K).solve(K[free] @ shape)
    return shape


def _elsewhere(solid: NonlinearSolid, solver: LinearSolver | None) -> SolidEquilibria:
    """The same in another process, with an analysis of its own that the first tangent sets here as there."""
    equilibria = SolidEquilibria(solid, solver)
    equilibria.straight()
    return equilibria
