"""The command that begins: a first job for a part, or an example."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from morembs.app.cli.completion import match_start, names_of, parts
from morembs.app.cli.messages import printing
from morembs.app.cli.terminal import Verb, messages
from morembs.app.cli.terminal import example as shown
from morembs.base.errors import InputError

if TYPE_CHECKING:
    from morembs.base.units import Units

app = typer.Typer()


def _complete_part(ctx: typer.Context, incomplete: str) -> list[str]:
    """Examples after --example, else parts."""
    if ctx.params.get("example"):
        from morembs.examples import EXAMPLES

        return match_start(EXAMPLES, incomplete)
    return parts(incomplete)


@app.command(cls=Verb, epilog=shown("morembs init part.msh --units mm-t-s"))
def init(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="PART",
            help="A mesh, deck, model file, CAD part, .mat or .npz; or an example.",
            show_default=False,
            autocompletion=_complete_part,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The job to write, by default beside the file.")
    ] = None,
    units: Annotated[
        str | None,
        typer.Option(
            help="Length, mass and time of the mesh.",
            show_default="by its size m-kg-s or mm-t-s",
            autocompletion=names_of("morembs.body.diagnostics.units", "SYSTEMS"),
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(help="Largest element of a CAD part, such as 3mm.", show_default="a twentieth of its length"),
    ] = None,
    show: Annotated[bool, typer.Option("--show", help="Print the job, write nothing.")] = False,
    example: Annotated[
        bool, typer.Option("--example", help="Write an example and its job: rod, bracket, deck or matrices.")
    ] = False,
) -> None:
    """Write a first job for a mesh, a deck, a model file or a CAD part, or a first system for a body, with comments."""
    from morembs.app.jobs.template import job_text, refuse_existing
    from morembs.app.kinds import BODY, CAD_PART, MEMBER, PART, instead, kind_of
    from morembs.base.units import parse_units
    from morembs.storage.safefile import replacing

    with messages():
        if example:
            given = {"--units": units, "--show": show, "--size": size}
            _write_example(file, out, next((option for option, value in given.items() if value), ""))
            return
        if file is None:
            raise InputError(f"init needs {PART}: morembs init part.msh; or, to try it: morembs init --example")
        if file.is_dir():
            raise InputError(f"{file} is a folder; expected {PART}", kind="file")
        if kind_of(file) in (BODY, MEMBER) and file.exists():
            given = {"--units": units, "--size": size}
            _write_system(file, out, show, next((option for option, value in given.items() if value), ""))
            return
        other = instead(file, PART)
        if other:
            raise InputError(f"{file}: {other}")
        job = _job_of(file.name.partition(".")[0], file.parent, out)
        if not show and file.exists():
            refuse_existing(job)
        declared = None if units is None else parse_units(units)
        sources = ""
        if kind_of(file) is CAD_PART:
            file, sources, declared = _mesh_part(file, job, size, declared, show)
        elif size is not None:
            raise InputError(f"{file} has its elements; --size is for CAD parts: morembs init part.step --size 3mm")
        text = job_text(file, job.parent, declared)
        if show:
            with printing():
                typer.echo(f"{text}\n# This job: morembs init {file}; then: morembs reduce {job}")
            return
        with replacing(job) as written:
            written.write(text.encode())
        with printing([str(job)]):
            then = f"morembs check {shlex.quote(str(job))}"
            typer.echo(f"written: {sources}{job}; look at its units, materials and interfaces, then: {then}")


def _write_system(file: Path, out: Path | None, show: bool, refused: str) -> None:
    """Write, or only print, a first system for a file of bodies or members, and say the next command."""
    # Not at the top: a job is what is wanted most.
    from morembs.app.jobs.template import refuse_existing
    from morembs.app.simulations.template import system_text
    from morembs.storage.safefile import replacing

    if refused:
        raise InputError(f"a body file is in SI units and has its elements; leave {refused} out")
    system = _job_of(f"{file.name.partition('.')[0]}.system", file.parent, out)
    text = system_text(file, system.parent)
    if show:
        with printing():
            typer.echo(text, nl=False)
        return
    refuse_existing(system)
    with replacing(system) as written:
        written.write(text.encode())
    with printing([str(system)]):
        typer.echo(f"written: {system}; then: morembs simulate {shlex.quote(str(system))}")


def _job_of(name: str, folder: Path, out: Path | None) -> Path:
    """The job to write.

    Raises:
        InputError: the name that is given does not end in .toml.
    """
    job = folder / f"{name}.toml" if out is None else out
    if job.suffix != ".toml":
        raise InputError(f"--out {str(job)!r} was given; expected a name that ends in .toml", keyword="out")
    return job


def _mesh_part(part: Path, job: Path, size: str | None, declared: Units | None, show: bool) -> tuple[Path, str, Units]:
    """Mesh a CAD part beside the job: the mesh, what is said of it, its units.

    Raises:
        InputError: a mesh of this name is there, other units, no such size, or Gmsh cannot mesh the part.
    """
    from morembs.base.units import LENGTH, parse_units
    from morembs.importers.cad import mesh_cad, parse_size

    if not part.is_file():
        raise InputError(f"{part} is not there; check the path", kind="file")
    command = f"morembs init {shlex.quote(str(part))} --size {size or '3mm'}"
    if show:
        raise InputError(f"{part} is a CAD part, which has to be meshed first: {command}")
    if declared is not None and declared.length != LENGTH["mm"]:
        raise InputError(
            f"--units {declared.name} was given, but a CAD part is meshed in mm; leave --units out", keyword="units"
        )
    mesh = job.with_suffix(".msh")
    if mesh.exists():
        raise InputError(f"{mesh} is there already; give another name: {command} -o NAME.toml", kind="output")
    taken = mesh_cad(part, mesh, None if size is None else parse_size(size))
    return mesh, f"{mesh} (elements up to {taken:g} mm), ", declared or parse_units("mm-t-s")


def _write_example(name: Path | None, out: Path | None, refused: str) -> None:
    """Write an example, rod where none is named, and say the next command."""
    from morembs.app.jobs.template import write_example
    from morembs.base.errors import nearest
    from morembs.examples import EXAMPLES

    chosen = "rod" if name is None else str(name)
    if chosen not in EXAMPLES:
        raise InputError(f"there is no example {chosen!r}; {nearest(chosen, EXAMPLES)}", kind="unknown")
    if refused:
        raise InputError(f"an example is written as it is; leave {refused} out")
    job = _job_of(chosen, Path(), out)
    write_example(chosen, job)
    with printing([str(job)]):
        files = ", ".join(str(job.parent / file) for file in EXAMPLES[chosen].files)
        typer.echo(f"written: {files}, {job}; then: morembs reduce {shlex.quote(str(job))}")
