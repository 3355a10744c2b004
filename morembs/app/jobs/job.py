"""The job file: a TOML contract, checked key by key before anything is computed."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import make_dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast

from morembs.app.jobs.solver import SolverTable
from morembs.app.jobs.stages.member_table import MemberTable
from morembs.app.jobs.stages.reduction import make_reducers
from morembs.app.jobs.stages.stage import STAGES, in_order
from morembs.app.jobs.tables import Job, JobTable, JobTables, ModesTable
from morembs.app.jobs.tolerances import TOL
from morembs.app.kinds import SYSTEM_FILE, SYSTEM_TABLE, instead
from morembs.base.errors import InputError
from morembs.base.key_tables import read_table
from morembs.base.options import Text, pairs, readings

BYTES = {"": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12}
BYTES |= {"b": 1, "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40}


def job_tables() -> type[JobTables]:
    """All tables that a job file may have: tables of its stages in their order, and tables of other commands."""
    kinds = [kind for stage in in_order(list(STAGES.values())) for kind in stage.tables]
    return _together(tuple(dict.fromkeys([*kinds, ModesTable])))


@cache
def _together(kinds: tuple[type[JobTable], ...]) -> type[JobTables]:
    def refuse_conflicts(tables: JobTables) -> None:
        for stage in STAGES.values():
            stage.refuse_conflicts(tables)

    entries = [(kind.key(), *kind.entry()) for kind in kinds]
    members = {"refuse_conflicts": refuse_conflicts, "__doc__": JobTables.__doc__, "__module__": __name__}
    made = make_dataclass("JobTables", entries, bases=(JobTables,), namespace=members, frozen=True, kw_only=True)
    return cast(type[JobTables], made)


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
    return job_of_text(read_text(path), path, changes)


def job_of_text(text: str, path: Path, changes: Sequence[str] = ()) -> Job:
    """The job that ``text`` says, as if it were in the file ``path``.

    Raises:
        InputError: as ``load_job``.
    """
    data = read_toml(text, path, changes)
    tables = read_table(job_tables(), data)
    given = SolverTable.of(tables).memory
    memory = None if given is None else parse_memory(given)
    reducers = {} if MemberTable.of(tables) is not None else make_reducers(tables)
    return Job(path=path, text=text, tables=tables, reducers=reducers, memory=memory, changes=tuple(changes))


def read_text(path: Path, words: str = "job file", kind: str = "a job") -> str:
    """The text of a TOML file that messages call by its ``words``, and expect to be of a ``kind``.

    Raises:
        InputError: it cannot be read, or is no text.
    """
    try:
        # Editors of some systems begin a text with a mark of its encoding.
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"{words} {str(path)!r} cannot be read ({reason}); {_near(path)}", kind="file") from error
    except UnicodeDecodeError as error:
        cure = instead(path, kind) or "expected a TOML file"
        raise InputError(f"{words} {str(path)!r} is not UTF-8 text; {cure}", kind="file") from error


def _key_given_twice(fault: str, text: str) -> str:
    """The message for a key that a table has twice, which the parser calls a value that is overwritten; else ""."""
    place = re.search(r"Cannot overwrite a value \(at line (\d+)", fault)
    if place is None:
        return ""
    key = text.splitlines()[int(place[1]) - 1].partition("=")[0].strip()
    return f"line {place[1]} gives the key {key!r} a second time; keep one of the two lines"


def read_toml(
    text: str, path: Path, changes: Sequence[str] = (), words: str = "job file", kind: str = "a job"
) -> dict[str, Any]:
    """The tables of a text, with other values of some keys.

    Raises:
        InputError: the text is no TOML, holds names that cannot be, is of another kind, or a change does not fit.
    """
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # TOMLDecodeError among them; numbers of thousands of digits and endless nesting are others.
        cure = "" if path.suffix == ".toml" else instead(path, kind)
        fault = _key_given_twice(str(error), text) or f"{error}; {cure or 'correct that line'}"
        raise InputError(f"{words} {str(path)!r} is not valid TOML: {fault}", kind="file", keyword=path.name) from error
    if kind != SYSTEM_FILE and SYSTEM_TABLE in data and instead(path, kind):
        raise InputError(f"{path}: {instead(path, kind)}")
    for key, value in pairs(changes).items():
        _change(data, key, value)
    wrong = next((word for word in _words_in(data) if "\0" in word), None)
    if wrong is not None:
        raise InputError(f"{wrong[:100]!r} in {str(path)!r} has a NUL character, which no name can have; remove it")
    return data


def _near(path: Path) -> str:
    """What to do about a file that cannot be read: perhaps its ending was left out."""
    endings = (".toml", ".msh")
    near = [each for each in (path.with_name(f"{path.name}{ending}") for ending in endings) if each.exists()]
    return f"did you mean {str(near[0])!r}?" if near else "check the path"


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
            raise InputError(
                f"--set {key}={text} was given; {name!r} is a value, not a table with the key {last!r}", keyword="set"
            )
    if not all((names, *names, last)):
        raise InputError(
            f"--set {key}={text} was given; expected TABLE.KEY=VALUE, such as reduce.modes=40", keyword="set"
        )
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
        raise InputError(
            f'{table}: memory = {text!r} has no unit; expected a text such as "4 GiB" or "500 MB"', keyword="memory"
        )
    if not 1 <= size < TOL.max_memory_bytes:
        raise InputError(
            f'{table}: memory = {text!r} was given; expected a text such as "4 GiB" or "500 MB"', keyword="memory"
        )
    return int(size)
