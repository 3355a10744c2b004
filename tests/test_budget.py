"""The memory a process may use, the files for what does not fit, and the algorithms that work in pieces for it."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base import scratch as scratches
from morembs.base.budget import UNLIMITED, Budget, current_budget, is_in_file
from morembs.base.errors import OutputError
from morembs.base.scratch import ScratchFolder, free_bytes
from morembs.base.types import Values
from morembs.dynamics.nonlinear.total_lagrangian import SaintVenantKirchhoff
from morembs.fem.interface import make_interface
from morembs.linalg.congruence import congruence, magnitudes
from morembs.linalg.lanczos import BlockLanczos
from morembs.linalg.space import Columns, Space
from morembs.problem import Problem, System
from morembs.reducers import CraigBampton
from tests.support.machine import has_memory
from tests.support.matrices import brick, mass, random
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

MB = 1 << 20


@pytest.fixture
def filed(tmp_path: Path) -> Budget:
    """A budget that puts every array into a file."""
    return Budget(1, tmp_path, in_memory=0)


def test_small_arrays_and_those_without_a_limit_stay_in_memory(tmp_path: Path) -> None:
    for budget, size in ((Budget(None, tmp_path), 3 * MB), (Budget(2000 * MB, tmp_path), MB)):
        A = budget.empty((size, 1), order="F")
        assert A.shape == (size, 1) and not A.any() and not list(tmp_path.iterdir())
    # Less than a fiftieth of a large budget is no reason to use the disk.
    assert Budget(4 << 30, tmp_path).empty(8 * MB).nbytes == 64 * MB and not list(tmp_path.iterdir())


def test_many_small_arrays_do_not_fill_what_little_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    has_memory(monkeypatch, resident=80 * MB)
    with Budget(100 * MB, tmp_path) as budget:
        arrays = [budget.empty(MB // 2) for _ in range(3)]
        assert budget.files == 3
        assert budget.empty(1000).nbytes == 8000 and budget.files == 3
        # An array that nobody holds any more takes no room.
        del arrays[1]
        assert budget.files == 2
    with Budget(1000 * MB, tmp_path) as budget:
        budget.empty(MB // 2)
        assert not budget.files


def test_a_raise_counts_the_arrays_that_it_lets_stay_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Made again under the budget that ``raise_for`` names they leave what was asked for, under less they do not."""

    held: list[Values] = []

    def left_by_four(budget: Budget) -> int:
        """What is left after four arrays."""
        resident = 80 * MB
        has_memory(monkeypatch, resident=resident)
        held.clear()
        for _ in range(4):
            before = budget.files
            held.append(budget.empty(10 * MB // 8))
            resident += 10 * MB if budget.files == before else 0
            has_memory(monkeypatch, resident=resident)
        left = budget.bytes_left()
        assert left is not None
        return left

    for wanted in (21 * MB, 30 * MB, 50 * MB, 200 * MB):
        with Budget(100 * MB, tmp_path) as tight:
            left = left_by_four(tight)
            assert left == 20 * MB and tight.files == 4
            more = tight.raise_for(wanted - left)
            assert more - (wanted - left) in (0, 10 * MB, 20 * MB, 30 * MB, 40 * MB)
        with Budget(100 * MB + more, tmp_path) as enough:
            assert left_by_four(enough) >= wanted
        if wanted == 50 * MB:
            with Budget(100 * MB + wanted - left, tmp_path) as short:
                assert left_by_four(short) < wanted


@pytest.mark.parametrize("order", ["C", "F"])
def test_large_arrays_live_in_a_file_without_a_name(tmp_path: Path, order: str) -> None:
    with Budget(100 * MB, tmp_path) as budget:
        A = budget.empty((2 * MB, 3), np.complex64, order)
        assert A.dtype == np.complex64 and A.flags["F_CONTIGUOUS" if order == "F" else "C_CONTIGUOUS"]
        A[:] = values = random(2 * MB, 3)
        (folder,) = tmp_path.iterdir()
        # The space is taken now, and nothing but the mark of the owner is left if the process is killed.
        assert [path.name for path in folder.iterdir()] == ["owner.lock"]
        budget.release_pages()
        np.testing.assert_array_equal(A, values.astype(np.complex64))
        assert budget.empty(3).base is None
    assert not list(tmp_path.iterdir())
    np.testing.assert_array_equal(A[-1], values[-1].astype(np.complex64))
    assert budget.empty(MB * 16).shape == (16 * MB,) and len(list(tmp_path.iterdir())) == 1
    budget.close()


REST = """
import sys
import threading
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
import numpy as np
from morembs.base.budget import (Budget)
from morembs.base.memory import resident_bytes
memory = resident_bytes() + int(sys.argv[2])
budget = Budget(memory, Path(sys.argv[1]), in_memory=16_000_000)
A = budget.empty(10_000_000)
empty = resident_bytes()
A[:] = np.arange(1e7)
full = resident_bytes()
budget.release_if_tight()
relaxed = resident_bytes()
budget.release_pages()
rested, off = resident_bytes(), budget.bytes_left() + resident_bytes() - memory
print(empty, full, relaxed, rested, int(A.sum() == 49999995000000.0), off)
"""


@pytest.mark.parametrize(("more", "tight"), [(95 * MB, True), (3000 * MB, False)])
def test_rest_gives_memory_back_and_keeps_the_values(tmp_path: Path, more: int, tight: bool) -> None:
    """In a process of its own, whose resident memory nothing else changes."""
    if not Path("/proc/self/statm").exists():
        pytest.skip("the resident memory is read from /proc")
    done = subprocess.run([sys.executable, "-c", REST, tmp_path, str(more)], capture_output=True, text=True, check=True)
    empty, full, relaxed, rested, same, off = map(int, done.stdout.split())
    assert full - empty > 75e6 and rested - empty < 5e6 and same and abs(off) < MB
    # In loops the pages go only when the budget is nearly used up.
    assert (relaxed - empty < 5e6) == tight
    assert not list(tmp_path.iterdir())


def test_columns_are_a_power_of_two_that_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Budget().columns(10**9) == 256 and Budget(widest=4).columns(10**9) == 4
    has_memory(monkeypatch, resident=400 * MB)
    for memory in (1, 100, 500, 700, 1100, 5000, 10**6):
        budget = Budget(memory * MB)
        assert budget.bytes_left() == (memory - 400) * MB
        for n, copies in ((10**5, 4), (10**6, 1)):
            columns = budget.columns(n, copies)
            assert columns in (4, 8, 16, 32, 64, 128, 256)
            share = 0.25 * (memory - 400) * MB
            assert columns == 4 or 8 * n * copies * columns <= share
            assert columns == 256 or 16 * n * copies * columns > share


def test_products_read_few_columns_of_long_arrays_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many for the same budget whatever is in memory, so that results do not depend on that."""
    has_memory(monkeypatch, resident=4000 * MB)
    assert Budget().read_at_once(10_000_000) == 64 == Budget(memory=8_000_000_000).read_at_once(10_000)
    assert Budget(memory=6_000_000_000).read_at_once(2_000_000) == 11
    assert Budget(memory=100_000_000).read_at_once(2_000_000) == 4
    widths: list[int] = []

    class Seen(np.ndarray):
        def __getitem__(self, key: Any) -> Any:
            part = np.asarray(self)[key]
            widths.append(part.shape[1])
            return part

    rng = np.random.default_rng(4)
    V, W = rng.standard_normal((5000, 30)), rng.standard_normal((5000, 3))
    product = Columns(budget=Budget(memory=10_000_000, scratch=tmp_path)).dot(V.view(Seen), W)
    assert product == pytest.approx(V.T @ W, rel=1e-12) and widths == [7, 7, 7, 7, 2]


def test_a_full_disk_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with Budget(100 * MB, tmp_path) as budget:
        with refusal("output", "scratch", "0.03", by=OutputError):
            budget.empty(4 * MB)
        # Small arrays need no disk.
        assert budget.empty(10).shape == (10,)
    assert not list(tmp_path.iterdir())


SCRATCH = """
import sys
import threading
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from morembs.base.scratch import ScratchFolder
folder = ScratchFolder(Path(sys.argv[1]))
(folder.path / "factor").write_bytes(b"x" * 1000)
print(folder.path, flush=True)
sys.stdin.readline()
"""


def _owner(parent: Path) -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen(
        [sys.executable, "-c", SCRATCH, parent], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    return process, Path(process.stdout.readline().strip())


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path: Path) -> None:
    process, path = _owner(tmp_path)
    with process:
        # While it lives, nobody touches its folder.
        own = ScratchFolder(tmp_path)
        assert (path / "factor").stat().st_size == 1000 and own.path.is_dir()
        process.send_signal(signal.SIGKILL)
    assert (path / "factor").exists()
    second = ScratchFolder(tmp_path)
    assert not path.exists() and own.path.is_dir() and second.path.is_dir()
    own.close()
    own.close()
    second.close()
    assert not list(tmp_path.iterdir())


def test_scratch_folder_goes_with_the_process_or_with_its_owner(tmp_path: Path) -> None:
    process, path = _owner(tmp_path / "new" / "folder")
    with process:
        assert path.parent == (tmp_path / "new" / "folder").resolve() and path.stat().st_mode & 0o777 == 0o700
    assert process.returncode == 0 and not path.exists()
    ScratchFolder(tmp_path / "new" / "folder")
    assert not list((tmp_path / "new" / "folder").iterdir())


def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    """A name is no proof: the mark of an owner that is gone is."""
    for name in ("morembs-results", "morembs-old", "other"):
        (tmp_path / name).mkdir()
    (tmp_path / "morembs-results" / "body.h5").write_text("")
    (tmp_path / "morembs-link").symlink_to(tmp_path / "other")
    (tmp_path / "morembs-file").write_text("")
    scratches.remove_abandoned(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["morembs-file", "morembs-link", "morembs-old", "morembs-results", "other"]


CUT = """
import os, sys
import threading
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from morembs.base.scratch import ScratchFolder

def traced(event, arguments):
    if event == sys.argv[2]:
        os._exit(9)

if sys.argv[3] == "made":
    sys.addaudithook(traced)
folder = ScratchFolder(Path(sys.argv[1]))
(folder.path / "factor").write_bytes(b"x" * 1000)
sys.addaudithook(traced)
folder.close()
"""


@pytest.mark.parametrize(
    ("event", "when"), [("fcntl.flock", "made"), ("os.rename", "made"), ("os.rmdir", "closed"), ("os.remove", "closed")]
)
def test_what_was_cut_off_while_it_was_made_or_removed_goes_with_the_next(
    tmp_path: Path, event: str, when: str
) -> None:
    ended = subprocess.run([sys.executable, "-c", CUT, tmp_path, event, when], check=False)
    assert ended.returncode == 9 and len(list(tmp_path.iterdir())) == 1
    ScratchFolder(tmp_path).close()
    assert not list(tmp_path.iterdir())


def test_a_folder_that_another_run_took_away_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mkdtemp, taken = tempfile.mkdtemp, []

    def at_once_taken(**options: Any) -> str:
        """A folder that is not marked yet when another run sees it."""
        folder = mkdtemp(**options)
        if not taken:
            taken.append(Path(folder))
            scratches.remove_abandoned(tmp_path)
        return folder

    monkeypatch.setattr(tempfile, "mkdtemp", at_once_taken)
    own = ScratchFolder(tmp_path)
    assert taken and not taken[0].exists() and list(tmp_path.iterdir()) == [own.path]
    own.close()


def test_parent_that_cannot_be_used_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    with refusal("output", "scratch"):
        ScratchFolder(tmp_path / "file" / "below")

    def refused(**options: object) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "mkdtemp", refused)
    with refusal("output", "scratch"):
        ScratchFolder(tmp_path)
    assert free_bytes(tmp_path / "not" / "yet") == free_bytes(tmp_path) > 0


def test_a_large_congruence_is_made_in_pieces() -> None:
    """2.7 million entries of which most are kept, against SciPy."""
    n = 80_000
    bands = [np.sin(1.0 + np.arange(n - abs(k))) for k in range(-17, 18)]
    A = sp.csr_array(sp.diags_array(bands, offsets=range(-17, 18)))
    A = sp.csr_array(A + A.T)
    slave = np.zeros(n, dtype=bool)
    slave[[5, 6, 40_000, n - 1]] = True
    rows = np.concatenate([np.flatnonzero(~slave), np.repeat(np.flatnonzero(slave), 6)])
    columns = np.concatenate([np.arange(n - 4), np.tile(n - 4 + np.arange(6), 4)])
    values = np.concatenate([np.ones(n - 4), random(24)])
    T = sp.csr_array((values, (rows, columns)), shape=(n, n + 2))
    assert abs(congruence(T, A) - T.T @ A @ T).max() < 1e-12


@pytest.mark.parametrize("in_files", [False, True])
def test_congruence_is_that_of_scipy(filed: Budget, in_files: bool) -> None:
    """Most rows are kept, some follow six others (a rigid interface), some follow many, some vanish."""
    rng = np.random.default_rng(6)
    A = sp.csr_array(brick(4))
    for slaves, masters in ((0, 0), (12, 6), (90, 6), (150, 20)):
        slave = np.zeros(192, dtype=bool)
        slave[rng.permutation(192)[:slaves]] = True
        kept = int((~slave).sum())
        T = np.zeros((192, kept + masters + 1))
        T[~slave, rng.permutation(kept)] = 1.0
        T[slave, kept : kept + masters] = rng.standard_normal((slaves, masters))
        T[np.flatnonzero(slave)[:2]] = 0.0
        T = sp.csr_array(T)
        with filed.in_use() if in_files else nullcontext():
            product = congruence(T, A)
        assert product.has_canonical_format and product.shape == (T.shape[1],) * 2
        expected = (T.T @ A @ T).toarray()
        np.testing.assert_allclose(product.toarray(), expected, rtol=0, atol=1e-13 * np.abs(expected).max())
        assert not product[[T.shape[1] - 1]].nnz
        rows = np.repeat(np.arange(product.shape[0]), np.diff(product.indptr))
        assert (np.diff(rows * product.shape[0] + product.indices) > 0).all()
    assert bool(filed.files) == in_files
    np.testing.assert_allclose(magnitudes(A, np.ones((192, 1)))[:, 0], abs(A).sum(axis=1), rtol=1e-14)
    filed.close()


def test_congruence_leaves_a_matrix_with_rows_in_any_order_as_it_was() -> None:
    A = sp.csr_array(brick(2))
    reverse = np.concatenate([np.arange(end - 1, begin - 1, -1) for begin, end in pairwise(A.indptr)])
    turned = sp.csr_array((A.data[reverse], A.indices[reverse], A.indptr), shape=A.shape)
    product = congruence(sp.csr_array(sp.eye_array(A.shape[0])), turned)
    assert product.has_canonical_format and (abs(product - A).max(), abs(turned - A).max()) == (0, 0)


@pytest.mark.parametrize(("rows", "width"), [(50, 8), (50, 150), (70_000, 8)])
def test_products_of_tall_blocks_are_those_of_numpy(filed: Budget, rows: int, width: int) -> None:
    """Also of so many columns, or rows, that they are taken in pieces."""
    V = filed.empty((rows, width), order="F")
    V[:] = values = random(rows, width)
    W, C, Y = random(rows, 4, seed=5), random(width, 4), random(width, 3, seed=6)
    columns = Columns(budget=filed)
    np.testing.assert_allclose(columns.dot(V, W), values.T @ W, atol=1e-9)
    rest = W.copy()
    columns.subtract(V, C, rest)
    np.testing.assert_allclose(rest, W - values @ C, atol=1e-12)
    out = np.full((rows, 3), np.nan)
    assert columns.multiply_into(V, Y, out) is out
    np.testing.assert_allclose(out, values @ Y, atol=1e-12)
    columns.multiply_into(V, Y, V[:, :3])
    np.testing.assert_allclose(V, np.hstack([values @ Y, values[:, 3:]]), atol=1e-12)
    assert columns.dot(V[:, :0], W).shape == (0, 4)
    assert is_in_file(V[:, 1:]) and not is_in_file(values)
    filed.close()


@pytest.mark.parametrize("memory", [None, 1])
def test_columns_are_put_in_order_where_they_lie(memory: int | None) -> None:
    """In memory and in a file; the columns behind them stay."""
    with Budget(memory=memory, in_memory=0 if memory else None) as budget:
        V = budget.empty((70, 6), order="F")
        V[:] = values = random(70, 6)
        assert is_in_file(V) is bool(memory)
        ordered = Columns(budget=budget).reorder(V, np.array([3, 0, 5]))
        np.testing.assert_array_equal(ordered, values[:, [3, 0, 5]])
        np.testing.assert_array_equal(V, np.hstack([values[:, [3, 0, 5]], values[:, 3:]]))


def test_a_larger_krylov_space_keeps_the_relation(filed: Budget) -> None:
    """Op V = V T + W E' before and after, with W in the columns of the last block."""
    K, M = brick(3).toarray(), mass(brick(3))
    lanczos = BlockLanczos(lambda F: np.linalg.solve(K, F), Space(M, budget=filed), random(81, 4), capacity=12)

    def off() -> float:
        V, T = lanczos.V[:, : lanczos.size], lanczos.T[: lanczos.size, : lanczos.size]
        rest = np.linalg.solve(K, M @ V) - V @ T
        rest[:, lanczos.last] -= lanczos.rest_vectors
        return float(np.abs(rest).max() + np.abs(V.T @ (M @ V) - np.eye(lanczos.size)).max())

    for size in (4, 8, 12):
        lanczos.expand()
        assert lanczos.size == size and off() < 1e-12
    assert lanczos.full()
    lanczos.enlarge(24)
    assert not lanczos.full() and lanczos.V.shape == (81, 24) and off() < 1e-12
    for _ in range(3):
        lanczos.expand()
        assert off() < 1e-12
    assert lanczos.size == 24
    filed.close()


def test_what_is_made_within_a_budget_keeps_it() -> None:
    assert current_budget() is UNLIMITED
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.03)))
    with Budget(memory=10**12, widest=4) as outer:
        with outer.in_use(), Budget(widest=8) as inner:
            assert current_budget() is inner
        assert current_budget() is outer
        problem = Problem(model, [make_interface(model, name="end", nodes=where(model, 0, 0.4))])
        others: list[Budget] = []
        thread = threading.Thread(target=lambda: others.append(current_budget()))
        thread.start()
        thread.join()
        # A thread has none of its own.
        assert others == [UNLIMITED]
    assert current_budget() is UNLIMITED
    kept = [problem.budget, problem.space.budget, problem.stiffness.budget, problem.system.space.budget]
    thread = threading.Thread(target=lambda: kept.append(problem.statics.budget))
    thread.start()
    thread.join()
    with problem:
        assert all(budget is outer for budget in kept) and problem.free_free.statics.space.budget is outer
        reduced = CraigBampton(modes=2).reduce(problem)
    with Problem(model, problem.interfaces) as free:
        assert free.budget is not outer and free.budget.memory is None
        expected = CraigBampton(modes=2).reduce(free)
    np.testing.assert_allclose(reduced.K, expected.K, atol=1e-9 * np.abs(expected.K).max())


def _of_worker(shared: tuple[System, None], s: complex) -> tuple[int | None, bool, bool]:
    system = shared[0]
    own = system.space.budget
    return own.memory, own is system.stiffness.budget, current_budget() is own


def test_a_worker_has_a_share_of_the_budget(tmp_path: Path) -> None:
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.03)))
    points = [1j * w for w in (10.0, 20.0, 30.0, 40.0)]
    with (
        Budget(memory=8 * 10**9, scratch=tmp_path),
        Problem(model, [make_interface(model, name="end", nodes=where(model, 0, 0.4))], workers=2) as problem,
        problem.system.worker_pool(None, points, workers=2, columns=6) as pool,
    ):
        assert pool.workers == 2
        for memory, same, _ in pool.each(_of_worker, points):
            assert memory is not None and 0 < memory < 8 * 10**9 and same


def test_another_process_gets_the_limits_and_no_files(tmp_path: Path) -> None:
    with Budget(memory=10**12, scratch=tmp_path, in_memory=0, widest=4) as budget:
        solid = SaintVenantKirchhoff(steel(box("hex8", (2, 1, 1), (0.2, 0.05, 0.03))))
        held = budget.empty((10, 3))
        assert budget.files and len(held) == 10
        _, _, state = solid.__reduce__()
        there = pickle.loads(pickle.dumps(state["budget"]))
    assert (there.memory, there.scratch, there.in_memory, there.widest, there.files) == (10**12, tmp_path, 0, 4, 0)
