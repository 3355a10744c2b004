"""A report: one HTML file with a row and a section for each part, made from body files; it needs no other file."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from markupsafe import Markup

from morembs.app.pages.kept import KeptParts, ReportFormat, as_json, sealed
from morembs.app.report.certificates import MEASURES
from morembs.app.report.style import STYLE
from morembs.app.report.words import bytes_words
from morembs.base.errors import InputError, MorembsError
from morembs.base.progress import duration_words
from morembs.base.summary import upwards
from morembs.storage.contents import Content
from morembs.storage.safefile import check_writable, replacing
from morembs.version import VERSION

if TYPE_CHECKING:
    from morembs.app.pages.against import Earlier
    from morembs.body.stored import StoredBodies


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A job of a report: its ``state`` (``done``, ``unchanged``, ``failed``), the ``message`` of a failed one, and of
    another the body file ``output`` and what it cost, where that is known, and the ``document`` of its run."""

    name: str
    job: str
    output: str = ""
    state: str
    message: str = ""
    seconds: float | None = None
    peak_memory_bytes: int | None = None
    document: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class ReportRequest:
    """A report that is to be written to ``path``, compared with an ``earlier`` one."""

    path: Path
    earlier: Earlier | None = None

    @classmethod
    def of(cls, path: Path | None, against: Path | None = None, within: str | None = None) -> ReportRequest | None:
        """Check, before the work begins, that a report can be written, and read what it is compared with, which the
        work may replace; None where none was asked for.

        Raises:
            InputError: another ending than .html, or no earlier report.
            OutputError: the folder cannot be written.
        """
        for option, wanted, needed in (("--against", against, path), ("--within", within, against)):
            if wanted is not None and needed is None:
                needs = "--report FILE.html" if path is None else "--against OLD.html"
                raise InputError(f"{option} {wanted} was given; it needs {needs}")
        if path is None:
            return None
        check_report(path)
        if against is None:
            return cls(path=path)
        # Not at the top: it knows of manifests, which few reports need.
        from morembs.app.pages.against import ChangeLimits, Earlier

        return cls(path=path, earlier=Earlier.read(against, ChangeLimits.of(within or "")))


def check_report(path: Path | None) -> None:
    """Check, before the work begins, that a report can be written.

    Raises:
        InputError: another ending than .html.
        OutputError: the folder cannot be written.
    """
    if path is None:
        return
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--report {path} was given; expected a name that ends in .html")
    check_writable(path)
    check_writable(path.with_suffix(".json"))


def write_report(path: Path, entries: Sequence[Entry], title: str, earlier: Earlier | None = None) -> str:
    """Write the report of some jobs, from the body files that they wrote: a page, and its data as JSON beside it.

    What the report that is there says and draws of body files that are the same now is taken from it. What changed
    since an earlier one is said in a sentence, "" where there is none.

    Raises:
        OutputError: a file cannot be written.
    """
    kept = KeptParts([path] if earlier is None else [path, earlier.path])
    pairs = [_part(number, entry, path, len(entries), kept) for number, entry in enumerate(entries, start=1)]
    document: dict[str, Any] = {
        "format": ReportFormat.NAME,
        "version": ReportFormat.VERSION,
        "morembs_version": VERSION,
        "title": title,
        "parts": [plain for plain, _ in pairs],
    }
    words = ""
    if earlier is not None:
        document["against"] = earlier.compared(document["parts"], path.resolve().parent)
        words = earlier.words(document["against"])
    data = as_json(document)
    text = rendered(
        "page.html",
        title=title,
        parts=[shown for _, shown in pairs],
        data=data,
        since=document.get("against"),
        words=words,
        decimals=_decimals(document["parts"]),
        measures=MEASURES,
        data_link=quote(os.fsencode(path.with_suffix(".json").name)),
        data_name=path.with_suffix(".json").name,
    )
    for place, content in ((path, text), (path.with_suffix(".json"), f"{data}\n")):
        with replacing(place) as file:
            # Names of files that are no UTF-8 have letters that no page can hold.
            file.write(content.encode("utf-8", "replace"))
    return words


def rendered(template: str, **values: Any) -> str:
    """A page by one of the templates in this folder, with the scripts and style sheets of all pages."""
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
        "hertz": lambda value, decimals: f"{value:,.{decimals}f}",
    }
    resources = {
        name: [_resource(*place) for place in places] for name, places in (("scripts", SCRIPTS), ("styles", STYLES))
    }
    return environment.get_template(template).render(version=VERSION, **resources, **values)


def _resource(package: str, name: str) -> Markup:
    """A script or style sheet of the package, which a page holds as it is."""
    return Markup((files(package) / name).read_text(encoding="utf-8"))


def _part(
    number: int, entry: Entry, report: Path, count: int, kept: KeptParts
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the report says of a part as plain values, and what its page shows beside that; a body file that cannot be
    read is a failure of its own."""
    said: dict[str, Any] = {
        "name": entry.name,
        "job": link_to(entry.job, report),
        "state": entry.state,
        "message": entry.message,
    }
    shown = {"number": number, "said": said, "job_name": Path(entry.job).name}
    if entry.state == "failed":
        return said, shown
    said |= {
        "output": link_to(entry.output, report),
        "seconds": entry.seconds,
        "peak_memory_bytes": entry.peak_memory_bytes,
    }
    try:
        content, page = _content(number, entry, report, count, kept)
    except MorembsError as error:
        said |= {"state": "failed", "message": str(error)}
        return said, shown
    said["body_file"] = content
    return said, shown | page


def _content(
    number: int, entry: Entry, report: Path, count: int, kept: KeptParts
) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """What a body file holds, as it was kept or is read, and what the page draws of it."""
    # Not at the top: what checks the path of a report does without.
    from morembs.app.jobs.document import sections_of
    from morembs.app.pages.sections import SECTIONS, PartPage, thumbnail

    try:
        sha256 = Content.of(entry.output).sha256
    except OSError:
        sha256 = ""
    content, fresh = kept.content(sha256), None
    if content is None:
        said, fresh = _read_content(Path(entry.output))
        content = sealed({"sha256": sha256, **said})
    part = PartPage(
        name=entry.name,
        number=number,
        count=count,
        report=report,
        file=Path(entry.output),
        sha256=sha256,
        content=content,
        kept=kept,
        fresh=fresh,
    )
    return content, {
        "row": _row(content, entry),
        "thumbnail": thumbnail(part),
        "drawn": [section(part) for section in SECTIONS],
        "sections": [] if entry.document is None else sections_of(entry.document, pages=True),
        "file": Path(entry.output).name,
        "links": _files(entry, report, content),
    }


def _read_content(path: Path) -> tuple[dict[str, Any], StoredBodies | None]:
    """What a file of bodies or of planar members holds, and all of the former.

    Raises:
        InputError: it cannot be read.
    """
    # Not at the top: what checks the path of a report does without.
    from morembs.app.pages.content import content_of
    from morembs.body.file import read_body
    from morembs.storage.hdf5 import MEMBERS, holds_format

    if holds_format(path, MEMBERS):
        from morembs.app.pages.members import content_of_members

        return content_of_members(path), None
    stored = read_body(path)
    return content_of(stored), stored


def _row(content: Mapping[str, Any], entry: Entry) -> dict[str, Any]:
    """What the columns of the table are sorted by, and what they show, by the body that stands for the part."""
    body, seconds, memory = content["bodies"][content["shown"]], entry.seconds, entry.peak_memory_bytes
    limit = body["limits"].get(body["measure"])
    return {
        "dofs": (-1, "-") if content["dofs"] is None else (content["dofs"], f"{content['dofs']:,}"),
        "order": (body["order"], f"{body['order']:,}"),
        # Unknown errors are sorted as infinite ones.
        "error": (
            math.inf if limit is None else limit,
            "-" if not body["limits"] else upwards(math.inf if limit is None else limit),
        ),
        "lowest": min(body["frequencies_hz"], default=-1.0),
        "frequencies": body["frequencies_hz"][: STYLE.page_frequencies],
        "mass": (content["mass_kg"], f"{content['mass_kg']:.4g} kg"),
        "seconds": (-1, "-") if seconds is None else (seconds, duration_words(seconds)),
        "memory": (-1, "-") if memory is None else (memory, bytes_words(memory)),
    }


def _decimals(parts: Sequence[Mapping[str, Any]]) -> int:
    """Digits behind the point of all frequencies of a page, by the lowest one."""
    lowest = [
        body["frequencies_hz"][0]
        for part in parts
        for body in part.get("body_file", {"bodies": {}})["bodies"].values()
        if body["frequencies_hz"]
    ]
    least = min((f for f in lowest if f > 0), default=1.0)
    wanted = STYLE.frequency_digits - 1 - math.floor(math.log10(least))
    return min(max(wanted, 1), STYLE.frequency_decimals)


def _files(entry: Entry, report: Path, content: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Files to take: the body, what its job wrote beside it, and exports of its bodies that lie there: what it is,
    link, name."""
    from morembs.exporters import EXPORTERS, default_path

    body, bodies = Path(entry.output), content["bodies"]
    found = {body: "body"}
    for path in (entry.document or {}).get("written", ()):
        found.setdefault(Path(path), "of the job")
    for name in bodies:
        for exporter in EXPORTERS.values():
            path = default_path(body, exporter, name, several=len(bodies) > 1)
            if path.is_file():
                old = path.stat().st_mtime_ns < body.stat().st_mtime_ns
                found.setdefault(path, f"{exporter.name}{', older than the body' if old else ''}")
    return [(what, link_to(path, report), path.name) for path, what in found.items()]


def link_to(path: str | Path, report: Path) -> str:
    """Where a page finds a file."""
    try:
        target = Path(os.path.relpath(path, report.resolve().parent)).as_posix()
    except ValueError:  # on another drive
        return Path(path).resolve().as_uri()
    return quote(os.fsencode(target))
