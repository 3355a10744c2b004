"""The folder beside a report of many parts: a page and a picture for each. What morembs wrote there is known by the
checksum at its end, and goes with its part; nothing else is touched."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from morembs.app.pages.kept import folder_beside
from morembs.base.errors import OutputError
from morembs.storage.contents import own_files
from morembs.storage.safefile import replacing

# Before version 1 viewers alone had pages there, called view-NAME.html.
_NAME = re.compile(r"(part|view)-[0-9a-f]{16}\.html")
_MARK = re.compile(rb"([0-9a-f]{64}) ([0-9a-f]{64}) -->\n")
_ICON = re.compile(rb'<link rel="icon" [^>]*href="data:image/png;base64,([A-Za-z0-9+/=]+)">')


def page_name(owner: str) -> str:
    """Name of the page of a part, by all that tells the part from others."""
    return f"part-{hashlib.sha256(owner.encode('utf-8', 'surrogatepass')).hexdigest()[:16]}.html"


def make_folder(report: Path) -> Path:
    """The folder beside a report, made where it is not there.

    Raises:
        OutputError: it cannot be made.
    """
    folder = folder_beside(report)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{folder}, the folder for the pages of the parts, cannot be made ({error.strerror}); remove what is "
            "there, or choose another place for the report"
        ) from error
    return folder


def remove_links(page: Path) -> None:
    """Remove links in place of a page or its picture: their targets were never given as outputs.

    Raises:
        OutputError: one cannot be removed.
    """
    for path in (page, page.with_suffix(".png")):
        if path.is_symlink():
            try:
                path.unlink()
            except OSError as error:
                raise OutputError(f"{path} is a link that cannot be removed ({error.strerror}); remove it") from error


def write_page(page: Path, report: Path, text: str, picture: bytes) -> None:
    """Write the page of a part with its mark, and the ``picture`` of its row beside it, where they are not there
    already; without a picture the one of before goes.

    Raises:
        OutputError: they cannot be written.
    """
    # Names of files that are no UTF-8 have letters that no page can hold.
    content = text.encode("utf-8", "replace")
    old = _read(page)
    if picture:
        _renew(page.with_suffix(".png"), picture)
    elif _is_own(old, report):
        with suppress(OSError):  # another run may have removed it
            _remove_picture(page, old)
    _renew(page, content + _mark(content, report))


def remove_others(report: Path, kept: Collection[str]) -> None:
    """Remove pages of parts that the report no longer has, with their pictures, where they are as they were written.

    Pages that were edited, and files of other names, stay; so does what cannot be removed. Behind a link lies the
    folder of another place, whose report may have pages of the same name.
    """
    folder = folder_beside(report)
    if folder.is_symlink():
        return
    with suppress(OSError):
        for page in sorted(folder.iterdir()):
            if _NAME.fullmatch(page.name) and page.name not in kept and not page.is_symlink():
                text = _read(page)
                if _is_own(text, None if page.name.startswith("view-") else report):
                    with suppress(OSError):
                        _remove_picture(page, text)
                        page.unlink()


def _read(path: Path) -> bytes:
    with own_files(), suppress(OSError):
        return path.read_bytes() if path.is_file() else b""
    return b""


def _renew(path: Path, content: bytes) -> None:
    if _read(path) != content:
        with replacing(path) as file:
            file.write(content)


def _mark(content: bytes, report: Path) -> bytes:
    """The end of a page: of which report it is, and that it is as it was written."""
    return f"<!-- {_sha(report.name)} {hashlib.sha256(content).hexdigest()} -->\n".encode()


def _sha(name: str) -> str:
    return hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()


def _is_own(text: bytes, report: Path | None) -> bool:
    """True if a page is as morembs wrote it for the ``report``, or for any where that is None."""
    content, _, end = text.rpartition(b"<!-- ")
    mark = _MARK.fullmatch(end)
    if mark is None or hashlib.sha256(content).hexdigest().encode() != mark[2]:
        return False
    return report is None or mark[1] == _sha(report.name).encode()


def _remove_picture(page: Path, text: bytes) -> None:
    """Remove the picture beside a page, where it is the icon of the page."""
    picture, icon = page.with_suffix(".png"), _ICON.search(text)
    if icon is not None and not picture.is_symlink() and base64.b64encode(_read(picture)) == icon[1]:
        picture.unlink()
