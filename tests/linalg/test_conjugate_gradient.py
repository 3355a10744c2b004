"""Block conjugate gradients against dense solutions, and with rough factors."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.linalg.sparse.conjugate_gradient import Operator, Solution, conjugate_gradients
from tests.support.matrices import random


def _matrix(values: np.ndarray) -> np.ndarray:
    """Symmetric, with these eigenvalues."""
    Q, _ = np.linalg.qr(random(len(values), len(values)))
    return (Q * values) @ Q.T


def _jacobi(A: np.ndarray) -> Operator:
    return lambda R: R / np.diag(A)[:, None]


def _single(A: np.ndarray) -> Operator:
    """A factor in single precision, as solvers use one: columns of unit size."""
    lu = sl.lu_factor(A.astype(np.complex64 if np.iscomplexobj(A) else np.float32))

    def solve(R: np.ndarray) -> np.ndarray:
        size = np.abs(R).max(axis=0)
        size[size == 0] = 1.0
        return np.asarray(sl.lu_solve(lu, R / size) * size, dtype=A.dtype, order="F")

    return solve


def _solve(A: np.ndarray, B: np.ndarray, precondition: Operator, **options: float) -> Solution:
    norm = float(np.linalg.norm(A, 2))

    def checked(operator: Operator) -> Operator:
        def call(X: np.ndarray) -> np.ndarray:
            assert X.flags.f_contiguous and X.ndim == 2
            before = X.copy()
            result = operator(X)
            np.testing.assert_array_equal(X, before)
            return result

        return call

    before = B.copy()
    solution = conjugate_gradients(checked(A.__matmul__), checked(precondition), B, norm=norm, **options)
    np.testing.assert_array_equal(B, before)
    size = norm * np.linalg.norm(solution.X, axis=0) + np.linalg.norm(B, axis=0)
    true = np.linalg.norm(B - A @ solution.X, axis=0) / np.where(size > 0, size, 1.0)
    np.testing.assert_allclose(solution.residual, true, rtol=0.5, atol=1e-16)
    return solution


@pytest.mark.parametrize("columns", [1, 7])
def test_positive_definite_solution_is_that_of_numpy(columns: int) -> None:
    A, B = _matrix(np.geomspace(1e-2, 1.0, 120)), random(120, columns)
    result = _solve(A, B, _jacobi(A))
    X = np.linalg.solve(A, B)
    assert not result.stagnated
    assert np.abs(result.X - X).max() < 1e-11 * np.abs(X).max()


def test_complex_symmetric_solution_is_that_of_numpy() -> None:
    A = _matrix(np.geomspace(1e-3, 1.0, 90)) + 1j * _matrix(np.linspace(0.1, 0.3, 90))
    B = np.asfortranarray(random(90, 5) + 1j * random(90, 5, seed=4))
    X = np.linalg.solve(A, B)
    for precondition, most in ((_jacobi(A), 90), (_single(A), 3)):
        result = _solve(A, B, precondition)
        assert result.steps <= most and not result.stagnated
        assert np.abs(result.X - X).max() < 1e-11 * np.abs(X).max()


def test_indefinite_solution_with_a_rough_factor() -> None:
    A, B = _matrix(np.concatenate([np.linspace(-3.0, -1e-3, 30), np.linspace(1e-3, 5.0, 70)])), random(100, 4)
    result = _solve(A, B, _single(A))
    X = np.linalg.solve(A, B)
    assert result.steps <= 5 and result.residual.max() < 1e-15
    assert np.abs(result.X - X).max() < 1e-11 * np.abs(X).max()


def test_columns_of_very_different_convergence_and_size() -> None:
    """A combination of three eigenvectors takes three steps, a random column many; each is solved to its own size."""
    A = _matrix(np.geomspace(1e-2, 1.0, 150))
    easy = np.linalg.eigh(A)[1][:, [3, 70, 149]].sum(axis=1)
    B = np.column_stack([easy, 1e-12 * random(150), 1e9 * random(150, seed=8), np.zeros(150), easy])
    calls: list[int] = []

    def count(R: np.ndarray) -> np.ndarray:
        calls.append(R.shape[1])
        return R.copy(order="F")

    result = _solve(A, B, count)
    X = np.linalg.solve(A, B)
    size = np.linalg.norm(X, axis=0)
    assert not result.stagnated
    assert (np.linalg.norm(result.X - X, axis=0) <= 1e-10 * size).all()
    assert not result.X[:, 3].any() and result.residual[3] == 0
    # The column of zeros never enters, the easy ones leave early.
    assert calls[0] == 4 and calls[len(calls) // 2] == 2


def test_only_zero_columns() -> None:
    result = _solve(np.eye(4), np.zeros((4, 3)), _jacobi(np.eye(4)))
    assert result.steps == 0 and not result.X.any() and not result.stagnated


def test_right_hand_sides_share_what_they_find() -> None:
    """Six modes that the preconditioner misses are found together: fewer steps than one column needs."""
    A = _matrix(np.concatenate([np.geomspace(1e-8, 1e-5, 6), np.linspace(0.9, 1.1, 200)]))
    alone = _solve(A, random(206, 1), lambda R: R.copy(order="F"))
    many = _solve(A, random(206, 12), lambda R: R.copy(order="F"))
    assert many.steps < 0.75 * alone.steps and not many.stagnated


def test_single_precision_factor_reaches_double_precision() -> None:
    for condition, most in ((1e2, 3), (1e6, 6)):
        A, B = _matrix(np.geomspace(1.0 / condition, 1.0, 150)), random(150, 3)
        result = _solve(A, B, _single(A))
        assert result.residual.max() < 1e-13 and result.steps <= most
        X = np.linalg.solve(A, B)
        assert np.abs(result.X - X).max() < 1e-14 * condition * np.abs(X).max() + 1e-12 * np.abs(X).max()


def test_a_factor_in_single_precision_that_is_useless_still_serves() -> None:
    """Condition 1e9: single precision loses the lowest modes, the iteration finds them."""
    A, B = _matrix(np.concatenate([np.geomspace(1e-9, 1e-7, 4), np.geomspace(1e-4, 1.0, 150)])), random(154, 3)
    result = _solve(A, B, _single(A))
    assert result.residual.max() < 1e-13 and not result.stagnated and result.steps <= 15


@pytest.mark.parametrize("max_steps", [30, 1000])
def test_stagnation_is_flagged(max_steps: int) -> None:
    values = np.geomspace(1e-7, 1.0, 400) * np.where(np.arange(400) % 2, 1.0, -1.0)
    A, bad = _matrix(values), np.where(random(400) > 0, 1.0, -1.0)[:, None]
    result = _solve(A, random(400, 2), lambda R: bad * R, max_steps=max_steps)
    assert result.stagnated and result.residual.max() > 1e-13
    assert result.steps <= min(max_steps, 300)


def test_a_preconditioner_without_curvature_is_flagged() -> None:
    A = np.array([[0.0, 1.0], [1.0, 0.0]])
    result = _solve(A, np.array([[1.0], [0.0]]), lambda R: R.copy(order="F"))
    assert result.stagnated and result.residual[0] > 0.1


def test_values_that_are_not_finite_are_flagged() -> None:
    result = conjugate_gradients(lambda X: X, lambda R: R * np.nan, np.ones((3, 2)), norm=1.0)
    assert result.stagnated


def test_residuals_are_true_after_many_steps() -> None:
    """The recurrence of an ill-conditioned problem drifts; with accuracy 0 only round-off stops a column."""
    A, B = _matrix(np.geomspace(1e-4, 1.0, 120)), random(120, 2)
    result = _solve(A, B, _jacobi(A), accuracy=0.0, max_steps=2000)
    assert result.residual.max() < 1e-14 and not result.stagnated


def test_accuracy_stops_early() -> None:
    A, B = _matrix(np.geomspace(1e-3, 1.0, 120)), random(120, 2)
    rough, fine = _solve(A, B, _jacobi(A), accuracy=1e-3), _solve(A, B, _jacobi(A))
    assert rough.steps < fine.steps and not rough.stagnated
    X = np.linalg.solve(A, B)
    assert 1e-9 < np.abs(rough.X - X).max() / np.abs(X).max() < 1e-1


def test_a_residual_that_drifted_is_found_and_replaced() -> None:
    """One product with A that is wrong by 1e-4 misleads the recurrence, never the answer."""
    A, B = _matrix(np.geomspace(1e-2, 1.0, 120)), random(120, 3)
    calls: list[int] = []

    def wrong_once(X: np.ndarray) -> np.ndarray:
        calls.append(X.shape[1])
        return np.asarray((1.0001 if len(calls) == 4 else 1.0) * (A @ X))

    result = conjugate_gradients(wrong_once, _jacobi(A), B, norm=1.0)
    X = np.linalg.solve(A, B)
    assert not result.stagnated
    assert np.abs(result.X - X).max() < 1e-11 * np.abs(X).max()
    assert result.residual.max() < 1e-12


def test_round_off_ends_the_iteration() -> None:
    """With accuracy 0 one step of an exact preconditioner is enough, or two."""
    A = _matrix(np.geomspace(1e-2, 1.0, 120))
    inverse = np.linalg.inv(A)
    result = _solve(A, random(120, 3), lambda R: np.asfortranarray(inverse @ R), accuracy=0.0)
    assert result.steps <= 2 and not result.stagnated
