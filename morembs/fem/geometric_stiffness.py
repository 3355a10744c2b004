"""Geometric stiffness of a stressed mesh: what stress adds to the stiffness.

K_g = sum_e int dN' S dN dV (x) I3 for the stress S of a small displacement field u (Zienkiewicz and Taylor 2000,
vol. 2, ch. 10): one scalar matrix on the nodes serves the displacements along x, y and z. Stress is taken at the
points where the stiffness is integrated, from the strain of the formulation of the elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from morembs.base.budget import current_budget
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.assembly import chunks, node_graph
from morembs.fem.elements import TYPES
from morembs.fem.formulations import formulation_of
from morembs.fem.material import VOIGT, Material
from morembs.fem.mesh import Mesh, material_of_elements


@dataclass(frozen=True, kw_only=True, eq=False)
class StressedMesh:
    """What the geometric stiffness of a mesh needs, independent of the stress.

    ``graph`` (n, n) is the pattern of all results, its data number its entries; ``owner`` gives the material of each
    element, block by block.
    """

    mesh: Mesh
    materials: tuple[Material, ...]
    graph: sp.csr_array
    owner: dict[int, Ints]

    @classmethod
    def of(cls, mesh: Mesh, materials: Sequence[Material]) -> StressedMesh:
        """The mesh with its materials, as ``fem.assemble`` takes them.

        Raises:
            InputError: a material names an unknown set, or an element has no or two materials.
        """
        owner = material_of_elements(mesh, materials)
        return cls(mesh=mesh, materials=tuple(materials), graph=node_graph(mesh), owner=owner)

    def stiffness(self, U: Floats) -> list[sp.csr_array]:
        """Scalar matrices (n, n), one for the stress of each column of the displacements ``U`` (3 n, k) in m.

        They share their pattern. Peak memory: the results and one chunk of about 50 MB times 2.

        Raises:
            InputError: ``U`` of another shape.
        """
        xyz, graph = self.mesh.nodes.xyz, self.graph
        if U.ndim != 2 or len(U) != 3 * len(xyz):
            raise InputError(
                f"displacements of shape {U.shape} were given; expected ({3 * len(xyz)}, k), x, y and z of every node",
                keyword="displacements",
            )
        budget = current_budget()
        data = [budget.empty(graph.nnz) for _ in range(U.shape[1])]
        elasticity = np.stack([material.stiffness for material in self.materials])
        for block, rows in chunks(self.mesh):
            nodes, formulation = block.nodes[rows], formulation_of(block)
            C = elasticity[self.owner[id(block)][rows]]
            elements = formulation.elements(TYPES[block.type], xyz[nodes], block.ids[rows], C)
            at_points, added = elements.here, formulation.change_of_strains(elements)
            k = nodes.shape[1]
            row, col = np.repeat(nodes, k, axis=1).ravel(), np.tile(nodes, (1, k)).ravel()
            at = np.asarray(graph[row, col]).ravel()
            for u, values in zip(U.T, data, strict=True):
                stress = stress_at_points(at_points.dN, u.reshape(-1, 3)[nodes], C, added)
                np.add.at(values, at, element_stiffness(at_points.dN, at_points.dV, stress).ravel())
            budget.release_if_tight()
        return [self._matrix(values) for values in data]

    def _matrix(self, values: Floats) -> sp.csr_array:
        matrix = sp.csr_array((values, self.graph.indices, self.graph.indptr), shape=self.graph.shape)
        matrix.has_canonical_format = True
        return matrix


def geometric_stiffness(mesh: Mesh, materials: Sequence[Material], u: Floats) -> sp.csr_array:
    """Scalar kg (n, n) in N/m of the stress under the displacements ``u`` (3 n,) in m: K_g = kg (x) I3.

    Raises:
        InputError: materials that do not fit the mesh, or ``u`` of another length.
    """
    return StressedMesh.of(mesh, materials).stiffness(np.asarray(u, dtype=float)[:, None])[0]


def stress_at_points(dN: Floats, u: Floats, C: Floats, added: Floats | None = None) -> Floats:
    """Stress (ne, nq, 3, 3) in Pa of the nodal displacements ``u`` (ne, k, 3).

    ``dN`` (ne, nq, k, 3) are the gradients of the shape functions, ``C`` (ne, 6, 6) the elastic constants, ``added``
    (ne, nq, 6, 3k) what the formulation adds to the strains of the gradients.
    """
    gradient = np.matmul(u.transpose(0, 2, 1)[:, None], dN)
    strain = np.stack([gradient[..., a, b] + (gradient[..., b, a] if a != b else 0.0) for a, b in VOIGT], axis=-1)
    if added is not None:
        strain += np.matmul(added, u.reshape(len(u), 1, -1, 1))[..., 0]
    flat = np.matmul(strain, C)
    stress = np.empty_like(gradient)
    for p, (a, b) in enumerate(VOIGT):
        stress[..., a, b] = stress[..., b, a] = flat[..., p]
    return np.asarray(stress)


def element_stiffness(dN: Floats, dV: Floats, stress: Floats) -> Floats:
    """Scalar matrices (ne, k, k) of the ``stress`` (ne, nq, 3, 3) at points of volume ``dV`` (ne, nq)."""
    ne, _, k, _ = dN.shape
    pulled = np.matmul(dN, stress * dV[..., None, None])
    left, right = (part.transpose(0, 2, 1, 3).reshape(ne, k, -1) for part in (pulled, dN))
    return np.asarray(np.matmul(left, right.transpose(0, 2, 1)))
