"""What CalculiX made of shells and beams: job.12d (topology) and job.frd (places of the expanded nodes)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.engines.calculix.rows import Expanded

_LABEL = re.compile(r'with label "(\w+)')
_KNOT = re.compile(r"KNOT was generated in node +(\d+)")
_BLOCK = b"    2C"
# Places in the expanded element that each node of its parent becomes; both in CalculiX' order.
_LAYERS3 = tuple((i, i + 3) for i in range(3))
_LAYERS4 = tuple((i, i + 4) for i in range(4))
_LAYERS6 = ((0, 3, 12), (1, 4, 13), (2, 5, 14), (6, 9), (7, 10), (8, 11))
_LAYERS8 = (*((i, i + 4, i + 16) for i in range(4)), *((i + 8, i + 12) for i in range(4)))
_BAR2 = ((0, 3, 4, 7), (1, 2, 5, 6))
_BAR3 = ((0, 3, 4, 7, 11, 15, 16, 19), (8, 10, 12, 14), (1, 2, 5, 6, 9, 13, 17, 18))
_BECOMES = {
    ("S", 3): _LAYERS3,
    ("S", 4): _LAYERS4,
    ("S", 6): _LAYERS6,
    ("S", 8): _LAYERS8,
    ("M", 3): _LAYERS3,
    ("M", 4): _LAYERS4,
    ("M", 6): _LAYERS6,
    ("M", 8): _LAYERS8,
    ("B", 2): _BAR2,
    ("B", 3): _BAR3,
    ("T", 2): _BAR2,
    ("T", 3): _BAR3,
}


def read_expansion(topology: Path, result: Path) -> Expanded | None:
    """Nodes of expanded elements, None where nothing was expanded.

    Raises:
        InputError: files that are cut off, or of another version.
    """
    if not topology.is_file() or not topology.stat().st_size:
        return None
    parent: dict[int, int] = {}
    knots: list[int] = []
    hinged, others = set[int](), set[int]()
    lines = iter(topology.read_text(errors="replace").splitlines())
    for line in lines:
        knot, head = _KNOT.search(line), _LABEL.search(line)
        if knot is not None:
            knots.append(int(knot[1]))
        if head is None:
            continue
        own = [int(text) for text in next(lines, "").split()]
        numbers: list[int] = []
        next(lines, "")
        for text in lines:
            if not text.strip():
                break
            numbers += [int(part) for part in text.split()]
        table = _BECOMES.get((head[1][0], len(own)))
        if table is None or len(numbers) <= max(max(places) for places in table):
            raise InputError(
                f"{topology.name} has an element {head[1]} of {len(own)} nodes, which is not known here", kind="unknown"
            )
        (hinged if head[1][0] in "TM" else others).update(own)
        for label, places in zip(own, table, strict=True):
            parent |= {numbers[place]: label for place in places}
    if not parent:
        return None
    nodes = np.array(sorted(parent), dtype=np.int64)
    return Expanded(
        nodes=nodes,
        xyz=_places(result, nodes),
        parent=np.array([parent[node] for node in nodes.tolist()]),
        knots=np.array(knots, dtype=np.int64),
        hinges=np.array(sorted(hinged - others), dtype=np.int64),
    )


def _places(path: Path, nodes: Ints) -> NDArray[np.float64]:
    """Places (n, 3) of ``nodes`` in a binary .frd."""
    data = path.read_bytes() if path.is_file() else b""
    start = data.find(_BLOCK)
    end = data.find(b"\n", start) + 1
    head = data[start:end].split()
    if start < 0 or len(head) < 3 or head[-1] != b"3":
        raise InputError(
            f"{path.name} has no places of expanded nodes; expected one of *NODE OUTPUT, OUTPUT=3D", kind="unsupported"
        )
    count = int(head[1])
    # Label and place of each node, as its binary form has them.
    kind = np.dtype([("label", "<i4"), ("xyz", "<f8", 3)])
    if len(data) < end + count * kind.itemsize:
        raise InputError(
            f"{path.name} is cut off within the places of its {count} nodes", kind="file", keyword=path.name
        )
    table = np.frombuffer(data, dtype=kind, count=count, offset=end)
    at = np.minimum(np.searchsorted(table["label"], nodes), count - 1)
    if (table["label"][at] != nodes).any():
        raise InputError(f"{path.name} does not name all nodes of the expanded elements", kind="unsupported")
    return np.asarray(table["xyz"][at], dtype=np.float64)
