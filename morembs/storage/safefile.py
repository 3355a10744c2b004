"""Files that are whole or not there, one or several together: written in a private folder beside, then renamed.

What a killed run leaves behind, the next one that writes to the same folder removes (``base.scratch``). A link that
was given as output stays, and the file that it leads to is replaced. A file that was read is never replaced
(``storage.contents``): that is asked here, where files get their names, and as soon as an output is named.

A library such as HDF5 does not survive a write that fails while it closes a file. ``SafeFile`` is therefore the file it
sees: after the first failure it swallows all writes, the library closes in peace, and the failure is raised afterwards.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from morembs.base import stopping
from morembs.base.errors import OutputError
from morembs.base.scratch import PrivateFolder
from morembs.storage.contents import promise, refuse_input, same_place, was_written

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# Of the private folders: hidden beside the output.
PREFIX = ".morembs.tmp-"
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
# Sees files that are complete, by the paths that were asked for, before they take their names.
Look = Callable[[Mapping[Path, Path]], None]
_LOOK: ContextVar[Look | None] = ContextVar("look", default=None)


@contextmanager
def looked_at(look: Look) -> Iterator[None]:
    """Within the ``with`` files that are complete are shown to ``look``; where it raises, none of them takes its
    name."""
    token = _LOOK.set(look)
    try:
        yield
    finally:
        _LOOK.reset(token)


class SafeFile:
    """Binary file that remembers its first failure instead of raising it.

    ``doing`` names what is being written, for the error message.
    """

    def __init__(self, path: Path) -> None:
        self._file = open(path, "x+b", buffering=0)  # noqa: SIM115
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
            count = self._file.readinto(view[done:])
            if not count:
                view[done:] = bytes(len(view) - done)
                break
            done += count
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

    Names change only once every file is complete and on the disk. Where one of them then cannot change, changed
    ones get their old files back. A power cut at just that time can leave some of each.

    Args:
        paths: files to write.

    Raises:
        OverwriteError: one of ``paths`` was read.
        OutputError: a file cannot be written, or two of ``paths`` are one file.
    """
    targets = [(path, checked(path)) for path in paths]
    for number, (path, target) in enumerate(targets):
        refuse_input(path)
        if any(one_file(target, other) for _, other in targets[:number]):
            raise OutputError(f"{path} would be written twice; give each file its own name")
    folders: dict[Path, PrivateFolder] = {}
    places: list[Place] = []
    files: list[SafeFile] = []
    try:
        for number, (path, target) in enumerate(targets):
            try:
                if target.parent not in folders:
                    folders[target.parent] = PrivateFolder(target.parent, PREFIX)
                new = folders[target.parent].path / f"{number}.tmp{target.suffix}"
                places.append(Place(path=path, target=target, new=new))
                files.append(SafeFile(places[-1].new))
            except OSError as error:
                raise _output_error(path, error, "the file", places) from error
        try:
            yield tuple(files)
        except Exception:
            # What a library says after a failed write is only a consequence of it.
            _refuse_failed(places, files)
            raise
        _complete(places, files)
        look = _LOOK.get()
        if look is not None:
            look({place.path: place.new for place in places})
        take_names(places)
    finally:
        for file in files:
            file.close()
        for folder in folders.values():
            folder.close()
    for place in folders:
        _sync_folder(place)


@dataclass(frozen=True, kw_only=True)
class Place:
    """A file as it was asked for, where links lead to, and the names of the new and the old one until all are there."""

    path: Path
    target: Path
    new: Path

    @property
    def old(self) -> Path:
        return self.new.with_name(f"{self.new.name}.old")


def _refuse_failed(places: Sequence[Place], files: Sequence[SafeFile]) -> None:
    for place, file in zip(places, files, strict=True):
        if isinstance(file.error, OSError):
            raise _output_error(place.path, file.error, file.doing, places) from file.error
        file.check()


def _complete(places: Sequence[Place], files: Sequence[SafeFile]) -> None:
    """Bring everything to the disk."""
    for place, file in zip(places, files, strict=True):
        try:
            os.fsync(file.fileno())
            file.close()
            file.check()
        except OSError as error:
            raise _output_error(place.path, error, "the end of the file", places) from error


def take_names(places: Sequence[Place]) -> None:
    """Take the names, all or none: a second name of the old file brings it back; none after a signal to end."""
    stopping.check()
    for place in places:
        refuse_input(place.path)
    for place in places if len(places) > 1 and hasattr(os, "link") else ():
        # Not every disk has second names; then the message says which files are new.
        with contextlib.suppress(OSError):
            os.link(place.target, place.old)
    done: list[tuple[Place, bool]] = []
    try:
        for place in places:
            existed = place.target.exists()
            os.replace(place.new, place.target)
            done.append((place, existed))
    except BaseException as error:
        mixed = [place for place, existed in reversed(done) if not _undone(place, existed)]
        for place in mixed:  # the old file, where there is a second name of it, is not lost with the folder
            with contextlib.suppress(OSError):
                os.replace(place.old, place.target.with_name(f"{place.target.name}.old{place.new.parent.suffix}"))
        if isinstance(error, OSError):
            raise _output_error(places[len(done)].path, error, "the end of the file", places, mixed) from error
        raise
    for place in places:
        was_written(place.target)


def _undone(place: Place, existed: bool) -> bool:
    """True if the old file is in place again."""
    try:
        if existed:
            os.replace(place.old, place.target)
        else:
            place.target.unlink()
    except OSError:
        return False
    return True


def one_file(one: Path, other: Path) -> bool:
    """True if two names are those of one file, also of one that is not there yet on a disk that ignores case."""
    if same_place(one, other):
        return True
    alike = one.name != other.name and one.name.casefold() == other.name.casefold()
    return alike and same_place(one.parent, other.parent) and _ignores_case(one.parent)


def _ignores_case(folder: Path) -> bool:
    """True if the disk takes names for the same that differ in small and capital letters only."""
    trial = PrivateFolder(folder, PREFIX)
    try:
        (trial.path / "a").touch()
        return (trial.path / "A").exists()
    finally:
        trial.close()


def copy_into(folder: Path, file: Path, name: str = "") -> None:
    """A copy of ``file`` in ``folder``, with its times, under its own name or another.

    Raises:
        OverwriteError: a file of that name was read.
        OutputError: it cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / (name or file.name)
    with replacing(target) as copy, file.open("rb") as held:
        shutil.copyfileobj(held, copy)
    shutil.copystat(file, target)


def check_writable(path: str | Path) -> None:
    """Check, before a long calculation, that a file can be written at ``path``; leaves nothing behind.

    Until it is written, no input can be read from there.

    Raises:
        OverwriteError: it was read.
        OutputError: the folder is missing or read-only, or ``path`` is a folder or a device.
    """
    target = checked(Path(path))
    promise(Path(path))
    try:
        folder = PrivateFolder(target.parent, PREFIX)
        try:
            (folder.path / "0.tmp").touch(exist_ok=False)
        finally:
            folder.close()
    except OSError as error:
        raise _output_error(Path(path), error, "a trial file") from error


def checked(path: Path) -> Path:
    """Where links lead to; a folder must be there and the name free or a file."""
    if "\0" in str(path):
        raise OutputError(f"{str(path)!r} cannot be written: no name of a file has a NUL character; give another name")
    _refuse_planted(path)
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


def _refuse_planted(path: Path) -> None:
    """In a folder where everybody may write, a link of somebody else is a trap, as Linux sees it (protected_symlinks).

    Raises:
        OutputError: ``path`` is such a link.
    """
    try:
        link, folder = path.lstat(), path.parent.stat()
    except OSError:
        return
    shared = hasattr(os, "geteuid") and folder.st_mode & stat.S_ISVTX and folder.st_mode & stat.S_IWOTH
    if stat.S_ISLNK(link.st_mode) and shared and link.st_uid not in (os.geteuid(), folder.st_uid):
        raise OutputError(
            f"{path} cannot be written: it is a link that another user made in a folder for all; give another name"
        )


def _output_error(
    path: Path, error: OSError, doing: str, places: Sequence[Place] = (), mixed: Sequence[Place] = ()
) -> OutputError:
    """The error with its cause, files that are left behind (of ``places``, ``mixed`` are new already), and the cure."""
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
