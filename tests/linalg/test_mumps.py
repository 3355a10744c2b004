"""What MUMPS adds to the contract of all solvers: its memory, factors on disk, inertia, null space and complement."""

from __future__ import annotations

import gc
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from morembs.base.errors import BudgetError, SingularMatrixError, SolverError
from morembs.base.progress import listening
from morembs.linalg.sparse import mumps, mumps_library, ordering
from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps
from morembs.linalg.sparse.mumps_codes import Job
from morembs.linalg.sparse.symmetric import Lower
from tests.support.matrices import backward_error, brick, chain, random, shifted, sparse_loads
from tests.support.refusals import refusal

Kind = type[Mumps] | type[EmbeddedMumps]
FULL = Lower.of(brick(10))


@pytest.fixture(params=[Mumps, EmbeddedMumps], ids=lambda kind: kind.name)
def kind(request: pytest.FixtureRequest) -> Kind:
    if reason := request.param.unavailable():
        pytest.skip(reason)
    return request.param


def _watched(kind: Kind, watch: Callable[[Callable[[Any, int], None], Any, int], None]) -> Kind:
    """``kind`` whose library leaves every job to ``watch(call, data, job)``; ``data`` is the structure of MUMPS."""

    class Watched(mumps_library.Library):
        def call(self, data: Any, job: int) -> None:
            watch(super().call, data, job)

    def library(dtype: str) -> mumps_library.Library | str:
        real = kind.library(dtype)
        return real if isinstance(real, str) else Watched(**vars(real))

    return type(kind.__name__, (kind,), {"library": staticmethod(library)})


def _needs(precision: str, structure: str) -> None:
    if reason := Mumps.lacks(precision, structure):
        pytest.skip(reason)


def _bytes_in(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def test_indefinite_matrix_is_not_taken_for_positive_definite(kind: Kind) -> None:
    with refusal("model", "", "16", by=SingularMatrixError):
        kind().factorize(shifted(chain(20), 1.3), "spd")


def test_the_order_is_used(kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    if ordering.metis_ordering(FULL) is None:
        pytest.skip("no METIS library; get it with: sudo apt-get install libmetis5")

    def entries() -> int:
        with kind().factorize(FULL, "spd") as factor:
            return factor.stats.factor_entries

    good = entries()
    monkeypatch.setattr(mumps, "metis_ordering", lambda A: np.arange(A.n))
    band = entries()
    assert good < 0.7 * band
    monkeypatch.setattr(mumps, "metis_ordering", lambda A: None)
    assert entries() < 0.9 * band


@pytest.mark.parametrize("hopeless", [False, True])
def test_workspace_is_raised_when_it_was_too_small(kind: Kind, hopeless: bool) -> None:
    asked: list[int] = []
    codes: list[int] = []

    def starve(call: Callable[[Any, int], None], data: Any, job: int) -> None:
        if job == Job.FACTORIZE:
            # ICNTL(14), the room in per cent.
            asked.append(int(data.icntl[13]))
            if hopeless or len(asked) == 1:
                data.icntl[13] = -60
        call(data, job)
        codes.extend([int(data.infog[0])] if job == Job.FACTORIZE else [])

    A, b = brick(8), random(1536)
    if hopeless:
        with refusal("result", "", "INFOG", by=SolverError):
            _watched(kind, starve)().factorize(A)
        assert asked == [20, 40, 80, 160]
        return
    with _watched(kind, starve)().factorize(A) as factor:
        assert backward_error(A, factor.solve(b), b) < 1e-14
    assert asked == [20, 40] and codes[0] in (-8, -9) and codes[1] == 0


def test_memory_is_given_back(kind: Kind) -> None:
    if not Path("/proc/self/statm").exists():
        pytest.skip("the resident memory is read from /proc")
    A, sizes = brick(6), []
    for _ in range(3):
        for _ in range(10):
            kind().factorize(A).close()
        gc.collect()
        sizes.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096)
    assert sizes[2] - sizes[0] < 3e6


def test_threads_factorise_and_solve_at_the_same_time(kind: Kind) -> None:
    """Several analyses alive at once, each used by the thread that made it."""
    gate = threading.Barrier(4)

    def error(number: int) -> float:
        A, b = shifted(brick(6), 13.7 * (number % 2)), random(648)
        with kind().analyse(A) as analysis:
            gate.wait(600)
            return max(backward_error(A, analysis.factorize(A).solve(b), b) for _ in range(3))

    with ThreadPoolExecutor(4) as pool:
        assert max(pool.map(error, range(8))) < 1e-13


def test_inertia_keeps_no_factor(kind: Kind) -> None:
    A, controls = shifted(brick(5), 13.7), []

    def note(call: Callable[[Any, int], None], data: Any, job: int) -> None:
        if job == Job.FACTORIZE:
            # ICNTL(31) discards the factor, ICNTL(22) writes it to the disk.
            controls.append((data.icntl[30], data.icntl[21]))
        call(data, job)

    count = np.count_nonzero(np.linalg.eigvalsh(A.toarray()) < 0)
    assert _watched(kind, note)(out_of_core=True).negative_eigenvalues(A) == count and controls == [(1, 0)]
    with kind(discard=True).analyse(A) as analysis, refusal("result", "", "INFOG(1)", "-44", by=SolverError):
        analysis.factorize_unchecked(Lower.of(A)).solve(np.ones(375))


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_budget_decides_where_the_factor_lies(kind: Kind, tmp_path: Path, structure: str) -> None:
    B = random(3000, 3)
    with kind().analyse(FULL, structure) as analysis:
        in_core = analysis.forecast.memory
        assert not analysis.forecast.out_of_core and analysis.forecast.kept >= 8 * analysis.forecast.factor_entries
    with kind(memory=in_core, scratch=tmp_path).factorize(FULL, structure) as factor:
        assert not factor.stats.out_of_core and not list(tmp_path.iterdir())
    with refusal("memory", "", "0.0", by=BudgetError) as caught:
        kind(memory=1000, scratch=tmp_path / "new").factorize(FULL, structure)
    on_disk = caught.value.needed
    assert on_disk < 0.7 * in_core and not (tmp_path / "new").exists()
    for budget in (on_disk, int(0.9 * in_core)):
        with kind(memory=budget, scratch=tmp_path / "new").factorize(FULL, structure) as factor:
            assert factor.stats.out_of_core and factor.stats.memory_bytes == 0
            assert _bytes_in(tmp_path / "new") >= 0.9 * factor.stats.disk_bytes > 1e6
            assert backward_error(brick(10), factor.solve(B), B) < 1e-13
        assert not list((tmp_path / "new").iterdir())
    with pytest.raises(BudgetError):
        kind(memory=on_disk, out_of_core=False).factorize(FULL, structure)


def test_a_second_factor_takes_the_place_of_the_first_on_disk(kind: Kind, tmp_path: Path) -> None:
    sizes, B = [], sparse_loads(1536, 5)
    with kind(out_of_core=True, scratch=tmp_path).analyse(brick(8)) as analysis:
        for shift in (0.0, 13.7, 2.2):
            A = shifted(brick(8), shift)
            factor = analysis.factorize(A)
            for _ in range(2):
                assert backward_error(A, factor.solve(B), B.toarray()) < 1e-12
                assert backward_error(A, factor.solve(B.toarray()), B.toarray()) < 1e-12
            sizes.append(_bytes_in(tmp_path))
    assert sizes[2] <= 1.1 * sizes[0] and not list(tmp_path.iterdir())


def test_single_precision_takes_half_the_disk(tmp_path: Path) -> None:
    _needs("single", "spd")
    A, b, disk = brick(10), random(3000), {}
    for precision in mumps.PRECISIONS:
        with Mumps(precision=precision, out_of_core=True, scratch=tmp_path).analyse(A, "spd") as analysis:
            factor = analysis.factorize_unchecked(FULL)
            disk[precision] = factor.stats.disk_bytes, _bytes_in(tmp_path)
            assert factor.stats.precision == precision
            error = np.linalg.norm(A @ factor.solve(b) - b) / np.linalg.norm(b)
            assert 1e-7 < error < 1e-4 if precision == "single" else error < 1e-12
    assert disk["single"][0] <= 0.51 * disk["double"][0] and disk["single"][1] <= 0.6 * disk["double"][1]
    with refusal("value", "precision", "double", "single"):
        Mumps(precision="half")


def test_low_rank_needs_a_library_that_can(kind: Kind) -> None:
    library = kind.library("float64")
    assert isinstance(library, mumps_library.Library)
    if not library.low_rank:
        with refusal("program", "low_rank", "0.0001"):
            kind(low_rank=1e-4).factorize(FULL, "spd")
        return
    controls = []

    def note(call: Callable[[Any, int], None], data: Any, job: int) -> None:
        if job == Job.FACTORIZE:
            # ICNTL(35) chooses blocks of low rank, CNTL(7) is what they may drop.
            controls.append((data.icntl[34], data.cntl[6]))
        call(data, job)

    with _watched(kind, note)(low_rank=1e-4).analyse(FULL, "spd") as analysis:
        x = analysis.factorize_unchecked(FULL).solve(random(3000))
    assert controls == [(2, 1e-4)]
    assert backward_error(brick(10), x, random(3000)) < 1e-3


@pytest.fixture
def on_disk(kind: Kind, tmp_path: Path) -> Iterator[Any]:
    yield kind(out_of_core=True, scratch=tmp_path / "scratch")
    assert not list((tmp_path / "scratch").iterdir())


def test_scratch_is_empty_after_an_exception(on_disk: Any) -> None:
    with pytest.raises(ZeroDivisionError), on_disk.factorize(brick(8), "spd"):
        assert len(list(on_disk.scratch.iterdir())) == 1
        raise ZeroDivisionError
    with pytest.raises(SingularMatrixError):
        on_disk.factorize(chain(40, held=False), "spd")


@pytest.mark.parametrize("job", [Job.ANALYSE, Job.FACTORIZE])
def test_an_interrupt_of_the_wait_leaves_nothing_behind(on_disk: Any, job: int) -> None:
    """The call goes on alone, then MUMPS frees what it holds; the folder is gone at once."""
    ended, freed = threading.Event(), threading.Event()

    def slow(call: Callable[[Any, int], None], data: Any, now: int) -> None:
        if now == job:
            assert ended.wait(600)
        call(data, now)
        if now == Job.END:
            freed.set()

    class Impatient:
        def stage(self, name: str) -> None: ...

        def update(self, text: str) -> None:
            raise KeyboardInterrupt

    solver = _watched(type(on_disk), slow)(out_of_core=True, scratch=on_disk.scratch)
    # Without the collector, which would hide a folder that nobody closed.
    gc.disable()
    try:
        with listening(Impatient()), pytest.raises(KeyboardInterrupt):
            solver.factorize(brick(6), "spd")
        assert not list(on_disk.scratch.iterdir()) and not freed.is_set()
        ended.set()
        assert freed.wait(600)
    finally:
        gc.enable()


def test_a_disk_that_is_too_small_is_reported_before(on_disk: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=1_000_000))
    with refusal("result", "", "0.0", by=SolverError):
        on_disk.factorize(brick(8), "spd")


def test_unusable_scratch_folders_are_reported(kind: Kind, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with refusal("output", "scratch"):
        kind(out_of_core=True, scratch=tmp_path / "file" / "below").factorize(brick(4), "spd")
    deep = tmp_path.joinpath(*["a" * 200] * 6)
    with refusal("value", "scratch"):
        kind(out_of_core=True, scratch=deep).factorize(brick(4), "spd")
    assert not list(deep.iterdir())
