"""The verb that simulates systems of bodies."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from morembs.app.cli.completion import JOBS, files_with
from morembs.app.cli.messages import console, printing, warn
from morembs.app.cli.terminal import AsJson, Changes, Done, Quiet, Verb, each_job, example
from morembs.base.progress import Progress

app = typer.Typer()


@app.command(cls=Verb, epilog=example("morembs simulate swing.toml -o swing.h5"))
def simulate(
    system: Annotated[
        Path,
        typer.Argument(
            metavar="SYSTEM.toml", help="A system of bodies.", show_default=False, autocompletion=files_with(*JOBS)
        ),
    ],
    changes: Changes = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The result, in place of [output] path.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write a page with pictures: an .html file.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a system of bodies: joints, loads, contact, from a file."""
    from morembs.app.pages.page import check_report
    from morembs.app.simulations.run import run_system
    from morembs.app.simulations.system_file import load_system

    # Seen from the working directory, not from the folder of the system.
    every = [*([] if out is None else [f"output.path={out.absolute()}"]), *(changes or ())]

    def work(path: Path, progress: Progress) -> Done:
        file = load_system(path, every)
        check_report(report)
        document = run_system(file, progress, warn).document()
        if report is not None:
            # Not at the top: few runs have a page.
            from morembs.app.pages.simulation import write_simulation_page

            progress.stage("write report")
            write_simulation_page(report, path, file.output, document)
            document["written"].append(str(report))
        return document, lambda: print_simulation(document)

    each_job([system], as_json, work, quiet)


def print_simulation(document: Mapping[str, Any]) -> None:
    """A finished run, by its document."""
    from morembs.app.report.text import print_sections, print_written, say
    from morembs.app.simulations.report import sections_of

    print_sections(console(), sections_of(document["job"], document))
    say(console(), *(f"note: {note}" for note in document["notes"]))
    say(console(), *(f"warning: {text}" for text in document["warnings"] if not console().is_terminal))
    print_written(console(), document["written"])


def show_recording(path: Path, documents: list[dict[str, Any]] | None) -> None:
    """Print what the file of a simulation holds, or add it to the ``documents``.

    Raises:
        InputError: the file is damaged, or of a newer version.
    """
    from morembs.app.report.text import print_sections, say
    from morembs.app.simulations.report import outline, sections_of
    from morembs.app.simulations.result_file import read_recording

    summary = outline(read_recording(path))
    if documents is not None:
        documents.append({"output": str(path), **summary})
        return
    with printing():
        print_sections(console(), sections_of(str(path), summary))
        say(console(), *(f"warning: {text}" for text in summary["warnings"]))


def checked_system(path: Path, changes: Sequence[str], progress: Progress) -> Done:
    """What a system file asks for, for scripts and for people."""
    from morembs.app.report.text import print_sections, say
    from morembs.app.report.words import bytes_words
    from morembs.app.simulations.check import check_system
    from morembs.app.simulations.system_file import load_system

    document = {"job": str(path), **check_system(load_system(path, changes), progress).as_json()}

    def show() -> None:
        from morembs.app.report.sections import Section

        counted = ("joints", "forces", "coordinates", "constraints", "degrees_of_freedom", "steps")
        rows = [*document["bodies"].items(), *((key.replace("_", " "), f"{document[key]:,}") for key in counted)]
        if document["lowest_frequency_hz"] is not None:
            rows.append(("lowest elastic frequency in Hz", f"{document['lowest_frequency_hz']:.4g}"))
        rows += [("memory of the run", bytes_words(document["memory_bytes"]))]
        rows += [("size of the result", bytes_words(document["result_bytes"]))]
        title = f"{path} is sound" if not document["warnings"] else f"{path} can be run, with warnings below"
        print_sections(console(), [Section(title=title, columns=("", ""), rows=rows)])
        say(console(), *(f"warning: {text}" for text in document["warnings"]))
        say(console(), f"to run it: morembs simulate {shlex.quote(str(path))}")

    return document, show
