"""Private folders for files that live as long as a calculation or a file that is being written, and never longer.

A folder is marked by a file that its process keeps locked, with the name of the machine in it. The operating system
drops the lock however the process ends, so the next run on that machine knows which folders nobody owns any more and
removes them. Where Python has no such locks (Windows) the mark names the process and when it began. Only the user may
enter such a folder, so that nobody plants links in it. What cannot be removed, as files that are still mapped there,
stays with its mark for the next run.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import platform
import re
import shutil
import stat
import tempfile
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path

from morembs.base import stopping
from morembs.base.errors import InputError

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None  # type: ignore[assignment]

log = logging.getLogger(__name__)
_PREFIX = "morembs-"
_OWNER = "owner.lock"
# In its place where Python has no locks: the machine, the process and when it began.
_PROCESS = "owner.process"
# In the place of the mark where files cannot be locked: then nobody knows whether the owner lives.
_UNKNOWN = "owner"
# The end of a name that tempfile.mkdtemp draws.
_DRAWN = r"-[a-z0-9_]{8}"
# What systems say that have no locks for files on some disk.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


class PrivateFolder:
    """A new private folder below ``parent`` (None: the temporary folder of the system).

    Removed by ``close``, when it is forgotten, or when the interpreter ends; what killed runs left behind in
    the same parent under the same ``prefix`` is removed first.

    Raises:
        OSError: the parent cannot be written.
    """

    def __init__(self, parent: Path | None, prefix: str = _PREFIX) -> None:
        remove_abandoned(parent, prefix)
        # A signal between its making and the promise to remove it would leave the folder behind.
        with stopping.whole_step():
            self._make(parent, prefix)

    def _make(self, parent: Path | None, prefix: str) -> None:
        handle, locked = None, False
        while not locked:
            self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=parent)).resolve()
            try:
                handle, locked = _lock(self.path), True
            except FileNotFoundError:
                continue  # another run took it for one that was left behind
            except OSError:
                shutil.rmtree(self.path, ignore_errors=True)
                raise
        self._finalize = weakref.finalize(self, _remove, self.path, handle, os.getpid())

    def close(self) -> None:
        """Remove the folder and all that is in it."""
        self._finalize()

    def outlast(self) -> Callable[[], None]:
        """The call that removes it, which nothing else does at the end of the interpreter."""
        held = self._finalize.detach()
        return partial(_remove, *held[2]) if held else self.close


class ScratchFolder(PrivateFolder):
    """A private folder for a calculation; ``parent`` is made if it is missing.

    Raises:
        InputError: the parent cannot be made or written.
    """

    def __init__(self, parent: Path | None) -> None:
        if parent is not None:
            try:
                parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(
                    f"the scratch folder {parent} cannot be made: {error}", kind="output", keyword="scratch"
                ) from error
        try:
            super().__init__(parent)
        except OSError as error:
            place = parent or tempfile.gettempdir()
            raise InputError(
                f"the scratch folder {place} cannot be written ({error.strerror}); give another one",
                kind="output",
                keyword="scratch",
            ) from error


def remove_abandoned(parent: Path | None, prefix: str = _PREFIX) -> None:
    """Remove the folders of processes of this machine that ended without doing so."""
    for folder in Path(parent or tempfile.gettempdir()).glob(f"{prefix}*"):
        with contextlib.suppress(OSError):
            if folder.is_dir() and not folder.is_symlink() and _is_abandoned(folder):
                log.info("removing %s, which an interrupted run left behind", folder)
                _clear(folder)


def free_bytes(parent: Path | None) -> int:
    """Free space on the disk of the scratch folder."""
    place = Path(parent or tempfile.gettempdir())
    while not place.exists() and place != place.parent:
        place = place.parent
    return shutil.disk_usage(place).free


def _is_abandoned(folder: Path) -> bool:
    mark, named = folder / _OWNER, folder / _PROCESS
    if named.exists():
        return _has_ended(named.read_bytes())
    if mark.exists():
        return _free(mark)
    if fcntl is None:
        return False
    if not re.fullmatch(_DRAWN, folder.name[-9:]) or stat.S_IMODE(folder.stat().st_mode) != stat.S_IRWXU:
        return False  # somebody else's
    new = mark.with_suffix(".new")
    if new.exists() and _free(new):
        # Its owner ended before it had a name; one that lives makes another folder.
        new.unlink()
    folder.rmdir()
    return False


def _free(mark: Path) -> bool:
    """True if nobody holds the lock of a mark of this machine."""
    if fcntl is None:
        return False
    handle = os.open(mark, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
    try:
        # Locks of another machine may not be seen here. An empty mark is one of version 0.1.
        if os.read(handle, 1024) not in (b"", _machine()):
            return False
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(handle)
    return True


def _process(number: int) -> bytes:
    """What a process is known by: a later one may get its number. Empty if there is none."""
    import psutil

    try:
        begun = psutil.Process(number).create_time()
    except psutil.Error:
        return b""
    return f"{number} {begun:.2f} ".encode() + _machine()


def _has_ended(mark: bytes) -> bool:
    """True if the process that wrote the ``mark`` on this machine has ended."""
    number, _, machine = [*mark.split(b" ", 2), b"", b""][:3]
    return machine == _machine() and number.isdigit() and _process(int(number)) != mark


def _clear(folder: Path) -> None:
    """Remove a folder, its mark only when nothing else is left, so that the next run removes the leftovers."""
    marks = (_OWNER, _PROCESS, _UNKNOWN)
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name not in marks:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
    if all(path.name in marks for path in folder.iterdir()):
        shutil.rmtree(folder, ignore_errors=True)


def _machine() -> bytes:
    return platform.node().encode()[:1024]


def _lock(folder: Path) -> int | None:
    """Open handle of the mark of ``folder``, locked until it is closed or the process ends; None without locks."""
    # It gets its name when it is locked, so that nobody ever sees it free.
    new = (folder / _OWNER).with_suffix(".new")
    handle = os.open(new, os.O_RDWR | os.O_CREAT | os.O_EXCL, stat.S_IRUSR | stat.S_IWUSR)
    try:
        if fcntl is None:
            os.write(handle, _process(os.getpid()))
            # Windows gives no open file another name.
            os.close(handle)
            new.rename(folder / _PROCESS)
            return None
        fcntl.flock(handle, fcntl.LOCK_EX)
        os.write(handle, _machine())
        new.rename(folder / _OWNER)
        return handle
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            os.close(handle)
            raise
    os.close(handle)
    new.rename(folder / _UNKNOWN)
    return None


def _remove(path: Path, handle: int | None, owner: int) -> None:
    """Remove the folder, unless this is a copy of the process that owns it."""
    if os.getpid() == owner:
        with contextlib.suppress(OSError):
            _clear(path)
    if handle is not None:
        with contextlib.suppress(OSError):
            os.close(handle)
