"""A reduced model so large that it stands for the full one, up to a frequency: what errors are measured against.

It is the Galerkin projection on a block Krylov space V of the elastic flexibility G, started at the loads. With
proportional damping A(s) = c (K + f M), c = 1 + i eta + beta s (eta the structural loss factor) and
f = (s^2 + alpha s) / c, so one real space serves all frequencies. With rho = G (F - (K + f M) V y), which the Lanczos
relation G M V = V T + W E' gives in small matrices, the error is dH = rho' K (K + f M)^-1 K rho, hence
|dH| <= max_k |lam_k / (lam_k + f)| |rho|_K^2: quadratic in the residual. The space grows until this is below a
tolerance everywhere; the maximum is taken over the Ritz values, which makes it an estimate.

One factorisation and a few blocks of solves make it; frequency responses, Gramians, and the choice of shifts and
orders are small dense problems in its coordinates afterwards. The space is kept with the problem and grows when
more is asked of it. A damping matrix of the model's own needs another space: ``damped_reference``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.errors import InputError, SolverError
from morembs.base.types import Complexes, Floats
from morembs.linalg.columns import orthonormal_pair
from morembs.linalg.eigen import accurate_eigh
from morembs.linalg.lanczos import BlockLanczos
from morembs.problem import SOFTER, Problem
from morembs.problem.damping import Damping
from morembs.responses.damped_reference import DampedSpace
from morembs.responses.direct import refuse_skew_parts, why_no_response
from morembs.responses.loads import static_response, unit_loads
from morembs.responses.massless import refuse_massless
from morembs.responses.rational import product
from morembs.responses.solves import Solves
from morembs.responses.tolerances import TOL

JUMPY = "; or let the ratio of the modal damping table jump further below or above the band"


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalReference:
    """Elastic part of the full model in k modal coordinates: M = I, K = diag(``values``).

    ``D`` (k, k) its damping, None for proportional or modal ``damping``; ``F`` (k, p) loads: first the interface
    motions, B, as far as ``inputs``, then inertia loads; ``V`` (Nc, >= k) and ``Y`` (k, k) lead back to the
    coupled dofs. ``error`` is the estimated relative error of H at the frequencies asked for.
    """

    values: Floats
    D: Floats | None
    damping: Damping
    F: Floats
    inputs: int
    V: Floats
    Y: Floats
    error: float
    problem: Problem

    @property
    def B(self) -> Floats:
        """Interface degrees of freedom (k, m)."""
        return self.F[:, : self.inputs]

    def damping_of_modes(self) -> Floats:
        """Diagonal (k,) of the damping matrix; without ``D`` there is nothing else in it."""
        if self.D is not None:
            return np.asarray(np.diag(self.D))
        return self.damping.of_modes(self.values)

    def damping_at_resonance(self) -> Floats:
        """``damping_of_modes`` (k,) with the viscous equivalent of structural damping: twice the decay of the modes."""
        if self.D is not None:
            return np.asarray(np.diag(self.D))
        return self.damping.at_resonance(self.values)

    def states(self, s: NDArray[Any], F: Floats | None = None) -> Complexes:
        """(ns, k, p) modal coordinates of A(s)^-1 F at complex ``s`` (ns,); ``F`` (k, p), by default all loads."""
        F = self.F if F is None else F
        s = np.asarray(s, dtype=complex)
        if self.D is None:
            stiffness = self.values * (1 + 1j * self.damping.structural)
            diagonal = stiffness + s[:, None] * self.damping_of_modes() + s[:, None] ** 2
            return np.asarray(F / diagonal[:, :, None])
        K, eye = np.diag(self.values), np.eye(len(self.values))
        return np.array([np.linalg.solve(K + x * self.D + x * x * eye, F.astype(complex)) for x in s])

    def response(self, omega: Floats) -> Complexes:
        """H (nf, m, m) at ``omega`` (nf,) in rad/s, elastic part."""
        return np.asarray(self.B.T @ self.states(1j * np.asarray(omega), self.B))

    def vectors(self, C: Floats) -> Floats:
        """Columns (Nc, j) in coupled dofs of the modal coordinates ``C`` (k, j)."""
        return self.problem.space.multiply(self.V[:, : len(self.Y)], self.Y @ C)


def reference_model(
    problem: Problem,
    omega: Floats,
    *,
    tolerance: float = TOL.default_reference_error,
    inertia_loads: bool = False,
    damping: Damping | None = None,
) -> ModalReference:
    """Reference whose error is below ``tolerance`` times the largest entry of H at all ``omega`` (nf,) in rad/s.

    Forces and moments are scaled to equal static energy for that. With modal damping every Ritz mode has the ratio of
    its own frequency. Where a modal table jumps beside unresolved modes, the error may be up to ``TOL.jump_error``:
    ``Reference.error`` is its value. Peak memory: the Krylov space, up to some hundred columns of length N.

    Args:
        inertia_loads: also follow the inertia loads of the moving frame, as ``loads.inertia_loads`` gives them.
        damping: taken instead of that of the problem, where the model has no damping matrix of its own.

    Raises:
        InputError: no interfaces, or modal damping beside a damping matrix of the model.
        SolverError: the error does not fall below ``tolerance``.
    """
    if not problem.B.shape[1]:
        raise InputError("a frequency response needs interfaces; add at least one [[interface]]", kind="missing")
    refuse_skew_parts(problem)
    omega = np.asarray(omega, dtype=float)
    if problem.D is not None:
        return _build_damped(problem, problem.D, omega, tolerance, inertia_loads)
    return reference_space(problem, inertia_loads).until(omega, tolerance, damping or problem.damping)


def reference_space(problem: Problem, inertia: bool = False) -> ReferenceSpace:
    """The Krylov space of ``problem``, also for ``inertia`` loads: kept, and larger with every demand.

    Raises:
        InputError: no load on the interfaces moves any mass.
    """
    refuse_massless(problem)
    return problem.compute_once(("reference", inertia), lambda: ReferenceSpace(problem, inertia))


def _build_damped(problem: Problem, D: sp.csr_array, omega: Floats, tolerance: float, inertia: bool) -> ModalReference:
    """Reference of a model with a damping matrix of its own."""
    reason = why_no_response(problem.damping, True, problem.K.shape[0])
    if reason:
        raise InputError(reason, kind="unsupported", keyword="damping")
    F = unit_loads(problem, inertia)
    space = problem.compute_once(("damped reference", inertia), lambda: DampedSpace(problem, D, F, omega))
    V, values, Y, D_modes, error = space.until(omega, tolerance)
    # Only models that are taken whole come here with Rayleigh damping beside their matrix.
    D_modes = D_modes + np.diag(problem.damping.of_modes(values))
    return ModalReference(
        values=values,
        D=D_modes,
        damping=problem.damping,
        F=Y.T @ problem.space.dot(V, F),
        inputs=problem.B.shape[1],
        V=V,
        Y=Y,
        error=error,
        problem=problem,
    )


def _beside_resonances(omega: Floats, reference: ModalReference) -> Floats:
    """``omega`` (nf,), but beside the undamped resonances of ``reference`` where it is one: there is no response."""
    poles = np.sqrt(reference.values[reference.damping_at_resonance() == 0])
    on = (np.abs(omega[:, None] - poles) <= TOL.on_resonance * poles).any(axis=1)
    return np.asarray(np.where(on, omega * (1 + TOL.least_flank), omega))


def has_stagnated(errors: list[float]) -> bool:
    """True if the latest blocks of a space do not help, by the ``errors`` after each."""
    late = max(TOL.stagnation_blocks, len(errors) // 2)
    before, latest = min(errors[:-late], default=np.inf), min(errors[-late:])
    return before <= TOL.stagnated_error and latest > 0.5 * before


class ReferenceSpace:
    """The Krylov space of a problem, which grows block by block."""

    def __init__(self, problem: Problem, inertia: bool) -> None:
        self.problem, self.inertia = problem, inertia
        F = unit_loads(problem, inertia)
        self.inputs = problem.B.shape[1]
        self.solves, self.residuals = Solves(problem), np.zeros(0)
        start = self.statics[0]
        if inertia:
            others = problem.free_free.flexibility(F[:, self.inputs :])
            start = problem.space.hstack(start, others)
        self.scale = np.sqrt(np.maximum(np.einsum("ij,ij->j", F, start), 0.0))
        if not (self.scale > 0).all():
            raise InputError("an interface degree of freedom does not deform the body; check the interfaces")
        start = start / self.scale
        M = problem.M
        self.room = M.shape[0] - problem.rigid.shape[1]
        self.lanczos = BlockLanczos(self._solve, problem.space, start, capacity=min(TOL.first_order, self.room), seed=3)
        # G F = V g in the first block of V.
        self.loads = self.lanczos.M_pending.T @ start
        self.stiffness: Floats = np.zeros((0, 0))
        self.lanczos.expand()
        self._border()

    @cached_property
    def statics(self) -> tuple[Floats, Floats]:
        """Static responses (Nc, m) to unit interface loads, refined where they need it, and their residuals (m,)."""
        return self.solves.checked(static_response(self.problem), self.problem.B.toarray())

    def _solve(self, F: Floats) -> Floats:
        """Elastic displacements under ``F``; the residuals of those under M times the newest block are kept."""
        if F is not self.lanczos.M_pending:
            return self.problem.free_free.flexibility(F)
        k, b = self.lanczos.size, F.shape[1]
        X, residuals = self.solves.flexibility(F)
        lost = self.solves.inertia(self.lanczos.V[:, k : k + b], TOL.no_change * np.sqrt(k + b))
        self.residuals = np.append(self.residuals, residuals + lost)
        return X

    def until(self, omega: Floats, tolerance: float, damping: Damping) -> ModalReference:
        """The space, grown until the error with ``damping`` is below ``tolerance`` at ``omega``.

        Raises:
            SolverError: the error stagnates above it, or the space has ``TOL.max_order`` columns.
        """
        lanczos, errors = self.lanczos, list[float]()
        while True:
            values, Y = sl.eigh(self.stiffness)
            g = np.zeros((lanczos.size, self.loads.shape[1]))
            g[: len(self.loads)] = self.loads
            # G F = V g, so F seen by the modes is V' K V g.
            F = Y.T @ (self.stiffness @ g)
            reference = ModalReference(
                values=values,
                D=None,
                damping=damping,
                F=F,
                inputs=self.inputs,
                V=lanczos.V,
                Y=Y,
                error=np.inf,
                problem=self.problem,
            )
            at = _beside_resonances(omega, reference)
            error, jumps = self._error(reference, g, at, tolerance), 0.0
            if damping.is_modal:
                # Every mode has a damping of its own, of which the residual on this space knows nothing.
                error, jumps = max(error, self._change(reference, g, at)), self._jumps(reference, at)
            worst = max(error, jumps)
            progress.update(f"frequency response: order {lanczos.size}, error {worst:.1e}")
            good = error <= tolerance and jumps <= max(tolerance, TOL.jump_error)
            if good or not lanczos.pending.shape[1]:
                return self._refine_soft_modes(reference, worst)
            errors.append(worst)
            if has_stagnated(errors):
                raise SolverError(
                    f"the full response reached an error of only {min(errors):.1e} with {lanczos.size} vectors, and "
                    f"more of them do not help: the residual is round-off; raise the tolerance, or {SOFTER}",
                    keyword="tolerance",
                )
            if not self.extend(worst, JUMPY if jumps > tolerance else ""):
                return self._refine_soft_modes(reference, worst)

    def extend(self, error: float, advice: str = "") -> bool:
        """One block more; False where there is none. ``error`` and ``advice`` are for the message of a full space.

        Raises:
            SolverError: the space has ``TOL.max_order`` columns.
        """
        lanczos = self.lanczos
        if lanczos.pending.shape[1]:
            self._clean()
        if not lanczos.pending.shape[1]:
            return False
        if lanczos.full() and lanczos.capacity < min(TOL.max_order, self.room):
            lanczos.enlarge(min(2 * lanczos.capacity, TOL.max_order, self.room))
        if lanczos.full():
            raise SolverError(
                f"the full response reached an error of only {error:.1e} with {lanczos.size} vectors; lower the "
                "upper frequency, or raise the tolerance" + advice
            )
        lanczos.expand()
        self._border()
        return True

    def _refine_soft_modes(self, reference: ModalReference, error: float) -> ModalReference:
        """``reference`` with soft modes known to their own round-off, and with its loads."""
        problem, V = self.problem, self.lanczos.V[:, : self.lanczos.size]

        def stiffness(Y: Floats) -> Floats:
            return problem.space.project(problem.space.multiply(V, Y), problem.K)

        values, Y = accurate_eigh(self.stiffness, projected=stiffness)
        F = Y.T @ problem.space.dot(V, unit_loads(problem, self.inertia))
        return replace(reference, values=values, Y=Y, F=F, error=error)

    def _clean(self) -> None:
        """Take rigid-body motion out of the next block: it was round-off before the block was scaled up."""
        lanczos, M = self.lanczos, self.problem.M
        Q, MQ = lanczos.pending, lanczos.M_pending
        bases = [self.problem.rigid, lanczos.V[:, : lanczos.size]]
        for _ in range(2):
            out = float(np.abs(self.problem.space.orthogonalize_once(bases, Q, MQ)).max(initial=0.0))
            if out > TOL.no_change:
                MQ = M @ Q
            if out < TOL.large_change:
                break
        # What was orthonormal keeps its length, unless it was rigid motion or round-off.
        Q, MQ = orthonormal_pair(Q, M, np.ones(Q.shape[1]), Q.T @ MQ, MW=MQ, least=np.sqrt(0.5))
        fits = self.room - lanczos.size
        lanczos.pending, lanczos.M_pending = Q[:, :fits], MQ[:, :fits]

    def _border(self) -> None:
        """V' K V with the newest block of V."""
        lanczos, stiffness = self.lanczos, self.stiffness
        self.problem.budget.release_if_tight()
        new = lanczos.V[:, lanczos.last]
        columns = self.problem.space.dot(lanczos.V[:, : lanczos.size], self.problem.K @ new)
        self.stiffness = np.zeros((lanczos.size, lanczos.size))
        self.stiffness[: len(stiffness), : len(stiffness)] = stiffness
        self.stiffness[:, lanczos.last] = columns
        self.stiffness[lanczos.last] = columns.T

    def _change(self, reference: ModalReference, g: Floats, omega: Floats) -> float:
        """Largest change of H by the newest block, relative to its largest entry at each frequency."""
        k = self.lanczos.last.start
        if not k:
            return np.inf
        values, Y = sl.eigh(self.stiffness[:k, :k])
        before = replace(reference, values=values, Y=Y, F=Y.T @ (self.stiffness[:k, :k] @ g[:k]))
        H, old = (model.F.T @ model.states(1j * omega) for model in (reference, before))
        return float((np.abs(H - old).max(axis=(1, 2)) / np.abs(H).max(axis=(1, 2))).max())

    def _jumps(self, reference: ModalReference, omega: Floats) -> float:
        """What H would change by if modes that may lie on either side of a jump of the modal table changed sides.

        With G M V y = V T y + W E'y, an eigenvalue of G M lies within |T y - y / theta| + |W E'y| of 1 / theta (in the
        norm of M; Weinstein 1934). Relative to the largest entry of H at each frequency.
        """
        lanczos, values, Y, jumps = self.lanczos, reference.values, reference.Y, reference.damping.jumps
        if not len(jumps):
            return 0.0
        T, last = lanczos.T[: lanczos.size, : lanczos.size], Y[lanczos.last]
        outside = np.einsum("ij,ik,kj->j", last, lanczos.residual_gram, last)
        residuals = np.sqrt(np.maximum(((T @ Y - Y / values) ** 2).sum(axis=0) + outside, 0.0))
        stiffness = values * (1 + 1j * reference.damping.structural)
        H = np.abs(reference.F.T @ reference.states(1j * omega)).max(axis=(1, 2))
        change = np.zeros(len(omega))
        for jump in jumps:
            unsure = np.abs(1 / values - 1 / jump**2) <= residuals
            if not unsure.any():
                continue
            omega_k, F = np.sqrt(values[unsure]), np.abs(reference.F[unsure])
            ratios = reference.damping.ratio(np.array([jump * (1 - TOL.beside_jump), jump * (1 + TOL.beside_jump)]))
            below, above = (
                1 / (stiffness[unsure] - omega[:, None] ** 2 + 2j * ratio * omega[:, None] * omega_k)
                for ratio in ratios
            )
            change += np.einsum("ki,fk,kj->fij", F, np.abs(below - above), F).max(axis=(1, 2)) / H
        return float(change.max(initial=0.0))

    def _error(self, reference: ModalReference, g: Floats, omega: Floats, tolerance: float) -> float:
        """Largest estimated error of H, relative to its largest entry at each frequency; some error above
        ``tolerance`` where that is exceeded and the space can still grow."""
        lanczos, values, Y = self.lanczos, reference.values, reference.Y
        V, W, T = lanczos.V[:, : lanczos.size], lanczos.rest_vectors, lanczos.T[: lanczos.size, : lanczos.size]
        KW = self.problem.K @ W
        cross = self.problem.space.dot(V, KW)
        energy = np.block([[self.stiffness, cross], [cross.T, W.T @ KW]])
        # What f y makes of the residual: T f y inside of the space and the rest behind it.
        TY = np.vstack([T @ Y, Y[lanczos.last]])

        def at(w: float) -> float:
            # K carries c; the rest of A is f M, and f y follows from the modal equation.
            c, _ = reference.damping.proportional(1j * w)
            stiffness = values * (1 + 1j * reference.damping.structural)
            row = 1.0 / (stiffness + 1j * w * reference.damping_of_modes() - w**2)
            gain = max(1.0, float(np.abs(values * row).max()))
            if not row.imag.any():
                # Without damping all is real, in a quarter of the time.
                c, row = c.real, row.real
            y, fy = row[:, None] * reference.F, (1.0 - c * row * values)[:, None] * reference.F
            H = reference.F.T @ y
            rho = -product(TY, fy)
            rho[: len(g)] += g - c * product(Y, y)
            residual = np.abs(np.einsum("ij,ij->j", rho.conj(), product(energy, rho)))
            return gain * float(residual.max()) / float(np.abs(H).max())

        # A few frequencies refuse most spaces; one that they accept is looked at everywhere.
        samples = omega[:: max(1, len(omega) // TOL.first_samples)]
        worst = max(at(w) for w in samples)
        if worst > tolerance and lanczos.pending.shape[1]:
            return worst
        return max(worst, max(at(w) for w in omega))
