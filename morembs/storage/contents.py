"""What was in files: which ones a calculation reads, and whether they are still the same."""

from __future__ import annotations

import hashlib
import os
import sys
import sysconfig
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Times of files are as coarse as this on some disks, in ns: a younger file may have changed without a new time.
_COARSE = 2_000_000_000
_NUMBERS = ("bytes", "modified_ns", "changed_ns", "looked_ns")
_SYSTEM = ("/proc", "/sys", "/dev")
_CODE = (".py", ".pyc", ".so", ".pyd", ".pyi")
_readings: list[set[str]] = []
_hooked: list[bool] = []


@dataclass(frozen=True)
class Content:
    """A file when it was looked at: size in bytes, times of its last change and of the look in ns, SHA-256.

    ``changed_ns`` is the time that the system keeps for itself, which copies and archives cannot give another value.
    """

    bytes: int
    modified_ns: int
    changed_ns: int
    looked_ns: int
    sha256: str

    @classmethod
    def of(cls, path: str | Path) -> Content:
        """What is in a file now.

        Raises:
            OSError: it cannot be read.
        """
        looked = time.time_ns()
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return cls(status.st_size, status.st_mtime_ns, status.st_ctime_ns, looked, digest)

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> Content:
        """The inverse of ``vars``.

        Raises:
            KeyError, TypeError, ValueError: other values.
        """
        size, modified, changed, looked = (int(values[key]) for key in _NUMBERS)
        return cls(size, modified, changed, looked, str(values["sha256"]))

    def still_in(self, path: str | Path) -> bool:
        """Whether the file holds the same now: by size and time where they tell it, else by its bytes."""
        try:
            status = os.stat(path)
            if status.st_size != self.bytes:
                return False
            settled = self.looked_ns - max(self.modified_ns, self.changed_ns) > _COARSE
            same = (status.st_mtime_ns, status.st_ctime_ns) == (self.modified_ns, self.changed_ns)
            return (settled and same) or Content.of(path).sha256 == self.sha256
        except OSError:
            return False


@contextmanager
def files_read() -> Iterator[dict[str, Content]]:
    """The files that are opened for reading within, filled in at the end; not those of Python and of the system.

    Includes and companions are known to the readers alone, of which there are many: Python itself says what it opens,
    and ``storage.hdf5`` says it for the HDF5 library.
    """
    if not _hooked:
        _hooked.append(True)
        sys.addaudithook(_heard)  # stays for the life of the process
    opened: set[str] = set()
    _readings.append(opened)
    contents: dict[str, Content] = {}
    try:
        yield contents
    finally:
        _readings.remove(opened)
        foreign = _foreign(opened)
    contents.update({str(path): Content.of(path) for path in foreign})


def _heard(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _readings:
        return
    path, mode, flags = arguments
    writes = flags & (os.O_WRONLY | os.O_RDWR) if isinstance(flags, int) else False
    if isinstance(path, str | os.PathLike) and not writes and not set(mode or "r") & set("wax+"):
        for opened in _readings:
            opened.add(os.path.abspath(path))


def _foreign(opened: set[str]) -> list[Path]:
    """Those that are files still, and neither code nor part of Python or of the system."""
    paths = sysconfig.get_paths()
    own = [os.path.realpath(place) for place in (paths["stdlib"], paths["purelib"], paths["platlib"])]
    beside = tuple(place + os.sep for place in (*own, *_SYSTEM))
    files = {os.path.realpath(name) for name in opened if not name.endswith(_CODE)}
    return sorted(Path(name) for name in files if os.path.isfile(name) and not name.startswith(beside))
