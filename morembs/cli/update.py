"""The verb that finds parameters from measured frequencies."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from morembs.cli.bodies import BodyFile, BodyName, values_of
from morembs.cli.families import parametric_of
from morembs.cli.messages import print_json, printing
from morembs.cli.terminal import EPILOG, AsJson, messages
from morembs.errors import InputError

if TYPE_CHECKING:
    from morembs.body.parametric import ParametricBody
    from morembs.parametric.update import Measured, Updated

app = typer.Typer()
Floats = NDArray[np.float64]


@app.command(epilog=EPILOG)
def update(
    file: BodyFile,
    measured: Annotated[
        Path, typer.Option("--measured", metavar="FILE.csv", help="Columns mode,frequency_hz and, if known, sigma_hz.")
    ],
    shapes: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Columns mode,id,ux,uy,uz: shapes that pair the modes.")
    ] = None,
    fix: Annotated[
        str | None, typer.Option(metavar="NAME,...", help="Parameters that keep their nominal values.")
    ] = None,
    prior: Annotated[
        str | None, typer.Option(metavar="NAME=SIGMA,...", help="Standard deviations about nominal values.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="A body file at the values found.")] = None,
    body: BodyName = None,
    as_json: AsJson = False,
) -> None:
    """Update the parameters of a body from measured frequencies."""
    with messages():
        inputs = {each.resolve() for each in (file, measured, shapes) if each is not None}
        if out is not None and out.resolve() in inputs:
            raise InputError(f"--out {out} would overwrite an input; give another name")
        parametric = parametric_of(file, body)
        fixed = [name.strip() for name in (fix or "").split(",") if name.strip()]
        result = parametric.update(
            read_measured(measured, parametric, shapes), fixed=fixed, prior=values_of(prior, "--prior")
        )
        written = [str(parametric.at(**result.values).write(out))] if out is not None else []
        with printing(written):
            if as_json:
                print_json([_document(result, written)])
            else:
                _print(result, parametric.units, written)


def read_measured(path: Path, parametric: ParametricBody, shapes: Path | None = None) -> Measured:
    """Measured frequencies, and shapes where there are any.

    Raises:
        InputError: a table that cannot be read, columns that are missing, or nodes that the body file does not keep.
    """
    from morembs.parametric.update import SIGMA, Measured

    columns = _columns(path, ("mode", "frequency_hz"), ("sigma_hz",))
    modes, frequencies = columns["mode"], columns["frequency_hz"]
    if (modes != np.round(modes)).any():
        raise InputError(f"the table {path} has modes {modes.tolist()}; expected integers from 1")
    sigma = columns.get("sigma_hz", SIGMA * frequencies)
    motions, basis = _shapes(shapes, modes, parametric) if shapes is not None else (None, None)
    return Measured(
        modes=modes.astype(np.int64), frequencies_hz=frequencies, sigma_hz=sigma, shapes=motions, basis=basis
    )


def _shapes(path: Path, modes: Floats, parametric: ParametricBody) -> tuple[Floats, Floats]:
    """Shapes (k, d) in the order of ``modes``, and the basis (d, n) there."""
    columns = _columns(path, ("mode", "id", "ux", "uy", "uz"))
    ids = np.unique(columns["id"])
    kept = parametric.source.node_ids
    lost = np.setdiff1d(ids, kept)
    if len(lost):
        raise InputError(
            f"the table {path} has the node {lost[0]:g}, and the body file keeps {len(kept)} nodes without it; make "
            'the body with [output] nodes = "all", or leave it out'
        )
    motions = np.full((len(modes), len(ids), 3), np.nan)
    for mode, node, *motion in zip(*columns.values(), strict=True):
        if mode not in modes:
            raise InputError(f"the table {path} has a shape of mode {mode:g}, of which no frequency was measured")
        motions[np.flatnonzero(modes == mode)[0], np.searchsorted(ids, node)] = motion
    if np.isnan(motions).any():
        raise InputError(f"the table {path} lacks nodes in some of its shapes; expected every mode at the same nodes")
    rows = 3 * np.flatnonzero(np.isin(kept, ids))[:, None] + np.arange(3)
    order = np.argsort(np.argsort(kept[np.isin(kept, ids)]))
    return motions[:, order].reshape(len(modes), -1), parametric.stored.basis()[rows.ravel()]


def _columns(path: Path, names: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Floats]:
    """Columns (k,) of a CSV file, in the order of ``names``."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"the table {path} cannot be read ({error}); check the path") from error
    header = [str(name).strip() for name in (rows[0] if rows else {})]
    if not rows or set(names) - set(header):
        raise InputError(
            f"the table {path} has the columns {', '.join(header) or 'none'} in {len(rows)} rows; expected "
            f"{','.join(names)} and numbers below"
        )
    result = {}
    for name in (*names, *(each for each in optional if each in header)):
        try:
            result[name] = np.array([float(row[name]) for row in rows])
        except (TypeError, ValueError, KeyError) as error:
            raise InputError(f"the table {path} has no number in some row of {name} ({error})") from error
        if not np.isfinite(result[name]).all():
            raise InputError(f"the table {path} has no finite number in some row of {name}")
    return result


def _document(result: Updated, written: list[str]) -> dict[str, object]:
    return {
        "values": result.values, "sigma": [x if np.isfinite(x) else None for x in result.sigma.tolist()],
        "correlation": result.correlation.tolist(), "singular_values": result.singular_values.tolist(),
        "untold": [dict(each) for each in result.untold], "at_end": list(result.at_end), "misfit": result.misfit,
        "modes": result.measured.modes.tolist(), "measured_hz": result.measured.frequencies_hz.tolist(),
        "frequencies_hz": result.frequencies_hz.tolist(), "written": written,
    }  # fmt: skip


def _print(result: Updated, units: tuple[str, ...], written: list[str]) -> None:
    for name, value, sigma, unit in zip(result.names, result.p, result.sigma, units, strict=True):
        spread = "kept" if sigma == 0 else f"+- {sigma:.2g}" if np.isfinite(sigma) else "not told by these frequencies"
        typer.echo(f"{name} = {value:.6g} {unit}".rstrip() + f"  {spread}")
    typer.echo("mode   measured, Hz   body, Hz       difference in standard deviations")
    rows = zip(
        result.measured.modes, result.measured.frequencies_hz, result.frequencies_hz, result.measured.sigma_hz,
        strict=True,
    )  # fmt: skip
    for mode, wanted, value, sigma in rows:
        typer.echo(f"{mode:4d}   {wanted:12.6g}   {value:12.6g}   {(value - wanted) / sigma:+.2f}")
    for direction in result.untold:
        changes = ", ".join(f"{name} {100 * part:+.3g} %" for name, part in direction.items())
        typer.echo(
            f"note: not identifiable from these frequencies: {changes} at once; fix one of them, or give a --prior"
        )
    for name in result.at_end:
        typer.echo(f"note: {name} lies at the end of its range; what was measured may need more")
    for name in written:
        typer.echo(f"written: {name}")
