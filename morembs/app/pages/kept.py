"""Contents and pictures of unchanged body files, which a new report takes from an older one.

An older report is read as data alone: its document is JSON, pictures are taken where they are PNG or WebP in base64,
and what plots show where it is JSON. Nothing else of it gets into a new page.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
import sys
from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping, MutableMapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from markupsafe import Markup

from morembs.app.pages.pictures import PNG_START, WEBP_START
from morembs.app.report.style import STYLE
from morembs.base.errors import InputError
from morembs.storage.contents import own_files
from morembs.version import VERSION

DOCUMENT = re.compile(r'<script type="application/json" id="report">([^<]*)</script>')
_PICTURE = re.compile(
    r'data-key="([0-9a-f]{64}:[a-z-]+)" data-sum="([0-9a-f]{64})" '
    rf'(?:src|href)="data:image/(?:png|webp);base64,((?:{PNG_START}|{WEBP_START})[A-Za-z0-9+/=]+)"'
)
_NOTHING = re.compile(r'<template data-key="([0-9a-f]{64}:[a-z-]+)"></template>')
_DATA = re.compile(
    r'<script type="application/json" data-key="([0-9a-f]{64}:[a-z-]+)" data-sum="([0-9a-f]{64})">([^<]*)</script>'
)


class ReportFormat:
    """Format of the document of a report."""

    NAME = "morembs-report"
    VERSION = 1


def as_json(value: Any) -> Markup:
    """A value as JSON that can stand in a page: nothing in it begins or ends a tag."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def sum_of(data: str) -> str:
    """The checksum that stands beside data in a page."""
    return hashlib.sha256(data.encode()).hexdigest()


def folder_beside(report: Path) -> Path:
    """``night_files`` beside ``night.html``, for the pages of its parts where they are many."""
    return report.with_name(f"{report.stem}_files")


def read_document(path: Path) -> dict[str, Any]:
    """The document of a report, from its page or from the JSON file beside it.

    Raises:
        InputError: it cannot be read, or is no report, or one of another version.
    """
    try:
        return _document(_text(path), path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read as a report ({error.strerror}); check the path", kind="file", keyword=path.name
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} cannot be read as a report ({error})", kind="file", keyword=path.name) from error


def _text(path: Path) -> str:
    """An older report, which the new one may replace: to read it is not to take it as an input of a job."""
    with own_files():
        return path.read_text(encoding="utf-8")


def _document(text: str, path: Path) -> dict[str, Any]:
    found = DOCUMENT.search(text)
    try:
        document = json.loads(found[1] if found else text, parse_constant=_no_number)
        known = isinstance(document, dict) and document.get("format") == ReportFormat.NAME
        known = known and all(isinstance(part, dict) and "name" in part for part in document["parts"])
    except (ValueError, KeyError, TypeError, RecursionError):
        known = False
    if not known:
        raise InputError(
            f"{path} has no data of a report; expected a report (.html or .json) that this morembs wrote, or the "
            "manifest of a batch"
        )
    if document.get("version") != ReportFormat.VERSION:
        raise InputError(
            f"{path} has the format version {document.get('version')}; this morembs reads {ReportFormat.VERSION}",
            kind="file",
            keyword=path.name,
        )
    return dict(document)


def _no_number(name: str) -> None:
    """NaN and infinity, which no report has.

    Raises:
        ValueError: always.
    """
    raise ValueError(f"{name} is no number of JSON")


class KeptParts:
    """What older reports say and draw of body files, by the SHA-256 of the file.

    Pictures and data are kept under ``key:name``, where the key is that of ``key_of``: other versions and other sizes
    of pictures have other keys. Reports that are not there, or no reports, have nothing.
    """

    def __init__(self, reports: Iterable[Path]) -> None:
        self._contents: dict[str, Mapping[str, Any]] = {}
        self._pictures: MutableMapping[str, str] = {}
        self._data: MutableMapping[str, str] = {}
        self._reports = tuple(reports)
        for path in self._reports:
            try:
                text = _text(path)
                document = _document(text, path)
            except (OSError, UnicodeDecodeError, InputError):
                continue
            if document.get("morembs_version") == VERSION:
                whole = [part["body_file"] for part in document["parts"] if _is_whole(part.get("body_file"))]
                self._contents |= {content["sha256"]: content for content in whole}
            self._take(text)

    def _take(self, text: str) -> None:
        self._pictures.update(_whole(_PICTURE, text) | dict.fromkeys(_NOTHING.findall(text), ""))
        self._data.update(_whole(_DATA, text))

    def beside(self, name: str) -> KeptParts:
        """The kept parts with the page ``name`` of a part beside the reports; additions are forgotten with it."""
        own = KeptParts(())
        own._contents, own._pictures, own._data = self._contents, ChainMap({}, self._pictures), ChainMap({}, self._data)
        for report in self._reports:
            with suppress(OSError, UnicodeDecodeError):
                own._take(_text(folder_beside(report) / name))
        return own

    def content(self, sha256: str) -> Mapping[str, Any] | None:
        """What a report of this version says of a body file, None where there is none."""
        return self._contents.get(sha256)

    def picture(self, key: str, make: Callable[[], bytes]) -> str:
        """The picture that was kept under ``key``, or a new one, in base64; empty where there is none."""
        with suppress(KeyError, ValueError):
            base64.b64decode(self._pictures[key], validate=True)
            return self._pictures[key]
        self._pictures[key] = base64.b64encode(make()).decode()
        return self._pictures[key]

    def data(self, key: str, make: Callable[[], Any]) -> Any:
        """The plain values that were kept under ``key``, or new ones."""
        with suppress(KeyError, ValueError, RecursionError):
            values = json.loads(self._data[key], parse_constant=_no_number)
            as_json(values)  # infinite numbers have other spellings too
            return values
        return make()


def _whole(pattern: re.Pattern[str], text: str) -> dict[str, str]:
    """What a page holds under a key with a checksum, where it is as it was written."""
    return {key: data for key, checksum, data in pattern.findall(text) if sum_of(data) == checksum}


def seal_content(content: Mapping[str, Any]) -> dict[str, Any]:
    """What is said of a body file, with the checksum by which a later report knows that it is as it was written."""
    return {**content, "seal": _seal(content)}


def _seal(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _is_whole(content: Any) -> bool:
    if not isinstance(content, dict):
        return False
    values = {key: value for key, value in content.items() if key != "seal"}
    # A checksum can be made anew by anybody: a page is made of values that it has places for alone.
    return _has_form(values, _FORM) and values["shown"] in values["bodies"] and content.get("seal") == _seal(values)


# What ``content_of`` and ``content_of_members`` give: a type, a list of one form, a table of these keys, or one of any
# names (the key ``str``); one of several forms in parentheses.
_FORM: dict[Any, Any] = {
    "sha256": str,
    "members": bool,
    "bodies": {
        str: {
            "method": str,
            "order": int,
            "asked": {str: (str, int, float, bool)},
            "frequencies_hz": [float],
            "kind": str,
            "measure": str,
            "limits": {str: (float, None)},
            "band_hz": ([float], None),
            "notes": str,
        }
    },
    "shown": str,
    "dofs": (int, None),
    "mass_kg": float,
    "center_of_mass_m": [float],
    "warnings": [str],
    "interfaces": {str: {"coupling": str, "nodes": int}},
    "stages": {str: {"seconds": float, "peak_memory_bytes": int}},
    "inputs": {str: str},
    "origin": {str: str},
}


def _has_form(value: Any, form: Any) -> bool:
    if isinstance(form, tuple):
        return any(_has_form(value, each) for each in form)
    if isinstance(form, list):
        return isinstance(value, list) and all(_has_form(each, form[0]) for each in value)
    if isinstance(form, dict) and isinstance(value, dict):
        if str in form:
            return all(_has_form(each, form[str]) for each in value.values())
        # Of bodies nothing is said of members.
        return {"members", *value} == {"members", *form} and all(_has_form(value[key], form[key]) for key in value)
    if form is None or isinstance(form, dict):
        return value is form
    if type(value) is float and not math.isfinite(value):
        return False
    # Whole numbers have 64 bits in the files that they come from.
    return type(value) is form and not (form is int and abs(value) > sys.maxsize)


def key_of(sha256: str) -> str:
    """Key of what is drawn of a body file: by its content, this version, and the sizes of pictures."""
    return hashlib.sha256(f"{sha256} {VERSION} {STYLE!r}".encode()).hexdigest()
