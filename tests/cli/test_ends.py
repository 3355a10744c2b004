"""How a command ends: signals that Python loses, output that nobody takes, faults, jobs in each other's way."""

from __future__ import annotations

import ctypes
import errno
import json
import os
import signal
import sys
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import scipy.linalg
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.cli import entry
from morembs.base import scratch, stopping
from tests.support.decks import folder
from tests.support.processes import Ended, apart, program

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and /dev/full are POSIX")
RUNNER = CliRunner()


class Watched:
    """Something that a weak reference can point to."""


class Closing:
    """Its end sends a signal."""

    def __init__(self, send: Callable[..., None]) -> None:
        self.send = send

    def __del__(self) -> None:
        self.send()


class Wrapping(Closing):
    """Makes another error of what the signal raises."""

    def __del__(self) -> None:
        try:
            self.send()
        except BaseException as error:
            raise SystemError("returned a result with an exception set") from error


def lose(way: str, number: int) -> None:
    """Get a signal where Python drops the exception of its handler, or where somebody makes something else of it."""

    def send(*_: object) -> None:
        os.kill(os.getpid(), number)

    def swallowed(then: Callable[[], object]) -> None:
        try:
            send()
        except BaseException:
            then()

    def failed(error: Exception) -> None:
        try:
            send()
        except BaseException:
            raise error from None

    if way == "weakref":
        watched = Watched()
        reference = weakref.ref(watched, send)
        del watched
        assert reference() is None
    elif way == "del":
        Closing(send)
    elif way == "del with another error":
        Wrapping(send)
    elif way == "printed by a library":
        try:
            send()
        except BaseException as error:
            other = SystemError("returned a result with an exception set")
            other.__cause__ = error
            sys.excepthook(SystemError, other, None)
    elif way == "the end of a library":
        ctypes.CDLL(None).exit(0)
    elif way == "swallowed, then the end of a library":
        swallowed(lambda: ctypes.CDLL(None).exit(0))
    elif way == "ctypes":
        ctypes.CFUNCTYPE(None)(send)()
    elif way == "swallowed":
        swallowed(lambda: None)
    elif way == "another error":
        failed(OSError("can't write data"))
    elif way == "a fault of a library":
        failed(SystemError("returned a result with an exception set"))


def losing(way: str, number: int, holder: ModuleType, place: str, *arguments: object) -> Callable[[], None]:
    """The command line, which loses a signal when it first calls ``place`` of a library (``holder``)."""
    command = program([str(argument) for argument in arguments])

    def work() -> None:
        real, calls = getattr(holder, place), []

        def wrapped(*args: Any, **options: Any) -> Any:
            calls.append(1)
            if len(calls) == 1:
                lose(way, number)
            return real(*args, **options)

        setattr(holder, place, wrapped)
        command()

    return work


@pytest.mark.parametrize(
    ("way", "number"),
    [
        ("weakref", signal.SIGINT),
        ("weakref", signal.SIGTERM),
        ("del", signal.SIGINT),
        ("del with another error", signal.SIGTERM),
        ("ctypes", signal.SIGTERM),
        ("swallowed", signal.SIGINT),
        ("another error", signal.SIGTERM),
        ("a fault of a library", signal.SIGINT),
        ("printed by a library", signal.SIGINT),
    ],
)
def test_no_signal_is_lost(tmp_path: Path, way: str, number: signal.Signals) -> None:
    """Where Python drops the exception of the handler, or somebody makes another one of it."""
    job = folder(tmp_path)
    (tmp_path / "part.h5").write_text("old")
    (tmp_path / "logs").mkdir()
    before = sorted(path.name for path in tmp_path.iterdir())
    other = job.with_name("other.toml")
    done = apart(losing(way, number, scipy.linalg, "eigh", "reduce", job, other), tmp_path, tmp_path / "logs")
    assert done.code == 128 + number, (done.output, done.errors)
    assert "error: " not in done.errors and not list((tmp_path / "logs" / "tmp").iterdir())
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert done.errors.splitlines()[-1].startswith(word) and "Traceback" not in done.errors, done.errors
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert (tmp_path / "part.h5").read_text() == "old" and "other.toml" not in done.errors


@pytest.mark.parametrize("way", ["weakref", "swallowed"])
def test_no_file_takes_its_name_after_a_signal(tmp_path: Path, way: str) -> None:
    """The body is complete when the signal comes, and lost: its temporary file goes, the old body stays."""
    job = folder(tmp_path)
    (tmp_path / "part.h5").write_text("old")
    before = sorted(path.name for path in tmp_path.iterdir())
    done = apart(losing(way, signal.SIGTERM, os, "fsync", "reduce", job), tmp_path)
    assert done.code == 143, (done.output, done.errors)
    assert sorted(path.name for path in tmp_path.iterdir()) == before and (tmp_path / "part.h5").read_text() == "old"


@pytest.mark.parametrize(("way", "code"), [("the end of a library", 1), ("swallowed, then the end of a library", 143)])
def test_a_library_does_not_end_a_run_as_if_it_had_succeeded(tmp_path: Path, way: str, code: int) -> None:
    """STOP in Fortran, which MUMPS comes to after a fault of its own, is exit code 0."""
    job = folder(tmp_path)
    (tmp_path / "part.h5").write_text("old")
    done = apart(losing(way, signal.SIGTERM, scipy.linalg, "eigh", "reduce", job), tmp_path)
    assert done.code == code, (done.output, done.errors)
    assert (tmp_path / "part.h5").read_text() == "old"


def say(*words: object) -> None:
    sys.stdout.write(" ".join(map(str, words)) + "\n")
    sys.stdout.flush()


def repeated() -> None:
    times = iter([0.0, 0.5, 5.0])
    with stopping.handle_signals(ends=True, clock=lambda: next(times)):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except SystemExit:
            os.kill(os.getpid(), signal.SIGTERM)
            say("cleans up")
            os.kill(os.getpid(), signal.SIGINT)
            say("never")


def test_a_second_signal_ends_at_once(tmp_path: Path) -> None:
    """But not the one that ``timeout`` sends twice."""
    done = apart(repeated, tmp_path)
    assert (done.code, done.output) == (143, "cleans up\n"), done.errors


def test_an_ignored_signal_stays_ignored(tmp_path: Path) -> None:
    """As under nohup."""
    job = folder(tmp_path)
    command = losing("swallowed", signal.SIGHUP, scipy.linalg, "eigh", "reduce", job)

    def work() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        command()

    done = apart(work, tmp_path)
    assert done.code == 0 and (tmp_path / "part.h5").is_file(), done.errors


def terminate_at(name: str) -> Callable[[str, tuple[object, ...]], None]:
    """An audit hook that sends a signal when a file of this ``name`` is opened."""

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and str(arguments[0]).endswith(name):
            os.kill(os.getpid(), signal.SIGTERM)

    return hook


def embedding() -> None:
    """A program that calls the command line, with a handler of its own."""

    def ended(*arguments: str) -> object:
        sys.argv = ["morembs", *arguments]
        try:
            entry.main()
        except SystemExit as end:
            return end.code
        return None

    def handler(*_: object) -> None:
        say("my own handler")

    signal.signal(signal.SIGTERM, handler)
    say(ended("info", "missing.h5"), signal.getsignal(signal.SIGTERM) is handler)
    sys.addaudithook(terminate_at("signal.toml"))
    say(ended("check", "signal.toml"))
    say(ended("--version"))
    os.kill(os.getpid(), signal.SIGTERM)
    say("went on")


def test_a_program_that_calls_the_command_line_goes_on(tmp_path: Path) -> None:
    """After bad input and after a signal, with its own handlers, and ends with its own exit code."""
    done = apart(embedding, tmp_path)
    assert done.code == 0, (done.output, done.errors)
    lines = done.output.splitlines()
    assert lines[:2] == ["2 True", "143"] and lines[3:] == ["0", "my own handler", "went on"], lines


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """A job that warns of its units."""
    return folder(tmp_path, {"model": 'mesh = "part.inp"', "check": "full_modes = 0", "reduce": 'method = "guyan"'})


def printed_to(descriptor: int, *arguments: object, folder: Path, number: int = 1) -> Ended:
    """How the command line ends with its standard output, or error (``number`` 2), elsewhere."""
    command = program([str(argument) for argument in arguments])

    def work() -> None:
        os.dup2(descriptor, number)
        # With a buffer, as in a process of its own.
        sys.stdout = os.fdopen(1, "w", closefd=False)
        command()

    return apart(work, folder)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_output_that_cannot_be_printed(job: Path) -> None:
    """Only files that were written are said to be."""
    output = job.with_name("part.h5")
    with open("/dev/full", "w") as full:
        for extra in ([], ["--json"]):
            done = printed_to(full.fileno(), "reduce", *extra, job, folder=job.parent)
            assert done.code == 2 and output.is_file()
            last = done.errors.splitlines()[-1]
            assert last == f"error: the output cannot be printed (No space left on device); written: {output}"
            output.unlink()
        for verb in (["check", job], ["solvers"], ["export", "--list"], ["import", "--list"]):
            done = printed_to(full.fileno(), *verb, folder=job.parent)
            assert done.code == 2
            assert done.errors == "error: the output cannot be printed (No space left on device)\n"


def test_nobody_reads(job: Path) -> None:
    """A pipe whose reader has gone: as output, and where warnings go, which ends no work."""
    reader, writer = os.pipe()
    os.close(reader)
    done = printed_to(writer, "reduce", job, folder=job.parent)
    assert done.code == 2 and "cannot be printed (Broken pipe); written: " in done.errors
    job.with_name("part.h5").unlink()
    done = printed_to(writer, "reduce", job, "--json", folder=job.parent, number=2)
    os.close(writer)
    assert done.code == 0 and json.loads(done.output)[0]["warnings"] and job.with_name("part.h5").is_file()


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.EIO, "Input/output error", "part.inp"), "refused a request at 'part.inp': Input/output error"),
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), "refused a request: Broken pipe"),
        (OSError("unknown"), "refused a request: unknown"),
    ],
    ids=["input", "pipe", "unknown"],
)
def test_other_errors_of_the_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
) -> None:
    """They are no failure to print, and nothing is said to be written. Other jobs go on."""
    real, calls = scipy.linalg.eigh, []

    def fail(*arguments: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise error
        return real(*arguments, **options)

    monkeypatch.setattr(scipy.linalg, "eigh", fail)
    for name in "ab":
        (tmp_path / name).mkdir()
    jobs = [str(folder(tmp_path / name)) for name in "ab"]
    result = RUNNER.invoke(cli.app, ["reduce", *jobs])
    assert result.exit_code == 2 and result.stderr == f"error: {jobs[0]}: the operating system {words}\n"
    assert not (tmp_path / "a" / "part.h5").exists() and (tmp_path / "b" / "part.h5").is_file()


@pytest.mark.parametrize("error", [RuntimeError("lost\nmy way"), RecursionError("too deep"), KeyError("x")], ids=repr)
def test_faults_tell_where_their_traceback_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(scipy.linalg, "eigh", fail)
    job = folder(tmp_path)
    result = RUNNER.invoke(cli.app, ["reduce", str(job), str(tmp_path / "missing.toml"), "--json"])
    assert result.exit_code == 1
    first, second = result.stderr.splitlines()
    (report,) = (tmp_path / "temporary").iterdir()
    assert type(error).__name__ in first and str(report) in first and "authors" in first and "missing.toml" in second
    text = report.read_text()
    assert "Traceback" in text and "in fail" in text and "Python 3" in text
    assert [set(entry) for entry in json.loads(result.stdout)] == [{"job", "error", "kind", "keyword"}] * 2
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    result = RUNNER.invoke(cli.app, ["reduce", str(job)])
    assert result.exit_code == 1 and "Traceback" in result.stderr and "traceback above" in result.stderr


@pytest.mark.parametrize("verb", ["check", "reduce"])
def test_jobs_in_each_others_way_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str) -> None:
    """One output, spelled in other ways or through a link; a picture that is another's body; an output that is
    another's mesh. What is in nobody's way is done."""
    job = folder(tmp_path)
    text = job.read_text()
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.h5").symlink_to(tmp_path / "part.h5")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "free.toml").write_text(text.replace('"part.h5"', '"free.h5"'))
    for output in ('"sub/../part.h5"', f'"{tmp_path}/part.h5"', '"link.h5"', '"b.h5"\npicture = "part.h5"'):
        if "picture" in output:
            text = text.replace('"part.h5"', '"part.png"')
            job.write_text(text)
            output = '"b.h5"\npicture = "part.png"'
            text = text.replace('"part.png"', '"part.h5"')
        (tmp_path / "other.toml").write_text(text.replace('"part.h5"', output))
        result = RUNNER.invoke(cli.app, [verb, "other.toml", "free.toml", "job.toml", "--json"])
        assert result.exit_code == 2, output
        results = json.loads(result.stdout)
        assert "is [output] path of job.toml too" in results[0]["error"] and "error" not in results[1]
        assert "of other.toml too" in results[2]["error"]
        assert not (tmp_path / "part.h5").exists() and not (tmp_path / "b.h5").exists()
    job.write_text(text)
    (tmp_path / "other.toml").write_text(text.replace('"part.h5"', '"job.toml"').replace("part.inp", "other.inp"))
    result = RUNNER.invoke(cli.app, [verb, "job.toml", "other.toml", "--json"])
    results = json.loads(result.stdout)
    assert result.exit_code == 2 and "error" not in results[0]
    assert "is the job file of job.toml too" in results[1]["error"]
    result = RUNNER.invoke(cli.app, [verb, "job.toml", "job.toml"])
    assert result.exit_code == 2 and result.stderr.count("of job.toml too") == 2


def test_a_signal_while_a_private_folder_is_made_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between its making and the promise to remove it: heeded a moment later, when it is known to whom it belongs."""
    mkdtemp = tempfile.mkdtemp

    def interrupted(*arguments: str, **options: str) -> str:
        path = mkdtemp(*arguments, **options)
        os.kill(os.getpid(), signal.SIGTERM)
        return path

    monkeypatch.setattr(tempfile, "mkdtemp", interrupted)
    with pytest.raises(SystemExit), stopping.handle_signals():
        scratch.PrivateFolder(tmp_path)
    with stopping.handle_signals():
        pass  # forgets the signal
    assert not list(tmp_path.iterdir())
