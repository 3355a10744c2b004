"""The job file: a TOML contract, checked key by key before anything is computed."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from morembs.app.jobs.schema import JobTables, ReduceTable
from morembs.base.errors import InputError, nearest
from morembs.base.options import Text, checked, in_toml, pairs, readings
from morembs.base.units import Units, parse_units
from morembs.reducers import REDUCERS
from morembs.reducers.base import Reducer
from morembs.storage.attempts import attempt_at

# Where a key is: names of tables and keys, and numbers of tables in [[...]].
Loc = tuple[int | str, ...]
MOST_BYTES = 2.0**60
BYTES = {"": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12}
BYTES |= {"b": 1, "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40}


@dataclass(frozen=True, kw_only=True, eq=False)
class Job:
    """A checked job: its tables, its text, and the reducers by name. Paths are relative to its folder.

    ``changes`` are the keys that were given another value, KEY=VALUE; the text is that of the file. ``attempt`` is the
    token of an attempt at the results, which then lie beside the files that they are for.
    """

    path: Path
    text: str
    tables: JobTables
    reducers: Mapping[str, Reducer]
    memory: int | None = None
    changes: tuple[str, ...] = ()
    attempt: str = ""

    def resolve(self, path: str) -> Path:
        """A path of the job file, seen from the working directory.

        Raises:
            InputError: no file can have this path.
        """
        try:
            whole = self.path.parent / Path(path).expanduser()
            whole.exists()
        except (RuntimeError, ValueError, OSError) as error:
            raise InputError(f"the path {path[:100]!r} cannot be used ({error}); give another") from error
        return whole

    def result(self, path: str) -> Path:
        """The place of a file that the job writes, which the attempt writes beside it."""
        whole = self.resolve(path)
        return attempt_at(whole, self.attempt) if self.attempt else whole

    @property
    def units(self) -> Units:
        """The declared units."""
        given = self.tables.model.units
        return parse_units(given if isinstance(given, str) else given.model_dump())

    @property
    def output(self) -> Path:
        """The body file."""
        return self.result(self.tables.output.path)

    @property
    def picture(self) -> Path | None:
        """The picture, if one is wanted."""
        return None if self.tables.output.picture is None else self.result(self.tables.output.picture)


def load_job(path: str | Path, changes: Sequence[str] = ()) -> Job:
    """Job of a TOML file.

    Args:
        changes: keys with other values than in the file, each ``"TABLE.KEY=VALUE"``; of several tables
            ``"TABLE.NAME.KEY=VALUE"`` means one, and without a name all are meant.

    Raises:
        InputError: the file is missing, is not TOML, or has unknown, missing or wrong keys; one line for
            each fault.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"job file {str(path)!r} cannot be read ({reason}); check the path") from error
    except UnicodeDecodeError as error:
        raise InputError(f"job file {str(path)!r} is not UTF-8 text; expected a TOML file") from error
    except (ValueError, RecursionError) as error:
        # TOMLDecodeError among them; numbers of thousands of digits and endless nesting are others.
        raise InputError(f"job file {str(path)!r} is not valid TOML: {error}; mend that line") from error
    for key, value in pairs(changes).items():
        _change(data, key, value)
    wrong = next((word for word in _words_in(data) if "\0" in word), None)
    if wrong is not None:
        raise InputError(f"{wrong[:100]!r} in {str(path)!r} has a NUL character, as no name has; give another text")
    try:
        tables = JobTables.model_validate(data)
    except ValidationError as error:
        raise InputError("\n".join(_faults(error, data))) from error
    memory = None if tables.solver.memory is None else parse_memory(tables.solver.memory)
    return Job(
        path=path, text=text, tables=tables, reducers=_reducers(tables.reduce), memory=memory, changes=tuple(changes)
    )


def _words_in(value: Any) -> Iterator[str]:
    """All texts of tables within tables."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _words_in(inner)


def _change(data: dict[str, Any], key: str, text: Text) -> None:
    """Give ``key``, TABLE.KEY or TABLE.NAME.KEY, another value in the tables of a job."""
    *names, last = key.split(".")
    tables: list[Any] = [data]
    for depth, name in enumerate(names):
        called = [table for table in tables if depth and name in (table.get("name"), table.get("method"))]
        inner = [] if called else [table.setdefault(name, {}) for table in tables]
        tables = called or [table for held in inner for table in (held if isinstance(held, list) else [held])]
        if not all(isinstance(table, dict) for table in tables):
            raise InputError(f"--set {key}={text} was given; {name!r} is a value and holds no key {last!r}")
    if not all((names, *names, last)):
        raise InputError(f"--set {key}={text} was given; expected TABLE.KEY=VALUE, such as reduce.modes=40")
    for table in tables:
        table[last] = readings(text)[0]


def parse_memory(text: str, table: str = "[solver]") -> int:
    """Bytes of a text such as ``"4 GiB"`` or ``"500 MB"``.

    Raises:
        InputError: not a positive number with a unit of memory.
    """
    match = re.fullmatch(r"\s*([0-9]+(?:\.[0-9]*)?)\s*([a-z]*)\s*", text.lower())
    size = float(match[1]) * BYTES[match[2]] if match and match[2] in BYTES else 0.0
    if match and not match[2]:
        raise InputError(f'{table}: memory = {text!r} has no unit; expected a text such as "4 GiB" or "500 MB"')
    if not 1 <= size < MOST_BYTES:
        raise InputError(f'{table}: memory = {text!r} was given; expected a text such as "4 GiB" or "500 MB"')
    return int(size)


def _reducers(tables: list[ReduceTable]) -> dict[str, Reducer]:
    """Name -> reducer with its options."""
    names = [table.name or table.method for table in tables]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise InputError(f"two [[reduce]] tables are named {repeated[0]!r}; give each its own name = ...")
    return {name: _reducer(name, table) for name, table in zip(names, tables, strict=True)}


def _reducer(name: str, table: ReduceTable) -> Reducer:
    where = f"[[reduce]] {name!r}: "
    if table.method not in REDUCERS:
        raise InputError(f"{where}method = {table.method!r} was given; {REDUCERS.advice(table.method)}")
    kind = REDUCERS[table.method]
    options = checked(
        kind, table.options(), f"method {table.method!r}", where=where, word="key", besides=("name", "method")
    )
    try:
        return kind(**options)
    except InputError as error:
        raise InputError(f"{where}{error}") from error


def _faults(error: ValidationError, data: Mapping[str, Any]) -> list[str]:
    """One line for each faulty key; the branches of a union count as one fault."""
    lines: dict[Loc, str] = {}
    meant: list[str] = []
    for fault in error.errors():
        loc, kind = fault["loc"], fault["type"]
        if kind == "extra_forbidden":
            _, _, table = _walk(loc[:-1])
            advice = nearest(str(loc[-1]), table.model_fields)
            lines[loc] = f"{_words(loc[:-1])}unknown key {str(loc[-1])!r}; {advice}"
            meant.append(f"{_words(loc[:-1])}{advice}")
            continue
        holder, at, _ = _walk(loc)
        if kind == "value_error":
            lines[at] = _words(at) + fault["msg"].removeprefix("Value error, ")
            continue
        expected = holder.model_fields[str(at[-1])].description
        if kind == "missing":
            lines[at] = f"{_words(at[:-1])}{at[-1]} is missing; expected {expected}"
        else:
            given = in_toml(_value(data, at))
            lines[at] = f"{_words(at[:-1])}{at[-1]} = {given} was given; expected {expected}"
    return [line for at, line in lines.items() if not _is_echo(at, line, lines, meant)]


def _is_echo(at: Loc, line: str, lines: Mapping[Loc, str], meant: list[str]) -> bool:
    """Whether another line says it better: one further inside, or an unknown key that was meant for this."""
    if any(at == other[: len(at)] for other in lines if other != at):
        return True
    return bool(at) and " is missing; " in line and f"{_words(at[:-1])}did you mean {at[-1]!r}?" in meant


def _value(data: Any, at: Loc) -> object:
    for step in at:
        data = data[step]
    return data


def _walk(loc: Loc) -> tuple[type[BaseModel], Loc, type[BaseModel]]:
    """(table that holds the last key of ``loc``, location of that key, table that ``loc`` leads to).

    Steps that are no keys, such as the names of branches of a union, are passed over.
    """
    holder: type[BaseModel] = JobTables
    table: type[BaseModel] = JobTables
    depth = 0
    for at, step in enumerate(loc):
        if isinstance(step, int) and at == depth and at == 1:
            depth = at + 1  # the number of a table in [[...]]
        elif isinstance(step, str) and step in table.model_fields:
            holder, depth = table, at + 1
            table = inner_table(table.model_fields[step].annotation) or table
    return holder, loc[:depth], table


def inner_table(annotation: object) -> type[BaseModel] | None:
    """The table inside an annotation such as ``list[Table] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((inner for part in get_args(annotation) if (inner := inner_table(part))), None)


def _words(loc: Loc) -> str:
    """``[[material]] 2: `` of ("material", 1)."""
    if not loc:
        return ""
    head = f"[[{loc[0]}]] {int(loc[1]) + 1}" if len(loc) > 1 and isinstance(loc[1], int) else f"[{loc[0]}]"
    inner = [str(step) for step in loc[1:] if isinstance(step, str) and step.isidentifier() and step[0].islower()]
    return ", ".join([head, *inner]) + ": "


def _description(model: type[BaseModel], key: str) -> str:
    return model.model_fields[key].description or "another value"
