"""Low-rank ADI against dense Lyapunov equations."""

import numpy as np
import pytest
import scipy.io
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import SolverError
from morembs.linalg.adi import SecondOrder, low_rank_gramian
from tests.support.matrices import chain, dense_gramians, difference, mass, slender_beam
from tests.support.refusals import refusal


def system(M, D, K, solve=None):
    """Dense solves stand for the sparse factor."""
    M, D, K = (A.toarray() if sp.issparse(A) else A for A in (M, D, K))
    return SecondOrder(
        M=sp.csr_array(M),
        K=sp.csr_array(K),
        apply_D=lambda X: D @ X,
        solve=solve or (lambda s, F: np.linalg.solve(s * s * M + s * D + K, F)),
        flexibility=lambda F: np.linalg.solve(K, F),
    )


def sandwich(folder):
    data = scipy.io.loadmat(folder / "nlevp_second_order" / "sandwich_beam_168.mat")
    M, Ke, Kv = (np.asarray(data[name].todense()) for name in ("M", "Ke", "Kv"))
    K = Ke + 350.4e3 * Kv
    w = np.sqrt(sl.eigh(K, M, eigvals_only=True, subset_by_index=[0, 0])[0])
    # The viscoelastic layer damps, which is not proportional.
    return M, 0.05 * w * M + 350.4e3 * 0.2 / w * Kv, K


def check(M, D, K, F, tolerance=1e-12, accuracy=1e-8, **options):
    gramian = low_rank_gramian(system(M, D, K), F, tolerance=tolerance, **options)
    P, Q = dense_gramians(M, D, K, F)
    Z = np.vstack([gramian.Zp, gramian.Zv])
    assert gramian.residual <= tolerance
    assert difference(Z @ Z.T, P) < accuracy
    M, D = (A.toarray() if sp.issparse(A) else A for A in (M, D))
    Y = np.vstack([M @ gramian.Zv + D @ gramian.Zp, gramian.Zp])
    assert difference(Y @ Y.T, Q) < accuracy
    return gramian


def test_gramians_of_a_chain_solve_their_lyapunov_equations():
    K = chain(20)
    M = mass(K)
    F = np.zeros((60, 2))
    F[0, 0], F[40, 1] = 1.0, 1e3
    check(M, 0.05 * M + 0.02 * K, K, F)


def test_damping_that_is_not_proportional():
    """Two dashpots to the ground besides some damping everywhere."""
    K = chain(15)
    M = mass(K)
    D = sp.csr_array(0.03 * K)
    extra = np.zeros(45)
    extra[[4, 30]] = 1.0, 20.0
    F = np.zeros((45, 1))
    F[10] = 1.0
    gramian = check(M, D + sp.diags_array(extra), K, F)
    # Overdamped motion takes real shifts.
    assert any(p.imag == 0 for p in gramian.shifts)


def test_viscoelastic_sandwich_beam(shared_data):
    M, D, K = sandwich(shared_data)
    F = np.zeros((168, 2))
    F[56, 0], F[-2, 1] = 1.0, 1.0
    # Eigenvalues span twelve powers of ten: no more digits are left in K, whatever the tolerance.
    check(M, D, K, F, tolerance=1e-15, accuracy=2e-6)


def test_compression_keeps_the_gramian():
    """So many loads that Z is compressed every few steps; its rows in blocks, as those of large models."""
    K = chain(20)
    M = mass(K)
    F = np.eye(60)[:, :30] * np.geomspace(1.0, 1e3, 30)
    check(M, 0.05 * M + 0.02 * K, K, F, rows=17)


def test_one_solve_for_each_shift_and_real_arithmetic_for_real_shifts():
    K = chain(10)
    M = mass(K)
    D = 0.1 * M + 3.0 * K
    seen = []
    dense = [A.toarray() for A in (M, D, K)]

    def solve(s, F):
        seen.append((s, F.dtype.kind))
        return np.linalg.solve(s * s * dense[0] + s * dense[1] + dense[2], F)

    F = np.zeros((30, 1))
    F[3] = 1.0
    gramian = low_rank_gramian(system(M, D, K, solve), F, tolerance=1e-10)
    assert [-s for s, _ in seen] == list(gramian.shifts)
    assert {kind for s, kind in seen if complex(s).imag == 0} == {"f"}
    assert all(p.real < 0 for p in gramian.shifts) and gramian.Zp.dtype == float


def test_what_is_left_is_said_where_steps_run_out_or_damping_is_missing():
    K = sp.csc_array(slender_beam(20))
    M = sp.eye_array(40, format="csc")
    F = np.eye(40)[:, [38]]
    with refusal("result", "max_steps", "1.0e-10", by=SolverError):
        low_rank_gramian(system(M, 1e-3 * M, K), F, max_steps=3)
    with refusal("result", "damping", by=SolverError):
        low_rank_gramian(system(M, 0.0 * M, K), F)


@pytest.mark.parametrize("seed", [0, 34])
def test_solutions_fill_a_small_model_that_moves_rigidly(seed):
    """The space of the shifts has as many columns as the model; the last is rigid motion, made of round-off."""
    rng = np.random.default_rng(seed)
    n = 6
    k = 10.0 ** rng.uniform(0, 12, n - 1)
    K = np.diag(np.r_[k, 0] + np.r_[0, k]) - np.diag(k, 1) - np.diag(k, -1)
    M = np.diag(rng.uniform(0.5, 2.0, n))
    D = 0.3 * M + 1e-5 * K
    rigid = np.ones((n, 1)) / np.sqrt(M.sum())
    P = np.eye(n) - rigid @ (M @ rigid).T
    X = sl.null_space((M @ rigid).T)
    free = SecondOrder(
        M=sp.csr_array(M),
        K=sp.csr_array(K),
        apply_D=lambda X: D @ X,
        solve=lambda s, F: P @ np.linalg.solve(s * s * M + s * D + K, F),
        flexibility=lambda F: X @ np.linalg.solve(X.T @ K @ X, X.T @ F),
    )
    F = P.T @ np.eye(n, 2)
    gramian = low_rank_gramian(free, F, tolerance=1e-12)
    reduced = dense_gramians(*(X.T @ A @ X for A in (M, D, K)), X.T @ F)[0]
    lift = np.kron(np.eye(2), X)
    Z = np.vstack([gramian.Zp, gramian.Zv])
    # The dense reference loses what is eps of the stiffest spring.
    assert gramian.residual <= 1e-12 and difference(Z @ Z.T, lift @ reduced @ lift.T) < np.finfo(float).eps * 1e12
