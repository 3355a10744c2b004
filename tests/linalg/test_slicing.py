"""Spectrum slicing against a dense eigensolver."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.budget import Budget
from morembs.base.errors import SolverError
from morembs.base.progress import listening
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.linalg.eigen import Modes, lowest_modes
from morembs.linalg.eigen_cost import is_dense_cheaper
from morembs.linalg.slicing import sliced_modes
from morembs.linalg.sparse.threads import blas_threads, limit_threads
from morembs.linalg.sturm import ShiftedInverse
from morembs.linalg.tolerances import TOL
from morembs.problem import Problem
from tests.support.meshes import STEEL, box
from tests.support.progress import Heard
from tests.support.refusals import refusal


def _problem(coupling: str | None) -> Problem:
    # A square section: pairs of equal frequencies.
    steel = isotropic(set="all", young=2e11, poisson=0.3, density=7800.0)
    model = assemble(box("hex20", (7, 2, 2), (0.4, 0.05, 0.05)), [steel])
    if coupling is None:
        return Problem(model)
    end = np.flatnonzero(model.nodes.xyz[:, 0] == 0.0)
    return Problem(model, [make_interface(model, name="end", nodes=end, coupling=coupling)])


def _dense(problem: Problem, pencil: object) -> np.ndarray:
    C = pencil.C.toarray() if sp.issparse(pencil.C) else pencil.C
    Q = sl.null_space(C.T)
    return sl.eigh(Q.T @ problem.K.toarray() @ Q, Q.T @ problem.M.toarray() @ Q, eigvals_only=True)


@pytest.mark.parametrize("coupling", [None, "average"])
def test_slices_hold_every_mode_of_the_band(coupling: str | None) -> None:
    with _problem(coupling) as problem:
        pencil = problem.free_free if coupling is None else problem.fixed_interface
        exact = _dense(problem, pencil)
        count = _gap(exact, 150)
        below = 0.5 * (exact[count - 1] + exact[count])
        first = lowest_modes(pencil, problem.M, count=10)
        values, vectors, _ = sliced_modes(
            pencil, problem.M, first.eigenvalues, first.vectors, count=count, below=below, per_slice=30
        )
        np.testing.assert_allclose(values, exact[:count], rtol=1e-8)
        assert np.abs(vectors.T @ (problem.M @ vectors) - np.eye(count)).max() < 1e-7
        residual = problem.K @ vectors - (problem.M @ vectors) * values
        C = pencil.C.toarray() if sp.issparse(pencil.C) else pencil.C
        residual -= C @ np.linalg.lstsq(C, residual, rcond=None)[0]
        assert np.abs(residual).max() < 1e-6 * np.abs(problem.K @ vectors).max()


def _gap(exact: np.ndarray, start: int) -> int:
    """The first count from ``start`` on with a gap behind it; the middle of a pair has no count."""
    return next(k for k in range(start, start + 10) if exact[k] > 1.001 * exact[k - 1])


def test_a_wrong_count_is_refused() -> None:
    """One mode more than there are: the last slice finds that it is missing."""
    with _problem("rigid") as problem:
        exact = _dense(problem, problem.fixed_interface)
        first = lowest_modes(problem.fixed_interface, problem.M, count=10)
        k = _gap(exact, 60)
        with refusal("result", "below", by=SolverError):
            sliced_modes(
                problem.fixed_interface,
                problem.M,
                first.eigenvalues,
                first.vectors,
                count=k + 1,
                below=0.5 * (exact[k - 1] + exact[k]),
                per_slice=30,
            )


def test_a_missing_first_mode_is_found_again() -> None:
    """Modes to begin with that lack one: the count of the next slice shows it, and the slice finds it or refuses."""
    with _problem("rigid") as problem:
        exact = _dense(problem, problem.fixed_interface)
        first = lowest_modes(problem.fixed_interface, problem.M, count=10)
        keep, k = np.arange(10) != 6, _gap(exact, 40)
        try:
            values, _, _ = sliced_modes(
                problem.fixed_interface,
                problem.M,
                first.eigenvalues[keep],
                first.vectors[:, keep],
                count=k,
                below=0.5 * (exact[k - 1] + exact[k]),
                per_slice=30,
            )
        except SolverError:
            return
        np.testing.assert_allclose(values, exact[:k], rtol=1e-8)


def test_wide_bands_are_sliced() -> None:
    with _problem("rigid") as problem:
        exact = _dense(problem, problem.fixed_interface)
        k = _gap(exact, 100)
        below = 0.5 * (exact[k - 1] + exact[k])
        heard = Heard()
        with listening(heard):
            modes = lowest_modes(problem.fixed_interface, problem.M, below=below, by_lapack=False, per_slice=24)
        assert any(text.startswith("slice at") for text in heard.news)
        np.testing.assert_allclose(modes.eigenvalues, exact[:k], rtol=1e-8)


def oscillators(stiffness: np.ndarray, mass: np.ndarray) -> FEModel:
    """Masses (n,) on springs to the ground (n,), three at a node; weak springs join the nodes."""
    weak = sp.diags_array([2.0, -1.0, -1.0], offsets=[0, 3, -3], shape=(len(mass), len(mass)))
    nodes = np.arange(len(mass) // 3)
    return FEModel(
        K=sp.csr_array(sp.diags_array(stiffness) + weak),
        M=sp.csr_array(sp.diags_array(mass)),
        nodes=Nodes(ids=nodes + 1, xyz=np.random.default_rng(1).uniform(0, 1, (len(nodes), 3))),
        dofs=DofMap(node=np.repeat(nodes, 3), component=np.tile(np.arange(3), len(nodes))),
    )


def test_slices_cross_a_wide_gap() -> None:
    """130 modes, then none over six decades, then more than a slice has room for on both sides of the shift."""
    low, high = 1e6 * (1 + 1e-3 * np.arange(130)), 1e12 * (1 + 1e-3 * np.arange(320))
    model = oscillators(np.concatenate([low, high]), np.ones(450))
    exact = np.linalg.eigvalsh(model.K.toarray())
    with Problem(model) as problem, listening(Heard(most=2000)):
        modes = lowest_modes(
            problem.free_free, problem.M, below=0.5 * (exact[259] + exact[260]), by_lapack=False, per_slice=24
        )
    np.testing.assert_allclose(modes.eigenvalues, exact[:260], rtol=1e-8)


@pytest.mark.parametrize("memory", [None, 2**32])
def test_no_more_modes_than_masses(memory: int | None) -> None:
    """18 masses among 600 dofs: all 18 modes are found, a nineteenth is refused."""
    stiffness, mass = 1e6 * np.linspace(2.0, 3.0, 600), np.zeros(600)
    mass[:180:10] = 1.0
    model = oscillators(stiffness, mass)
    inner = mass > 0
    K = model.K.toarray()
    left = K[np.ix_(inner, inner)] - K[np.ix_(inner, ~inner)] @ np.linalg.solve(
        K[np.ix_(~inner, ~inner)], K[np.ix_(~inner, inner)]
    )
    with Budget(memory=memory), Problem(model) as problem:
        modes = lowest_modes(problem.free_free, problem.M, count=18, by_lapack=False)
        np.testing.assert_allclose(modes.eigenvalues, np.linalg.eigvalsh(left), rtol=1e-9)
        with refusal("value", "count", "18"):
            lowest_modes(problem.free_free, problem.M, count=19, by_lapack=False)


def _wanted(count: int, model: FEModel, monkeypatch: pytest.MonkeyPatch) -> tuple[Modes, list[int], list[int]]:
    """Free modes by the default, the columns of each solve, and the rows of each dense eigenproblem."""
    solved: list[int] = []
    dense: list[int] = []
    apply, eigh = ShiftedInverse.apply, sl.eigh

    def small(A: np.ndarray, *given: object, **options: object) -> object:
        dense.append(len(A))
        return eigh(A, *given, **options)

    monkeypatch.setattr(sl, "eigh", small)

    def counted(self: ShiftedInverse, F: np.ndarray) -> np.ndarray:
        solved.append(F.shape[1])
        return apply(self, F)

    monkeypatch.setattr(ShiftedInverse, "apply", counted)
    with Problem(model) as problem:
        modes = lowest_modes(problem.free_free, problem.M, count=count)
        monkeypatch.undo()
        stats = problem.statics.factor.stats
        assert np.abs(modes.vectors.T @ (problem.M @ modes.vectors) - np.eye(count)).max() < 1e-10
        return modes, [*solved, *[stats.columns // stats.passes] * stats.passes], dense


def test_many_modes_by_count_take_few_solves_and_small_eigenproblems(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sixth of all modes of a block: those of LAPACK, with a hundredth of its operations.

    ARPACK takes a pass over the factor for each column, more than two a mode. In one space there were small
    eigenproblems as dear as that of all modes, with a look after each block.
    """
    model = assemble(box("hex8", (8, 8, 8), (0.1, 0.11, 0.123)), [isotropic(set="all", **STEEL)])
    size, count = model.K.shape[0], 360
    modes, solved, dense = _wanted(count, model, monkeypatch)
    exact = sl.eigh(model.K.toarray(), model.M.toarray(), eigvals_only=True, subset_by_index=(6, 6 + count))
    np.testing.assert_allclose(modes.eigenvalues, exact[:count], rtol=1e-10)
    X, MX = modes.vectors, model.M @ modes.vectors
    residual = np.linalg.norm(model.K @ X - MX * modes.eigenvalues, axis=0)
    assert (residual < 2e-9 * np.linalg.norm(model.K @ X, axis=0)).all()
    assert exact[count - 1] < modes.verified_below < exact[count] * (1 + 1e-9)
    assert sum(rows**3 for rows in dense) < 0.06 * size**3 and max(dense) < size / 5
    assert sum(solved) < 4 * count and len(solved) < 0.6 * count
    # In one space: so few looks while it grows by four times its first one, five percent each.
    modes, solved, dense = _wanted(180, model, monkeypatch)
    np.testing.assert_allclose(modes.eigenvalues, exact[:180], rtol=1e-10)
    large = [rows for rows in dense if rows > 180]
    assert len(large) <= 20 and sum(solved) < 4 * 180


def test_modes_of_small_models_take_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads of small products spin: beside other work two of them took three times the processor time of one."""
    threads: list[int] = []
    apply = ShiftedInverse.apply

    def counted(self: ShiftedInverse, F: np.ndarray) -> np.ndarray:
        threads.append(blas_threads())
        return apply(self, F)

    monkeypatch.setattr(ShiftedInverse, "apply", counted)
    model = assemble(box("hex8", (8, 8, 8), (0.1, 0.11, 0.123)), [isotropic(set="all", **STEEL)])
    with Problem(model) as problem, limit_threads(2):
        before = blas_threads()
        lowest_modes(problem.free_free, problem.M, count=30)
        assert set(threads) == {1} and blas_threads() == before == 2


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_large_shares_are_dense_where_that_is_cheaper_and_fits(share: float) -> None:
    """Half of 2,187 modes cost as much one by one as all of them by LAPACK; a budget without room for it says no."""
    rows = 2187
    room = TOL.dense_matrices * 8 * rows**2
    assert is_dense_cheaper(rows, int(share * rows), room) == (share > 0.45)
    assert not is_dense_cheaper(rows, int(share * rows), room - 1)
    # No share of a large model is found faster by its cube.
    assert not is_dense_cheaper(20_000, int(share * 20_000), None)
