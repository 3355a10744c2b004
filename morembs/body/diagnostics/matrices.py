"""What can be seen in a matrix alone: shape, values, symmetry, half-stored triangles, definiteness, empty rows.

All passes go over pieces of rows, so that temporaries stay small beside the matrix.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.budget import current_budget
from morembs.base.types import Floats, Ints
from morembs.body.diagnostics.findings import Finding, Names, list_labels
from morembs.body.diagnostics.tolerances import TOL
from morembs.linalg.congruence import magnitudes

WORDS = {"K": "the stiffness matrix K", "M": "the mass matrix M", "D": "the damping matrix D"}


def canonical(A: sp.sparray, name: str) -> tuple[sp.csr_array, list[Finding]]:
    """``A`` as real CSR with sorted indices and no duplicates, copied only where needed."""
    findings = []
    if np.iscomplexobj(A.data):
        imaginary = float(np.abs(A.data.imag).max(initial=0.0))
        if imaginary:
            sentence = f"{WORDS[name]} has complex values (imaginary parts up to {imaginary:.3g})"
            cure = "only the real parts are examined; give structural damping as a loss factor"
            findings.append(Finding(code="complex", severity="note", sentence=sentence, cure=cure))
        A = A.real
    whole = A if isinstance(A, sp.csr_array) and A.dtype == np.float64 else sp.csr_array(A, dtype=np.float64)
    if not whole.has_canonical_format:
        whole = whole.copy() if whole is A else whole
        whole.sum_duplicates()
    return whole, findings


def pieces(A: sp.csr_array) -> Iterator[tuple[int, int, Ints, Ints, Floats]]:
    """First and last row of a piece, and rows, columns and values of its entries."""
    for first in range(0, A.shape[0], TOL.rows_at_once):
        last = min(first + TOL.rows_at_once, A.shape[0])
        begin, end = A.indptr[first], A.indptr[last]
        row = np.repeat(np.arange(first, last), np.diff(A.indptr[first : last + 1]))
        yield first, last, row, A.indices[begin:end], A.data[begin:end]


def values(A: sp.csr_array, name: str, names: Names) -> list[Finding]:
    """Entries that are not finite, and a matrix without any."""
    bad = [row[~np.isfinite(value)] for _, _, row, _, value in pieces(A)]
    rows = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *bad]))
    if len(rows):
        labels, words = names.places(rows)
        sentence = f"{WORDS[name]} has {sum(map(len, bad))} entries that are not finite numbers, at {words}"
        cure = "export it again, and look for missing material data there"
        return [Finding(code="not-finite", severity="error", sentence=sentence, cure=cure, where=labels)]
    if not A.data.any():
        sentence = f"{WORDS[name]} is zero"
        severity = "note" if name == "D" else "error"
        return [Finding(code="zero-matrix", severity=severity, sentence=sentence, cure="check the export")]
    return []


def symmetry(A: sp.csr_array, name: str, names: Names) -> tuple[sp.csr_array, list[Finding]]:
    """The whole symmetric matrix and what was wrong with ``A``: half stored, or not symmetric.

    Products with a random vector find a difference without a copy; only then are the triangles compared.
    """
    # No component is small: each entry counts.
    x = np.random.default_rng(3).uniform(0.5, 1.5, A.shape[0]) * _scale(A)
    size = np.maximum(magnitudes(A, x[:, None])[:, 0], sizes_of_columns(A, x))
    if (np.abs(A @ x - A.T @ x) <= TOL.same_entry * size).all():
        return A, []
    half = half_stored(A)
    if half:
        cure = "repaired() completes it; or export both triangles"
        sentence = f"{WORDS[name]} holds only {half} (no off-diagonal entry has its mirror image)"
        return complete_triangles(A), [Finding(code="half-stored", severity="error", sentence=sentence, cure=cure)]
    return _not_symmetric(A, name, names)


def _scale(A: sp.csr_array) -> Floats:
    d = np.abs(A.diagonal())
    return np.asarray(np.divide(1.0, np.sqrt(d), out=np.ones(len(d)), where=d > 0))


def sizes_of_columns(A: sp.csr_array, x: Floats) -> Floats:
    """|A|' |x| (N,)."""
    total = np.zeros(A.shape[1])
    for _, _, row, column, value in pieces(A):
        total += np.bincount(column, np.abs(value) * np.abs(x[row]), A.shape[1])
    return total


def half_stored(A: sp.csr_array) -> str:
    """Words for the half that ``A`` holds; empty where both are there or there is nothing off the diagonal."""
    lower = upper = 0
    for _, _, row, column, value in pieces(A):
        lower += int(np.count_nonzero(value[column < row]))
        upper += int(np.count_nonzero(value[column > row]))
    if lower + upper == 0:
        return ""
    if not upper:
        return "its lower triangle"
    if not lower:
        return "its upper triangle"
    mask = sp.csr_array(((A.data != 0).astype(np.int8), A.indices, A.indptr), shape=A.shape)
    mask.setdiag(0)
    both = mask.multiply(mask.T)
    return "" if both.nnz and both.data.any() else "one half, some entries above and some below its diagonal"


def complete_triangles(A: sp.csr_array) -> sp.csr_array:
    """Both triangles of a half-stored ``A``. Peak memory: twice the result."""
    whole = sp.csr_array(A + A.T - sp.diags_array(A.diagonal()))
    whole.sort_indices()
    return whole


def _not_symmetric(A: sp.csr_array, name: str, names: Names) -> tuple[sp.csr_array, list[Finding]]:
    mirror = sp.csr_array(A.T)
    difference = sp.coo_array(A - mirror)
    d = np.sqrt(np.maximum(np.abs(A.diagonal()), np.finfo(float).tiny))
    row, column = difference.coords
    size = np.abs(difference.data)
    scale = np.maximum(d[row] * d[column], np.maximum(*_largest(A, row, column)))
    bad = np.flatnonzero((size > TOL.same_entry * scale) & (row < column))
    bad = bad[np.argsort(-size[bad], kind="stable")]
    symmetric = sp.csr_array((A + mirror) * 0.5)
    symmetric.sort_indices()
    if not len(bad):
        return symmetric, []
    relative = float((size[bad] / np.maximum(scale[bad], np.finfo(float).tiny)).max())
    i, j = row[bad[0]], column[bad[0]]
    pair = names.dof_labels(np.array([i, j]))
    labels = names.places(np.unique(np.concatenate([row[bad], column[bad]])))[0]
    sentence = (
        f"{WORDS[name]} is not symmetric: {len(bad)} pairs of entries differ, most between {pair[0]} and {pair[1]} "
        f"({A[i, j]:.6g} and {A[j, i]:.6g})"
    )
    severity, cure = (
        "error",
        'take [model] unsymmetric = "split" where gyroscopic or circulatory terms are meant, or export it again',
    )
    if relative < TOL.rounded_entry:
        severity, cure = "warning", "it looks like rounded numbers: take the mean of both, (A + A')/2"
    return symmetric, [Finding(code="not-symmetric", severity=severity, sentence=sentence, cure=cure, where=labels)]


def _largest(A: sp.csr_array, row: Ints, column: Ints) -> tuple[Floats, Floats]:
    """Largest magnitude of the rows ``row`` and ``column`` where the diagonal is zero, else 0."""
    largest = np.zeros(A.shape[0])
    for _, _, rows, _, value in pieces(A):
        np.maximum.at(largest, rows, np.abs(value))
    largest[A.diagonal() != 0] = 0.0
    return largest[row], largest[column]


def definiteness(A: sp.csr_array, name: str, names: Names) -> list[Finding]:
    """Proofs that a symmetric ``A`` is indefinite: its diagonal, 2 by 2 minors, a few steps of Lanczos."""
    severity = "warning" if name == "D" else "error"
    d = A.diagonal()
    negative = np.flatnonzero(d < 0)
    if len(negative):
        labels, words = names.places(negative)
        sentence = f"{WORDS[name]} is indefinite: its diagonal is negative at {words}, down to {d[negative].min():.4g}"
        return [Finding(code="indefinite", severity=severity, sentence=sentence, cure=_CURES[name], where=labels)]
    minors, root = [], np.sqrt(d)
    for _, _, row, column, value in pieces(A):
        # Roots first: their product neither overflows nor underflows.
        bad = (row != column) & (np.abs(value) > (1 + TOL.negative_quotient) * root[row] * root[column]) & (value != 0)
        minors.append(row[bad])
    rows = np.unique(np.concatenate(minors))
    if len(rows):
        labels, words = names.places(rows)
        what = "zero on its diagonal beside other entries" if (d[rows] == 0).any() else "off-diagonal entries too large"
        sentence = f"{WORDS[name]} is indefinite: {what} at {words}"
        cure = "take out Lagrange multipliers (eliminate the constraints)" if (d[rows] == 0).any() else _CURES[name]
        return [Finding(code="indefinite", severity=severity, sentence=sentence, cure=cure, where=labels)]
    quotient, x = lowest(A)
    if quotient >= -TOL.negative_quotient:
        return []
    worst = np.flatnonzero(np.abs(x) > TOL.named_motion * np.abs(x).max())
    labels, words = names.places(worst[np.argsort(-np.abs(x[worst]), kind="stable")])
    sentence = f"{WORDS[name]} is indefinite: a motion about {words} has negative energy"
    return [Finding(code="indefinite", severity=severity, sentence=sentence, cure=_CURES[name], where=labels)]


_CURES = {
    "K": "look for negative springs, inverted elements or a preload beyond buckling there",
    "M": "look for negative densities or point masses there",
    "D": "look for negative dampers there",
}


def lowest(A: sp.csr_array) -> tuple[float, Floats]:
    """Upper bound of the lowest eigenvalue of S A S, S = |diag A|^-1/2, and its vector (N,), by Lanczos steps.

    Peak memory: 17 columns of length N.
    """
    n = A.shape[0]
    S = _scale(A)
    S[A.diagonal() == 0] = 0.0
    steps = min(TOL.lanczos_steps, n)
    V = current_budget().empty((n, steps), order="F")
    q = np.random.default_rng(4).standard_normal(n) * (S > 0)
    q /= max(float(np.linalg.norm(q)), np.finfo(float).tiny)
    diagonal, beside = [], []
    for k in range(steps):
        V[:, k] = q
        w = S * (A @ (S * q))
        diagonal.append(float(q @ w))
        # Twice is enough against all of so few vectors.
        for _ in range(2):
            w -= V[:, : k + 1] @ (V[:, : k + 1].T @ w)
        size = float(np.linalg.norm(w))
        if size < TOL.invariant_space or k + 1 == steps:
            break
        beside.append(size)
        q = w / size
    m = len(diagonal)
    theta, Y = sl.eigh_tridiagonal(np.array(diagonal), np.array(beside[: m - 1]), select="i", select_range=(0, 0))
    return float(theta[0]), np.asarray(V[:, :m] @ Y[:, 0])


def empty_and_massless(K: sp.csr_array, M: sp.csr_array, names: Names) -> list[Finding]:
    """Dofs without stiffness, without mass, or without both; coordinates without places may be rigid motions."""
    stiff, heavy = (_row_has_values(A) for A in (K, M))
    findings = []
    groups = (
        ("empty-dofs", "error", ~stiff & ~heavy, "neither stiffness nor mass"),
        ("no-stiffness", "error" if names.dofs is not None else "note", ~stiff & heavy, "mass but no stiffness"),
    )
    for code, severity, where, words in groups:
        rows = np.flatnonzero(where)
        if len(rows):
            labels, places = names.places(rows)
            sentence = f"{len(rows)} dofs have {words}: {places}"
            cure = "" if severity == "note" else "leave these dofs out, or join their nodes to the structure"
            findings.append(Finding(code=code, severity=severity, sentence=sentence, cure=cure, where=labels))
    return findings + _massless(np.flatnonzero(stiff & ~heavy), names)


def _massless(rows: Ints, names: Names) -> list[Finding]:
    if not len(rows):
        return []
    labels, places = names.places(rows)
    turning = names.dofs is not None and bool(names.dofs.turning[rows].all())
    sentence = f"{len(rows)} {'rotations' if turning else 'dofs'} have stiffness but no mass: {places}"
    cure = (
        "as lumped masses have it; reduce with statics or condense them"
        if turning
        else "look for a part without density or lumped masses that were left out; else condense these dofs statically"
    )
    return [
        Finding(code="massless", severity="note" if turning else "warning", sentence=sentence, cure=cure, where=labels)
    ]


def _row_has_values(A: sp.csr_array) -> NDArray[np.bool_]:
    count = np.zeros(A.shape[0], dtype=np.int64)
    for first, last, row, _, value in pieces(A):
        count[first:last] = np.bincount(row - first, value != 0, last - first)
    return count > 0


def duplicate_rows(K: sp.csr_array, M: sp.csr_array, names: Names) -> list[Finding]:
    """Dofs whose rows of K are equal, and those of M: one dof written twice.

    Where M tells them apart their difference is a motion without energy, which has mass.
    """
    key = np.random.default_rng(6).uniform(1.0, 2.0, K.shape[0])
    product, size = K @ key, magnitudes(K, key[:, None])[:, 0]
    order = np.lexsort((product, size))
    near = np.abs(np.diff(product[order])) <= TOL.equal_rows * size[order][1:]
    near &= (size[order][1:] > 0) & (np.abs(np.diff(size[order])) <= TOL.equal_rows * size[order][1:])
    max_pairs = TOL.compared_pairs
    pairs = [
        (a, b)
        for a, b in zip(order[:-1][near][:max_pairs].tolist(), order[1:][near][:max_pairs].tolist(), strict=True)
        if all(abs(A[[a], :] - A[[b], :]).max() <= TOL.equal_rows * abs(A[[a], :]).sum() for A in (K, M))
    ]
    if not pairs:
        return []
    first = list_labels(names.dof_labels(np.array(pairs[0])))
    labels = names.places(np.unique(np.array(pairs).ravel()))[0]
    sentence = f"{len(pairs)} pairs of dofs have equal rows in the matrices K and M, the first {first}"
    cure = "leave one dof of each pair out"
    return [Finding(code="duplicate-dofs", severity="error", sentence=sentence, cure=cure, where=labels)]
