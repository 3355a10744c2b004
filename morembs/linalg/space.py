"""Columns N x k in one inner product and under one memory budget, which are no arguments anywhere else.

All work goes a block of columns at a time, as arrays may lie in files.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.budget import Budget, current_budget, is_in_file
from morembs.base.types import Floats, Ints, Values
from morembs.linalg.columns import dense, fix_signs, m_norms, orthonormal
from morembs.linalg.dense import symmetric
from morembs.linalg.tolerances import TOL


def _row_blocks(V: Values) -> list[slice]:
    return [slice(first, first + TOL.product_rows) for first in range(0, len(V), TOL.product_rows)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Columns:
    """Columns of any length, in memory or in files as ``budget`` decides: that of the ``with Budget(...)`` around."""

    budget: Budget = field(default_factory=current_budget)

    def dot(self, V: Values, W: Values) -> Values:
        """V^H W, a block of columns of ``V`` at a time."""
        parts = []
        self.budget.release_if_tight()
        for block in self._blocks(V):
            parts.append(V[:, block].conj().T @ W)
            self.budget.release_if_tight()
        return np.vstack(parts) if parts else np.zeros((0, W.shape[1]))

    def subtract(self, V: Values, C: Values, W: Values) -> None:
        """W -= V C in place, a block of columns of ``V`` at a time."""
        real = V.dtype == W.dtype == C.dtype == np.float64 and W.size > 0 and V.flags.f_contiguous
        for block in self._blocks(V):
            # Without an array for the product, where the BLAS can take it from W itself.
            if real and W.flags.f_contiguous:
                sl.blas.dgemm(-1.0, V[:, block], C[block], beta=1.0, c=W, overwrite_c=1)
            elif real and W.flags.c_contiguous:
                sl.blas.dgemm(-1.0, C[block], V[:, block], beta=1.0, c=W.T, trans_a=1, trans_b=1, overwrite_c=1)
            else:
                W -= V[:, block] @ C[block]
            self.budget.release_if_tight()

    def multiply(self, V: Floats, Y: Floats) -> Floats:
        """V Y (N, k), where the budget wants it."""
        return self.multiply_into(V, Y, self.budget.empty((len(V), Y.shape[1]), order="F"))

    def read_rows(self, V: Values, rows: Ints) -> Values:
        """Rows ``rows`` (j,) of ``V`` (N, k), a block of columns at a time."""
        some = np.empty((len(rows), V.shape[1]), V.dtype)
        for block in self._blocks(V):
            some[:, block] = V[rows, block]
            self.budget.release_if_tight()
        return some

    def multiply_into(self, V: Floats, Y: Floats, out: Floats) -> Floats:
        """V Y into ``out`` (N, k), which may be the first columns of ``V``: of an array in memory a block of rows at a
        time, of one in a file a block of columns."""
        self.budget.release_if_tight()
        if not is_in_file(V):
            for rows in _row_blocks(V):
                out[rows] = V[rows] @ Y
                self.budget.release_if_tight()
            return out
        is_separate = not np.may_share_memory(V, out)
        product = out if is_separate else self.budget.empty(out.shape, order="F")
        for block in self._blocks(product):
            product[:, block] = 0.0
            self.subtract(V, -Y[:, block], product[:, block])
        return out if is_separate else self._copy(product, out)

    def reorder(self, V: Floats, order: Ints) -> Floats:
        """Columns ``order`` (j,) of ``V`` (N, k), written over its first j ones."""
        out = V[:, : len(order)]
        if not is_in_file(V):
            for rows in _row_blocks(V):
                out[rows] = V[rows][:, order]
            return out
        columns = self.budget.empty(out.shape, order="F")
        for to, column in enumerate(order):
            columns[:, to] = V[:, column]
            self.budget.release_if_tight()
        return self._copy(columns, out)

    def _copy(self, V: Floats, out: Floats) -> Floats:
        for block in self._blocks(V):
            out[:, block] = V[:, block]
            self.budget.release_if_tight()
        return out

    def hstack(self, *parts: Floats) -> Floats:
        """Columns of the ``parts`` (N, .) side by side, in memory or in a scratch file as the budget decides."""
        V = self.budget.empty((len(parts[0]), sum(part.shape[1] for part in parts)), order="F")
        at = 0
        for part in parts:
            V[:, at : at + part.shape[1]] = part
            at += part.shape[1]
            self.budget.release_if_tight()
        return V

    def map_columns(
        self,
        apply: Callable[[Values], Values],
        F: Values | sp.csc_array,
        dtype: Any = np.float64,
        width: int | None = None,
    ) -> Values:
        """apply(F) (N, k) where the budget wants it, the columns of ``F`` (N, k) made dense ``width`` at a time, by
        default as many as the budget has room for."""
        X = self.budget.empty(F.shape, dtype, order="F")
        width = self.budget.columns(F.shape[0]) if width is None else width
        for at in range(0, F.shape[1], width):
            X[:, at : at + width] = apply(dense(F[:, at : at + width]))
            self.budget.release_if_tight()
        return X

    def project(self, V: Floats, A: sp.csr_array, W: Floats | None = None) -> Floats:
        """V' A V or ``W``' A V (n, n) of a symmetric ``A``, a block of columns of ``V`` (Nc, n) at a time."""
        width = self.budget.columns(len(V))
        test = V if W is None else W
        parts = [self.dot(test, A @ V[:, at : at + width]) for at in range(0, V.shape[1], width)]
        product = np.hstack(parts) if parts else np.zeros((0, 0))
        return symmetric(product) if W is None else product

    def fix_signs(self, V: Floats) -> Floats:
        """As the function ``columns.fix_signs``, in place."""
        for block in self._blocks(V):
            fix_signs(V[:, block])
            self.budget.release_if_tight()
        return V

    def _blocks(self, V: Values) -> list[slice]:
        width = self.budget.read_at_once(len(V))
        return [slice(first, first + width) for first in range(0, V.shape[1], width)]


@dataclass(frozen=True, eq=False)
class Space(Columns):
    """Columns of length N with the inner product x^H ``M`` y.

    >>> space = Space(problem.M)
    >>> more = space.complement(problem.rigid, problem.B.toarray())
    >>> bool(np.abs(space.dot(problem.rigid, problem.M @ more)).max() < 1e-12)
    True
    """

    M: sp.sparray

    def orthogonalize_in_place(self, V: Values | Sequence[Values], W: Values, MW: Values | None = None) -> Values:
        """Take span(V) (M-orthonormal, in one or several blocks) out of ``W`` in place; returns V^H M W.

        Done twice, or what is left of ``W`` would keep the round-off of what was taken out. ``MW`` saves the first
        product where it is known.
        """
        bases = [V] if isinstance(V, np.ndarray) else [*V]
        if not sum(Q.shape[1] for Q in bases):
            return np.zeros((0, W.shape[1]))
        first = self.orthogonalize_once(bases, W, self.M @ W if MW is None else MW)
        return np.asarray(first + self.orthogonalize_once(bases, W, self.M @ W))

    def orthogonalize_once(self, bases: Sequence[Values], W: Values, MW: Values) -> Values:
        """Take the spans of ``bases`` out of ``W`` in place, once, given M W; returns the coefficients."""
        parts = [self.dot(Q, MW) for Q in bases]
        for Q, C in zip(bases, parts, strict=True):
            self.subtract(Q, C, W)
        return parts[0] if len(parts) == 1 else np.vstack(parts)

    def complement(self, V: Values | Sequence[Values], W: Values, *, passes: int = 1) -> Values:
        """M-orthonormal columns of what ``W`` (overwritten) adds to the M-orthonormal ``V``, in one or more blocks."""
        return self.orthogonalize(V, W, passes=passes)[1]

    def orthogonalize(self, V: Values | Sequence[Values], W: Values, *, passes: int = 1) -> tuple[Values, Values]:
        """Coefficients V^H M W, and ``complement``; ``W`` becomes what V leaves of it."""
        MW = self.M @ W
        before = m_norms(W, MW)
        coefficients = self.orthogonalize_in_place(V, W, MW)
        Q = orthonormal(W, self.M, before, passes=passes)
        # Scaling up what was small scaled up its part along V too.
        self.orthogonalize_in_place(V, Q)
        return coefficients, orthonormal(Q, self.M, np.ones(Q.shape[1]), passes=passes)
