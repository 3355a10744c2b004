"""Cards of Nastran bulk data as fields: DMIG entries of a text, in blocks of whole cards."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.text_matrices import integers, numbers, text_blocks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A line of large fields: a name or mark of 8 characters, then four fields of 16.
_MARK, _FIELD, _FIELDS = 8, 16, 4
_LINE = _MARK + _FIELD * _FIELDS
_STAR, _D, _BLANK, _COMMENT = ord("*"), ord("D"), ord(" "), ord("$")


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """A header (its fields from the name on) or entries (k,) of one matrix, with the column of each."""

    name: str
    header: list[str] | None
    column_grid: Ints
    column_component: Ints
    grid: Ints
    component: Ints
    a: Floats
    b: Floats


def dmig_blocks(path: Path) -> Iterator[bytes]:
    """Text in blocks of whole cards, without comments."""
    rest = b""
    for block in text_blocks(path):
        text = rest + block
        if b"$" in text:
            text = re.sub(rb"\$.*", b"", text)
        if b"\r" in text or b"\t" in text:
            text = b"\n".join(line.expandtabs(8) for line in text.replace(b"\r", b"").split(b"\n"))
        starts = text.rfind(b"\nDMIG")
        cut = starts + 1 if starts >= 0 else len(text) if not rest else 0
        rest = text[cut:]
        if cut:
            yield text[:cut]
    if rest:
        yield rest


def columns_of(block: bytes, name: str) -> Iterator[Column]:
    """The DMIG entries of a block."""
    if b"DMIG" not in block.upper():
        return
    plain = _large_columns(block, name)
    if plain is None:
        yield from _any_columns(block, name)
    else:
        yield from plain


def _large_columns(block: bytes, name: str) -> list[Column] | None:
    """Entries of a block in which all lines are large fields; None where some are not."""
    if b"," in block:
        return None
    codes = np.frombuffer(block + b" " * _LINE, dtype=np.uint8)
    ends = np.flatnonzero(codes == 10)
    starts = np.concatenate([[0], ends[:-1] + 1])
    kept = ends > starts
    starts, length = starts[kept], (ends - starts)[kept]
    lines = np.lib.stride_tricks.sliding_window_view(codes, _LINE)[starts].copy()
    lines[np.arange(_LINE) >= length[:, None]] = _BLANK
    begins = lines[:, 0] == _D
    if not (begins | (lines[:, 0] == _STAR)).all() or not begins[0]:
        return None
    heads = lines[begins]
    if (heads[:, :5] != np.frombuffer(b"DMIG*", dtype=np.uint8)).any():
        return None
    is_header = _is_zero(heads[:, _MARK + _FIELD : _MARK + 2 * _FIELD])
    owner = np.cumsum(begins) - 1
    entry = ~begins & ~is_header[owner]
    values = _field_numbers(lines[entry][:, _MARK:], name).reshape(-1, _FIELDS)
    labels = np.zeros((len(heads), 2))
    labels[~is_header] = _field_numbers(heads[~is_header, _MARK + _FIELD : _MARK + 3 * _FIELD], name).reshape(-1, 2)
    names = heads[:, _MARK : _MARK + _FIELD].copy().view(f"S{_FIELD}").ravel()
    cards = []
    # Runs of one name between headers.
    turn = np.flatnonzero(is_header | np.concatenate([[True], names[1:] != names[:-1]]))
    turn = np.unique(np.concatenate([turn, turn[is_header[turn]] + 1, [len(heads)]]))
    turn = turn[turn <= len(heads)]
    of_entry = owner[entry]
    for begin, end in zip(turn[:-1].tolist(), turn[1:].tolist(), strict=True):
        title = names[begin].decode("latin-1").strip().upper()
        if is_header[begin]:
            own = lines[(owner == begin)][:, _MARK:]
            fields = [bytes(f).decode("latin-1").strip() for f in own.reshape(-1, _FIELD)]
            cards.append(_card(title, fields, name))
            continue
        part = slice(*np.searchsorted(of_entry, [begin, end]).tolist())
        at = integers(labels[of_entry[part]], "a grid or component of a column", name)
        cards.append(_entries(title, at, values[part], name))
    return cards


def _is_zero(fields: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Whether a field holds the number 0."""
    return np.asarray(((fields == _BLANK) | (fields == ord("0"))).all(axis=1) & (fields == ord("0")).any(axis=1))


def _field_numbers(lines: NDArray[np.uint8], name: str) -> Floats:
    """Numbers of fields of 16 characters; a blank field is 0."""
    fields = lines.reshape(-1, _FIELD)
    text = np.full((len(fields), _FIELD + 1), 10, dtype=np.uint8)
    text[:, :_FIELD] = fields
    text[(fields == _BLANK).all(axis=1), 0] = ord("0")
    values = numbers(text.tobytes(), name)
    if len(values) != len(fields):
        raise InputError(f"{name} has DMIG fields that do not keep to their columns; expected 16 characters each")
    return values


def _entries(title: str, at: Ints, values: Floats, name: str) -> Column:
    if len(values) and not values[:, 0].all():
        # An entry without a grid: the blank rest of a line.
        used = values.any(axis=1)
        at, values = at[used], values[used]
    labels = integers(values[:, :2], "a grid or component", name)
    both = np.concatenate([labels, at])
    if len(both) and (both[:, 0].min() < 1 or both[:, 1].min() < 0 or both[:, 1].max() > 6):
        raise InputError(f"{name}: the DMIG {title} names a grid below 1 or a component beyond 0 to 6; it is damaged")
    return Column(
        name=title, header=None, column_grid=at[:, 0], column_component=at[:, 1], grid=labels[:, 0],
        component=labels[:, 1], a=values[:, 2], b=values[:, 3],
    )  # fmt: skip


def _any_columns(block: bytes, name: str) -> Iterator[Column]:
    """Entries in any of the three ways to write fields, line by line."""
    card: list[str] = []
    for line in [*block.decode("latin-1").split("\n"), "END"]:
        if not line.strip():
            continue
        if line[0].isalpha():
            if card:
                yield _card(card[0].upper(), card, name)
            card = _fields(line) if line[:5].upper().rstrip(" ,") in ("DMIG", "DMIG*") else []
        elif card:
            card += _fields(line)


def _fields(line: str) -> list[str]:
    """Data fields of a line, eight or four."""
    if "," in line:
        parts = [part.strip() for part in line.split(",")]
        count = 4 if "*" in parts[0] else 8
        data = parts[1 : 1 + count]
        return data + [""] * (count - len(data))
    if "*" in line[:_MARK]:
        return [line[i : i + 16].strip() for i in range(8, 72, 16)]
    return [line[i : i + 8].strip() for i in range(8, 72, 8)]


def _card(title: str, fields: list[str], name: str) -> Column:
    if fields[1] in ("0", ""):
        none = np.empty(0, dtype=np.int64)
        empty = np.empty(0)
        return Column(
            name=title, header=fields, column_grid=none, column_component=none, grid=none, component=none, a=empty,
            b=empty,
        )  # fmt: skip
    data = [field or "0" for field in [*fields[1:3], *fields[4:]]]
    values = numbers(("\n".join(data) + "\n").encode("latin-1"), name)
    if len(values) != len(data) or len(data) % 4 != 2:
        raise InputError(f"{name}: a column of the DMIG {title} has {len(data) - 2} fields; expected four per entry")
    at = integers(values[:2], "a grid or component of a column", name)
    entries = values[2:].reshape(-1, 4)
    return _entries(title, np.tile(at, (len(entries), 1)), entries, name)
