"""The job file: a TOML contract, checked key by key before anything is computed."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morembs.app.jobs.schema import JobTables, ReduceTable
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.key_tables import read_table
from morembs.base.options import Text, pairs, read_options, readings
from morembs.base.units import Units, parse_units
from morembs.reducers import REDUCERS
from morembs.reducers.base import Reducer
from morembs.storage.attempts import attempt_at

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
        return parse_units(given if isinstance(given, str) else given.values())

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
    tables = read_table(JobTables, data)
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
    if not 1 <= size < TOL.max_memory_bytes:
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
    options = read_options(
        kind, table.options(), f"method {table.method!r}", where=where, word="key", besides=("name", "method")
    )
    try:
        return kind(**options)
    except InputError as error:
        raise InputError(f"{where}{error}") from error
