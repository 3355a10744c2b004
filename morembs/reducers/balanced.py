"""Second-order balanced truncation: keep what loads reach and interface motions show most.

Gramians come from low-rank ADI on the full elastic part, or, over a frequency band and with modal damping, from
the reference model in its few modal coordinates. Only the variants "fv" (Meyer and Srinivasan 1996) and "pv" (with
forces and motions at the same places) project with one basis and keep symmetry and stability; the others (Reis
and Stykel 2008; "so": Chahlaoui et al. 2006) may lose stability, are checked, and then refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from morembs.base.errors import InputError, SolverError
from morembs.base.limits import PositiveCount, RelativeError, one_of
from morembs.base.types import Floats, Values
from morembs.base.units import angular_band, in_hz
from morembs.linalg.adi import LowRankGramian, SecondOrder, dense_gramian, low_rank_gramian
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.linalg.space import Space
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import Damping, Problem, System
from morembs.reducers.base import Basis, elastic_basis
from morembs.reducers.families import OfResponses
from morembs.reducers.petrov_galerkin import two_sided_basis
from morembs.reducers.problem_summary import ProblemSummary, ShiftedFactorisations
from morembs.reducers.second_order_balancing import (
    ONE_SIDED,
    VARIANTS,
    Products,
    Truncation,
    band_factor,
    lyapunov_factor,
    singular_values,
    truncate_balanced,
    usable_order,
)
from morembs.reducers.tolerances import TOL
from morembs.responses.band import Band
from morembs.responses.loads import elastic_part, unit_loads
from morembs.responses.reference import ModalReference, reference_model

INSTEAD = "give band_hz = [lower, upper], or replace the modal damping by alpha and beta"
BALANCING = ("bfsr", "sr")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Gramian:
    """Zp and Zv in the coordinates of ``lift``, which gives columns (Nc, j) in coupled dofs."""

    Zp: Floats
    Zv: Floats
    products: Products
    reference: ModalReference | None
    notes: Mapping[str, object]

    def lift(self, Z: Floats, C: Floats, problem: Problem) -> Floats:
        """Z C as columns (Nc, j)."""
        if self.reference is not None:
            return self.reference.vectors(Z @ C)
        return problem.space.multiply(Z, C)


@dataclass(frozen=True, kw_only=True)
class BalancedTruncation(OfResponses):
    """Coordinates that loads reach and outputs see alike.

    Args:
        variant: "fv" (free velocity), "pv" (position-velocity), "p", "v", "vp" or "so" (position and velocity); only
            "fv" and "pv" are symmetric.
        order: number of elastic coordinates; this or ``tolerance``.
        tolerance: relative singular value of the first coordinate that is left out.
        band_hz: [low, high], the band of the Gramians; all frequencies by default, which needs damping.
        balancing: "bfsr" orthonormalises the bases, "sr" scales them; the reduced models differ by round-off only.
        adi_tolerance: part of the static compliance of the loads that the Gramian may omit.
        adi_steps: maximum number of ADI shifts, each with a factorisation of the full dynamic stiffness. If 300 shifts
            are too few for a model of at most 600 dofs, a dense Lyapunov equation gives the Gramian.

    >>> BalancedTruncation(order=8).reduce(held).order
    8
    """

    method: ClassVar[str] = "balanced-truncation"
    variant: Annotated[str, one_of(*VARIANTS)] = "fv"
    order: PositiveCount | None = None
    tolerance: RelativeError | None = None
    band_hz: Band | None = None
    balancing: Annotated[str, one_of(*BALANCING)] = "bfsr"
    adi_tolerance: RelativeError = 1e-10
    adi_steps: PositiveCount = LINALG.adi_steps

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.order is None) == (self.tolerance is None):
            raise InputError(
                f'method "{self.method}" needs either order = COUNT or tolerance = PART (one of the two)',
                kind="missing",
                keyword="order",
            )

    @property
    def two_sided(self) -> bool:
        return self.variant not in ONE_SIDED

    def why_no_response(self, facts: ProblemSummary) -> str:
        if self.band_hz is not None:
            own = "band_hz needs proportional damping, and this model has its own damping matrix; leave band_hz away"
            return own if facts.own_damping else ""
        return _why_no_gramian(facts.damping, facts.own_damping)

    def plan_factorisations(self, facts: ProblemSummary) -> Sequence[ShiftedFactorisations]:
        # The iteration over all frequencies has a solver of its own where that of the job takes no complex matrices.
        return super().plan_factorisations(facts) if self.band_hz is not None else ()

    def _basis(self, problem: Problem) -> Basis:
        gramian = self._gramian(problem)
        products = gramian.products
        order = self._order(products)
        cut = truncate_balanced(products, self.variant, order, self.balancing)
        if cut.cosine < TOL.least_cosine:
            raise SolverError(
                f'variant = "{self.variant}" has a test space that is nearly perpendicular to the motion '
                f"at order {order} (cosine {cut.cosine:.1e}): the order cuts between singular values that belong "
                'together; take another order, or variant = "fv" or "pv"',
                keyword="variant",
            )
        values = [float(x) for x in cut.values[: min(2 * order, len(cut.values))]]
        notes = {**gramian.notes, "singular_values": values}
        if self.variant == "so":
            notes["position_singular_values"] = [float(x) for x in singular_values(products, "p")[: 2 * order]]
        right = gramian.lift(gramian.Zv if cut.right_of_velocities else gramian.Zp, cut.right, problem)
        if not self.two_sided:
            return elastic_basis(problem, right, "balanced", notes)
        return _two_sided(problem, gramian, cut, right, notes, self.variant)

    def _order(self, products: Products) -> int:
        usable = usable_order(products, self.variant)
        if self.order is not None:
            if self.order > usable:
                raise InputError(
                    f"order = {self.order} was given, but only {usable} singular values are above round-off; "
                    f"take order = {usable} or less",
                    kind="model",
                    keyword="order",
                )
            return self.order
        names = ("p", "v") if self.variant == "so" else (self.variant,)
        values = [singular_values(products, name) for name in names]
        return min(usable, max(int((s > float(self.tolerance or 0.0) * s[0]).sum()) for s in values))

    def _gramian(self, problem: Problem) -> _Gramian:
        if self.band_hz is not None:
            return _over_band(problem, (self.band_hz[0], self.band_hz[1]))
        if problem.damping.is_modal:
            return self._with_modal_damping(problem)
        return self._over_all(problem)

    def _over_all(self, problem: Problem) -> _Gramian:
        with _damped_system(problem) as (system, notes):
            elastic = _elastic(problem, system)
            try:
                gramian = low_rank_gramian(
                    elastic,
                    _loads(problem),
                    tolerance=self.adi_tolerance,
                    max_steps=self.adi_steps,
                    space=problem.space,
                )
                way = "low-rank ADI over all frequencies"
            except SolverError:
                if problem.K.shape[0] > TOL.dense_gramian_rows or self.adi_steps < LINALG.adi_steps:
                    raise
                gramian, way = _dense_gramian(problem, elastic), "dense Lyapunov equation, as ADI took too many shifts"
        M, K, space, (alpha, beta) = problem.M, problem.K, problem.space, _rayleigh(problem)
        Zp, Zv = gramian.Zp, gramian.Zv
        Mpp, Mpv, Mvv = space.project(Zp, M), space.project(Zv, M, Zp), space.project(Zv, M)
        Dpp, Dpv = alpha * Mpp, alpha * Mpv
        if beta:
            Dpp, Dpv = Dpp + beta * space.project(Zp, K), Dpv + beta * space.project(Zv, K, Zp)
        if problem.D is not None:
            Dpp, Dpv = Dpp + space.project(Zp, problem.D), Dpv + space.project(Zv, problem.D, Zp)
        notes = {**notes, "gramian": way, "adi_residual": gramian.residual, "adi_shifts": len(gramian.shifts)}
        products = Products.of(Mpp, Mpv, Mvv, Dpp, Dpv)
        return _Gramian(Zp=Zp, Zv=Zv, products=products, reference=None, notes=notes)

    def _with_modal_damping(self, problem: Problem) -> _Gramian:
        """Over all frequencies, in a reference model whose range doubles until the singular values stand."""
        reference = reference_model(problem, np.zeros(1), tolerance=TOL.reference_error)
        wanted = self.order or 10
        top = 4 * float(np.sqrt(reference.values[0]))
        before: tuple[Floats, Floats] | None = None
        for _ in range(TOL.range_doublings):
            reference = _up_to(problem, top)
            Zp, Zv = lyapunov_factor(reference.values, reference.damping_of_modes(), reference.B * problem.motion_scale)
            products = _modal_products(reference, Zp, Zv)
            values = singular_values(products, "pv")[:wanted], singular_values(products, self.variant)[:wanted]
            if before is not None and len(before[0]) == wanted:
                settled, change = (float(np.abs(a - b).max() / a[0]) for a, b in zip(values, before, strict=True))
                if settled <= TOL.settled_gramian:
                    notes = {
                        "gramian": "modal damping: Lyapunov equation of a reference model of order "
                        f"{len(reference.values)}, accurate up to {in_hz(top):.6g} Hz",
                        "gramian_change": change,
                    }
                    return _Gramian(Zp=Zp, Zv=Zv, products=products, reference=reference, notes=notes)
            before = values
            top *= 2
        raise SolverError(
            f"the singular values still change where the Gramian covers {top / (4 * np.pi):.6g} Hz; {INSTEAD}"
        )


def _dense_gramian(problem: Problem, elastic: SecondOrder) -> LowRankGramian:
    K, M = problem.K.toarray(), problem.M.toarray()
    return dense_gramian(K, M, elastic.apply_D(np.eye(len(K))), _loads(problem), problem.rigid.shape[1])


def _why_no_gramian(damping: Damping, own: bool) -> str:
    """Why there is no Gramian over all frequencies; ``own``: the model has a damping matrix."""
    if damping.structural:
        return (
            "an integral over all frequencies needs viscous damping, and structural damping has no matrix; give "
            "band_hz = [lower, upper], or replace it by rayleigh or modal damping"
        )
    if damping.is_modal and own:
        return (
            "it takes a damping matrix of the model or modal damping, not both; replace the modal damping by alpha and "
            "beta"
        )
    if damping.is_modal and not all(ratio for _, ratio in damping.steps):
        return (
            "it integrates over all resonances, and the modal damping table leaves some undamped; give band_hz = "
            "[lower, upper], or no ratio of zero"
        )
    if not own and not damping.is_viscous:
        return (
            "it integrates over all resonances, which are infinite without damping; add [damping], or give "
            'band_hz = [lower, upper], or take method = "gramian"'
        )
    return ""


def _up_to(problem: Problem, top: float) -> ModalReference:
    """Reference from zero to ``top`` (rad/s)."""
    omega = np.linspace(0.0, top, TOL.reference_samples)
    try:
        return reference_model(problem, omega, tolerance=TOL.reference_error)
    except SolverError as error:
        raise SolverError(
            "with modal damping the Gramian over all frequencies needs a reference model up to "
            f"{in_hz(top):.6g} Hz, which is out of reach ({error}); {INSTEAD}",
            kind=error.kind,
            keyword=error.keyword,
        ) from error


def _over_band(problem: Problem, band_hz: tuple[float, float]) -> _Gramian:
    """The Gramian over a band, in the coordinates of the reference model."""
    low, high = angular_band(band_hz)
    omega = np.linspace(low, high, TOL.reference_samples)
    reference = reference_model(problem, omega, tolerance=TOL.reference_error)
    loads = reference.B * problem.motion_scale
    decay = reference.damping_at_resonance()
    # Modes of a table may be damped in part.
    delta = 0.0 if (decay > 0).all() else TOL.axis_offset * high
    Zp, Zv = band_factor(lambda s: reference.states(s, loads), reference.values, decay, (low, high), delta)
    notes: dict[str, object] = {
        "gramian": f"quadrature over {band_hz[0]:g} to {band_hz[1]:g} Hz of a reference model of order "
        f"{len(reference.values)}"
    }
    if delta:
        notes["delta"] = delta
        notes["undamped"] = f"resonances without damping: integrated along s = {delta:.6g} rad/s + i omega"
    return _Gramian(Zp=Zp, Zv=Zv, products=_modal_products(reference, Zp, Zv), reference=reference, notes=notes)


def _modal_products(reference: ModalReference, Zp: Floats, Zv: Floats) -> Products:
    # The pairing of positions and velocities takes structural damping at its equivalent at each resonance.
    D = reference.damping_at_resonance()[:, None]
    return Products.of(Zp.T @ Zp, Zp.T @ Zv, Zv.T @ Zv, Zp.T @ (D * Zp), Zp.T @ (D * Zv))


def _loads(problem: Problem) -> Floats:
    """Loads (Nc, m) on the elastic part, moments as forces at the radius of gyration."""
    return elastic_part(problem, unit_loads(problem) * problem.motion_scale)


def _rayleigh(problem: Problem) -> tuple[float, float]:
    return problem.damping.alpha, problem.damping.beta


@contextmanager
def _damped_system(problem: Problem) -> Iterator[tuple[System, dict[str, object]]]:
    """The system that the iteration solves with, and what had to be changed for it.

    That of the problem serves unless Rayleigh damping comes on top of a damping matrix, which then holds both, or its
    solver takes no complex matrices.
    """
    system, D, (alpha, beta) = problem.system, problem.D, _rayleigh(problem)
    notes: dict[str, object] = {}
    solver = problem.solver
    if "complex-symmetric" not in solver.structures:
        solver = select_solver(memory=solver.memory, scratch=solver.scratch)
        notes["shift_solver"] = f"{solver.name}, as {problem.solver.name} takes no complex matrices"
    if D is not None and (alpha or beta):
        D = D + alpha * problem.M + beta * problem.K
        system = replace(system, velocity_matrix=D, damping=Damping())
    elif solver is problem.solver:
        yield system, notes
        return
    with problem.budget.in_use():
        pencil = DynamicStiffness(problem.K, problem.M, D, solver=solver)
    with pencil as stiffness:
        yield replace(system, stiffness=stiffness), notes


def _elastic(problem: Problem, system: System) -> SecondOrder:
    """The elastic part as the iteration sees it: no solution has rigid motion in it."""
    M, K, D = problem.M, problem.K, problem.D
    alpha, beta = _rayleigh(problem)
    if problem.system.damps_rigid_motion:
        raise InputError(
            "the damping matrix of this model damps its rigid-body motion, so its elastic part has no Gramian of "
            "its own; hold the body somewhere, or give [damping] instead of the matrix",
            kind="model",
            keyword="damping",
        )

    def apply_D(X: Floats) -> Floats:
        Y = alpha * (M @ X) + (beta * (K @ X) if beta else 0.0)
        return np.asarray(Y if D is None else Y + D @ X)

    def solve(s: complex, F: Values) -> Values:
        with system.inverse(s) as inverse:
            return inverse(F)

    return SecondOrder(M=M, K=K, apply_D=apply_D, solve=solve, flexibility=problem.free_free.flexibility)


def _two_sided(
    problem: Problem, gramian: _Gramian, cut: Truncation, right: Floats, notes: Mapping[str, object], variant: str
) -> Basis:
    """Rigid-body modes and the elastic columns of trial, test and velocity spaces; refused where unstable."""
    M, Z = problem.M, problem.rigid
    W = gramian.lift(gramian.Zp, cut.left if cut.left is not None else cut.right, problem)
    V_velocity = None if cut.velocity is None else gramian.lift(gramian.Zv, cut.velocity, problem)
    for X in (right, W, *([] if V_velocity is None else [V_velocity])):
        Space(M).orthogonalize_in_place(Z, X)
    notes = {**notes, "stability": "all poles checked; this variant does not guarantee it at other orders"}
    return two_sided_basis(
        problem,
        right,
        W,
        "balanced",
        notes,
        V_velocity=V_velocity,
        what=f'variant = "{variant}"',
        instead='take variant = "fv" or "pv", which are always stable, or another order',
    )
