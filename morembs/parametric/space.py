"""One basis V for a whole box of parameters, with its reduced terms and their residuals; it grows by columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.linalg.congruence import weighted_row_sums
from morembs.linalg.dense import symmetric
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.tolerances import TOL as LINALG
from morembs.parametric.bound import ParametricBound, ratio
from morembs.parametric.coordinates import LoadCoordinates, stack_padded
from morembs.parametric.model import ParametricModel
from morembs.parametric.proof import BoxCells
from morembs.parametric.terms import AffineProblem
from morembs.parametric.tolerances import TOL
from morembs.problem import Problem


class GlobalSpace:
    """M_a-orthonormal columns V (Nc, n) of ``problem``, whose nominal values are the anchor, the rigid motions first.

    The dual norm is that of ``K`` with the ``supports`` held: of the anchor, or of its elements without springs where
    the ``loose`` problem is given; V has all rigid motions then, too.

    Peak memory: V, the coordinates' basis and the terms of a few columns, where the budget wants them.
    """

    def __init__(self, problem: AffineProblem, cut: float = TOL.dependent_column, loose: Problem | None = None) -> None:
        self.problem, self.loose = problem, loose
        self.K, statics = (problem.K, problem.statics) if loose is None else (loose.K, loose.statics)
        Nc = self.K.shape[0]
        self.supports = statics.supports
        count = len(self.supports)
        columns = sp.csc_array((np.ones(count), (self.supports, np.arange(count))), shape=(Nc, count))
        self.held = ConstrainedStatics(statics, columns, "the supports") if count else None
        self.coordinates = LoadCoordinates(
            self.held.flexibility if self.held is not None else statics.apply, replace(problem.space, M=self.K), cut
        )
        self.V: list[Floats] = []
        self._K: list[list[Floats]] = [[] for _ in problem.K_terms]
        self._M: list[list[Floats]] = [[] for _ in problem.M_terms]
        self._K_parts: list[list[Floats]] = [[] for _ in problem.K_terms]
        self._M_parts: list[list[Floats]] = [[] for _ in problem.M_terms]
        self._K_rest: list[list[Floats]] = [[] for _ in problem.K_terms]
        self._M_rest: list[list[Floats]] = [[] for _ in problem.M_terms]
        self._rounding: list[list[list[Floats]]] = [[[] for _ in terms] for terms in (problem.K_terms, problem.M_terms)]
        self._weights = [[_rounding(A) for A in terms] for terms in (problem.K_terms, problem.M_terms)]
        self.floor = float(problem.elastic_modes(count=1).eigenvalues[0])
        loads = problem.B.toarray() * problem.motion_scale
        norms = np.sqrt(np.maximum(np.einsum("ij,ij->j", loads, self.coordinates.flexibility(loads)), 0.0))
        # Loads on the supports move nothing: of them there is round-off alone, which has no direction.
        self._B, self._B_rest = self.coordinates.of(loads, np.maximum(norms, TOL.still_load * norms.max(initial=0.0)))
        self._add_rigid()

    @property
    def size(self) -> int:
        """Number of columns n."""
        return sum(block.shape[1] for block in self.V)

    def _add_rigid(self) -> None:
        problem = self.problem
        r = problem.rigid.shape[1]
        if len(problem.morphs) and r not in (0, 6):
            raise InputError(
                f"a morph was given for a body with {r} rigid-body motions; expected six (free) or none (held)",
                kind="model",
            )
        self._append(np.array(problem.rigid, order="F"))

    def stiffness_sum(self, theta: Floats) -> sp.csr_array:
        """sum_q theta_q K_q (Nc, Nc) of the terms that the dual norm knows."""
        own = len(self.problem.varied.stiffness)
        felt = (self.loose is None) | (np.arange(len(theta)) < own)
        return self.problem.stiffness_sum(np.where(felt, theta, 0.0))

    def add_rigid_at_others(self) -> None:
        """Add what rigid motions at other values of the morphs are beside those at the anchor."""
        known = 0 if self.loose is not None else 1
        for j in range(known, 1 + len(self.problem.morphs) if self.problem.rigid.shape[1] or not known else 0):
            self.add(np.array(self.problem.rigid_terms[:, :, j], order="F"))

    def _rigid(self) -> Floats:
        """Coordinates (n, 6, 1 + morphs) of the rigid motions at all values."""
        problem, V, terms = self.problem, self.columns(), np.moveaxis(self.problem.rigid_terms, 2, 0)
        return np.stack([problem.space.dot(V, problem.M @ np.asfortranarray(R)) for R in terms], axis=2)

    def add(self, X: Floats) -> int:
        """Number of columns that ``X`` (Nc, k), overwritten, adds."""
        problem = self.problem
        X = problem.space.complement(self.V, X)
        if not X.shape[1]:
            return 0
        Y = sl.eigh(symmetric(X.T @ (problem.K @ X)))[1]
        problem.space.multiply_into(X, Y, X)
        self._append(problem.space.fix_signs(X))
        return int(X.shape[1])

    def _append(self, X: Floats) -> None:
        problem, space = self.problem, self.problem.space
        self.V.append(space.budget.store(X))
        energy = np.sqrt(np.einsum("ij,ij->j", X, problem.K @ X).clip(0) + self.floor)
        every = (
            (problem.K_terms, self._K, self._K_parts, self._K_rest, energy),
            (problem.M_terms, self._M, self._M_parts, self._M_rest, 1 / energy),
        )
        one, high = np.ones_like(problem.box.high), problem.box.high
        ratios = [ratio(law, high, one) for law in (problem.law_K, problem.law_M)]
        kinds = zip(ratios, self._weights, self._rounding, every, strict=True)
        for size, weights, rounding, (terms, reduced, parts, rest_norms, scale) in kinds:
            for q, A in enumerate(terms):
                WX = np.asfortranarray(weights[q][:, None] * X)
                rounding[q].append(np.vstack([space.dot(V, WX) for V in self.V]))
                AX = np.asfortranarray(A @ X)
                reduced[q].append(np.vstack([space.dot(V, AX) for V in self.V]))
                # A term counts with its coefficient; polynomials are of order one.
                C, norms = self.coordinates.of(AX, scale / size[q])
                parts[q].append(C)
                rest_norms[q].append(norms)
                space.budget.release_if_tight()

    def reduce_model(self) -> ParametricModel:
        """The reduced model of all columns."""
        problem, V = self.problem, self.columns()
        r = problem.rigid.shape[1]
        if r == 6:
            rigid = self._rigid()
        else:
            rigid = np.zeros((self.size, r, 1 + len(problem.morphs)))
            rigid[:, :, 0] = np.eye(self.size, r)
        return ParametricModel(
            box=problem.box,
            law_K=problem.law_K,
            law_M=problem.law_M,
            K=_symmetric_stack(self._K, self.size),
            M=_symmetric_stack(self._M, self.size),
            B=np.asarray((problem.B.T @ V).T),
            rigid=rigid,
            damping=problem.damping,
            scale=problem.motion_scale,
        )

    def columns(self) -> Floats:
        """V (Nc, n)."""
        return self.problem.space.hstack(*self.V)

    def bound(
        self, cells: BoxCells, F: Floats, *, sigma: float, highest: float, soft: Floats, eps: float = 0.0
    ) -> ParametricBound:
        """The bound for all columns; ``F`` (n, k) coordinates of the columns that are deflated."""
        q, problem = self.coordinates.size, self.problem
        K, M = (np.stack([stack_padded(term, q) for term in parts]) for parts in (self._K_parts, self._M_parts))
        rest_K, rest_M = (
            np.stack([np.concatenate(term) for term in rest_norms]) for rest_norms in (self._K_rest, self._M_rest)
        )
        theta = problem.law_M(problem.box.nominal)
        long = len(problem.rigid) ** 2 * LINALG.roundoff / (16 * TOL.roundoff_split)
        rounding = [
            _symmetric_stack(weighted, self.size) + long * _positive(_symmetric_stack(reduced, self.size))
            for weighted, reduced in zip(self._rounding, (self._K, self._M), strict=True)
        ]
        return ParametricBound(
            law_K=problem.law_K,
            law_M=problem.law_M,
            anchor=problem.box.nominal,
            soft=soft,
            cells=cells,
            residual_B=stack_padded([self._B], q),
            residual_K=K,
            residual_M=M,
            residual_F=np.tensordot(theta, M, 1) @ F,
            rest_B=self._B_rest,
            rest_K=rest_K,
            rest_M=rest_M,
            rest_F=np.abs(theta) @ rest_M @ np.abs(F),
            motion_F=F,
            sigma=sigma,
            highest=highest,
            eps=eps,
            rounding_K=rounding[0],
            rounding_M=rounding[1],
            rigid=None if self.loose is None else self._rigid(),
        )


def _positive(terms: Floats) -> Floats:
    """|A| (Q, n, n) of each of the ``terms``, so that |x'A x| <= x'|A| x: that of a preload may be negative."""
    values, U = np.linalg.eigh(terms)
    return np.asarray((U * np.abs(values)[:, None, :]) @ U.transpose(0, 2, 1))


def _rounding(A: sp.csr_array) -> Floats:
    """Weights w (Nc,): round-off in ``A``, in its products with columns and in sums of these over all rows makes at
    most x'(w x) of x'A x, beside ``TOL.roundoff_split``."""
    count = np.diff(A.indptr)
    return weighted_row_sums(A, LINALG.strain_roundoff + LINALG.roundoff * (TOL.roundoff_split + 0.5 * count))


def _symmetric_stack(terms: list[list[Floats]], n: int) -> Floats:
    """(Q, n, n) of the upper block triangles."""
    stack = np.zeros((len(terms), n, n))
    for q, blocks in enumerate(terms):
        at = 0
        for block in blocks:
            rows, k = block.shape
            stack[q, :rows, at : at + k] = block
            stack[q, at : at + k, :rows] = block.T
            at += k
        stack[q] = symmetric(stack[q])
    return stack
