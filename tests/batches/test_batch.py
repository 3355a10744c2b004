"""Batches: what is due, processes that work for them, and what is remembered."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from morembs.app.batches.children import Children
from morembs.app.batches.manifest import Manifest
from morembs.app.batches.plan import find_unchanged, parts_of
from morembs.app.batches.records import Nobody, Record
from morembs.app.batches.run import batch
from morembs.app.batches.workers import Finished, Heard, Task, Worker
from morembs.base import stopping
from morembs.body.file import read_body
from morembs.storage.contents import Content
from tests.support import decks, processes
from tests.support.batches import remember
from tests.support.refusals import Refusal, refusal

# Seconds after which a wait for another thread counts as endless.
PATIENCE = 600.0

# A program that says what it gets, prints a document, and waits for the end of its input if it is asked to.
CHILD = """
import json, os, sys
print("[2 s] stage", file=sys.stderr, flush=True)
verb, *paths = [word for word in sys.argv[1:] if not word.startswith("--")]
if verb == "die":
    os.kill(os.getpid(), 9)
if verb == "fail":
    print("error: one\\ntwo", file=sys.stderr)
    raise SystemExit(2)
if verb == "wait":
    sys.stdin.read()
    open(paths[0], "w").close()
print(json.dumps([{"threads": os.environ["OMP_NUM_THREADS"]} for _ in paths]))
"""


def states(records: tuple[Record, ...]) -> dict[str, str]:
    return {record.name: record.state for record in records}


def jobs(folder: Path, tables: Mapping[str, Mapping[str, str]]) -> Path:
    """A folder with the job NAME/NAME.toml for each name, each with a deck of its own."""
    for name, own in tables.items():
        (folder / name).mkdir()
        decks.folder(folder / name, own, decks.deck(decks.BEAM[:12])).rename(folder / name / f"{name}.toml")
    return folder


@pytest.mark.usefixtures("forked_jobs")
def test_only_what_is_due_is_run(tmp_path: Path) -> None:
    """A sound job, one with a wrong material, one without its deck."""
    wrong = {"material": 'set = "all"\nyoung = 1\npoisson = 0.6\ndensity = 1'}
    folder = jobs(tmp_path, {"a": {}, "wrong": wrong, "lost": {}})
    (folder / "lost" / "part.inp").unlink()

    class Told(Nobody):
        def end_job(self, part: object, count: int, record: Record) -> None:
            order.append(record.name)

    order: list[str] = []
    records = batch([folder], listener=Told())
    assert states(records) == {"a": "done", "wrong": "failed", "lost": "failed"}
    assert set(order[:2]) == {"wrong", "lost"}  # before anything is factorised
    by_name = {record.name: record for record in records}
    assert "poisson" in by_name["wrong"].message and "part.inp" in by_name["lost"].message
    assert {record.code for record in records if record.state == "failed"} == {2}
    body = read_body(folder / "a" / "part.h5").bodies["cb"]
    assert by_name["a"].facts["bodies"]["cb"]["order"] == len(body.mass_matrix)

    # One byte of the deck.
    deck = folder / "a" / "part.inp"
    deck.write_text(deck.read_text().replace("30.0", "33.0"))
    (folder / "wrong" / "wrong.toml").unlink()
    (folder / "lost" / "lost.toml").unlink()
    (record,) = batch([folder], changes=[])
    assert record.state == "done" and record.facts["mass"] > 1.02 * by_name["a"].facts["mass"]
    assert states(batch([folder])) == {"a": "unchanged"}


def on_terminal(work: Callable[[], object], folder: Path) -> tuple[int, str, str]:
    """Exit code and standard output of ``work``, and what its standard error shows on a terminal, without colours."""
    master, slave = os.openpty()
    shown: list[bytes] = []

    def read() -> None:
        # Reading fails once nobody has the other end any more.
        with contextlib.suppress(OSError):
            while block := os.read(master, 4096):
                shown.append(block)

    def begin() -> None:
        os.dup2(slave, 2)
        work()

    reader = threading.Thread(target=read)
    reader.start()
    try:
        ended = processes.apart(begin, folder)
    finally:
        os.close(slave)
        reader.join(PATIENCE)
        os.close(master)
    return ended.code, ended.output, re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", b"".join(shown).decode().replace("\r", "\n"))


@pytest.mark.skipif(sys.platform == "win32", reason="terminals are POSIX")
@pytest.mark.usefixtures("forked_jobs")
def test_a_terminal_shows_each_job_above_a_bar(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    wrong = {"material": 'set = "all"\nyoung = 1\npoisson = 0.6\ndensity = 1'}
    folder = jobs(tmp_path, {"a": {}, "wrong": wrong})
    code, output, shown = on_terminal(processes.program(["batch", str(folder)]), folder)
    assert code == 2 and output.splitlines()[-1] == "1 done, 1 failed"
    assert re.search(r"^\[1/2\] a: done in .+, order 16, [\d.]+ GB$", shown, re.MULTILINE), shown
    assert re.search(r"^\[2/2\] wrong: failed: .*poisson", shown, re.MULTILINE)
    # A job that runs has a line of its own; the bar counts those that ended.
    assert set(re.findall(r"^\[./2\] (\S+) +━+", shown, re.MULTILINE)) == {"a"}
    counts = [int(count) for count in re.findall(r"^batch +\S+ +(\d)/2", shown, re.MULTILINE)]
    assert counts == sorted(counts) and set(counts) >= {1, 2}


@pytest.mark.parametrize(
    ("change", "due"),
    [
        (lambda folder: None, set()),
        (lambda folder: os.utime(folder / "a" / "part.inp"), set()),
        (lambda folder: (folder / "a" / "part.inp").write_text("other"), {"a"}),
        (lambda folder: (folder / "a" / "part.h5").unlink(), {"a"}),
        (lambda folder: (folder / "b" / "part.h5").write_bytes(b"A body"), {"b"}),
        (lambda folder: (folder / "a" / "a.toml").write_text(decks.job({"check": "full_modes = 3"})), {"a"}),
        (lambda folder: (folder / "a" / "a.toml").write_text(decks.job({"solver": "threads = 1"})), set()),
        (lambda folder: (folder / "a" / "a.toml").write_text("# a comment\n" + decks.job()), set()),
    ],
)
def test_a_job_is_due_when_its_inputs_or_results_change(
    tmp_path: Path, change: Callable[[Path], object], due: set[str]
) -> None:
    folder = jobs(tmp_path, {"a": {}, "b": {}})
    with Manifest(folder / "batch.manifest") as manifest:
        remember(folder, manifest)
    change(folder)
    with Manifest(folder / "batch.manifest") as manifest:
        assert {part.name for part in parts_of([folder]) if find_unchanged(part, manifest) is None} == due
        changed = parts_of([folder], ["reduce.modes=3"])
        assert not any(find_unchanged(part, manifest) for part in changed)


def test_jobs_take_no_more_memory_than_they_ask_for(tmp_path: Path) -> None:
    """Small ones too, of which most is what the program itself takes: whole processes."""
    for name, length in (("small", 6), ("larger", 10)):
        (tmp_path / name).mkdir()
        text = decks.deck(list(itertools.product(range(length), range(10), range(10))))
        decks.folder(tmp_path / name, {"solver": "threads = 1"}, text)
    assert set(states(batch([tmp_path], workers=1)).values()) == {"done"}
    asked, took = {}, {}
    for event in map(json.loads, (tmp_path / "batch.manifest").read_text().splitlines()):
        if event["event"] == "started":
            asked[event["output"]] = 1e6 * event["MB"]
        elif event["event"] == "ended":
            took[event["output"]] = max(event["facts"]["peak_memory_bytes"].values())
    # Most of the margin on top of the forecast is left for what differs between runs.
    assert len(took) == 2 and max(took[name] / asked[name] for name in took) < 0.92


@pytest.mark.usefixtures("forked_jobs")
def test_one_job_alone_is_remembered_with_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within the working directory; a manifest above that belongs to others."""
    folder = jobs(tmp_path, {"a": {}, "b": {}})
    with Manifest(folder / "batch.manifest") as manifest:
        remember(folder, manifest)
    monkeypatch.chdir(folder)
    assert states(batch([folder / "a"])) == {"a": "unchanged"}
    assert not (folder / "a" / "batch.manifest").exists()
    monkeypatch.chdir(folder / "b")
    assert states(batch([folder / "a"], check_only=True)) == {"a": "sound"}
    assert (folder / "a" / "batch.manifest").exists()


def test_a_batch_of_faults_leaves_no_manifest(tmp_path: Path) -> None:
    assert states(batch([tmp_path / "nothing.toml"])) == {"nothing": "failed"}
    assert not list(tmp_path.iterdir())


def test_a_path_that_cannot_be_is_the_fault_of_its_own_job(tmp_path: Path) -> None:
    jobs(tmp_path, {"lost": {}, "good": {}})
    job = tmp_path / "lost" / "lost.toml"
    job.write_text(re.sub(r'(?m)^(path|file|mesh) = "', r'\1 = "~no-user-of-this-name/', job.read_text()))
    faults = {part.name: part.fault for part in parts_of([tmp_path])}
    assert faults["good"] is None and "~no-user-of-this-name/" in str(faults["lost"])


def test_bytes_that_change_with_their_time_kept_are_seen(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"one")
    old = path.stat().st_mtime_ns - 10**12
    os.utime(path, ns=(old, old))
    content = Content.of(path)
    path.write_bytes(b"two")
    os.utime(path, ns=(old, old))
    assert not content.still_in(path)


def test_a_folder_that_moves_is_still_up_to_date(tmp_path: Path) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    jobs(folder, {"a": {}})
    with Manifest(folder / "batch.manifest") as manifest:
        remember(folder, manifest)
    folder = folder.rename(tmp_path / "there")
    with Manifest(folder / "batch.manifest") as manifest:
        assert all(find_unchanged(part, manifest) for part in parts_of([folder]))


def test_content_of_the_same_size_and_time_is_read_again(tmp_path: Path) -> None:
    """The time of a file says nothing for as long as a disk counts time."""
    path = tmp_path / "file"
    path.write_bytes(b"one")
    content = Content.of(path)
    path.write_bytes(b"two")
    os.utime(path, ns=(content.modified_ns, content.modified_ns))
    assert not content.still_in(path)


def test_names_of_jobs_tell_them_apart(tmp_path: Path) -> None:
    for name in ("x/rod", "y/rod", "y/disc"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.toml").write_text(decks.job({"output": f'path = "{Path(name).name}.h5"'}))
    (tmp_path / "y" / "other.toml").write_text("[tool]\nx = 1\n")
    (tmp_path / "y" / "torn.toml").write_text("[model]\nmesh = \n")
    parts = parts_of([tmp_path, tmp_path / "x" / "rod.toml"])
    assert [part.name for part in parts] == [os.path.join("x", "rod"), "disc", os.path.join("y", "rod"), "torn"]
    assert [part.fault is None for part in parts] == [True, True, True, False]


def test_jobs_that_write_one_file_are_refused(tmp_path: Path) -> None:
    decks.folder(tmp_path)
    (tmp_path / "other.toml").write_text(decks.job())
    assert all("part.h5" in str(part.fault) for part in parts_of([tmp_path]))


def test_folders_without_jobs(tmp_path: Path) -> None:
    with refusal("missing", "jobs"):
        parts_of([tmp_path])
    with refusal("value", "jobs"):
        batch([tmp_path], workers=0)


def test_a_manifest_survives_what_killed_batches_leave(tmp_path: Path) -> None:
    folder, path = jobs(tmp_path, {"a": {}}), tmp_path / "batch.manifest"
    with Manifest(path) as manifest:
        remember(folder, manifest)
        for _ in range(300):
            manifest.record_failure(folder / "b.h5", "a message")
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"event": "ended", "outp')
    for _ in range(2):  # the second finds it compacted
        with Manifest(path) as manifest:
            assert all(find_unchanged(part, manifest) for part in parts_of([folder]))
            with refusal("file", "batch.manifest"):
                Manifest(path)
    assert len(path.read_bytes()) < len(whole) / 10
    assert sorted(each.name for each in folder.iterdir()) == ["a", "batch.manifest"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("something else", ("file", "batch.manifest")),
        ("[model]\n", ("file", "manifest")),
        (
            '{"event": "begun", "format": "morembs-batch", "version": 1}\n{"event": "ended"}\n',
            ("file", "manifest", "2;"),
        ),
        ('{"event": "begun", "format": "morembs-batch", "version": 1}\n{{\n', ("file", "manifest", "2;")),
        ('{"event": "begun", "format": "morembs-batch", "version": 9}\n', ("file", "batch.manifest", "9;")),
    ],
)
def test_other_files_are_no_manifests(tmp_path: Path, text: str, said: Refusal) -> None:
    path = tmp_path / "batch.manifest"
    path.write_text(text)
    with refusal(*said):
        Manifest(path)
    assert path.read_text() == text


def children() -> Children:
    return Children(Worker(bytes=1e9, cores=2, slots=2), 2, (sys.executable, "-c", CHILD))


def task(*arguments: object) -> Task:
    return Task(number=7, arguments=tuple(map(str, arguments)), threads=3)


def all_of(running: Children) -> tuple[list[str], list[Finished]]:
    lines, ends = [], []
    while running.running:
        heard = running.next()
        if isinstance(heard, Heard):
            lines.append(heard.line)
        elif heard is not None:
            ends.append(heard)
    return lines, ends


def test_children_say_how_they_end() -> None:
    with children() as running:
        for verb in ("good", "fail", "die"):
            running.start(task(verb, "job"))
            lines, (end,) = all_of(running)
            assert lines[0] == "[2 s] stage"
            assert end.number == 7 and end.killed == (verb == "die")
            # Python takes some megabytes.
            assert not hasattr(os, "wait4") or 1e6 < end.peak_memory_bytes < 1e11
            if verb == "good":
                assert end.code == 0 and json.loads(end.printed) == [{"threads": "3"}]
            else:
                assert not end.printed
                assert end.message.startswith("one\ntwo" if verb == "fail" else "its process was ended by signal 9")


def test_children_end_with_their_batch(tmp_path: Path) -> None:
    """Leaving the ``with`` ends those that run; one whose batch is killed reads the end of its input."""
    with children() as running:
        running.start(task("wait", tmp_path / "never"))
        while not isinstance(running.next(), Heard):
            pass
    assert not (tmp_path / "never").exists()

    text = (
        "import os\nfrom tests.batches.test_batch import children, task\nc = children()\n"
        f"c.start(task('wait', {str(tmp_path / 'left')!r}))\nwhile c.next() is None:\n    pass\n"
        "os.kill(os.getpid(), 9)\n"
    )
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", text], cwd=root, env={**os.environ, "PYTHONPATH": str(root)})
    while not (tmp_path / "left").exists():
        time.sleep(0.01)


@pytest.mark.skipif(sys.platform == "win32", reason="a process of Windows cannot send itself such a signal")
def test_a_child_that_starts_as_a_signal_comes_ends_with_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun: list[subprocess.Popen[str]] = []

    class Interrupted(subprocess.Popen):
        def __init__(self, *words: object, **options: object) -> None:
            super().__init__(*words, **options)
            begun.append(self)
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    with stopping.handle_signals(), pytest.raises(SystemExit), children() as running:
        running.start(task("wait", tmp_path / "never"))
    with stopping.handle_signals():
        pass  # It forgets the signal, which was for this process.
    (process,) = begun
    assert process.returncode is not None and not (tmp_path / "never").exists()


def test_a_command_leaves_with_its_input(tmp_path: Path) -> None:
    job = decks.folder(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "morembs", "reduce", str(job), "--attached"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
    )
    assert done.returncode == 128 + 15 and not (tmp_path / "part.h5").exists()


def test_what_a_job_read_is_in_its_results(tmp_path: Path) -> None:
    from morembs.app.jobs.job import load_job
    from morembs.app.jobs.run import run_job

    job = decks.folder(tmp_path, text="*INCLUDE, INPUT=inner.inp\n")
    (tmp_path / "inner.inp").write_text(decks.deck(decks.BEAM[:12]))
    result = run_job(load_job(job, ["reduce.cb.modes=2"]))
    assert {Path(name).name for name in result.inputs} == {"part.inp", "inner.inp"}
    stored = read_body(result.job.output).provenance
    assert stored["changes"] == [b"reduce.cb.modes=2"]
    assert len(stored["inputs"]["sha256"]) == 2
