"""Mesh and materials to stiffness and mass matrices, chunk by chunk.

K = sum_e int B' C B dV and M = Ms (x) I3 with Ms = sum_e int rho N' N dV (consistent mass), where the formulation of
the elements does not say otherwise.
The sparsity pattern is built first, on the node graph; every chunk of elements then adds into the
final arrays, so that peak memory stays near that of K and M themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.arguments import checked
from morembs.base.budget import current_budget
from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.fem.elements import TYPES, ElementType
from morembs.fem.fe_model import DofMap, FEModel
from morembs.fem.formulations import Formulation, Geometry, element_mass, formulation_of, geometry, strain_operator
from morembs.fem.inner_modes import with_inner_modes
from morembs.fem.material import Material
from morembs.fem.mesh import ElementBlock, Mesh, material_of_elements
from morembs.fem.middle_nodes import mesh_in_order
from morembs.fem.surface import seam_faces
from morembs.fem.tolerances import TOL

MASS_INTEGRATION = ("element", "exact", "reduced")


def check_mesh(mesh: Mesh, materials: Sequence[Material]) -> sp.csr_array:
    """Refuse what ``assemble`` refuses, without integrating; returns the node graph (n, n).

    Raises:
        InputError: as ``assemble``.
    """
    mesh = mesh_in_order(mesh)
    material_of_elements(mesh, materials)
    _refuse_loose_nodes(mesh)
    _refuse_gaps(mesh)
    for block, rows in chunks(mesh):
        kind, formulation = TYPES[block.type], formulation_of(block)
        geometry(mesh.nodes.xyz[block.nodes[rows]], formulation.integration(kind), block.ids[rows], kind)
        progress.update(f"{block.type}: {rows[-1] + 1} of {len(block.ids)}")
    return node_graph(mesh)


def stiffness_pattern(graph: sp.csr_array) -> sp.csr_array:
    """Matrix (3 n, 3 n) of ones with the pattern of the stiffness on the node ``graph`` (n, n) of ``check_mesh``."""
    indptr, indices = _scalar_pattern(graph, full=True)
    ones = current_budget().empty(len(indices))
    ones[:] = 1.0
    K = sp.csr_array((ones, indices, indptr), shape=(3 * graph.shape[0],) * 2)
    K.has_canonical_format = True
    return K


@checked
def assemble(
    mesh: Mesh, materials: Sequence[Material], *, mass_integration: str = "element", seams: bool = False
) -> FEModel:
    """Assemble the stiffness and mass of a mesh with one material for each element.

    Mid-side nodes in the order of another program are sorted. ``warnings`` of the model report this, and a mass
    integration that differs from the rule of a block.

    Peak memory: K and M, a sixth as much for the node graph and its masses, and about 100 MB.

    Args:
        mesh: nodes in m and elements.
        materials: one for each set of elements, in SI.
        mass_integration: "element" (the rule of each block; the exact mass if its program has no special rule), or
            one rule for all elements: "exact" (the consistent mass, on straight-sided elements) or "reduced" (at the
            points of the stiffness, like CalculiX: one point in tet4, four in tet10).
        seams: allow faces of different elements to meet, like the programs of decks.

    Raises:
        InputError: a material names an unknown set; an element has no material or two; an element is inverted or
            degenerate, or its mid-side nodes are in no known order; a node belongs to no element; a formulation or a
            rule of the mass does not exist for the type of its elements.

    >>> assemble(mesh, [steel]).K.shape
    (60, 60)
    """
    other_mass = mass_warnings(mesh, mass_integration)
    mesh = mesh_in_order(mesh)
    owner = material_of_elements(mesh, materials)
    _refuse_loose_nodes(mesh)
    if not seams:
        _refuse_gaps(mesh)
    graph = node_graph(mesh)
    k_data, m_data = current_budget().empty(9 * graph.nnz), np.zeros(graph.nnz)
    integrate(mesh, materials, owner, graph, stiffness=k_data, mass=m_data, mass_integration=mass_integration)
    if not all(np.isfinite(array.sum()) for array in (k_data, m_data)):
        raise InputError("stiffness or mass is not finite; check the coordinates, the material and the units")
    K, M = stiffness_matrix(graph, k_data), mass_matrix(graph, m_data)
    if mass_integration == "element" and any(block.mass == "row-sum" for block in mesh.blocks):
        M.eliminate_zeros()
    model = FEModel(
        K=K,
        M=M,
        nodes=mesh.nodes,
        dofs=DofMap.translations(len(mesh.nodes)),
        mesh=mesh,
        materials=tuple(materials),
        source=mesh.source,
        warnings=(*mesh.warnings, *other_mass),
    )
    return with_inner_modes(model, mesh, materials, owner, mass_integration)


def integrate(
    mesh: Mesh,
    materials: Sequence[Material],
    owner: dict[int, Ints],
    graph: sp.csr_array,
    *,
    stiffness: Floats | None = None,
    mass: Floats | None = None,
    mass_integration: str = "element",
    chosen: Mapping[int, NDArray[np.bool_]] | None = None,
    weights: Callable[[ElementBlock, Ints], Floats] | None = None,
) -> None:
    """Add elements to the data of K (9 nnz) and of the scalar mass (nnz) on the ``graph`` of ``node_graph``.

    Args:
        mesh: with middle nodes in order.
        owner: index of the material of each element, as of ``material_of_elements``.
        chosen: per block (by identity) which elements count (ne,); all of them by default.
        weights: factors (n, nq) of the volumes at the points of the stiffness, of a block and rows of its elements.
    """
    blocks_per_row = np.diff(graph.indptr).astype(np.int64)
    densities = np.array([material.density for material in materials])
    done, total, axes = 0, mesh.element_count, np.arange(3)
    for block, rows in chunks(mesh, chosen):
        which = owner[id(block)][rows]
        x, ids, nodes = mesh.nodes.xyz[block.nodes[rows]], block.ids[rows], block.nodes[rows]
        k = nodes.shape[1]
        at = np.asarray(graph[np.repeat(nodes, k, axis=1).ravel(), np.tile(nodes, (1, k)).ravel()]).astype(np.int64)
        if mass is not None:
            rule = block.mass if mass_integration == "element" else mass_integration
            np.add.at(mass, at, element_mass(block, rule, x, densities[which]).ravel())
        if stiffness is not None:
            at = at.reshape(-1, k, k)
            factors = None if weights is None else weights(block, rows)
            formulation, kind = formulation_of(block), TYPES[block.type]
            for part, K in _stiffness(formulation, kind, x, ids, materials, which, factors):
                # Entry (a, b) of node block `at` lies at 9*start + 3*a*blocks + 3*(at - start) + b of the CSR array.
                start = graph.indptr[nodes[part]].astype(np.int64)[:, :, None, None, None]
                step = (3 * blocks_per_row[nodes[part]])[:, :, None, None, None] * axes[:, None, None]
                place = 6 * start + 3 * at[part][:, :, None, :, None] + step + axes
                np.add.at(stiffness, place.ravel(), K.ravel())
        done += len(rows)
        current_budget().release_if_tight()
        progress.update(f"assembled {done} of {total} elements")


def entries_of(
    mesh: Mesh, graph: sp.csr_array, chosen: Mapping[int, NDArray[np.bool_]] | None = None
) -> tuple[Ints, Ints]:
    """Places (l,) in the data of the scalar mass and (9 l,) in those of K that the ``chosen`` elements touch."""
    touched = np.zeros(graph.nnz, dtype=bool)
    for block, rows in chunks(mesh, chosen):
        nodes = block.nodes[rows]
        k = nodes.shape[1]
        touched[np.asarray(graph[np.repeat(nodes, k, axis=1).ravel(), np.tile(nodes, (1, k)).ravel()])] = True
    entries, axes = np.flatnonzero(touched), np.arange(3)
    row = np.searchsorted(graph.indptr, entries, side="right") - 1
    start, blocks = graph.indptr[row].astype(np.int64), np.diff(graph.indptr)[row].astype(np.int64)
    places = (6 * start + 3 * entries)[:, None, None] + 3 * axes[:, None] * blocks[:, None, None] + axes
    return entries, np.sort(places.ravel())


def stiffness_matrix(graph: sp.csr_array, k_data: Floats) -> sp.csr_array:
    """K (3 n, 3 n) of its data (9 nnz) on the ``graph`` (n, n), as ``integrate`` fills them."""
    indptr, indices = _scalar_pattern(graph, full=True)
    K = sp.csr_array((k_data, indices, indptr), shape=(3 * graph.shape[0],) * 2)
    K.has_canonical_format = True
    return K


def mass_warnings(mesh: Mesh, mass_integration: str) -> tuple[str, ...]:
    """Where ``mass_integration`` is not the rule that the elements of a deck have in their program, a sentence each.

    Raises:
        InputError: an unknown rule.
    """
    if mass_integration not in MASS_INTEGRATION:
        raise InputError(
            f"mass_integration = {mass_integration!r} was given; {nearest(mass_integration, MASS_INTEGRATION)}",
            kind="unknown",
            keyword="mass_integration",
        )
    others: dict[tuple[str, str], int] = {}
    for block in mesh.blocks:
        # A mesh that says nothing of its mass has the exact one, and any other may be asked for.
        if mass_integration != "element" and block.mass not in ("exact", mass_integration):
            others[block.type, block.mass] = others.get((block.type, block.mass), 0) + len(block.ids)
    return tuple(
        f"{count} elements {kind} have the mass {mass_integration!r}, as was asked for, where their program takes "
        f"{rule!r}: frequencies of a coarse mesh may differ by 10 %; leave the mass integration out for its mass"
        for (kind, rule), count in others.items()
    )


def _refuse_loose_nodes(mesh: Mesh) -> None:
    used = np.zeros(len(mesh.nodes), dtype=bool)
    for block in mesh.blocks:
        used[block.nodes] = True
    loose = np.flatnonzero(~used)
    if len(loose):
        raise InputError(
            f"{len(loose)} nodes belong to no element (first: {mesh.nodes.ids[loose[0]]}); remove them from the mesh",
            kind="model",
        )


def _refuse_gaps(mesh: Mesh) -> None:
    seams = seam_faces(mesh) if len(mesh.blocks) > 1 else 0
    if seams:
        raise InputError(
            f"elements of different types meet at {seams} faces whose nodes do not match (a quadratic next to a linear "
            "face, or a quadrilateral next to two triangles): the mesh would open there; make it conforming",
            kind="model",
            keyword="mesh",
        )


def chunks(mesh: Mesh, chosen: Mapping[int, NDArray[np.bool_]] | None = None) -> Iterator[tuple[ElementBlock, Ints]]:
    """Blocks with rows of their elements, few enough that what is integrated over them stays near 50 MB times 4.

    ``chosen`` says for each block (by identity) which elements (ne,) are meant; all by default.
    """
    for block in mesh.blocks:
        kind = TYPES[block.type]
        points = len(kind.rule(kind.stiffness_order).weights)
        per_element = 8 * (2 * 6 * 3 * kind.n_nodes * points + 2 * 9 * kind.n_nodes**2)
        size = max(1, TOL.element_bytes // per_element)
        rows = np.arange(len(block.ids)) if chosen is None else np.flatnonzero(chosen[id(block)])
        for start in range(0, len(rows), size):
            yield block, rows[start : start + size]


def node_graph(mesh: Mesh) -> sp.csr_array:
    """Which nodes share an element: CSR pattern (n, n) whose data number its own entries."""
    indptr, indices, offset = [np.zeros(1, dtype=np.int64)], [], 0
    for block in mesh.blocks:
        ne, k = block.nodes.shape
        indptr.append(offset + k * np.arange(1, ne + 1, dtype=np.int64))
        indices.append(block.nodes.ravel())
        offset += ne * k
    C = sp.csr_array(
        (np.ones(offset, dtype=np.int8), np.concatenate(indices), np.concatenate(indptr)),
        shape=(sum(len(block.ids) for block in mesh.blocks), len(mesh.nodes)),
    )
    graph = sp.csr_array(C.T.tocsr() @ C)
    graph.sort_indices()
    small = np.int32 if 9 * graph.nnz < np.iinfo(np.int32).max else np.int64
    numbers = np.arange(graph.nnz, dtype=small)
    return sp.csr_array((numbers, graph.indices.astype(small), graph.indptr.astype(small)), shape=graph.shape)


def _scalar_pattern(graph: sp.csr_array, *, full: bool) -> tuple[Ints, Ints]:
    """indptr and indices of the matrix with 3x3 blocks on ``graph``: full, or diagonal blocks b*I3."""
    blocks = np.diff(graph.indptr)
    width = 3 if full else 1
    indptr = np.concatenate([[0], np.cumsum(np.repeat(width * blocks, 3))]).astype(graph.indptr.dtype)
    indices = current_budget().empty(int(indptr[-1]), graph.indices.dtype)
    for begin, end, start, local, row_length in _entries(graph):
        columns = 3 * graph.indices[begin:end]
        # The columns of a node block repeat in the three rows of its node.
        for a in range(3):
            at = width * (3 * start + a * row_length + local)
            for b in range(width):
                indices[at + b] = columns + (b if full else a)
    return indptr, indices


def _entries(graph: sp.csr_array) -> Iterator[tuple[int, int, Ints, Ints, Ints]]:
    """Pieces of ``graph``: their first entry and their end, and for each entry where its row starts, its place in the
    row, and the length of the row."""
    ends = graph.indptr[1:].astype(np.int64)
    first = 0
    while first < len(ends):
        last = max(int(np.searchsorted(ends, graph.indptr[first] + TOL.numbers_at_once, side="right")), first + 1)
        begin, end = int(graph.indptr[first]), int(ends[last - 1])
        lengths = np.diff(graph.indptr[first : last + 1]).astype(np.int64)
        start = graph.indptr[first:last].astype(np.int64).repeat(lengths)
        yield begin, end, start, np.arange(begin, end) - start, lengths.repeat(lengths)
        first = last


def mass_matrix(graph: sp.csr_array, m_data: Floats) -> sp.csr_array:
    """M = Ms (x) I3 (3 n, 3 n) of the data (nnz) of the scalar mass on the ``graph`` (n, n)."""
    indptr, indices = _scalar_pattern(graph, full=False)
    data = current_budget().empty(3 * graph.nnz)
    for begin, end, start, local, row_length in _entries(graph):
        for a in range(3):
            data[3 * start + a * row_length + local] = m_data[begin:end]
    M = sp.csr_array((data, indices, indptr), shape=(3 * graph.shape[0],) * 2)
    M.has_canonical_format = True
    return M


def _stiffness(
    formulation: Formulation,
    kind: ElementType,
    x: Floats,
    ids: Ints,
    materials: Sequence[Material],
    which: Ints,
    factors: Floats | None = None,
) -> Iterator[tuple[slice, Floats]]:
    """Stiffness (n, 3k, 3k) of elements with node coordinates ``x`` (ne, k, 3), piece by piece; ``factors`` (ne, nq)
    multiply the volumes."""
    constants = np.stack([material.stiffness for material in materials])
    whole = formulation.elements(kind, x, ids, constants[which])
    if factors is not None:
        whole = replace(whole, here=Geometry(whole.here.dN, whole.here.dV * factors))
    # C = L L', so that B' C B = (L'B)'(L'B) is one product of a matrix with itself.
    roots = np.linalg.cholesky(constants).transpose(0, 2, 1)
    _, nq, k, _ = whole.here.dN.shape
    size = max(1, TOL.numbers_at_once // (18 * nq * k))
    for first in range(0, len(x), size):
        part = slice(first, first + size)
        here = Geometry(whole.here.dN[part], whole.here.dV[part])
        elements = replace(whole, x=x[part], C=whole.C[part], here=here)
        plain = strain_operator(here.dN) if formulation.has_modes else formulation.operator(elements)
        B = np.matmul(roots[which[part]][:, None], plain)
        B *= np.sqrt(here.dV)[..., None, None]
        B = B.reshape(len(B), nq * 6, 3 * k)
        stiffness = np.matmul(B.transpose(0, 2, 1), B)
        if formulation.hourglass is not None:
            added = formulation.hourglass(elements)
            for axis in range(3):
                stiffness[:, axis::3, axis::3] += added
        yield part, 0.5 * (stiffness + stiffness.transpose(0, 2, 1))
