"""The mesh of an assembled input deck: nodes that solids use, its sets under their final names."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from morembs.base.types import Ints
from morembs.fem import Mesh, Nodes
from morembs.importers.abaqus.assembly import Assembly
from morembs.importers.imported import first_nodes


def mesh_of(assembly: Assembly, extra: Ints) -> tuple[Mesh, Nodes, Ints]:
    """Mesh of the solids, its nodes with ``extra`` rows behind them, and the row among these of all nodes (or -1)."""
    used = np.zeros(len(assembly.ids), dtype=bool)
    for block in assembly.blocks:
        used[block.nodes] = True
    if not assembly.blocks:
        used[:] = True
    kept = np.flatnonzero(used)
    kept = kept[np.argsort(assembly.ids[kept], kind="stable")]
    loose = np.unique(extra[~used[extra]])
    row = np.full(len(assembly.ids), -1, dtype=np.int64)
    row[kept] = np.arange(len(kept))
    row[loose] = len(kept) + np.arange(len(loose))
    blocks = [replace(block, nodes=row[block.nodes]) for block in assembly.blocks]
    node_sets = {}
    for name, (placed, own) in assembly.named("node").items():
        rows = np.empty(0, dtype=np.int64)
        with assembly.problems.collected():
            rows = row[assembly.members("node", placed, own)]
        if (rows >= 0).any():
            node_sets[name] = np.sort(rows[rows >= 0])
        else:
            assembly.notes.append(f"The node set {name} holds no node of the model and was left out.")
    spans = np.cumsum([0, *(len(block.ids) for block in blocks)])
    element_sets = {}
    for name, (placed, own) in assembly.named("element").items():
        numbers = np.empty(0, dtype=np.int64)
        with assembly.problems.collected():
            numbers = assembly.members("element", placed, own)
        picked = tuple(numbers[slice(*np.searchsorted(numbers, [a, b]))] - a for a, b in pairwise(spans.tolist()))
        if any(len(p) for p in picked):
            element_sets[name] = picked
    assembly.blocks = []
    left = len(assembly.ids) - len(kept) - len(loose)
    if left:
        first = assembly.ids[row < 0].min()
        assembly.notes.append(f"{left} nodes belong to no element and were left out (first: {first}).")
    both = np.concatenate([kept, loose])
    nodes = Nodes(ids=assembly.ids[both], xyz=assembly.xyz[both], sets=node_sets)
    mesh = Mesh(
        nodes=first_nodes(nodes, len(kept)),
        blocks=tuple(blocks),
        element_sets=element_sets,
        source=assembly.deck,
        warnings=tuple(assembly.warnings),
    )
    return mesh, nodes, row
