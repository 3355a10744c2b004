"""Modes: complete, also where eigenvalues cluster, and verified by counting."""

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.base.budget import Budget
from morembs.base.errors import SolverError
from morembs.base.progress import listening
from morembs.fem.interface import make_interface
from morembs.linalg import eigen
from morembs.linalg.columns import orthonormal
from morembs.linalg.eigen import lowest_modes
from morembs.linalg.lanczos import BlockLanczos, largest
from morembs.linalg.sturm import ShiftedInverse, count_below
from morembs.linalg.tolerances import TOL
from morembs.problem import Problem
from tests.support.meshes import box, steel, where
from tests.support.progress import Heard
from tests.support.refusals import refusal


@pytest.fixture(scope="module")
def square_bar():
    """A square bar: every bending mode is double. So large that its modes are not found by LAPACK."""
    model = steel(box("hex20", (17, 2, 2), (0.5, 0.04, 0.04)))
    assert TOL.dense_rows < model.K.shape[0] < 1.1 * TOL.dense_rows
    return model


@pytest.fixture(scope="module")
def exact(square_bar):
    """Elastic eigenvalues and modes of the bar by LAPACK."""
    values, vectors = sl.eigh(square_bar.K.toarray(), square_bar.M.toarray())
    return values[6:], vectors[:, 6:]


def test_sparse_modes_are_all_modes_of_the_dense_pencil(square_bar, exact):
    exact = exact[0]
    with Problem(square_bar) as problem:
        for count in (1, 3, 10, 25, 60):
            modes = lowest_modes(problem.free_free, problem.M, count=count)
            assert modes.eigenvalues == pytest.approx(exact[:count], rel=1e-9)
            V = modes.vectors
            assert np.abs(V.T @ (problem.M @ V) - np.eye(count)).max() < 1e-12
            residual = problem.K @ V - problem.M @ V * modes.eigenvalues
            # Force residual against the modal forces themselves.
            assert np.abs(residual).max() < 1e-6 * np.abs(problem.M @ V * modes.eigenvalues).max()
        gap = next(k for k in range(18, 40) if exact[k] > 1.01 * exact[k - 1])
        below = 0.5 * (exact[gap - 1] + exact[gap])
        assert len(lowest_modes(problem.free_free, problem.M, below=below).eigenvalues) == gap
        # A limit right on a double eigenvalue is no reason to stop.
        assert len(lowest_modes(problem.free_free, problem.M, below=float(exact[1])).eigenvalues) == 2


def counts_are_those_of(pencil, exact):
    """Sturm counts in ten gaps."""
    gaps = [k for k in range(1, 30) if exact[k] / exact[k - 1] > 1.001][:10]
    assert len(gaps) == 10
    for k in gaps:
        assert count_below(pencil, 0.5 * (exact[k] + exact[k - 1])) == k
    # A shift right on an eigenvalue moves aside instead of failing.
    assert 0 <= count_below(pencil, float(exact[0])) <= 2


def test_counts_agree_with_the_sorted_list(square_bar, exact):
    with Problem(square_bar) as problem:
        counts_are_those_of(problem.free_free, exact[0])


def test_a_missing_mode_is_noticed_and_found(square_bar, exact, monkeypatch):
    """An eigensolver that fails to see a mode: the count must not let the result pass without it.

    Under a budget, where modes are counted behind the eigensolver.
    """
    calls = []
    with Budget(memory=4 * 2**30), Problem(square_bar) as problem:

        def blind(lanczos, count, **rest):
            theta, Y = largest(lanczos, count + 1, **rest)
            calls.append(count)
            keep = [j for j in range(count + 1) if j != 2 or len(calls) > 1][:count]
            return theta[keep], Y[:, keep]

        monkeypatch.setattr(eigen, "largest", blind)
        modes = lowest_modes(problem.free_free, problem.M, count=10)
        assert len(calls) == 2
        assert modes.eigenvalues == pytest.approx(exact[0][:10], rel=1e-9)
        monkeypatch.setattr(eigen, "largest", lambda *a, **k: (1 / exact[0][1:12], exact[1][:, 1:12]))
        with refusal("result", "count", by=SolverError):
            lowest_modes(problem.free_free, problem.M, count=10)


def test_a_mode_that_both_shifts_miss_is_noticed(square_bar, exact, monkeypatch):
    """One mode is hidden from the solves at both shifts: the inertia of the second says that it is there."""
    x = exact[1][:, 2:3]
    with Problem(square_bar) as problem:

        def hidden(solve, F):
            U = solve(F)
            return U - x @ (x.T @ (problem.M @ U))

        solve, apply = problem.free_free.flexibility, ShiftedInverse.apply
        monkeypatch.setattr(problem.free_free, "flexibility", lambda F: hidden(solve, F))
        monkeypatch.setattr(ShiftedInverse, "apply", lambda self, F: hidden(lambda G: apply(self, G), F))
        with refusal("result", "count", by=SolverError):
            lowest_modes(problem.free_free, problem.M, count=25)


@pytest.mark.parametrize("coupling", ["average", "direct"])
def test_modes_of_the_held_body_at_two_shifts_are_those_of_lapack(square_bar, coupling):
    """Rows that are held drop out of the shifted matrix, general constraints border it; so do counts."""
    held = [
        make_interface(square_bar, name=name, nodes=where(square_bar, 0, x), coupling=coupling)
        for name, x in (("l", 0.0), ("r", 0.5))
    ]
    with Problem(square_bar, held) as problem:
        dense = lowest_modes(problem.fixed_interface, problem.M, count=30, by_lapack=True).eigenvalues
        modes = lowest_modes(problem.fixed_interface, problem.M, count=25)
        assert modes.eigenvalues == pytest.approx(dense[:25], rel=1e-9)
        assert np.abs(modes.vectors.T @ (problem.M @ modes.vectors) - np.eye(25)).max() < 1e-12
        assert np.abs(problem.B.T @ modes.vectors).max() < 1e-9 * np.abs(modes.vectors).max()
        counts_are_those_of(problem.fixed_interface, dense)


def test_a_quarter_of_all_modes_ends_when_all_are_found():
    """Rigid motions enter the space by round-off; what they do there is no mode that has to converge."""
    model = steel(box("hex8", (6, 6, 6), (0.1, 0.11, 0.123)))
    with Problem(model) as problem, listening(Heard(most=200)):
        exact = lowest_modes(problem.free_free, problem.M, count=260, by_lapack=True).eigenvalues
        modes = lowest_modes(problem.free_free, problem.M, count=260, by_lapack=False)
    assert modes.eigenvalues == pytest.approx(exact, rel=1e-9)


def test_restarted_lanczos_finds_the_same(square_bar, exact):
    with Problem(square_bar) as problem:
        random = np.random.default_rng(0).standard_normal((problem.M.shape[0], 8))
        start = problem.free_free.flexibility(problem.M @ random)
        lanczos = BlockLanczos(problem.free_free.flexibility, problem.space, start, capacity=44)
        theta, _ = largest(lanczos, 20)
        assert lanczos.V.shape[1] == 44
        assert 1 / theta == pytest.approx(exact[0][:20], rel=1e-9)


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


@pytest.mark.parametrize("large", [True, False])
def test_modes_kept_from_an_earlier_call_do_not_cut_a_later_one(square_bar, exact, large):
    """First a few modes by count, then all up to a limit far above them, then fewer again."""
    model, exact = square_bar, exact[0]
    if not large:
        model = steel(box("hex20", (7, 2, 2), (0.5, 0.04, 0.04)))
        exact = sl.eigh(model.K.toarray(), model.M.toarray(), eigvals_only=True)[6:]
    with Problem(model) as problem:
        gap = next(k for k in range(12, 40) if exact[k] > 1.01 * exact[k - 1])
        limit = 0.5 * (exact[gap - 1] + exact[gap])
        assert len(problem.elastic_modes(count=3).eigenvalues) == 3
        assert len(problem.elastic_modes(below=limit).eigenvalues) == gap
        # The fourth mode may be half of a pair; the limit takes the pair whole.
        pair = int((exact <= exact[3] * (1 + 1e-6)).sum())
        assert len(problem.elastic_modes(below=float(exact[3])).eigenvalues) == pair
        assert len(problem.elastic_modes(count=gap + 5).eigenvalues) == gap + 5


@pytest.mark.parametrize("kind", ["elastic_modes", "fixed_modes"])
def test_modes_of_a_band_are_computed_once(square_bar, kind):
    """Equal and lower limits are served from the modes that are known, with no step of the eigensolver."""
    model, heard = square_bar, Heard()
    interface = make_interface(model, name="left", nodes=where(model, 0, 0.0))
    with listening(heard):
        problem = Problem(model, [interface])
    with problem:
        modes = getattr(problem, kind)
        below = 3 * float(modes(count=6).eigenvalues[-1])
        first, known = modes(below=below), len(heard.news)
        assert len(first.eigenvalues) > 7
        assert np.array_equal(modes(below=below).eigenvalues, first.eigenvalues)
        assert len(modes(below=0.3 * below).eigenvalues) < len(first.eigenvalues)
        assert len(heard.news) == known
        modes(below=1.5 * below)
        assert len(heard.news) > known and heard.news[-1].endswith("converged")
