"""Elements that are left-handed as a whole: their nodes in the order that makes them right-handed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from morembs.fem.elements import TYPES
from morembs.fem.mesh import ElementBlock, Mesh
from morembs.fem.tolerances import TOL


def mirror_of(kind: str) -> Ints:
    """The order (k,) of the nodes of an element seen in a mirror: two axes of a tetrahedron are exchanged, else the
    bottom goes to the top."""
    reference = TYPES[kind].reference
    mirrored = reference.copy()
    if kind.startswith("tet"):
        mirrored[:, [0, 1]] = reference[:, [1, 0]]
    else:
        mirrored[:, 2] = 1.0 - reference[:, 2]
    return np.asarray(np.linalg.norm(reference[:, None] - mirrored[None], axis=2).argmin(axis=0), dtype=np.int64)


def right_handed(mesh: Mesh) -> Mesh:
    """The mesh with elements reversed that are left-handed at all of their points; a warning says how many.

    Elements that are right-handed at some points and left-handed at others stay, and are refused where they are
    integrated.
    """
    blocks, count, first = [], 0, 0
    for block in mesh.blocks:
        left = _left_handed(block, mesh)
        if left.any():
            nodes = block.nodes.copy()
            nodes[left] = nodes[left][:, mirror_of(block.type)]
            first = first or int(block.ids[left][0])
            count += int(left.sum())
            block = replace(block, nodes=nodes)
        blocks.append(block)
    if not count:
        return mesh
    warning = (
        f"{count} elements are left-handed and were reversed: bottom and top are exchanged (first: {first}) "
        "[flipped-elements]"
    )
    return replace(mesh, blocks=tuple(blocks), warnings=(*mesh.warnings, warning))


def _left_handed(block: ElementBlock, mesh: Mesh) -> NDArray[np.bool_]:
    """Which elements (ne,) are left-handed at all points of their stiffness."""
    kind = TYPES[block.type]
    _, middle = kind.shape(kind.reference.mean(axis=0, keepdims=True))
    parts = [np.zeros(0, dtype=bool)]
    for start in range(0, len(block.ids), TOL.handed_elements):
        x = mesh.nodes.xyz[block.nodes[start : start + TOL.handed_elements]]
        left = _determinants(middle, x)[:, 0] < 0
        if left.any():
            left[left] = (_determinants(kind.rule(kind.stiffness_order).dN, x[left]) < 0).all(axis=1)
        parts.append(left)
    return np.concatenate(parts)


def _determinants(dN: Floats, x: Floats) -> Floats:
    """Of elements (ne,) at points (nq,), with gradients ``dN`` (nq, k, 3) and nodes at ``x`` (ne, k, 3)."""
    # Elements without volume are refused where they are assembled.
    with np.errstate(divide="ignore"):
        return np.asarray(np.linalg.det(np.einsum("qki,ekx->eqxi", dN, x)))
