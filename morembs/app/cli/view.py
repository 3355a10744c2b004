"""The verb that shows a file in a browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from morembs.app.cli.completion import known_files
from morembs.app.cli.messages import printing, tell
from morembs.app.cli.terminal import Verb, example, messages, progress_line
from morembs.base.errors import InputError
from morembs.storage.safefile import check_writable, replacing

if TYPE_CHECKING:
    from morembs.fem.viewer import Scene

app = typer.Typer()
SHOWN = "A body, a recovered motion, a model, a mesh, a deck or a job; two bodies side by side."


@app.command(cls=Verb, epilog=example("morembs view part.h5"))
def view(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE [FILE2]", help=SHOWN, show_default=False, autocompletion=known_files)
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The page to write, by default FILE.view.html.")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Write the page, open no browser.")] = False,
) -> None:
    """Show bodies, models, decks and jobs in a browser; a click there selects nodes."""
    from morembs.app.jobs.viewing import scene_of_files, still_picture
    from morembs.fem.viewer import viewer_page

    with messages():
        page = _page(files, out)
        check_writable(page)
        with progress_line():
            scene, bodies = scene_of_files(files)
            text = viewer_page(scene, still_picture(bodies))
        with replacing(page) as target:
            target.write(text.encode("utf-8", "replace"))
        with printing([str(page)]):
            typer.echo("\n".join([f"written: {page}, {_size(scene)}", *(f"note: {note}" for note in scene.notes)]))
        if not no_open and not webbrowser.open(page.resolve().as_uri()):
            tell(f"note: no browser could be started here; open {page} in one")


def _page(files: list[Path], out: Path | None) -> Path:
    """Where the page goes.

    Raises:
        InputError: another ending than .html, or more than two files.
    """
    if len(files) > 2:
        raise InputError(f"{len(files)} files were given; expected one, or two bodies to show beside each other")
    if out is not None and out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--out {out} was given; expected a name that ends in .html", keyword="out")
    return out or files[0].with_name("-".join(file.name for file in files) + ".view.html")


def _size(scene: Scene) -> str:
    facts = scene.facts
    shapes = f", {facts['shapes']} shapes" if facts["shapes"] else ""
    return f"{facts['triangles']:,} triangles{shapes}"
