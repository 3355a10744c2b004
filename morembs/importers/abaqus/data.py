"""Data lines of input decks: fields, numbers and labels, and blocks of nodes, elements and members of sets."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.keywords import Card, decode
from morembs.importers.decks.numerals import words_of
from morembs.importers.matrices.text import integers, numbers
from morembs.importers.tolerances import TOL

_GAP = re.compile(rb"[0-9.][ \t]+[0-9.+\-]")
# An exponent without a letter, which only Nastran has.
_IMPLIED = re.compile(rb"[0-9.][+\-][^,\n]*")


def fields(lines: bytes, *, ends: bool = False) -> list[list[str]]:
    """Fields of each data line without empty ones at its end; with ``ends`` one where the line ends in a comma."""
    rows = []
    for line in decode(lines).split("\n"):
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
    read = _plain_nodes(piece)
    if read is not None:
        return read
    ids, xyz = [], []
    for row in fields(piece):
        if not row:
            continue
        node = label(row[0])
        if node is None:
            raise InputError(
                f"{card}: {', '.join(row)[:60]!r} cannot be read; expected a label and three coordinates", kind="file"
            )
        ids.append(node)
        xyz.append([number(text, card) for text in (row[1:4] + [""] * 3)[:3]])
    return np.array(ids, dtype=np.int64), np.array(xyz, dtype=np.float64).reshape(-1, 3)


def _plain_nodes(piece: bytes) -> tuple[Ints, Floats] | None:
    """Labels and coordinates where all lines have as many fields and these are plain numbers, else None."""
    words = words_of(piece)
    width = 0 if words is None else words.width
    if words is None or width < 2 or words.is_empty[::width].any():
        return None
    ids = words.integers(slice(0, None, width))
    given = np.arange(len(words)).reshape(-1, width)[:, 1:4]
    values = words.reals(given.ravel(), implied=False)
    if ids is None or values is None or (ids < 0).any() or (np.abs(values) >= TOL.largest_number).any():
        return None
    xyz = np.zeros((len(ids), 3))
    xyz[:, : given.shape[1]] = values.reshape(given.shape)
    return ids, xyz


def element_numbers(piece: bytes, card: Card) -> tuple[Ints, NDArray[np.bool_]]:
    """All integers (k,) of data lines, and which of them are the first of their line (k,)."""
    words = words_of(piece)
    plain = None if words is None else words.integers()
    if words is not None and plain is not None:
        given = ~words.is_empty
        number: Ints = np.cumsum(words.ends_line) - words.ends_line
        if not given.all():
            plain, number = plain[given], number[given]
        return plain, np.concatenate([np.ones(min(1, len(number)), dtype=bool), number[1:] > number[:-1]])
    gap = _GAP.search(piece)
    if gap:
        line = piece[piece.rfind(b"\n", 0, gap.start()) + 1 :].split(b"\n")[0]
        raise InputError(f"{card}: {line.decode('latin-1')[:60]!r} has a blank within a field; expected commas")
    implied = _IMPLIED.search(piece)
    if implied:
        word = piece[
            max(piece.rfind(b",", 0, implied.start()), piece.rfind(b"\n", 0, implied.start())) + 1 : implied.end()
        ]
        raise InputError(
            f"{card}: {word.decode('latin-1').strip()[:60]!r} cannot be read as a label; expected an integer"
        )
    values = integers(numbers(piece, card.file), "a label", card.file)
    codes = np.frombuffer(piece, dtype=np.uint8)
    # Digits, signs and dots are above the comma or are the comma's neighbours; separators are few.
    is_separator = (codes == 10) | (codes == 44) | (codes == 32) | (codes == 9)
    starts = np.flatnonzero(~is_separator & np.concatenate([[True], is_separator[:-1]]))
    behind = np.searchsorted(starts, np.flatnonzero(codes == 10))
    first = np.zeros(len(starts), dtype=bool)
    first[:1] = True
    first[behind[behind < len(starts)]] = True
    if len(first) != len(values):
        raise InputError(
            f"{card}: {piece[:60].decode('latin-1')!r} cannot be read as labels; expected integers", kind="file"
        )
    return values, first


def members(piece: bytes, card: Card) -> tuple[Ints, list[str]]:
    """Labels and names in the data lines of a set."""
    words = words_of(piece)
    plain = None if words is None else words.integers()
    if words is not None and plain is not None and not (plain < 0).any():
        return plain[~words.is_empty], []
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
