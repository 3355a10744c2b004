"""Middle nodes of quadratic elements: does each lie at the edge that its place in the element means?

Programs list the middle nodes of one element in different orders, and a mesh in the order of another program has the
same nodes, volumes near the true ones, and matrices that are wrong by tens of percent.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.elements import TYPES
from morembs.fem.mesh import Mesh
from morembs.fem.tolerances import TOL

_CORNERS = {"tet10": "tet4", "hex20": "hex8", "hex27": "hex8", "wedge15": "wedge6"}
# By place in the element: the corners (in VTK order) in whose middle the node lies, as other programs list them.
_NETGEN_TET = "01 02 03 12 13 23"
_NASTRAN_HEX = "01 12 23 30 04 15 26 37 45 56 67 74"
_GMSH_HEX = "01 03 04 12 15 23 26 37 45 47 56 67"
_ORDERS = {
    "tet10": {"gmsh": "01 12 20 03 23 13", "Netgen": _NETGEN_TET, "FEniCS": "23 13 12 03 02 01"},
    "hex20": {"Nastran or Exodus": _NASTRAN_HEX, "gmsh": _GMSH_HEX},
    "hex27": {
        "gmsh": f"{_GMSH_HEX} 0123 0154 0374 1265 2376 4567 01234567",
        "Exodus": f"{_NASTRAN_HEX} 01234567 0123 4567 0374 1265 0154 2376",
    },
    "wedge15": {"Nastran or Exodus": "01 12 20 03 14 25 34 45 53", "gmsh": "01 02 03 12 14 25 34 35 45"},
}


def mesh_in_order(mesh: Mesh) -> Mesh:
    """The mesh with the middle nodes of its elements in VTK order; ``warnings`` name each order that was another one.

    Raises:
        InputError: as ``in_order``.
    """
    blocks, sentences = [], []
    for block in mesh.blocks:
        nodes, words = in_order(block.type, block.nodes, mesh.nodes.xyz, block.ids, mesh.nodes.ids, mesh.source)
        blocks.append(block if words is None else replace(block, nodes=nodes))
        sentences += [] if words is None else [words]
    return replace(mesh, blocks=tuple(blocks), warnings=(*mesh.warnings, *sentences)) if sentences else mesh


def in_order(kind: str, nodes: Ints, xyz: Floats, ids: Ints, labels: Ints, source: str) -> tuple[Ints, str | None]:
    """Rows of nodes (ne, k) in VTK order, and a sentence where the order was that of another program.

    Args:
        kind: type of the elements with the labels ``ids`` (ne,).
        xyz: (n, 3) places of all nodes, whose labels are ``labels`` (n,).
        source: the file, for messages.

    Raises:
        InputError: middle nodes that are not in the middle of their edges in any order that is known, or in different
            orders in one block.
    """
    if kind not in _CORNERS or not any(_are_crossed(costs).any() for _, costs in _costs(kind, nodes, xyz)):
        return nodes, None
    total = sum((costs.sum(axis=0) for _, costs in _costs(kind, nodes, xyz)), start=np.zeros(()))
    # Place in the file of the node for each place in VTK order.
    from scipy.optimize import linear_sum_assignment

    places = np.argsort(linear_sum_assignment(total)[1])
    own = np.arange(len(places))
    name = None
    if total[places, own].sum() < TOL.better_order * np.trace(total):
        name = next((name for name, order in _places_by_order(kind).items() if np.array_equal(order, places)), None)
    corners = TYPES[_CORNERS[kind]].n_nodes
    if name is not None:
        nodes = np.concatenate([nodes[:, :corners], nodes[:, corners:][:, places]], axis=1)
    _refuse_crossed(kind, nodes, xyz, ids, labels, source)
    if name is None:
        return nodes, None
    whose = f"elements {kind} of {source}" if source else f"elements {kind}"
    return nodes, (
        f"the middle nodes of {len(ids)} {whose} were in the order of {name} and were put in order; check that the "
        "program that wrote them is right elsewhere"
    )


@cache
def _places_by_order(kind: str) -> dict[str, Ints]:
    """Order -> for each middle node of VTK its place among those of the order."""
    reference, orders = TYPES[kind].reference, {}
    corners = TYPES[_CORNERS[kind]].n_nodes
    for name, words in _ORDERS[kind].items():
        middles = np.array([reference[[int(digit) for digit in word]].mean(axis=0) for word in words.split()])
        distance = np.linalg.norm(middles[None] - reference[corners:, None], axis=2)
        orders[name] = np.asarray(distance.argmin(axis=1))
    return orders


def _costs(kind: str, nodes: Ints, xyz: Floats) -> Iterator[tuple[Ints, Floats]]:
    """Rows of elements, and (k, m, m) squared distances of each middle node from each place of one, over the squared
    size of the element."""
    low = TYPES[_CORNERS[kind]]
    N, _ = low.shape(TYPES[kind].reference[low.n_nodes :])
    for start in range(0, len(nodes), TOL.ordered_elements):
        x = xyz[nodes[start : start + TOL.ordered_elements]]
        corners, middles = x[:, : low.n_nodes], x[:, low.n_nodes :]
        with np.errstate(all="ignore"):  # elements of no size, and places beyond all measure, are refused elsewhere
            size = np.square(np.ptp(corners, axis=1)).sum(axis=1)
            places = np.einsum("sc,ecx->esx", N, corners)
            costs = np.square(middles[:, :, None] - places[:, None]).sum(axis=3) / size[:, None, None]
        yield np.arange(start, start + len(x)), costs


def _are_crossed(costs: Floats) -> NDArray[np.bool_]:
    """Elements (k,) of which two middle nodes lie nearer to each other's places than to their own."""
    own = np.einsum("eii->ei", costs)
    with np.errstate(all="ignore"):
        gain = own[:, :, None] + own[:, None] - costs - costs.transpose(0, 2, 1)
        return np.asarray((gain > TOL.order_roundoff).any(axis=(1, 2)) & np.isfinite(costs).all(axis=(1, 2)))


def _refuse_crossed(kind: str, nodes: Ints, xyz: Floats, ids: Ints, labels: Ints, source: str) -> None:
    """Refuse elements that another order of their middle nodes fits far better."""
    from scipy.optimize import linear_sum_assignment

    wrong: list[int] = []
    for rows, costs in _costs(kind, nodes, xyz):
        for e in np.flatnonzero(_are_crossed(costs)).tolist():
            order = linear_sum_assignment(costs[e])
            if costs[e][order].sum() < TOL.better_order * np.trace(costs[e]):
                wrong.append(int(rows[e]))
    if not wrong:
        return
    low = TYPES[_CORNERS[kind]]
    element = nodes[wrong[0]]
    corners, middles = element[: low.n_nodes], element[low.n_nodes :]
    _, costs = next(_costs(kind, element[None], xyz))
    m = int(np.diagonal(costs[0]).argmax())
    reference = TYPES[kind].reference
    N, _ = low.shape(reference[low.n_nodes :][[m]])
    ends = [int(corners[c]) for c in np.flatnonzero(N[0] > TOL.no_shape)]
    middle = N[0] @ xyz[corners]
    away = np.linalg.norm(xyz[middles[m]] - middle) / np.linalg.norm(np.ptp(xyz[ends], axis=0))
    raise InputError(
        f"{source or 'the mesh'} has {len(wrong)} elements {kind} whose middle nodes are not at the edges of their "
        f"places (first: element {ids[wrong[0]]}, whose node {labels[middles[m]]} lies {away:.2g} times the edge's "
        f"length from the middle of the nodes {', '.join(str(labels[i]) for i in ends)}); write the middle nodes in "
        "the order that the format wants",
        kind="model",
    )
