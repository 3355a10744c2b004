"""*NGEN, *NFILL, *NCOPY, *ELGEN and *ELCOPY of an input deck: nodes and elements that others give rise to.

They take what their scope holds where they stand. Labels of generated nodes and elements are those of the manual of
Abaqus; CalculiX has none of these keywords.
"""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.data import label
from morembs.importers.abaqus.deck import Members, NamedSet, Rows, Scope, join, values
from morembs.importers.abaqus.keywords import Card
from morembs.importers.decks.algebra import rotation_about
from morembs.importers.tolerances import TOL

GENERATING = ("NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY")
_NOT_HERE = ("SYSTEM", "SINGULAR", "BIAS", "TWO STEP", "POLE", "REFLECT", "ALL NODES")


def generate(scope: Scope, card: Card, rows: Rows) -> dict[str, int]:
    """Put nodes and elements that a keyword generates into its scope; returns counts of new elements by type.

    Raises:
        InputError: options that are not supported, or labels and sets that are not there.
    """
    wrong = [option for option in _NOT_HERE if option in card.options]
    wrong += ["LINE"] if card.options.get("LINE", "C").upper() != "C" else []
    if wrong:
        raise InputError(
            f"{card} is given with {wrong[0]}, which is not supported; write its nodes and elements out",
            kind="conflict",
        )
    rows = [row for row in rows if row]
    if card.keyword == "NGEN":
        for row in rows:
            _line_of_nodes(scope, card, row)
    elif card.keyword == "NFILL":
        for row in rows:
            _fill(scope, card, row)
    elif card.keyword == "NCOPY":
        _copy_nodes(scope, card, rows)
    elif card.keyword == "ELCOPY":
        return _copy_elements(scope, card)
    else:
        return _rows_of_elements(scope, card, rows)
    return {}


def _add_nodes(scope: Scope, name: str, ids: Ints, xyz: Floats, more: Ints | None = None) -> None:
    if len(ids) > TOL.max_generated:
        raise InputError(f"{len(ids)} nodes are generated at once; check the numbers of the line", kind="unsupported")
    scope.node_ids.append(ids)
    scope.xyz.append(xyz)
    join(scope.node_sets, name, Members(ids if more is None else np.concatenate([more, ids]), [], [], ""))


def _places(scope: Scope, card: Card, labels: Ints) -> Floats:
    """Coordinates (n, 3) of nodes of the scope by their labels."""
    ids = np.concatenate([np.empty(0, dtype=np.int64), *scope.node_ids])
    order = np.argsort(ids, kind="stable")
    at = np.minimum(np.searchsorted(ids[order], labels), max(len(ids) - 1, 0))
    missing = np.asarray(labels)[ids[order][at] != labels] if len(ids) else np.asarray(labels)
    if len(missing):
        raise InputError(f"{card} names the node {missing[0]}, which is not defined before it", kind="unknown")
    return np.concatenate(scope.xyz)[order[at]]


def _members(sets: dict[str, NamedSet], card: Card, text: str, depth: int = 0) -> Ints:
    """Labels of a set as it is paired with others, or one label."""
    own = label(text)
    if own is not None:
        return np.array([own])
    if text.upper() not in sets or depth > 50:
        raise InputError(
            f"{card} names {text!r}, which is neither a label nor a set that is defined before it", kind="unsupported"
        )
    pieces, listed = [np.empty(0, dtype=np.int64)], False
    for part in sets[text.upper()].parts:
        if part.of_elements or part.instance:
            raise InputError(f"{card} names the set {text!r}, which is not one of labels", kind="unsupported")
        pieces += [part.labels, *(np.arange(a, b + 1, s) for a, b, s in part.ranges)]
        pieces += [_members(sets, card, name, depth + 1) for name in part.names]
        listed |= part.unsorted
    return np.concatenate(pieces) if listed else np.unique(np.concatenate(pieces))


def _integers(card: Card, row: list[str], defaults: tuple[int | None, ...]) -> list[int]:
    """The fields of a line as integers; None where there is no default."""
    integers = []
    for i, default in enumerate(defaults):
        text = row[i] if i < len(row) else ""
        value = label(text) if text else default
        if value is None:
            raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected integers")
        integers.append(value)
    return integers


def _line_of_nodes(scope: Scope, card: Card, row: list[str]) -> None:
    """Nodes between two, on a straight line, or on an arc about a centre."""
    first, last, step = _integers(card, row, (None, None, 1))
    if step < 1 or (last - first) % step or last <= first:
        raise InputError(
            f"{card}: from node {first} to {last} in steps of {step} is no line of nodes", kind="unsupported"
        )
    count = (last - first) // step
    a, b = _places(scope, card, np.array([first, last]))
    t = np.arange(1, count) / count
    xyz = a + t[:, None] * (b - a)
    if card.options.get("LINE", "").upper() == "C":
        xyz = _arc(scope, card, row, a, b, t)
    _add_nodes(scope, card.options.get("NSET", ""), first + step * np.arange(1, count), xyz, np.array([first, last]))


def _arc(scope: Scope, card: Card, row: list[str], a: Floats, b: Floats, t: Floats) -> Floats:
    """Places on an arc from ``a`` to ``b`` about the centre in the fields 4 (a node) or 5 to 7, as t (n,) goes to 1."""
    numbers = np.array((values([*row[4:], *[""] * 6], card))[:6])
    center = _places(scope, card, np.array([label(row[3])]))[0] if len(row) > 3 and row[3] else numbers[:3]
    from_, to, normal = a - center, b - center, np.cross(a - center, b - center)
    angle = float(np.arctan2(np.linalg.norm(normal), from_ @ to))
    if numbers[3:].any():
        axis = numbers[3:] / np.linalg.norm(numbers[3:])
        angle = float(np.arctan2(axis @ normal, from_ @ to)) % (2 * np.pi)
    elif not np.linalg.norm(normal) > TOL.parallel * np.linalg.norm(from_) * np.linalg.norm(to):
        raise InputError(
            f"{card}: the ends of an arc are on a line with its centre; give the normal of its plane",
            kind="unsupported",
        )
    else:
        axis = normal / np.linalg.norm(normal)
    sizes = np.linalg.norm(from_) + t * (np.linalg.norm(to) - np.linalg.norm(from_))
    turned = np.array([rotation_about(axis, angle * part) @ from_ for part in t])
    return np.asarray(center + turned * (sizes / np.linalg.norm(from_))[:, None])


def _fill(scope: Scope, card: Card, row: list[str]) -> None:
    """Nodes on lines between those of two sets; of the longer one the first."""
    if len(row) < 2:
        raise InputError(f"{card}: {', '.join(row)!r} was given; expected two sets of nodes and a number of intervals")
    first, second = (_members(scope.node_sets, card, text) for text in row[:2])
    intervals, step = _integers(card, row[2:], (None, 1))
    if intervals < 1:
        raise InputError(f"{card}: {intervals} intervals were given; expected one at least")
    first, second = first[: len(second)], second[: len(first)]
    a, b = _places(scope, card, first), _places(scope, card, second)
    t = np.arange(1, intervals) / intervals
    ids = first + step * np.arange(1, intervals)[:, None]
    xyz = a + t[:, None, None] * (b - a)
    more = np.concatenate([first, second])
    _add_nodes(scope, card.options.get("NSET", ""), ids.ravel(), xyz.reshape(-1, 3), more)


def _copy_nodes(scope: Scope, card: Card, rows: Rows) -> None:
    """Nodes of a set, shifted and turned, ``MULTIPLE`` times."""
    labels = _members(scope.node_sets, card, card.need("OLD SET"))
    number, multiple = _integers(card, [card.options.get(k, "") for k in ("CHANGE NUMBER", "MULTIPLE")], (None, 1))
    if "SHIFT" not in card.options or not rows:
        raise InputError(f"{card} is not given with SHIFT and its lines, which is expected", kind="conflict")
    shift, turn = np.array((values(rows[0], card) + [0.0] * 3)[:3]), np.array([0.0] * 7)
    if len(rows) > 1:
        turn = np.array((values(rows[1], card) + [0.0] * 7)[:7])
    axis = turn[3:6] - turn[:3]
    if turn[6] and not np.linalg.norm(axis) > 0:
        raise InputError(f"{card}: the two points of the axis of rotation must differ")
    R = rotation_about(axis / np.linalg.norm(axis), np.radians(turn[6])) if turn[6] else np.eye(3)
    xyz = _places(scope, card, labels)
    for time in range(1, multiple + 1):
        xyz = (xyz + shift - turn[:3]) @ R.T + turn[:3]
        _add_nodes(scope, card.options.get("NEW SET", ""), labels + time * number, xyz)


def _element(scope: Scope, card: Card, number: int) -> tuple[str, Ints]:
    """Type and nodes of an element of the scope."""
    for code, pieces in scope.elements.items():
        for piece in pieces:
            at = np.flatnonzero(piece[:, 0] == number)
            if len(at):
                return code, piece[at[0], 1:]
    raise InputError(
        f"{card} names the element {number}, which is no solid that is defined before it", kind="unsupported"
    )


def _rows_of_elements(scope: Scope, card: Card, rows: Rows) -> dict[str, int]:
    """Elements in rows, in rows of rows and in layers of these, from a master element each."""
    more: dict[str, int] = {}
    for row in rows:
        master, *numbers = _integers(card, row, (None, None, None, 1, 1, 0, 0, 1, 0, 0))
        if min(numbers[::3]) < 1 or np.prod([float(n) for n in numbers[::3]]) > TOL.max_generated:
            raise InputError(f"{card}: {', '.join(row)[:60]!r} was given; expected positive numbers of elements")
        code, nodes = _element(scope, card, master)
        i, j, k = (g.ravel() for g in np.indices((numbers[6], numbers[3], numbers[0]))[::-1])
        to = numbers[2] * i + numbers[5] * j + numbers[8] * k
        by = numbers[1] * i + numbers[4] * j + numbers[7] * k
        elements = np.column_stack([master + to, nodes + by[:, None]])
        scope.elements[code].append(elements[1:])
        more[code] = more.get(code, 0) + len(elements) - 1
        join(scope.element_sets, card.options.get("ELSET", ""), Members(elements[:, 0].copy(), [], [], ""))
    return more


def _copy_elements(scope: Scope, card: Card) -> dict[str, int]:
    """Elements of a set with other labels, on nodes with other labels."""
    options = [card.options.get(key, "") for key in ("ELEMENT SHIFT", "SHIFT NODES")]
    number, by = _integers(card, options, (None, None))
    old, more = _members(scope.element_sets, card, card.need("OLD SET")), dict[str, int]()
    for code, pieces in scope.elements.items():
        own = np.concatenate(pieces)
        copies = own[np.isin(own[:, 0], old)]
        if len(copies):
            copies = np.column_stack([copies[:, 0] + number, copies[:, 1:] + by])
            pieces.append(copies)
            more[code] = len(copies)
            join(scope.element_sets, card.options.get("NEW SET", ""), Members(copies[:, 0].copy(), [], [], ""))
    return more
