"""Abaqus and CalculiX input decks: nodes, solid elements, sets, with their labels.

Read here and not by meshio, which drops labels, sets named inside keywords and hex20 variants.
One part or one flat mesh is read; a deck with several instances is refused rather than misread.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.model import ElementBlock, Mesh, Nodes

Ints = NDArray[np.int64]
# Abaqus numbers the nodes of all these as VTK does.
SOLIDS = {
    "C3D4": "tet4", "C3D10": "tet10", "C3D10M": "tet10", "C3D10I": "tet10", "C3D8": "hex8", "C3D8R": "hex8",
    "C3D8I": "hex8", "C3D20": "hex20", "C3D20R": "hex20", "C3D27": "hex27", "C3D6": "wedge6", "C3D15": "wedge15",
}  # fmt: skip
NODES = {"tet4": 4, "tet10": 10, "hex8": 8, "hex20": 20, "hex27": 27, "wedge6": 6, "wedge15": 15}


@dataclass
class _Deck:
    """What has been read so far; sets hold labels and names of other sets."""

    name: str
    node_ids: list[int] = field(default_factory=list)
    xyz: list[list[float]] = field(default_factory=list)
    elements: dict[str, list[list[int]]] = field(default_factory=dict)
    node_sets: dict[str, list[str]] = field(default_factory=dict)
    element_sets: dict[str, list[str]] = field(default_factory=dict)
    instances: int = 0


def read_abaqus(path: Path) -> Mesh:
    """Mesh of an input deck in the deck's own units.

    Raises:
        InputError: not a deck, an element type that is not supported, or several instances.
    """
    deck = _Deck(path.name)
    try:
        for keyword, options, lines in _blocks(path):
            _take(deck, keyword, options, lines)
    except (ValueError, UnicodeDecodeError, IndexError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path.name} cannot be read as an Abaqus input deck ({error}); check the file") from error
    if not deck.node_ids:
        raise InputError(f"{path.name} has no *NODE block; expected an Abaqus or CalculiX input deck with a mesh")
    if deck.instances > 1:
        raise InputError(f"{path.name} has {deck.instances} instances; expected one part (write a flat deck)")
    return _mesh(deck)


def _blocks(path: Path) -> Iterator[tuple[str, dict[str, str], list[str]]]:
    """(KEYWORD, {OPTION: value}, data lines) of each keyword block."""
    keyword, options, lines = "", {}, []  # type: tuple[str, dict[str, str], list[str]]
    text = path.read_text(encoding="utf-8", errors="strict").replace("\r", "").split("\n")
    for line in text:
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*"):
            if keyword:
                yield keyword, options, lines
            head, *rest = line[1:].split(",")
            keyword, lines = " ".join(head.upper().split()), []
            pairs = [part.partition("=") for part in rest if part.strip()]
            options = {key.strip().upper(): value.strip() for key, _, value in pairs}
        else:
            lines.append(line)
    if keyword:
        yield keyword, options, lines


def _take(deck: _Deck, keyword: str, options: dict[str, str], lines: list[str]) -> None:
    if keyword == "NODE":
        for line in lines:
            fields = line.split(",")
            deck.node_ids.append(int(fields[0]))
            deck.xyz.append([float(f.strip() or "0") for f in (fields[1:4] + ["0"] * 3)[:3]])
        if options.get("NSET"):
            deck.node_sets.setdefault(options["NSET"], []).extend(line.split(",")[0] for line in lines)
    elif keyword == "ELEMENT":
        _take_elements(deck, options, lines)
    elif keyword in ("NSET", "ELSET"):
        sets = deck.node_sets if keyword == "NSET" else deck.element_sets
        sets.setdefault(options.get(keyword, ""), []).extend(_members(lines, "GENERATE" in options))
    elif keyword == "INSTANCE":
        deck.instances += 1
        if lines:
            raise InputError(
                f"{deck.name} moves an instance (data lines under *INSTANCE); only a mesh in place can be read, "
                "write a flat deck"
            )
    elif keyword == "INCLUDE":
        raise InputError(f"{deck.name} uses *INCLUDE, which is not followed; paste the included file in")


def _take_elements(deck: _Deck, options: dict[str, str], lines: list[str]) -> None:
    code = options.get("TYPE", "").upper()
    if code not in SOLIDS:
        raise InputError(
            f"{deck.name} has elements of the type {code or '(none)'!r}, which is not supported; expected one of "
            f"{', '.join(sorted(SOLIDS))}"
        )
    width = 1 + NODES[SOLIDS[code]]
    numbers = [int(f) for line in lines for f in line.split(",") if f.strip()]
    if len(numbers) % width:
        raise InputError(
            f"{deck.name}: a *ELEMENT, TYPE={code} block holds {len(numbers)} numbers; expected a multiple of {width} "
            f"(label and {width - 1} nodes each)"
        )
    rows = [numbers[i : i + width] for i in range(0, len(numbers), width)]
    deck.elements.setdefault(SOLIDS[code], []).extend(rows)
    if options.get("ELSET"):
        deck.element_sets.setdefault(options["ELSET"], []).extend(str(row[0]) for row in rows)


def _members(lines: list[str], generate: bool) -> list[str]:
    if not generate:
        return [f.strip() for line in lines for f in line.split(",") if f.strip()]
    labels: list[str] = []
    for line in lines:
        first, last, *step = (int(f) for f in line.split(",") if f.strip())
        labels.extend(str(i) for i in range(first, last + 1, *step))
    return labels


def _labels(sets: dict[str, list[str]], name: str, seen: frozenset[str] = frozenset()) -> set[int]:
    """Labels of a set, other sets inside it resolved."""
    upper = {key.upper(): key for key in sets}
    result: set[int] = set()
    for member in sets[name]:
        if member.lstrip("-").isdigit():
            result.add(int(member))
        elif member.upper() in upper and upper[member.upper()] not in seen:
            result |= _labels(sets, upper[member.upper()], seen | {name})
        else:
            raise InputError(f"the set {name!r} names {member!r}, which is neither a label nor a set")
    return result


def _mesh(deck: _Deck) -> Mesh:
    all_ids = np.array(deck.node_ids, dtype=np.int64)
    if len(np.unique(all_ids)) != len(all_ids):
        raise InputError(f"{deck.name} defines some nodes twice; expected unique node labels")
    order = np.argsort(all_ids)
    rows = {kind: np.array(block, dtype=np.int64) for kind, block in deck.elements.items()}
    named = np.unique(np.concatenate([r[:, 1:].ravel() for r in rows.values()])) if rows else all_ids[order]
    found = np.isin(named, all_ids)
    if not found.all():
        raise InputError(f"{deck.name}: elements name the node {named[~found][0]}, which is not defined")
    ids = named
    xyz = np.array(deck.xyz)[order][np.searchsorted(all_ids[order], ids)]
    blocks = tuple(
        ElementBlock(type=kind, nodes=np.searchsorted(ids, r[:, 1:]), ids=r[:, 0]) for kind, r in rows.items()
    )
    node_sets = {}
    for name in deck.node_sets:
        labels = np.array(sorted(_labels(deck.node_sets, name)), dtype=np.int64)
        members = np.searchsorted(ids, labels[np.isin(labels, ids)])
        if len(members):
            node_sets[name] = members
    element_sets = {}
    for name in deck.element_sets:
        labels = np.array(sorted(_labels(deck.element_sets, name)), dtype=np.int64)
        picked = tuple(np.flatnonzero(np.isin(block.ids, labels)) for block in blocks)
        if any(len(p) for p in picked):
            element_sets[name] = picked
    return Mesh(
        nodes=Nodes(ids=ids, xyz=xyz, sets=node_sets), blocks=blocks, element_sets=element_sets, source=deck.name
    )
