"""The verb that evaluates body files with parameters."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from morembs.cli.bodies import BodyFile, BodyName, values_of
from morembs.cli.families import parametric_of, read_values
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
