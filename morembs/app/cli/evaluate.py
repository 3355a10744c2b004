"""The verb that evaluates body files with parameters."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from morembs.app.cli.bodies import BodyFile, BodyName, values_of
from morembs.app.cli.completion import TABLES, files_with
from morembs.app.cli.families import parametric_of, read_values
from morembs.app.cli.members import evaluate_member
from morembs.app.cli.messages import print_json, printing, warn
from morembs.app.cli.terminal import AsJson, Verb, example, messages
from morembs.app.report.style import STYLE
from morembs.base.errors import InputError
from morembs.storage.safefile import check_writable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from morembs.body.parametric import Evaluation, ParametricBody
    from morembs.parametric.model import ModelAt

app = typer.Typer()
At = Annotated[
    str | None, typer.Option("--at", metavar="NAME=VALUE,...", help="Values in SI units; others are nominal.")
]
Values = Annotated[
    Path | None,
    typer.Option(
        "--table", metavar="FILE.csv", help="Values, a row for each body.", autocompletion=files_with(*TABLES)
    ),
]
KIND = {"bound": "proven bound", "estimate": "estimate of a bound"}


@app.command(cls=Verb, epilog=example("morembs evaluate part.h5 --at young=2.1e11"))
def evaluate(
    file: BodyFile,
    at: At = None,
    table: Values = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="A body file for --at; a .csv or .h5 file for --table.")
    ] = None,
    frequencies: Annotated[int, typer.Option(help="How many elastic frequencies.")] = STYLE.evaluated_frequencies,
    bound_hz: Annotated[
        str | None, typer.Option("--bound", metavar="HZ,...", help="Bounds of the error of H at these frequencies.")
    ] = None,
    sensitivity: Annotated[bool, typer.Option("--sensitivity", help="Derivatives of the frequencies too.")] = False,
    matrices: Annotated[bool, typer.Option("--matrices", help="K, M and D of each row too, in a .h5 file.")] = False,
    body: BodyName = None,
    as_json: AsJson = False,
) -> None:
    """Evaluate a body with parameters at other values, or a planar member between given frames."""
    # Not at the top: help needs no file.
    from morembs.storage.hdf5 import MEMBERS, holds_format

    with messages():
        if holds_format(file, MEMBERS):
            if table is not None or bound_hz is not None or sensitivity or matrices:
                raise InputError(
                    f"{file} holds planar members, which take --at start.angle=0.2,end.x=0.3,... and --out FILE.csv",
                    kind="unsupported",
                )
            evaluate_member(file, body, values_of(at), out, as_json)
            return
        _refuse_mixed(at, table, out, sensitivity, matrices)
        if frequencies < 1:
            raise InputError(
                f"--frequencies {frequencies} was given; expected a number, 1 or more", keyword="frequencies"
            )
        at_hz = _frequencies_of(bound_hz)
        parametric = parametric_of(file, body)
        if table is not None:
            _evaluate_table(parametric, table, out, frequencies, at_hz, matrices, as_json)
        else:
            _evaluate_one(parametric.at(**values_of(at)), out, frequencies, at_hz, sensitivity, as_json)


def _frequencies_of(text: str | None) -> list[float]:
    """Frequencies in Hz of --bound."""
    try:
        given = [float(part) for part in (text or "").split(",") if part.strip()]
    except ValueError:
        given = [math.nan]
    if not all(math.isfinite(f) and f >= 0 for f in given) or (text is not None and not given):
        raise InputError(
            f"--bound {text} was given; expected frequencies in Hz, zero or more: HZ,HZ,...", keyword="bound"
        )
    return given


def _refuse_mixed(at: str | None, table: Path | None, out: Path | None, sensitivity: bool, matrices: bool) -> None:
    if (at is None) == (table is None):
        raise InputError("evaluate needs values: --at NAME=VALUE,... for one body, or --table FILE.csv for many")
    if sensitivity and table is not None:
        raise InputError(
            "--sensitivity was given for a table; take --at for the derivatives at one value", keyword="sensitivity"
        )
    if matrices and (table is None or out is None or out.suffix != ".h5"):
        raise InputError("--matrices was given; it needs --table and --out FILE.h5", keyword="matrices")
    if table is not None and out is not None and out.suffix not in (".csv", ".h5"):
        raise InputError(f"--out {out} was given for a table; expected a name that ends in .csv or .h5", keyword="out")
    if table is None and out is not None and out.suffix == ".csv":
        raise InputError(
            f"--out {out} was given for --at, which writes a body file; expected a name that ends in .h5", keyword="out"
        )
    if out is not None:
        check_writable(out)


def _evaluate_one(
    at: Evaluation, out: Path | None, count: int, at_hz: list[float], sensitivity: bool, as_json: bool
) -> None:
    # Not at the top: help needs no numbers.
    import numpy as np

    from morembs.app.cli.messages import without_nan

    hz = at.frequencies_hz[:count]
    if len(hz) < count:
        warn(f"{count} frequencies were asked for; the body has {len(hz)}")
    bounds = at.bound(np.array(at_hz)) if at_hz else np.zeros(0)
    written = [str(at.write(out))] if out is not None else []
    slopes: dict[str, Any] = {}
    clustered: list[bool] = []
    in_band: list[bool] = []
    if sensitivity:
        derived = at.sensitivity()
        slopes = {name: values[: len(hz)].tolist() for name, values in derived.frequencies_hz.items()}
        clustered, in_band = (flags[: len(hz)].tolist() for flags in (derived.clustered, derived.in_band))
    with printing(written):
        if as_json:
            document = {"at": at.values, "written": written, "frequencies_hz": hz.tolist()}
            more = {"frequency_slopes": slopes, "clustered": clustered, "in_band": in_band} if sensitivity else {}
            known = {"bound_hz": at_hz, "bound": without_nan(bounds)} if at_hz else {}
            print_json([{**document, "bound_kind": at.bound_kind, **known, **more}])
            return
        units = zip(at.values.items(), at.parent.units, strict=True)
        typer.echo("at " + ", ".join(f"{name} = {value:.6g} {unit}".rstrip() for (name, value), unit in units))
        typer.echo("elastic frequencies in Hz: " + ", ".join(f"{f:,.7g}" for f in hz))
        for f, bound in zip(at_hz, bounds.tolist(), strict=True):
            limit = f"{KIND[at.bound_kind]}: {bound:.3g} m/N" if math.isfinite(bound) else "no bound there"
            typer.echo(f"error of H at {f:.12g} Hz, {limit}")
        for name, values in slopes.items():
            typer.echo(f"Hz per unit of {name}: " + ", ".join(f"{value:.5g}" for value in values))
        if any(clustered):
            numbers = ", ".join(str(k + 1) for k, together in enumerate(clustered) if together)
            typer.echo(f"note: frequencies {numbers} lie together; their derivatives are those of the branches")
        if not all(in_band):
            numbers = ", ".join(str(k + 1) for k, inside in enumerate(in_band) if not inside)
            typer.echo(f"note: frequencies {numbers} lie above the band of the body, and their derivatives are rough")
        for name in written:
            typer.echo(f"written: {name}")


def _evaluate_table(
    parametric: ParametricBody,
    table: Path,
    out: Path | None,
    count: int,
    at_hz: list[float],
    matrices: bool,
    as_json: bool,
) -> None:
    # Not at the top: help needs no numbers.
    import numpy as np

    from morembs.app.cli.messages import without_nan

    values = read_values(table, parametric)
    hz = parametric.frequencies_hz(values, count)
    bodies = [parametric.model.at(p) for p in values] if matrices or at_hz else []
    bounds = np.array([each.bound(np.array(at_hz)) for each in bodies]).reshape(len(values), len(at_hz))
    kinds = [each.bound_kind for each in bodies] if at_hz else []
    result = _Table(names=parametric.names, values=values, hz=hz, at_hz=at_hz, bounds=bounds, kinds=kinds)
    written = []
    if out is not None:
        _write_table(out, result, bodies if matrices else [])
        written = [str(out)]
    with printing(written):
        if as_json:
            known = {"bound_hz": at_hz, "bound": without_nan(bounds), "bound_kind": kinds} if at_hz else {}
            print_json(
                [
                    {
                        "table": str(table),
                        "written": written,
                        "values": values.tolist(),
                        "frequencies_hz": hz.tolist(),
                        **known,
                    }
                ]
            )
        elif out is None:
            typer.echo(_csv(result), nl=False)
        else:
            typer.echo(f"written: {out}, {len(values)} values with {hz.shape[1]} frequencies each")


@dataclass(frozen=True, kw_only=True)
class _Table:
    """Rows of ``values`` (k, P) with frequencies ``hz`` (k, c), ``bounds`` (k, f) at ``at_hz`` and their ``kinds``."""

    names: tuple[str, ...]
    values: NDArray[np.float64]
    hz: NDArray[np.float64]
    at_hz: list[float]
    bounds: NDArray[np.float64]
    kinds: list[str]


def _csv(table: _Table) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    last = ["bound_kind"] if table.kinds else []
    columns = [f"frequency_{k + 1}_hz" for k in range(table.hz.shape[1])]
    rows.writerow([*table.names, *columns, *(f"bound_at_{f:.12g}_hz" for f in table.at_hz), *last])
    for k, numbers in enumerate(zip(table.values.tolist(), table.hz.tolist(), table.bounds.tolist(), strict=True)):
        rows.writerow([*(repr(x) for part in numbers for x in part), *table.kinds[k : k + 1]])
    return text.getvalue()


def _write_table(out: Path, table: _Table, bodies: list[ModelAt]) -> None:
    if out.suffix == ".csv":
        from morembs.storage.safefile import replacing

        with replacing(out) as text:
            text.write(_csv(table).encode())
        return
    import numpy as np

    from morembs.storage.writer import writing

    def words(given: Iterable[str]) -> NDArray[np.bytes_]:
        return np.array([each.encode() for each in given])

    with writing(out) as file:
        file.put("names", words(table.names), "names of the parameters")
        file.put("values", table.values, "a row for each body, SI units")
        file.put("frequencies_hz", table.hz, "elastic eigenfrequencies", "Hz")
        if table.at_hz:
            file.put("bound_hz", np.array(table.at_hz), "where the bounds hold", "Hz")
            file.put("bound", table.bounds, "of the Frobenius norm of the error of H, a row for each body", "m/N")
            file.put("bound_kind", words(table.kinds), "bound, estimate or none")
        for name in ("M", "K", "D") if bodies else ():
            file.put(name, np.stack([getattr(each, name) for each in bodies]), "reduced matrices, one for each row")
