"""HDF5 files of morembs: written whole or not at all, sealed with checksums, every dataset with its description."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.storage.checksums import seal
from morembs.storage.kinds import KINDS
from morembs.storage.safefile import SafeFile, replacing
from morembs.storage.storable import plain, storable
from morembs.storage.table import Table
from morembs.storage.tolerances import TOL
from morembs.version import VERSION


@contextmanager
def writing(path: Path, *, excluded: Sequence[str] = (), sealed: bool = True) -> Iterator[Writer]:
    """An HDF5 file that takes the place of ``path`` when the ``with`` ends well; else ``path`` stays as it was.

    Args:
        excluded: groups with checksums of their own.
        sealed: whether there are any.

    Raises:
        OutputError: the file cannot be written, whatever the library made of that.
    """
    # The oldest layout: every reader knows it, and its groups carry no time stamps. Without a chunk cache parts of
    # chunks are read without the rest.
    with replacing(path) as safe, h5py.File(safe, "w", libver=("earliest", "v108"), rdcc_nbytes=0) as file:
        yield Writer(file, safe)
        if sealed:
            safe.doing = "the checksums"
            for name in excluded:
                seal(file[name])
            seal(file, excluded=excluded)
        safe.check()


@dataclass(frozen=True)
class Columns:
    """A matrix of this ``shape`` that comes in ``blocks`` of columns, so that it is never in memory as a whole."""

    shape: tuple[int, ...]
    dtype: Any
    blocks: Iterable[NDArray[Any]]


@dataclass(frozen=True)
class Writer:
    """Stores datasets in an open HDF5 group; ``safe`` hears their names, and reports a failed write after each."""

    file: Any
    safe: SafeFile | None = None

    def name_step(self, what: str) -> None:
        """Name what is written next, for the message should that fail."""
        if self.safe is not None:
            self.safe.doing = what

    def check(self) -> None:
        """Raise what went wrong, if anything did."""
        if self.safe is not None:
            self.safe.check()

    def put(self, name: str, data: Any, about: str = "", units: str = "") -> None:
        """Store one dataset with its description and units."""
        self.name_step(name)
        self._mark(self.file.create_dataset(name, data=data), about, units)

    def columns(self, name: str, value: NDArray[Any] | Columns, about: str = "", units: str = "") -> None:
        """Store a matrix, each column in one piece."""
        self.name_step(name)
        matrix = value if isinstance(value, Columns) else Columns(value.shape, value.dtype, (value,))
        chunks = (min(matrix.shape[0], TOL.chunk_rows), 1) if min(matrix.shape) else None
        data, column = self.file.create_dataset(name, matrix.shape, matrix.dtype, chunks=chunks), 0
        self._mark(data, about, units)
        for block in matrix.blocks:
            for number in range(block.shape[1]):
                data[:, column + number] = block[:, number]
                self.check()
            column += block.shape[1]
            del block  # before the next is made

    def _mark(self, item: Any, about: str, units: str) -> None:
        """Attributes for people; no number is kept in them."""
        for key, words in (("description", about), ("units", units)):
            if words:
                item.attrs[key] = np.bytes_(words)
        self.check()

    def rows(self, at: str, table: Table, whole: object, **given: Any) -> None:
        """Store ``whole`` by its ``table`` in the group ``at``, a path with a slash behind it; ``given`` values
        stand for those of its fields."""
        source = table.parts(whole)
        for row in table:
            value = given[row.key] if row.key in given else row.of(source)
            if value is None and row.optional:
                continue
            if row.inline and isinstance(row.kind, Table):
                self.rows(at, row.kind, value)
                continue
            for name, part in row.parts(value):
                if isinstance(row.kind, Table):
                    self.rows(f"{at}{name}/", row.kind, part)
                elif row.columns:
                    self.columns(at + name, part, row.about, row.units)
                else:
                    self.put(at + name, KINDS[row.kind].encode(part), row.about, row.units)
        for name, words in table.attributes.items():
            self.file[at or "/"].attrs[name] = np.bytes_(words)

    def provenance(self, given: Mapping[str, object]) -> None:
        """Store where the file comes from, with the time and the version."""
        stamp = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "morembs_version": VERSION}
        self.tree("provenance", {**stamp, **given})

    def tree(self, name: str, value: object) -> None:
        """Store nested mappings as groups; None is left out, rows of equal keys become columns."""
        value = plain(value)
        if isinstance(value, list | tuple) and value:
            rows = [plain(row) for row in value]
            if all(isinstance(row, Mapping) and row.keys() == rows[0].keys() for row in rows):
                value = {key: [row[key] for row in rows] for key in rows[0]}
        if isinstance(value, Mapping):
            self.file.require_group(name)
            for key, inner in value.items():
                self.tree(f"{name}/{str(key).replace('/', '_').strip('.') or '_'}", inner)
        elif value is not None:
            self.put(name, storable(value))
