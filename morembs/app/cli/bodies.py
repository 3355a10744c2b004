"""Verbs of the command line that work on body files."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from morembs.app.cli.completion import BODIES, TABLES, files_with, names_of
from morembs.app.cli.messages import Failure, print_json, print_names, printing
from morembs.app.cli.terminal import AsJson, Verb, example, messages, progress_line
from morembs.app.kinds import HDF5, instead
from morembs.base import stopping
from morembs.base.errors import InputError
from morembs.base.options import pairs
from morembs.base.scratch import ScratchFolder

if TYPE_CHECKING:
    from morembs.body.recovery.recover import Recovered
    from morembs.exporters import Exported

app = typer.Typer()


def expect_bodies(files: Any) -> Any:
    """Callback of arguments that are body files: other kinds of files are recognized.

    Raises:
        InputError: another kind of file; the message says the command for it.
    """
    for file in files if isinstance(files, list) else [files]:
        advice = instead(file, "a body file") if file is not None and file.suffix not in HDF5 else ""
        if advice:
            raise InputError(f"{file}: {advice}")
    return files


body_argument = partial(typer.Argument, show_default=False, callback=expect_bodies, autocompletion=files_with(*BODIES))
BodyFile = Annotated[Path, body_argument(metavar="FILE.h5", help="A body file.")]
Documents = list[dict[str, Any]] | None
BodyName = Annotated[str | None, typer.Option("--body", help="Which body, where the file holds several.")]


@app.command(cls=Verb, epilog=example("morembs info part.h5"))
def info(
    files: Annotated[list[Path], body_argument(metavar="FILE.h5...", help="Body files.")],
    proof: Annotated[bool, typer.Option("--proof", help="Print the lemmas that limits of errors rest on.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show what body files hold."""
    from morembs.app.cli.report_stored import show

    each_file(files, as_json, lambda file, documents: show(file, documents, proof))


@app.command(cls=Verb, epilog=example("morembs export part.h5 --to exudyn"))
def export(
    files: Annotated[list[Path] | None, body_argument(metavar="[FILE.h5...]", help="Body files.")] = None,
    to: Annotated[
        str | None,
        typer.Option(
            "--to", help="The target, one that --list names.", autocompletion=names_of("morembs.exporters", "EXPORTERS")
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file to write, by default beside FILE.")] = None,
    body: BodyName = None,
    frame: Annotated[
        str | None, typer.Option(help="Another floating frame: mean-axes, tangent:NAME, chord:NAME,NAME ...")
    ] = None,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option of the target, KEY=VALUE.")] = None,
    time_step: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Step of a simulation in real time: faster modes go.")
    ] = None,
    check: Annotated[
        float | None,
        typer.Option("--check", metavar="HZ", help="Name the time step for motion up to HZ; write nothing."),
    ] = None,
    at: Annotated[
        str | None, typer.Option("--at", metavar="NAME=VALUE,...", help="Values of parameters, in SI units.")
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            "--table",
            metavar="FILE.csv",
            help="Values of parameters, a row for each body.",
            autocompletion=files_with(*TABLES),
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the targets.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write bodies for another program."""
    from morembs.exporters import EXPORTERS
    from morembs.storage.contents import note_input

    options = [*(option or []), *([] if time_step is None else [f"time_step={time_step!r}"])]
    with messages():
        if listed:
            print_names({name: f"{kind.about} ({kind.suffix})" for name, kind in EXPORTERS.items()}, as_json)
            return
        if not files or to is None:
            given = shlex.join(map(str, files or [Path("FILE.h5")]))
            raise InputError(
                f"the {'target (--to NAME)' if files else 'body file'} is missing, such as: "
                f"morembs export {given} --to {to or 'exudyn'}; all targets: morembs export --list",
                kind="missing",
                keyword="to" if files else "files",
            )
        for file in files:
            note_input(str(file))  # also of those whose turn comes later
        if out is not None and len(files) > 1:
            raise InputError(
                f"--out {out} was given for {len(files)} files; without it each goes beside its own", keyword="out"
            )
        if table is not None:
            # Not at the top: few bodies have parameters.
            from morembs.app.cli.families import export_family

            if at is not None or len(files) > 1:
                raise InputError(
                    "--table was given with --at or several files; expected one file and a table",
                    kind="conflict",
                    keyword="table",
                )
            export_family(files[0], table, to, out, body, pairs(options), frame, as_json)
            return

    if check is not None:
        each_file(files, as_json, partial(_show_step, to=to, band_hz=check, body=body, options=pairs(options)))
        return
    taken: list[Path] = []

    def write(file: Path, documents: Documents) -> None:
        values = None if at is None else values_of(at)
        done = _export_body(file, to, out, body, pairs(options), frame, values, taken)
        taken.extend(done.paths)
        paths = [str(path) for path in done.paths]
        if documents is not None:
            documents.append({"file": str(file), "to": to, "written": paths, "notes": list(done.notes)})
            return
        with printing(paths):
            typer.echo("\n".join([f"written: {', '.join(paths)}", *(f"note: {note}" for note in done.notes)]))

    each_file(files, as_json, write)


def _show_step(
    file: Path, documents: Documents, *, to: str, band_hz: float, body: str | None, options: Mapping[str, object]
) -> None:
    """Print the time step for a band, or add it to the documents."""
    # Not at the top: help needs no exporter.
    from morembs.base.summary import upwards
    from morembs.exporters import step_for_band
    from morembs.exporters.tolerances import TOL

    found, errors = step_for_band(file, to, band_hz, body=body, options=options)
    if documents is not None:
        documents.append(
            {
                "file": str(file),
                "to": to,
                "band_hz": band_hz,
                "time_step_s": found.step,
                "modes": found.kept,
                "errors": errors,
            }
        )
        return
    shown = ", ".join(f"{kind} {upwards(error)}" for kind, error in errors.items()) or "none, all modes are there"
    typer.echo(f"time step for motion up to {band_hz:g} Hz: {found.step:g} s, {found.kept} of {found.count} modes")
    typer.echo(f"errors: {shown}")
    worst = max((error for kind, error in errors.items() if kind != "velocities"), default=0.0)
    if worst > TOL.real_time_error:
        typer.echo(f"note: no step that was looked at is within {TOL.real_time_error:g}; this is the shortest")


def _export_body(
    file: Path,
    to: str | None,
    out: Path | None,
    name: str | None,
    options: Mapping[str, object],
    frame: str | None,
    at: Mapping[str, float] | None,
    taken: Sequence[Path],
) -> Exported:
    """A body, or a planar member, written for another program."""
    # Not at the top: help needs no exporter.
    from morembs.exporters import export_body
    from morembs.storage.hdf5 import MEMBERS, holds_format

    target = to or ""
    if not holds_format(file, MEMBERS):
        return export_body(file, target, path=out, body=name, options=options, frame=frame, taken=taken, at=at)
    if frame is not None or at is not None:
        raise InputError(
            f"--frame or --at was given, and {file} holds planar members, which have neither; leave it out",
            kind="unsupported",
            keyword="frame",
        )
    # Not at the top: few files hold members.
    from morembs.dynamics.gmp.export import export_member

    return export_member(file, target, path=out, member=name, options=options, taken=taken)


def values_of(text: str | None, option: str = "--at") -> dict[str, float]:
    """Values by name of NAME=VALUE,NAME=VALUE.

    Raises:
        InputError: another form, a name twice, or no number.
    """
    values: dict[str, float] = {}
    parts = [part.replace(" ", "") for part in (text or "").split(",") if part.strip()]
    for name, value in pairs(parts, option).items():
        try:
            values[name] = float(value)
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise InputError(f"{option} {name}={value} was given; expected NAME=NUMBER,NAME=NUMBER")
    return values


def each_file(files: Sequence[Path], as_json: bool, work: Callable[[Path, Documents], None]) -> None:
    """Do ``work`` for each file: it prints, or adds to the documents; a file that fails does not stop the others.

    Raises:
        typer.Exit: some failed.
    """
    documents: list[dict[str, Any]] = []
    failed: list[Failure] = []
    for file in files:
        stopping.check()
        before = len(failed)
        with messages(failed, f"{file}: " if len(files) > 1 else ""):
            work(file, documents if as_json else None)
        if len(failed) > before and len(files) > 1:
            documents.append({"file": str(file), **failed[-1].document()})
    if documents and as_json:
        written = [path for document in documents for path in document.get("written", ())]
        with messages(failed), printing(written):
            print_json(documents)
    if failed:
        raise typer.Exit(min(fault.code for fault in failed))


@app.command(cls=Verb, epilog=example("morembs recover part.h5 motion.csv -o motion.vtkhdf"))
def recover(
    file: BodyFile,
    trajectory: Annotated[
        Path,
        typer.Argument(
            metavar="TRAJECTORY",
            help="Coordinates over time, .npz .csv .txt .h5.",
            show_default=False,
            autocompletion=files_with(".npz", ".csv", ".txt", ".h5"),
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The .vtkhdf file to write.", show_default=False)],
    body: BodyName = None,
    no_stress: Annotated[bool, typer.Option("--no-stress", help="Displacements only.")] = False,
    scale: Annotated[float, typer.Option(help="Magnify deformations.")] = 1.0,
    every: Annotated[int, typer.Option(help="Take every n-th step.")] = 1,
    at: Annotated[
        str | None, typer.Option("--at", metavar="NAME=VALUE,...", help="Values of parameters, with --no-stress.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Expand a reduced motion to all nodes, with stresses, for ParaView."""
    from morembs.body.recovery.recover import recover as recover_series

    with messages():
        if at is not None and not no_stress:
            raise InputError(
                "--at was given with stress, whose shapes hold at nominal values only; add --no-stress", keyword="at"
            )
        with progress_line(), _evaluated(file, body, at) as source:
            done = recover_series(source, trajectory, out, body=body, stress=not no_stress, scale=scale, every=every)
        with printing([str(done.path)]):
            _print_recovered(done, as_json)


@contextmanager
def _evaluated(file: Path, body: str | None, at: str | None) -> Iterator[Path]:
    """The body file, or that of other values of its parameters for as long as it is needed."""
    if at is None:
        yield file
        return
    # Not at the top: few bodies have parameters.
    from morembs.app.cli.families import parametric_of

    # An empty folder without an owner is cleared by any other run that begins meanwhile.
    with closing(ScratchFolder(None)) as folder:
        yield parametric_of(file, body).at(**values_of(at)).write(folder.path / file.name)


def _print_recovered(done: Recovered, as_json: bool) -> None:
    peak, worst = (_label_largest(*each) for each in ((done.peak, "von_mises_pa"), (done.worst_jump, "jump_pa")))
    if as_json:
        if peak is not None:
            peak["jump_pa"] = done.peak_jump
        print_json(
            [
                {
                    "written": str(done.path),
                    "body": done.body,
                    "steps": done.steps,
                    "nodes": done.nodes,
                    "peak": peak,
                    "worst_jump": worst,
                    "notes": list(done.notes),
                }
            ]
        )
        return
    typer.echo(f"written: {done.path}, {done.steps} steps of body {done.body} at {done.nodes:,} nodes")
    if done.peak is not None:
        stress, node, time = done.peak
        near = ""
        if done.peak_jump is not None and stress > 0:
            near = f"; elements around it miss the average by {done.peak_jump / stress:.1%}"
        typer.echo(f"largest von Mises stress: {stress / 1e6:,.4g} MPa at node {node}, {time:g} s{near}")
    if done.peak is not None and done.worst_jump is not None and done.peak[0] > 0:
        jump, node, time = done.worst_jump
        typer.echo(
            f"largest jump between elements: {jump / 1e6:,.4g} MPa ({jump / done.peak[0]:.1%} of that stress) at "
            f"node {node}, {time:g} s"
        )
    for note in done.notes:
        typer.echo(f"note: {note}")


def _label_largest(largest: tuple[float, int, float] | None, key: str) -> dict[str, Any] | None:
    """A largest value with its node and its time, by their names."""
    return None if largest is None else dict(zip((key, "node", "time_s"), largest, strict=True))
