"""The ledger of files that a calculation opens: their names, targets of links, contents; and the rule that no result
replaces one of them."""

from __future__ import annotations

import hashlib
import os
import sys
import sysconfig
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morembs.base.errors import OverwriteError
from morembs.storage.tolerances import TOL

_NUMBERS = ("bytes", "inode", "modified_ns", "changed_ns", "looked_ns")
_SYSTEM = ("/proc", "/sys", "/dev")
_CODE = (".py", ".pyc", ".so", ".pyd", ".pyi")
Place = tuple[int, int] | str
_ledgers: list[Ledger] = []
_hooked: list[bool] = []
_own: ContextVar[bool] = ContextVar("_own", default=False)


@dataclass(frozen=True)
class Content:
    """A file when it was looked at: where the links of its name led (``target``), number of the file on its disk, size
    in bytes, times of its last change and of the look in ns, SHA-256.

    ``changed_ns`` is the time that the system keeps for itself, which copies and archives cannot give another value.
    """

    target: str
    bytes: int
    inode: int
    modified_ns: int
    changed_ns: int
    looked_ns: int
    sha256: str

    @classmethod
    def of(cls, path: str | Path) -> Content:
        """What is in a file now; to look is not to take it as an input.

        Raises:
            OSError: it cannot be read.
        """
        looked = time.time_ns()
        with own_files(), open(path, "rb") as file:
            status = os.fstat(file.fileno())
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return cls(
            os.path.realpath(path),
            status.st_size,
            status.st_ino,
            status.st_mtime_ns,
            status.st_ctime_ns,
            looked,
            digest,
        )

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> Content:
        """The inverse of ``vars``.

        Raises:
            KeyError, TypeError, ValueError: other values, such as those of an older version.
        """
        numbers: dict[str, Any] = {key: int(values[key]) for key in _NUMBERS}
        return cls(target=str(values["target"]), sha256=str(values["sha256"]), **numbers)

    def still_in(self, path: str | Path) -> bool:
        """True if the name leads to the same bytes now: by the file and its times where they tell, else by all bytes.

        A link may lead to another file by now, of the same size and even of the same times.
        """
        try:
            status = os.stat(path)
            if status.st_size != self.bytes:
                return False
            settled = self.looked_ns - max(self.modified_ns, self.changed_ns) > TOL.coarse_time_ns
            known = self.inode, self.modified_ns, self.changed_ns
            same = (status.st_ino, status.st_mtime_ns, status.st_ctime_ns) == known
            return (settled and same) or Content.of(path).sha256 == self.sha256
        except OSError:
            return False


class Ledger:
    """The files that are opened for reading while it is kept, and the files that are to be written."""

    def __init__(self) -> None:
        # The name that was opened, whole but with its links and dots, and where it led.
        self.opened: dict[str, str] = {}
        # The same names by the places that they led to then, as a batch has thousands.
        self.places: dict[Place, list[str]] = {}
        self.promised: list[Path] = []
        self.written: list[str] = []

    def names(self) -> list[str]:
        """The names that were opened of files that are there still, without those of Python and of the system."""
        paths = sysconfig.get_paths()
        own = [os.path.realpath(place) for place in (paths["stdlib"], paths["purelib"], paths["platlib"])]
        beside = tuple(place + os.sep for place in (*own, *_SYSTEM))
        found = self.opened.items()
        return sorted(name for name, at in found if not at.startswith(beside) and os.path.isfile(name))

    def contents(self) -> dict[str, Content]:
        """What is in these files, by the names that were opened."""
        return {name: Content.of(name) for name in self.names()}


@contextmanager
def keeping_ledger() -> Iterator[Ledger]:
    """Within, all that is opened for reading is kept in a ledger, and no result takes the place of any of it.

    Includes and companions are known to the readers alone, of which there are many: Python itself reports its
    open files, and ``storage.hdf5`` says it for the HDF5 library.
    """
    if not _hooked:
        _hooked.append(True)
        sys.addaudithook(_record_open)  # stays for the life of the process
    ledger = Ledger()
    _ledgers.append(ledger)
    try:
        yield ledger
    finally:
        _ledgers.remove(ledger)


@contextmanager
def own_files() -> Iterator[None]:
    """Within, what is opened is no input: steps and lists of an earlier run, which this one replaces."""
    before = _own.set(True)
    try:
        yield
    finally:
        _own.reset(before)


def promise(path: Path) -> None:
    """Say that ``path`` is to be written: from now on it cannot be opened as an input.

    Raises:
        OverwriteError: it is one already.
    """
    refuse_input(path)
    if _ledgers:
        _ledgers[-1].promised.append(Path(os.path.abspath(path)))


def refuse_input(path: Path) -> None:
    """Refuse to write to a file that was read, whatever its name: links, hard links and other cases too.

    Raises:
        OverwriteError: ``path`` is one.
    """
    places: tuple[Place, ...] = (os.path.realpath(path), place_of(path))
    for ledger in list(_ledgers):
        for name in (name for place in places for name in ledger.places.get(place, ())):
            # The number of a file that is gone belongs to another one by now.
            if same_place(path, name) or same_place(path, ledger.opened[name]):
                raise _overwrite_error(path, name)


def was_written(path: Path) -> None:
    """Say that ``path`` is a result now, which may be read and written again."""
    for ledger in list(_ledgers):
        target = os.path.realpath(path)
        ledger.promised = [place for place in ledger.promised if os.path.realpath(place) != target]
        ledger.written.append(target)


def note_input(name: str) -> None:
    """Add a file that another process opened.

    Raises:
        OverwriteError: it is to be written.
    """
    _record_name(name)


def place_of(path: str | Path) -> Place:
    """What all names of one file have in common: device and number of one that is there, else where links lead."""
    with suppress(OSError):
        status = os.stat(path)
        if status.st_ino:
            return status.st_dev, status.st_ino
    return os.path.realpath(path)


def same_place(one: str | Path, other: str | Path) -> bool:
    """True if two names lead to one file, or would once it is there."""
    return os.path.realpath(one) == os.path.realpath(other) or place_of(one) == place_of(other)


def _record_open(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _ledgers or _own.get():
        return
    path, mode, flags = arguments
    writes = flags & (os.O_WRONLY | os.O_RDWR) if isinstance(flags, int) else False
    if isinstance(path, str | bytes | os.PathLike) and not writes and not set(mode or "r") & set("wax+"):
        _record_name(os.fsdecode(path))


def _record_name(name: str) -> None:
    """Keep a name in all ledgers: not without its dots, which mean another folder behind a link."""
    if name.endswith(_CODE) or "\0" in name:
        return
    try:
        name = name if os.path.isabs(name) else os.path.join(os.getcwd(), name)
        target = os.path.realpath(name)
    except OSError:
        return
    refused: list[OverwriteError] = []
    for ledger in list(_ledgers):
        if target not in ledger.written:
            if name not in ledger.opened:
                ledger.opened[name] = target
                for place in {target, place_of(name)}:
                    ledger.places.setdefault(place, []).append(name)
            refused += [_overwrite_error(place, name) for place in ledger.promised if same_place(place, target)]
    if refused:
        raise refused[0]


def _overwrite_error(path: Path, name: str) -> OverwriteError:
    also = "" if os.path.abspath(path) == os.path.normpath(name) else f", which is {name}"
    return OverwriteError(f"{path} would overwrite a file that is read{also}; give the result another name")
