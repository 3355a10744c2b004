"""What runs that were killed leave behind, links of others, and disks that are full before anything is written."""

import errno
import os
import platform
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import pytest

from morembs.base import scratch
from morembs.base.errors import OutputError
from morembs.storage.safefile import PREFIX, check_writable, replacing, replacing_all
from tests.support.refusals import refusal

WRITING = """
import sys
from pathlib import Path
from morembs.storage.safefile import replacing_all
with replacing_all([Path(name) for name in sys.argv[1:]]) as files:
    for file in files:
        file.write(b"half of")
    print("writing", flush=True)
    sys.stdin.read()
"""


def writer(*paths: Path) -> subprocess.Popen[str]:
    """A process that is in the middle of writing files."""
    command = [sys.executable, "-c", WRITING, *map(str, paths)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "writing\n"
    return process


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.skipif(scratch.fcntl is None, reason="without locks nothing is known to be left over")
def test_the_next_run_removes_what_killed_ones_left_and_nothing_of_live_ones(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    (here / "a").write_bytes(b"old")
    for _ in range(3):
        killed = writer(here / "a", here / "b", there / "c")
        killed.send_signal(signal.SIGKILL)
        killed.communicate()
    assert names(here)[-1] == "a" and len(names(here)) == 2 and len(names(there)) == 1  # each saw to the last
    with writer(here / "a") as live:
        check_writable(there / "c")
        with replacing(here / "b") as file:
            file.write(b"new")
        assert not names(there) and names(here)[1:] == ["a", "b"] and len(names(here)) == 3
        live.communicate("")
    assert live.returncode == 0 and names(here) == ["a", "b"]
    assert (here / "a").read_bytes() == b"half of" and (here / "b").read_bytes() == b"new"


@pytest.mark.skipif(scratch.fcntl is None, reason="without locks nothing is known to be left over")
def test_what_may_be_of_another_machine_or_program_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".a.tmp-1").write_bytes(b"of another program")
    for name, text in (("other", b"another machine"), ("mine", platform.node().encode())):
        (tmp_path / f"{PREFIX}{name}").mkdir()
        (tmp_path / f"{PREFIX}{name}" / "owner.lock").write_bytes(text)
    # A disk without locks: nobody can know whether the owner lives.
    with monkeypatch.context() as patch:
        patch.setattr(scratch.fcntl, "flock", raising(OSError(errno.ENOLCK, "No locks available")))
        unknown = scratch.PrivateFolder(tmp_path, PREFIX)
    with replacing(tmp_path / "a") as file:
        file.write(b"new")
    assert names(tmp_path) == sorted([".a.tmp-1", f"{PREFIX}other", unknown.path.name, "a"])
    unknown.close()
    assert not unknown.path.exists()


def raising(error: OSError):
    def fails(*_: object) -> None:
        raise error

    return fails


def test_a_copy_of_the_process_removes_nothing(tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom morembs.base.scratch import PrivateFolder\n"
        "folder = PrivateFolder(Path(sys.argv[1]))\n"
        "if os.fork() == 0:\n    sys.exit()\n"
        "os.wait()\nsys.exit(0 if folder.path.is_dir() else 1)\n"
    )
    if hasattr(os, "fork"):
        assert subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False).returncode == 0
        assert not names(tmp_path)


def test_nobody_else_can_place_links_where_files_are_made(tmp_path: Path) -> None:
    with replacing(tmp_path / "a") as file:
        (folder,) = tmp_path.glob(f"{PREFIX}*")
        assert folder.stat().st_mode & 0o777 == 0o700
        file.write(b"new")
    (tmp_path / "b").write_bytes(b"")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can make links of others")
def test_a_link_of_another_user_in_a_folder_for_all_is_refused(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    (tmp_path / "mine").write_bytes(b"precious")
    (shared / "out").symlink_to(tmp_path / "mine")
    check_writable(shared / "out")
    os.lchown(shared / "out", 12345, 12345)
    for call in (check_writable, lambda path: replacing_all([path]).__enter__()):
        with refusal("output", "", shared / "out", by=OutputError):
            call(shared / "out")
    shared.chmod(0o755)
    check_writable(shared / "out")
    assert (tmp_path / "mine").read_bytes() == b"precious" and names(shared) == ["out"]


@pytest.mark.parametrize(("holder", "call"), [(tempfile, "mkdtemp"), (os, "write")])
def test_no_room_for_the_folder_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, holder: ModuleType, call: str
) -> None:
    """Nor for its mark."""
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(holder, call, lambda *_, **__: raising(full)())
    for write in (lambda: check_writable(tmp_path / "a"), lambda: replacing(tmp_path / "a").__enter__()):
        with refusal("output", "", tmp_path / "a", full.strerror.split()[-1], by=OutputError):
            write()
    assert not names(tmp_path)
