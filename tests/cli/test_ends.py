"""How a command ends: signals that Python loses, output that nobody takes, faults, jobs in each other's way."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs.cli import commands as cli
from morembs.jobs import run
from tests.support.decks import folder

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals and /dev/full are POSIX")
RUNNER = CliRunner()

LOST = """
import ctypes, os, signal, sys, weakref
from morembs.cli import console
from morembs.jobs import run
from morembs.storage import safefile

way, number, place = sys.argv[1], int(sys.argv[2]), sys.argv[3]

class Watched:
    pass

class Closing:
    def __del__(self):
        os.kill(os.getpid(), number)

class Wrapping:
    def __del__(self):
        try:
            send()
        except BaseException as error:
            raise SystemError("returned a result with an exception set") from error

def send(*_):
    os.kill(os.getpid(), number)

def lose():
    if way == "weakref":
        watched = Watched()
        reference = weakref.ref(watched, send)
        del watched
    elif way == "del":
        Closing()
    elif way == "del with another error":
        Wrapping()
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
        try:
            send()
        except BaseException:
            ctypes.CDLL(None).exit(0)
    elif way == "ctypes":
        ctypes.CFUNCTYPE(None)(send)()
    elif way == "swallowed":
        try:
            send()
        except BaseException:
            pass
    elif way == "another error":
        try:
            send()
        except BaseException:
            raise OSError("can't write data") from None
    elif way == "a fault of a library":
        try:
            send()
        except BaseException:
            raise SystemError("returned a result with an exception set") from None

holder = safefile if place == "_complete" else run
real = getattr(holder, place)
calls = []

def wrapped(*args, **options):
    calls.append(1)
    if len(calls) == 1:
        lose()
    if place == "_reduce":
        print("went on", flush=True)
    return real(*args, **options)

setattr(holder, place, wrapped)
sys.argv = ["morembs", *sys.argv[4:]]
console()
"""


def ended(code: str, *arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, **options)  # type: ignore[call-overload, no-any-return]


@pytest.mark.parametrize(
    ("way", "number"),
    [
        ("weakref", signal.SIGINT), ("weakref", signal.SIGTERM), ("del", signal.SIGINT),
        ("del with another error", signal.SIGTERM), ("ctypes", signal.SIGTERM),
        ("swallowed", signal.SIGINT), ("another error", signal.SIGTERM),
        ("a fault of a library", signal.SIGINT), ("printed by a library", signal.SIGINT),
    ],
)  # fmt: skip
def test_no_signal_is_lost(tmp_path: Path, way: str, number: signal.Signals) -> None:
    """Where Python drops the exception of the handler, or somebody makes another one of it."""
    job = folder(tmp_path)
    (tmp_path / "part.h5").write_text("old")
    (tmp_path / "temporary").mkdir()
    before = sorted(path.name for path in tmp_path.iterdir())
    environment = {**os.environ, "TMPDIR": str(tmp_path / "temporary")}
    other = job.with_name("other.toml")
    done = ended(LOST, way, int(number), "_reduce", "reduce", job, other, env=environment)
    assert done.returncode == 128 + number, (done.stdout, done.stderr)
    assert "error: " not in done.stderr and not list((tmp_path / "temporary").iterdir())
    word = "interrupted" if number == signal.SIGINT else "terminated"
    assert done.stderr.splitlines()[-1].startswith(word) and "Traceback" not in done.stderr, done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert (tmp_path / "part.h5").read_text() == "old" and "other.toml" not in done.stderr


@pytest.mark.parametrize("way", ["weakref", "swallowed"])
def test_no_file_takes_its_name_after_a_signal(tmp_path: Path, way: str) -> None:
    """The body is complete when the signal comes, and lost: its temporary file goes, the old body stays."""
    job = folder(tmp_path)
    (tmp_path / "part.h5").write_text("old")
    before = sorted(path.name for path in tmp_path.iterdir())
    done = ended(LOST, way, int(signal.SIGTERM), "_complete", "reduce", job)
    assert done.returncode == 143, (done.stdout, done.stderr)
    assert sorted(path.name for path in tmp_path.iterdir()) == before and (tmp_path / "part.h5").read_text() == "old"


@pytest.mark.parametrize(("way", "code"), [("the end of a library", 1), ("swallowed, then the end of a library", 143)])
def test_a_library_does_not_end_a_run_as_if_it_had_succeeded(tmp_path: Path, way: str, code: int) -> None:
    """STOP in Fortran, which MUMPS comes to after a fault of its own, is exit code 0."""
    job = folder(tmp_path)
    (tmp_path / "part.h5").write_text("old")
    done = ended(LOST, way, int(signal.SIGTERM), "_reduce", "reduce", job)
    assert done.returncode == code, (done.stdout, done.stderr)
    assert (tmp_path / "part.h5").read_text() == "old"


REPEATED = """
import os, signal
from morembs import stopping
times = iter([0.0, 0.5, 5.0])
with stopping.heeded(ends=True, clock=lambda: next(times)):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except SystemExit:
        os.kill(os.getpid(), signal.SIGTERM)
        print("cleans up", flush=True)
        os.kill(os.getpid(), signal.SIGINT)
        print("never", flush=True)
"""


def test_a_second_signal_ends_at_once() -> None:
    """But not the one that ``timeout`` sends twice."""
    done = ended(REPEATED)
    assert (done.returncode, done.stdout) == (143, "cleans up\n"), done.stderr


def test_an_ignored_signal_stays_ignored(tmp_path: Path) -> None:
    """As under nohup."""
    job = folder(tmp_path)
    code = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + LOST
    done = ended(code, "swallowed", int(signal.SIGHUP), "_reduce", "reduce", job)
    assert done.returncode == 0 and (tmp_path / "part.h5").is_file(), done.stderr


EMBEDDING = """
import os, signal, sys
from morembs.cli import main
from morembs.cli import entry

def ended(*arguments):
    sys.argv = ["morembs", *arguments]
    try:
        main()
    except SystemExit as end:
        return end.code

mine = lambda *_: print("my own handler", flush=True)
signal.signal(signal.SIGTERM, mine)
print(ended("info", "missing.h5"), signal.getsignal(signal.SIGTERM) is mine)
work = entry._work
entry._work = lambda _: os.kill(os.getpid(), signal.SIGTERM)
print(ended("check", "missing.toml"))
entry._work = work
print(ended("--version"))
os.kill(os.getpid(), signal.SIGTERM)
print("went on", flush=True)
"""


def test_a_program_that_calls_the_command_line_goes_on() -> None:
    """After bad input and after a signal, with its own handlers, and ends with its own exit code."""
    done = ended(EMBEDDING)
    assert done.returncode == 0, (done.stdout, done.stderr)
    said = done.stdout.splitlines()
    assert said[:2] == ["2 True", "143"] and said[3:] == ["0", "my own handler", "went on"], said


@pytest.fixture
def job(tmp_path: Path) -> Path:
    """A job that warns of its units."""
    return folder(tmp_path, {"model": 'mesh = "part.inp"', "check": "full_modes = 0", "reduce": 'method = "guyan"'})


def printed_to(target: object, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "morembs", *map(str, arguments)]
    return subprocess.run(command, stdout=target, stderr=subprocess.PIPE, text=True)  # type: ignore[call-overload, no-any-return]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_output_that_cannot_be_printed(job: Path) -> None:
    """Only files that were written are said to be."""
    output = job.with_name("part.h5")
    with open("/dev/full", "w") as full:
        for extra in ([], ["--json"]):
            done = printed_to(full, "reduce", *extra, job)
            assert done.returncode == 2 and output.is_file()
            last = done.stderr.splitlines()[-1]
            assert last == f"error: the output cannot be printed (No space left on device); written: {output}"
            output.unlink()
        for verb in (["check", job], ["solvers"], ["export", "--list"], ["import", "--list"]):
            done = printed_to(full, *verb)
            assert done.returncode == 2
            assert done.stderr == "error: the output cannot be printed (No space left on device)\n"


def test_nobody_reads(job: Path) -> None:
    """A pipe whose reader has gone: as output, and where warnings go, which ends no work."""
    reader, writer = os.pipe()
    os.close(reader)
    done = printed_to(writer, "reduce", job)
    assert done.returncode == 2 and "cannot be printed (Broken pipe); written: " in done.stderr
    job.with_name("part.h5").unlink()
    command = [sys.executable, "-m", "morembs", "reduce", str(job), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=writer, text=True)
    os.close(writer)
    assert done.returncode == 0 and json.loads(done.stdout)[0]["warnings"] and job.with_name("part.h5").is_file()


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
    real, calls = run.run_job, []

    def fail(*args: object) -> object:
        calls.append(args)
        if len(calls) == 1:
            raise error
        return real(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(run, "run_job", fail)
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
    def fail(*_: object) -> None:
        raise error

    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(run, "run_job", fail)
    job = folder(tmp_path)
    result = RUNNER.invoke(cli.app, ["reduce", str(job), str(tmp_path / "missing.toml"), "--json"])
    assert result.exit_code == 1
    first, second = result.stderr.splitlines()
    (report,) = (tmp_path / "temporary").iterdir()
    assert type(error).__name__ in first and str(report) in first and "authors" in first and "missing.toml" in second
    text = report.read_text()
    assert "Traceback" in text and "in fail" in text and "Python 3" in text
    assert [set(one) for one in json.loads(result.stdout)] == [{"job", "error"}] * 2
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    result = RUNNER.invoke(cli.app, ["reduce", str(job)])
    assert result.exit_code == 1 and "Traceback" in result.stderr and "traceback above" in result.stderr


@pytest.mark.parametrize("verb", ["check", "reduce"])
def test_jobs_in_each_others_way_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str) -> None:
    """One output, spelled in other ways or through a link; a picture that is another's body; an output that is
    another's mesh. What is in nobody's way is done."""
    one = folder(tmp_path)
    text = one.read_text()
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.h5").symlink_to(tmp_path / "part.h5")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "free.toml").write_text(text.replace('"part.h5"', '"free.h5"'))
    for output in ('"sub/../part.h5"', f'"{tmp_path}/part.h5"', '"link.h5"', '"b.h5"\npicture = "part.h5"'):
        if "picture" in output:
            text = text.replace('"part.h5"', '"part.png"')
            one.write_text(text)
            output = '"b.h5"\npicture = "part.png"'
            text = text.replace('"part.png"', '"part.h5"')
        (tmp_path / "other.toml").write_text(text.replace('"part.h5"', output))
        result = RUNNER.invoke(cli.app, [verb, "other.toml", "free.toml", "job.toml", "--json"])
        assert result.exit_code == 2, output
        found = json.loads(result.stdout)
        assert "is [output] path of job.toml too" in found[0]["error"] and "error" not in found[1]
        assert "of other.toml too" in found[2]["error"]
        assert not (tmp_path / "part.h5").exists() and not (tmp_path / "b.h5").exists()
    one.write_text(text)
    (tmp_path / "other.toml").write_text(text.replace('"part.h5"', '"job.toml"').replace("part.inp", "other.inp"))
    result = RUNNER.invoke(cli.app, [verb, "job.toml", "other.toml", "--json"])
    found = json.loads(result.stdout)
    assert result.exit_code == 2 and "error" not in found[0] and "is the job file of job.toml too" in found[1]["error"]
    result = RUNNER.invoke(cli.app, [verb, "job.toml", "job.toml"])
    assert result.exit_code == 2 and result.stderr.count("of job.toml too") == 2
