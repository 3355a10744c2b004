"""A report: one HTML file with a row and a section for each part, made from body files.

Up to some parts it needs no other file; of more it is their table, with a page a part in the folder beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morembs.app.pages.beside import make_folder, remove_others
from morembs.app.pages.kept import KeptParts, ReportFormat, as_json, folder_beside
from morembs.app.pages.parts import Entry, PartPlace, decimals, part_of
from morembs.app.pages.rendering import link_to, render_page
from morembs.app.report.certificates import MEASURES
from morembs.app.report.style import STYLE
from morembs.base.errors import InputError, OutputError
from morembs.storage.safefile import check_writable, replacing_all
from morembs.version import VERSION

if TYPE_CHECKING:
    from morembs.app.pages.against import Earlier


@dataclass(frozen=True, kw_only=True)
class ReportRequest:
    """A report that is to be written to ``path``, compared with an ``earlier`` one."""

    path: Path
    earlier: Earlier | None = None

    @classmethod
    def of(
        cls, path: Path | None, against: Path | None = None, within: str | None = None, parts: Callable[[], int] = int
    ) -> ReportRequest | None:
        """Check, before the work begins, that a report can be written, and read the earlier one, which the work may
        replace; None where none was asked for. ``parts`` counts its parts.

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
        check_report(path, parts)
        if against is None:
            return cls(path=path)
        # Not at the top: it knows of manifests, which few reports need.
        from morembs.app.pages.against import ChangeLimits, Earlier

        return cls(path=path, earlier=Earlier.read(against, ChangeLimits.of(within or "")))


def check_report(path: Path | None, parts: Callable[[], int] = int, *, sections: int = STYLE.sections_in_page) -> None:
    """Check, before the work begins, that a report can be written; with its folder, where more ``parts`` than
    ``sections`` need one.

    Raises:
        InputError: another ending than .html, or a report that has its data and pages at the same place.
        OutputError: the folder cannot be written.
    """
    if path is None:
        return
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--report {path} was given; expected a name that ends in .html", keyword="report")
    twin = path.with_suffix(".htm" if path.suffix.lower() == ".html" else ".html")
    if twin.exists():
        raise InputError(
            f"--report {path} was given, and {twin.name} is there: both have {path.stem}.json and {path.stem}_files; "
            "choose a report of another name",
            kind="conflict",
            keyword="report",
        )
    check_writable(path)
    check_writable(path.with_suffix(".json"))
    folder = folder_beside(path)
    if folder.exists():
        try:
            check_writable(folder / "part.html")
        except OutputError:
            # A report of few parts does without, and to count those of a batch takes time.
            if parts() > sections:
                raise


def write_report(
    path: Path,
    entries: Sequence[Entry],
    title: str,
    earlier: Earlier | None = None,
    *,
    sections: int = STYLE.sections_in_page,
) -> str:
    """Write the report of some jobs, from the body files that they wrote: a page, and its data as JSON beside it. Of
    more parts than ``sections`` the page is their table, and each has a page of its own in a folder beside it; pages
    there of parts that are gone are removed.

    What the report that is there says and draws of body files that are the same now is taken from it. What changed
    since an earlier one is said in a sentence, "" where there is none.

    Raises:
        OutputError: a file cannot be written.
    """
    kept = KeptParts([path] if earlier is None else [path, earlier.path])
    folder = make_folder(path) if len(entries) > sections else None
    places = [PartPlace.of(entry, path, folder) for entry in entries]
    pairs = [part_of(number, *part, kept) for number, part in enumerate(zip(entries, places, strict=True), start=1)]
    document: dict[str, Any] = {
        "format": ReportFormat.NAME,
        "version": ReportFormat.VERSION,
        "morembs_version": VERSION,
        "title": title,
        "parts": [plain for plain, _ in pairs],
    }
    words = ""
    if earlier is not None:
        document["against"] = earlier.compare_parts(document["parts"], path.resolve().parent)
        words = earlier.words(document["against"])
    data = as_json(document)
    text = render_page(
        "page.html",
        title=title,
        parts=[shown for _, shown in pairs],
        data=data,
        since=document.get("against"),
        words=words,
        has_sections=folder is None,
        decimals=decimals(document["parts"]),
        measures=MEASURES,
        data_link=link_to(path.with_suffix(".json"), path),
        data_name=path.with_suffix(".json").name,
    )
    with replacing_all([path, path.with_suffix(".json")]) as files:
        for file, content in zip(files, (text, f"{data}\n"), strict=True):
            # Names of files that are no UTF-8 have letters that no page can hold.
            file.write(content.encode("utf-8", "replace"))
    remove_others(path, {place.page.name for place in places if place.page is not None})
    return words
