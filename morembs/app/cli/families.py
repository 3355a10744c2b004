"""Bodies at many values of their parameters: tables of values, and files of other programs for each row."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from morembs.app.cli.messages import print_json, printing
from morembs.base.errors import InputError, OutputError
from morembs.storage.contents import own_files
from morembs.storage.csv_table import read_table

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from morembs.body.parametric import ParametricBody


def parametric_of(file: Path, body: str | None) -> Any:
    """The body with parameters of a file.

    Raises:
        InputError: it has none, or several.
    """
    # Not at the top: help needs no file.
    from morembs.body.file import read_body

    bodies = read_body(file).bodies
    if body is not None:
        return bodies[body].parametric
    varied = [each for each in bodies.values() if each.has_parameters]
    if len(varied) > 1:
        raise InputError(f"{file} has several bodies with parameters; name one: {', '.join(b.name for b in varied)}")
    return (varied or list(bodies.values()))[0].parametric


def read_values(path: Path, parametric: ParametricBody) -> NDArray[np.float64]:
    """Values (k, P) of a table, whose header has names of parameters; others are nominal.

    Raises:
        InputError: a table that cannot be read, unknown names, or values outside the box.
    """
    # Not at the top: help needs no numbers.
    import numpy as np

    columns = read_table(path, optional=None)
    result = np.empty((len(next(iter(columns.values()))), len(parametric.names)))
    for number, row in enumerate(zip(*columns.values(), strict=True)):
        try:
            result[number] = parametric.model.box.point(dict(zip(columns, row, strict=True)))
        except InputError as error:
            raise error.restate(f"the table {path}, row {number + 1} below its header: {error}") from error
    return result


def export_family(
    file: Path,
    table: Path,
    to: str,
    out: Path | None,
    body: str | None,
    options: Mapping[str, object],
    frame: str | None,
    as_json: bool,
) -> None:
    """Write the body at each row of ``table`` for another program: numbered files beside ``out`` and ``index.csv``.

    Raises:
        InputError: as ``export_body`` and ``read_values``.
        OutputError: files that cannot be written.
    """
    from morembs.exporters import EXPORTERS, export_body, make_exporter
    from morembs.storage.safefile import check_writable, replacing

    make_exporter(to, options)
    suffix = EXPORTERS[to].suffix
    first = file.with_suffix(suffix) if out is None else out
    index = first.with_name("index.csv")
    check_writable(index)
    parametric = parametric_of(file, body)
    values = read_values(table, parametric)
    digits, stem, ending = len(str(len(values))), first.name.removesuffix(first.suffix), first.suffix or suffix
    places = [first.with_name(f"{stem}_{number:0{digits}d}{ending}") for number in range(1, len(values) + 1)]
    _refuse_other_family(index, first.stem, {path.name for path in places})
    # Files that are replaced have no list until all of them are there: the old one tells of other values.
    try:
        index.resolve().unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{index} cannot be replaced ({error}); give another folder with -o") from error
    taken, rows = list[Path](), list[list[str]]()
    for path, p in zip(places, values, strict=True):
        at = dict(zip(parametric.names, p.tolist(), strict=True))
        done = export_body(
            file, to, path=path, body=parametric.stored.name, options=options, frame=frame, at=at, taken=taken
        )
        taken.extend(done.paths)
        rows.append([path.name, *(repr(x) for x in p.tolist())])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([["file", *parametric.names], *rows])
    with replacing(index) as written:
        written.write(text.getvalue().encode())
    paths = [str(path) for path in (*taken, index)]
    with printing(paths):
        if as_json:
            print_json([{"file": str(file), "to": to, "written": paths}])
        else:
            typer.echo(f"written: {len(values)} bodies as {first.stem}_N{first.suffix or suffix}, and {index}")


def _refuse_other_family(index: Path, stem: str, new: set[str]) -> None:
    """Refuse to replace the ``index`` of another family, whose files have no other list; the same one is made again,
    but not where files of its own would stay that are not among the ``new`` ones, and tell of other values.

    Raises:
        InputError: in these cases.
    """
    try:
        with own_files(), index.open(newline="", encoding="utf-8") as file:
            names = [row[0] for row in csv.reader(file) if row][1:]
    except FileNotFoundError:
        return
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{index} cannot be read ({error}); give another folder with -o", kind="file") from error
    other = next((name for name in names if Path(name).stem.rpartition("_")[0] != stem), None)
    if other is not None or not names:
        what = f"tells the values of {other}, of another family" if other else "is no list of files"
        raise InputError(f"{index} {what}; give this one a folder of its own with -o FOLDER/{stem}")
    old = [name for name in names if name not in new and index.with_name(name).exists()]
    if old:
        shown = ", ".join(old[:3]) + (f" and {len(old) - 3} more" if len(old) > 3 else "")
        raise InputError(
            f"{index} lists {shown}, which hold other parameter values than the {len(new)} new files; delete them, or "
            "give another folder with -o"
        )
