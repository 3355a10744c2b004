"""The verb that finds parameters from measured frequencies."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from morembs.app.cli.bodies import BodyFile, BodyName, values_of
from morembs.app.cli.families import parametric_of
from morembs.app.cli.messages import print_json, printing
from morembs.app.cli.terminal import AsJson, Verb, example, messages

if TYPE_CHECKING:
    from morembs.parametric.update import Updated

app = typer.Typer()


@app.command(cls=Verb, epilog=example("morembs update part.h5 --measured frequencies.csv -o updated.h5"))
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
        # Not at the top: help needs no numbers.
        from morembs.body.measured import read_measured
        from morembs.storage.safefile import check_writable

        if out is not None:
            check_writable(out)
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


def _document(result: Updated, written: list[str]) -> dict[str, object]:
    return {
        "values": result.values,
        "sigma": [x if math.isfinite(x) else None for x in result.sigma.tolist()],
        "correlation": result.correlation.tolist(),
        "singular_values": result.singular_values.tolist(),
        "untold": [dict(each) for each in result.untold],
        "at_end": list(result.at_end),
        "misfit": result.misfit,
        "modes": result.measured.modes.tolist(),
        "measured_hz": result.measured.frequencies_hz.tolist(),
        "frequencies_hz": result.frequencies_hz.tolist(),
        "above_band": list(result.above),
        "written": written,
    }


def _print(result: Updated, units: tuple[str, ...], written: list[str]) -> None:
    for name, value, sigma, unit in zip(result.names, result.p, result.sigma, units, strict=True):
        spread = (
            "kept"
            if sigma == 0
            else f"+- {sigma:.2g}"
            if math.isfinite(sigma)
            else "not determined by these frequencies"
        )
        typer.echo(f"{name} = {value:.6g} {unit}".rstrip() + f"  {spread}")
    typer.echo("mode   measured, Hz   body, Hz       difference in standard deviations")
    rows = zip(
        result.measured.modes,
        result.measured.frequencies_hz,
        result.frequencies_hz,
        result.measured.sigma_hz,
        strict=True,
    )
    for mode, wanted, value, sigma in rows:
        typer.echo(f"{mode:4d}   {wanted:12.6g}   {value:12.6g}   {(value - wanted) / sigma:+.2f}")
    for direction in result.untold:
        changes = ", ".join(f"{name} {100 * part:+.3g} %" for name, part in direction.items())
        typer.echo(
            f"note: not identifiable from these frequencies: {changes} at once; fix one of them, or give a --prior"
        )
    if result.above:
        typer.echo(
            f"note: modes {', '.join(map(str, result.above))} lie above the band for which the body was made, where "
            "its own error is not known; leave them out, or reduce with a wider band_hz"
        )
    for name in result.at_end:
        typer.echo(f"note: {name} lies at the end of its range; what was measured may need more")
    for name in written:
        typer.echo(f"written: {name}")
