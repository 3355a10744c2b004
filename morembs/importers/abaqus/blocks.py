"""What the data lines of *ELEMENT, *NSET and *ELSET of input decks hold."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import groupby

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Bools, Ints
from morembs.importers.abaqus.data import element_numbers, fields, label, members
from morembs.importers.abaqus.deck import DISCRETE, NODES, SOLIDS, Members
from morembs.importers.abaqus.keywords import Card

_BEAMS = re.compile(r"B3([123])")
_PLANES = re.compile(r"(?:S|CPS|CPE|CPEG|CAX|M3D|T3D|T2D|R3D|STRI|SFM3D|DC3D|F3D|AC3D|COH3D|SC|GK3D|CONN3D)(\d\d?)")
_NONE = np.empty(0, dtype=np.int64)


def set_parts(card: Card, pieces: Iterator[bytes], instance: str) -> Iterator[Members]:
    """What a *NSET or *ELSET puts into its set, which is there also where it is nothing."""
    if "ELSET" in card.options and card.keyword == "NSET":
        source = [card.options["ELSET"]] if card.options["ELSET"] else []
        source += [text for row in fields(b"".join(pieces)) for text in row if text]
        yield Members(_NONE, [], source, instance, of_elements=True)
        return
    yield Members(_NONE, [], [], instance)
    for piece in pieces:
        if "GENERATE" in card.options:
            yield Members(_NONE, [_range(row, card) for row in fields(piece) if row], [], instance)
        elif piece and "UNSORTED" in card.options:
            yield from _list_members(piece, instance)
        elif piece:
            labels, names = members(piece, card)
            yield Members(labels, [], names, instance)


def _list_members(piece: bytes, instance: str) -> Iterator[Members]:
    """Labels and names in their order."""
    texts = [text for row in fields(piece) for text in row if text]
    for named, group in groupby(texts, key=lambda text: label(text) is None):
        own = list(group)
        ids = np.array([] if named else own, dtype=np.int64)
        yield Members(ids, [], own if named else [], instance, unsorted=True)


def _range(row: list[str], card: Card) -> tuple[int, int, int]:
    parts = [label(text) for text in row]
    if len(parts) in (2, 3) and None not in parts:
        first, last, step = (int(p or 0) for p in [*parts, 1][:3])
        if step > 0 and last >= first:
            return first, last, step
    raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected first label, last label and step")


def solid_records(card: Card, pieces: Iterator[bytes], code: str) -> Iterator[Ints]:
    """Label and nodes (k, width) of elements; each must begin on a line of its own."""
    width = 1 + NODES[SOLIDS[code]]
    rest, rest_first = np.empty(0, dtype=np.int64), np.empty(0, dtype=bool)
    for piece in pieces:
        if not piece:
            continue
        values, first = _without_more(*element_numbers(piece, card), width)
        values, first = np.concatenate([rest, values]), np.concatenate([rest_first, first])
        whole = len(values) // width * width
        rows = values[:whole].reshape(-1, width)
        shifted = np.flatnonzero(~first[:whole].reshape(-1, width)[:, 0])
        if len(shifted):
            near = rows[max(int(shifted[0]) - 1, 0), 0]
            raise InputError(
                f"{card}, TYPE={code}: the element {near} does not have {width - 1} nodes; expected a label and "
                f"{width - 1} nodes (a multiple of {width} numbers), each element on a line of its own"
            )
        rest, rest_first = values[whole:], first[whole:]
        yield rows
    if len(rest):
        raise InputError(
            f"{card}, TYPE={code}: the block does not hold a multiple of {width} numbers (label and {width - 1} nodes "
            f"for each element): {len(rest)} are left over; the file may be cut off",
            kind="file",
        )


def _without_more(values: Ints, first: Bools, width: int) -> tuple[Ints, Bools]:
    """Numbers (k,) of lines, and which begin a line, without those beyond the last node where all lines have equally
    many: CalculiX passes over them."""
    starts = np.flatnonzero(first)
    count = len(values) // max(len(starts), 1)
    if count <= width or not np.array_equal(starts, np.arange(0, len(values), count)) or len(values) % count:
        return values, first
    return values.reshape(-1, count)[:, :width].ravel(), first.reshape(-1, count)[:, :width].ravel()


def other_records(card: Card, pieces: Iterator[bytes], code: str) -> Iterator[tuple[int, list[str]]]:
    """Label (0: none that is one) and nodes as they are written of elements that are no solids.

    Raises:
        InputError: an element on single nodes without these.
    """
    count, missing = _nodes_of(code), 0
    for row in fields(b"".join(pieces), ends=True):
        if not row:
            continue
        here, open_end = len([text for text in row if text]), not row[-1]
        if missing > 0:
            missing -= here
            continue
        # Where nobody knows how many nodes a type has, a line that ends in a comma goes on.
        missing = count + 1 - here if count else int(open_end)
        given, nodes = label(row[0]), [text for text in row[1:] if text]
        if code in DISCRETE and (given is None or len(nodes) != DISCRETE[code]):
            raise InputError(
                f"{card}: {', '.join(row)[:60]!r} was given; expected a label and "
                f"{'a node' if DISCRETE[code] == 1 else 'two nodes'}"
            )
        yield given or 0, nodes


def _nodes_of(code: str) -> int:
    """Nodes of an element that is no solid, 0 where that is not known."""
    if code in DISCRETE:
        return DISCRETE[code]
    beam = _BEAMS.match(code)
    plane = _PLANES.match(code)
    return (2, 3, 2)[int(beam.group(1)) - 1] if beam else int(plane.group(1)) if plane else 0


def line_records(card: Card, pieces: Iterator[bytes], code: str, width: int) -> Ints:
    """Label and nodes (k, 1 + width) of elements; data may go on in further lines, and lines may name more nodes."""
    values, first = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=bool)]
    for piece in pieces:
        if piece:
            own, begins = element_numbers(piece, card)
            values.append(own)
            first.append(begins)
    numbers, starts = np.concatenate(values), np.flatnonzero(np.concatenate(first))
    if len(numbers) % (width + 1) == 0 and np.isin(np.arange(0, len(numbers), width + 1), starts).all():
        return numbers.reshape(-1, width + 1)
    rows, row = [], list[int]()
    for line in np.split(numbers, starts[1:]):
        row += line.tolist()
        if len(row) > width:
            # As CalculiX does: what a line has beyond the last node is passed over.
            rows.append(row[: width + 1])
            row = []
    if row:
        raise InputError(
            f"{card}, TYPE={code}: the element {row[0]} has {len(row) - 1} nodes, expected {width}; the file may be "
            "cut off",
            kind="file",
        )
    return np.array(rows, dtype=np.int64).reshape(-1, width + 1)
