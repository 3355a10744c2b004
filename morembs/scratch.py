"""Private folders for files that live as long as a calculation, and never longer.

A folder is marked by a file that its process keeps locked. The operating system drops the lock however the
process ends, so the next run knows which folders nobody owns any more and removes them.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import tempfile
import time
import weakref
from pathlib import Path
from typing import Any

from morembs.errors import InputError

try:
    import fcntl
except ImportError:  # not on this system: then nothing is known to be left over
    fcntl = None  # type: ignore[assignment]

log = logging.getLogger(__name__)
_PREFIX = "morembs-"
_OWNER = "owner.lock"
# A folder without a lock file may be one that is being made right now.
_YOUNG = 60.0


class ScratchFolder:
    """A new private folder below ``parent`` (None: the temporary folder of the system).

    Removed by ``close``, when it is forgotten, or when the interpreter ends; what killed runs left behind in
    the same parent is removed first.

    Raises:
        InputError: the parent cannot be made or written.
    """

    def __init__(self, parent: Path | None) -> None:
        if parent is not None:
            try:
                parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"the scratch folder {parent} cannot be made: {error}") from error
        remove_abandoned(parent)
        try:
            self.path = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent)).resolve()
        except OSError as error:
            place = parent or tempfile.gettempdir()
            raise InputError(
                f"the scratch folder {place} cannot be written ({error.strerror}); give another one"
            ) from error
        self._finalize = weakref.finalize(self, _remove, self.path, _lock(self.path / _OWNER))

    def close(self) -> None:
        """Remove the folder and all that is in it."""
        self._finalize()


def remove_abandoned(parent: Path | None) -> None:
    """Remove the folders of processes that ended without doing so."""
    if fcntl is None:
        return
    for folder in Path(parent or tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.is_dir() and not folder.is_symlink() and _abandoned(folder):
                log.info("removing %s, which an interrupted run left behind", folder)
                shutil.rmtree(folder, ignore_errors=True)


def free_bytes(parent: Path | None) -> int:
    """Free space on the disk of the scratch folder."""
    place = Path(parent or tempfile.gettempdir())
    while not place.exists() and place != place.parent:
        place = place.parent
    return shutil.disk_usage(place).free


def _abandoned(folder: Path) -> bool:
    mark = folder / _OWNER
    if not mark.exists():
        empty = all(path.suffix == ".new" for path in folder.iterdir())
        return empty and time.time() - folder.stat().st_mtime > _YOUNG
    handle = os.open(mark, os.O_RDWR)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(handle)
    return True


def _lock(path: Path) -> Any:
    """Open handle of ``path``, locked until it is closed or the process ends."""
    # It gets its name when it is locked, so that nobody ever sees it free.
    new = path.with_suffix(".new")
    handle = os.open(new, os.O_RDWR | os.O_CREAT, 0o600)
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX)
    new.rename(path)
    return handle


def _remove(path: Path, handle: int) -> None:
    shutil.rmtree(path, ignore_errors=True)
    with contextlib.suppress(OSError):
        os.close(handle)
