"""Lowest modes of a constrained body, proven complete by a Sturm count."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.linalg.columns import dense, fix_signs, m_norms
from morembs.linalg.dense import symmetric
from morembs.linalg.eigen_cost import block_width, is_dense_cheaper, slice_width
from morembs.linalg.lanczos import BlockLanczos, largest
from morembs.linalg.massless import split_massless
from morembs.linalg.second_shift import first_look, keeps_two_factors, modes_below
from morembs.linalg.slicing import gap_after, sliced_modes
from morembs.linalg.space import Space
from morembs.linalg.sparse.threads import limit_threads
from morembs.linalg.statics import ConstrainedStatics
from morembs.linalg.sturm import ShiftedInverse, count_below, off_eigenvalues
from morembs.linalg.tolerances import TOL

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Modes:
    """``eigenvalues`` (m,) in (rad/s)2 ascending, ``vectors`` (N, m) M-orthonormal.

    ``verified_below`` is the eigenvalue below which no mode is missing: a Sturm count proved it where modes are
    ``counted``; otherwise LAPACK found all modes of the dense pencil.
    """

    eigenvalues: Floats
    vectors: Floats
    verified_below: float
    counted: bool = True

    @property
    def frequencies_hz(self) -> Floats:
        """Frequencies (m,) in Hz."""
        return np.asarray(eigenvalue_in_hz(self.eigenvalues))

    def first(self, count: int) -> Modes:
        """The lowest ``count`` of these modes."""
        verified_below = self.verified_below if count >= len(self.eigenvalues) else float(self.eigenvalues[count])
        return replace(
            self, eigenvalues=self.eigenvalues[:count], vectors=self.vectors[:, :count], verified_below=verified_below
        )


def lowest_modes(
    body: ConstrainedStatics,
    M: sp.csr_array,
    *,
    count: int | None = None,
    below: float | None = None,
    what: str = "modes",
    by_lapack: bool | None = None,
    per_slice: int | None = None,
) -> Modes:
    """The lowest ``count`` modes, or all with eigenvalues up to ``below`` in (rad/s)2.

    Args:
        by_lapack: from dense matrices (True) or by block Lanczos (False); by default what the size is for.
        per_slice: modes of a slice, where there are so many that they are found slice by slice; by default by cost.

    Raises:
        InputError: more modes than the restricted body has.
        SolverError: no convergence, or the Sturm count still finds a missing mode.
    """
    size, shifted = M.shape[0] - body.count, None
    if count is None:
        if below is None:
            raise InputError("lowest_modes needs either count or below", kind="missing")
        # Up to the limit and including it: a mode, or a cluster, right at the limit belongs to it whole.
        below *= 1 + TOL.eigenvalue_gap
        if not (M.shape[0] <= TOL.dense_rows if by_lapack is None else by_lapack):
            count, shifted = _up_to(body, M, below)
            if count > TOL.most_modes and M.shape[0] > TOL.small_rows:
                raise InputError(
                    f"{count} {what} lie below {eigenvalue_in_hz(below):.6g} Hz, more than {TOL.most_modes}; "
                    "lower the limit"
                )
    if count is not None and count > size:
        raise InputError(_too_many(what, count, size))
    if by_lapack is None:
        rows, left = M.shape[0], body.statics.budget.bytes_left()
        by_lapack = rows <= TOL.dense_rows or (count is not None and is_dense_cheaper(rows, count, left))
    if by_lapack:
        return _dense(body, M, count, below)
    if not count:
        return Modes(eigenvalues=np.zeros(0), vectors=np.zeros((M.shape[0], 0)), verified_below=below or 0.0)
    per_slice = slice_width(body.statics.factor.stats) if per_slice is None else per_slice
    # Threads that wait for each other in small products take the processor from whoever works beside.
    with limit_threads(1 if M.shape[0] <= TOL.one_thread_rows else None):
        if count > TOL.least_slices * per_slice:
            if shifted is not None:
                shifted.close()
            return _find_by_slices(body, M, count, below, what, per_slice)
        return _sparse(body, M, count, below, what, shifted)


def _up_to(body: ConstrainedStatics, M: sp.csr_array, below: float) -> tuple[int, ShiftedInverse | None]:
    """How many modes lie below, and the factor that counted them where it will be of use."""
    if keeps_two_factors(body) and M.shape[0] > TOL.small_rows:
        try:
            shifted = off_eigenvalues(below, partial(ShiftedInverse, body))
            return shifted.below, shifted
        except SolverError as error:
            log.info("no second shift: %s", error)
    return count_below(body, below), None


def _dense(body: ConstrainedStatics, M: sp.csr_array, count: int | None, below: float | None) -> Modes:
    # Displacements and rotations count alike, independent of their units.
    s = 1.0 / np.sqrt(np.maximum(body.statics.pencil.lower.diagonal(), np.finfo(float).tiny))[:, None]
    C = s * dense(body.C)
    Q = s * (sl.qr(C)[0][:, C.shape[1] :] if C.shape[1] else np.eye(M.shape[0]))
    K = Q.T @ (body.statics.pencil.lower @ Q)
    Mq = Q.T @ (M @ Q)
    values, vectors = _dense_pencil(symmetric(K), symmetric(Mq))
    vectors = Q @ vectors
    # LAPACK has the lowest modes to eps of the highest eigenvalue only.
    soft = int((values < TOL.soft_eigenvalue * values[-1]).sum()) if len(values) else 0
    if soft:
        values[:soft], vectors[:, :soft] = _refine_by_inverse_iteration(body, M, vectors[:, :soft])
    m = int((values <= below).sum()) if count is None and below is not None else count
    vectors = fix_signs(vectors[:, :m])
    # All modes are known here, but only those that are returned count as held.
    verified_below = float(values[m]) if m is not None and m < len(values) else np.inf
    return Modes(eigenvalues=values[:m], vectors=vectors, verified_below=verified_below, counted=False)


def _refine_by_inverse_iteration(body: ConstrainedStatics, M: sp.csr_array, V: Floats) -> tuple[Floats, Floats]:
    """Modes near span(V) (N, k), M-orthonormal, by inverse iteration: to eps of the vectors that they combine."""
    for _ in range(2):
        V = body.flexibility(M @ V)
        V /= m_norms(V, M @ V)
        K, G = V.T @ (body.statics.pencil.lower @ V), V.T @ (M @ V)
        # The inverse pencil has its largest values, which LAPACK computes best, for the lowest modes.
        theta, Y = sl.eigh(symmetric(G), symmetric(K))
        values, V = 1.0 / theta[::-1], V @ (Y[:, ::-1] / np.sqrt(theta[::-1]))
    return values, V


def accurate_eigh(
    A: Floats, M: Floats | None = None, projected: Callable[[Floats], Floats] | None = None
) -> tuple[Floats, Floats]:
    """Eigenvalues (n,) of (``A``, ``M``), ascending, and vectors (n, n), where LAPACK has all to eps of the highest.

    Values below ``TOL.soft_eigenvalue`` of the highest are found again in the span of their vectors alone, and so on:
    all are known to eps / ``TOL.soft_eigenvalue`` of themselves as far as A is. ``projected`` gives Y' A Y of some
    vectors Y (n, k), by default from ``A``; M = I by default.
    """
    values, Y = sl.eigh(A, M)
    soft = int((values < TOL.soft_eigenvalue * values[-1]).sum()) if len(values) else 0
    while soft:
        soft_vectors = Y[:, :soft]
        part = soft_vectors.T @ A @ soft_vectors if projected is None else projected(soft_vectors)
        values[:soft], Q = sl.eigh(symmetric(part))
        Y[:, :soft] = soft_vectors @ Q
        # At least the highest of them is known now.
        soft = min(soft - 1, int((values[:soft] < TOL.soft_eigenvalue * values[soft - 1]).sum()))
    return values, Y


def modes_with_mass(K: Floats, M: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues (k,), ascending, and M-orthonormal vectors (n, k) of the motions that have mass."""
    split = split_massless(K, M)
    if split is None:
        values, Y = sl.eigh(K, M)
        return values, Y
    values, Y = sl.eigh(symmetric(split.P.T @ K @ split.P), symmetric(split.P.T @ M @ split.P))
    return values, split.P @ Y


def modes_without_mass_last(A: Floats, M: Floats) -> tuple[Floats, Floats]:
    """``accurate_eigh`` of an M that may be singular: motions without mass come last, with the eigenvalue infinity and
    unit stiffness (n, n).

    Raises:
        InputError: a motion that has neither mass nor stiffness.
    """
    split = split_massless(A, M)
    if split is None:
        return accurate_eigh(A, M)
    P, Z = split.P, split.Z
    values, Y = accurate_eigh(symmetric(P.T @ A @ P), symmetric(P.T @ M @ P))
    return np.concatenate([values, np.full(Z.shape[1], np.inf)]), np.hstack([P @ Y, Z])


def _dense_pencil(K: Floats, M: Floats) -> tuple[Floats, Floats]:
    """All finite modes of a dense pencil with K positive definite and M at least semidefinite."""
    try:
        values, vectors = sl.eigh(K, M)
    except np.linalg.LinAlgError:
        # M is singular (massless motions, reduced integration): the inverse pencil has 0 for infinity.
        theta, vectors = sl.eigh(M, K)
        finite = theta > np.finfo(float).eps * len(K) * theta[-1]
        values, vectors = 1.0 / theta[finite], vectors[:, finite] / np.sqrt(theta[finite])
        order = np.argsort(values)
        values, vectors = values[order], vectors[:, order]
    return values, vectors


def _sparse(
    body: ConstrainedStatics,
    M: sp.csr_array,
    count: int,
    below: float | None,
    what: str,
    shifted: ShiftedInverse | None = None,
) -> Modes:
    """Modes by block Lanczos, at shift zero and then at that of the Sturm count where its factor may be kept."""
    lanczos = _space(body, M, count)
    if keeps_two_factors(body) and (count > TOL.one_factor_modes or shifted is not None):
        cut = first_look(lanczos, count, what=what)
        try:
            if shifted is None and cut is not None:
                shifted = off_eigenvalues(cut, partial(ShiftedInverse, body))
        except SolverError as error:
            log.info("no second shift: %s", error)
        if shifted is not None and cut is not None:
            with shifted:
                values, vectors = modes_below(lanczos, shifted, what=what)
            vectors = body.statics.space.fix_signs(vectors[:, :count])
            verified_below = max(shifted.sigma, below or 0.0) if len(values) == count else float(values[count])
            return Modes(eigenvalues=values[:count], vectors=vectors, verified_below=verified_below)
    return _find_by_counting(body, M, lanczos, count, below, what)


def _find_by_slices(
    body: ConstrainedStatics, M: sp.csr_array, count: int, below: float | None, what: str, per_slice: int
) -> Modes:
    """Modes slice by slice, the first at shift zero, whose factor is there."""
    theta, Y = largest(_space(body, M, per_slice), per_slice, what=what)
    # The last ones have their tolerance and no more: the first slice finds these again, and better.
    known = int(TOL.known_part * per_slice)
    theta, Y = theta[:known], Y[:, :known]
    values, vectors, proven = sliced_modes(body, M, 1.0 / theta, Y, count=count, below=below, per_slice=per_slice)
    vectors = body.statics.space.fix_signs(vectors)
    return Modes(eigenvalues=values, vectors=vectors, verified_below=proven if below is None else below)


def _space(body: ConstrainedStatics, M: sp.csr_array, count: int) -> BlockLanczos:
    """A Krylov space at shift zero for ``count`` modes, of one block."""
    start = _start(body, M, count)
    capacity = min(3 * (count + 2) + 8 * start.shape[1], M.shape[0] - body.count)
    return BlockLanczos(body.flexibility, Space(M, budget=body.statics.budget), start, capacity=capacity)


def _start(body: ConstrainedStatics, M: sp.csr_array, count: int) -> Floats:
    """Displacements (N, k) under random inertia loads, some of which have been solved for with the constraints."""
    solved = body.take_ahead()
    if solved is None:
        return body.flexibility(start_loads(M, _block(body, count)))
    return body.constrain(solved, start_loads(M, solved.shape[1]))[0]


def _find_by_counting(
    body: ConstrainedStatics, M: sp.csr_array, lanczos: BlockLanczos, count: int, below: float | None, what: str
) -> Modes:
    """Modes by block Lanczos at shift zero, counted afterwards."""
    wanted = min(count if below is not None else count + 2, M.shape[0] - body.count)
    for _ in range(TOL.count_attempts):
        theta, Y = largest(lanczos, wanted, what=what)
        values = 1.0 / theta
        if len(values) < count:
            raise InputError(_too_many(what, count, len(values)), keyword="count")
        cut = below if below is not None else gap_after(values, count)
        if cut is None and len(values) < wanted:
            cut = 2 * values[-1]  # no motion beyond these has mass
        if cut is None:
            wanted = min(wanted + lanczos.block, M.shape[0] - body.count)
            continue
        counted = int((values < cut).sum())
        lanczos.store()
        true = count if below is not None else count_below(body, cut)
        log.info("Sturm count: %d %s below %.6g Hz, %d found", true, what, eigenvalue_in_hz(cut), counted)
        if counted == true:
            vectors = body.statics.space.fix_signs(Y[:, :count])
            verified_below = float(cut) if counted == count else float(values[count])
            return Modes(eigenvalues=values[:count], vectors=vectors, verified_below=verified_below)
        wanted = max(wanted, true + 2)
    raise SolverError(
        f"the Sturm count finds {true} {what} below {eigenvalue_in_hz(cut):.6g} Hz, the eigensolver {counted}; "
        "ask for a few modes more or less, so that the limit does not cut a cluster"
        if cut is not None
        else f"the first {wanted} {what} lie in one cluster; ask for more of them",
        keyword="count",
    )


def _too_many(what: str, count: int, size: int) -> str:
    return f"{count} {what} were asked for, but only {size} degrees of freedom with mass are left; ask for fewer"


def _block(body: ConstrainedStatics, count: int) -> int:
    """Width of the Krylov blocks: a factor on disk is read as a whole for each of them, so they are wide there."""
    if not body.statics.factor.stats.out_of_core:
        return block_width(body.statics.factor.stats, count)
    return body.statics.block_columns(max(TOL.wide_block, count + 2))


def start_loads(M: sp.csr_array, columns: int) -> Floats:
    """Loads (N, k) that a Krylov space begins with: of random motions."""
    return np.asarray(M @ np.random.default_rng(2).standard_normal((M.shape[0], columns)))
