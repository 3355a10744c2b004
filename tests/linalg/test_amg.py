"""Multigrid against direct solvers, and what it refuses."""

from __future__ import annotations

import tracemalloc
from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import BudgetError, SingularMatrixError, SolverError
from morembs.fem import rigid_motion
from morembs.linalg.sparse import amg
from morembs.linalg.sparse.amg import Amg
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.superlu import SuperLU
from morembs.linalg.sparse.symmetric import Lower
from tests.support.matrices import random
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal


@cache
def _body(n: tuple[int, int, int] = (4, 4, 5), size: tuple[float, float, float] = (1, 1, 1), kind: str = "tet10"):
    """Stiffness and rigid motions of a free box."""
    model = steel(box(kind, n, size))
    return sp.csr_array(model.K), rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component), model


def _clamped(*shape, kind: str = "tet10") -> tuple[sp.csr_array, np.ndarray]:
    """The box without the dofs of its face x = 0."""
    K, Z, model = _body(*shape, kind=kind)
    rows = np.setdiff1d(np.arange(len(Z)), model.dofs.of_nodes(where(model, 0, 0.0)))
    return sp.csr_array(K[rows][:, rows]), Z[rows]


def _steps(K: sp.csr_array, Z: np.ndarray | None, B: np.ndarray) -> tuple[int, np.ndarray]:
    with Amg(near_nullspace=Z).factorize(K, "spd") as factor:
        X = factor.solve(B)
        assert len(factor.session.levels) >= 1
        return factor.session.steps, X


def test_it_is_in_the_table_and_never_chosen() -> None:
    assert SOLVERS["amg"] is Amg and list(SOLVERS)[-1] == "superlu"
    assert isinstance(select_solver("amg", memory=5), Amg)
    with select_solver().factorize(_clamped((1, 1, 1))[0], "spd") as factor:
        assert factor.stats.backend != "amg"


@pytest.mark.parametrize("kind", ["tet10", "hex8"])
def test_thirty_right_hand_sides_agree_with_a_direct_solver(kind: str) -> None:
    K, Z = _clamped((7, 7, 7) if kind == "hex8" else (4, 4, 5), kind=kind)
    B = random(len(Z), 30) * np.geomspace(1e-9, 1e9, 30)
    with SuperLU().factorize(K, "spd") as factor:
        X = factor.solve(B)
    steps, Y = _steps(K, Z, B)
    assert (np.abs(X - Y).max(axis=0) < 1e-9 * np.abs(X).max(axis=0)).all()
    assert steps <= 16
    size = np.linalg.norm(abs(K).sum(axis=1), np.inf) * np.linalg.norm(Y, axis=0) + np.linalg.norm(B, axis=0)
    assert (np.linalg.norm(K @ Y - B, axis=0) < 1e-12 * size).all()


def test_near_nullspace_saves_steps() -> None:
    K, Z = _clamped((8, 3, 3), (4, 1, 1))
    B = random(len(Z), 2)
    assert _steps(K, Z, B)[0] < 0.7 * _steps(K, None, B)[0]


def test_a_body_on_springs_and_one_without_some_dofs() -> None:
    """Springs at six dofs carry the body, or six dofs are gone: nodes of one and two dofs among those of three."""
    K, Z, _ = _body()
    held = np.array([0, 1, 2, 760, 761, 900])
    stiff = np.zeros(len(Z))
    stiff[held] = K.diagonal()[held]
    keep = np.setdiff1d(np.arange(len(Z)), held)
    for A, near in ((sp.csr_array(K + sp.diags_array(stiff)), Z), (sp.csr_array(K[keep][:, keep]), Z[keep])):
        b = random(A.shape[0], 3)
        with SuperLU().factorize(A, "spd") as factor:
            X = factor.solve(b)
        steps, Y = _steps(A, near, b)
        assert np.abs(X - Y).max() < 1e-9 * np.abs(X).max()
        assert steps <= 22


def test_rows_are_put_together_to_nodes() -> None:
    """Nodes of 3, 2, 1 and 6 rows become blocks of three; idle rows touch nothing and have no motion."""
    sizes = np.array([3, 2, 1, 6])
    node = np.repeat(np.arange(4), sizes)
    touch = np.array([[4, 1, 0, 0], [1, 4, 1, 0], [0, 1, 4, 1], [0, 0, 1, 4]])
    A = sp.csr_array(touch[np.ix_(node, node)] * 1.0)
    near = random(12, 2)
    blocks, place, wide = amg.by_nodes(A, near, np.array([0, 3, 5, 6]))
    assert blocks.blocksize == (3, 3) and blocks.shape == (15, 15)
    np.testing.assert_array_equal(place, [0, 1, 2, 3, 4, 6, *range(9, 15)])
    full = blocks.toarray()
    np.testing.assert_array_equal(full[np.ix_(place, place)], A.toarray())
    idle = [5, 7, 8]
    np.testing.assert_array_equal(full[idle], 4.0 * np.eye(15)[idle])
    np.testing.assert_array_equal(wide[place], near)
    assert not wide[idle].any()
    _, _, constant = amg.by_nodes(A, None, np.array([0, 3, 5, 6]))
    np.testing.assert_array_equal(constant[place], np.eye(3)[place % 3])
    assert amg.by_nodes(A, None, np.arange(12))[0].blocksize == (1, 1)


def test_scalar_chain() -> None:
    n = 4000
    A = sp.csr_array(sp.diags_array([-np.ones(n - 1), np.full(n, 2.001), -np.ones(n - 1)], offsets=[-1, 0, 1]))
    b = random(n)
    _, x = _steps(A, None, b)
    assert np.abs(A @ x - b).max() < 1e-10


def test_unknowns_that_do_not_couple() -> None:
    with Amg().factorize(sp.csr_array(sp.diags_array(np.geomspace(1.0, 1e6, 3000))), "spd") as factor:
        np.testing.assert_allclose(factor.solve(np.geomspace(1.0, 1e6, 3000)), 1.0, rtol=1e-11)


@pytest.mark.parametrize("n", [1, 2, 30])
def test_small_matrices_are_solved_directly(n: int) -> None:
    A = np.eye(n) * 3.0 + 0.1
    with Amg().factorize(sp.csr_array(A), "spd") as factor:
        b = random(n, 2)
        np.testing.assert_allclose(factor.solve(b), np.linalg.solve(A, b), rtol=1e-13)
        assert factor.session.steps == 1


def test_v_cycle_is_symmetric_and_positive() -> None:
    K, Z = _clamped((4, 4, 5))
    B = np.asfortranarray(random(len(Z), 6))
    S = B.T @ amg.Hierarchy(K, Z, np.arange(0, len(Z), 3)).precondition(B)
    assert np.abs(S - S.T).max() < 1e-5 * np.abs(S).max()
    assert np.linalg.eigvalsh(S + S.T).min() > 0


def test_memory_bounds_the_columns_of_a_block() -> None:
    K, Z = _clamped((4, 4, 5))
    B = random(len(Z), 64)
    needed = Amg().analyse(K, "spd").forecast.memory
    solutions, peaks = [], []
    for memory in (None, needed):
        with Amg(near_nullspace=Z, memory=memory).factorize(K, "spd") as factor:
            tracemalloc.start()
            try:
                solutions.append(factor.solve(B))
                peaks.append(tracemalloc.get_traced_memory()[1])
            finally:
                tracemalloc.stop()
    room = needed - factor.stats.memory_bytes + B.nbytes
    assert peaks[1] < room < peaks[0]
    X, Y = solutions
    np.testing.assert_allclose(X, Y, rtol=0, atol=1e-10 * np.abs(X).max())


def test_a_budget_that_is_too_small() -> None:
    K, Z = _clamped((4, 4, 5))
    needed = Amg().analyse(K, "spd").forecast.memory
    with refusal("memory", "", "10.0", by=BudgetError) as caught:
        Amg(near_nullspace=Z, memory=10_000_000).factorize(K, "spd")
    assert caught.value.needed == needed


def test_forecast_of_memory_and_entries() -> None:
    K, Z = _clamped((6, 6, 6))
    lower = Lower.of(K)
    with Amg(near_nullspace=Z).analyse(lower, "spd") as analysis:
        expected = analysis.forecast
        # What is imported and kept by the first run is none of the memory of a factor.
        amg.Hierarchy(K, Z, np.arange(0, len(Z), 3))
        tracemalloc.start()
        try:
            factor = analysis.factorize(lower)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        stats = factor.stats
    assert expected.backend == "amg" and not expected.out_of_core and expected.size == len(Z)
    assert expected.memory == pytest.approx(peak, rel=0.25)
    assert expected.kept == pytest.approx(stats.memory_bytes, rel=0.25)
    assert expected.factor_entries == pytest.approx(stats.factor_entries, rel=0.25)
    assert expected.flops > 100 * K.nnz


def test_other_structures_are_refused() -> None:
    K, _ = _clamped((2, 2, 2))
    with refusal("value", "solver"):
        Amg().factorize(K, "symmetric")
    with refusal("value", "solver"):
        Amg().factorize(sp.csr_array(K + 1j * K), "complex-symmetric")


def test_no_inertia() -> None:
    with Amg().factorize(_clamped((1, 1, 1))[0], "spd") as factor, refusal("result", "solver", by=SolverError):
        factor.negative_pivots()


@pytest.mark.parametrize("near", [True, False])
def test_free_body_is_refused(near: bool) -> None:
    K, Z, _ = _body()
    with refusal("model", by=SingularMatrixError):
        Amg(near_nullspace=Z if near else None).factorize(K, "spd")


def test_indefinite_matrix_is_refused() -> None:
    K, Z = _clamped((4, 4, 5))
    with refusal("model", by=SingularMatrixError):
        Amg(near_nullspace=Z).factorize(sp.csr_array(K - 0.05 * K.diagonal().max() * sp.eye_array(len(Z))), "spd")


def test_negative_diagonal_is_refused() -> None:
    d = np.linspace(1.0, 2.0, 3000)
    d[1500] = -1.0
    with refusal("model", by=SingularMatrixError):
        Amg().factorize(sp.csr_array(sp.diags_array(d)), "spd")


def test_near_nullspace_of_wrong_shape() -> None:
    K, Z = _clamped((4, 4, 5))
    for wrong in (Z[:-1], Z[:, 0], Z * np.nan):
        with refusal("value", "near"):
            Amg(near_nullspace=wrong).factorize(K, "spd")


def test_slender_body_says_what_to_do() -> None:
    """A beam of 1 : 100 without its rotations in the near-nullspace."""
    K, _ = _clamped((100, 1, 1), (100, 1, 1))
    with refusal("result", "solver", by=SolverError):
        Amg().factorize(K, "spd")


def test_without_pyamg_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Amg.unavailable() == ""
    monkeypatch.setattr(amg, "find_spec", lambda name: None)
    assert "pip install pyamg" in Amg.unavailable()


def test_failure_of_pyamg_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ValueError("no aggregates")

    monkeypatch.setattr("pyamg.smoothed_aggregation_solver", fail)
    with refusal("result", "solver", by=SolverError):
        Amg().factorize(_clamped((4, 4, 5))[0], "spd")
