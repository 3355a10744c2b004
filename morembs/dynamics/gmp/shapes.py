"""Shapes and energy of a reduced planar member in the frame of its chord, as tables over its end angles t.

u = X(t) + A(t) eps + Psi eta,   eps = d / d0(t) - 1,
V = W(t) + k(t)/2 e^2 + eta' Lambda eta / 2,   e = eps + c(t)' eta + eta' H(t) eta / 2:

e is the mean strain along the member. It enters as one square, so that V is bounded below; c is how modes stretch
the bent shape, H how they stretch any shape, which is tension stiffening. Four formulations:

- linear: X linear in t, no c and H: the floating frame with component modes in the frame of the chord;
- foreshortened: X to second order by static derivatives, c to first, H at the reference; no nonlinear solves;
- membrane: X from the manifold, c and H from the geometry of the axis of a beam, straight without load;
- tangent: X from the manifold, c, H and k from the tangent stiffness alone.

A beam that is curved without load is stretched by its modes from the start. e holds that, so its modes Psi are those of
the stiffness K less the part of e, K A A'K / A'KA (but for linear, whose stretch is the static one).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.gmp.chebyshev import ChebyshevTable, points
from morembs.dynamics.gmp.data import Formulation, Parameterised
from morembs.dynamics.gmp.envelope import target
from morembs.dynamics.gmp.equilibria import BeamWork, Equilibrium, Solver
from morembs.dynamics.gmp.fields import Fields, fields
from morembs.dynamics.gmp.manifold import Manifold, refuse_coarse
from morembs.dynamics.gmp.modes import BendingModes, bending_modes
from morembs.dynamics.gmp.offline import tabulate_member
from morembs.dynamics.gmp.plan import AngleRange, Plan, Report
from morembs.dynamics.gmp.tolerances import TOL
from morembs.dynamics.nonlinear.component import NonlinearComponent
from morembs.dynamics.nonlinear.planar_beam import PlanarBeam
from morembs.dynamics.nonlinear.statics import Factor


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """Shapes and stiffness at one t, see above, with e spare modes: ``X``, ``A`` (N,), ``k`` N m, ``c`` (m + e,), ``H``
    (m, m)."""

    X: Floats
    A: Floats
    k: float
    c: Floats
    H: Floats

    def flat(self, of: Fields, end: int) -> Floats:
        """All in one vector, shapes as amplitudes of fields; ``end`` is the coordinate of the chord's length."""
        return np.concatenate((of.condense(self.X), of.condense(self.A), [self.X[end], self.k], self.c, self.H.ravel()))


def shapes(
    component: NonlinearComponent, *, formulation: Formulation, modes: int, plan: Plan
) -> tuple[Parameterised, Report]:
    """The offline stage.

    Args:
        component: the component without load.
        formulation: kind of the coordinates.
        modes: number of bending modes.
        plan: ranges of the angles, and the checkpoint.

    Raises:
        InputError: an unknown formulation, too many modes, a range that the equilibria do not cover.
        OutputError: the checkpoint cannot be written.
    """
    check_value("formulation", formulation, Formulation)
    if formulation == "membrane" and not isinstance(component, PlanarBeam):
        raise InputError(
            f"formulation 'membrane' was given for a {type(component).__name__}; it needs the axis of a PlanarBeam. "
            "Take 'tangent'",
            kind="unsupported",
            keyword="formulation",
        )
    solver = Solver(component)
    mean = _mean_stretch(component, formulation)
    kept = bending_modes(component, modes, mean)
    available = _with_extra(component, modes, kept, mean)
    law = _Law(component, solver, available, modes, mean)
    if formulation in ("membrane", "tangent"):
        tables = tabulate_member(BeamWork(component, law.membrane if formulation == "membrane" else law.tangent), plan)
        manifold, samples, report = Manifold.of(tables), tables.samples, tables.report
        reach, count, energy, errors = tables.reach, tables.count, manifold.energy, np.array(manifold.errors())
        if plan.points_per_angle is not None:
            refuse_coarse(manifold.errors(), reach, count)
    else:
        report = _without_equilibria(law, plan)
        reach, count, errors = report.reach, report.points, np.zeros(2)
        grid, along = points(reach, count), law.linear if formulation == "linear" else law.foreshorten
        samples = [along(np.array([a, b])) for a in grid for b in grid]
        W = np.array([[0.5 * np.array([a, b]) @ law.angles @ np.array([a, b]) for b in grid] for a in grid])
        energy = ChebyshevTable.through(reach, W, curved=True)
    H0 = np.zeros(len(available.squares)) if formulation == "linear" else law.straight_diagonal()
    of = fields(component, np.column_stack([column for s in samples for column in (s.X, s.A)] + [available.Psi]))
    flat = np.array([s.flat(of, int(solver.second[0])) for s in samples]).reshape(count, count, -1)
    data = Parameterised(
        formulation=formulation,
        reach=reach,
        length=solver.length,
        count=modes,
        table=ChebyshevTable.through(reach, flat),
        energy=energy,
        fields=of,
        Psi=of.condense(available.Psi),
        squares=available.squares,
        H0=H0,
        peaks=np.abs(available.Psi[component.translations]).max(axis=(0, 1)),
        excluded=available.excluded,
        errors=errors,
    )
    return data, report


def _without_equilibria(law: _Law, plan: Plan) -> Report:
    """Three points, which linear and quadratic functions need; the range as for those with equilibria."""
    reach, notes = plan.reach, tuple[str, ...]()
    if isinstance(reach, AngleRange):
        reach, notes = target(BeamWork(law.component), law.start, law.solver.turns, reach, ())
    return Report(
        reach=reach, points=3, equilibria=0, solved=0, restored=0, symmetries=(), errors={}, notes=notes, seconds=0.0
    )


def _mean_stretch(component: NonlinearComponent, formulation: Formulation) -> Floats | None:
    """Uniform stretch (N,) of a beam that is not straight, None where modes take no part in it.

    Raises:
        InputError: such a beam with a formulation that knows only straight ones.
    """
    if not isinstance(component, PlanarBeam) or formulation == "linear":
        return None
    if np.abs(component.directions).max() < TOL.straight_angle:
        return None
    if formulation == "membrane":
        raise InputError(
            "formulation 'membrane' was given for a beam that is not straight; take 'tangent' or 'foreshortened'",
            kind="unsupported",
            keyword="formulation",
        )
    return _scale_shape(component, component.reference)


def _scale_shape(component: NonlinearComponent, X: Floats) -> Floats:
    """Uniform stretch of a shape: positions, no rotations."""
    A, at = np.zeros_like(X), component.translations
    A[at] = X[at]
    return A


def _with_extra(component: NonlinearComponent, count: int, kept: BendingModes, stretch: Floats | None) -> BendingModes:
    for extra in range(TOL.spare_modes, 0, -1):
        try:
            return bending_modes(component, count + extra, stretch)
        except InputError:
            continue
    return kept


class _Law:
    """Samples of shapes of one component."""

    def __init__(
        self, component: NonlinearComponent, solver: Solver, modes: BendingModes, count: int, mean: Floats | None
    ) -> None:
        self.component, self.solver, self.count = component, solver, count
        self.Psi, self.length = modes.Psi, solver.length
        self.start: Equilibrium = solver.straight()
        self.stretch = self._axial() if mean is None else mean
        self.K = component.tangent(self.start.X)
        self.angles = np.asarray(self.start.modes.T @ (self.K @ self.start.modes))
        self.k = float(self.stretch @ (self.K @ self.stretch))

    def _axial(self) -> Floats:
        """Linear stretch (N,) of the straight component, the end moved by its length."""
        component, solver = self.component, self.solver
        end = int(solver.second[0])
        free = np.setdiff1d(solver.free, [end])
        K = component.tangent(component.reference)
        shape = np.zeros(component.size)
        shape[end] = self.length
        shape[free] = -Factor(K[free][:, free]).solve((K[:, [end]][free]).toarray()[:, 0] * self.length)
        return shape

    def _along(self, X: Floats) -> Floats:
        return _scale_shape(self.component, X)

    def _slope(self, X: Floats, direction: Floats) -> Any:
        """Derivative of the tangent along a direction.

        The central difference of a tangent that is quadratic in positions, as that of a beam, is exact.
        """
        h = TOL.tangent_step / max(1.0, float(np.abs(direction).max()))
        return (self.component.tangent(X + h * direction) - self.component.tangent(X - h * direction)) / (2 * h)

    def _plain(self, X: Floats, A: Floats) -> Sample:
        m = self.Psi.shape[1]
        k = float(A @ (self.K @ A))
        return Sample(X=X, A=A, k=k, c=np.zeros(m), H=np.zeros((self.count, self.count)))

    def linear(self, t: Floats) -> Sample:
        """Static and fixed-interface modes."""
        return self._plain(self.start.X + self.start.modes @ t, self.stretch)

    def foreshorten(self, t: Floats) -> Sample:
        """With static second derivatives, and stretch by modes to first order in t."""
        second, c0, c1, H = self._expansion
        X = self.start.X + self.start.modes @ t + 0.5 * (second @ t) @ t
        return Sample(X=X, A=self._along(X), k=self.k, c=c0 + c1 @ t, H=H)

    @cached_property
    def _expansion(self) -> tuple[Floats, Floats, Floats, Floats]:
        """At t = 0: second derivatives of X (N, 2, 2), c (m + e,), its first derivatives (m + e, 2), and H."""
        free, Y = self.solver.free, self.start.modes
        factor = Factor(self.K[free][:, free])
        second, c1 = np.zeros((self.component.size, 2, 2)), np.zeros((self.Psi.shape[1], 2))
        for i in range(2):
            slope = self._slope(self.start.X, Y[:, i])
            second[free, :, i] = -factor.solve((slope @ Y)[free])
            c1[:, i] = self.Psi.T @ (slope @ self.stretch + self.K @ self._along(Y[:, i])) / self.k
        second, c0 = 0.5 * (second + second.transpose(0, 2, 1)), self.Psi.T @ (self.K @ self.stretch) / self.k
        return second, c0, c1, self._compute_stiffening(self.start.X, self.stretch, self.k)

    def _compute_stiffening(self, X: Floats, A: Floats, k: float) -> Floats:
        Psi = self.Psi[:, : self.count]
        return np.asarray(Psi.T @ (self._slope(X, A) @ Psi) / k)

    def straight_diagonal(self) -> Floats:
        """Diagonal of H at the straight shape, of all modes (m + e,)."""
        slope = self._slope(self.start.X, self.stretch)
        return np.asarray(np.einsum("nk,nk->k", self.Psi, slope @ self.Psi) / self.k)

    def tangent(self, X: Floats) -> Sample:
        """All from the tangent at X."""
        A, K = self._along(X), self.component.tangent(X)
        force = K @ A
        k = float(A @ force)
        return Sample(X=X, A=A, k=k, c=self.Psi.T @ force / k, H=self._compute_stiffening(X, A, k))

    def membrane(self, X: Floats) -> Sample:
        """From the direction of the axis: first and second variation of the chord of a line of constant length."""
        table, A = X.reshape(-1, 3), self._along(X)
        step = np.diff(table[:, :2], axis=0)
        along = np.hypot(step[:, 0], step[:, 1])
        sine, cosine = step[:, 1] / along, step[:, 0] / along
        # Rise of the modes over each element, length times rotation.
        rise = np.diff(self.Psi.reshape(-1, 3, self.Psi.shape[1])[:, 1], axis=0)
        d0 = X[self.solver.second[0]]
        kept = rise[:, : self.count]
        H = np.einsum("e,ek,el->kl", cosine / along, kept, kept) / d0
        return Sample(X=X, A=A, k=self.k, c=sine @ rise / d0, H=H)
