"""A(s) = s^2 M + s (D + G) + K + N on one pattern, so that one symbolic analysis serves all shifts."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.budget import current_budget
from morembs.base.closing import Closing
from morembs.base.errors import InputError
from morembs.base.types import Values
from morembs.linalg.sparse.solver import Analysis, Factorization, Forecast, LinearSolver
from morembs.linalg.sparse.symmetric import General, Lower
from morembs.linalg.tolerances import TOL


class DynamicStiffness(Closing):
    """The pencil of ``K``, ``M`` and optionally ``D`` (N, N), symmetric, ``G`` and ``N``, skew. A context manager.

    ``lower`` is the lower triangle of K on the union of the patterns. Peak memory: that triangle, one more of
    it for each A(s), two where there is a skew part, and 4 bytes for each entry of the other matrices. ``regular``
    False lets K have rows of nothing but zero.

    Raises:
        InputError: matrices that are not symmetric, not finite, or of different sizes.
    """

    def __init__(
        self,
        K: sp.csr_array,
        M: sp.csr_array,
        D: sp.csr_array | None = None,
        *,
        G: sp.csr_array | None = None,
        N: sp.csr_array | None = None,
        solver: LinearSolver,
        regular: bool = True,
    ) -> None:
        self.solver, self.budget = solver, current_budget()
        stiffness = Lower.of(K, "the stiffness matrix", regular=regular)
        parts = [
            Lower.of(A, what, regular=False)
            for A, what in ((M, "the mass matrix"), (D, "the damping matrix"))
            if A is not None
        ]
        symmetric = len(parts)
        for A, what in ((G, "the gyroscopic matrix"), (N, "the circulatory matrix")):
            if A is not None:
                general = General.of(A, what, regular=False)
                parts.append(Lower(general.indptr, general.indices, general.skew))
        if any(part.n != stiffness.n for part in parts):
            raise InputError(
                f"K, M and D have {[stiffness.n, *(part.n for part in parts)]} rows; expected equal numbers",
                keyword="K",
            )
        places = [_places(stiffness, part) for part in parts]
        if any((place < 0).any() for place in places):
            for part in parts:
                stiffness = _widen(stiffness, part)
            places = [_places(stiffness, part) for part in parts]
        self.lower = stiffness
        added = [(place, part.data) for place, part in zip(places, parts, strict=True)]
        self._added, skew = added[:symmetric], added[symmetric:]
        # Powers of s that go with the skew parts.
        powers = [power for A, power in ((G, 1), (N, 0)) if A is not None]
        self._skew = list(zip(powers, skew, strict=True))
        self._analyses: dict[str, Analysis] = {}

    def at(self, s: complex) -> Lower:
        """Lower triangle of A(s), with its skew part where it has one: real for real ``s``, and for imaginary ``s``
        without D and G."""
        scales = [s * s, s][: len(self._added)]
        real = all(complex(scale).imag == 0.0 for scale in scales)
        data: Values = np.array(self.lower.data, dtype=np.float64 if real else np.complex128)
        for scale, (place, values) in zip(scales, self._added, strict=True):
            _add(data, place, complex(scale).real if real else scale, values)
        skewed = [(s**power, part) for power, part in self._skew if s or not power]
        if not skewed:
            return replace(self.lower, data=data)
        kind = data.dtype if all(complex(scale).imag == 0.0 for scale, _ in skewed) else np.complex128
        skew = np.zeros(len(data), dtype=kind)
        for scale, (place, values) in skewed:
            _add(skew, place, scale if kind == np.complex128 else complex(scale).real, values)
        return General(self.lower.indptr, self.lower.indices, data.astype(kind, copy=False), skew)

    def structure_at(self, s: complex) -> str:
        """Structure of A(s), as ``structure_at`` has it."""
        powers = {power for power, _ in self._skew}
        return structure_at(s, D=len(self._added) > 1, G=1 in powers, N=0 in powers)

    def shift(self, sigma: float) -> Lower:
        """Lower triangle of K - sigma M."""
        place, values = self._added[0]
        data = np.array(self.lower.data)
        _add(data, place, -sigma, values)
        return replace(self.lower, data=data)

    def factorize(self, s: complex, structure: str | None = None) -> Factorization:
        """Factor of A(s), which lives until the next one of the same structure; the analysis is shared.

        ``structure`` None: that of ``structure_at``.

        Raises:
            SingularMatrixError: ``s`` is an eigenvalue.
            SolverError: the backend failed or the budget is too small.
        """
        A = self.at(s)
        structure = self.structure_at(s) if structure is None else structure
        what = f"s^2 M + s D + K at s = {s:.6g}"
        if structure not in self._analyses:
            self.budget.release_pages()
            self._analyses[structure] = self.solver.with_memory(self.budget.bytes_left()).analyse(A, structure, what)
        return self._analyses[structure].factorize(A, what)

    def for_worker(self) -> DynamicStiffness:
        """The same matrices under the budget of here and without any factor, for a process of its own."""
        other = copy(self)
        other.budget, other._analyses = current_budget(), {}
        return other

    def with_springs(self, rows: NDArray[np.int64]) -> Lower:
        """K with springs of ``spring_stiffness`` to the ground at ``rows``."""
        with self.budget.in_use():
            return with_springs(self.lower, rows)

    def room_for_factor(self, structure: str) -> int:
        """Bytes that a factor of A(s) in memory takes at most, with the values of A(s), from a symbolic analysis."""
        return plan_at_shift(self.lower, structure, self.solver)[1]

    @property
    def analysed(self) -> tuple[str, ...]:
        """Structures of the matrices factorised so far; all of one structure share one analysis."""
        return tuple(self._analyses)

    def close(self) -> None:
        """Release all factors."""
        for analysis in self._analyses.values():
            analysis.close()
        self._analyses.clear()


def plan_at_shift(lower: Lower, structure: str, solver: LinearSolver) -> tuple[Forecast, int]:
    """What a factor of A(s) on the pattern of ``lower`` takes in memory, and all bytes with the values of A(s)."""
    if structure.startswith("complex"):
        lower = replace(lower, data=lower.data.astype(complex))
    values = lower.data.nbytes
    if structure.endswith("unsymmetric"):
        lower, values = General(lower.indptr, lower.indices, lower.data, lower.data), 2 * values
    with solver.with_memory(None).analyse(lower, structure) as analysis:
        plan = analysis.forecast
    return plan, values + max(plan.memory, plan.kept)


def structure_at(s: complex, *, D: bool, G: bool, N: bool) -> str:
    """Structure of A(s) where there is a damping, a gyroscopic and a circulatory matrix or not: "symmetric", or
    "unsymmetric" with a skew part; "complex-" before it where A(s) is complex."""
    s = complex(s)
    real = (s * s).imag == 0.0 and (s.imag == 0.0 or not (D or G))
    return ("" if real else "complex-") + ("unsymmetric" if N or (G and s) else "symmetric")


def _add(data: Values, place: Values, factor: complex, values: Values) -> None:
    """data[place] += factor * values, in pieces."""
    for first in range(0, len(place), TOL.entries_at_once):
        part = slice(first, first + TOL.entries_at_once)
        data[place[part]] += factor * values[part]


def with_fixed_rows(A: Lower, rows: NDArray[np.int64]) -> Lower:
    """``A`` on the subspace where ``rows`` vanish, padded there with its largest diagonal: same pattern.

    Works in place: the values of ``A`` are lost.
    """
    data = A.data
    on = np.zeros(A.n, dtype=bool)
    on[rows] = True
    scale = float(np.abs(A.diagonal()).max())
    for first in range(0, A.n, TOL.entries_at_once >> 5):
        last = min(first + (TOL.entries_at_once >> 5), A.n)
        begin, end = A.indptr[first], A.indptr[last]
        column = np.repeat(np.arange(first, last), np.diff(A.indptr[first : last + 1]))
        row = A.indices[begin:end]
        out = on[column] | on[row]
        data[begin:end][out] = np.where(row[out] == column[out], scale, 0.0)
    return replace(A, data=data)


def spring_stiffness(A: Lower, rows: NDArray[np.int64]) -> Values:
    """Stiffness (k,) of springs to the ground at ``rows``: their diagonal, or the largest of all where it is zero."""
    diagonal = A.diagonal()
    return np.where(diagonal[rows] != 0, diagonal[rows], np.abs(diagonal).max(initial=0.0) or 1.0)


def with_springs(A: Lower, rows: NDArray[np.int64]) -> Lower:
    """``A`` with springs of ``spring_stiffness`` to the ground at ``rows``."""
    data = current_budget().empty(A.nnz, A.data.dtype)
    data[:] = A.data
    # The first entry of a column is its diagonal, as a stiffness has one in every row, or the mass.
    first = A.indptr[rows]
    if (first == A.indptr[rows + 1]).any() or not np.array_equal(A.indices[first], rows):
        raise InputError(
            "the stiffness matrix has rows without a diagonal entry; remove these dofs", kind="model", keyword="K"
        )
    data[first] += spring_stiffness(A, rows)
    return replace(A, data=data)


def _widen(A: Lower, other: Lower) -> Lower:
    """``A`` with explicit zeros where only ``other`` has entries: these are few as a rule."""
    budget = current_budget()
    missing = np.flatnonzero(_places(A, other) < 0)
    column = np.searchsorted(other.indptr, missing, side="right") - 1
    added = np.cumsum(np.bincount(column + 1, minlength=A.n + 1))
    size = A.nnz + len(missing)
    indptr = (A.indptr + added).astype(np.int32 if size <= np.iinfo(np.int32).max else np.int64)
    indices, data = budget.empty(size, A.indices.dtype), budget.empty(size, A.data.dtype)
    rows = _rows_at_once(A)
    for first in range(0, A.n, rows):
        last = min(first + rows, A.n)
        before, after = slice(A.indptr[first], A.indptr[last]), slice(indptr[first], indptr[last])
        part = slice(*np.searchsorted(column, [first, last]))
        row = other.indices[missing[part]]
        at = np.searchsorted(_keys(A, first, last), (column[part] - first) * A.n + row)
        indices[after], data[after] = np.insert(A.indices[before], at, row), np.insert(A.data[before], at, 0.0)
        budget.release_if_tight()
    return Lower(indptr, indices, data)


def _rows_at_once(A: Lower) -> int:
    return max(1, int(TOL.entries_at_once * A.n / max(A.nnz, 1)))


def _places(A: Lower, other: Lower) -> Values:
    """Where (nnz of other,) each entry of ``other`` lies in ``A``; -1 where it does not."""
    budget = current_budget()
    place = budget.empty(other.nnz, A.indptr.dtype)
    rows = _rows_at_once(A)
    for first in range(0, A.n, rows):
        last = min(first + rows, A.n)
        keys = [_keys(B, first, last) for B in (A, other)]
        begin, end = other.indptr[first], other.indptr[last]
        at = np.searchsorted(keys[0], keys[1])
        missing = at == len(keys[0])
        at[missing] = 0
        missing |= keys[0][at] != keys[1] if len(keys[0]) else True
        place[begin:end] = np.where(missing, -1, at + A.indptr[first])
        budget.release_if_tight()
    return place


def _keys(A: Lower, first: int, last: int) -> NDArray[np.int64]:
    """One ascending number for each entry of the columns ``first`` to ``last``."""
    column = np.repeat(np.arange(last - first, dtype=np.int64), np.diff(A.indptr[first : last + 1]))
    return np.asarray(column * A.n + A.indices[A.indptr[first] : A.indptr[last]], dtype=np.int64)
