"""Blocks of fixed-width numbers in ANSYS archives (CDWRITE): NBLOCK, EBLOCK, CMBLOCK, RLBLOCK, ETBLOCK.

A block is a command, a Fortran format such as (3i9,6e21.13e3), and lines in which numbers may touch each other and
trailing zeros are left out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.ansys.lines import BlockText, Lines
from morembs.importers.decks.numerals import Words, fixed_integers, words_of
from morembs.importers.tolerances import TOL

_GROUP = re.compile(r"(\d*)([IEFGD])(\d+)(?:\.\d+(?:E\d+)?)?|(\d+)X")
_FORMAT = re.compile(rf"\(((?:{_GROUP.pattern})(?:,(?:{_GROUP.pattern}))*)\)?")


@dataclass(frozen=True)
class LineFormat:
    """Groups of columns of a line: kind (I whole, R real, X passed over), count and width."""

    groups: tuple[tuple[str, int, int], ...]

    def count(self, kind: str) -> int:
        """Columns of a kind."""
        return sum(count for own, count, _ in self.groups if own == kind)

    @property
    def whole(self) -> int:
        """Columns of integers."""
        return self.count("I")

    @property
    def real(self) -> int:
        """Columns of reals."""
        return self.count("R")

    @property
    def length(self) -> int:
        """Characters of a full line."""
        return sum(count * width for _, count, width in self.groups)


def layout(line: bytes, block: str, name: str) -> LineFormat:
    """Layout of a format line such as (19i10), (3i9,6e21.13e3) or (1i9,2x,3e20.13,3e16.9).

    Raises:
        InputError: another format.
    """
    text = line.decode("latin-1").upper().replace("1P,", "").replace("1P", "").split("!")[0].strip()
    parts = _FORMAT.fullmatch(text.replace(" ", ""))
    groups = []
    for count, kind, width, blanks in _GROUP.findall(parts[1] if parts else ""):
        if len(count + width + blanks) > 5:
            break
        number = ("I" if kind == "I" else "R", int(count or 1), int(width or 0))
        groups.append(("X", 1, int(blanks)) if blanks else number)
    if (
        not parts
        or len(groups) != parts[1].count(",") + 1
        or not any(kind != "X" for kind, _, _ in groups)
        or any(not (0 < n <= TOL.block_numbers and 0 < w <= TOL.block_number_characters) for _, n, w in groups)
    ):
        raise InputError(f"{name}: {block} has the format {text[:40]!r}; expected one such as (3i9,6e21.13e3)")
    return LineFormat(tuple(groups))


def columns(rows: BlockText, form: LineFormat, block: str, name: str) -> tuple[Ints, Floats]:
    """Integers (k, whole) and reals (k, real) of lines; fields that a line leaves out are zero.

    Raises:
        InputError: a line that is too long, or something that is not a finite number.
    """
    for row in np.flatnonzero(rows.lengths > form.length).tolist():
        if len(rows[row].rstrip()) > form.length:
            raise InputError(
                f"{name}: a line of {block} is longer than its format: {_quote_line(rows[row])!r}", kind="unsupported"
            )
    table, at = rows.characters(form.length), 0
    longest = int(rows.lengths.max(initial=0))
    whole: list[Ints] = [np.zeros((len(rows), 0), dtype=np.int64)]
    real: list[Floats] = [np.zeros((len(rows), 0))]
    for kind, count, width in form.groups:
        # Columns that no line has are not looked at.
        given = min(count, max(0, -(-(longest - at) // width)))
        part, at = table[:, at : at + given * width].reshape(len(rows), given, width), at + count * width
        if kind == "I":
            whole += [_integers(part, rows, block, name), np.zeros((len(rows), count - given), dtype=np.int64)]
        elif kind == "R":
            real += [_reals(part, rows, block, name), np.zeros((len(rows), count - given))]
    integers, reals = np.concatenate(whole, axis=1), np.concatenate(real, axis=1)
    if not np.isfinite(reals).all():
        bad = _quote_line(rows[int(np.flatnonzero(~np.isfinite(reals).all(axis=1))[0])])
        raise InputError(f"{name}: {block} holds a number that is not finite: {bad!r}")
    if integers.size and np.abs(integers).max() >= 2**31:
        raise InputError(f"{name}: {block} holds an integer of more than 31 bits; it is damaged", kind="file")
    return integers, reals


def _quote_line(line: bytes) -> str:
    """Its begin, as messages quote it."""
    return line.decode("latin-1")[: TOL.shown_line]


def _integers(part: NDArray[np.uint8], rows: BlockText, block: str, name: str) -> Ints:
    values = fixed_integers(part)
    if values is None:
        words = _words(part)
        values = None if words is None else words.integers()
    return _odd_numbers(part, np.int64, rows, block, name) if values is None else values.reshape(part.shape[:2])


def _reals(part: NDArray[np.uint8], rows: BlockText, block: str, name: str) -> Floats:
    words = _words(part)
    values = None if words is None else words.reals()
    return _odd_numbers(part, np.float64, rows, block, name) if values is None else values.reshape(part.shape[:2])


def _words(part: NDArray[np.uint8]) -> Words | None:
    """Columns (n, count, width), which may touch each other, as words; None where a blank stands within one."""
    count, columns, width = part.shape
    if not part.size:
        return None
    text = np.full((count, columns, width + 1), ord(","), dtype=np.uint8)
    text[:, :, :width] = part
    text[-1, -1, -1] = ord("\n")
    if (part == ord(",")).any():
        return None
    return words_of(text.tobytes())


def _odd_numbers(part: NDArray[np.uint8], kind: type, rows: BlockText, block: str, name: str) -> NDArray:  # type: ignore[type-arg]
    """Numbers that are written in another way than most, or are none."""
    words = np.ascontiguousarray(part).view(f"S{part.shape[2]}")[:, :, 0]
    words = np.where((part == ord(" ")).all(axis=2), b"0", words)
    for row, line in enumerate(words):
        try:
            if b"_" in b"".join(line):
                raise ValueError("digits in groups, which only Python reads")
            line.astype(kind)
        except (ValueError, OverflowError) as error:
            bad = _quote_line(rows[row])
            raise InputError(
                f"{name}: a line of {block} is not as its format says: {bad!r}", kind="unsupported"
            ) from error
    return words.astype(kind)


def node_block(lines: Lines, fields: list[str]) -> tuple[Ints, Floats, Floats]:
    """Labels (k,), coordinates (k, 3) and angles of nodal axes (k, 3) of an NBLOCK.

    Raises:
        InputError: not as its format says, cut off, or another count than announced.
    """
    form = layout(lines.take("NBLOCK"), "NBLOCK", lines.name)
    if form.whole < 1 or form.real < 3:
        raise InputError(f"{lines.name}: NBLOCK has a format without label and x, y, z", kind="unsupported")
    parts = [columns(rows, form, "NBLOCK", lines.name) for rows in lines.block("NBLOCK", (b"N,", b"-1", b"NBLOCK"))]
    label = np.concatenate([whole[:, 0] for whole, _ in parts])
    real = np.concatenate([values for _, values in parts])
    count = announced_count(fields, 4)
    if len(label) and label.min() < 1:
        raise InputError(f"{lines.name}: NBLOCK has the node label {label.min()}; expected labels from 1")
    if count and len(label) != count:
        raise InputError(
            f"{lines.name}: NBLOCK holds {len(label)} nodes where it announces {count}; it is cut off",
            kind="file",
            keyword=lines.name,
        )
    angles = np.zeros((len(label), 3))
    angles[:, : min(3, form.real - 3)] = real[:, 3:6]
    return label, real[:, :3], angles


def element_block(lines: Lines, fields: list[str]) -> tuple[bool, Ints]:
    """True if it is of the SOLID form, and the lines (k, columns) of an EBLOCK as they are."""
    form = layout(lines.take("EBLOCK"), "EBLOCK", lines.name)
    if form.real:
        raise InputError(f"{lines.name}: EBLOCK has a format with reals; expected one such as (19i8)")
    parts = [columns(rows, form, "EBLOCK", lines.name)[0] for rows in lines.block("EBLOCK", (b"-1",))]
    key = fields[2].upper() if len(fields) > 2 else ""
    if key == "COMPACT":
        raise InputError(
            f"{lines.name} has an EBLOCK in the compact form; write it again (CDWRITE,DB,model,cdb)",
            kind="file",
            keyword=lines.name,
        )
    solid = key == "SOLID"
    least = 12 if solid else 6
    if form.whole < least:
        raise InputError(f"{lines.name}: EBLOCK has {form.whole} columns; expected {least} or more")
    return solid, np.concatenate(parts).astype(np.int32)


def component_block(lines: Lines, fields: list[str]) -> Ints:
    """Ranges (k, 2) of labels of a CMBLOCK, first and last, single labels too.

    Raises:
        InputError: a range without a start or that runs backwards, or a count that cannot be right.
    """
    name = fields[1] if len(fields) > 1 else "?"
    block = f"CMBLOCK {name}"
    form = layout(lines.take(block), block, lines.name)
    count = announced_count(fields, 3)
    if form.real or not form.whole:
        raise InputError(f"{lines.name}: {block} has a format with reals; expected one such as (8i10)")
    rows = lines.rows(block, -(-count // form.whole))
    given = columns(rows, form, block, lines.name)[0].ravel()
    given, rest = given[:count], given[count:]
    if rest.any() or (given == 0).any():
        raise InputError(
            f"{lines.name}: {block} does not hold the {count} numbers that it announces; it is damaged",
            kind="file",
            keyword=lines.name,
        )
    last = np.flatnonzero(given < 0)
    start = given[last - 1]
    if len(last) and (last[0] == 0 or (start <= 0).any() or (-given[last] < start).any()):
        raise InputError(
            f"{lines.name}: {block} has a range that does not run from a label to a larger one", kind="unsupported"
        )
    ends = np.where(np.append(given[1:], 0) < 0, -np.append(given[1:], 0), given)
    return np.column_stack([given, ends])[given > 0]


def real_constants(lines: Lines, fields: list[str]) -> dict[int, list[float]]:
    """Sets of real constants of an RLBLOCK by number."""
    first = layout(lines.take("RLBLOCK"), "RLBLOCK", lines.name)
    more = layout(lines.take("RLBLOCK"), "RLBLOCK", lines.name)
    if first.whole != 2 or not first.real or not more.real or more.whole:
        raise InputError(f"{lines.name}: RLBLOCK has formats other than (2i8,6g16.9) and (7g16.9)", kind="unsupported")
    result: dict[int, list[float]] = {}
    for _ in range(announced_count(fields, 1)):
        head, values = columns(lines.rows("RLBLOCK", 1), first, "RLBLOCK", lines.name)
        number, count = (int(i) for i in head[0])
        row = values[0].tolist()
        while len(row) < count:
            row.extend(columns(lines.rows("RLBLOCK", 1), more, "RLBLOCK", lines.name)[1][0].tolist())
        result[number] = row[:count]
    return result


def element_types(lines: Lines) -> list[list[int]]:
    """Rows (type, number of the element, key options from 1) of an ETBLOCK."""
    lines.take("ETBLOCK")
    rows = []
    for block in lines.block("ETBLOCK", (b"-1",)):
        for line in block.text.splitlines():
            words = line.split()
            if len(words) < 2 or not all(word.lstrip(b"-").isdigit() and len(word) < 10 for word in words):
                raise InputError(
                    f"{lines.name}: a line of ETBLOCK is not a list of integers: {_quote_line(line)!r}",
                    kind="unsupported",
                )
            rows.append([int(word) for word in words])
    return rows


def announced_count(fields: list[str], place: int) -> int:
    word = fields[place] if place < len(fields) else ""
    return int(word) if word.isdigit() and len(word) < 12 else 0
