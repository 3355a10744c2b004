"""Motions without energy of a positive semidefinite matrix, found from the matrix alone.

Groups of rows that no entry couples have null spaces of their own. Each is scaled to a unit diagonal, so that units of
its rows do not matter, and its eigenvalues are compared with what round-off leaves of zero ones.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.base.types import Floats, Ints
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.tolerances import TOL


def groups_of(A: sp.csr_array) -> tuple[int, Ints]:
    """How many groups of rows no entry of the symmetric ``A`` (n, n) couples, and the group (n,) of each row."""
    # The pattern is symmetric, so strong components are the groups, and SciPy makes no copy for them.
    count, label = connected_components(A, directed=True, connection="strong")
    return int(count), label.astype(np.int64)


def null_space(A: sp.csr_array, solver: LinearSolver, rounding: float = 0.0) -> Floats:
    """Basis (n, r) of the null space of a positive semidefinite ``A``, whose entries are known to ``rounding``.

    Peak memory: a dense copy of the largest group up to ``TOL.dense_rows`` rows, or its factor.

    Raises:
        SolverError: the factorisation of a larger group failed; a SingularMatrixError where it is indefinite.
    """
    count, label = groups_of(A)
    size = np.bincount(label, minlength=count)
    # A row that is coupled to none is a motion where its entry is zero.
    alone = np.flatnonzero((size[label] == 1) & (A.diagonal() == 0))
    columns: list[tuple[Ints, Floats]] = [(alone[[i]], np.ones((1, 1))) for i in range(len(alone))]
    order, ends = np.argsort(label, kind="stable"), np.cumsum(size)
    for number in np.flatnonzero(size > 1):
        rows = order[ends[number] - size[number] : ends[number]]
        columns.append((rows, _null_space_of_group(sp.csr_array(A[rows][:, rows]), solver, rounding)))
    result = np.zeros((A.shape[0], sum(Z.shape[1] for _, Z in columns)))
    at = 0
    for rows, Z in columns:
        result[rows, at : at + Z.shape[1]] = Z
        at += Z.shape[1]
    return result


def _null_space_of_group(A: sp.csr_array, solver: LinearSolver, rounding: float) -> Floats:
    d = np.abs(A.diagonal())
    scale = sp.diags_array(1.0 / np.sqrt(np.where(d > 0, d, 1.0)))
    unit = sp.csr_array(scale @ A @ scale)
    values, Y = sl.eigh(unit.toarray()) if A.shape[0] <= TOL.dense_rows else _lowest(unit, solver, rounding)
    zero = np.abs(values) <= max(TOL.zero_eigenvalue * A.shape[0], rounding)
    return np.asarray(scale @ Y[:, zero])


def _lowest(A: sp.csr_array, solver: LinearSolver, rounding: float) -> tuple[Floats, Floats]:
    """More of the lowest eigenvalues (k,) of ``A`` (n, n) than are zero, and their vectors (n, k)."""
    n, width = A.shape[0], TOL.null_space_columns
    shift = max(TOL.null_space_shift, 10 * rounding)
    with solver.factorize(sp.csr_array(A + shift * sp.eye_array(n)), "spd", what="K + sigma I") as factor:
        while True:
            Y = np.random.default_rng(21).standard_normal((n, min(width, n)))
            for _ in range(TOL.null_space_steps):
                Y = sl.qr(factor.solve(Y), mode="economic")[0]
            values, Q = sl.eigh(Y.T @ (A @ Y))
            if values[-1] > shift or width >= n:
                return values, Y @ Q
            width *= 2
