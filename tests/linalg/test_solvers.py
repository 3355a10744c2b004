"""What every sparse solver has to do, whatever it is made of."""

from __future__ import annotations

import gc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs.base.budget import Budget
from morembs.base.errors import InputError, SingularMatrixError, SolverError
from morembs.base.memory import resident_bytes
from morembs.linalg.sparse import mumps_library
from morembs.linalg.sparse.mumps import Mumps
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.solver import STRUCTURES, LinearSolver
from morembs.linalg.sparse.superlu import SuperLU
from morembs.linalg.sparse.symmetric import General, Lower
from tests.support.matrices import (
    COUPLING,
    backward_error,
    badly_scaled,
    brick,
    chain,
    damped,
    mass,
    random,
    shifted,
    skewed,
    sparse_loads,
)
from tests.support.refusals import Refusal, refusal

# Three matrices of one pattern for each structure.
MATRICES: dict[str, tuple[Callable[[int], sp.csc_array], ...]] = {
    "spd": tuple(lambda nodes, s=s: shifted(brick(nodes), -s) for s in (0.0, 0.5, 20.0)),
    "symmetric": tuple(lambda nodes, s=s: shifted(brick(nodes), s) for s in (13.7, 0.9, -1.0)),
    "complex-symmetric": tuple(lambda nodes, w=w: damped(brick(nodes), w) for w in (1.3, 0.2, 5.0)),
    "unsymmetric": tuple(lambda nodes, p=p: skewed(shifted(brick(nodes), 13.7), p) for p in (0.3, -0.2, 0.1)),
    "complex-unsymmetric": tuple(lambda nodes, p=p: skewed(damped(brick(nodes), 1.3), p) for p in (0.3, -0.2, 0.1)),
}
PAIRS = [(name, structure) for name, kind in SOLVERS.items() for structure in kind.structures]
REAL = [pair for pair in PAIRS if pair[1] in ("spd", "symmetric")]
Pair = tuple[LinearSolver, str]


def _configured(name: str, structure: str = "spd") -> LinearSolver:
    """The solver called ``name``, skipped where it or the library for this ``structure`` is not here."""
    if reason := _missing(name, structure):
        pytest.skip(reason)
    return SOLVERS[name]()


@cache
def _missing(name: str, structure: str) -> str:
    """Why the solver called ``name`` does not serve, or nothing."""
    kind = SOLVERS[name]
    if reason := kind.unavailable():
        return reason
    try:
        kind().analyse(MATRICES[structure][0](2), structure).close()
    except InputError as error:
        return str(error)
    return ""


@pytest.fixture(params=list(SOLVERS))
def solver(request: pytest.FixtureRequest) -> LinearSolver:
    return _configured(request.param)


@pytest.fixture(params=PAIRS, ids="-".join)
def pair(request: pytest.FixtureRequest) -> Pair:
    return _configured(*request.param), request.param[1]


@pytest.fixture(params=REAL, ids="-".join)
def real_pair(request: pytest.FixtureRequest) -> Pair:
    return _configured(*request.param), request.param[1]


def _loads(structure: str, *shape: int) -> np.ndarray:
    B = random(*shape)
    return np.asarray(B + 1j * random(*shape, seed=8)) if structure.startswith("complex") else B


def _bound(*columns: Any) -> sp.csc_array:
    return sp.csc_array(np.array(columns))


def test_solution_is_that_of_numpy(pair: Pair) -> None:
    solver, structure = pair
    A = MATRICES[structure][0](4)
    with solver.factorize(A, structure) as factor:
        for shape in ((192,), (192, 1), (192, 200)):
            B = _loads(structure, *shape)
            before = B.copy()
            X = factor.solve(B)
            np.testing.assert_array_equal(B, before)
            assert X.shape == shape and X.dtype == B.dtype
            assert backward_error(A, X, B) < 1e-12
            np.testing.assert_allclose(X, np.linalg.solve(A.toarray(), B), rtol=0, atol=1e-10 * np.abs(X).max())


def test_transposed_solutions_are_those_of_the_transpose(pair: Pair) -> None:
    solver, structure = pair
    A, B = MATRICES[structure][0](4), _loads(structure, 192, 3)
    with solver.factorize(A, structure) as factor:
        X = factor.solve(B, transposed=True)
        assert backward_error(sp.csc_array(A.T), X, B) < 1e-12
        assert backward_error(A, factor.solve(B), B) < 1e-12


@pytest.mark.parametrize("structure", ["unsymmetric", "complex-unsymmetric"])
@pytest.mark.parametrize("name", [name for name, kind in SOLVERS.items() if "unsymmetric" in kind.structures])
def test_a_singular_matrix_that_is_not_symmetric(name: str, structure: str) -> None:
    """One row is the sum of two others; its columns are not."""
    A = MATRICES[structure][0](3).toarray()
    A[40] = A[41] + A[42]
    with pytest.raises(SingularMatrixError):
        _configured(name, structure).factorize(sp.csc_array(A), structure)


def test_a_matrix_that_is_not_symmetric_has_no_inertia_and_no_symmetric_factor() -> None:
    A = General.of(skewed(brick(3), 0.2))
    np.testing.assert_allclose(A.full().toarray(), skewed(brick(3), 0.2).toarray(), rtol=1e-15)
    with SuperLU().factorize(A, "unsymmetric") as factor, refusal("result", "solver", by=SolverError):
        factor.negative_pivots()
    with refusal("model", "structure"):
        SuperLU().factorize(A, "symmetric")


def test_a_matrix_whose_rows_differ_by_sixteen_powers_of_ten(pair: Pair) -> None:
    solver, structure = pair
    A, B = badly_scaled(MATRICES[structure][0](4)), _loads(structure, 192, 3)
    # The stopping rule of the iteration knows one norm of the whole matrix.
    accuracy = 1e-10 if solver.name == "mumps-mixed" else 1e-12
    with solver.factorize(A, structure) as factor:
        assert backward_error(A, factor.solve(B), B) < accuracy


def test_sparse_right_hand_sides_give_what_dense_ones_give(pair: Pair) -> None:
    """Also with row numbers in no order, and with entries given in two parts."""
    solver, structure = pair
    A, B = MATRICES[structure][0](4), sparse_loads(192, 9)
    B = sp.csc_array(B * (1 + 1j)) if structure.startswith("complex") else B
    parts = sp.csc_array((np.tile(B.data / 2, 2), np.tile(B.indices, 2), np.append(0, 2 * B.nnz)), shape=(192, 1))
    with solver.factorize(A, structure) as factor:
        X = factor.solve(B)
        assert type(X) is np.ndarray and backward_error(A, X, B.toarray()) < 1e-12
        assert not X[:, 0].any()
        assert backward_error(A, factor.solve(parts), parts.toarray()) < 1e-12
        assert factor.solve(B[:, :0]).shape == (192, 0) and not factor.solve(0 * B).any()


def test_one_row_and_no_columns(pair: Pair) -> None:
    solver, structure = pair
    value = 4j if structure.startswith("complex") else 4.0 if structure == "spd" else -4.0
    with solver.factorize(_bound([value]), structure) as factor:
        assert factor.solve(np.array([2.0])) == pytest.approx(2.0 / value)
    with solver.factorize(MATRICES[structure][0](3), structure) as factor:
        assert factor.solve(np.zeros((81, 0))).shape == (81, 0)


def test_one_analysis_serves_three_matrices(pair: Pair) -> None:
    solver, structure = pair
    B, factors = _loads(structure, 192, 2), []
    with solver.analyse(MATRICES[structure][0](4), structure) as analysis:
        assert analysis.forecast.size == 192 and analysis.forecast.memory > 0
        for matrix in MATRICES[structure]:
            A = matrix(4)
            factors.append(analysis.factorize(A))
            assert backward_error(A, factors[-1].solve(B), B) < 1e-12
            with refusal("conflict", "pattern"):
                analysis.factorize(chain(64))
            with refusal("conflict", "pattern"):
                analysis.factorize(matrix(3))
            # A matrix that is refused costs nothing.
            assert not factors[-1].closed
        assert [factor.closed for factor in factors] == [True, True, False]
        # Some backends leave out what cancels exactly, or delay pivots.
        entries = [factor.stats.factor_entries for factor in factors]
        assert max(entries) <= 1.1 * min(entries)
        with refusal("result", "solve", by=SolverError):
            factors[0].solve(B)
    assert factors[-1].closed
    with refusal("result", "factorize", by=SolverError):
        analysis.factorize(A)


def test_a_factor_closes_the_analysis_that_was_made_for_it(solver: LinearSolver) -> None:
    factor = solver.factorize(chain(5), "spd")
    analysis = factor.analysis
    factor.close()
    factor.close()
    assert analysis is not None and analysis.closed
    with refusal("result", "solve", by=SolverError):
        factor.solve(np.ones(15))


def test_a_structure_that_is_not_taken_is_refused() -> None:
    refused = [
        (name, structure)
        for name, kind in SOLVERS.items()
        for structure in STRUCTURES
        if structure not in kind.structures and not kind.unavailable()
    ]
    for name, structure in refused:
        with refusal("value", "solver", name, structure):
            SOLVERS[name]().factorize(MATRICES[structure][0](2), structure)


def test_a_structure_that_is_not_that_of_the_values_is_refused(pair: Pair) -> None:
    solver, structure = pair
    kind = "unsymmetric" if structure.endswith("unsymmetric") else "symmetric"
    other = kind if structure.startswith("complex") else f"complex-{kind}"
    with refusal("conflict", "structure", structure):
        solver.factorize(MATRICES[other][0](2), structure)
    with refusal("value", "structure", "spd", "symmetric"):
        solver.factorize(chain(5), "general")


@pytest.mark.parametrize("nodes", [7, 40])
def test_a_free_chain_is_singular(real_pair: Pair, nodes: int) -> None:
    solver, structure = real_pair
    with pytest.raises(SingularMatrixError):
        solver.factorize(chain(nodes, held=False), structure)


def test_an_analysis_outlives_a_singular_matrix(real_pair: Pair) -> None:
    solver, structure = real_pair
    b = random(21)
    with solver.analyse(chain(7), structure) as analysis:
        with pytest.raises(SingularMatrixError):
            analysis.factorize(chain(7, held=False))
        assert backward_error(chain(7), analysis.factorize(chain(7)).solve(b), b) < 1e-12


def test_rows_without_stiffness_are_singular(solver: LinearSolver) -> None:
    """Whether their zeros are stored or not."""
    A = sp.csr_array(chain(10))
    A.data[(A.indices == 11) | (np.repeat(np.arange(30), np.diff(A.indptr)) == 11)] = 0.0
    with pytest.raises(SingularMatrixError):
        solver.factorize(A, "spd")
    A.eliminate_zeros()
    with refusal("model", "", "11", by=SingularMatrixError):
        solver.factorize(A, "spd")


@pytest.mark.parametrize(
    ("A", "words"),
    [
        (sp.csc_array((0, 0)), ("value",)),
        (sp.csc_array((4, 4)), ("model",)),
        (sp.csc_array(np.ones((3, 4))), ("value",)),
        (_bound([1.0, 2.0], [0.0, 1.0]), ("model", "matrix")),
        (_bound([1.0, np.nan], [np.nan, 1.0]), ("value", "matrix")),
        (_bound([np.inf, 0.0], [0.0, 1.0]), ("value", "matrix")),
    ],
    ids=["empty", "zero", "not square", "not symmetric", "nan", "infinite"],
)
def test_bad_matrices_are_refused(solver: LinearSolver, A: sp.csc_array, words: Refusal) -> None:
    with refusal(*words, by=(InputError, SingularMatrixError)):
        solver.factorize(A, "spd")


def test_bad_values_are_refused_by_an_analysis_of_a_good_matrix(solver: LinearSolver) -> None:
    """Also those of a triangle, which nobody checked."""
    A, lower = chain(5), Lower.of(chain(5))
    with solver.analyse(A, "spd") as analysis:
        for bad in (A, lower):
            bad.data[:] = np.nan
            with refusal("value", "matrix"):
                analysis.factorize(bad)


@pytest.mark.parametrize("shape", [(14,), (16, 2), (15, 2, 2)], ids=str)
def test_right_hand_sides_of_wrong_shape_are_refused(solver: LinearSolver, shape: tuple[int, ...]) -> None:
    with solver.factorize(chain(5), "spd") as factor, refusal("value", "B", "15"):
        factor.solve(np.ones(shape))


def test_complex_right_hand_sides_of_a_real_matrix_are_refused(solver: LinearSolver) -> None:
    with solver.factorize(chain(5), "spd") as factor, refusal("unsupported", "B"):
        factor.solve(np.ones(15) * 1j)


def test_inertia_counts_the_eigenvalues_of_a_pencil_below_a_shift(solver: LinearSolver) -> None:
    if "symmetric" not in solver.structures:
        pytest.skip("it factorises positive definite matrices only")
    K, M = brick(3), mass(brick(3))
    values = sl.eigh(K.toarray(), M.toarray(), eigvals_only=True)
    gaps = [k for k in range(1, 81) if values[k] > 1.01 * values[k - 1]]
    chosen = [0, *(gaps[i] for i in np.linspace(0, len(gaps) - 1, 8).astype(int)), 81]
    limits = np.concatenate([[0.0], values, [2 * values[-1]]])
    try:
        solver.negative_eigenvalues(K)
    except SolverError as error:
        pytest.skip(str(error))
    for gap in chosen:
        A = sp.csc_array(K - 0.5 * (limits[gap] + limits[gap + 1]) * M)
        assert solver.negative_eigenvalues(A) == gap
        with solver.factorize(A) as factor:
            assert factor.negative_pivots() == gap


@cache
def large_brick() -> tuple[sp.csc_array, np.ndarray]:
    """A matrix of 8,232 rows and its lowest eigenvalues, products of those of the two whose Kronecker product it is."""
    K, coupling = brick(14), sl.eigvalsh(COUPLING)
    lowest = spl.eigsh(K[::3, ::3] / COUPLING[0, 0], 20, sigma=0.0, return_eigenvectors=False)
    below = np.outer(lowest, coupling)
    return K, below[below < lowest.max() * coupling.min()]


def test_inertia_of_large_fronts(solver: LinearSolver) -> None:
    """The last front of 8,232 unknowns is large enough for processes to share it. ARPACK says how many are below."""
    if "symmetric" not in solver.structures:
        pytest.skip("it factorises positive definite matrices only")
    K, below = large_brick()
    try:
        assert solver.negative_eigenvalues(shifted(K, 3.0)) == (below < 3.0).sum() == 27
    except SolverError as error:
        pytest.skip(str(error))


def test_two_factors_live_side_by_side(solver: LinearSolver) -> None:
    A, C, b = chain(20), brick(4), random(192)
    with solver.factorize(A, "spd") as first, solver.factorize(C, "spd") as second:
        x, y = first.solve(b[:60]), second.solve(b)
    assert backward_error(A, x, b[:60]) < 1e-12
    assert backward_error(C, y, b) < 1e-12


def test_threads_do_not_disturb_each_other(solver: LinearSolver) -> None:
    """Also when the threads are the first to look for the library."""
    mumps_library.system_library.cache_clear()
    mumps_library.embedded_library.cache_clear()

    def error(number: int) -> float:
        A = shifted(brick(5 + number % 2), -number)
        b = random(A.shape[0])
        with solver.factorize(A, "spd") as factor:
            return max(backward_error(A, factor.solve(b), b) for _ in range(3))

    with ThreadPoolExecutor(4) as pool:
        assert max(pool.map(error, range(8))) < 1e-12


def test_stats_count_the_entries_of_the_factor(pair: Pair) -> None:
    solver, structure = pair
    if solver.name == "amg":
        pytest.skip("it has a hierarchy, no factor")
    A = MATRICES[structure][0](4)
    with solver.factorize(A, structure) as factor:
        stats = factor.stats
    assert (stats.backend, stats.size, stats.out_of_core, stats.disk_bytes) == (solver.name, 192, False, 0)
    assert stats.nnz == A.nnz and A.nnz / 2 < stats.factor_entries < 2 * 192**2
    assert stats.memory_bytes >= 4 * stats.factor_entries and stats.seconds > 0


def test_a_forgotten_factor_is_freed(solver: LinearSolver) -> None:
    released = []
    factor = solver.factorize(chain(20), "spd")

    class Noting(type(factor.analysis)):
        def _release(self) -> None:
            released.append(1)
            super()._release()

    factor.analysis.__class__ = Noting
    del factor
    gc.collect()
    assert released == [1]


@pytest.mark.parametrize("structure", STRUCTURES)
def test_in_memory_on_disk_and_mixed_agree(structure: str, tmp_path: Path) -> None:
    _configured("mumps", structure)
    _configured("mumps-mixed", structure)
    A, B = MATRICES[structure][0](8), _loads(structure, 1536, 70)
    solvers = (Mumps(), Mumps(out_of_core=True, scratch=tmp_path), SOLVERS["mumps-mixed"]())
    solutions = []
    for solver in solvers:
        with solver.factorize(A, structure) as factor:
            solutions.append(factor.solve(B))
            assert factor.stats.out_of_core == bool(list(tmp_path.iterdir()))
    for other in solutions[1:]:
        assert np.abs(other - solutions[0]).max() <= 1e-9 * np.abs(solutions[0]).max()
    assert not list(tmp_path.iterdir())


def test_superlu_refines_an_indefinite_solution() -> None:
    """Without a choice of pivots, 1e-5 on the diagonal costs five digits of the first solution."""
    A = sp.csc_array(sp.kron(sp.eye_array(20), np.array([[1e-5, 1.0], [1.0, 1e-5]])))
    b = random(40)
    with SuperLU().factorize(A) as factor:
        assert np.abs(A @ factor.solve(b) - b).max() < 1e-14


def test_superlu_works_without_an_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("morembs.linalg.sparse.superlu.metis_ordering", lambda A: None)
    A, b = shifted(brick(5), 13.7), random(375)
    with SuperLU().factorize(A) as factor:
        assert backward_error(A, factor.solve(b), b) < 1e-14
        assert factor.negative_pivots() == np.count_nonzero(np.linalg.eigvalsh(A.toarray()) < 0)


def test_an_easy_indefinite_matrix_that_needs_pivots() -> None:
    """Without a choice of pivots SuperLU loses all digits here: it must see that and choose them."""
    row = sp.diags_array([-np.ones(11), 2 * np.ones(12), -np.ones(11)], offsets=[-1, 0, 1])
    eye = sp.eye_array(12)
    A = sp.csr_array(
        sp.kron(sp.kron(row, eye), eye)
        + sp.kron(sp.kron(eye, row), eye)
        + sp.kron(sp.kron(eye, eye), row)
        - 3.0 * sp.eye_array(12**3)
    )
    b = np.random.default_rng(0).standard_normal(12**3)
    for name in ("superlu", "mumps", "umfpack"):
        if not SOLVERS[name].unavailable():
            with SOLVERS[name]().factorize(A) as factor:
                assert np.linalg.norm(A @ factor.solve(b) - b) < 1e-9 * np.linalg.norm(b)


@pytest.mark.parametrize("kind", [np.float32, np.int64, np.longdouble])
def test_other_kinds_of_numbers_become_double(kind: type) -> None:
    A = sp.csr_array(sp.diags_array([-np.ones(29), 3 * np.ones(30), -np.ones(29)], offsets=[-1, 0, 1]).astype(kind))
    with select_solver().factorize(A, "spd") as factor:
        x = factor.solve(sp.csc_matrix(np.eye(30)[:, :2]))
    np.testing.assert_allclose(x, np.linalg.inv(A.toarray().astype(float))[:, :2], atol=1e-13)


@pytest.mark.parametrize("name", list(SOLVERS))
def test_a_closed_factor_gives_its_memory_back(name: str) -> None:
    """While its analysis lives, which then makes another factor; processes that hold a part of it count."""
    if reason := SOLVERS[name].unavailable():
        pytest.skip(reason)
    # Arrays of some megabytes may stay with the C library of each process, so numbers of half the size, and several
    # processes, take a larger model.
    A = shifted(brick(20 if "mixed" in name or "ranks" in name else 16), -1.0)
    b = random(A.shape[0])
    budget = Budget(memory=10**12)

    def resident() -> int:
        budget.release_pages()
        return resident_bytes() + sum(each.memory_info().rss for each in psutil.Process().children(recursive=True))

    # What a solver loads when it is used first stays.
    SOLVERS[name]().factorize(shifted(brick(3), -1.0), "spd").close()
    with SOLVERS[name]().analyse(A, "spd") as analysis:
        before = resident()
        factor = analysis.factorize(A)
        held = resident() - before
        factor.close()
        kept = resident() - before
        assert kept < 0.3 * held + 5e6 and held > 0.5 * factor.stats.memory_bytes
        assert backward_error(A, analysis.factorize(A).solve(b), b) < 1e-10
