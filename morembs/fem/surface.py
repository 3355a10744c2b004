"""The skin of a solid mesh: outer faces, and the area that belongs to each of their nodes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from morembs.fem.elements import FACES, TYPES
from morembs.fem.mesh import Mesh


def outer_faces(mesh: Mesh, *, within: Ints | None = None, elements: tuple[Ints, ...] | None = None) -> dict[str, Ints]:
    """Faces that belong to one element only, as {face type: (nf, k) node rows in VTK order}.

    A face belongs to two elements where their corners are the same, also of a quadratic and a linear one.

    Args:
        within: keep only faces all of whose nodes are among these rows.
        elements: for each block the rows to take the skin of; None for the whole mesh.
    """
    inside = np.ones(len(mesh.nodes), dtype=bool)
    if within is not None:
        inside[:] = False
        inside[within] = True
    candidates: dict[str, list[Ints]] = {}
    for j, block in enumerate(mesh.blocks):
        nodes = block.nodes if elements is None else block.nodes[elements[j]]
        for kind, local in TYPES[block.type].face_nodes:
            faces = nodes[:, local]
            candidates.setdefault(kind, []).append(faces[inside[faces].all(axis=1)])
    stacked = {kind: np.concatenate(parts) for kind, parts in candidates.items()}
    outer: dict[str, Ints] = {}
    for corners in (3, 4):
        kinds = [kind for kind in stacked if _corners(kind) == corners]
        once = _once([stacked[kind] for kind in kinds], corners)
        outer |= {kind: stacked[kind][chosen] for kind, chosen in zip(kinds, once, strict=True)}
    return {kind: outer[kind] for kind in stacked}


def seen_faces(mesh: Mesh) -> dict[str, Ints]:
    """Faces as ``outer_faces``, to look at: of elements on the same nodes one alone counts, as two of them hide each
    face of the other."""
    return outer_faces(mesh, elements=tuple(_first_of_each(block.nodes) for block in mesh.blocks))


def _first_of_each(nodes: Ints) -> Ints:
    """Rows (k,) of ``nodes`` (n, w) that have other nodes than all rows before, in any order."""
    # Sums of random numbers are the same for the same nodes in any order, and of 64 bits for no others.
    draw = np.random.default_rng(21).integers(0, 2**63, int(nodes.max(initial=-1)) + 1, dtype=np.uint64)
    return np.sort(np.unique(draw[nodes].sum(axis=1), return_index=True)[1])


def _corners(kind: str) -> int:
    return 3 if kind.startswith("tri") else 4


def _once(faces: list[Ints], corners: int) -> list[NDArray[np.bool_]]:
    """Which faces of some kinds share their corner nodes with no other face."""
    keys = np.sort(np.concatenate([np.empty((0, corners), dtype=np.int64), *(f[:, :corners] for f in faces)]), axis=1)
    if not len(keys):
        return [np.zeros(0, dtype=bool) for _ in faces]
    _, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    return np.split(counts[inverse.ravel()] == 1, np.cumsum([len(f) for f in faces])[:-1])


def seam_faces(mesh: Mesh, linear: NDArray[np.bool_] | None = None) -> int:
    """Faces that have one of another kind on the same corners, or two triangles on the corners of a quadrilateral.

    Args:
        linear: which nodes (n,) stand for middle nodes that linear edges do not have; faces with such alone are linear.
    """
    keys: dict[int, list[Ints]] = {3: [], 4: []}
    for block in mesh.blocks:
        for kind, local in TYPES[block.type].face_nodes:
            faces, corners = block.nodes[:, local], _corners(kind)
            straight = np.zeros(len(faces), dtype=bool)
            if linear is not None:
                straight |= linear[faces[:, corners:]].all(axis=1)
            degree = np.where(straight, corners, faces.shape[1])
            keys[corners].append(np.column_stack([np.sort(faces[:, :corners], axis=1), degree]))
    seams = 0
    for corners, parts in keys.items():
        if parts:
            kinds = np.unique(np.concatenate(parts), axis=0)
            _, counts = np.unique(kinds[:, :corners], axis=0, return_counts=True)
            seams += int((counts > 1).sum())
    outer = [np.sort(nodes[:, : _corners(kind)], axis=1) for kind, nodes in outer_faces(mesh).items()]
    triangles = {tuple(t) for f in outer if f.shape[1] == 3 for t in f.tolist()}
    quads = [q for f in outer if f.shape[1] == 4 for q in f.tolist()] if triangles else []
    return seams + sum(any(tuple(q[:i] + q[i + 1 :]) in triangles for i in range(4)) for q in quads)


def nodal_areas(xyz: Floats, faces: Mapping[str, Ints]) -> Floats:
    """Consistent area int N_a dA (n,) of each node in m2; sums to the area of the faces."""
    area = np.zeros(len(xyz))
    for kind, nodes in faces.items():
        if len(nodes):
            rule = FACES[kind].rule(FACES[kind].mass_order)
            tangents = np.einsum("fka,qkr->fqra", xyz[nodes], rule.dN, optimize=True)
            dA = np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=2) * rule.weights
            np.add.at(area, nodes.ravel(), (dA @ rule.N).ravel())
    return area
