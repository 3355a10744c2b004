"""A part of a report: what is said of it as plain values, its row in the table, its section or a page of its own."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from morembs.app.pages.beside import page_name, remove_links, write_page
from morembs.app.pages.kept import KeptParts, seal_content
from morembs.app.pages.rendering import link_to, render_page
from morembs.app.report.certificates import MEASURES
from morembs.app.report.style import STYLE
from morembs.app.report.words import bytes_words
from morembs.base.errors import MorembsError, OutputError
from morembs.base.progress import duration_words
from morembs.base.summary import upwards
from morembs.storage.contents import Content

if TYPE_CHECKING:
    from morembs.app.pages.sections import PartPage
    from morembs.body.stored import StoredBodies


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A job of a report: its ``state`` (``done``, ``unchanged``, ``failed``), the ``message`` of a failed one, and of
    another the body file ``output``, its cost where that is known, and the ``document`` of its run."""

    name: str
    job: str
    output: str = ""
    state: str
    message: str = ""
    seconds: float | None = None
    peak_memory_bytes: int | None = None
    document: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class PartPlace:
    """Where a part is shown: ``report`` is the page with its row, ``page`` one of its own in the folder beside it, None
    where its section stands in the report."""

    report: Path
    page: Path | None = None

    @classmethod
    def of(cls, entry: Entry, report: Path, folder: Path | None) -> PartPlace:
        """In ``folder``, where there is one.

        Raises:
            OutputError: a link is in the place of the page, and cannot be removed.
        """
        if folder is None:
            return cls(report=report)
        # Two parts may have one name, and two jobs one body file: a page belongs to all of them together.
        owner = f"{entry.name}\n{Path(entry.job).absolute()}\n{Path(entry.output).absolute()}"
        page = folder / page_name(owner)
        remove_links(page)
        return cls(report=report, page=page)


def part_of(number: int, entry: Entry, place: PartPlace, kept: KeptParts) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the report says of a part as plain values, and what its page shows beside that; a body file that cannot be
    read is a failure of its own. Where the part has a page of its own, it is written.

    Raises:
        OutputError: that page cannot be written.
    """
    content: dict[str, Any] = {
        "name": entry.name,
        "job": link_to(entry.job, place.report),
        "state": entry.state,
        "message": entry.message,
    }
    page = place.page or place.report
    shown: dict[str, Any] = {
        "number": number,
        "record": content,
        "link": f"#part-{number}" if place.page is None else link_to(place.page, place.report),
        "thumbnail": "",
    }
    picture = b""
    section: dict[str, Any] = {"job_name": Path(entry.job).name, "job_link": link_to(entry.job, page), "icon": ""}
    if entry.state != "failed":
        content |= {
            "output": link_to(entry.output, place.report),
            "seconds": entry.seconds,
            "peak_memory_bytes": entry.peak_memory_bytes,
        }
        # Not at the top: what checks the path of a report does without.
        from morembs.app.pages.sections import row_picture

        own = kept if place.page is None else kept.beside(place.page.name)
        try:
            part = _read(entry, own, is_alone=place.page is not None)
            section |= _section(part, entry, page)
            shown["row"] = _row(part.content, entry)
            if place.page is None:
                shown["thumbnail"] = part.image(row_picture(part))
            else:
                shown["thumbnail"], picture = _linked_image(part, place, place.page)
            content["body_file"] = part.content
        except OutputError:
            raise
        except MorembsError as error:
            content |= {"state": "failed", "message": str(error)}
    if place.page is None:
        return content, shown | section
    text = render_page(
        "part.html",
        title=entry.name,
        report=place.report.name,
        part=shown | section,
        decimals=decimals([content]),
        measures=MEASURES,
        back=f"{link_to(place.report, place.page)}#part-{number}",
    )
    write_page(place.page, place.report, text, picture)
    return content, shown


def _linked_image(part: PartPage, place: PartPlace, page: Path) -> tuple[Markup, bytes]:
    """The image in the row of a part from a file beside its page, which a browser reads once the row is near, and what
    that file holds."""
    # Not at the top: what checks the path of a report does without.
    from morembs.app.pages.sections import row_picture

    picture = row_picture(part)
    content = base64.b64decode(part.source(picture))
    if not content:
        return Markup(""), content
    text = '<img src="{}" alt="{}" width="{:.0f}" height="{:.0f}" loading="lazy">'
    width, height, dots = picture.size
    link = link_to(page.with_suffix(".png"), place.report)
    return Markup(text).format(link, picture.alt, width * dots, height * dots), content


def _read(entry: Entry, kept: KeptParts, *, is_alone: bool) -> PartPage:
    """A part, with what its body file holds, as it was kept or is read.

    Raises:
        InputError: it cannot be read.
    """
    # Not at the top: what checks the path of a report does without.
    from morembs.app.pages.sections import PartPage

    try:
        sha256 = Content.of(entry.output).sha256
    except OSError:
        sha256 = ""
    content, fresh = kept.content(sha256), None
    if content is None:
        values, fresh = _read_content(Path(entry.output))
        content = seal_content({"sha256": sha256, **values})
    file = Path(entry.output)
    return PartPage(
        name=entry.name, file=file, sha256=sha256, content=content, kept=kept, fresh=fresh, is_alone=is_alone
    )


def _section(part: PartPage, entry: Entry, page: Path) -> dict[str, Any]:
    """What the section of a part shows beside what its body file holds."""
    from morembs.app.jobs.document import sections_of
    from morembs.app.pages.sections import SECTIONS, icon

    return {
        "icon": icon(part) if part.is_alone else "",
        "drawn": [section(part) for section in SECTIONS],
        "sections": [] if entry.document is None else sections_of(entry.document, pages=True),
        "file": part.file.name,
        "links": _files(entry, page, part.content),
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
    """Sort keys and texts of the columns of the table, by the body that stands for the part."""
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


def decimals(parts: Sequence[Mapping[str, Any]]) -> int:
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


def _files(entry: Entry, page: Path, content: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Files to take: the body, what its job wrote beside it, and exports of its bodies that lie there: kind,
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
    return [(what, link_to(path, page), path.name) for path, what in found.items()]
