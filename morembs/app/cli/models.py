"""Verbs of the command line that make model files."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from functools import cache, partial
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from morembs.app.cli.completion import Offer, match_start, models, names_of
from morembs.app.cli.messages import print_json, print_names, printing
from morembs.app.cli.terminal import AsJson, Verb, example, messages, progress_line
from morembs.base.errors import InputError
from morembs.base.options import pairs

if TYPE_CHECKING:
    from morembs.app.jobs.import_job import ImportResult
    from morembs.fem.material import Material
    from morembs.importers.options import ImportOptions

app = typer.Typer()
IMPORT_EXAMPLE = example("morembs import part.inp --units mm-t-s -o part.model.h5")


class _Import(TyperCommand):
    """The verb as lists of verbs show it; its options are loaded where it is used."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """That of the command with its options, which keeps its command line."""
        context = import_command().make_context(info_name, [*args], parent, **extra)
        context.meta[COMMAND_LINE] = args
        return context


COMMAND_LINE = "morembs.command_line"


@app.command("import", cls=_Import, epilog=IMPORT_EXAMPLE)
def import_model() -> None:
    """Convert a model of another program into a model file that jobs read."""


def _refuse_job(file: Path) -> None:
    """A file that the importers need not be asked about."""
    from morembs.app.kinds import JOB, SYSTEM, kind_of

    kind = kind_of(file)
    if kind in (JOB, SYSTEM) and kind is not None and file.is_file():
        raise InputError(
            f"{file}: {kind.name} was given, expected a model, a deck or a mesh: morembs check {shlex.quote(str(file))}"
        )


# How options look whose text has parts.
_METAVARS = {
    "format": "NAME",
    "units": "L-M-T",
    "density": "X[,set=NAME]",
    "skip": "WORD[,WORD]",
    "engine": "NAME[:PATH]",
    "preload": "STEPS",
    "engine_timeout": "SECONDS",
    "set": "KEY=VALUE",
    "keep_files": "DIR",
}

# Names that options take from tables.
_OFFERED = {
    "format": names_of("morembs.importers", "IMPORTERS"),
    "engine": names_of("morembs.importers.engines", "ENGINES"),
    "units": names_of("morembs.body.diagnostics.units", "SYSTEMS"),
}


def _import(
    context: typer.Context,
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]", help="The file of the model.", show_default=False, autocompletion=models),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The model file to write, NAME.model.h5.")] = None,
    material: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=X,...",
            help="For sets without: young=..,poisson=..,density=..[,set=NAME].",
            rich_help_panel="Decks",
        ),
    ] = None,
    split: Annotated[
        bool, typer.Option("--split", help="A file for each part that nothing joins to others: NAME-1.model.h5, ...")
    ] = False,
    check: Annotated[bool, typer.Option("--check", help="Examine the model and print what is found.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="As --check; errors stop the import.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Tell all problems and notes, write nothing.")] = False,
    listed: Annotated[bool, typer.Option("--list", help="List the formats and engines.")] = False,
    as_json: AsJson = False,
    **given: Any,
) -> None:
    """Convert a model of another program into a model file that jobs read."""
    from morembs.app.jobs.import_job import run_import
    from morembs.importers.decks.problems import DeckError

    command = _command(context.meta[COMMAND_LINE])
    with messages():
        if listed:
            engines = _list_engines()
            print_names({**_list_formats(), **engines}, as_json, dict.fromkeys(engines, "--engine "))
            return
        target = _model_file(Path("dry.model.h5") if dry_run and out is None else out, files or [], command)
        file = _only_file(files or [])
        if file is not None and given["format"] is None:
            _refuse_job(file)
        options = _options_given(file, given)
        run = partial(
            run_import, target, options, materials=_materials(material), split=split, check=check, strict=strict
        )
        if dry_run:
            _dry_run(run, command, as_json=as_json)
            return
        try:
            with progress_line() as progress:
                done = run(progress=progress)
        except DeckError as error:
            raise error.restate("\n".join(error.of_command(command).lines())) from None
        parts = [done, *done.others]
        with printing([str(part.path) for part in parts]):
            if as_json:
                print_json([_document(part) for part in parts])
            else:
                typer.echo("\n".join(line for part in parts for line in _lines(part)))


_import.__doc__ = import_model.__doc__


@cache
def import_command() -> Any:
    """An option for each field of ``ImportOptions``; these are loaded only where it is used."""
    own = signature(_import, eval_str=True).parameters
    context, first, *others = (parameter for parameter in own.values() if parameter.kind is not Parameter.VAR_KEYWORD)
    parameters = [context, first, *_import_options(), *others]
    _import.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    _import.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    verb = typer.Typer(add_completion=False)
    verb.command("import", cls=Verb, epilog=IMPORT_EXAMPLE)(_import)
    return typer.main.get_command(verb)


def _import_options() -> Iterator[Parameter]:
    """Parameters of the command line for the options that are not its argument."""
    from morembs.base.arguments import hints_of
    from morembs.base.limits import choices
    from morembs.importers.options import OF_DECKS, OF_ENGINES, OF_MATRICES, PATHS, ImportOptions, default_of

    panels = dict.fromkeys(OF_MATRICES, "Files of matrices") | dict.fromkeys((*OF_DECKS, "mass_integration"), "Decks")
    panels |= dict.fromkeys(("engine", *OF_ENGINES), "Decks that another program assembles")
    hints = hints_of(ImportOptions)
    for entry in fields(ImportOptions):
        name, default, meaning = entry.name, default_of(entry), entry.metadata["meaning"].replace("`", "")
        if name == "file":
            continue
        values = choices(hints[name])
        several = name in ("density", "skip", "set")
        kind: Any = list[str] | None if several else type(default) if default is not None else str | None
        shown = typer.Option(
            f"--{name.replace('_', '-')}",
            metavar=_METAVARS.get(name, "FILE" if name in PATHS else "|".join(values) or None),
            help=f"{meaning[0].upper()}{meaning[1:]}.",
            autocompletion=_OFFERED.get(name) or (_one_of(values) if values else None),
            rich_help_panel=panels.get(name),
        )
        yield Parameter(
            name,
            Parameter.POSITIONAL_OR_KEYWORD,
            default=None if several else default,
            annotation=Annotated[kind, shown],
        )


def _one_of(values: Sequence[str]) -> Offer:
    return lambda incomplete: match_start(values, incomplete)


def _options_given(file: Path | None, given: dict[str, Any]) -> ImportOptions:
    """The options of the command line."""
    from morembs.base.units import parse_units
    from morembs.importers.decks.options import density_of
    from morembs.importers.options import read_import_options

    parse_units(given["units"])
    words = [word.strip() for text in given["skip"] or [] for word in text.split(",") if word.strip()]
    texts = {
        "density": density_of(given["density"] or []) or None,
        "skip": words or None,
        "set": pairs(given["set"] or []),
    }
    return read_import_options(**{**given, **texts, "file": file})


def _materials(texts: Sequence[str] | None) -> tuple[Material, ...]:
    """Materials in the units of the files from "young=210e3,poisson=0.3,density=7.85e-9[,set=NAME]" each.

    Raises:
        InputError: unknown, missing or repeated keys, or values that make no material.
    """
    return tuple(_material(text) for text in texts or [])


def _material(text: str) -> Material:
    from morembs.fem.material import isotropic

    given: dict[str, str] = {}
    for part in text.split(","):
        key, equals, value = part.partition("=")
        if not equals or key.strip() in given or key.strip() not in ("young", "poisson", "density", "set"):
            raise InputError(
                f"--material {text!r} was given; expected young=...,poisson=...,density=... and for one element set "
                ",set=NAME"
            )
        given[key.strip()] = value.strip()
    missing = [key for key in ("young", "poisson", "density") if key not in given]
    if missing:
        raise InputError(
            f"--material {text!r} was given; {' and '.join(missing)} is missing: add {missing[0]}=NUMBER",
            kind="missing",
        )
    try:
        numbers = {key: float(given[key]) for key in ("young", "poisson", "density")}
    except ValueError as error:
        raise InputError(f"--material {text!r} was given; expected numbers young, poisson and density") from error
    return isotropic(set=given.get("set", "all"), **numbers)


def _list_engines() -> dict[str, str]:
    """A line for each program that may assemble decks: its description and its place."""
    from morembs.importers.engines import ENGINES

    lines = {}
    for name, engine in ENGINES.items():
        try:
            program = engine.find("")
            place = f"{program.name}{f' {program.version}' if program.version else ''} at {program.path}"
        except InputError:
            place = "not found"
        lines[name] = f"{engine.about} ({place})"
    return lines


def _list_formats() -> dict[str, str]:
    """A line for each format."""
    from morembs.importers import IMPORTERS

    return {
        name: importer.about + (f" ({', '.join(importer.endings)})" if importer.endings else "")
        for name, importer in IMPORTERS.items()
    }


def _command(arguments: list[str]) -> str:
    """The command line quoted for a shell; a dry run that knows where to write goes on to be none."""
    writes = any(argument == "-o" or argument.startswith("--out") for argument in arguments)
    return shlex.join(["morembs", "import", *(word for word in arguments if not (writes and word == "--dry-run"))])


def _model_file(out: Path | None, files: list[Path], command: str) -> Path:
    if out is None:
        file = files[0] if files else Path("FILE")
        name = f"{file.name.partition('.')[0] if files else 'NAME'}.model.h5"
        typed = command if files else "morembs import FILE"
        cure = f"{typed} -o {shlex.quote(name)}"
        raise InputError(f"the name of the model file is missing; add it: {cure}", kind="missing", keyword="out")
    if not out.name.endswith((".h5", ".hdf5")):
        raise InputError(
            f"--out {str(out)!r} was given; expected a name that ends in .h5, such as part.model.h5", keyword="out"
        )
    return out


def _only_file(files: list[Path]) -> Path | None:
    if len(files) > 1:
        raise InputError(
            f"{len(files)} files were given; expected one with the whole model, or --stiffness FILE --mass FILE "
            "for matrices in files of their own, and --nodes FILE for their mesh"
        )
    return files[0] if files else None


def _dry_run(run: Callable[..., ImportResult], command: str, *, as_json: bool) -> None:
    """What an import would say; nothing is written.

    Raises:
        typer.Exit: the model cannot be imported, with code 2.
    """
    from morembs.importers.decks.problems import DeckError, in_lines

    try:
        with progress_line() as progress:
            done = run(dry=True, progress=progress)
    except DeckError as error:
        answer = error.of_command(command).answer
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
                                    "kind": p.kind,
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
                lines += [f"cure of all problems: {answer}"] if answer else []
                lines += [error.hint] if error.hint else []
                count = "1 problem" if len(error.problems) == 1 else f"{len(error.problems)} problems"
                typer.echo("\n".join([*lines, f"{error.source} cannot be imported: {count}"]))
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
