"""Modes: complete, also where eigenvalues cluster, and verified by counting."""

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.errors import SolverError
from morembs.interface import make_interface
from morembs.linalg import eigen
from morembs.linalg.columns import orthonormal
from morembs.linalg.lanczos import BlockLanczos, largest
from morembs.problem import Problem
from tests.support.meshes import box, steel, where


@pytest.fixture(scope="module")
def square_bar():
    """A square bar: every bending mode is double."""
    return steel(box("hex20", (14, 2, 2), (0.5, 0.04, 0.04)))


def test_sparse_modes_are_all_modes_of_the_dense_pencil(square_bar, monkeypatch):
    monkeypatch.setattr(eigen, "DENSE", 0)
    monkeypatch.setattr(eigen, "DENSE_PART", 0)
    with Problem(square_bar) as problem:
        exact = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[6:]
        for count in (1, 3, 10, 25, 60):
            problem._elastic = None
            modes = problem.elastic_modes(count=count)
            assert modes.eigenvalues == pytest.approx(exact[:count], rel=1e-9)
            V = modes.vectors
            assert np.abs(V.T @ (problem.M @ V) - np.eye(count)).max() < 1e-12
            residual = problem.K @ V - problem.M @ V * modes.eigenvalues
            # Force residual against the modal forces themselves.
            assert np.abs(residual).max() < 1e-6 * np.abs(problem.M @ V * modes.eigenvalues).max()
        gap = next(k for k in range(18, 40) if exact[k] > 1.01 * exact[k - 1])
        problem._elastic = None
        assert len(problem.elastic_modes(below=0.5 * (exact[gap - 1] + exact[gap])).eigenvalues) == gap
        # A limit right on a double eigenvalue is no reason to stop.
        problem._elastic = None
        assert len(problem.elastic_modes(below=float(exact[1])).eigenvalues) == 2


@pytest.mark.parametrize("coupling", [None, "rigid", "average", "direct"])
def test_counts_agree_with_the_sorted_list(square_bar, coupling):
    """Sturm counts in ten gaps of the free and of the restricted pencil."""
    made = []
    if coupling:
        made = [make_interface(square_bar, name=n, nodes=where(square_bar, 0, x), coupling=coupling)
                for n, x in (("l", 0.0), ("r", 0.5))]  # fmt: skip
    with Problem(square_bar, made) as problem:
        pencil = problem.internal if coupling else problem.elastic
        exact = eigen._dense(pencil, problem.M, 30, None).eigenvalues
        gaps = [k for k in range(1, 30) if exact[k] / exact[k - 1] > 1.001][:10]
        assert len(gaps) == 10
        for k in gaps:
            assert pencil.count_below(0.5 * (exact[k] + exact[k - 1])) == k
        # A shift right on an eigenvalue moves aside instead of failing.
        assert 0 <= pencil.count_below(float(exact[0])) <= 2


def test_a_missing_mode_is_noticed_and_found(square_bar, monkeypatch):
    """A start space without the first modes: the count must not let the result pass without them."""
    monkeypatch.setattr(eigen, "DENSE", 0)
    monkeypatch.setattr(eigen, "DENSE_PART", 0)
    calls = []
    with Problem(square_bar) as problem:
        exact = eigen._dense(problem.elastic, problem.M, 12, None)

        def blind(lanczos, count, **rest):
            theta, Y = largest(lanczos, count + 1, **rest)
            calls.append(count)
            keep = [j for j in range(count + 1) if j != 2 or len(calls) > 1][:count]
            return theta[keep], Y[:, keep]

        monkeypatch.setattr(eigen, "largest", blind)
        modes = problem.elastic_modes(count=10)
        assert len(calls) == 2
        assert modes.eigenvalues == pytest.approx(exact.eigenvalues[:10], rel=1e-9)
        problem._elastic = None
        monkeypatch.setattr(eigen, "largest", lambda *a, **k: (1 / exact.eigenvalues[1:], exact.vectors[:, 1:]))
        with pytest.raises(SolverError, match="Sturm count finds"):
            problem.elastic_modes(count=10)


def test_restarted_lanczos_finds_the_same(square_bar):
    with Problem(square_bar) as problem:
        exact = eigen._dense(problem.elastic, problem.M, 20, None)
        random = np.random.default_rng(0).standard_normal((problem.M.shape[0], 8))
        start = problem.elastic.flexibility(problem.M @ random)
        lanczos = BlockLanczos(problem.elastic.flexibility, problem.M, start, capacity=44)
        theta, _ = largest(lanczos, 20)
        assert lanczos.V.shape[1] == 44
        assert 1 / theta == pytest.approx(exact.eigenvalues, rel=1e-9)


def test_orthonormalisation_drops_what_depends(square_bar):
    M = square_bar.M
    W = np.random.default_rng(1).standard_normal((M.shape[0], 5))
    W = np.hstack([W, W @ np.random.default_rng(2).standard_normal((5, 3)), np.zeros((len(W), 1))])
    W *= 10.0 ** np.arange(-4, 5)
    Q = orthonormal(W, M)
    assert Q.shape[1] == 5
    assert np.abs(Q.T @ (M @ Q) - np.eye(5)).max() < 1e-13 * 5
    V = W / np.where(np.linalg.norm(W, axis=0) > 0, np.linalg.norm(W, axis=0), 1)
    assert np.abs(V - Q @ (Q.T @ (M @ V))).max() < 1e-9


@pytest.mark.parametrize("dense", [0, 10_000])
def test_modes_kept_from_an_earlier_call_do_not_cut_a_later_one(square_bar, monkeypatch, dense):
    """First a few modes by count, then all up to a limit far above them, then fewer again."""
    monkeypatch.setattr(eigen, "DENSE", dense)
    monkeypatch.setattr(eigen, "DENSE_PART", dense)
    with Problem(square_bar) as problem:
        exact = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[6:]
        gap = next(k for k in range(12, 40) if exact[k] > 1.01 * exact[k - 1])
        limit = 0.5 * (exact[gap - 1] + exact[gap])
        assert len(problem.elastic_modes(count=3).eigenvalues) == 3
        assert len(problem.elastic_modes(below=limit).eigenvalues) == gap
        # The fourth mode may be half of a pair; the limit takes the pair whole.
        pair = int((exact <= exact[3] * (1 + 1e-6)).sum())
        assert len(problem.elastic_modes(below=float(exact[3])).eigenvalues) == pair
        assert len(problem.elastic_modes(count=gap + 5).eigenvalues) == gap + 5


@pytest.mark.parametrize("kind", ["elastic_modes", "fixed_modes"])
def test_modes_of_a_band_are_computed_once(monkeypatch, kind):
    """Equal and lower limits are served from the modes that are known, with no step of the eigensolver."""
    steps = []
    monkeypatch.setattr(eigen, "DENSE", 0)
    monkeypatch.setattr(eigen, "DENSE_PART", 0)
    expand = BlockLanczos.expand
    monkeypatch.setattr(BlockLanczos, "expand", lambda self: (steps.append(1), expand(self))[1])
    model = steel(box("hex8", (8, 2, 2), (0.5, 0.05, 0.03)))
    with Problem(model, [make_interface(model, name="left", nodes=where(model, 0, 0.0))]) as problem:
        modes = getattr(problem, kind)
        below = 3 * float(modes(count=6).eigenvalues[-1])
        first, known = modes(below=below), len(steps)
        assert len(first.eigenvalues) > 7
        assert np.array_equal(modes(below=below).eigenvalues, first.eigenvalues)
        assert len(modes(below=0.5 * below).eigenvalues) < len(first.eigenvalues)
        assert len(steps) == known
        modes(below=1.5 * below)
        assert len(steps) > known
