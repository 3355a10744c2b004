"""Sections of a report: a table with a title, and sentences. A terminal and a page show the same ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum


class Place(IntEnum):
    """Where a section stands in a report."""

    SUMMARY = 0
    TABLES = 1
    REMARKS = 2


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of ``rows`` below the names of its ``columns``, and ``lines`` below that; either may be absent.

    The first column is one of names, the others are numbers.
    """

    place: Place = Place.TABLES
    title: str = ""
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    lines: Sequence[str] = ()
