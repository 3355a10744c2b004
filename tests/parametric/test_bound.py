"""The bound of a global basis against dense solutions: a free chain of 60 dofs, two stiffnesses and a mass."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.linalg.space import Space
from morembs.linalg.sparse.select import select_solver
from morembs.parametric.bound import ParametricBound
from morembs.parametric.bound_at import ritz_pairs
from morembs.parametric.cells import is_positive
from morembs.parametric.coordinates import LoadCoordinates
from morembs.parametric.law import LINEAR, ONE, Law
from morembs.parametric.proof import BoxCells
from morembs.problem.damping import Damping

N, LOW, HIGH = 60, np.array([0.6, 0.6, 0.7]), np.array([1.8, 1.8, 1.5])
DAMPINGS = {
    "none": Damping(),
    "structural": Damping(structural=0.03),
    "stiffness": Damping(beta=0.02),
    "mass": Damping(alpha=0.01),
    "rayleigh": Damping(alpha=0.01, beta=0.01),
    "both": Damping(alpha=0.005, beta=0.01, structural=0.01),
}
ELASTIC = 7
EPS = np.finfo(float).eps
# More than the highest eigenvalue.
HIGHEST = 4 * 1.8 / 0.7


def chain():
    """Terms of K in two moduli, of M in the mass of the second half (the first is fixed), and loads at three masses."""
    springs = np.zeros((2, N, N))
    for i in range(N - 1):
        springs[int(i >= 25), i : i + 2, i : i + 2] += [[1, -1], [-1, 1]]
    masses = np.stack([np.diag((np.arange(N) < 30).astype(float)), np.diag((np.arange(N) >= 30).astype(float))])
    return springs, masses, np.eye(N)[:, [0, 20, 59]]


def laws():
    nothing = (np.zeros(0),) * 3
    K = Law(factors=np.array([[LINEAR, ONE, ONE], [ONE, LINEAR, ONE]]), points=nothing)
    return K, Law(factors=np.array([[ONE, ONE, ONE], [ONE, ONE, LINEAR]]), points=nothing)


class Reduced:
    """Modes of the chain at few values, with static responses, and the bound of that basis."""

    def __init__(self, extra=ELASTIC):
        self.K_terms, self.M_terms, self.B = chain()
        self.law_K, self.law_M = laws()
        anchor = np.array([1.0, 1.0, 1.0])
        K, M = self.full(anchor)
        values, Phi = sl.eigh(K, M)
        self.highest = np.sqrt(values[4])
        columns = [Phi[:, : 1 + ELASTIC]]
        for p in (anchor, LOW, HIGH, [0.6, 1.8, 1.0]):
            columns += [sl.eigh(*self.full(p))[1][:, :extra], np.linalg.pinv(self.full(p)[0]) @ self.B]
        V = np.linalg.qr(np.sqrt(np.diag(M))[:, None] * np.hstack(columns))[0] / np.sqrt(np.diag(M))[:, None]
        self.V, n = V, V.shape[1]
        k, sigma = 1 + ELASTIC, 2 * values[1 + ELASTIC]
        soft = np.array([*LOW[:2], HIGH[2]])
        W, (K_soft, M_heavy) = M @ V[:, :k], self.full(soft)
        least = 0.97 * sl.eigvalsh(K_soft + sigma * W @ W.T, M_heavy)[0]
        assert is_positive(sp.csr_array(K_soft - least * M_heavy), select_solver(), W=W, sigma=sigma)
        cells = BoxCells(
            low=LOW[None], high=HIGH[None], alpha=np.ones(1), least=np.array([least]), proven=np.array([True])
        )
        held = np.zeros((N, N))
        held[1:, 1:] = np.linalg.inv(K[1:, 1:])
        coordinates = LoadCoordinates(lambda F: held @ F, Space(sp.csr_array(K)))
        B, rest_B = coordinates.of(self.B, np.ones(3))
        parts = [[coordinates.of(A @ V, np.ones(n)) for A in terms] for terms in (self.K_terms, self.M_terms)]

        def stacked(terms):
            C = np.zeros((len(terms), coordinates.size, n))
            for q, (part, _) in enumerate(terms):
                C[q, : len(part)] = part
            return C, np.stack([rest for _, rest in terms])

        (K_C, K_rest), (M_C, M_rest) = (stacked(terms) for terms in parts)
        F = np.eye(n, k)
        rounding = [
            np.array([V.T @ (16 * EPS * np.abs(A).sum(axis=1)[:, None] * V) for A in terms])
            for terms in (self.K_terms, self.M_terms)
        ]
        self.bound = ParametricBound(
            law_K=self.law_K,
            law_M=self.law_M,
            anchor=anchor,
            soft=soft,
            cells=cells,
            residual_B=np.vstack([B, np.zeros((coordinates.size - len(B), 3))]),
            residual_K=K_C,
            residual_M=M_C,
            residual_F=M_C.sum(axis=0) @ F,
            rest_B=rest_B,
            rest_K=K_rest,
            rest_M=M_rest,
            rest_F=M_rest.sum(axis=0) @ np.abs(F),
            motion_F=F,
            sigma=sigma,
            highest=self.highest,
            rounding_K=rounding[0],
            rounding_M=rounding[1],
        )

    def full(self, p):
        return np.tensordot(self.law_K(np.asarray(p)), self.K_terms, 1), np.tensordot(
            self.law_M(np.asarray(p)), self.M_terms, 1
        )

    def at(self, p, damping):
        K, M = (self.V.T @ A @ self.V for A in self.full(p))
        rigid = np.linalg.lstsq(self.V, np.ones((N, 1)), rcond=None)[0]
        return self.bound.at(p, K=K, M=M, B=self.V.T @ self.B, rigid=rigid, damping=damping)

    def errors(self, p, damping, omega):
        """|H - H_r|_F of the elastic parts, from dense modes of the chain and of the reduced matrices."""
        K, M = self.full(p)
        rigid = np.linalg.lstsq(self.V, np.ones((N, 1)), rcond=None)[0]
        responses = []
        for A, C, R, B in (
            (K, M, np.ones((N, 1)), self.B),
            (self.V.T @ K @ self.V, self.V.T @ M @ self.V, rigid, self.V.T @ self.B),
        ):
            _, values, Y = ritz_pairs(A, C, R)
            s = 1j * omega[:, None]
            c, g = damping.proportional(s)
            a = c * values + g + s * (damping.of_modes(values) - damping.alpha - damping.beta * values)
            b = Y.T @ B
            responses.append(np.einsum("im,fi,ij->fmj", b, 1 / a, b))
        return np.linalg.norm(responses[0] - responses[1], axis=(1, 2))


@pytest.fixture(scope="module")
def reduced():
    return Reduced()


@pytest.mark.parametrize("name", DAMPINGS)
def test_no_error_of_the_chain_exceeds_its_bound(reduced, name):
    rng, damping = np.random.default_rng(1), DAMPINGS[name]
    ratios, infinite = [], 0
    for _ in range(40):
        p = rng.uniform(LOW, HIGH)
        at = reduced.at(p, damping)
        omega = reduced.highest * rng.uniform(0, 1, 100)
        bound, error = at.error(omega), reduced.errors(p, damping, omega)
        assert at.kind == "bound"
        # LAPACK has the eigenvalues to some eps of the highest one, which counts beside resonances.
        c, g = damping.proportional(1j * omega[:, None])
        a = np.abs(c * at.values + g)
        floor = 20 * np.finfo(float).eps * HIGHEST / a**2 @ (at.b**2).sum(axis=1)
        assert (error <= bound + floor).all()
        infinite += int((~np.isfinite(bound)).sum())
        known = np.isfinite(bound) & (error > floor)
        ratios.append(bound[known] / error[known])
    ratios = np.concatenate(ratios)
    assert infinite <= 80 and len(ratios) > 3600
    assert np.median(ratios) < 5 and np.percentile(ratios, 95) < 20


def test_modal_damping_is_an_estimate(reduced):
    assert reduced.at(np.ones(3), Damping(modal=0.02)).kind == "estimate"


def test_a_band_beyond_what_is_known_has_no_bound(reduced):
    at = reduced.at(np.ones(3), Damping(structural=0.02))
    assert np.isinf(at.error(np.array([3.0 * np.sqrt(at.least)]))).all()


def test_the_least_eigenvalue_beside_low_ritz_vectors_is_not_below_its_bound(reduced):
    rng = np.random.default_rng(4)
    for _ in range(50):
        p = rng.uniform(LOW, HIGH)
        at, (K, M) = reduced.at(p, Damping()), reduced.full(p)
        _, _, Y = ritz_pairs(
            reduced.V.T @ K @ reduced.V,
            reduced.V.T @ M @ reduced.V,
            np.linalg.lstsq(reduced.V, np.ones((N, 1)), rcond=None)[0],
        )
        X = np.hstack([np.ones((N, 1)), reduced.V @ Y[:, : at.n_low]])
        Q = np.linalg.qr(M @ X, mode="complete")[0][:, X.shape[1] :]
        true = sl.eigh(Q.T @ K @ Q, Q.T @ M @ Q, eigvals_only=True)[0]
        assert reduced.highest**2 < at.least <= true


def smaller(reduced, columns, seed=2):
    """The basis cut to the anchor's modes and some ``columns`` of no merit."""
    n = reduced.V.shape[1]
    T = np.hstack([np.eye(n, 1 + ELASTIC), np.random.default_rng(seed).standard_normal((n, columns))])
    small = Reduced.__new__(Reduced)
    small.__dict__.update(reduced.__dict__, V=reduced.V @ T, bound=reduced.bound.in_basis(T))
    return small


def test_a_smaller_basis_has_the_bound_of_its_own(reduced):
    p, damping = np.array([1.4, 1.1, 1.2]), Damping(structural=0.02)
    small, omega = smaller(reduced, 12), np.linspace(0.05, 1, 40) * reduced.highest
    error, bound = small.errors(p, damping, omega), small.at(p, damping).error(omega)
    assert (error <= bound).all() and np.isfinite(bound).all()
    assert error.max() > 10 * reduced.errors(p, damping, omega).max()


def test_between_an_undamped_resonance_and_that_of_the_basis_there_is_no_bound(reduced):
    p, small = np.array([1.4, 1.1, 1.2]), smaller(reduced, 12)
    at, true = small.at(p, Damping()), sl.eigh(*reduced.full(p), eigvals_only=True)
    between = np.sqrt(0.5 * (true[1:4] + at.values[:3]))
    assert (at.values[:3] > true[1:4] * (1 + 1e-8)).all()
    assert np.isinf(at.error(between)).all()
    assert np.isfinite(at.error(np.sqrt(true[1:4]) * 0.9)).all()
