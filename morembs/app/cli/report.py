"""What people and scripts get to see: tables for a terminal, plain values for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from morembs.app.cli.certificates import Certified, print_certificates
from morembs.app.cli.messages import without_nan
from morembs.app.cli.style import STYLE
from morembs.app.cli.tables import (
    bytes_words,
    frame_words,
    listed,
    mass_table,
    percent,
    plain_table,
    ranking_words,
    titled,
    words,
)
from morembs.app.cli.tolerances import TOL
from morembs.app.jobs.pareto import Contender
from morembs.app.jobs.run import JobResult
from morembs.app.jobs.stages.forecast import JobForecast
from morembs.base.progress import duration_words
from morembs.base.types import Floats
from morembs.body import Body
from morembs.certificate.record import CERTIFICATE
from morembs.storage.checksums import whole_sum

if TYPE_CHECKING:
    from morembs.certificate.record import Certificate

# Rows of a forecast that their keys do not explain.
LABELS = {
    "stiffness_nonzeros": "nonzeros of K",
    "mass_nonzeros": "nonzeros of M",
    "matrices_bytes": "memory of K and M",
    "factor_entries": "nonzeros of the factor",
    "factor_flops": "operations of the factorisation",
    "factor_bytes": "memory of the factor",
    "scratch_bytes": "scratch files",
    "columns_bytes": "memory of the bases",
    "peak_memory_bytes": "peak memory",
    "factor_seconds": "factorisation in s",
    "reduction_seconds": "reductions",
    "shift_factor_entries": "nonzeros of the largest factor at a shift",
    "shift_factor_bytes": "memory of that factor",
    "shift_seconds": "factorisations at shifts in s",
    "processes": "workers or ranks beside it",
    "process_bytes": "memory of each of them",
    "all_processes_bytes": "peak memory of all processes",
}
# Left out where there is nothing beside the one factorisation and the one process.
BESIDE = ("shift_factor_entries", "shift_factor_bytes", "shift_seconds", "processes", "process_bytes")
# Coordinates that follow responses.
RESPONSES = {"krylov", "gramian", "balanced"}


def result_json(result: JobResult) -> dict[str, Any]:
    """A finished job as plain values, SI units."""
    part, first = result.bodies[0].part, result.bodies[0]
    response = result.response
    return {
        "job": str(result.job.path),
        "output": str(result.job.output),
        "body_sha256": whole_sum(result.job.output),
        "picture": None if result.job.picture is None else str(result.job.picture),
        "solver": result.solver,
        "choice": result.choice,
        "factor": asdict(result.factor),
        "nodes": result.nodes,
        "elements": result.elements,
        "dofs": result.dofs,
        "mass": part.mass,
        "center_of_mass": part.center_of_mass.tolist(),
        "inertia": part.inertia.tolist(),
        "frequencies_hz": first.frequencies_hz.tolist(),
        "full_frequencies_hz": listed(first.full_frequencies_hz),
        "bodies": {
            body.name: {
                "order": body.reduced.order,
                "rigid_count": body.reduced.rigid_count,
                "frequencies_hz": body.frequencies_hz.tolist(),
                "mode_kind": list(body.reduced.mode_kind),
                "recipe": dict(body.recipe),
                "frame": None if body.floating is None else body.floating.kind,
                "ranking": [[term.name, term.equation, term.share] for term in body.ranking],
                "largest_response_error": None if response is None else float(response.error[body.name].max()),
                "certificate": None if body.certificate is None else _certificate_json(body.certificate),
            }
            for body in result.bodies
        },
        "warnings": list(result.warnings),
        "inputs": {name: asdict(content) for name, content in result.inputs.items()},
        "seconds": {stage.name: stage.seconds for stage in result.stages},
        "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in result.stages},
        "job_peak_memory_bytes": result.peak_memory_bytes,
    }


def _certificate_json(certificate: Certificate) -> dict[str, Any]:
    values = {name: value for name, value in asdict(certificate).items() if name != "notes"}
    values = {name: without_nan(value) for name, value in values.items()}
    return {
        **values,
        "absolute_error": certificate.absolute_error,
        "bound_kind": certificate.bound_kind,
        "notes": list(certificate.notes),
    }


def print_result(console: Console, result: JobResult, told: Sequence[str] = ()) -> None:
    """Frequencies, mass and cost of a finished job; a terminal shows the warnings ``told`` before already."""
    part = result.bodies[0].part
    console.print(
        f"[bold]{result.job.path.name}[/]: {result.nodes:,} nodes, {result.elements:,} elements, "
        f"{result.dofs:,} degrees of freedom, solver {result.solver}",
        highlight=False,
    )
    if result.choice:
        console.print(f"  solver: {result.choice}", highlight=False, soft_wrap=True)
    for body in result.bodies:
        console.print(f"  {body.name}: {words(body.reduced.mode_kind)}", highlight=False)
        if body.floating is not None and (body.floating.kind != "mean-axes" or body.floating.stiffening is not None):
            console.print(f"    {frame_words(body.floating)}", highlight=False, soft_wrap=True)
        if body.ranking:
            console.print(f"    inertia terms: {ranking_words(body.ranking)}", highlight=False, soft_wrap=True)
    # Side by side as far as 80 columns hold them.
    for first in range(0, len(result.bodies), STYLE.bodies_per_table):
        table = _frequencies(result.bodies[first : first + STYLE.bodies_per_table])
        titled(console, "free-free frequencies, rigid-body modes left out", table)
        if result.bodies[0].full_frequencies_hz is not None and any("-" in column.cells for column in table.columns):
            console.print("-: the body has no such mode, or none that stands for one of the full model", soft_wrap=True)
    titled(console, "mass properties", mass_table(part.mass, part.center_of_mass, part.inertia))
    _print_certificates(console, result.bodies)
    titled(console, "cost", _cost(result))
    console.print()
    if result.response is not None and not any(body.certificate for body in result.bodies):
        band = result.response.frequencies_hz
        for name, error in result.response.error.items():
            console.print(
                f"{name}: relative error of the frequency response at most {error.max():.2e} from {band[0]:,.6g} to "
                f"{band[-1]:,.6g} Hz (median {np.median(error):.1e})",
                highlight=False,
                soft_wrap=True,
            )
    for warning in result.warnings:
        if warning not in told or not console.is_terminal:
            console.print(f"warning: {escape(warning)}", highlight=False, soft_wrap=True)
    written = [result.job.output] + ([] if result.job.picture is None else [result.job.picture])
    _print_written(console, written)


def _print_certificates(console: Console, bodies: Sequence[Body]) -> None:
    """The errors of each body, and the choices of those that made some."""
    known = []
    for body in bodies:
        if body.certificate is not None:
            values = CERTIFICATE.flat(body.certificate)
            choice = [str(body.recipe["choice"])] if "choice" in body.recipe else []
            known.append(Certified(name=body.name, order=body.reduced.order, values=values, notes=choice))
    print_certificates(console, known, [interface.name for interface in bodies[0].part.interfaces])


def print_forecast(console: Console, job: str, forecast: JobForecast) -> None:
    """A checked job and what it will need."""
    table = plain_table("", "")
    for key, value in forecast.as_json().items():
        if key in ("warnings", "choice") or (not value and key in BESIDE):
            continue
        if key == "interface_nodes":
            value = ", ".join(f"{name} {count:,}" for name, count in value.items()) or "none"
        elif key == "reduction_seconds":
            known = ", ".join(f"{name} {duration_words(seconds)}" for name, seconds in value.items())
            value = f"{known} (within a factor of three)" if known else "no forecast"
        elif key == "extent":
            value = " x ".join(f"{length:.4g}" for length in value) + " m"
        if key.endswith("_bytes"):
            shown = bytes_words(value)
        elif isinstance(value, int):
            shown = f"{value:,}"
        else:
            shown = f"{value:.3g}" if isinstance(value, float) else str(value)
        table.add_row(LABELS.get(key, key.removesuffix("_bytes").replace("_", " ")), escape(shown))
    count = len(forecast.warnings)
    warned = f" can be run, with {count} warning{'s' if count > 1 else ''} below" if count else " is sound"
    titled(console, job + warned, table)
    if forecast.choice:
        console.print(f"solver: {forecast.choice}", highlight=False, soft_wrap=True)
    for text in forecast.warnings:
        console.print(f"[yellow]warning:[/] {escape(text)}", highlight=False, soft_wrap=True)


def print_contenders(console: Console, job: str, compared: Sequence[Contender], written: Sequence[Path]) -> None:
    """Reductions side by side; a star marks those that no other is both at most as large and as wrong as."""
    heads = ("order", "error", "limit", "mean, pointwise", "static", "held, median", "seconds", "peak memory")
    table = plain_table("body", *heads)
    for contender in compared:
        known = contender.bound, contender.mean_error, contender.static_error, contender.held_error
        table.add_row(
            ("* " if contender.best else "  ") + contender.name,
            str(contender.order),
            f"{contender.error:.1e}",
            *("-" if value is None else f"{value:.1e}" for value in known),
            f"{contender.seconds:.2f}",
            bytes_words(contender.peak_memory_bytes),
        )
    titled(console, f"{job}: reductions compared, * on the Pareto front of order and error", table)
    measures = " and ".join(sorted({contender.measure for contender in compared}))
    console.print(
        f"error: reached in the band, limit: not exceeded in it, by the measure of the certificate ({measures}); mean, "
        "pointwise: of |E(f)| / |H(f)| at the stored frequencies; held: the same with one interface held still, median "
        "over the band, worst interface; seconds: what reductions share (modes, the reference model) counts for the "
        "first that needs it; peak memory: of the process during it",
        highlight=False,
        soft_wrap=True,
    )
    _print_written(console, written)


def _print_written(console: Console, files: Sequence[Path]) -> None:
    console.print("written: " + ", ".join(map(str, files)), highlight=False, soft_wrap=True)


def _frequencies(bodies: Sequence[Body]) -> Table:
    """Elastic frequencies, those of the full model first where they are known."""
    full = bodies[0].full_frequencies_hz
    rigid = bodies[0].reduced.rigid_count if full is None else int((full == 0).sum())
    columns = ["mode"] + ["full Hz"] * (full is not None)
    for body in bodies:
        held = ", held" if body.reduced.rigid_count < rigid else ""
        columns += [f"{body.name} Hz{held}"] + ["off by %"] * (full is not None)
    table = plain_table(*columns)
    elastic = None if full is None else full[rigid:]
    rows = STYLE.reported_frequencies if elastic is None else len(elastic)
    frequencies = [body.frequencies_hz[body.reduced.rigid_count :] for body in bodies]
    if elastic is not None:
        frequencies = [
            beside(elastic, own) if RESPONSES.intersection(body.reduced.mode_kind) else own
            for body, own in zip(bodies, frequencies, strict=True)
        ]
    for number in range(rows):
        row = [str(number + 1)] + ([] if elastic is None else [f"{elastic[number]:,.2f}"])
        for body, own in zip(bodies, frequencies, strict=True):
            known = number < len(own) and np.isfinite(own[number])
            row.append(f"{own[number]:,.2f}" if known else "-")
            if elastic is not None:
                # Modes beyond those kept are not approximations of anything; held bodies have other modes.
                kinds = body.reduced.mode_kind
                by_modes = "rigid" in kinds and not RESPONSES.intersection(kinds)
                kept = kinds.count("elastic") if by_modes else len(own)
                fits = known and number < kept and body.reduced.rigid_count == rigid
                row.append(percent(own[number] / elastic[number] - 1) if fits else "-")
        table.add_row(*row)
    return table


def beside(full: Floats, own: Floats) -> Floats:
    """(k,) of ``own`` frequencies (n,), ascending, the one that stands for each of ``full`` (k,), nan where none does:
    bodies that follow responses have modes of no load neither in number nor in order."""
    partner, first = np.full(len(full), np.nan), 0
    for k, hz in enumerate(full):
        near = first + int(np.abs(own[first:] - hz).argmin()) if first < len(own) else len(own)
        if near < len(own) and abs(own[near] - hz) <= TOL.same_row * hz:
            partner[k], first = own[near], near + 1
    return partner


def _cost(result: JobResult) -> Table:
    table = plain_table("stage", "seconds", "peak memory")
    for stage in result.stages:
        table.add_row(stage.name, f"{stage.seconds:.2f}", bytes_words(stage.peak_memory_bytes))
    seconds = sum(stage.seconds for stage in result.stages)
    table.add_row("all", f"{seconds:.2f}", bytes_words(result.peak_memory_bytes))
    return table
