"""Checksums of all that a file holds, in the file: damage that no other check can see is found and named.

The group ``checksums`` has two datasets of text, a row for each object: ``names``, and ``sha256`` in hexadecimal
digits. Other writers may leave it out. Its rows, and what is summed, are described in
docs/reference/schema/conventions.md.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Values
from morembs.storage.storable import text
from morembs.storage.tolerances import TOL

GROUP = "checksums"


def seal(group: Any, *, excluded: Sequence[str] = ()) -> None:
    """Store the checksums of all below an open HDF5 ``group`` in place of its present ones.

    Whoever changes a file on purpose calls this afterwards, or removes the group ``checksums``.

    Args:
        excluded: groups below that are left out.
    """
    if GROUP in group:
        del group[GROUP]
    names: list[str] = []
    group.id.links.visit(lambda name: names.append(name.decode()))
    sums: dict[str, str] = {}
    for name in names:
        item = group[name]
        if name.split("/")[0] in excluded or (isinstance(item, h5py.Group) and not len(item.attrs)):
            continue
        sums[name] = _sum(item)
        for column in range(item.shape[1] if _by_columns(item) else 0):
            sums[f"{name}/{column}"] = _sum_of(item[:, column])
    group[f"{GROUP}/names"], group[f"{GROUP}/sha256"] = text(*sums), text(*sums.values())
    group[f"{GROUP}/names"].attrs["description"] = np.bytes_("of objects, and of columns as NAME/column")
    group[f"{GROUP}/sha256"].attrs["description"] = np.bytes_("of types, shapes, attributes and values")


def whole_sum(path: Path | str) -> str:
    """SHA-256 of the checksums of a file: equal where all is equal that they are made of, bit by bit.

    Raises:
        OSError, KeyError: there is no such file, or none in it.
    """
    with h5py.File(path, "r") as file:
        return hashlib.sha256(b"\n".join([*file[f"{GROUP}/names"][()], *file[f"{GROUP}/sha256"][()]])).hexdigest()


def warn_unsealed(path: Path | str, file: Any, mark: str) -> tuple[str, ...]:
    """A warning where an open file has no checksums, but the dataset ``mark``, which came to its format with 0.2 as
    they did."""
    if GROUP in file or mark not in file:
        return ()
    return (
        f"{Path(path).name} has no group {GROUP}, which morembs writes since 0.2: damage that leaves numbers plausible "
        "is not seen; write it again, or if they were left out on purpose, call morembs.storage.checksums.seal",
    )


class Checksums:
    """Those of an open HDF5 ``group``, none where it has no group ``checksums``; ``path`` is for messages.

    Raises:
        InputError: they cannot be read.
    """

    def __init__(self, path: Path | str, group: Any) -> None:
        self.path, self.group = path, group
        self.sums: dict[str, str] = {}
        table = group.get(GROUP)
        if table is None:
            return
        try:
            names, sums = ([line.decode() for line in table[part][()].tolist()] for part in ("names", "sha256"))
            self.sums = dict(zip(names, sums, strict=True))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise self._damage_error(GROUP, "cannot be read") from error

    def verify(self, chosen: Callable[[str], bool] = lambda name: True) -> None:
        """See that nothing that was summed is missing, and sum again what is ``chosen`` by its name.

        Raises:
            InputError: an object is missing, or is not what was written; its name is in the message.
        """
        items: dict[str, Any] = {}
        for name, held in self.sums.items():
            above, _, number = name.rpartition("/")
            data = items.get(above) if number.isdigit() else None
            if isinstance(data, h5py.Dataset):
                # The row of the dataset, where its shape is in, stands before those of its columns.
                same = not chosen(name) or held == _sum_of(data[:, int(number)])
            else:
                items[name] = item = self.group.get(name)
                if item is None:
                    raise self._damage_error(name, "is missing")
                same = not chosen(name) or held == _sum(item, whole=f"{name}/0" not in self.sums)
            if not same:
                raise self._damage_error(name, "is not what was written, as its checksum says")

    def verify_column(self, name: str, column: int, values: Values) -> None:
        """Compare ``values`` that were read as a column of the dataset ``name``.

        Raises:
            InputError: they are not what was written.
        """
        name = f"{name}/{column}"
        if self.sums.get(name) not in (None, _sum_of(values)):
            raise self._damage_error(name, "is not what was written, as its checksum says")

    def _damage_error(self, name: str, what: str) -> InputError:
        at = f"{self.group.name.rstrip('/')}/"
        return InputError(
            f"{self.path}: {at}{name} {what}; if the file was changed on purpose, remove the group {at}{GROUP} (or "
            "call morembs.storage.checksums.seal), else it is damaged: write it again",
            kind="file",
            keyword=Path(self.path).name,
        )


def _by_columns(item: Any) -> bool:
    """True if each column lies in one piece, as it is read alone."""
    return isinstance(item, h5py.Dataset) and item.ndim == 2 and item.chunks is not None and item.chunks[1] == 1


def _sum(item: Any, *, whole: bool | None = None) -> str:
    """Of an object; values of a dataset that is summed by columns are left out (``whole`` False)."""
    total = hashlib.sha256()
    total.update(_kind(item) if isinstance(item, h5py.Dataset) else b"group\n")
    for name in sorted(item.attrs):
        value = np.asarray(item.attrs[name])
        total.update(name.encode() + b" " + _kind(value) + _bytes(value))
    if isinstance(item, h5py.Dataset) and (not _by_columns(item) if whole is None else whole):
        for block in _blocks(item):
            total.update(_bytes(block))
    return total.hexdigest()


def _sum_of(values: Values) -> str:
    return hashlib.sha256(_kind(values) + _bytes(values)).hexdigest()


def _kind(values: Any) -> bytes:
    """Type and shape in a line: ``f8 (3, 2)``; text of any length is ``O8``."""
    return f"{values.dtype.kind}{values.dtype.itemsize} {values.shape}\n".encode()


def _bytes(values: Values) -> bytes:
    """Numbers with their lowest byte first, row by row; texts of any length with a zero behind each."""
    if values.dtype.kind in "OU":
        lines = [line if isinstance(line, bytes) else str(line).encode() for line in np.ravel(values).tolist()]
        return b"".join(line + b"\0" for line in lines)
    return values.astype(values.dtype.newbyteorder("<"), copy=False).tobytes()


def _blocks(item: Any) -> Iterator[Values]:
    """All values of a dataset, row by row."""
    if not item.shape or item.size * item.dtype.itemsize <= TOL.block_bytes:
        if item.shape is not None:
            yield np.asarray(item[()])
        return
    step = max(1, TOL.block_bytes * len(item) // (item.size * item.dtype.itemsize))
    for start in range(0, len(item), step):
        yield np.asarray(item[start : start + step])
