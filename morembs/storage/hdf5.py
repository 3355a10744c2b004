"""HDF5 files of strangers, opened for reading: nothing in them may lead out of them, or fill the memory.

The HDF5 library follows links to other files, takes the values of a dataset from any file that it names, and loads
filters as plug-ins. Every reader therefore opens its file here, where all objects are looked at first.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, MorembsError
from morembs.base.memory import available_bytes
from morembs.storage.tolerances import TOL

# What the libraries raise where a file is damaged.
DAMAGE = (
    OSError,
    RuntimeError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    ArithmeticError,
    MemoryError,
    EOFError,
)
# Filters within the library: deflate, shuffle, fletcher32, szip, nbit, scaleoffset, and the LZF of h5py.
_FILTERS = {1, 2, 3, 4, 5, 6, 32000}
# Format of the files of planar members, which are told from others.
MEMBERS = "morembs-members"


@contextmanager
def reading(path: Path, expected: str, cure: str = "write it again") -> Iterator[Any]:
    """An HDF5 file, open for reading; what goes wrong while it is read becomes one message.

    Args:
        expected: what the file should be, in words; ``cure`` what to do with a damaged one.

    Raises:
        InputError: no such file, no HDF5 file, one that leads out of itself, or one that is damaged.
    """
    if not path.is_file():
        raise InputError(f"{path} was given as {expected}; there is no such file", kind="file", keyword=path.name)
    try:
        if not h5py.is_hdf5(path):
            path.open("rb").close()  # says why, where it cannot be read at all
            raise InputError(
                f"{path} cannot be read as {expected}: it is not an HDF5 file; check the name",
                kind="file",
                keyword=path.name,
            )
        with _open_audited(path) as file:
            _refuse_unsafe(path, file)
            yield file
    except MorembsError:
        raise
    except BlockingIOError as error:
        raise InputError(
            f"{path} is open for writing in another program; close it there, then read it",
            kind="file",
            keyword=path.name,
        ) from error
    except DAMAGE as error:
        raise InputError(
            f"{path} cannot be read as {expected} ({_reason(error)}); if it is damaged, {cure}",
            kind="file",
            keyword=path.name,
        ) from error


@contextmanager
def reading_format(
    path: Path, expected: str, name: str, known: int, *, cure: str = "write it again", hint: str = ""
) -> Iterator[Any]:
    """A file of ours, open as by ``reading`` once it is known to have the /format ``name`` and a ``known`` version.

    Args:
        hint: what to say besides where it is another file.

    Raises:
        InputError: as ``reading``, another kind of file, or one of a newer version.
    """
    with reading(path, expected, cure) as file:
        if is_format(file, MEMBERS):
            raise InputError(
                f"{path} holds planar members, expected {expected}; morembs info, evaluate and export take members, "
                "and in Python morembs.dynamics.gmp.stored.read_members",
                kind="unsupported",
                keyword=path.name,
            )
        if not is_format(file, name):
            raise InputError(
                f"{path} is an HDF5 file but not {expected} of morembs (no /format {name!r}){hint}",
                kind="file",
                keyword=path.name,
            )
        if not isinstance(file.get("format_version"), h5py.Dataset):
            raise InputError(
                f"{path} is an incomplete {expected.removeprefix('a ')}; missing: /format_version; {cure}",
                kind="file",
                keyword=path.name,
            )
        refuse_newer(path, int(file["format_version"][()]), known, f"install a newer one, or {cure}")
        yield file


def is_format(file: Any, name: str) -> bool:
    """True if an open HDF5 file says that it has the format ``name``."""
    held = file.get("format")
    return isinstance(held, h5py.Dataset) and held.shape == () and bool(held[()] == name.encode())


def holds_format(path: Path, name: str) -> bool:
    """True if ``path`` is a file of ours of the format ``name``, sound or not."""
    try:
        with reading(path, "a file of morembs") as file:
            return is_format(file, name)
    except InputError:
        return False


def tree(group: Any) -> dict[str, Any]:
    """Nested mapping of a group; text as str, numbers as Python numbers, arrays as lists."""
    return {name: tree(item) if hasattr(item, "items") else _plain(item[()]) for name, item in group.items()}


def _plain(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value.tolist()


def refuse_unsafe_file(path: Path) -> None:
    """Look at a file that another reader will open; what is no HDF5 file, or damaged, is left to that reader.

    Raises:
        InputError: the file leads out of itself, or announces much more than it holds.
    """
    # Other libraries of C, which do not say it either, open what is no HDF5 file.
    sys.audit("open", path, "r", 0)
    try:
        if path.is_file() and h5py.is_hdf5(path):
            with _open_audited(path) as file:
                _refuse_unsafe(path, file)
    except MorembsError:
        raise
    except DAMAGE:
        return


def refuse_newer(path: Path, version: int, known: int, cure: str = "install a newer one") -> None:
    """Refuse a file of a version that is not among 1 to ``known``; docs/reference/schema.md says when versions rise.

    Raises:
        InputError: it is of another version.
    """
    if not 1 <= version <= known:
        raise InputError(
            f"{path} has the format version {version}; this morembs reads up to {known}; {cure}",
            kind="file",
            keyword=path.name,
        )


def read_dataset(item: Any) -> NDArray[Any]:
    """All of a dataset.

    Raises:
        InputError: it has no values, or is a group.
    """
    if not isinstance(item, h5py.Dataset) or item.shape is None:
        raise InputError(f"{item.name} is not a dataset with values; the file is damaged, write it again", kind="file")
    return np.asarray(item[()])


def _open_audited(path: Path) -> Any:
    # The HDF5 library does not say what it opens (see ``contents``).
    sys.audit("open", path, "r", 0)
    return h5py.File(path, "r")


def _reason(error: BaseException) -> str:
    words = error.args[0] if isinstance(error, KeyError) and error.args else error
    # A message quotes 200 characters of it at most.
    return " ".join(str(words).split())[:200] or type(error).__name__


def _refuse_unsafe(path: Path, file: Any) -> None:
    """Look at all links and datasets, without reading values."""
    links: list[tuple[bytes, int, int]] = []
    file.id.links.visit(lambda name, info: links.append((name, info.type, info.u)), info=True)
    groups, unpacked = {h5py.h5o.get_info(file.id).addr}, 0
    for name, kind, address in links:
        words = f"{path}: /{name.decode(errors='replace')}"
        if kind == h5py.h5l.TYPE_SOFT:
            continue  # the name of another object in this file
        if kind != h5py.h5l.TYPE_HARD:
            raise InputError(
                f"{words} is a link to another file, which is not followed; give one file with all data",
                kind="unsupported",
            )
        item = h5py.h5o.open(file.id, name)
        if isinstance(item, h5py.h5d.DatasetID):
            unpacked += _refuse_strange(words, item)
        elif isinstance(item, h5py.h5g.GroupID):
            if address in groups:
                raise InputError(
                    f"{words} is a group under two names; the file is damaged, write it again", kind="file"
                )
            groups.add(address)
    free = available_bytes() if unpacked else 0
    if unpacked > free:
        raise InputError(
            f"{path} holds packed data of {unpacked:.3g} bytes that are nearly all alike; {free:.3g} bytes of memory "
            "are free; check the file, or give more memory",
            kind="file",
            keyword=path.name,
        )


def _refuse_strange(words: str, item: Any) -> int:
    """Look at one dataset; returns its bytes in memory if it is packed so tight that its size says nothing."""
    layout = item.get_create_plist()
    if layout.get_external_count():
        other = layout.get_external(0)[0].decode(errors="replace")
        raise InputError(
            f"{words} takes its values from the file {other!r}, which is not read; give one file with all",
            kind="unsupported",
        )
    if layout.get_layout() == h5py.h5d.VIRTUAL:
        raise InputError(
            f"{words} takes its values from other datasets (virtual); give one file with all data", kind="unsupported"
        )
    strange = {layout.get_filter(i)[0] for i in range(layout.get_nfilters())} - _FILTERS
    if strange:
        raise InputError(
            f"{words} is packed with the filter {min(strange)}, which is not part of HDF5; pack it with gzip, or not "
            "at all (h5repack -f GZIP=4)",
            kind="unsupported",
            keyword="filter",
        )
    if item.get_space().get_simple_extent_type() != h5py.h5s.SIMPLE:
        return 0
    announced, held = math.prod(item.shape) * item.get_type().get_size(), item.get_storage_size()
    if announced > TOL.small_bytes and announced > TOL.largest_compression * held:
        raise InputError(
            f"{words} announces {announced:.3g} bytes, of which the file holds {held}; it is damaged or was never "
            "filled, write it again",
            kind="file",
        )
    return announced if layout.get_nfilters() and announced > max(TOL.small_bytes, TOL.usual_compression * held) else 0
