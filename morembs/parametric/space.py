"""One basis V for a whole box of parameters, with the reduced terms and the residuals of the bound; it grows by columns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.linalg.columns import complement, dot, fix_signs, hstack, multiply, multiply_into, symmetric
from morembs.linalg.statics import ConstrainedStatics
from morembs.parametric.bound import BoundAt, Cells, ParametricBound
from morembs.parametric.coordinates import CUT, LoadCoordinates, padded
from morembs.parametric.law import Law
from morembs.parametric.terms import AffineProblem
from morembs.problem.damping import Damping

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedTerms:
    """``K`` (Q, n, n) and ``M`` (J, n, n) whose sums by ``law_K`` and ``law_M`` are the reduced matrices at p, scaled
    loads ``B`` (n, m), and rigid motions ``rigid`` (n, r, 1 + morphs), affine in the ``morphs``."""

    law_K: Law
    law_M: Law
    K: Floats
    M: Floats
    B: Floats
    rigid: Floats
    morphs: NDArray[np.int64]

    def rigid_at(self, p: Floats) -> Floats:
        """Coordinates (n, r) of the rigid motions at ``p`` (P,)."""
        return np.asarray(self.rigid @ np.concatenate([[1.0], p[self.morphs]]))

    def at(self, p: Floats) -> tuple[Floats, Floats]:
        """K and M (n, n) at ``p`` (P,)."""
        n = self.K.shape[1]
        return tuple(
            (law(p) @ terms.reshape(len(terms), -1)).reshape(n, n)
            for law, terms in ((self.law_K, self.K), (self.law_M, self.M))
        )

    def turned(self, T: Floats, back: Floats) -> ReducedTerms:
        """Those of the basis V ``T`` (n, k), with ``back`` (k, n) ``T`` = I, whose span has all rigid motions."""
        return replace(
            self, K=T.T @ self.K @ T, M=T.T @ self.M @ T, B=T.T @ self.B,
            rigid=np.einsum("ij,jrs->irs", back, self.rigid),
        )  # fmt: skip

    def bounded(self, bound: ParametricBound, p: Floats, damping: Damping) -> BoundAt:
        """The bound at ``p`` (P,)."""
        K, M = self.at(p)
        return bound.at(p, K=K, M=M, B=self.B, rigid=self.rigid_at(p), damping=damping)


class GlobalSpace:
    """M_a-orthonormal columns V (Nc, n) of ``problem``, whose nominal values are the anchor, the rigid motions first.

    Peak memory: V, the coordinates' basis and the terms of a few columns, where the budget wants them.
    """

    def __init__(self, problem: AffineProblem, cut: float = CUT) -> None:
        self.problem, budget = problem, problem.budget
        statics, Nc = problem.statics, problem.K.shape[0]
        self.supports = statics.supports
        count = len(self.supports)
        held = sp.csc_array((np.ones(count), (self.supports, np.arange(count))), shape=(Nc, count))
        self.held = ConstrainedStatics(statics, held, "the supports") if count else None
        self.coordinates = LoadCoordinates(
            self.held.flexibility if self.held is not None else statics.apply, problem.K, budget, cut
        )
        self.morphs = np.array([j for j, each in enumerate(problem.parameters) if each.kind == "morph"], dtype=np.int64)
        self.V: list[Floats] = []
        self._K: list[list[Floats]] = [[] for _ in problem.K_terms]
        self._M: list[list[Floats]] = [[] for _ in problem.M_terms]
        self._K_parts: list[list[Floats]] = [[] for _ in problem.K_terms]
        self._M_parts: list[list[Floats]] = [[] for _ in problem.M_terms]
        self._K_rest: list[list[Floats]] = [[] for _ in problem.K_terms]
        self._M_rest: list[list[Floats]] = [[] for _ in problem.M_terms]
        self.floor = float(problem.elastic_modes(count=1).eigenvalues[0])
        loads = problem.B.toarray() * problem.motion_scale
        sizes = np.sqrt(np.maximum(np.einsum("ij,ij->j", loads, self.coordinates.flexibility(loads)), 0.0))
        self._B, self._B_rest = self.coordinates.of(loads, sizes + (sizes == 0))
        self._add_rigid()

    @property
    def size(self) -> int:
        """Number of columns n."""
        return sum(block.shape[1] for block in self.V)

    def _add_rigid(self) -> None:
        problem = self.problem
        r = problem.rigid.shape[1]
        if len(self.morphs) and r not in (0, 6):
            raise InputError(
                f"a morph was given for a body with {r} rigid-body motions; expected six (free) or none (held)"
            )
        self._append(np.array(problem.rigid, order="F"))

    def add_rigid_at_others(self) -> None:
        """Add what rigid motions at other values of the morphs are beside those at the anchor."""
        for j in range(len(self.morphs) if self.problem.rigid.shape[1] else 0):
            self.add(np.array(self.problem.rigid_terms[:, :, 1 + j], order="F"))

    def add(self, X: Floats, least: float = 0.0) -> int:
        """Number of columns that ``X`` (Nc, k), overwritten, adds; those that keep less than ``least`` of their energy
        do not count."""
        problem = self.problem
        X = complement(self.V, X, problem.M, problem.budget)
        if not X.shape[1]:
            return 0
        values, Y = sl.eigh(symmetric(X.T @ (problem.K @ X)))
        multiply_into(X, Y, X, problem.budget)
        self._append(fix_signs(X, problem.budget))
        return X.shape[1]

    def _append(self, X: Floats) -> None:
        problem, budget = self.problem, self.problem.budget
        self.V.append(budget.store(X))
        energy = np.sqrt(np.einsum("ij,ij->j", X, problem.K @ X).clip(0) + self.floor)
        every = (
            (problem.K_terms, self._K, self._K_parts, self._K_rest, energy),
            (problem.M_terms, self._M, self._M_parts, self._M_rest, 1 / energy),
        )
        nominal = self.problem.law_K(self.problem.box.nominal), self.problem.law_M(self.problem.box.nominal)
        for theta, (terms, reduced, parts, rests, scale) in zip(nominal, every, strict=True):
            for q, A in enumerate(terms):
                AX = np.asfortranarray(A @ X)
                reduced[q].append(np.vstack([dot(V, AX, budget) for V in self.V]))
                # A term counts with its coefficient: those of polynomials are of order one.
                C, rest = self.coordinates.of(AX, scale / max(abs(theta[q]), LEAST_PART * np.abs(theta).max()))
                parts[q].append(C)
                rests[q].append(rest)
                budget.release_if_tight()

    def reduced(self) -> ReducedTerms:
        """Reduced terms for all columns."""
        problem = self.problem
        B = dot(self.columns(), problem.B.toarray()) * problem.motion_scale
        r = problem.rigid.shape[1]
        if r == 6 or len(self.morphs):
            MR = np.stack([problem.M @ problem.rigid_terms[:, :, i] for i in range(problem.rigid_terms.shape[2])], 2)
            rigid = np.stack([dot(self.columns(), MR[:, :, i]) for i in range(MR.shape[2])], 2)
        else:
            rigid = np.eye(self.size, r)[:, :, None]
        return ReducedTerms(
            law_K=problem.law_K, law_M=problem.law_M, K=_symmetric_stack(self._K, self.size),
            M=_symmetric_stack(self._M, self.size), B=B, rigid=rigid[:, :r] if not r else rigid, morphs=self.morphs,
        )  # fmt: skip

    def columns(self) -> Floats:
        """V (Nc, n)."""
        return hstack(*self.V, budget=self.problem.budget)

    def bound(self, cells: Cells, F: Floats, *, sigma: float, highest: float, soft: Floats, eps: float = 0.0) -> ParametricBound:
        """The bound for all columns; ``F`` (n, k) coordinates of the columns that are deflated."""
        q, problem = self.coordinates.size, self.problem
        K, M = (np.stack([padded(term, q) for term in parts]) for parts in (self._K_parts, self._M_parts))
        rest_K, rest_M = (np.stack([np.concatenate(term) for term in rests]) for rests in (self._K_rest, self._M_rest))
        theta = problem.law_M(problem.box.nominal)
        return ParametricBound(
            law_K=problem.law_K, law_M=problem.law_M, anchor=problem.box.nominal, soft=soft, cells=cells,
            residual_B=padded([self._B], q), residual_K=K, residual_M=M,
            residual_F=np.tensordot(theta, M, 1) @ F, rest_B=self._B_rest, rest_K=rest_K, rest_M=rest_M,
            rest_F=np.abs(theta) @ rest_M @ np.abs(F), motion_F=F, sigma=sigma, highest=highest, eps=eps,
        )  # fmt: skip


LEAST_PART = 1e-3


def _symmetric_stack(terms: list[list[Floats]], n: int) -> Floats:
    """(Q, n, n) of the upper block triangles."""
    whole = np.zeros((len(terms), n, n))
    for q, blocks in enumerate(terms):
        at = 0
        for block in blocks:
            rows, k = block.shape
            whole[q, :rows, at : at + k] = block
            whole[q, at : at + k, :rows] = block.T
            at += k
        whole[q] = symmetric(whole[q])
    return whole
