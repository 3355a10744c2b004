"""Findings where they are: nodes and elements of a mesh that an examination names, open edges and loose parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import cast

import numpy as np

from morembs.base.types import Ints
from morembs.body.diagnostics.elements import bodies_of_nodes, double_elements, open_seams
from morembs.body.diagnostics.findings import Finding, list_labels
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import Mesh, Nodes
from morembs.fem.surface import seen_faces
from morembs.fem.viewer.scene import Group, Kind
from morembs.fem.viewer.skin import triangles_of


def mesh_findings(mesh: Mesh) -> list[Finding]:
    """What a mesh shows by itself: elements that are there twice, and nodes that were not merged."""
    return [*double_elements(mesh), *open_seams(mesh)]


def groups_of_findings(findings: Sequence[Finding], nodes: Nodes, mesh: Mesh | None, joined: Ints) -> list[Group]:
    """Findings with the nodes that they name; then what can only be seen: open edges, loose parts, orphan nodes.

    Args:
        joined: rows of nodes that rigid and average elements, masses or springs hold, and so do without elements.
    """
    groups = []
    for finding in findings:
        rows = _rows(finding, nodes, mesh)
        sentence = f"{finding.sentence}; {finding.cure}" if finding.cure else finding.sentence
        groups.append(
            Group(name=finding.code, kind=cast(Kind, finding.severity), nodes=rows, count=len(rows), about=sentence)
        )
    if mesh is None or not mesh.blocks:
        return groups
    return [*groups, *_open_edges(mesh), *_loose_parts(mesh, len(nodes)), *_orphans(mesh, nodes, joined)]


def _rows(finding: Finding, nodes: Nodes, mesh: Mesh | None) -> Ints:
    """Rows of the nodes that a finding is about."""
    numbers = [int(found[1]) for label in finding.where if (found := re.fullmatch(r"(?:node )?(-?\d+)( .*)?", label))]
    labels = np.unique(np.array(numbers, dtype=np.int64))
    if finding.code == "double-elements":
        blocks = mesh.blocks if mesh is not None else ()
        held = [block.nodes[np.isin(block.ids, labels)].ravel() for block in blocks]
        return np.unique(np.concatenate([labels[:0], *held]))
    return np.flatnonzero(np.isin(nodes.ids, labels))


def _open_edges(mesh: Mesh) -> list[Group]:
    """Edges of the skin with a face on one side only: faces of elements that meet there differ."""
    triangles, _ = triangles_of(seen_faces(mesh), middles=False)
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    pairs, counts = np.unique(edges, axis=0, return_counts=True)
    free = pairs[counts == 1]
    if not len(free):
        return []
    about = (
        f"{len(free)} edges of the skin have a face on one side only; faces of elements that meet there do not match"
    )
    return [Group(name="open edges", kind="warning", nodes=np.unique(free), lines=free, about=about)]


def _loose_parts(mesh: Mesh, count: int) -> list[Group]:
    """Parts that no element joins to the largest one, the largest first."""
    body = bodies_of_nodes(mesh, count)
    sizes = np.bincount(body[body >= 0])
    order = np.argsort(-sizes, kind="stable")
    groups = []
    for number, part in enumerate(order[1 : 1 + TOL.shown_parts], start=2):
        rows = np.flatnonzero(body == part)
        about = f"part {number} of {len(order)}: {len(rows):,} nodes that no element joins to the largest part"
        groups.append(Group(name="loose part", kind="note", nodes=rows, count=len(rows), about=about))
    return groups


def _orphans(mesh: Mesh, nodes: Nodes, joined: Ints) -> list[Group]:
    used = np.zeros(len(nodes), dtype=bool)
    used[joined] = True
    for block in mesh.blocks:
        used[block.nodes] = True
    rows = np.flatnonzero(~used)
    if not len(rows):
        return []
    words = list_labels([str(label) for label in nodes.ids[rows[: TOL.kept_labels]].tolist()], len(rows), "node")
    return [
        Group(
            name="orphan nodes",
            kind="warning",
            nodes=rows,
            about=f"no element has {words}; delete them, if none is meant",
        )
    ]
