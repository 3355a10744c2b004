"""The lower triangle of a symmetric matrix, and s^2 M + s D + K on one pattern."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.budget import Budget
from morembs.base.errors import InputError, SingularMatrixError
from morembs.linalg.dynamic_stiffness import DynamicStiffness, with_fixed_rows, with_springs
from morembs.linalg.sparse.superlu import SuperLU
from morembs.linalg.sparse.symmetric import Lower
from tests.support.matrices import backward_error, brick, chain, damped, mass, random
from tests.support.refusals import Refusal, refusal
from tests.support.solvers import CountingSolver

SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 3.0]])


@pytest.fixture(params=["real", "complex", "no diagonal", "one row"])
def dense(request: pytest.FixtureRequest) -> np.ndarray:
    """Matrices with stored values; the third has rows whose diagonal is not stored."""
    return {
        "real": brick(3).toarray(),
        "complex": damped(chain(9), 1.3).toarray(),
        "no diagonal": SWAP,
        "one row": np.array([[-2.0]]),
    }[request.param]


@pytest.mark.parametrize("kind", [sp.csr_array, sp.csc_array, sp.coo_array])
def test_triangle_by_columns(dense: np.ndarray, kind: type) -> None:
    lower = Lower.of(kind(dense))
    n = len(dense)
    half = sp.csc_array((lower.data, lower.indices, lower.indptr), shape=(n, n))
    np.testing.assert_array_equal(half.toarray(), np.tril(dense))
    assert half.has_canonical_format
    assert (lower.n, lower.nnz) == (n, np.count_nonzero(np.tril(dense)))
    np.testing.assert_array_equal(lower.columns(), np.nonzero(np.tril(dense).T)[0])
    np.testing.assert_array_equal(lower.full().toarray(), dense)
    np.testing.assert_array_equal(lower.diagonal(), np.diag(dense))
    np.testing.assert_allclose(lower.largest_in_rows(), np.abs(dense).max(axis=1), rtol=1e-15)
    assert Lower.of(lower) is lower


def test_product_is_that_of_the_whole_matrix(dense: np.ndarray) -> None:
    lower = Lower.of(sp.csr_array(dense))
    for X in (random(len(dense)), random(len(dense), 5), random(len(dense), 5) * (1 - 2j), random(len(dense), 0)):
        before = X.copy()
        np.testing.assert_allclose(lower @ X, dense @ X, rtol=0, atol=1e-14 * np.abs(dense).sum())
        np.testing.assert_array_equal(X, before)


def test_large_matrices_are_handled_in_pieces() -> None:
    """Some 100,000 rows and 1.2 million entries, against SciPy, which makes all of it at once."""
    n = 101_000
    bands = [1.0 + 0.3 * np.sin(np.arange(n - k)) for k in range(12)]
    half = sp.diags_array(bands, offsets=range(0, -12, -1), shape=(n, n), format="csr")
    A = sp.csr_array(half + sp.tril(half, -1).T + 40.0 * sp.eye_array(n))
    lower = Lower.of(A)
    pieces = sp.csc_array((lower.data, lower.indices, lower.indptr), shape=A.shape)
    assert abs(sp.tril(A, format="csc") - pieces).max() == 0
    X = random(n, 2)
    np.testing.assert_allclose(lower @ X, A @ X, rtol=0, atol=1e-12)
    np.testing.assert_allclose(lower.largest_in_rows(), abs(A).max(axis=1).toarray().ravel(), rtol=1e-15)
    assert abs(lower.full() - A).max() == 0
    # The bands far out are those of M alone: entries are added in every column, those where pieces end among them.
    M = sp.diags_array([1.0 + np.arange(n) / n, *[np.full(n - 90, 0.5)] * 2], offsets=[0, 90, -90], format="csr")
    with DynamicStiffness(A, M, solver=SuperLU()) as pencil:
        assert abs(pencil.at(2.0).full() - (A + 4.0 * M)).max() < 1e-13
    rows, kept = np.array([0, 70_000, n - 1]), np.ones(n)
    kept[rows] = 0.0
    S = sp.diags_array(kept)
    held = S @ A @ S + sp.diags_array((1.0 - kept) * A.diagonal().max())
    assert abs(with_fixed_rows(lower, rows).full() - held).max() == 0


def test_entries_given_twice_are_summed_and_the_matrix_is_left_alone() -> None:
    A = sp.csr_array((np.array([1.0, 2.0, 4.0, 4.0]), np.array([0, 0, 1, 1]), np.array([0, 2, 4])), shape=(2, 2))
    lower = Lower.of(A)
    np.testing.assert_array_equal(lower.data, [3.0, 8.0])
    np.testing.assert_array_equal(lower.full().toarray(), [[3.0, 0.0], [0.0, 8.0]])
    assert A.nnz == 4


@pytest.mark.parametrize(
    ("A", "error", "words"),
    [
        (np.ones((3, 4)), InputError, ("value", "", "4")),
        (np.ones((0, 0)), InputError, ("value",)),
        ([[1.0, 1.0], [0.0, 1.0]], InputError, ("model", "matrix")),
        ([[1.0, 1e-3], [1.0001e-3, 1.0]], InputError, ("model", "matrix")),
        ([[1.0, 1j], [-1j, 1.0]], InputError, ("model", "matrix")),
        ([[1.0, 0.0], [0.0, np.nan]], InputError, ("value", "matrix")),
        (np.zeros((2, 2)), SingularMatrixError, ("model",)),
        (np.diag([1.0, 0.0, 0.0]), SingularMatrixError, ("model",)),
    ],
)
def test_bad_matrices_are_refused(A: list[list[float]], error: type[Exception], words: Refusal) -> None:
    with refusal(*words, by=error):
        Lower.of(sp.csr_array(np.array(A)), "the test")


def test_round_off_of_an_assembly_is_no_lack_of_symmetry() -> None:
    """Also where forces and moments are in units that lie far apart."""
    D = sp.diags_array(np.tile([1e6, 1.0, 1e-6], 27))
    A = sp.csr_array(D @ brick(3) @ D)
    A.data *= 1.0 + 1e-13 * random(A.nnz)
    Lower.of(A)
    A.data *= 1.0 + 1e-6 * random(A.nnz)
    with refusal("model", "matrix"):
        Lower.of(A)


def test_pattern_tells_matrices_apart_by_where_they_have_entries() -> None:
    A = Lower.of(brick(3))
    stored_zero = brick(3)
    stored_zero.data[stored_zero.data < 0] = 0.0
    assert A.pattern == Lower.of(-2.5 * brick(3)).pattern == Lower.of(stored_zero).pattern
    stored_zero.eliminate_zeros()
    # One entry beside the diagonal, in another row or in another column.
    moved = [np.eye(3) for _ in range(3)]
    for A_moved, (row, column) in zip(moved, ((1, 0), (2, 0), (2, 1)), strict=True):
        A_moved[row, column] = A_moved[column, row] = 0.5
    # The same row numbers as those of the last one, in other columns.
    moved.append(np.array([[1.0, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 1.0]]))
    patterns = {Lower.of(sp.csc_array(A_moved)).pattern for A_moved in moved}
    assert len({A.pattern, Lower.of(stored_zero).pattern, *patterns}) == 6


def _pencil(with_damping: bool) -> tuple[sp.csr_array, sp.csr_array, sp.csr_array | None]:
    """K and M with entries outside each other's pattern; D within neither."""
    K, M = sp.csr_array(chain(12)), sp.csr_array(mass(brick(3))[:36, :36])
    far = np.zeros((36, 36))
    far[[3, 30], [30, 3]] = 0.1
    D = sp.csr_array(0.02 * K + sp.csr_array(far)) if with_damping else None
    M = sp.csr_array(M + sp.csr_array(np.roll(far, 3, axis=(0, 1))))
    return K, M, D


@pytest.mark.parametrize("with_damping", [False, True])
@pytest.mark.parametrize("s", [0.0, 1.5, -2.0, 3j, 0.2 + 3j], ids=str)
def test_dynamic_stiffness_is_the_sum(s: complex, with_damping: bool) -> None:
    K, M, D = _pencil(with_damping)
    expected = s**2 * M.toarray() + K.toarray() + (0.0 if D is None else s * D.toarray())
    with DynamicStiffness(K, M, D, solver=SuperLU()) as pencil:
        before = pencil.lower.data.copy()
        A = pencil.at(s)
        real = complex(s).imag == 0 or (D is None and complex(s).real == 0)
        assert A.data.dtype == (np.float64 if real else np.complex128)
        np.testing.assert_allclose(A.full().toarray(), expected, rtol=0, atol=1e-14 * np.abs(expected).max())
        sigma = 0.7
        np.testing.assert_allclose(pencil.shift(sigma).full().toarray(), (K - sigma * M).toarray(), atol=1e-15)
        assert A.pattern == pencil.shift(sigma).pattern == pencil.lower.pattern
        np.testing.assert_array_equal(pencil.lower.data, before)
        np.testing.assert_array_equal(pencil.lower.full().toarray(), K.toarray())


def test_matrices_of_different_sizes_are_refused() -> None:
    K, M, D = _pencil(True)
    with refusal("value", "K", "36", "81"):
        DynamicStiffness(K, sp.csr_array(mass(brick(3))), D, solver=SuperLU())
    with refusal("model", "matrix"):
        DynamicStiffness(K, M, sp.csr_array(sp.triu(D)), solver=SuperLU())


def test_matrices_in_files_give_the_same(tmp_path: Path) -> None:
    K, M, D = _pencil(True)
    with Budget(1 << 40, tmp_path, in_memory=0) as budget, DynamicStiffness(K, M, D, solver=SuperLU()) as pencil:
        assert budget.files >= 5
        expected = DynamicStiffness(K, M, D, solver=SuperLU()).at(2j)
        np.testing.assert_array_equal(pencil.at(2j).data, expected.data)
        assert pencil.at(2j).pattern == expected.pattern


def test_all_factors_share_one_analysis_for_each_structure() -> None:
    solver = CountingSolver()
    K, M, D = _pencil(True)
    b = random(36)
    with DynamicStiffness(K, M, D, solver=solver) as pencil:
        for s in (0.3, 0.2, 1j, 2j, 0.4):
            factor = pencil.factorize(s)
            A = s * s * M + s * D + K
            assert backward_error(A, factor.solve(b), b) < 1e-14
        with refusal("conflict", "structure"):
            DynamicStiffness(K, M, solver=SuperLU()).factorize(1.0, "complex-symmetric")
    assert solver.analyses == {"symmetric": 1, "complex-symmetric": 1}
    assert factor.closed


def test_held_rows_leave_the_rest_and_the_pattern() -> None:
    A, rows, expected = Lower.of(brick(3)), np.array([0, 17, 80]), brick(3).toarray()
    expected[rows] = expected[:, rows] = 0.0
    expected[rows, rows] = A.diagonal().max()
    H = with_fixed_rows(A, rows)
    np.testing.assert_array_equal(H.full().toarray(), expected)
    assert H.pattern == Lower.of(brick(3)).pattern


def test_sprung_rows_have_a_spring_as_stiff_as_their_diagonal() -> None:
    A, rows = Lower.of(brick(3)), np.array([0, 17, 80])
    expected = brick(3).toarray()
    expected[rows, rows] *= 2.0
    np.testing.assert_array_equal(with_springs(A, rows).full().toarray(), expected)
    np.testing.assert_array_equal(A.full().toarray(), brick(3).toarray())
    for matrix, row in ((SWAP, 0), (SWAP, 1), (SWAP[:2, :2], 1)):
        with refusal("model", "K"):
            with_springs(Lower.of(sp.csr_array(matrix)), np.array([row]))
