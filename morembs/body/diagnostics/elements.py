"""What a mesh shows by itself: elements that are there twice, and nodes that should be one."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.base.types import Floats, Ints
from morembs.body.diagnostics.findings import Finding, list_labels
from morembs.body.diagnostics.tolerances import TOL
from morembs.fem import Mesh
from morembs.fem.elements import TYPES


def close_pairs(xyz: Floats) -> Ints:
    """Pairs (k, 2) of rows of ``xyz`` (n, 3) at one place, ascending in each; of many at one place the nearest few."""
    reach = TOL.coincident_nodes * max(float(np.ptp(xyz, axis=0).max()), np.finfo(float).tiny) if len(xyz) else 0.0
    # What is near in space is near along any line: of small models no node is left after three of them.
    rows = np.arange(len(xyz))
    for line in np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]:
        along = (xyz[rows] - xyz[0]) @ line
        order = np.argsort(along)
        # A percent more, so that no pair is lost by round-off along the line.
        near = np.diff(along[order]) <= 1.01 * reach
        rows = np.sort(rows[order[np.append(near, False) | np.insert(near, 0, False)]]) if len(near) else rows[:0]
    if not len(rows):
        return np.empty((0, 2), dtype=np.int64)
    # Not at the top, where it would cost every command its memory.
    from scipy.spatial import cKDTree

    # The nearest few are enough: a search for all pairs grows without bounds where many nodes coincide.
    distance, other = cKDTree(xyz).query(xyz, k=min(4, len(xyz)), distance_upper_bound=reach)
    row, column = np.nonzero(np.isfinite(distance))
    two = other[row, column]
    return np.asarray(np.unique(np.sort(np.stack([row, two], axis=1)[row != two], axis=1), axis=0), dtype=np.int64)


def bodies_of_nodes(mesh: Mesh, count: int) -> Ints:
    """(count,) number of the body that each node belongs to by shared nodes of elements, -1 for nodes of none."""
    first = [np.repeat(block.nodes[:, 0], block.nodes.shape[1] - 1) for block in mesh.blocks]
    rest = [block.nodes[:, 1:].ravel() for block in mesh.blocks]
    none = np.empty(0, dtype=np.int64)
    row, column = np.concatenate([none, *first]), np.concatenate([none, *rest])
    links = sp.coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(count, count))
    label = connected_components(links, directed=False)[1].astype(np.int64)
    used = np.zeros(count, dtype=bool)
    used[row], used[column] = True, True
    label[~used] = -1
    return np.asarray(label)


def double_elements(mesh: Mesh) -> list[Finding]:
    """A warning of solid elements that lie in the place of others, on the same corners or on copies of these.

    Peak memory: about 30 numbers per node and 4 per element.
    """
    n = len(mesh.nodes)
    pairs = close_pairs(mesh.nodes.xyz)
    links = sp.coo_array((np.ones(len(pairs), dtype=np.int8), tuple(pairs.T)), shape=(n, n))
    place = connected_components(links, directed=False)[1]
    # The sum of random numbers of its corners is the same for the same corners in any order.
    draw = np.random.default_rng(21).integers(0, 2**63, (2, n), dtype=np.uint64)
    keys, own, label = [], [], []
    for block in mesh.blocks:
        corners = block.nodes[:, sorted({corner for face in TYPES[block.type].faces for corner in face})]
        keys.append(draw[0][place[corners]].sum(axis=1) + np.uint64(corners.shape[1]))
        own.append(draw[1][corners].sum(axis=1))
        label.append(block.ids)
    if not keys:
        return []
    key, nodes, ids = np.concatenate(keys), np.concatenate(own), np.concatenate(label)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    if not len(same):
        return []
    same = same[np.argsort(order[same], kind="stable")]
    first, second = order[same], order[same + 1]
    shared = int((nodes[first] == nodes[second]).sum())
    on = "on the same nodes" if shared == len(same) else "on copies of their nodes"
    if 0 < shared < len(same):
        on = f"{shared} on the same nodes, the others on copies of them"
    words = [
        f"{a} and {b}"
        for a, b in zip(ids[first][: TOL.kept_labels].tolist(), ids[second][: TOL.kept_labels].tolist(), strict=True)
    ]
    sentence = (
        f"{len(same)} solid elements lie in the place of others, {on}, so that mass and stiffness count twice there: "
        f"elements {list_labels(words, len(same))}"
    )
    cure = "delete the copies (a part may be in the model twice), unless elements are overlaid on purpose"
    where = tuple(str(label) for pair in zip(ids[first].tolist(), ids[second].tolist(), strict=True) for label in pair)
    where = where[: TOL.kept_labels]
    return [Finding(code="double-elements", severity="warning", sentence=sentence, cure=cure, where=where)]


def seam_finding(labels: tuple[str, ...], words: str, count: int) -> Finding:
    """A warning of ``count`` pairs of nodes, ``labels`` one after the other and ``words`` for the first of them."""
    sentence = (
        f"{count} {'pair' if count == 1 else 'pairs'} of nodes of one body are at one place and not joined, so that "
        f"the body is open there and softer: {words}"
    )
    cure = "merge nodes within a small tolerance where the mesh was made, unless a crack or a gap is meant"
    return Finding(code="coincident-nodes", severity="warning", sentence=sentence, cure=cure, where=labels)


def open_seams(mesh: Mesh) -> list[Finding]:
    """A warning of nodes of one body at one place that no element joins; bodies that touch are left alone."""
    used = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(block.nodes.ravel() for block in mesh.blocks)]))
    pairs = used[close_pairs(mesh.nodes.xyz[used])]
    if not len(pairs):
        return []
    body = bodies_of_nodes(mesh, len(mesh.nodes))
    pairs = pairs[body[pairs[:, 0]] == body[pairs[:, 1]]]
    pairs = pairs[~_in_one_element(mesh, pairs)]
    if not len(pairs):
        return []
    ids = mesh.nodes.ids[pairs[: TOL.kept_labels]].astype(str)
    words = list_labels([f"{a} and {b}" for a, b in ids.tolist()], len(pairs))
    return [seam_finding(tuple(ids.ravel().tolist()), words, len(pairs))]


def _in_one_element(mesh: Mesh, pairs: Ints) -> NDArray[np.bool_]:
    """(k,) whether some element has both nodes of a pair."""
    n, touched = len(mesh.nodes), np.zeros(len(mesh.nodes), dtype=bool)
    touched[pairs] = True
    codes = [np.empty(0, dtype=np.int64)]
    for block in mesh.blocks:
        near = block.nodes[touched[block.nodes].sum(axis=1) > 1]
        low, high = np.minimum(near[:, :, None], near[:, None, :]), np.maximum(near[:, :, None], near[:, None, :])
        codes.append((low * n + high).ravel())
    return np.isin(pairs[:, 0] * n + pairs[:, 1], np.concatenate(codes))
