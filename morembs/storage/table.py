"""Tables of the datasets in a group: what its writer stores, its reader takes, its check expects and its page tells.

A field of a dataclass that is a ``dataset`` is declared there alone; ``table_of`` gives the table of the class.
``Writer.rows`` writes by a table, ``read_rows`` reads by it, ``TableCheck`` compares a file with it, and
``scripts/schema.py`` writes the tables of the documentation.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import KW_ONLY, MISSING, dataclass, field, fields, replace
from functools import partial
from itertools import count, takewhile
from typing import Any, Generic, TypeVar

import h5py
import numpy as np

from morembs.base.errors import InputError
from morembs.storage.storable import json_text, storable, text

T = TypeVar("T")


@dataclass(frozen=True)
class Kind:
    """What a dataset holds: its type in files, its name in messages, the kinds of NumPy's types that are read, how a
    value becomes an array, and how one that was read becomes a value."""

    stored: str
    words: str
    dtypes: str
    encode: Callable[[Any], Any]
    decode: Callable[[Any], Any]


def _floats(value: Any) -> Any:
    return np.asarray(value, dtype=np.float64)


def _integers(value: Any) -> Any:
    return np.asarray(value, dtype=np.int64)


def _value(value: Any) -> Any:
    """An array, or one number of Python."""
    return value if np.ndim(value) else value.item()


def _lines(value: Any) -> Any:
    """A text, or a tuple of them."""
    return tuple(line.decode() for line in value.tolist()) if np.ndim(value) else value.decode()


def _words(value: Any) -> Any:
    """As ``_lines``, of programs that fill up with blanks, and of files whose names are no UTF-8."""
    lines = [bytes(line).decode("utf-8", "surrogateescape").rstrip(" ") for line in np.atleast_1d(value)]
    return tuple(lines) if np.ndim(value) else lines[0]


def _text(value: Any) -> Any:
    return text(*value) if isinstance(value, list | tuple) else storable(value)


def _sentences(value: Any) -> tuple[str, ...]:
    sentences = value.decode().strip()
    return (sentences,) if sentences else ()


KINDS = {
    # Finite numbers; any, also infinite ones and NaN; those that are looked at when they are read.
    "real": Kind("f8", "real numbers", "iuf", _floats, lambda value: _value(_floats(value))),
    "any": Kind("f8", "real numbers", "iuf", _floats, _value),
    "later": Kind("f8", "real numbers", "f", _floats, _value),
    "whole": Kind("i8", "integers", "iu", _integers, lambda value: _value(_integers(value))),
    # A few of them, as a tuple; those that keep their width.
    "few": Kind("i8", "integers", "iu", _integers, lambda value: tuple(value.tolist())),
    "index": Kind("i4 or i8", "integers", "iu", np.asarray, _value),
    "code": Kind("u1", "integers", "iu", lambda value: np.asarray(value, dtype=np.uint8), _value),
    "flag": Kind("u1", "integers", "iu", lambda value: value.astype(np.uint8), lambda value: value.astype(bool)),
    "text": Kind("text", "text", "SO", _text, _lines),
    "words": Kind("text", "text", "SO", _text, _words),
    "json": Kind("text", "text", "SO", lambda value: storable(json_text(value)), json.loads),
    # Sentences in one line of text.
    "notes": Kind("text", "text", "SO", lambda value: storable("; ".join(value) or " "), _sentences),
}


@dataclass(frozen=True)
class Row:
    """A dataset below some group, or a group with a table of its own.

    Args:
        name: path below the group; ``NAME/*`` are all in the group NAME, values of a mapping, and ``NAME_#`` are
            NAME_0, NAME_1, ..., values of a sequence.
        kind: one of ``KINDS``, or a table.
        shape: sizes apart by blanks. A letter is a size that the first dataset with it gives and all others share,
            with a number before it that many times it; ``any`` is any size.
        about: what it is, the attribute ``description``; ``units`` the attribute of that name.
        doc: what the documentation says instead of ``about``.
        when: may be absent: in the words of the documentation, when.
        field: where the value is found, and is put when it was read; by default the last part of ``name``.
        write: gives the value of the object that has the fields; by default that of ``field``.
        read: whether a reader takes it; what follows from other datasets is there for other programs.
        later: whether a reader takes it from the file at each use only.
        columns: each column lies in one piece, in single or double precision.
    """

    name: str
    kind: str | Table
    shape: str = ""
    about: str = ""
    units: str = ""
    _: KW_ONLY
    doc: str = ""
    when: str = ""
    field: str = ""
    write: Callable[[Any], Any] | None = None
    read: bool = True
    later: bool = False
    columns: bool = False

    @property
    def many(self) -> bool:
        """Whether the row stands for several."""
        return self.name.endswith(("/*", "_#"))

    @property
    def place(self) -> str:
        """Path of the dataset or group, of several what their paths have in common."""
        return self.name.removesuffix("*").removesuffix("#")

    @property
    def key(self) -> str:
        """Name of the field."""
        return self.field or self.name.removesuffix("/*").rpartition("/")[2]

    def of(self, whole: Any) -> Any:
        """The value that is written of an object, or of a mapping, with the fields."""
        if self.write is not None:
            return self.write(whole)
        value = whole[self.key] if isinstance(whole, Mapping) else getattr(whole, self.key)
        return (value() if value else None) if isinstance(value, Later) else value

    def items(self, group: Any) -> dict[str, Any]:
        """Those in an open ``group``, of several, by what follows ``place`` in their paths."""
        if self.name.endswith("#"):
            numbers = takewhile(lambda number: f"{self.place}{number}" in group, count())
            return {str(number): group[f"{self.place}{number}"] for number in numbers}
        return dict(group[self.place].items()) if self.place in group else {}

    def parts(self, value: Any) -> Iterator[tuple[str, Any]]:
        """What a value stands for: paths, and the value of each."""
        if self.name.endswith("*"):
            value = value.items()
        elif self.many:
            value = enumerate(value)
        yield from ((f"{self.place}{name}", part) for name, part in value) if self.many else [(self.place, value)]

    def value(self, item: Any) -> Any:
        """What an open dataset or group holds."""
        if isinstance(self.kind, Table):
            return read_rows(item, self.kind)
        return KINDS[self.kind].decode(_columns(item) if self.columns else item[()])


@dataclass(frozen=True)
class Table:
    """The rows of a group. What is stored there is ``build`` of the fields that were read, and ``parts`` of it are an
    object or a mapping with the fields that are written."""

    rows: tuple[Row, ...]
    build: Callable[..., Any] = dict
    parts: Callable[[Any], object] = lambda value: value

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)


def dataset(
    kind: str | Table, *row: str, name: str = "", default: Any = MISSING, default_factory: Any = MISSING, **more: Any
) -> Any:
    """A field of a dataclass that is a dataset of a file: the arguments are those of ``Row``, whose name is by default
    that of the field, and those of ``dataclasses.field``."""
    made: Any = {"default": default} if default_factory is MISSING else {"default_factory": default_factory}
    return field(**made, metadata={"row": Row(name, kind, *row, **more)})


def table_of(kind: Any, **made: Callable[..., Any]) -> Table:
    """The table of a dataclass: its fields that are datasets. ``made`` are ``build`` and ``parts`` of the table."""
    rows = [
        replace(row, name=row.name or each.name, field=each.name)
        for each in fields(kind)
        if (row := each.metadata.get("row")) is not None
    ]
    return Table(tuple(rows), **({"build": kind} | made))


@dataclass(frozen=True)
class Later(Generic[T]):
    """A value that is read at each call; false where there is none, and then a call says ``why_not``.

    Raises:
        InputError: there is none, or the file is gone or damaged.
    """

    read: Callable[[], T] | None = None
    why_not: str = ""

    @classmethod
    def of(cls, value: T) -> Later[T]:
        """One that is in memory."""
        return cls(partial(_same, value))

    def __bool__(self) -> bool:
        return self.read is not None

    def __call__(self) -> T:
        if self.read is None:
            raise InputError(self.why_not)
        return self.read()


def _same(value: T) -> T:
    return value


def read_rows(
    group: Any, table: Table, lacking: str = "the group lacks", later: Callable[[Row], Any] | None = None
) -> Any:
    """What an open HDF5 ``group`` holds; fields that may be absent, and are, are left out. ``later`` makes what stands
    for a row that is read at its use.

    Raises:
        InputError: others are absent; ``lacking`` says before their names whose they are.
    """
    values, missing = dict[str, Any](), []
    for row in table:
        item = None if row.many else group.get(row.place)
        if row.many:
            several = {name: row.value(inner) for name, inner in row.items(group).items()}
            values[row.key] = several if row.name.endswith("*") else tuple(several.values())
        elif isinstance(item, h5py.Group if isinstance(row.kind, Table) else h5py.Dataset):
            if row.later and later is not None:
                values[row.key] = later(row)
            elif row.read and not row.later:
                values[row.key] = row.value(item)
        elif not row.when:
            missing.append(row.place)
    if missing:
        raise InputError(f"{lacking} {', '.join(missing)}; write the file again")
    return table.build(**values)


def _columns(data: Any) -> Any:
    """The whole dataset; a matrix in pieces of columns comes column by column, as it lies on the disk."""
    if data.chunks is None or data.ndim != 2:
        return data[()]
    matrix = np.empty(data.shape, data.dtype, order="F")
    for column in range(data.shape[1]):
        matrix[:, column] = data[:, column]
    return matrix
