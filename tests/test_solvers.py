"""What every sparse solver has to do, and what MUMPS and the ordering add to it."""

from __future__ import annotations

import gc
import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.errors import InputError, SingularMatrixError, SolverError
from morembs.linalg import mumps, mumps_library, ordering
from morembs.linalg import select as selection
from morembs.linalg.mumps import EmbeddedMumps, Mumps
from morembs.linalg.select import SOLVERS, available_solvers, select_solver
from morembs.linalg.solver import LinearSolver
from morembs.linalg.superlu import SuperLU

MUMPS = ("mumps", "mumps-embedded")
COUPLING = np.array([[2.0, 0.3, 0.1], [0.3, 2.0, 0.2], [0.1, 0.2, 2.0]])


def _runs(name: str) -> type[LinearSolver]:
    reason = SOLVERS[name].unavailable()
    if reason:
        pytest.skip(reason)
    return SOLVERS[name]


@pytest.fixture(params=list(SOLVERS))
def solver(request: pytest.FixtureRequest) -> LinearSolver:
    return _runs(request.param)()


@pytest.fixture(params=MUMPS)
def mumps_class(request: pytest.FixtureRequest) -> type[LinearSolver]:
    return _runs(request.param)


def _chain(nodes: int, held: bool = True) -> sp.csc_array:
    """Springs in a row, three coupled displacements at each node."""
    main = np.full(nodes, 2.0)
    if not held:
        main[[0, -1]] = 1.0
    L = sp.diags_array([-np.ones(nodes - 1), main, -np.ones(nodes - 1)], offsets=[-1, 0, 1])
    return sp.csc_array(sp.kron(L, COUPLING))


def _brick(nodes: int) -> sp.csc_array:
    """27-point stencil on a cube of ``nodes`` to the power 3, three displacements each; SPD."""
    row = sp.diags_array([np.ones(nodes - 1), np.ones(nodes), np.ones(nodes - 1)], offsets=[-1, 0, 1])
    P = sp.csr_array(sp.kron(sp.kron(row, row), row)) - sp.eye_array(nodes**3)
    L = sp.diags_array(np.asarray(P.sum(axis=1)).ravel() + 0.01) - P
    return sp.csc_array(sp.kron(L, COUPLING))


def _random(*shape: int) -> np.ndarray:
    return np.random.default_rng(3).standard_normal(shape)


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_positive_definite_solution_is_that_of_numpy(solver: LinearSolver, structure: str) -> None:
    A, B = _brick(4), _random(192, 5)
    with solver.factorize(A, structure) as factor:
        X = factor.solve(B)
    np.testing.assert_allclose(X, np.linalg.solve(A.toarray(), B), rtol=0, atol=1e-10 * np.abs(X).max())


def test_indefinite_solution_is_that_of_numpy(solver: LinearSolver) -> None:
    A, B = _brick(4), _random(192, 5)
    A = A - sp.csc_array(13.7 * sp.eye_array(192))
    with solver.factorize(A) as factor:
        X = factor.solve(B)
        assert factor.negative_pivots() > 10
    np.testing.assert_allclose(X, np.linalg.solve(A.toarray(), B), rtol=0, atol=1e-10 * np.abs(X).max())


def test_superlu_refines_an_indefinite_solution() -> None:
    """Without a choice of pivots, 1e-5 on the diagonal costs five digits of the first solution."""
    A = sp.csc_array(sp.kron(sp.eye_array(20), np.array([[1e-5, 1.0], [1.0, 1e-5]])))
    b = _random(40)
    with SuperLU().factorize(A) as factor:
        assert np.abs(A @ factor.solve(b) - b).max() < 1e-14


@pytest.mark.parametrize("gap", [0, 1, 7, 40, 90])
def test_inertia_counts_the_eigenvalues_below_a_shift(solver: LinearSolver, gap: int) -> None:
    A = _chain(30) + sp.csc_array(sp.diags_array(np.linspace(0.0, 1.0, 90)))
    values = np.linalg.eigvalsh(A.toarray())
    limits = np.concatenate([[values[0] - 1.0], values, [values[-1] + 1.0]])
    shift = 0.5 * (limits[gap] + limits[gap + 1])
    with solver.factorize(A - sp.csc_array(shift * sp.eye_array(90))) as factor:
        assert factor.negative_pivots() == np.count_nonzero(values < shift) == gap


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
@pytest.mark.parametrize("nodes", [7, 40])
def test_free_chain_is_singular(solver: LinearSolver, structure: str, nodes: int) -> None:
    with pytest.raises(SingularMatrixError):
        solver.factorize(_chain(nodes, held=False), structure)


def test_row_without_stiffness_is_singular(solver: LinearSolver) -> None:
    keep = np.ones(30)
    keep[11] = 0.0
    D = sp.diags_array(keep)
    with pytest.raises(SingularMatrixError):
        solver.factorize(sp.csc_array(D @ _chain(10) @ D), "spd")


def test_empty_and_zero_matrices_are_refused(solver: LinearSolver) -> None:
    with pytest.raises(InputError, match="no rows"):
        solver.factorize(sp.csc_array((0, 0)))
    with pytest.raises(SingularMatrixError):
        solver.factorize(sp.csc_array((4, 4)))


def test_one_by_one(solver: LinearSolver) -> None:
    with solver.factorize(sp.csc_array([[-4.0]])) as factor:
        assert factor.solve(np.array([2.0])) == pytest.approx(-0.5)
        assert factor.negative_pivots() == 1


def test_solve_after_close_is_refused(solver: LinearSolver) -> None:
    factor = solver.factorize(_chain(5))
    factor.close()
    factor.close()
    with pytest.raises(SolverError, match="closed"):
        factor.solve(np.ones(15))


def test_block_equals_single_columns_and_leaves_the_right_hand_side(solver: LinearSolver) -> None:
    A, B = _brick(5), np.asfortranarray(_random(375, 70))
    before = B.copy()
    with solver.factorize(A, "spd") as factor:
        X = factor.solve(B)
        single = np.column_stack([factor.solve(B[:, column]) for column in range(70)])
        assert factor.solve(B[:, 0]).shape == (375,)
        assert factor.solve(B[:, :0]).shape == (375, 0)
    np.testing.assert_array_equal(B, before)
    np.testing.assert_allclose(X, single, rtol=0, atol=1e-13 * np.abs(X).max())


@pytest.mark.parametrize("shape", [(14,), (16, 2), (15, 2, 2)])
def test_right_hand_side_of_wrong_shape(solver: LinearSolver, shape: tuple[int, ...]) -> None:
    with solver.factorize(_chain(5)) as factor, pytest.raises(InputError, match="shape"):
        factor.solve(np.ones(shape))


def test_bad_matrices_are_refused(solver: LinearSolver) -> None:
    with pytest.raises(InputError, match="square"):
        solver.factorize(sp.csc_array(np.ones((3, 4))))
    A = _chain(5)
    A.data[3] = np.nan
    with pytest.raises(InputError, match="finite"):
        solver.factorize(A)


def test_two_factors_live_side_by_side(solver: LinearSolver) -> None:
    A, C, b = _chain(20), _brick(4), _random(192)
    with solver.factorize(A, "spd") as first, solver.factorize(C) as second:
        x, y = first.solve(b[:60]), second.solve(b)
    assert np.abs(A @ x - b[:60]).max() < 1e-12
    assert np.abs(C @ y - b).max() < 1e-11


def test_threads_do_not_disturb_each_other(solver: LinearSolver) -> None:
    """Also when the threads are the first to look for the library."""
    mumps_library.system_library.cache_clear()
    mumps_library.embedded_library.cache_clear()
    b = _random(1536)

    def residual(number: int) -> float:
        A = _brick(8) + sp.csc_array(number * sp.eye_array(1536))
        with solver.factorize(A, "spd") as factor:
            return max(float(np.abs(A @ factor.solve(b) - b).max()) for _ in range(5))

    with ThreadPoolExecutor(4) as pool:
        assert max(pool.map(residual, range(16))) < 1e-10


def test_stats_count_the_entries_of_the_factor(solver: LinearSolver) -> None:
    A = _brick(4)
    with solver.factorize(A, "spd") as factor:
        stats = factor.stats
    assert (stats.backend, stats.size, stats.nnz) == (solver.name, 192, A.nnz)
    assert A.nnz / 2 < stats.factor_entries < 2 * 192**2
    assert stats.memory_bytes >= 8 * stats.factor_entries
    assert not stats.out_of_core


def test_indefinite_matrix_is_not_taken_for_positive_definite(mumps_class: type[LinearSolver]) -> None:
    with pytest.raises(SingularMatrixError, match="positive definite"):
        mumps_class().factorize(_chain(20) - sp.csc_array(1.3 * sp.eye_array(60)), "spd")


@pytest.fixture
def budget(mumps_class: type[LinearSolver], tmp_path: Path) -> Iterator[int]:
    """Bytes that the message for a hopeless budget says are enough, with the factors on disk."""
    scratch = tmp_path / "hopeless"
    with pytest.raises(SolverError, match="needed even with") as caught:
        mumps_class(memory=1000, scratch=scratch).factorize(_brick(16), "spd")
    assert list(scratch.iterdir()) == []
    on_disk, in_core = map(int, re.findall(r"(\d+) MB (?:are|without)", str(caught.value)))
    assert on_disk < 0.8 * in_core
    yield on_disk * 1_000_000


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_factors_on_disk_solve_like_those_in_memory(
    mumps_class: type[LinearSolver], budget: int, tmp_path: Path, structure: str
) -> None:
    A, scratch = _brick(16), tmp_path / "new" / "scratch"
    B = _random(A.shape[0], 40)
    budget += budget // 5 if structure == "symmetric" else 0
    with mumps_class().factorize(A, structure) as factor:
        X = factor.solve(B)
        assert not factor.stats.out_of_core
    on_disk = mumps_class(memory=budget, scratch=scratch)
    other_solver = mumps_class(memory=budget * 2 // 3, scratch=scratch)
    with on_disk.factorize(A, structure) as factor, other_solver.factorize(_brick(14), structure) as other:
        assert factor.stats.out_of_core and other.stats.out_of_core
        assert sum(path.stat().st_size for path in scratch.rglob("*") if path.is_file()) > 1e6
        Y = factor.solve(B)
        assert np.abs(_brick(14) @ other.solve(B[:8232]) - B[:8232]).max() < 1e-10
        again = factor.solve(B)
    assert np.abs(X - Y).max() <= 1e-12 * np.abs(X).max()
    np.testing.assert_array_equal(Y, again)
    assert list(scratch.iterdir()) == []


def test_scratch_is_empty_after_an_exception(
    mumps_class: type[LinearSolver], budget: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_disk = mumps_class(memory=budget, scratch=tmp_path)
    (tmp_path / "hopeless").rmdir()
    with pytest.raises(ZeroDivisionError), on_disk.factorize(_brick(16), "spd"):
        assert len(list(tmp_path.iterdir())) == 1
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []

    def fail(factor: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(mumps._MumpsFactor, "_free_matrix", fail)
    gc.disable()
    try:
        with pytest.raises(KeyboardInterrupt):
            on_disk.factorize(_brick(16), "spd")
        assert list(tmp_path.iterdir()) == []
    finally:
        gc.enable()


def test_unusable_scratch_folders_are_reported(mumps_class: type[LinearSolver], tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(InputError, match="scratch folder"):
        mumps_class(memory=1000, scratch=blocked / "below").factorize(_brick(8), "spd")
    deep = tmp_path.joinpath(*["a" * 200] * 6)
    with pytest.raises(InputError, match="shorter"):
        mumps_class(memory=1000, scratch=deep).factorize(_brick(8), "spd")
    assert list(deep.iterdir()) == []


@pytest.mark.parametrize("hopeless", [False, True])
def test_workspace_is_raised_when_it_was_too_small(
    mumps_class: type[LinearSolver], monkeypatch: pytest.MonkeyPatch, hopeless: bool
) -> None:
    codes: list[int] = []
    asked: list[int] = []
    call, control = mumps._MumpsFactor._call, mumps._MumpsFactor._control

    def spy(factor: mumps._MumpsFactor, job: int) -> int:
        asked.append(factor._data.icntl[13])
        if job == 1 or hopeless:
            control(factor, 14, -60)
        code = call(factor, job)
        codes.extend([code] if job == 2 else [])
        return code

    monkeypatch.setattr(mumps._MumpsFactor, "_call", spy)
    A, b = _brick(8), _random(1536)
    if hopeless:
        with pytest.raises(SolverError, match=r"INFOG\(1\) = -[89], INFOG\(2\) = \d+: .*too small"):
            mumps_class().factorize(A)
        assert len(codes) == 4
        assert asked[-5:-1] == [-60, 60, 120, 240]
        return
    with mumps_class().factorize(A) as factor:
        assert np.abs(A @ factor.solve(b) - b).max() < 1e-11
    assert codes[0] in (-8, -9) and codes[-1] == 0


def test_memory_is_given_back(mumps_class: type[LinearSolver]) -> None:
    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    if not Path("/proc/self/statm").exists():
        pytest.skip("the resident memory is read from /proc")
    A, solver = _brick(6), mumps_class()
    sizes = []
    for _ in range(3):
        for _ in range(70):
            solver.factorize(A).close()
        gc.collect()
        sizes.append(resident())
    assert sizes[2] - sizes[0] < 3e6


def _symbolic_entries(A: sp.csc_array, order: np.ndarray) -> int:
    """Entries of the Cholesky factor of ``A`` in that order (SuperLU keeps the order it is given)."""
    from scipy.sparse.linalg import splu

    P = sp.csc_array(A[order][:, order])
    return int(splu(P, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).L.nnz)


def test_metis_order_is_a_permutation_with_less_fill() -> None:
    A = _brick(9)
    order = ordering.metis_ordering(A)
    if order is None:
        pytest.skip("no METIS library; get it with: sudo apt-get install libmetis5")
    np.testing.assert_array_equal(np.sort(order), np.arange(A.shape[0]))
    # The displacements of a node stay together.
    np.testing.assert_array_equal(order.reshape(-1, 3) % 3, np.tile([0, 1, 2], (729, 1)))
    assert _symbolic_entries(A, order) < 0.7 * _symbolic_entries(A, np.arange(A.shape[0]))


def test_mumps_uses_the_order(mumps_class: type[LinearSolver], monkeypatch: pytest.MonkeyPatch) -> None:
    A = _brick(9)
    if ordering.metis_ordering(A) is None:
        pytest.skip("no METIS library; get it with: sudo apt-get install libmetis5")

    def entries() -> int:
        with mumps_class().factorize(A, "spd") as factor:
            return factor.stats.factor_entries

    good = entries()
    monkeypatch.setattr(mumps, "metis_ordering", lambda A: np.arange(A.shape[0]))
    assert good < 0.7 * entries()


@pytest.mark.parametrize("chunk", [5, 1 << 22])
def test_groups_of_equal_rows(monkeypatch: pytest.MonkeyPatch, chunk: int) -> None:
    """Three nodes with 3, 1 and 2 displacements in a row, then one that resembles no neighbour."""
    monkeypatch.setattr(ordering, "_CHUNK", chunk)
    node = np.array([0, 0, 0, 1, 2, 2, 3])
    touch = np.array([[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 1], [0, 0, 1, 1]])
    A = sp.csc_array(touch[np.ix_(node, node)].astype(float))
    first = ordering._new_pattern(A)
    np.testing.assert_array_equal(np.flatnonzero(first), [0, 3, 4, 6])
    np.testing.assert_array_equal(ordering._quotient(A, first).toarray() != 0, touch - np.eye(4) != 0)
    np.testing.assert_array_equal(
        ordering._explode(np.array([2, 0, 3, 1]), np.array([0, 3, 4, 6]), np.array([3, 1, 2, 1])),
        [4, 5, 0, 1, 2, 6, 3],
    )


def test_order_of_a_pattern_that_is_stored_on_one_side_only() -> None:
    A = _brick(5)
    A.data[(A.indices > np.repeat(np.arange(375), np.diff(A.indptr)) + 40)] = 0.0
    A.eliminate_zeros()
    order = ordering.metis_ordering(A)
    if order is not None:
        np.testing.assert_array_equal(np.sort(order), np.arange(375))


def test_without_metis_there_is_no_order_and_mumps_finds_its_own(
    mumps_class: type[LinearSolver], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(ordering.ctypes.util, "find_library", lambda name: None)
        ordering._metis.cache_clear()
        assert ordering.metis_ordering(_brick(5)) is None
        with mumps_class().factorize(_brick(9), "spd") as factor:
            assert factor.stats.factor_entries < 1.2 * _symbolic_entries(_brick(9), np.arange(2187))
    ordering._metis.cache_clear()


HEADER = """
#define MUMPS_VERSION "5.9.9" /* a comment */
#define MUMPS_VERSION_MAX_LEN 30
typedef struct {
    MUMPS_INT sym, par, job; /* a; b */
    MUMPS_INT comm_fortran, icntl[60], infog[80], n, nrhs, lrhs;
    MUMPS_INT8 nnz;
    MUMPS_INT *irn, *jcn, *perm_in;
    DMUMPS_COMPLEX *a, * rhs;
    char version_number[MUMPS_VERSION_MAX_LEN + 1 + 1];
    char ooc_tmpdir[256], ooc_prefix[64];
} DMUMPS_STRUC_C;
"""


def test_structure_is_read_from_the_header() -> None:
    version, fields = mumps_library.parse_header(HEADER)
    sizes = {name: kind.__name__ for name, kind in fields}
    assert version == "5.9.9"
    assert [name for name, _ in fields][:4] == ["sym", "par", "job", "comm_fortran"]
    assert sizes["version_number"] == "c_char_Array_32"
    assert sizes["icntl"] == "c_int_Array_60"
    assert sizes["rhs"] == sizes["irn"] == "c_void_p"


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("MUMPS_INT8 nnz", "quad nnz", "quad nnz"),
        ("ooc_prefix[64]", "ooc_prefix[SIZE]", "SIZE"),
        ("char ooc_tmpdir[256], ", "char ", "ooc_tmpdir"),
        ("DMUMPS_STRUC_C", "OTHER", "no DMUMPS_STRUC_C"),
        ("nnz;", "nnz;\n#ifdef NEW\n MUMPS_INT more;\n#endif", "not understood"),
    ],
)
def test_unknown_headers_are_refused(old: str, new: str, reason: str) -> None:
    with pytest.raises(mumps_library.UnusableError, match=reason):
        mumps_library.parse_header(HEADER.replace(old, new))


def test_header_of_another_version_is_refused(
    mumps_class: type[LinearSolver], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = mumps_library.system_library if mumps_class is Mumps else mumps_library.embedded_library
    structure = mumps_library._structure

    def other(header: Path) -> object:
        return "5.0.0", structure(header)[1]

    monkeypatch.setattr(mumps_library, "_structure", other)
    assert "5.0.0" in load.__wrapped__()


def test_64_bit_integers_are_refused(tmp_path: Path) -> None:
    (tmp_path / "dmumps_c.h").write_text(HEADER)
    (tmp_path / "mumps_int_def.h").write_text("/* #define MUMPS_INTSIZE64 */\n#define MUMPS_INTSIZE32\n")
    mumps_library._structure(tmp_path / "dmumps_c.h")
    (tmp_path / "mumps_int_def.h").write_text("#define MUMPS_INTSIZE64\n")
    with pytest.raises(mumps_library.UnusableError, match="64-bit"):
        mumps_library._structure(tmp_path / "dmumps_c.h")


def test_missing_libraries_say_how_to_get_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mumps_library.ctypes.util, "find_library", lambda name: None)
    reason = mumps_library.system_library.__wrapped__()
    assert "was found" in reason and "apt-get install libmumps-seq-dev" in reason
    monkeypatch.setattr(mumps_library, "casadi_folder", lambda: None)
    assert "pip install casadi" in mumps_library.embedded_library.__wrapped__()


def test_selection_takes_the_first_that_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(SOLVERS) == ["mumps", "mumps-embedded", "superlu"]
    assert available_solvers()["superlu"] == ""
    runs = [name for name, reason in available_solvers().items() if not reason]
    assert select_solver().name == runs[0]
    monkeypatch.setattr(Mumps, "unavailable", classmethod(lambda cls: "gone; get it back"))
    monkeypatch.setattr(EmbeddedMumps, "unavailable", classmethod(lambda cls: "gone as well"))
    chosen = select_solver(memory=5, scratch=Path("x"))
    assert (chosen.name, chosen.memory, chosen.scratch) == ("superlu", 5, Path("x"))
    with pytest.raises(InputError, match="gone; get it back"):
        select_solver("mumps")


def test_unknown_solver_names_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'superlu'"):
        select_solver("super-lu")
    assert selection.AUTO not in SOLVERS
