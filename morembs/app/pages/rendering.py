"""Pages from the templates in this folder, and links from them to files."""

from __future__ import annotations

import os
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from markupsafe import Markup

from morembs.app.report.words import bytes_words
from morembs.base.summary import upwards
from morembs.fem.viewer.page import bare_program
from morembs.version import VERSION

if TYPE_CHECKING:
    from jinja2 import Environment


def render_page(template: str, **values: Any) -> str:
    """A page by one of the templates in this folder; scripts and style sheets of sections are at hand there."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    # Not at the top: commands without a report do without them.
    from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

    from morembs.app.pages.sections import SCRIPTS, STYLES

    environment = Environment(
        loader=PackageLoader("morembs.app.pages", "."),
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "upwards": lambda value: "unbounded" if value is None else upwards(value),
        "bytes": bytes_words,
        # As they were given, which is seldom with digits behind the point.
        "band": lambda ends: f"{ends[0]:,.10g} to {ends[1]:,.10g} Hz",
        "hertz": lambda values, decimals, between=", ": between.join(f"{value:,.{decimals}f}" for value in values),
    }
    environment.globals |= {
        "version": VERSION,
        "scripts": [_script(*place) for place in SCRIPTS],
        "styles": [_resource(*place) for place in STYLES],
        "table_script": _script("morembs.app.pages", "page.js"),
    }
    return environment


def _script(package: str, name: str) -> Markup:
    """A script of the package, without what only its readers need."""
    return Markup(bare_program(_resource(package, name)))


def _resource(package: str, name: str) -> Markup:
    """A style sheet or script of the package, which is no text of a page to be escaped."""
    return Markup((files(package) / name).read_text(encoding="utf-8"))


def link_to(path: str | Path, page: Path) -> str:
    """Where a page finds a file."""
    try:
        target = Path(os.path.relpath(path, page.resolve().parent)).as_posix()
    except ValueError:  # on another drive
        return Path(path).resolve().as_uri()
    return quote(os.fsencode(target))
