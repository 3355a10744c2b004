"""One global basis for a box of parameters, grown where the bound is largest and cut to the smallest that keeps it.

Greedy search (Rozza, Huynh and Patera 2008; for second-order pencils Baur, Beattie, Benner and Gugercin 2011 take given
points): responses and modes at the p of a training set where the bound over the band is largest. What was collected is
compressed by proper orthogonal decomposition of reduced responses over p and frequencies, and the least number of
vectors is taken whose bound keeps the tolerance at all training points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import angular_band, eigenvalue_in_hz, in_hz
from morembs.linalg.dense import symmetric
from morembs.linalg.lanczos import BlockLanczos
from morembs.parametric.bound import ParametricBound, ratio
from morembs.parametric.bound_at import BoundAt, ritz_pairs
from morembs.parametric.cells import Proofs
from morembs.parametric.model import ParametricModel
from morembs.parametric.samples import frequencies, narrower, training_points
from morembs.parametric.space import GlobalSpace
from morembs.parametric.steps import SearchSteps, Step
from morembs.parametric.terms import AffineProblem
from morembs.parametric.tolerances import TOL
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.responses.certified import floor_of
from morembs.storage.lemma import PROVEN, kind_of


@dataclass(frozen=True, kw_only=True, eq=False)
class ParametricBasis:
    """Columns ``V`` (Nc, n) of the ``model``, which has the bound; ``kinds`` of the columns.

    ``box_bound`` is the largest bound over the band at all values looked at, a maximum over samples; ``worst`` (P,) is
    the p of it, ``points`` (k, P) are the values with factorisations of K, of which
    there were ``factorisations`` and ``counts`` of eigenvalues beside them. ``collected`` columns were there before the
    cut. ``kind`` is "bound" or "estimate"; ``floor`` the damping ratio that is assumed.
    """

    V: Floats
    kinds: tuple[str, ...]
    model: ParametricModel
    box_bound: float
    worst: Floats
    points: Floats
    factorisations: int
    counts: int
    collected: int
    kind: str
    floor: float


@dataclass(frozen=True, kw_only=True)
class BasisRequest:
    """What a basis is to keep: relative error ``tolerance`` of the response over ``band_hz``, at ``training`` Sobol
    points and the corners, with ``order_limit`` columns at most."""

    band_hz: tuple[float, float]
    tolerance: float
    training: int
    order_limit: int
    floor: float | None = None
    accept_bound: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Worst:
    """The largest relative bound, its p (P,) and frequency."""

    value: float
    p: Floats
    hz: float


class GreedySearch:
    """The search for a basis of ``problem`` that keeps what is ``wanted``."""

    def __init__(self, problem: AffineProblem, wanted: BasisRequest) -> None:
        self.problem, self.wanted = problem, wanted
        self.floor = floor_of(problem, wanted.band_hz, wanted.floor, problem.damping_at(problem.box.low))
        self.low, self.high = angular_band(wanted.band_hz)
        self.training = training_points(problem.box, wanted.training)
        progress.update("modes at nominal values")
        limit = (self._choose_deflation() * self.high) ** 2
        modes = problem.elastic_modes(below=limit)
        self.sigma = TOL.deflation_weight * limit
        self._start(modes.vectors)
        if min(cell.alpha for cell in self.cells) < TOL.least_stiffness_left and problem.loose is not None:
            self._start(modes.vectors, problem.loose)
        self.points: list[Floats] = []
        self.factorisations = 1
        kind = f"{wanted.band_hz} {wanted.training} {self.floor}"
        self.steps = SearchSteps(problem, kind, problem.output)

    def _start(self, modes: Floats, loose: Problem | None = None) -> None:
        """The space of the low ``modes`` and rigid motions, and what is proven in its dual norm."""
        self.space = GlobalSpace(self.problem, loose=loose)
        self.space.add(np.array(modes, order="F"))
        # Before the motions that are rigid at other p only: no low modes are beside those, nor orthogonal to them.
        self.deflated = self.space.size
        self.space.add_rigid_at_others()
        self.kept = self.space.size
        self.proofs = Proofs(self.space)
        # Many cells help little where the norm is the matter.
        leaves_loose = loose is None and self.problem.loose is not None
        self.cells = self.proofs.cells(TOL.max_cells) if leaves_loose else self.proofs.cells()

    def _choose_deflation(self) -> float:
        """The multiple of the upper frequency below which modes of the anchor are deflated."""
        problem, box = self.problem, self.problem.box
        used = np.array([kind in ("young", "density") for kind in box.kinds])
        low, high = np.where(used, box.low, box.nominal), np.where(used, box.high, box.nominal)
        stiffer = ratio(problem.law_K.monotone, box.nominal, low).max()
        lighter = ratio(problem.law_M.monotone, high, box.nominal).max()
        return float(
            np.clip(TOL.softest_up_to * np.sqrt(stiffer * lighter), TOL.deflated_up_to, TOL.max_deflated_up_to)
        )

    def damping(self, p: Floats) -> Damping:
        """The damping at ``p`` (P,) with its floor."""
        own = self.problem.box.damping(self.problem.damping, p)
        return replace(own, structural=own.structural + 2 * self.floor) if self.floor else own

    def run(self) -> ParametricBasis:
        """The basis.

        Raises:
            InputError: the tolerance is not reached.
        """
        wanted = self.wanted
        self._take(Worst(value=np.inf, p=self.problem.box.nominal, hz=0.0))
        last, stalled = np.inf, 0
        while stalled < TOL.stalled_steps:
            worst = self._next()
            stalled = stalled + 1 if np.isfinite(last) and worst.value > TOL.least_progress * last else 0
            last = worst.value
            progress.update(
                f"bound {worst.value:.1e} with {self.space.size} columns from {len(self.points)} values of p"
            )
            enough = worst.value <= wanted.tolerance
            if enough or len(self.points) >= TOL.max_full_points or not self._take(worst):
                break
        model, bound = self._bound(proof=True)
        return self._cut(model, bound)

    def _next(self) -> Worst:
        """Where the bound is largest, as an earlier run knows or from the training set."""
        steps = self.steps.known[len(self.points) :]
        if steps:
            return Worst(value=steps[0].value, p=steps[0].p, hz=steps[0].hz)
        model, bound = self._bound(proof=False)
        return self.worst(model, replace(bound, rounding_K=None, rounding_M=None))

    def _bound(self, *, proof: bool) -> tuple[ParametricModel, ParametricBound]:
        model, enough = self.space.reduce_model(), TOL.least_gap * self.high**2
        F = np.eye(self.space.size, self.deflated)
        cells = self.proofs.least(self.cells, F, self.sigma, enough, proof=proof)
        if cells.least.min() < enough:
            F = self._more_deflated(model)
            cells = self.proofs.least(self.cells, F, self.sigma, enough, proof=proof)
        bound = self.space.bound(
            cells, F, sigma=self.sigma, highest=self.high, soft=self.proofs.soft, eps=self.problem.eps
        )
        return model, bound

    def _more_deflated(self, model: ParametricModel) -> Floats:
        """Orthonormal coordinates (n, k) of the deflated modes with those of the softest bodies, where modes of the
        anchor alone are too far from them."""
        deflated, ends = self.deflated, self.proofs.soft
        columns = []
        for cell in self.cells:
            p = np.where(np.isin(np.arange(len(ends)), self.proofs.curved), 0.5 * (cell.low + cell.high), ends)
            K, M = model.matrices(p)
            _, values, Y = ritz_pairs(K, M, model.rigid_at(p))
            columns.append(Y[:, values < (TOL.corner_modes_up_to * self.high) ** 2])
        beside = np.hstack(columns)[deflated:]
        U, norms, _ = sl.svd(beside, full_matrices=False)
        return np.asarray(sl.block_diag(np.eye(deflated), U[:, norms > TOL.new_direction * norms.max(initial=0.0)]))

    def _take(self, worst: Worst) -> bool:
        """Responses and modes at the ``worst`` p join the space, more of them where it was taken before; whether there
        was anything new."""
        p, number = worst.p, len(self.points)
        before = sum(np.array_equal(p, known) for known in self.points)
        self.points.append(p)
        nominal = np.array_equal(p, self.problem.box.nominal)
        self.factorisations += not nominal
        X = self.steps.columns(number)
        if X is None:
            if nominal:
                X = self._responses(self.problem, before)
            else:
                with self.problem.at(p) as there:
                    X = self._responses(there, before)
            self.steps.add(number, Step(p=p, value=worst.value, hz=worst.hz, columns=X))
        # Bits of products depend on the order in memory, which files do not tell.
        return self.space.add(np.asfortranarray(X)) > 0

    def _responses(self, problem: Problem, before: int) -> Floats:
        """Low modes of ``problem`` and the first blocks of the Krylov space of its interface loads, static responses
        first: all from one factorisation."""
        flexibility, space = problem.free_free.flexibility, problem.space
        X = space.map_columns(flexibility, problem.B.toarray() * self.problem.motion_scale)
        blocks, least = TOL.load_blocks + before, (TOL.taken_up_to * (1 + 0.5 * before) * self.high) ** -2
        lanczos = BlockLanczos(flexibility, space, X, capacity=min(TOL.mode_steps * X.shape[1], len(X)))
        start = 0
        for step in range(TOL.mode_steps):
            if lanczos.full() or not lanczos.pending.shape[1]:
                break
            lanczos.expand()
            start = lanczos.size if step < blocks else start
            theta, Y, residual = lanczos.ritz()
            low = theta > least
            if step >= blocks and (residual[low] <= TOL.mode_residual * theta[low]).all():
                break
        return np.hstack([lanczos.vectors(Y[:, low]), lanczos.V[:, :start]])

    def worst(
        self, model: ParametricModel, bound: ParametricBound, points: Floats | None = None, enough: float = np.inf
    ) -> Worst:
        """The largest relative bound over the band at ``points`` (k, P), by default those of the training; the first
        one above ``enough``. Where it is infinite anywhere the residual tells which p is the worst."""
        largest = Worst(value=-1.0, p=self.problem.box.nominal, hz=0.0)
        residual = -1.0
        for p in self.training if points is None else points:
            at = self._bound_at(model, bound, p)
            self._refuse_undamped(at, p)
            omega = frequencies(at.values, at.damping, self.low, self.high)
            relative = at.error(omega) / at.envelope(omega)
            k = int(np.argmax(relative))
            size = at.residual(omega).max() if np.isinf(relative[k]) else 0.0
            if relative[k] > largest.value or (relative[k] == largest.value and size > residual):
                largest, residual = Worst(value=float(relative[k]), p=p, hz=float(in_hz(omega[k]))), size
            if largest.value > enough:
                break
        return largest

    def _bound_at(self, model: ParametricModel, bound: ParametricBound, p: Floats) -> BoundAt:
        K, M = model.matrices(p)
        B, rigid = model.B * model.scale, model.rigid_at(p)
        return bound.at(p, K=K, M=M, B=B, rigid=rigid, damping=self.damping(p))

    def _cut(self, model: ParametricModel, bound: ParametricBound) -> ParametricBasis:
        """The least part of the space that keeps the tolerance."""
        wanted, size = self.wanted, self.space.size
        T = self._decomposition(model)
        order = np.argsort([-self._relative(model, bound, p) for p in self.training])

        def of(n: int) -> tuple[ParametricModel, ParametricBound]:
            return project_model(model, T[:, :n]), bare.in_basis(T[:, :n])

        # More columns mend no round-off.
        bare = replace(bound, rounding_K=None, rounding_M=None)
        low, high = self.kept, min(size, wanted.order_limit)
        worst = self.worst(*of(high), points=self.training[order])
        if worst.value > wanted.tolerance and not wanted.accept_bound:
            raise self._explain_unreached(worst, high, model, bare)
        while worst.value <= wanted.tolerance and low < high:
            middle = (low + high) // 2
            progress.update(f"{middle} of {size} columns")
            if self.worst(*of(middle), points=self.training[order], enough=wanted.tolerance).value <= wanted.tolerance:
                high = middle
            else:
                low = middle + 1
        model, bound = project_model(model, T[:, :high]), bound.in_basis(T[:, :high]).compress()
        box = self.problem.box
        fresh = training_points(box, TOL.fresh_per_training * wanted.training, seed=2)
        worst = self.worst(model, bound, np.vstack([self.training, fresh]))
        rigid = self.problem.rigid.shape[1]
        kinds = ("rigid",) * rigid + ("elastic",) * (self.deflated - rigid) + ("krylov",) * (high - self.deflated)
        proof = bound.proof(self.damping(self.training[0]))
        return ParametricBasis(
            V=self.problem.space.multiply(self.space.columns(), T[:, :high]),
            kinds=kinds,
            model=replace(model, bound=bound),
            box_bound=worst.value,
            worst=worst.p,
            points=np.array(self.points),
            factorisations=self.factorisations,
            counts=self.proofs.count,
            collected=size,
            kind="bound" if kind_of(proof) == PROVEN else "estimate",
            floor=self.floor,
        )

    def _relative(self, model: ParametricModel, bound: ParametricBound, p: Floats) -> float:
        at = self._bound_at(model, bound, p)
        omega = frequencies(at.values, at.damping, self.low, self.high)
        return float((at.error(omega) / at.envelope(omega)).max())

    def _decomposition(self, model: ParametricModel) -> Floats:
        """(n, n) orthonormal directions in the space: the kept ones, then those of responses, the largest first.

        Responses count relative to the envelope, in the inner product of K_a + mu M_a.
        """
        n, kept = self.space.size, self.kept
        covariance = np.zeros((n, n))
        for p in self._some():
            K, M = model.matrices(p)
            _, values, Y = ritz_pairs(K, M, model.rigid_at(p))
            damping = self.damping(p)
            omega = frequencies(values, damping, self.low, self.high)
            for X in _responses(Y, values, Y.T @ (model.B * model.scale), damping, omega):
                covariance += X
        K, M = model.matrices(self.problem.box.nominal)
        L = sl.cholesky(symmetric(K) + self.high**2 * np.eye(n), lower=True)
        known = sl.qr(L.T[:, :kept], mode="economic")[0]
        C = L.T @ covariance @ L
        C -= known @ (known.T @ C)
        C -= (C @ known) @ known.T
        _, U = sl.eigh(symmetric(C))
        new = sl.solve_triangular(L.T, U[:, ::-1][:, : n - kept])
        Q, R = sl.qr(np.hstack([np.eye(n, kept), new]))
        return np.asarray(Q * np.where(np.diag(R) < 0, -1.0, 1.0))

    def _some(self) -> Floats:
        step = max(1, len(self.training) // TOL.snapshots)
        return np.vstack([*self.points, self.training[::step]])

    def _refuse_undamped(self, at: BoundAt, p: Floats) -> None:
        """Refuse values ``p`` (P,) without damping at a resonance of the band, where no response has a limit.

        Raises:
            InputError: in these cases.
        """
        inside = at.values[(at.values > self.low**2) & (at.values < self.high**2)]
        undamped = inside[at.damping.at_resonance(inside) == 0]
        if len(undamped):
            raise InputError(
                f"at {self._words(p)} the body has no damping at {len(undamped)} resonances of the band, the first at "
                f"{eigenvalue_in_hz(undamped[0]):,.6g} Hz, where its response has no limit; expected some: give "
                "[damping], a range of alpha or beta from above 0, or damping_floor = 0.01"
            )

    def _words(self, p: Floats) -> str:
        given = zip(self.problem.parameters, p, strict=True)
        return ", ".join(f"{each.name} = {x:.4g} {each.unit}".rstrip() for each, x in given)

    def _explain_unreached(
        self, worst: Worst, order: int, model: ParametricModel, bound: ParametricBound
    ) -> InputError:
        """The error for the ``worst`` bound, of ``model`` and ``bound`` with all of the basis."""
        sentence = f"tolerance = {self.wanted.tolerance:g} is not reached with {order} coordinates: the bound is"
        where = f"at {self._words(worst.p)} and {worst.hz:,.6g} Hz"
        cure = "raise the tolerance or the order_limit, narrow the ranges or the band, or take accept_bound = true"
        if np.isinf(worst.value):
            at = self._bound_at(model, bound, worst.p)
            finite = np.array([np.isfinite(self._relative(model, bound, p)) for p in self.training])
            words = narrower(self.problem.box, self.training, finite)
            lacking = at.explain_infinite(bound.cells.at(worst.p)[0], 2 * np.pi * worst.hz, self.high)
            return InputError(f"{sentence} infinite {where}: {lacking}; {words}", kind="result")
        # What the bound is with all of the basis and the geometry exact.
        alone = self._relative(model, replace(bound, eps=0.0), worst.p)
        geometry = (
            f"; most of it is the interpolated geometry, exact to {self.problem.eps:.1e}, beside light damping"
            if alone < 0.5 * worst.value and self.problem.eps
            else ""
        )
        return InputError(f"{sentence} {worst.value:.1e} {where}{geometry}; {cure}")


def project_model(model: ParametricModel, T: Floats) -> ParametricModel:
    """``model`` on the basis V ``T`` (n, k) with orthonormal columns, whose span has all rigid motions."""
    rigid = np.einsum("nk,nrs->krs", T, model.rigid)
    return replace(model, K=T.T @ model.K @ T, M=T.T @ model.M @ T, B=T.T @ model.B, rigid=rigid)


def _responses(Y: Floats, values: Floats, b: Floats, damping: Damping, omega: Floats) -> Iterator[Floats]:
    """Covariances (n, n) of the responses at ``omega`` (nf,), relative to their envelopes."""
    for w in omega:
        c, g = damping.proportional(1j * w)
        a = c * values + g + 1j * w * (damping.of_modes(values) - damping.alpha - damping.beta * values)
        envelope = float((1 / np.abs(a)) @ (b**2).sum(axis=1))
        X = Y @ (b / a[:, None]) / envelope
        yield (X @ X.conj().T).real
