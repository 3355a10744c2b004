"""Files that are whole or not there: written under another name, then renamed.

A library such as HDF5 does not survive a write that fails while it closes a file. ``SafeFile`` is
therefore the file it sees: after the first failure it swallows all writes, the library closes in
peace, and the failure is raised afterwards.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
    target = _checked(path)
    temporary = _temporary(target)
    try:
        file = SafeFile(temporary)
    except OSError as error:
        raise _output_error(path, error, "the file") from error
    try:
        try:
            yield file
        except Exception:
            # What a library says after a failed write is only a consequence of it.
            _refuse_failed(path, file)
            raise
        _finish(path, file, temporary, target)
    finally:
        file.close()
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    _sync_folder(target.parent)


def _refuse_failed(path: Path, file: SafeFile) -> None:
    if isinstance(file.error, OSError):
        raise _output_error(path, file.error, file.doing) from file.error
    file.check()


def _finish(path: Path, file: SafeFile, temporary: Path, target: Path) -> None:
    """Bring everything to the disk, then take the name."""
    try:
        os.fsync(file.fileno())
        file.close()
        file.check()
        os.replace(temporary, target)
    except OSError as error:
        raise _output_error(path, error, "the end of the file") from error


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


def _output_error(path: Path, error: OSError, doing: str) -> OutputError:
    reason = error.strerror or str(error)
    cure = "check the disk, then run again"
    if error.errno in _FULL:
        cure = "free space there (or raise the quota or file-size limit), or choose another folder"
    elif error.errno in _FORBIDDEN:
        cure = "choose a folder you may write to"
    elif error.errno == errno.ENAMETOOLONG:
        cure = "give a shorter name"
    kept = "; the file that was there before is unchanged" if os.path.exists(path) else ""
    return OutputError(f"{path} could not be written (at: {doing}): {reason}{kept}; {cure}")


def _sync_folder(folder: Path) -> None:
    """Make the new name survive a power cut, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
