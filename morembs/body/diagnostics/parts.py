"""Parts that do not touch, and nodes that should be one."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.base.types import Ints
from morembs.body.diagnostics.elements import bodies_of_nodes, close_pairs, seam_finding
from morembs.body.diagnostics.findings import Finding, Names, list_labels
from morembs.fem import DofMap, Mesh, Nodes


def part_of_dofs(K: sp.csr_array, dofs: DofMap | None) -> Ints:
    """(N,) number of the part of each dof, -1 for a dof without stiffness; the dofs of a node belong together.

    Peak memory: a copy of K where it stores zeros.
    """
    graph = K
    if not K.data.all():
        graph = K.copy()
        graph.eliminate_zeros()
    stiff = np.diff(graph.indptr) > 0
    # The pattern is symmetric, so strong components are the parts, and SciPy makes no copy for them.
    count, label = connected_components(graph, directed=True, connection="strong")
    label = label.astype(np.int64)
    if dofs is not None:
        nodes = int(dofs.node.max(initial=0)) + 1
        links = sp.csr_array(
            (np.ones(int(stiff.sum()), dtype=np.int8), (label[stiff], count + dofs.node[stiff])),
            shape=(count + nodes, count + nodes),
        )
        label = connected_components(links, directed=False)[1][:count][label].astype(np.int64)
    label[~stiff] = -1
    _, label[stiff] = np.unique(label[stiff], return_inverse=True)
    return np.asarray(label, dtype=np.int64)


def parts_findings(
    K: sp.csr_array, part: Ints, nodes: Nodes | None, dofs: DofMap | None, names: Names, mesh: Mesh | None = None
) -> list[Finding]:
    """Unconnected parts, and nodes at one place that are not joined; a ``mesh`` tells seams from bodies that touch."""
    count = int(part.max(initial=-1)) + 1
    pairs, on_two_nodes = coincident(K, part, nodes, dofs)
    seams = _seams(pairs[~on_two_nodes], names, nodes, mesh)
    if count < 2:
        return seams
    if dofs is None:
        sentence = f"the stiffness matrix K falls into {count} groups of dofs that do not touch"
        cure = "give nodes and the map of the dofs to tell parts from directions"
        return [Finding(code="uncoupled-dofs", severity="note", sentence=sentence, cure=cure)]
    size = np.bincount(part[part >= 0])
    biggest = np.sort(size)[::-1][:5]
    first = [names.of_dofs(np.flatnonzero(part == number))[:1] for number in np.argsort(-size, kind="stable")[:5]]
    labels = names.node_labels(np.concatenate(first))
    words = ", ".join(map(str, biggest))
    sentence = f"the model falls into {count} unconnected parts (of {words} dofs, at nodes {list_labels(labels)})"
    if not on_two_nodes.any():
        cure = "join the parts, or reduce them one by one"
        return [Finding(code="parts", severity="error", sentence=sentence, cure=cure, where=labels), *seams]
    flat, both = _pairs(pairs[on_two_nodes], names)
    sentence += f"; {int(on_two_nodes.sum())} pairs of their nodes are at one place: {both}"
    return [Finding(code="parts", severity="error", sentence=sentence, cure="merge these nodes", where=flat), *seams]


def _seams(pairs: Ints, names: Names, nodes: Nodes | None, mesh: Mesh | None) -> list[Finding]:
    """Pairs of nodes within one part that K does not join: a seam of a body, or two bodies that touch."""
    if not len(pairs) or nodes is None:
        return []
    open_ = np.ones(len(pairs), dtype=bool)
    if mesh is not None:
        body = bodies_of_nodes(mesh, len(nodes))
        open_ = body[pairs[:, 0]] == body[pairs[:, 1]]
    findings = []
    if open_.any():
        findings.append(seam_finding(*_pairs(pairs[open_], names), int(open_.sum())))
    if not open_.all():
        labels, words = _pairs(pairs[~open_], names)
        sentence = f"{int((~open_).sum())} pairs of nodes of bodies that touch are at one place and not joined: {words}"
        cure = "merge them if the bodies are one; a contact is not in a linear model"
        findings.append(Finding(code="touching-bodies", severity="note", sentence=sentence, cure=cure, where=labels))
    return findings


def _pairs(pairs: Ints, names: Names) -> tuple[tuple[str, ...], str]:
    """Labels of pairs of nodes, one after the other, and words for the first."""
    flat = names.node_labels(pairs.ravel())
    return flat, list_labels([f"{a} and {b}" for a, b in zip(flat[::2], flat[1::2], strict=False)], len(pairs))


def coincident(K: sp.csr_array, part: Ints, nodes: Nodes | None, dofs: DofMap | None) -> tuple[Ints, NDArray[np.bool_]]:
    """Pairs (k, 2) of nodes at one place without stiffness between them, and which belong to different parts."""
    if nodes is None or dofs is None or not len(part):
        return np.empty((0, 2), dtype=np.int64), np.empty(0, dtype=bool)
    of_node = np.full(len(nodes), -1, dtype=np.int64)
    np.maximum.at(of_node, dofs.node, part)
    used = np.flatnonzero(of_node >= 0)
    pairs = used[close_pairs(nodes.xyz[used])]
    on_two_nodes = of_node[pairs[:, 0]] != of_node[pairs[:, 1]]
    keep = on_two_nodes | ~_are_coupled(K, pairs, dofs)
    return pairs[keep], on_two_nodes[keep]


def _are_coupled(K: sp.csr_array, pairs: Ints, dofs: DofMap) -> NDArray[np.bool_]:
    """(k,) whether K couples the nodes of each pair."""
    width = int(dofs.node.max(initial=0)) + 1
    both = np.flatnonzero(np.isin(dofs.node, pairs))
    entries = sp.coo_array(K[both, :])
    row, column = dofs.node[both[entries.coords[0]]], dofs.node[entries.coords[1]]
    low, high = np.minimum(row, column)[entries.data != 0], np.maximum(row, column)[entries.data != 0]
    return np.isin(pairs[:, 0] * width + pairs[:, 1], low * width + high)
