"""Writes the tables of docs from those that writers, readers and checks of files and jobs go by, from the reducers and
from the tolerances of the rooms; and the version where pages, recipe and citation name it.

A table stands between the lines <!-- table: NAME --> and <!-- end -->; what is around it is written by hand. With
--check nothing is written, and the exit code is 1 where a page is stale.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from itertools import groupby
from pathlib import Path

from morembs.app.cli.tolerance_table import tolerances
from morembs.app.jobs.job import job_tables
from morembs.app.simulations.contact_tables import SurfaceTable
from morembs.app.simulations.laws import LawTable, MotionTable
from morembs.app.simulations.result_file import RECORDING
from morembs.app.simulations.sliding_tables import SwitchingTable
from morembs.app.simulations.tables import SystemTables
from morembs.base.arguments import hints_of
from morembs.base.key_tables import Table as KeyTable
from morembs.base.key_tables import describe_expected, holds_several, inner_table
from morembs.base.limits import choices
from morembs.base.options import in_toml
from morembs.body.body import BODY
from morembs.body.floating.parametric import FrameTerms
from morembs.body.floating.stiffening import STIFFENING
from morembs.body.parametric_parts import ParametricParts
from morembs.body.recovery_shapes import RECOVERY
from morembs.body.stored import FILE, INTERFACE
from morembs.certificate.record import CERTIFICATE
from morembs.dynamics.gmp.stored import MEMBER
from morembs.importers.native import MODEL
from morembs.importers.options import ImportOptions
from morembs.parametric.bound import ParametricBound
from morembs.parametric.proof import BoxCells
from morembs.reducers import REDUCERS, Reducer
from morembs.responses.static_mode_tables import StaticModeTables
from morembs.storage.kinds import KINDS
from morembs.storage.table import Row, Table, table_of
from morembs.version import VERSION

ROOT = Path(__file__).resolve().parents[1]
# Name of a table on a page -> paths of its groups as they are shown, and their tables.
SHOWN = {
    "body file": [("/", FILE), ("/interfaces/NAME/", INTERFACE), ("/bodies/NAME/", BODY)],
    "certificate": [("", CERTIFICATE)],
    "stiffening": [("", STIFFENING)],
    "recovery": [("", RECOVERY)],
    "switching": [("", table_of(StaticModeTables))],
    "parametric": [
        ("", table_of(ParametricParts)),
        ("frame/", table_of(FrameTerms)),
        ("bound/", table_of(ParametricBound)),
        ("bound/cells/", table_of(BoxCells)),
    ],
    "member": [("", MEMBER)],
    "model file": [("", MODEL)],
    "simulation": [("/", RECORDING)],
}
# Files beside docs that name the version, and the words in front of it there.
NAMED = ("README.md", "CITATION.cff", "conda/recipe/recipe.yaml")
VERSIONS = re.compile(r'^(version: |  version: "|.*?\bmorembs-)\d+\.\d+\.\d+(?=-py3-none-any|"|$)', re.MULTILINE)
# Tables within tables of system files that have many keys.
UNFOLDED = (LawTable, MotionTable, SwitchingTable, SurfaceTable)


def lines(at: str, table: Table) -> Iterator[str]:
    """Rows of a table in Markdown; a group with a sentence of its own has its table elsewhere."""
    for row in table:
        if row.inline and isinstance(row.kind, Table):
            yield from lines(at, row.kind)
            continue
        path = at + row.name.replace("*", "NAME").replace("#", "i")
        if not isinstance(row.kind, Table):
            yield f"| `{path}` | {shape(row)} | {stored(row)} | {units(row)} | {meaning(row)} |"
        elif row.doc:
            yield f"| `{path}/...` | | | | {row.doc} |"
        else:
            yield from lines(f"{path}/", row.kind)


def shape(row: Row) -> str:
    """(3 N, n) of ``3N n``."""
    return f"({', '.join(re.sub(r'(?<=[0-9])(?=[A-Za-z])', ' ', size) for size in row.shape.split())})"


def stored(row: Row) -> str:
    """Type in the file."""
    return "f4 or f8" if row.columns and row.name != "basis" else KINDS[str(row.kind)].stored


def units(row: Row) -> str:
    """With raised exponents."""
    return row.units.translate({ord("2"): "²", ord("3"): "³"})


def meaning(row: Row) -> str:
    """What it is, and when it is there."""
    since = f"since {row.since}" if row.since else ""
    return "; ".join(words for words in (row.doc or row.about, row.when, since) if words)


def keys() -> Iterator[str]:
    """Rows in Markdown of the keys of all reducers, whose docstrings say what they mean."""
    for method in REDUCERS.own:
        reducer = REDUCERS[method]
        words = arguments(reducer)
        first = f"`{method}`"
        for field in fields(reducer):
            yield f"| {first} | `{field.name}` | {default(field)} | {words[field.name]} |"
            first = ""
        if first:
            yield f"| {first} | | | it has no keys |"


def arguments(reducer: type[Reducer]) -> dict[str, str]:
    """What its docstring says of each option, or that of the class which it comes from."""
    words: dict[str, str] = {}
    for holder in reversed(reducer.__mro__):
        _, _, text = (inspect.cleandoc(holder.__doc__ or "")).partition("Args:\n")
        for name, meaning in re.findall(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", text, re.MULTILINE):
            words[name] = re.sub(r"\s+", " ", meaning).replace("``", "`").rstrip(".")
    return words


def default(field: Field[object]) -> str:
    """As it stands in a job."""
    value = field.default if field.default_factory is MISSING else field.default_factory()
    return "" if value is MISSING else "none" if value in (None, [], {}) else f"`{in_toml(value)}`".replace("'", '"')


def job_keys() -> Iterator[str]:
    """A row for each key of a job that is the same for all methods."""
    return keys_of(job_tables())


def keys_of(tables: type[KeyTable]) -> Iterator[str]:
    """A row for each key of the tables of a file."""
    for table, hint in hints_of(tables).items():
        kind = inner_table(hint)
        if kind is None:
            raise TypeError(f"{table} holds no table")
        name = f"[[{table}]]" if holds_several(hint) else f"[{table}]"
        yield from rows_of(f"`{name}`", kind)


def rows_of(name: str, kind: type[KeyTable], within: str = "") -> Iterator[str]:
    """A row for each key of a table; those of laws and motions, which are many, follow theirs."""
    hints = hints_of(kind)
    for key in fields(kind):
        yield f"| {name} | `{within}{key.name}` | {left_out(key)} | {describe_expected(key, hints[key.name])} |"
        inner = inner_table(hints[key.name])
        if inner in UNFOLDED:
            yield from rows_of(name, inner, f"{within}{key.name}.")


def import_options() -> Iterator[str]:
    """A row for each option of an import."""
    hints = hints_of(ImportOptions)
    for entry in fields(ImportOptions):
        flag = "FILE" if entry.name == "file" else f"--{entry.name.replace('_', '-')}"
        meaning = entry.metadata["meaning"]
        names = ", ".join(f"`{name}`" for name in choices(hints[entry.name]))
        yield f"| `{flag}` | `{entry.name}` | {left_out(entry)} | {meaning}{f': {names}' if names else ''} |"


def left_out(key: Field[object]) -> str:
    """What a key of a job has where it is left out."""
    value = key.default if key.default_factory is MISSING else key.default_factory()
    if value is MISSING:
        return "must be given"
    return "none" if value is None else f"`{in_toml(value)}`".replace("'", '"')


def tolerance_tables(top: str) -> Iterator[str]:
    """A table for each room within ``top``: the names, the values and the comments above the fields."""
    for room, quantities in groupby(tolerances(), lambda quantity: quantity.room):
        if room.partition(".")[0] != top:
            continue
        yield from (
            f"\n## `morembs.{room}.tolerances`\n",
            "| quantity | value | where it comes from |",
            "|---|---|---|",
        )
        for quantity in quantities:
            value, reason = repr(quantity.value).replace("_", ""), quantity.reason.replace("|", r"\|")
            yield f"| `{quantity.name}` | {value} | {reason} |"


def renewed(text: str) -> str:
    """A page with its tables as they are now."""

    def table(match: re.Match[str]) -> str:
        if match[1] == "reducers":
            head, rows = ["| method | key | default | meaning |", "|---|---|---|---|"], list(keys())
        elif match[1] == "job keys":
            head, rows = ["| table | key | default | what to give |", "|---|---|---|---|"], list(job_keys())
        elif match[1] == "system keys":
            head, rows = ["| table | key | default | what to give |", "|---|---|---|---|"], list(keys_of(SystemTables))
        elif match[1] == "import options":
            head = ["| option | key, argument | default | meaning |", "|---|---|---|---|"]
            rows = list(import_options())
        elif match[1].startswith("tolerances of "):
            head, rows = [], list(tolerance_tables(match[1].removeprefix("tolerances of ")))
        else:
            head = ["| dataset | shape | type | unit | meaning |", "|---|---|---|---|---|"]
            rows = [line for at, part in SHOWN[match[1]] for line in lines(at, part)]
        return "\n".join([f"<!-- table: {match[1]} -->", *head, *rows, "<!-- end -->"])

    text = VERSIONS.sub(rf"\g<1>{VERSION}", text)
    return re.sub(r"<!-- table: (.*?) -->\n.*?<!-- end -->", table, text, flags=re.DOTALL)


def stale() -> dict[Path, str]:
    """Pages that are not as they should be, and how they should be."""
    named = [*sorted((ROOT / "docs").rglob("*.md")), *(ROOT / name for name in NAMED)]
    pages = {page: page.read_text(encoding="utf-8") for page in named}
    return {page: new for page, text in pages.items() if (new := renewed(text)) != text}


def main() -> int:
    """Write the pages, or with --check say which are stale."""
    check = "--check" in sys.argv[1:]
    for page, text in stale().items():
        if check:
            print(f"{page.relative_to(ROOT)} is stale; run scripts/schema.py")
        else:
            page.write_text(text, encoding="utf-8")
    return int(check and bool(stale()))


if __name__ == "__main__":
    raise SystemExit(main())
