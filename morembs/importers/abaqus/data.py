"""Data lines of input decks: fields, numbers and labels, and blocks of nodes, elements and members of sets."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.keywords import Card, decoded
from morembs.importers.matrices.text import integers, numbers, table
from morembs.importers.tolerances import TOL

_GAP = re.compile(rb"[0-9.][ \t]+[0-9.+\-]")


def fields(lines: bytes, *, ends: bool = False) -> list[list[str]]:
    """Fields of each data line without empty ones at its end; with ``ends`` one where the line ends in a comma."""
    rows = []
    for line in decoded(lines).split("\n"):
        row = [part.strip().strip('"') for part in line.split(",")]
        while row and not row[-1]:
            row.pop()
        row += [""] * (ends and bool(row) and line.rstrip().endswith(","))
        if row or line.strip():
            rows.append(row)
    return rows


def number(text: str, card: Card) -> float:
    """A finite number; an empty field is 0."""
    if not text:
        return 0.0
    try:
        value = float(text.replace("d", "e").replace("D", "E"))
    except ValueError:
        value = float("nan")
    if not abs(value) < TOL.largest_number or "_" in text:
        raise InputError(f"{card}: {text[:40]!r} cannot be read as a number; expected a finite one")
    return value


def label(text: str) -> int | None:
    """A label, or None where the text is a name."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 17 else None


def node_rows(piece: bytes, card: Card) -> tuple[Ints, Floats]:
    """Labels (n,) and coordinates (n, 3) of the data lines of *NODE."""
    if _is_plain(piece):
        try:
            rows = table(piece, 4, card.file)
        except InputError:
            rows = None
        if rows is not None and piece.count(b",") == 3 * len(rows):
            return integers(rows[:, 0], "a node label", card.file), rows[:, 1:]
    ids, xyz = [], []
    for row in fields(piece):
        if not row:
            continue
        node = label(row[0])
        if node is None:
            raise InputError(f"{card}: {', '.join(row)[:60]!r} cannot be read; expected a label and three coordinates")
        ids.append(node)
        xyz.append([number(text, card) for text in (row[1:4] + [""] * 3)[:3]])
    return np.array(ids, dtype=np.int64), np.array(xyz, dtype=np.float64).reshape(-1, 3)


_ALL_SEPARATORS, _SEPARATORS = (bytes(int(chr(code) in marks) for code in range(256)) for marks in (", \t\n", ",\n"))


def _words(text: bytes, separators: bytes) -> int:
    """How many words there are between separators."""
    apart = np.frombuffer(text.translate(separators), dtype=np.uint8)
    return int(np.count_nonzero(apart[1:] < apart[:-1])) + int(len(apart) > 0 and not apart[0])


def _has_gap(piece: bytes) -> bool:
    """Whether a blank stands within a field."""
    if b" " not in piece and b"\t" not in piece:
        return False
    return _words(piece, _ALL_SEPARATORS) != _words(piece.translate(None, b" \t"), _SEPARATORS)


def _is_plain(piece: bytes) -> bool:
    """Whether no field is empty and none has a blank within it; searches for plain bytes take a tenth of patterns."""
    text = piece.translate(None, b" \t")
    return not (b",," in text or b",\n" in text or b"\n," in text or text[:1] == b"," or _has_gap(piece))


def element_numbers(piece: bytes, card: Card) -> tuple[Ints, NDArray[np.bool_]]:
    """All integers (k,) of data lines, and which of them are the first of their line (k,)."""
    gap = _GAP.search(piece) if _has_gap(piece) else None
    if gap:
        line = piece[piece.rfind(b"\n", 0, gap.start()) + 1 :].split(b"\n")[0]
        raise InputError(f"{card}: {line.decode('latin-1')[:60]!r} has a blank within a field; expected commas")
    values = integers(numbers(piece, card.file), "a label", card.file)
    codes = np.frombuffer(piece, dtype=np.uint8)
    # Digits, signs and dots are above the comma or are the comma's neighbours; separators are few.
    apart = (codes == 10) | (codes == 44) | (codes == 32) | (codes == 9)
    starts = np.flatnonzero(~apart & np.concatenate([[True], apart[:-1]]))
    behind = np.searchsorted(starts, np.flatnonzero(codes == 10))
    first = np.zeros(len(starts), dtype=bool)
    first[:1] = True
    first[behind[behind < len(starts)]] = True
    if len(first) != len(values):
        raise InputError(f"{card}: {piece[:60].decode('latin-1')!r} cannot be read as labels; expected integers")
    return values, first


def members(piece: bytes, card: Card) -> tuple[Ints, list[str]]:
    """Labels and names in the data lines of a set."""
    if not piece.translate(None, b"0123456789, \t\n") and not _has_gap(piece):
        return integers(numbers(piece, card.file), "a label", card.file), []
    labels: list[int] = []
    names: list[str] = []
    for row in fields(piece):
        for text in row:
            value = label(text)
            if value is not None:
                labels.append(value)
            elif text:
                names.append(text)
    return np.array(labels, dtype=np.int64), names
