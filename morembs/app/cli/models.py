"""Verbs of the command line that make model files."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from morembs.app.cli.messages import print_json, print_names, printing
from morembs.app.cli.terminal import EPILOG, AsJson, messages, progress_line
from morembs.app.cli.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.options import pairs

if TYPE_CHECKING:
    from morembs.app.jobs.import_job import ImportJob, ImportResult

app = typer.Typer()


class _Asked(TyperCommand):
    """A command that keeps its command line in the context."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As of click."""
        ctx.meta[_Asked.__name__] = list(args)
        return super().parse_args(ctx, args)


@app.command("import", cls=_Asked, epilog=EPILOG)
def import_model(
    context: typer.Context,
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="[FILE]", help="The file of the model.", show_default=False)
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The model file to write, NAME.model.h5.")] = None,
    format: Annotated[str | None, typer.Option(help="The format, one that --list names.")] = None,
    units: Annotated[str, typer.Option(help="Length, mass and time of the files.")] = "m-kg-s",
    stiffness: Annotated[Path | None, typer.Option(help="A file with K alone.")] = None,
    mass: Annotated[Path | None, typer.Option(help="A file with M alone.")] = None,
    damping: Annotated[Path | None, typer.Option(help="A file with D alone.")] = None,
    gyroscopic: Annotated[Path | None, typer.Option(help="A file with G alone, skew-symmetric.")] = None,
    circulatory: Annotated[Path | None, typer.Option(help="A file with N alone, which joins K.")] = None,
    nodes: Annotated[Path | None, typer.Option(help="A mesh that gives nodes to matrices.")] = None,
    dofs: Annotated[Path | None, typer.Option(help="A table node,dof of the rows (.csv).")] = None,
    material: Annotated[
        list[str] | None, typer.Option(help="For sets without: young=..,poisson=..,density=..[,set=NAME].")
    ] = None,
    mass_integration: Annotated[str, typer.Option(help="For a mesh: element, exact or reduced.")] = "element",
    dialect: Annotated[
        str, typer.Option(help="The program that an .inp was written for: auto, abaqus or calculix.")
    ] = "auto",
    density: Annotated[
        list[str] | None, typer.Option(help="For materials with stiffness only: X or X,set=NAME, in units of the deck.")
    ] = None,
    contact: Annotated[str, typer.Option(help="Contact of a deck: refuse, skip, or tie (glue).")] = "refuse",
    skip: Annotated[
        list[str] | None, typer.Option(help="Keywords, cards or element types to leave out, between commas.")
    ] = None,
    engine: Annotated[
        str | None, typer.Option(help="Who assembles a deck: calculix or mystran (NAME:PATH), or auto.")
    ] = None,
    boundary: Annotated[str, typer.Option(help="With --engine: drop what the deck holds, or keep it.")] = "drop",
    preload: Annotated[int, typer.Option(help="With --engine: the steps up to this one run first.")] = 0,
    engine_timeout: Annotated[
        float, typer.Option(help="With --engine: seconds for each run of it.")
    ] = TOL.engine_seconds,
    keep_files: Annotated[
        Path | None, typer.Option(metavar="DIR", help="With --engine: a folder for what it read and wrote.")
    ] = None,
    option: Annotated[list[str] | None, typer.Option("--set", help="An option of the format, KEY=VALUE.")] = None,
    allow_includes_outside: Annotated[
        bool, typer.Option("--allow-includes-outside", help="Decks may include files from beyond their folders.")
    ] = False,
    split: Annotated[
        bool, typer.Option("--split", help="A file for each part that nothing joins to others: NAME-1.model.h5, ...")
    ] = False,
    check: Annotated[bool, typer.Option("--check", help="Examine the model and print what is found.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="As --check; errors stop the import.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Tell all problems and notes, write nothing.")] = False,
    listed: Annotated[bool, typer.Option("--list", help="List the formats and engines.")] = False,
    as_json: AsJson = False,
) -> None:
    """Convert a model of another program into a model file that jobs read."""
    from morembs.app.jobs.import_job import ImportJob, list_engines, list_formats, material_of, run_import
    from morembs.base.units import parse_units
    from morembs.importers.decks.options import density_of
    from morembs.importers.decks.problems import DeckError

    command = _command(context.meta[_Asked.__name__])
    with messages():
        if listed:
            engines = list_engines()
            print_names({**list_formats(), **engines}, as_json, dict.fromkeys(engines, "--engine "))
            return
        named = {"K": stiffness, "M": mass, "D": damping, "G": gyroscopic, "N": circulatory}
        job = ImportJob(
            out=_model_file(Path("dry.model.h5") if dry_run and out is None else out),
            file=_only_file(files or []),
            format=format,
            units=parse_units(units),
            nodes=nodes,
            dofs=dofs,
            matrices={role: path for role, path in named.items() if path is not None},
            materials=tuple(material_of(text) for text in material or []),
            mass_integration=mass_integration,
            dialect=dialect,
            density=density_of(density or []),
            contact=contact,
            skip=tuple(word.strip() for text in skip or [] for word in text.split(",") if word.strip()),
            engine=engine,
            engine_options=_engine_options(boundary, preload, engine_timeout, keep_files),
            options=pairs(option or []),
            allow_includes_outside=allow_includes_outside,
            split=split,
        )
        if dry_run:
            _dry_run(job, command, check=check, strict=strict, as_json=as_json)
            return
        try:
            with progress_line() as progress:
                done = run_import(job, check=check, strict=strict, progress=progress)
        except DeckError as error:
            raise InputError("\n".join(error.asked(command).lines())) from None
        parts = [done, *done.others]
        with printing([str(part.path) for part in parts]):
            if as_json:
                print_json([_document(part) for part in parts])
            else:
                typer.echo("\n".join(line for part in parts for line in _lines(part)))


def _command(arguments: list[str]) -> str:
    """The command line quoted for a shell; a dry run that knows where to write goes on to be none."""
    writes = any(argument == "-o" or argument.startswith("--out") for argument in arguments)
    return shlex.join(["morembs", "import", *(word for word in arguments if not (writes and word == "--dry-run"))])


def _model_file(out: Path | None) -> Path:
    if out is None:
        raise InputError("import needs the name of the model file to write: morembs import FILE -o NAME.model.h5")
    if not out.name.endswith((".h5", ".hdf5")):
        raise InputError(f"--out {str(out)!r} was given; expected a name that ends in .h5, such as part.model.h5")
    return out


def _only_file(files: list[Path]) -> Path | None:
    if len(files) > 1:
        raise InputError(
            f"{len(files)} files were given; expected one with the whole model, or --stiffness FILE --mass FILE "
            "for matrices in files of their own, and --nodes FILE for their mesh"
        )
    return files[0] if files else None


def _engine_options(boundary: str, preload: int, timeout: float, keep: Path | None) -> dict[str, Any]:
    """The options of engines that are not as they are by default."""
    given = {
        "boundary": (boundary, "drop"),
        "preload": (preload, 0),
        "timeout": (timeout, TOL.engine_seconds),
        "keep_files": ("" if keep is None else str(keep), ""),
    }
    return {name: value for name, (value, default) in given.items() if value != default}


def _dry_run(job: ImportJob, command: str, *, check: bool, strict: bool, as_json: bool) -> None:
    """What an import would say; nothing is written.

    Raises:
        typer.Exit: the model cannot be imported, with code 2.
    """
    from morembs.app.jobs.import_job import run_import
    from morembs.importers.decks.problems import DeckError, in_lines

    try:
        with progress_line() as progress:
            done = run_import(job, check=check, strict=strict, dry=True, progress=progress)
    except DeckError as error:
        answer = error.asked(command).answer
        with printing():
            if as_json:
                print_json(
                    [
                        {
                            "importable": False,
                            "command": answer,
                            "problems": [
                                {
                                    "what": p.what,
                                    "file": p.file,
                                    "line": p.line,
                                    "keyword": p.keyword,
                                    "flags": list(p.flags),
                                }
                                for p in error.problems
                            ],
                        }
                    ]
                )
            else:
                lines = [line for p in error.problems for line in in_lines(f"problem: {p.placed}")]
                lines += [f"all of it is answered by: {answer}"] if answer else []
                lines += [error.hint] if error.hint else []
                typer.echo("\n".join([*lines, f"{error.source} cannot be imported: {len(error.problems)} problems"]))
        raise typer.Exit(2) from None
    with printing():
        if as_json:
            documents = [_document(part) for part in (done, *done.others)]
            print_json([{"importable": True, **{k: v for k, v in d.items() if k != "written"}} for d in documents])
        else:
            for part in (done, *done.others):
                size, nodes = part.model.size, len(part.model.nodes)
                first = f"can be imported: {size:,} dofs at {nodes:,} nodes, read as {part.format}; nothing was written"
                typer.echo("\n".join([first, *_lines(part)[1:]]))


def _document(done: ImportResult) -> dict[str, Any]:
    from morembs.app.cli.messages import without_nan
    from morembs.app.cli.report_stored import findings_json

    model = done.model
    return {
        "written": str(done.path),
        "format": done.format,
        "dofs": model.size,
        "nodes": len(model.nodes),
        "elements": 0 if model.mesh is None else sum(len(block.ids) for block in model.mesh.blocks),
        "matrices": [name for name in ("K", "M", "D", "G", "N") if getattr(model, name) is not None],
        "body": None
        if done.outlook is None
        else {
            "extent": list(done.outlook.extent),
            "mass": without_nan(done.outlook.mass),
            "first_hz": without_nan(done.outlook.first_hz),
        },
        "warnings": list(done.warnings),
        "sets": sorted(model.nodes.sets),
        "couplings": list(model.couplings),
        "notes": list(model.notes),
        "findings": findings_json(done.diagnosis),
    }


def _lines(done: ImportResult) -> list[str]:
    model = done.model
    lines = [f"written: {done.path}, {model.size:,} dofs at {len(model.nodes):,} nodes, read as {done.format}"]
    if model.couplings:
        lines.append(f"couplings: {', '.join(model.couplings)}")
    lines += [f"note: {note}" for note in model.notes]
    if done.outlook is not None:
        lines.insert(1, f"the body: {done.outlook.words}")
    # An examination finds what is warned of without one, and says more.
    examination = "" if done.diagnosis is None else done.diagnosis.text()
    lines += [f"warning: {text}" for text in done.warnings if text not in examination]
    return lines + ([examination] if examination else [])
