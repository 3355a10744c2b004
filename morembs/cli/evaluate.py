"""The verb that evaluates body files with parameters."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from morembs.cli.bodies import BodyFile, BodyName, values_of
from morembs.cli.messages import print_json, printing
from morembs.cli.terminal import EPILOG, AsJson, messages
from morembs.errors import InputError

if TYPE_CHECKING:
    from morembs.body.parametric import BodyAt, ParametricBody

app = typer.Typer()
Floats = NDArray[np.float64]
At = Annotated[
    str | None, typer.Option("--at", metavar="NAME=VALUE,...", help="Values in SI units; others are nominal.")
]
Values = Annotated[Path | None, typer.Option("--table", metavar="FILE.csv", help="Values, a row for each body.")]
# Frequencies that are printed.
SHOWN = 6


@app.command(epilog=EPILOG)
def evaluate(
    file: BodyFile,
    at: At = None,
    table: Values = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="A body file for --at; a .csv or .h5 file for --table.")
    ] = None,
    frequencies: Annotated[int, typer.Option(help="How many elastic frequencies.")] = SHOWN,
    sensitivity: Annotated[bool, typer.Option("--sensitivity", help="Derivatives of the frequencies too.")] = False,
    matrices: Annotated[bool, typer.Option("--matrices", help="K, M and D of each row too, in a .h5 file.")] = False,
    body: BodyName = None,
    as_json: AsJson = False,
) -> None:
    """Evaluate a body with parameters at other values."""
    with messages():
        _refuse_mixed(file, at, table, out, sensitivity, matrices)
        parametric = parametric_of(file, body)
        if table is not None:
            _evaluate_table(parametric, table, out, frequencies, matrices, as_json)
        else:
            _evaluate_one(parametric.at(**values_of(at)), out, frequencies, sensitivity, as_json)


def _refuse_mixed(
    file: Path, at: str | None, table: Path | None, out: Path | None, sensitivity: bool, matrices: bool
) -> None:
    if (at is None) == (table is None):
        raise InputError("evaluate needs values: --at NAME=VALUE,... for one body, or --table FILE.csv for many")
    if sensitivity and table is not None:
        raise InputError("--sensitivity was given for a table; take --at for the derivatives at one value")
    if matrices and (table is None or out is None or out.suffix != ".h5"):
        raise InputError("--matrices was given; it needs --table and --out FILE.h5")
    if table is not None and out is not None and out.suffix not in (".csv", ".h5"):
        raise InputError(f"--out {out} was given for a table; expected a name that ends in .csv or .h5")
    if out is not None and out.resolve() in {each.resolve() for each in (file, table) if each is not None}:
        raise InputError(f"--out {out} would overwrite an input; give another name")


def parametric_of(file: Path, body: str | None) -> ParametricBody:
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


def read_values(path: Path, parametric: ParametricBody) -> Floats:
    """Values (k, P) of a table, whose header has names of parameters; others are nominal.

    Raises:
        InputError: a table that cannot be read, unknown names, or values outside the box.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].lstrip().startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the table {path} cannot be read ({error}); check the path") from error
    header = [name.strip() for name in rows[0]] if rows else []
    if len(rows) < 2 or len(set(header)) < len(header):
        raise InputError(f"the table {path} has no rows below its header, or a name twice; expected NAME,NAME and rows")
    result = np.empty((len(rows) - 1, len(parametric.names)))
    for number, row in enumerate(rows[1:]):
        try:
            values = dict(zip(header, map(float, row), strict=True))
            result[number] = parametric.model.box.point(values)
        except ValueError as error:
            raise InputError(f"the table {path}, row {number + 1}: {error}; expected {len(header)} numbers") from error
        except InputError as error:
            raise InputError(f"the table {path}, row {number + 1}: {error}") from error
    return result


def export_family(
    file: Path, table: Path, to: str, out: Path | None, body: str | None, options: Mapping[str, object],
    frame: str | None, as_json: bool,
) -> None:  # fmt: skip
    """Write the body at each row of ``table`` for another program: numbered files beside ``out`` and ``index.csv``.

    Raises:
        InputError: as ``export_body`` and ``read_values``.
    """
    from morembs.exporters import EXPORTERS, export_body, make_exporter
    from morembs.storage.safefile import replacing

    make_exporter(to, options)
    suffix = EXPORTERS[to].suffix
    first = file.with_suffix(suffix) if out is None else out
    parametric = parametric_of(file, body)
    values = read_values(table, parametric)
    digits, taken, rows = len(str(len(values))), list[Path](), list[list[str]]()
    for number, p in enumerate(values, 1):
        path = first.with_name(f"{first.name.removesuffix(first.suffix)}_{number:0{digits}d}{first.suffix or suffix}")
        at = dict(zip(parametric.names, p.tolist(), strict=True))
        done = export_body(
            file, to, path=path, body=parametric.stored.name, options=options, frame=frame, at=at, taken=taken
        )
        taken.extend(done.paths)
        rows.append([path.name, *(repr(x) for x in p.tolist())])
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([["file", *parametric.names], *rows])
    index = first.with_name("index.csv")
    with replacing(index) as written:
        written.write(text.getvalue().encode())
    paths = [str(path) for path in (*taken, index)]
    with printing(paths):
        if as_json:
            print_json([{"file": str(file), "to": to, "written": paths}])
        else:
            typer.echo(f"written: {len(values)} bodies as {first.stem}_N{first.suffix}, and {index}")


def _evaluate_one(at: BodyAt, out: Path | None, count: int, sensitivity: bool, as_json: bool) -> None:
    hz = at.frequencies_hz[: max(count, 0)]
    written = [str(at.write(out))] if out is not None else []
    slopes: dict[str, Any] = {}
    clustered: list[bool] = []
    if sensitivity:
        derived = at.model.sensitivity()
        slopes = {name: values[: len(hz)].tolist() for name, values in derived.frequencies_hz.items()}
        clustered = derived.clustered[: len(hz)].tolist()
    with printing(written):
        if as_json:
            document = {"at": at.values, "written": written, "frequencies_hz": hz.tolist()}
            more = {"frequency_slopes": slopes, "clustered": clustered} if sensitivity else {}
            print_json([{**document, "bound_kind": at.bound_kind, **more}])
            return
        units = zip(at.values.items(), at.parent.units, strict=True)
        typer.echo("at " + ", ".join(f"{name} = {value:.6g} {unit}".rstrip() for (name, value), unit in units))
        typer.echo("elastic frequencies in Hz: " + ", ".join(f"{f:,.7g}" for f in hz))
        for name, values in slopes.items():
            typer.echo(f"Hz per unit of {name}: " + ", ".join(f"{value:.5g}" for value in values))
        if any(clustered):
            numbers = ", ".join(str(k + 1) for k, together in enumerate(clustered) if together)
            typer.echo(f"note: frequencies {numbers} lie together; their derivatives are those of the branches")
        for name in written:
            typer.echo(f"written: {name}")


def _evaluate_table(
    parametric: ParametricBody, table: Path, out: Path | None, count: int, matrices: bool, as_json: bool
) -> None:
    values = read_values(table, parametric)
    hz = parametric.frequencies_hz(values, count)
    written = []
    if out is not None:
        _write_table(out, parametric, values, hz, matrices)
        written = [str(out)]
    with printing(written):
        if as_json:
            print_json([{
                "table": str(table), "written": written, "values": values.tolist(), "frequencies_hz": hz.tolist()
            }])  # fmt: skip
        elif out is None:
            typer.echo(_csv(parametric.names, values, hz), nl=False)
        else:
            typer.echo(f"written: {out}, {len(values)} values with {hz.shape[1]} frequencies each")


def _csv(names: tuple[str, ...], values: Floats, hz: Floats) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow([*names, *(f"frequency_{k + 1}_hz" for k in range(hz.shape[1]))])
    rows.writerows([repr(x) for x in row] for row in np.hstack([values, hz]).tolist())
    return text.getvalue()


def _write_table(out: Path, parametric: ParametricBody, values: Floats, hz: Floats, matrices: bool) -> None:
    if out.suffix == ".csv":
        from morembs.storage.safefile import replacing

        with replacing(out) as file:
            file.write(_csv(parametric.names, values, hz).encode())
        return
    from morembs.storage.writer import writing

    with writing(out) as file:
        file.put("names", np.array([name.encode() for name in parametric.names]), "names of the parameters")
        file.put("values", values, "a row for each body, SI units")
        file.put("frequencies_hz", hz, "elastic eigenfrequencies", "Hz")
        if matrices:
            bodies = [parametric.model.at(p) for p in values]
            for name in ("M", "K", "D"):
                file.put(name, np.stack([getattr(each, name) for each in bodies]), "reduced matrices, one for each row")
