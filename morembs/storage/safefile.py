"""Files that are whole or not there, one or several together: written under other names, then renamed.

A library such as HDF5 does not survive a write that fails while it closes a file. ``SafeFile`` is
therefore the file it sees: after the first failure it swallows all writes, the library closes in
peace, and the failure is raised afterwards.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from morembs import stopping
from morembs.errors import OutputError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)


class SafeFile:
    """Binary file that remembers its first failure instead of raising it.

    ``doing`` names what is being written, for the error message.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "w+b", buffering=0)  # noqa: SIM115  (closed in close)
        self.error: BaseException | None = None
        self.doing = "the file"

    def write(self, data: bytes | memoryview) -> int:
        """Write all of ``data``, or keep the reason why not."""
        view = memoryview(data)
        if self.error is None:
            try:
                done = 0
                while done < len(view):
                    done += self._file.write(view[done:]) or 0
            except BaseException as error:  # also an interruption: HDF5 must not see it here
                self.error = error
        return len(view)

    def truncate(self, size: int) -> int:
        """Set the length in bytes, or keep the reason why not."""
        if self.error is None:
            try:
                self._file.truncate(size)
            except BaseException as error:
                self.error = error
        return size

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a position in bytes."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Position in bytes."""
        return self._file.tell()

    def read(self, size: int = -1) -> bytes:
        """Read up to ``size`` bytes."""
        return self._file.read(size) or b""

    def readinto(self, buffer: memoryview) -> int:
        """Fill ``buffer``, with zeros behind the end of the file."""
        view, done = memoryview(buffer).cast("B"), 0
        while done < len(view):
            got = self._file.readinto(view[done:])
            if not got:
                view[done:] = bytes(len(view) - done)
                break
            done += got
        return len(view)

    def flush(self) -> None:
        """Nothing is held back."""

    def check(self) -> None:
        """Raise the first failure, if there was one."""
        if self.error is not None:
            raise self.error

    def fileno(self) -> int:
        """Descriptor of the operating system."""
        return self._file.fileno()

    def close(self) -> None:
        """Close; a failure is kept like that of a write."""
        try:
            self._file.close()
        except OSError as error:
            self.error = self.error or error


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.tmp-{os.getpid()}")


@contextmanager
def replacing(path: Path) -> Iterator[SafeFile]:
    """A file that takes the place of ``path`` when the ``with`` ends well; else ``path`` stays as it was.

    Raises:
        OutputError: the file cannot be written, whatever a library made of that.
    """
    with replacing_all([path]) as (file,):
        yield file


@contextmanager
def replacing_all(paths: Sequence[Path]) -> Iterator[tuple[SafeFile, ...]]:
    """Files that belong together: all take the places of ``paths`` when the ``with`` ends well, else none does.

    Names change only once every file is complete and on the disk. Where one of them then cannot change, those that
    did get their old files back. A power cut at just that time can leave some of each.

    Raises:
        OutputError: a file cannot be written, or two of ``paths`` are one file.
    """
    places = [_Place(path=path, target=_checked(path)) for path in paths]
    for number, place in enumerate(places):
        if any(place.target == other.target for other in places[:number]):
            raise OutputError(f"{place.path} would be written twice; give each file its own name")
    files: list[SafeFile] = []
    try:
        for place in places:
            try:
                files.append(SafeFile(place.temporary))
            except OSError as error:
                raise _output_error(place.path, error, "the file", places) from error
        try:
            yield tuple(files)
        except Exception:
            # What a library says after a failed write is only a consequence of it.
            _refuse_failed(places, files)
            raise
        _complete(places, files)
        _take_names(places)
    finally:
        for file in files:
            file.close()
        for place in places:
            _drop(place.temporary)
    for folder in {place.target.parent for place in places}:
        _sync_folder(folder)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A file as it was asked for, where links lead to, and its names until all are there."""

    path: Path
    target: Path

    @property
    def temporary(self) -> Path:
        return _temporary(self.target)

    @property
    def old(self) -> Path:
        return self.target.with_name(f".{self.target.name}.old-{os.getpid()}")


def _refuse_failed(places: Sequence[_Place], files: Sequence[SafeFile]) -> None:
    for place, file in zip(places, files, strict=True):
        if isinstance(file.error, OSError):
            raise _output_error(place.path, file.error, file.doing, places) from file.error
        file.check()


def _complete(places: Sequence[_Place], files: Sequence[SafeFile]) -> None:
    """Bring everything to the disk."""
    for place, file in zip(places, files, strict=True):
        try:
            os.fsync(file.fileno())
            file.close()
            file.check()
        except OSError as error:
            raise _output_error(place.path, error, "the end of the file", places) from error


def _take_names(places: Sequence[_Place]) -> None:
    """Take the names, all or none: a second name of the old file brings it back; none after a signal to end."""
    stopping.check()
    for place in places if len(places) > 1 else ():
        # Not every disk has second names; then the message says which files are new.
        with contextlib.suppress(OSError):
            _drop(place.old)
            os.link(place.target, place.old)
    done: list[tuple[_Place, bool]] = []
    try:
        for place in places:
            existed = place.target.exists()
            os.replace(place.temporary, place.target)
            done.append((place, existed))
    except BaseException as error:
        mixed = [place for place, existed in reversed(done) if not _undone(place, existed)]
        for place in places:
            if place not in mixed:
                _drop(place.old)
        if isinstance(error, OSError):
            raise _output_error(places[len(done)].path, error, "the end of the file", places, mixed) from error
        raise
    for place in places:
        _drop(place.old)


def _drop(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def _undone(place: _Place, existed: bool) -> bool:
    """Whether the file is again what it was before."""
    try:
        if existed:
            os.replace(place.old, place.target)
        else:
            place.target.unlink()
    except OSError:
        return False
    return True


def check_writable(path: str | Path) -> None:
    """Check, before a long calculation, that a file can be written at ``path``; leaves nothing behind.

    Raises:
        OutputError: the folder is missing or read-only, or ``path`` is a folder or a device.
    """
    target = _checked(Path(path))
    temporary = _temporary(target)
    try:
        temporary.touch()
        temporary.unlink()
    except OSError as error:
        raise _output_error(Path(path), error, "a trial file") from error


def _checked(path: Path) -> Path:
    """Where links lead to; a folder must be there and the name free or a file."""
    target = Path(os.path.realpath(path))
    folder = target.parent
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "does not exist"
        raise OutputError(f"{path} cannot be written: the folder {folder} {what}; make it, or choose another")
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return target
    except OSError as error:
        raise _output_error(path, error, "the file") from error
    if stat.S_ISDIR(mode):
        raise OutputError(f"{path} cannot be written: it is a folder; give the name of a file")
    if not stat.S_ISREG(mode):
        raise OutputError(f"{path} cannot be written: it is not a regular file; give another name")
    return target


def _output_error(
    path: Path, error: OSError, doing: str, places: Sequence[_Place] = (), mixed: Sequence[_Place] = ()
) -> OutputError:
    """What went wrong, what it left behind (of ``places``, ``mixed`` are new already), and what to do."""
    reason = error.strerror or str(error)
    cure = "check the disk, then run again"
    if error.errno in _FULL:
        cure = "free space there (or raise the quota or file-size limit), or choose another folder"
    elif error.errno in _FORBIDDEN:
        cure = "choose a folder you may write to"
    elif error.errno == errno.ENAMETOOLONG:
        cure = "give a shorter name"
    kept = ""
    if mixed:
        names = ", ".join(place.path.name for place in mixed)
        kept = f"; {names} of the same set could not be taken back and do not fit the other files: do not use them"
    elif len(places) > 1 and any(os.path.exists(place.path) for place in places):
        kept = "; the files that were there before are unchanged"
    elif os.path.exists(path):
        kept = "; the file that was there before is unchanged"
    return OutputError(f"{path} could not be written (at: {doing}): {reason}{kept}; {cure}")


def _sync_folder(folder: Path) -> None:
    """Make the new name survive a power cut, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
