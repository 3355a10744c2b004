"""Verbs of the command line that make model files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from morembs.cli.messages import print_json, printing
from morembs.cli.terminal import EPILOG, AsJson, messages, progress_line
from morembs.errors import InputError
from morembs.options import pairs
from morembs.units import parse_units

if TYPE_CHECKING:
    from morembs.jobs.import_job import ImportResult

app = typer.Typer()


@app.command("import", epilog=EPILOG)
def import_model(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="[FILE]", help="The file of the model.", show_default=False)
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The model file to write, NAME.model.h5.")] = None,
    format: Annotated[str | None, typer.Option(help="The format, one that --list names.")] = None,
    units: Annotated[str, typer.Option(help="Length, mass and time of the files.")] = "m-kg-s",
    stiffness: Annotated[Path | None, typer.Option(help="A file with K alone.")] = None,
    mass: Annotated[Path | None, typer.Option(help="A file with M alone.")] = None,
    damping: Annotated[Path | None, typer.Option(help="A file with D alone.")] = None,
    nodes: Annotated[Path | None, typer.Option(help="A mesh that gives nodes to matrices.")] = None,
    dofs: Annotated[Path | None, typer.Option(help="A table node,dof of the rows (.csv).")] = None,
    material: Annotated[
        list[str] | None, typer.Option(help="For a mesh: young=..,poisson=..,density=..[,set=NAME].")
    ] = None,
    mass_integration: Annotated[str, typer.Option(help="For a mesh: element, exact or reduced.")] = "element",
    dialect: Annotated[
        str, typer.Option(help="The program that an .inp was written for: auto, abaqus or calculix.")
    ] = "auto",
    option: Annotated[list[str] | None, typer.Option("--set", help="An option of the format, KEY=VALUE.")] = None,
    allow_includes_outside: Annotated[
        bool, typer.Option("--allow-includes-outside", help="Decks may include files from beyond their folders.")
    ] = False,
    check: Annotated[bool, typer.Option("--check", help="Examine the model and print what is found.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="As --check; errors stop the import.")] = False,
    listed: Annotated[bool, typer.Option("--list", help="List the formats.")] = False,
    as_json: AsJson = False,
) -> None:
    """Convert a model of another program into a model file that jobs read."""
    from morembs.jobs.import_job import ImportJob, list_formats, material_of, run_import

    if listed:
        formats = list_formats()
        with messages(), printing():
            if as_json:
                print_json([{"name": name, "about": about} for name, about in formats.items()])
            else:
                typer.echo("\n".join(f"{name}: {about}" for name, about in formats.items()))
        return
    with messages():
        if out is None:
            raise InputError("import needs the name of the model file to write: morembs import FILE -o NAME.model.h5")
        if not out.name.endswith((".h5", ".hdf5")):
            raise InputError(f"--out {str(out)!r} was given; expected a name that ends in .h5, such as part.model.h5")
        if files is not None and len(files) > 1:
            raise InputError(
                f"{len(files)} files were given; expected one with the whole model, or --stiffness FILE --mass FILE "
                "for matrices in files of their own, and --nodes FILE for their mesh"
            )
        named = {"K": stiffness, "M": mass, "D": damping}
        given = parse_units(units)
        job = ImportJob(
            out=out, file=files[0] if files else None, format=format, units=given, nodes=nodes, dofs=dofs,
            matrices={role: path for role, path in named.items() if path is not None},
            materials=tuple(material_of(text) for text in material or []), mass_integration=mass_integration,
            dialect=dialect, options=pairs(option or []), allow_includes_outside=allow_includes_outside,
        )  # fmt: skip
        with progress_line() as progress:
            done = run_import(job, check=check, strict=strict, progress=progress)
        with printing([str(done.path)]):
            if as_json:
                print_json([_document(done)])
            else:
                typer.echo("\n".join(_lines(done)))


def _document(done: ImportResult) -> dict[str, Any]:
    from morembs.cli.report import without_nan
    from morembs.cli.report_stored import findings_json

    model = done.model
    return {
        "written": str(done.path), "format": done.format, "dofs": model.size, "nodes": len(model.nodes),
        "elements": 0 if model.mesh is None else sum(len(block.ids) for block in model.mesh.blocks),
        "matrices": [name for name in ("K", "M", "D") if getattr(model, name) is not None],
        "body": None if done.outlook is None else {
            "extent": list(done.outlook.extent), "mass": without_nan(done.outlook.mass),
            "first_hz": without_nan(done.outlook.first_hz),
        },
        "warnings": list(done.warnings),
        "sets": sorted(model.nodes.sets), "couplings": list(model.couplings), "notes": list(model.notes),
        "findings": findings_json(done.diagnosis),
    }  # fmt: skip


def _lines(done: ImportResult) -> list[str]:
    model = done.model
    lines = [f"written: {done.path}, {model.size:,} dofs at {len(model.nodes):,} nodes, read as {done.format}"]
    if model.couplings:
        lines.append(f"couplings: {', '.join(model.couplings)}")
    lines += [f"note: {note}" for note in model.notes]
    if done.outlook is not None:
        lines.insert(1, f"the body: {done.outlook.words}")
    # An examination finds what is warned of without one, and says more.
    found = "" if done.diagnosis is None else done.diagnosis.text()
    lines += [f"warning: {text}" for text in done.warnings if text not in found]
    return lines + ([found] if found else [])
