"""Tables of datasets in a group: what its writer stores, its reader takes, its check expects and its page tells.

A dataset is declared once, at the field of a dataclass (``dataset``) or at a property that follows from fields
(``derived``); ``table_of`` gives the table of the class. ``Writer.rows`` writes by a table, ``read_rows`` reads by it,
``TableCheck`` compares a file with it, and ``scripts/schema.py`` writes the tables of the documentation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, MISSING, dataclass, field, fields, replace
from functools import cached_property, partial
from itertools import count, takewhile
from typing import Any, Generic, TypeVar

import h5py
import numpy as np

from morembs.base.errors import InputError
from morembs.storage.kinds import KINDS, refuse_not_finite

T = TypeVar("T")


@dataclass(frozen=True)
class Row:
    """A dataset below some group, or a group with a table of its own.

    Args:
        name: path below the group; ``NAME/*`` are all in the group NAME, values of a mapping, and ``NAME_#`` are
            NAME_0, NAME_1, ..., values of a sequence.
        kind: one of ``KINDS``, or a table.
        shape: sizes apart by blanks. A letter is a size that the first dataset with it gives and all others share,
            with a number before it that many times it; ``any`` is any size.
        about: the attribute ``description``; ``units`` the attribute of that name.
        doc: what the documentation says instead of ``about``.
        since: version that wrote it first: files of earlier ones lack it.
        when: may be absent: in the words of the documentation, when.
        largest: whole numbers from 0 to this: a number or a size, ``6`` or ``n``, or places on it, ``n-1``.
        known: texts, or names of a group's members, that are expected: these, or the ones that gave a size.
        positive: a number above zero.
        counts: the whole number is itself a size, this letter.
        field: where the value is found, and is put when it was read; by default the last part of ``name``.
        write: gives the value of the object that has the fields; by default that of ``field``.
        read: whether a reader takes it; what follows from other datasets is there for other programs.
        later: whether a reader takes it from the file at each use only.
        columns: each column lies in one piece, in single or double precision.
        inline: the rows of its table stand in the same group as itself.
        beside: of several objects in a sequence (``repeat_table``): one dataset for all of them.
    """

    name: str
    kind: str | Table
    shape: str = ""
    about: str = ""
    units: str = ""
    _: KW_ONLY
    # Rows come in the order in which they were declared.
    order: int = field(default_factory=count().__next__, compare=False)
    doc: str = ""
    since: str = ""
    when: str = ""
    largest: str = ""
    known: str | Sequence[str] = ()
    positive: bool = False
    counts: str = ""
    field: str = ""
    write: Callable[[Any], Any] | None = None
    read: bool = True
    later: bool = False
    columns: bool = False
    inline: bool = False
    beside: bool = False

    @property
    def optional(self) -> bool:
        """True if files without it are read."""
        return bool(self.when or self.since)

    @property
    def many(self) -> bool:
        """True if the row stands for several."""
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

    def within(self, group: Any) -> bool:
        """True if any row of an ``inline`` table is in an open ``group``."""
        return isinstance(self.kind, Table) and any(row.place in group for row in self.kind)

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
        """What an open dataset or group holds.

        Raises:
            InputError: numbers that are not finite, of a row whose numbers were not looked at before.
        """
        if isinstance(self.kind, Table):
            return read_rows(item, self.kind)
        kind = KINDS[self.kind]
        value = kind.decode(_columns(item) if self.columns else kind.read(item))
        if self.kind == "later":
            refuse_not_finite(item.file.filename, item.name.lstrip("/"), np.asarray(value))
        return value


@dataclass(frozen=True)
class Table:
    """The rows of a group. What is stored there is ``build`` of the fields that were read, and ``parts`` of it are an
    object or a mapping with the fields that are written; ``attributes`` are texts of the group."""

    rows: tuple[Row, ...]
    build: Callable[..., Any] = dict
    parts: Callable[[Any], Any] = lambda value: value
    attributes: Mapping[str, str] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def flat(self, whole: Any) -> dict[str, Any]:
        """Values of an object by the paths of its datasets, ``None`` for missing ones."""
        source = self.parts(whole)
        return {name: value for row in self for name, value in row.parts(row.of(source))}


def dataset(
    kind: str | Table, *row: str, name: str = "", default: Any = MISSING, default_factory: Any = MISSING, **more: Any
) -> Any:
    """A field of a dataclass that is a dataset of a file: the arguments are those of ``Row``, whose name is by default
    that of the field, and those of ``dataclasses.field``."""
    made: Any = {"default": default} if default_factory is MISSING else {"default_factory": default_factory}
    return field(**made, metadata={"row": Row(name, kind, *row, **more)})


class Derived(cached_property[T]):
    """A property that is a dataset of a file."""

    row: Row


def derived(
    kind: str | Table, *row: str, name: str = "", read: bool = False, **more: Any
) -> Callable[[Callable[[Any], T]], Derived[T]]:
    """Decorates a method without arguments: a property that is kept, and a dataset that follows from the fields.

    Readers leave it to other programs unless it is ``read``; the other arguments are those of ``Row``.
    """

    def decorate(function: Callable[[Any], T]) -> Derived[T]:
        made = Derived(function)
        made.row = Row(name or function.__name__, kind, *row, field=function.__name__, read=read, **more)
        return made

    return decorate


def table_of(kind: Any, **made: Any) -> Table:
    """The table of a dataclass: its fields and properties that are datasets. ``made`` are fields of ``Table``."""
    rows = [
        replace(row, name=row.name or each.name, field=each.name)
        for each in fields(kind)
        if (row := each.metadata.get("row")) is not None
    ]
    rows += [each.row for base in kind.__mro__ for each in vars(base).values() if isinstance(each, Derived)]
    return Table(tuple(sorted(rows, key=lambda row: row.order)), **({"build": kind} | made))


def repeat_table(own: Table, name: str = "") -> Table:
    """Several objects, each of the table ``own``: one dataset for all of them of each row ``beside``, the other rows in
    groups NAME_0, NAME_1, ...; without a ``name`` all rows are beside."""
    beside = [row for row in own if row.beside or not name]
    inner = Table(tuple(row for row in own if row not in beside), parts=own.parts)

    def parts(several: Sequence[Any]) -> dict[str, Any]:
        columns = {row.key: [row.of(own.parts(each)) for each in several] for row in beside}
        return columns | {name: several}

    def build(**columns: Any) -> tuple[Any, ...]:
        groups = columns.pop(name) if name else ()
        rows = zip(*(_entries(column) for column in columns.values()), strict=True)
        given = [dict(zip(columns, row, strict=True)) for row in rows] if columns else [{} for _ in groups]
        if name:
            given = [one | group for one, group in zip(given, groups, strict=True)]
        return tuple(own.build(**values) for values in given)

    return Table((*beside, *([Row(f"{name}_#", inner, field=name)] if name else [])), build, parts)


def variants(kinds: Mapping[str, type], about: Row, *more: Row) -> Table:
    """Objects of several dataclasses, distinguished by their names in the dataset ``about``; datasets of one name mean
    the same in all. Of ``more`` rows a mapping that is written has the values."""
    tables = {name: table_of(kind) for name, kind in kinds.items()}
    rows = {row.name: replace(row, field=row.name, write=None) for table in tables.values() for row in table}
    for name, row in rows.items():
        owners = [kind for kind, table in tables.items() if name in [own.name for own in table]]
        if len(owners) < len(tables):
            rows[name] = replace(row, when=row.when or f"of `{'`, `'.join(owners)}`")

    def parts(whole: Any) -> Mapping[str, Any]:
        if isinstance(whole, Mapping):
            return whole
        name = next(name for name, kind in kinds.items() if isinstance(whole, kind))
        return dict.fromkeys(rows) | {row.name: row.of(whole) for row in tables[name]} | {about.key: name}

    def build(**values: Any) -> Any:
        name = values.pop(about.key)
        if name not in kinds:
            raise InputError(
                f"the {about.key} {name!r} was given; expected {' or '.join(kinds)}", kind="unknown", keyword=about.key
            )
        return kinds[name](**{row.key: values[row.name] for row in tables[name] if row.name in values})

    return Table((about, *rows.values(), *more), build, parts)


def _entries(column: Any) -> Any:
    return column.tolist() if isinstance(column, np.ndarray) and column.ndim == 1 else column


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
            raise InputError(self.why_not, kind="missing")
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
        item = None if row.many or row.inline else group.get(row.place)
        if row.many:
            several = {name: row.value(inner) for name, inner in row.items(group).items()}
            if row.read:
                values[row.key] = several if row.name.endswith("*") else tuple(several.values())
        elif row.inline:
            if not row.optional or row.within(group):
                values[row.key] = row.value(group)
        elif isinstance(item, h5py.Group if isinstance(row.kind, Table) else h5py.Dataset):
            if row.later and later is not None:
                values[row.key] = later(row)
            elif row.read and not row.later:
                values[row.key] = row.value(item)
        elif not row.optional:
            missing.append(row.place)
    if missing:
        raise InputError(f"{lacking} {', '.join(missing)}; write the file again", kind="file", keyword=missing[0])
    return table.build(**values)


def _columns(data: Any) -> Any:
    """The whole dataset; a matrix in pieces of columns comes column by column, as it lies on the disk."""
    if data.chunks is None or data.ndim != 2:
        return data[()]
    matrix = np.empty(data.shape, data.dtype, order="F")
    for column in range(data.shape[1]):
        matrix[:, column] = data[:, column]
    return matrix
