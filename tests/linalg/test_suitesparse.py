"""What is special to CHOLMOD and UMFPACK; the contract of all solvers is tested elsewhere."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import BudgetError, SingularMatrixError, SolverError
from morembs.base.progress import listening
from morembs.linalg.sparse import cholmod, cholmod_library, umfpack
from morembs.linalg.sparse.cholmod import Cholmod
from morembs.linalg.sparse.interruptible import ForeignObject
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.sparse.threads import blas_threads, limit_threads
from morembs.linalg.sparse.umfpack import Umfpack
from tests.support import meshes
from tests.support.refusals import refusal

BOTH = (Cholmod, Umfpack)
# Seconds after which a wait for another thread counts as endless.
PATIENCE = 600.0


@pytest.fixture(autouse=True)
def _needs_both() -> None:
    reason = Cholmod.unavailable() or Umfpack.unavailable()
    if reason:
        pytest.skip(reason)


@pytest.fixture(scope="module")
def cube() -> tuple[sp.csr_array, sp.csr_array]:
    """Stiffness and mass of a cube of tet10 that is clamped on one face; the two have one pattern."""
    model = meshes.steel(meshes.box("tet10", (4, 4, 4), (1.0, 1.0, 1.0)))
    free = np.ones((model.K.shape[0] // 3, 3), dtype=bool)
    free[meshes.where(model, 0, 0.0)] = False
    rows = np.flatnonzero(free)
    K, M = (sp.csr_array(sp.csr_array(A)[rows][:, rows]) for A in (model.K, model.M))
    K.sort_indices()
    # Stored zeros give both the same pattern.
    column = np.repeat(np.arange(K.shape[0]), np.diff(K.indptr)) * K.shape[0] + K.indices
    held = np.repeat(np.arange(M.shape[0]), np.diff(M.indptr)) * M.shape[0] + M.indices
    values = np.zeros(K.nnz)
    values[np.searchsorted(column, held)] = M.data
    return K, sp.csr_array((values, K.indices, K.indptr), shape=K.shape)


def _sum(K: sp.csr_array, factor: float, M: sp.csr_array) -> sp.csr_array:
    """K + factor M, with the stored zeros."""
    return sp.csr_array((K.data + factor * M.data, K.indices, K.indptr), shape=K.shape)


def _random(*shape: int) -> np.ndarray:
    return np.random.default_rng(3).standard_normal(shape)


def _error(A: sp.csr_array, X: np.ndarray, B: np.ndarray) -> float:
    """Largest componentwise backward error."""
    return float((np.abs(B - A @ X) / (abs(A) @ np.abs(X) + np.abs(B))).max())


def test_cholmod_refuses_what_need_not_be_positive_definite(cube: tuple[sp.csr_array, ...]) -> None:
    with refusal("value", "solver", "cholmod"):
        Cholmod().factorize(cube[0], "symmetric")


@pytest.mark.parametrize("kind", BOTH)
def test_a_budget_that_is_too_small(kind: type[LinearSolver], cube: tuple[sp.csr_array, ...]) -> None:
    K = cube[0]
    with kind().analyse(K, "spd") as analysis:
        needed = analysis.forecast.memory
    with kind(memory=needed).analyse(K, "spd"):
        pass
    sizes = f"{(needed - 100_000) / 1e6:.1f}", f"{needed / 1e6:.1f}"
    with refusal("memory", "", *sizes, '"mumps"', by=BudgetError) as caught:
        kind(memory=needed - 100_000).analyse(K, "spd")
    assert caught.value.needed == needed


def test_indefinite_matrix_is_told_and_the_analysis_survives(cube: tuple[sp.csr_array, ...]) -> None:
    K, M = cube
    with Cholmod().analyse(K, "spd") as analysis:
        symbolic = analysis.session.common.memory_inuse
        with refusal("model", by=SingularMatrixError):
            analysis.factorize(_sum(K, -1e9, M))
        assert analysis.session.common.memory_inuse == symbolic
        b = _random(K.shape[0])
        assert _error(K, analysis.factorize(K).solve(b), b) < 1e-12


@pytest.mark.parametrize("kind", BOTH)
def test_one_analysis_serves_several_matrices(kind: type[LinearSolver], cube: tuple[sp.csr_array, ...]) -> None:
    K, M = cube
    b = _random(K.shape[0], 3)
    with kind().analyse(K, "spd") as analysis:
        for shift in (0.0, 1e6, 1e9):
            A = _sum(K, shift, M)
            factor = analysis.factorize(A)
            assert _error(A, factor.solve(b), b) < 1e-12
        assert factor.negative_pivots() == 0


def test_umfpack_takes_stored_zeros_of_one_matrix_and_values_of_the_next(cube: tuple[sp.csr_array, ...]) -> None:
    first, second = sp.csr_array(cube[0]), sp.csr_array(cube[0])
    first.data = np.where(np.abs(first.data) < 1e-3 * np.abs(first.data).max(), 0.0, first.data)
    b = _random(first.shape[0])
    with Umfpack().analyse(first) as analysis:
        assert _error(second, analysis.factorize(second).solve(b), b) < 1e-12


def test_cholmod_forecast_is_what_the_factor_takes(cube: tuple[sp.csr_array, ...]) -> None:
    K = cube[0]
    with Cholmod().analyse(K, "spd") as analysis:
        plan, common = analysis.forecast, analysis.session.common
        symbolic = common.memory_inuse
        factor = analysis.factorize(K)
        assert factor.stats.factor_entries == plan.factor_entries
        assert 8 * plan.factor_entries == factor.stats.memory_bytes
        assert plan.factor_entries >= common.lnz
        # Integers of our own copy of the triangle come on top of what CHOLMOD counts.
        assert plan.memory == pytest.approx(common.memory_usage + 8 * (analysis.lower_nnz + K.shape[0]), rel=0.02)
        assert plan.kept == common.memory_inuse
        factor.close()
        assert common.memory_inuse == symbolic
    assert common.memory_inuse == 0


def test_umfpack_forecast(cube: tuple[sp.csr_array, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """With the fill from CHOLMOD nearly exact, without it the bound of UMFPACK."""
    with Umfpack().analyse(cube[0], "spd") as analysis:
        plan, stats = analysis.forecast, analysis.factorize(cube[0]).stats
        assert plan.factor_entries == pytest.approx(stats.factor_entries, rel=0.01)
        assert plan.flops == pytest.approx(stats.flops, rel=0.05)
        assert stats.memory_bytes < plan.kept < plan.memory
    monkeypatch.setattr(umfpack, "fill_of", lambda A, order: None)
    with Umfpack().analyse(cube[0], "spd") as analysis:
        results = analysis.session.results
        assert analysis.forecast.memory > results[21] * results[3] > plan.memory
        assert analysis.factorize(cube[0]).stats.factor_entries == pytest.approx(stats.factor_entries, rel=0.02)


@pytest.mark.parametrize("kind", BOTH)
def test_many_right_hand_sides(kind: type[LinearSolver], cube: tuple[sp.csr_array, ...]) -> None:
    """More than a block of them, and the last block is smaller."""
    K, B = cube[0], _random(cube[0].shape[0], 200)
    with kind().factorize(K, "spd") as factor:
        assert _error(K, factor.solve(B), B) < 1e-12
        assert _error(K, factor.solve(B[:, :1]), B[:, :1]) < 1e-12


@pytest.mark.parametrize("columns", [15, 16, 41, 150])
def test_columns_solved_side_by_side_are_the_same(cube: tuple[sp.csr_array, ...], columns: int) -> None:
    """Three threads of the BLAS share the columns out: the same bytes twice, and as many threads as before."""
    A, B = cube[0], np.random.default_rng(4).standard_normal((cube[0].shape[0], columns))
    with Cholmod().factorize(A, "spd") as factor, limit_threads(1):
        alone = factor.solve(B)
        with limit_threads(3):
            together = factor.solve(B)
            assert np.array_equal(factor.solve(B), together)
            assert blas_threads() == 3
    assert np.abs(together - alone).max() < 1e-12 * np.abs(alone).max()
    assert np.abs(A @ together - B).max() < 1e-11 * np.abs(B).max()


def test_right_hand_sides_leave_no_memory_behind(cube: tuple[sp.csr_array, ...]) -> None:
    with Cholmod().analyse(cube[0], "spd") as analysis:
        factor, common = analysis.factorize(cube[0]), analysis.session.common
        before = common.memory_inuse
        factor.solve(_random(cube[0].shape[0], 5))
        assert common.memory_inuse == before


@pytest.mark.parametrize("kind", BOTH)
def test_threads_may_solve_with_one_factor(kind: type[LinearSolver], cube: tuple[sp.csr_array, ...]) -> None:
    K, B = cube[0], _random(cube[0].shape[0], 20)
    with kind().factorize(K, "spd") as factor, ThreadPoolExecutor(4) as pool:
        for X in pool.map(factor.solve, [B] * 24):
            assert _error(K, X, B) < 1e-12


def test_umfpack_gives_memory_back(cube: tuple[sp.csr_array, ...]) -> None:
    """CHOLMOD counts its memory itself, which is tested above."""
    sizes = []
    for _ in range(3):
        for _ in range(6):
            Umfpack().factorize(cube[0], "spd").close()
        gc.collect()
        sizes.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096)
    # Twelve factors of ten megabytes each.
    assert sizes[2] - sizes[0] < 30e6


class Watched:
    """A foreign library that leaves every call to ``watch(name, function, *args)``."""

    def __init__(self, library: Any, watch: Callable[..., object]) -> None:
        self.library, self.watch = library, watch

    def __getattr__(self, name: str) -> Callable[..., object]:
        return partial(self.watch, name, getattr(self.library, name))


def _watched(kind: type[LinearSolver], watch: Callable[..., object]) -> LinearSolver:
    """A solver of ``kind`` whose library leaves its calls to ``watch``; their names are those of the library."""
    library = kind.library()
    if kind is Cholmod:
        functions = {name: partial(watch, name, function) for name, function in library.functions.items()}
        spied: object = replace(library, functions=functions)
    else:
        spied = Watched(library, watch)
    return type(kind.__name__, (kind,), {"library": staticmethod(lambda: spied)})()


def test_umfpack_frees_a_factor_that_is_closed_or_singular(cube: tuple[sp.csr_array, ...]) -> None:
    calls: list[str] = []

    def note(name: str, function: Callable[..., object], *args: object) -> object:
        calls.append(name)
        return function(*args)

    with _watched(Umfpack, note).analyse(cube[0]) as analysis:
        factor = analysis.factorize(cube[0])
        assert "umfpack_dl_free_numeric" not in calls
        factor.close()
        assert calls[-1] == "umfpack_dl_free_numeric"
    ones = sp.csr_array(np.ones((2, 2)))
    with _watched(Umfpack, note).analyse(ones) as analysis:
        with refusal("model", by=SingularMatrixError):
            analysis.factorize(ones)
        assert calls[-2:] == ["umfpack_dl_numeric", "umfpack_dl_free_numeric"]


def test_cholmod_uses_the_order(cube: tuple[sp.csr_array, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    def entries() -> int:
        with Cholmod().analyse(cube[0], "spd") as analysis:
            return analysis.forecast.factor_entries

    good = entries()
    monkeypatch.setattr("morembs.linalg.sparse.cholmod.metis_ordering", lambda A: None)
    assert entries() < 2 * good
    monkeypatch.setattr("morembs.linalg.sparse.cholmod.metis_ordering", lambda A: np.arange(A.n))
    assert entries() > 1.5 * good


def test_umfpack_corrects_small_pivots() -> None:
    """A pivot just above the tolerance costs three digits of the first solution."""
    rng = np.random.default_rng(4)
    dense = rng.standard_normal((200, 200))
    A = sp.csr_array(dense + dense.T)
    A.setdiag(0.01 * rng.standard_normal(200))
    B = _random(200, 40)
    with Umfpack().analyse(A) as analysis:
        factor = analysis.factorize(A)
        plain = analysis.session.substitute(np.asfortranarray(B))
        assert _error(A, plain, B) > 3e-14
        assert _error(A, factor.solve(B), B) < 3e-15


def test_umfpack_takes_complex_values(cube: tuple[sp.csr_array, ...]) -> None:
    K, M = cube
    A = sp.csr_array((1.0 + 0.02j) * K - 1e8 * M)
    B = _random(K.shape[0], 35) + 1j * _random(K.shape[0], 35)
    with Umfpack().factorize(A, "complex-symmetric") as factor:
        X = factor.solve(B)
        assert X.dtype == np.complex128
        assert _error(A, X, B) < 1e-13
        with refusal("result", "solver", by=SolverError):
            factor.negative_pivots()


def test_umfpack_gives_no_inertia_after_other_pivots() -> None:
    A = sp.csr_array(sp.kron(sp.eye_array(40), np.array([[1e-9, 1.0], [1.0, 1e-9]])))
    with Umfpack().factorize(A) as factor, refusal("result", "solver", by=SolverError):
        factor.negative_pivots()


HEADER = """
#define CHOLMOD_MAIN_VERSION 9 /* a comment */
#define CHOLMOD_SUB_VERSION 8
#define CHOLMOD_SUBSUB_VERSION 7
#define CHOLMOD_MAXMETHODS 9
#define CHOLMOD_HOST_SUPERNODE_BUFFERS 8
typedef struct cholmod_common_struct
{
    double zrelax [3], fl, lnz ;
    size_t nrelax [3] ;
    int supernodal, final_ll, quick_return_if_not_posdef, print, nmethods, postorder, itype, status ;
    void (*error_handler) (int status, const char *file,
        int line, const char *message) ;
    struct cholmod_method_struct
    {
        double lnz ;
        int ordering ;
        size_t other_3 [4] ;
    } method [CHOLMOD_MAXMETHODS + 1] ;
    size_t memory_usage, memory_inuse ;
#ifdef GPU_BLAS
    #define CHOLMOD_CUBLAS_HANDLE cublasHandle_t
#else
    #define CHOLMOD_CUBLAS_HANDLE void *
#endif
    CHOLMOD_CUBLAS_HANDLE cublasHandle ;
    CHOLMOD_CUDASTREAM    gpuStream[CHOLMOD_HOST_SUPERNODE_BUFFERS];
} cholmod_common ;
typedef struct cholmod_sparse_struct
{
    size_t nrow, ncol, nzmax ;
    void *p, *i, *x ;
    int stype, itype, xtype, dtype, sorted, packed ;
} cholmod_sparse ;
typedef struct cholmod_dense_struct { size_t nrow, ncol, nzmax, d ; void *x ; int xtype, dtype ; } cholmod_dense ;
typedef struct cholmod_factor_struct
{
    size_t n, minor, nsuper, xsize, maxcsize ;
    void *Perm ;
    int is_super, xtype ;
} cholmod_factor ;
"""


def test_structures_are_read_from_the_header() -> None:
    version, structures = cholmod_library.parse_header(HEADER)
    common = structures["common"]
    assert version == "9.8.7"
    assert common.method.size == 10 * (8 + 8 + 32)
    assert common.error_handler.offset == 5 * 8 + 3 * 8 + 8 * 4
    assert common.gpuStream.size == 8 * ctypes.sizeof(ctypes.c_void_p)
    assert ctypes.sizeof(structures["dense"]) == 48


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("#define CHOLMOD_SUB_VERSION 8", "", "version"),
        ("double zrelax", "quad zrelax", "quad zrelax"),
        ("other_3 [4]", "other_3 [SIZE]", "SIZE"),
        ("itype, status ;", "itype ;", "lacks status"),
        ("} cholmod_factor ;", "} other ;", "no cholmod_factor"),
        ("    #define CHOLMOD_CUBLAS_HANDLE cublasHandle_t", "    int more ; /* CUBLAS */", "conditional"),
    ],
)
def test_unknown_headers_are_refused(old: str, new: str, reason: str) -> None:
    assert old in HEADER
    with pytest.raises(cholmod_library.UnusableError, match=reason):
        cholmod_library.parse_header(HEADER.replace(old, new))


def _installed() -> Path:
    names = [Path(folder) / name for folder in cholmod_library.FOLDERS for name in cholmod_library.HEADERS]
    return next(path for path in names if path.is_file() and "cholmod_common_struct" in path.read_text("latin-1"))


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("#define CHOLMOD_SUBSUB_VERSION ", "#define CHOLMOD_SUBSUB_VERSION 9", "the library"),
        ("double grow1 ;", "", "differs"),
        ("int prefer_zomplex ;", "int prefer_zomplex ; double one, two ;", "differs"),
    ],
)
def test_header_of_another_version_is_refused(old: str, new: str, reason: str, tmp_path: Path) -> None:
    text = _installed().read_text("latin-1")
    assert old in text
    (tmp_path / "cholmod_core.h").write_text(text.replace(old, new), "latin-1")
    words = cholmod_library.cholmod_library.__wrapped__((str(tmp_path),))
    assert reason in words and "apt-get install libsuitesparse-dev" in words


def test_missing_libraries_say_how_to_get_them(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (cholmod_library, umfpack):
        monkeypatch.setattr(module, "find_library", lambda name: None)
    for load in (cholmod_library.cholmod_library, umfpack.umfpack_library):
        assert "apt-get install libsuitesparse-dev" in load.__wrapped__()


def test_without_its_header_the_fill_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cholmod, "cholmod_library", lambda: "none")
    with Umfpack().factorize(sp.csr_array([[2.0]])) as factor:
        assert factor.solve(np.ones(1)) == pytest.approx(0.5)


def test_loops_of_cholmod_run_in_one_thread() -> None:
    library = cholmod_library.cholmod_library()
    assert not isinstance(library, str)
    if library.openmp is None:
        pytest.skip("this CHOLMOD has no OpenMP, or its BLAS needs it")
    get, _ = library.openmp
    before = get()
    with library.serial_loops():
        assert get() == 0
    assert get() == before > 0


@pytest.fixture
def interrupt() -> Iterator[Callable[[threading.Event], None]]:
    """Sends this process the signal of Ctrl-C once an event has come."""
    # A process that was started in the background ignores the signal.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)

    def send(event: threading.Event) -> None:
        if event.wait(PATIENCE):
            os.kill(os.getpid(), signal.SIGINT)

    yield lambda event: threading.Thread(target=send, args=(event,), daemon=True).start()
    signal.signal(signal.SIGINT, before)


class Held(ForeignObject):
    """A foreign object that knows when it was freed."""

    def __init__(self) -> None:
        super().__init__()
        self.freed = threading.Event()

    def _free(self) -> None:
        self.freed.set()


def test_an_interrupted_call_frees_what_it_works_on_when_it_ends(interrupt: Callable[[threading.Event], None]) -> None:
    held, begun, ended = Held(), threading.Event(), threading.Event()

    def long() -> None:
        begun.set()
        ended.wait(PATIENCE)

    interrupt(begun)
    with pytest.raises(KeyboardInterrupt):
        held.call(long)
    # The call still runs: nobody has ended it.
    assert held.abandoned and not held.freed.is_set()
    with refusal("result", "interrupted", by=SolverError):
        held.call(long)
    ended.set()
    assert held.freed.wait(PATIENCE)


def test_calls_give_results_errors_and_news() -> None:
    news: list[str] = []
    heard = threading.Event()

    class Listener:
        def stage(self, name: str) -> None: ...

        def update(self, text: str) -> None:
            news.append(text)
            heard.set()

    def fail() -> None:
        raise ValueError("wrong")

    held = Held()
    assert held.call(divmod, 7, 2) == (3, 1)
    with listening(Listener()):
        assert held.call(heard.wait, PATIENCE, news="factorising")
    with pytest.raises(ValueError, match="wrong"):
        held.call(fail)
    assert all(re.fullmatch(r"factorising \d+ s", text) for text in news), news
    assert not held.abandoned and not held.freed.is_set()


def test_a_call_outside_the_main_thread_runs_there() -> None:
    with ThreadPoolExecutor(1) as pool:
        own, used = pool.submit(lambda: (threading.get_ident(), Held().call(threading.get_ident))).result()
    assert own == used


@pytest.mark.parametrize("kind", BOTH)
def test_a_signal_ends_a_factorisation(
    kind: type[LinearSolver], cube: tuple[sp.csr_array, ...], interrupt: Callable[[threading.Event], None]
) -> None:
    """The wait ends before the call does; the call, which cannot be stopped, frees everything when it has ended."""
    called: list[str] = []
    begun, released, freed = (threading.Event() for _ in range(3))
    numeric, last = ("factorize", "finish") if kind is Cholmod else ("umfpack_dl_numeric", "umfpack_dl_free_symbolic")

    def slow(name: str, function: Callable[..., object], *args: object) -> object:
        if name == numeric:
            begun.set()
            released.wait(PATIENCE)
            called.append("ended")
        result = function(*args)
        if "free" in name or name == last:
            called.append(name)
        if name == last:
            freed.set()
        return result

    analysis = _watched(kind, slow).analyse(cube[0], "spd")
    called.clear()
    interrupt(begun)
    with pytest.raises(KeyboardInterrupt):
        analysis.factorize(cube[0])
    with refusal("result", "interrupted", by=SolverError):
        analysis.factorize(cube[0])
    analysis.close()
    assert called == []
    released.set()
    assert freed.wait(PATIENCE)
    assert called[0] == "ended" and called[-1] == last
    if kind is Cholmod:
        assert analysis.session.common.memory_inuse == 0
    else:
        assert called[1:] == ["umfpack_dl_free_numeric", last]
