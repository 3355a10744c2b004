"""Stress and strain at nodes from displacements.

The displacement gradient at the integration points of the stiffness is fitted in each element by its linear
functions (least squares, Hinton and Campbell 1974), taken at the element's nodes, and averaged at a node over the
elements of one material with their volumes as weights. All of that is one sparse operator G; strain and stress
follow from G u. Where the formulation of the elements takes another strain, its extra terms go the same way.

Tensors have the order xx, yy, zz, xy, yz, zx (that of VTK and ParaView) and tensor shears: a strain xy is half the
engineering shear. Stresses are in Pa, along the axes of the model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.budget import current_budget
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints, Reals
from morembs.fem import assembly as fem
from morembs.fem.elements import TYPES, ElementType
from morembs.fem.fe_model import FEModel
from morembs.fem.formulations import Elements, Formulation, formulation_of
from morembs.fem.mesh import Mesh, material_of_elements
from morembs.fem.surface import outer_faces
from morembs.fem.tolerances import TOL

NODES = ("skin", "all")
COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "zx")
# Where the components lie in the Voigt order xx, yy, zz, yz, zx, xy of the materials.
_FROM_VOIGT = np.array([0, 1, 2, 5, 3, 4])
_ROW, _COLUMN = np.array([0, 1, 2, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 0])
_LINEAR = {"t": "tet4", "h": "hex8", "w": "wedge6"}


@dataclass(frozen=True, kw_only=True, eq=False)
class StressOperator:
    """G u: averaged displacement gradients at points, and what makes strain and stress of them.

    ``nodes`` (np,) rows of the model's nodes, ascending; a node where materials meet is one point for each of them,
    and ``material`` (np,) tells which (the index of the first material with the same constants).
    ``gradient`` (3 np, n) gives for row 3 p + b the derivative of a nodal field along axis b; ``elasticity``
    (materials, 6, 6) in Pa takes strains to stresses in the order of this module. ``added`` (6 np, 3 n) is what
    formulations add to the strain of the gradients, where they do. ``elements`` gives the same of single elements,
    where that is wanted.
    """

    nodes: Ints
    material: Ints
    gradient: sp.csr_array
    elasticity: Floats
    added: sp.csr_array | None = None
    elements: SingleElements | None = None

    def strain(self, u: Floats) -> Floats:
        """Strains (6 np, k) of displacements ``u`` (3 n, k), x, y, z of node after node.

        Allocates 24 values for each point and column.
        """
        k = u.shape[1]
        H = np.asarray(self.gradient @ u.reshape(-1, 3 * k)).reshape(-1, 3, 3, k)
        strain = np.asarray(0.5 * (H[:, _ROW, _COLUMN] + H[:, _COLUMN, _ROW])).reshape(-1, k)
        if self.added is not None:
            strain += self.added @ u
        return strain

    def stress(self, u: Floats) -> Floats:
        """Stresses (6 np, k) in Pa of displacements ``u`` (3 n, k) in m."""
        strain = self.strain(u).reshape(len(self.nodes), 6, -1)
        for which in np.unique(self.material):
            rows = slice(None) if (self.material == which).all() else np.flatnonzero(self.material == which)
            strain[rows] = self.elasticity[which] @ strain[rows]
        return strain.reshape(-1, u.shape[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class SingleElements:
    """Stresses of the elements at a point before they are averaged: row i is element ``element`` (ne,), numbered
    through the blocks of the mesh, at ``point`` (ne,), a place in the points of the averaged stress.
    """

    point: Ints
    element: Ints
    operator: StressOperator


def stress_operator(
    model: FEModel, nodes: str | Ints = "skin", *, elements: bool = False, collected: int = TOL.collected_entries
) -> StressOperator:
    """Operator at ``nodes``: "skin", "all" or rows of ``model.nodes``; ``elements`` adds that of single elements.

    Only elements that touch these nodes are looked at, a chunk at a time. Peak memory: four times the entries of G
    (up to 170 for each point of 20-node hexahedra, 80 of 10-node tetrahedra; 12 bytes each) and one chunk; they are
    added up whenever there are ``collected`` of them. Single elements have as many entries as their nodes, for each of
    their points.

    Raises:
        InputError: a model without elements or materials, an unknown choice of nodes or rows that do not exist.
    """
    mesh = model.mesh
    if mesh is None or not model.materials or not model.dofs.begins_solid(len(mesh.nodes)):
        raise InputError(
            "stress needs solid elements and their materials, and this model has matrices only; give a mesh with "
            "materials, or leave stress out",
            kind="unsupported",
            keyword="mesh",
        )
    rows = chosen_rows(mesh, nodes)
    alike = _alike(model)
    owner = {block: alike[which] for block, which in material_of_elements(mesh, model.materials).items()}
    points = _points(mesh, owner, rows, len(alike))
    # Engineering shears of the materials' constants against tensor shears here.
    C = np.stack([material.stiffness for material in model.materials])[:, _FROM_VOIGT][:, :, _FROM_VOIGT]
    C = C * np.array([1, 1, 1, 2, 2, 2])
    node, material = points // len(alike), points % len(alike)
    constants = np.stack([material.stiffness for material in model.materials])
    of = _Points(mesh, owner, points, constants, collected)
    n, alone, changed = len(mesh.nodes), None, any(formulation_of(block).change for block in mesh.blocks)
    if elements:
        G, point, element = of.single(_gradients, 3, n)
        more = _store(of.single(_additions, 6, 3 * n)[0]) if changed else None
        single = StressOperator(
            nodes=node[point], material=material[point], elasticity=C, gradient=_store(G), added=more
        )
        alone = SingleElements(point=point, element=element, operator=single)
    return StressOperator(
        nodes=node,
        material=material,
        elasticity=C,
        gradient=_store(of.average(_gradients, 3, n)),
        added=_store(of.average(_additions, 6, 3 * n)) if changed else None,
        elements=alone,
    )


def _store(matrix: sp.csr_array) -> sp.csr_array:
    """The same where the budget wants it."""
    budget = current_budget()
    parts = tuple(budget.store(array) for array in (matrix.data, matrix.indices, matrix.indptr))
    return sp.csr_array(parts, shape=matrix.shape)


def chosen_rows(mesh: Mesh, nodes: str | Ints) -> Ints:
    """Rows of the nodes that ``nodes`` means, ascending.

    Raises:
        InputError: an unknown word, no node, or rows that the mesh does not have.
    """
    if isinstance(nodes, str):
        if nodes not in NODES:
            raise InputError(
                f"nodes = {nodes!r} was given for the stress; expected one of {', '.join(NODES)}, or rows",
                keyword="nodes",
            )
        if nodes == "all":
            return np.arange(len(mesh.nodes))
        return np.unique(np.concatenate([faces.ravel() for faces in outer_faces(mesh).values()]))
    rows = np.unique(np.asarray(nodes, dtype=np.int64))
    if not len(rows) or rows[0] < 0 or rows[-1] >= len(mesh.nodes):
        what = f"row {rows[0] if rows[0] < 0 else rows[-1]}" if len(rows) else "no node"
        raise InputError(
            f"{what} was given for the stress; expected some rows 0..{len(mesh.nodes) - 1} of the nodes", keyword=what
        )
    return rows


def _alike(model: FEModel) -> Ints:
    """For each material the index of the first one with the same constants."""
    C = [material.stiffness for material in model.materials]
    return np.array([next(j for j, other in enumerate(C) if np.array_equal(stiffness, other)) for stiffness in C])


def _points(mesh: Mesh, owner: Mapping[int, Ints], rows: Ints, materials: int) -> Ints:
    """Numbers node * materials + material, ascending, of all pairs that occur at the nodes ``rows``."""
    wanted = np.zeros(len(mesh.nodes), dtype=bool)
    wanted[rows] = True
    blocks = []
    for block in mesh.blocks:
        for label in np.unique(owner[id(block)]):
            nodes = np.unique(block.nodes[owner[id(block)] == label])
            blocks.append(nodes[wanted[nodes]] * materials + label)
    return np.unique(np.concatenate(blocks))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Values (pairs, r, c) of elements, each at one of its nodes, for the ``columns`` (pairs, c); where, by what
    ``volume`` (pairs,) in m3."""

    point: Ints
    element: Ints
    volume: Floats
    columns: Ints
    values: Floats


# Columns (ne, c) of elements with node rows (ne, k), and what they take to values at points (ne, nq, r, c).
_Values = Callable[[Formulation, Elements, Ints], tuple[Ints, Floats]]


def _gradients(_: Formulation, elements: Elements, nodes: Ints) -> tuple[Ints, Floats]:
    return nodes, elements.here.dN.transpose(0, 1, 3, 2)


def _additions(formulation: Formulation, elements: Elements, nodes: Ints) -> tuple[Ints, Floats]:
    """What the formulation adds to the strain of the gradients: no columns where it adds nothing."""
    added = formulation.change_of_strains(elements)
    if added is None:
        return nodes[:, :0], np.empty((*elements.here.dV.shape, 6, 0))
    columns = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), -1)
    return columns, added[:, :, _FROM_VOIGT] * np.array([1, 1, 1, 0.5, 0.5, 0.5])[:, None]


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of a mesh, numbers node * materials + material, with the constants of the materials (m, 6, 6)."""

    mesh: Mesh
    owner: Mapping[int, Ints]
    numbers: Ints
    constants: Floats
    collected: int

    def pairs(self, values_of: _Values) -> Iterator[_Pairs]:
        """All pairs of an element and one of its nodes that is a point, a chunk of elements at a time."""
        mesh, materials = self.mesh, len(self.constants)
        wanted = np.zeros(len(mesh.nodes), dtype=bool)
        wanted[self.numbers // materials] = True
        starts = np.cumsum([0, *(len(block.ids) for block in mesh.blocks)]).tolist()
        first = dict(zip(map(id, mesh.blocks), starts, strict=False))
        for block, rows in fem.chunks(mesh):
            rows = rows[wanted[block.nodes[rows]].any(axis=1)]
            if not len(rows):
                continue
            kind, nodes, which = TYPES[block.type], block.nodes[rows], self.owner[id(block)][rows]
            formulation = formulation_of(block)
            elements = formulation.elements(kind, mesh.nodes.xyz[nodes], block.ids[rows], self.constants[which])
            columns, at_points = values_of(formulation, elements, nodes)
            element, a = np.nonzero(wanted[nodes])
            fitted = extrapolation(kind, elements.rule.points)
            yield _Pairs(
                np.searchsorted(self.numbers, nodes[element, a] * materials + which[element]),
                rows[element] + first[id(block)],
                elements.here.dV.sum(axis=1)[element],
                columns[element],
                np.einsum("aq,eqrc->earc", fitted, at_points, optimize=True)[element, a],
            )
            progress.update(f"stress operator: {block.type} {rows[-1] + 1} of {len(block.ids)}")

    def average(self, values_of: _Values, rows: int, columns: int) -> sp.csr_array:
        """Matrix (rows np, columns), averaged with the volumes of the elements."""
        count = len(self.numbers)
        shape = (rows * count, columns)
        total, volume = sp.csr_array(shape), np.zeros(count)
        parts: list[tuple[Floats, Ints, Ints]] = []
        collected = 0
        for pair in self.pairs(values_of):
            np.add.at(volume, pair.point, pair.volume)
            values = pair.values * pair.volume[:, None, None]
            row = np.broadcast_to((rows * pair.point[:, None] + np.arange(rows))[:, :, None], values.shape)
            column = np.broadcast_to(pair.columns[:, None, :], values.shape)
            parts.append((values.ravel(), row.ravel(), column.ravel()))
            collected += values.size
            if collected > max(self.collected, total.nnz):
                total, parts, collected = total + _sum(parts, shape), [], 0
        if parts:
            total = total + _sum(parts, shape)
        total.data /= np.repeat(volume, rows).repeat(np.diff(total.indptr))
        return total

    def single(self, values_of: _Values, rows: int, columns: int) -> tuple[sp.csr_array, Ints, Ints]:
        """The same (rows ne, columns) of single elements, by points, with point and element of each."""
        parts, point, element = [], [], []
        for pair in self.pairs(values_of):
            count, _, width = pair.values.shape
            places = np.repeat(pair.columns.astype(np.int32), rows, axis=0).ravel()
            start = width * np.arange(rows * count + 1)
            parts.append(sp.csr_array((pair.values.ravel(), places, start), shape=(rows * count, columns)))
            point.append(pair.point)
            element.append(pair.element)
        points_of, elements = np.concatenate(point), np.concatenate(element)
        order = np.argsort(points_of, kind="stable")
        chosen = (rows * order[:, None] + np.arange(rows)).ravel()
        return sp.csr_array(sp.vstack(parts, format="csr")[chosen]), points_of[order], elements[order]


def _sum(parts: list[tuple[Floats, Ints, Ints]], shape: tuple[int, int]) -> sp.csr_array:
    values, rows, columns = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return sp.csr_array(sp.coo_array((values, (rows, columns)), shape=shape))


def extrapolation(kind: ElementType, points: Floats) -> Floats:
    """(k, nq) values at the nodes of an element from those at ``points`` (nq, 3), as of its formulation.

    Exact for fields that are linear in its reference coordinates; one point alone gives a constant.
    """
    linear = TYPES[_LINEAR[kind.name[0]]]
    at_points, _ = linear.shape(points)
    at_nodes, _ = linear.shape(kind.reference)
    return np.asarray(at_nodes @ np.linalg.pinv(at_points))


def von_mises(stress: Reals) -> Floats:
    """Von Mises stress (...) of stress tensors (..., 6), in the same units."""
    xx, yy, zz, xy, yz, zx = np.moveaxis(np.asarray(stress, dtype=np.float64), -1, 0)
    direct = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
    return np.asarray(np.sqrt(0.5 * direct + 3 * (xy**2 + yz**2 + zx**2)))


def von_mises_slope(stress: Reals, change: Reals) -> Floats:
    """Derivative (...) of the von Mises stress where tensors (..., 6) change by ``change`` (..., 6) per unit; zero
    where there is no stress, as there is no derivative."""
    xx, yy, zz, xy, yz, zx = np.moveaxis(np.asarray(stress, dtype=np.float64), -1, 0)
    gradient = np.stack((2 * xx - yy - zz, 2 * yy - zz - xx, 2 * zz - xx - yy, 6 * xy, 6 * yz, 6 * zx), axis=-1)
    size, slope = 2 * von_mises(stress), (gradient * change).sum(axis=-1)
    return np.asarray(np.divide(slope, size, out=np.zeros_like(size), where=size > 0))


def principal(tensor: Reals) -> Floats:
    """Principal values (..., 3), largest first, of stress or strain tensors (..., 6)."""
    values = np.asarray(tensor, dtype=np.float64)
    full = np.empty((*values.shape[:-1], 3, 3))
    full[..., _ROW, _COLUMN] = full[..., _COLUMN, _ROW] = values
    return np.asarray(np.linalg.eigvalsh(full)[..., ::-1])
