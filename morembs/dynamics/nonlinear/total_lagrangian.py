"""Solid elements at large displacements: St. Venant-Kirchhoff material in the total Lagrangian form.

F = sum_k x_k dN_k', E = (F'F - 1)/2, S = C : E, W = int S : E / 2 dV over the undeformed volume (Zienkiewicz and
Taylor 2000, vol. 2, ch. 10). Elements, quadrature and materials are those of ``model.assembly``, so that the tangent
without load is its stiffness matrix. Good for large rotations at moderate strains: the material softens under strong
compression, and an element may turn inside out, which ``refuse_inverted`` says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from morembs.base.budget import Budget, current_budget
from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel
from morembs.fem.assembly import chunks, node_graph, stiffness_pattern
from morembs.fem.elements import TYPES, Rule
from morembs.fem.formulations import formulation_of, geometry
from morembs.fem.geometric_stiffness import element_stiffness
from morembs.fem.material import VOIGT
from morembs.fem.mesh import ElementBlock, material_of_elements


@dataclass(frozen=True, eq=False)
class _Chunk:
    """Elements at their points: node rows (ne, k), dN (ne, nq, k, 3), dV (ne, nq), C (ne, 6, 6), where their stress
    begins, their places in the node graph."""

    nodes: Ints
    dN: Floats
    dV: Floats
    C: Floats
    first: int
    at: Ints

    def of(self, stress: Floats) -> Floats:
        """The stress (ne, nq, 6) here of that of all points."""
        return np.asarray(stress[self.first : self.first + self.dV.size].reshape(*self.dV.shape, 6))


class SaintVenantKirchhoff:
    """Energy, inner forces and tangent of all nodes of a model of solid elements.

    Positions are given as (n, 3) in m. Memory: the places of element matrices in the tangent (4 k^2 bytes per
    element of k nodes), the tangent, and one chunk of about 50 MB times 5.

    Raises:
        InputError: a model without mesh and materials, or with coordinates other than its nodes' displacements;
            elements whose formulation is one of small strains.
    """

    def __init__(self, model: FEModel) -> None:
        if model.mesh is None or not model.materials or not model.dofs.is_solid:
            raise InputError(
                "the model has no mesh of solid elements with materials, or more than the displacements of its nodes; "
                "expected what morembs.fem.assembly.assemble gives. Large displacements need the elements themselves",
                kind="unsupported",
                keyword="model",
            )
        self._model, self.mesh, self.budget, self.X = model, model.mesh, current_budget(), model.nodes.xyz
        self._owner = material_of_elements(self.mesh, model.materials)
        self._stiffness = np.stack([material.stiffness for material in model.materials])
        self._graph = node_graph(self.mesh)
        self._places: dict[tuple[int, int], Ints] = {}
        self._pieces = list(chunks(self.mesh))
        self._rules = {id(block): _rule(block) for block in self.mesh.blocks}
        self.points = sum(len(self._rules[id(block)].weights) * len(block.ids) for block in self.mesh.blocks)

    def __reduce__(self) -> tuple[type[SaintVenantKirchhoff], tuple[FEModel], dict[str, Budget]]:
        # What belongs to a block is found by its identity, which another process does not share.
        return SaintVenantKirchhoff, (self._model,), {"budget": self.budget}

    def _chunks(self) -> Iterator[_Chunk]:
        first = 0
        for block, rows in self._pieces:
            nodes, kind = block.nodes[rows], TYPES[block.type]
            here = geometry(self.X[nodes], self._rules[id(block)], block.ids[rows], kind)
            key = id(block), int(rows[0])
            if key not in self._places:
                k = nodes.shape[1]
                row, col = np.repeat(nodes, k, axis=1).ravel(), np.tile(nodes, (1, k)).ravel()
                self._places[key] = np.asarray(self._graph[row, col]).ravel()
            C = self._stiffness[self._owner[id(block)][rows]]
            yield _Chunk(nodes, here.dN, here.dV, C, first, self._places[key])
            first += here.dV.size
            self.budget.release_if_tight()

    def _gradients(self, chunk: _Chunk, x: Floats) -> tuple[Floats, Floats]:
        """H = F - 1 (ne, nq, 3, 3) and stress S (ne, nq, 6), from displacements, which keeps small strains exact."""
        u = (x - self.X)[chunk.nodes]
        H = np.matmul(u.transpose(0, 2, 1)[:, None], chunk.dN)
        E = 0.5 * (H + np.swapaxes(H, -1, -2) + np.swapaxes(H, -1, -2) @ H)
        return H, np.matmul(_voigt(E), chunk.C)

    def energy(self, x: Floats) -> float:
        """Strain energy in J."""
        total = 0.0
        for chunk in self._chunks():
            H, S = self._gradients(chunk, x)
            E = 0.5 * (H + np.swapaxes(H, -1, -2) + np.swapaxes(H, -1, -2) @ H)
            total += 0.5 * float(np.einsum("eqp,eqp,eq->", S, _voigt(E), chunk.dV))
        return total

    def force(self, x: Floats, stress: Floats | None = None) -> Floats:
        """Inner forces (n, 3) in N; those of another ``stress`` (points, 6) where it is given."""
        result = np.zeros_like(self.X)
        for chunk in self._chunks():
            H, S = self._gradients(chunk, x)
            S = S if stress is None else chunk.of(stress)
            P = (H + np.eye(3)) @ _tensor(S) * chunk.dV[..., None, None]
            local = np.einsum("eqkb,eqab->eka", chunk.dN, P, optimize=True)
            for a in range(3):
                result[:, a] += np.bincount(chunk.nodes.ravel(), local[:, :, a].ravel(), len(result))
        return result

    def stress(self, x: Floats) -> Floats:
        """Second Piola-Kirchhoff stress (points, 6) in Pa: xx, yy, zz, yz, zx, xy."""
        result = self.budget.empty((self.points, 6))
        for chunk in self._chunks():
            S = self._gradients(chunk, x)[1].reshape(-1, 6)
            result[chunk.first : chunk.first + len(S)] = S
        return result

    def stress_after(self, x: Floats, step: Floats) -> Floats:
        """Stress (points, 6) at x plus its change to first order by a ``step`` (n, 3) of the nodes."""
        result = self.budget.empty((self.points, 6))
        for chunk in self._chunks():
            H, S = self._gradients(chunk, x)
            change = np.matmul(step[chunk.nodes].transpose(0, 2, 1)[:, None], chunk.dN)
            rate = np.swapaxes(H + np.eye(3), -1, -2) @ change
            rate = 0.5 * (rate + np.swapaxes(rate, -1, -2))
            new = (S + np.matmul(_voigt(rate), chunk.C)).reshape(-1, 6)
            result[chunk.first : chunk.first + len(new)] = new
        return result

    def tangent(self, x: Floats, stress: Floats | None = None) -> sp.csr_array:
        """Tangent stiffness (3 n, 3 n), of one pattern; ``stress`` (points, 6) may replace that at x in its geometric
        part."""
        graph = self._graph
        blocks = np.diff(graph.indptr).astype(np.int64)
        data = self.budget.empty(9 * graph.nnz)
        data[:] = 0.0
        for chunk in self._chunks():
            K = self._elements(chunk, x, stress)
            k = chunk.nodes.shape[1]
            row = np.repeat(chunk.nodes, k, axis=1).ravel()
            # Entry (a, b) of node block `at` lies at 9*start + 3*a*blocks + 3*(at - start) + b of the CSR array.
            first = 6 * graph.indptr[row].astype(np.int64) + 3 * chunk.at
            for a in range(3):
                for b in range(3):
                    np.add.at(data, first + a * 3 * blocks[row] + b, K[:, a::3, b::3].ravel())
        indptr, indices = self.pattern
        K = sp.csr_array((data, indices, indptr), shape=(self.X.size,) * 2)
        K.has_canonical_format = True
        return K

    def neighbours(self, nodes: Ints) -> Ints:
        """Nodes that share an element with one of ``nodes``."""
        return np.asarray(self._graph[nodes].indices)

    @cached_property
    def pattern(self) -> tuple[Ints, Ints]:
        """indptr and indices of the tangent, blocks of 3 x 3 on the node graph."""
        with self.budget.in_use():
            whole = stiffness_pattern(self._graph)
        return whole.indptr, whole.indices

    def _elements(self, chunk: _Chunk, x: Floats, stress: Floats | None) -> Floats:
        """Tangent stiffness (ne, 3k, 3k) of the elements of a chunk."""
        H, S = self._gradients(chunk, x)
        ne, nq, k, _ = chunk.dN.shape
        S = S if stress is None else chunk.of(stress)
        F = H + np.eye(3)
        B = np.empty((ne, nq, 6, k, 3))
        for p, (a, b) in enumerate(VOIGT):
            B[:, :, p] = chunk.dN[..., a, None] * F[:, :, None, :, b]
            if a != b:
                B[:, :, p] += chunk.dN[..., b, None] * F[:, :, None, :, a]
        # C = L L', so that B' C B is one product of a matrix with itself.
        roots = np.swapaxes(np.linalg.cholesky(chunk.C), -1, -2)[:, None] * np.sqrt(chunk.dV)[..., None, None]
        B = np.matmul(roots, B.reshape(ne, nq, 6, 3 * k)).reshape(ne, nq * 6, 3 * k)
        K = np.matmul(B.transpose(0, 2, 1), B)
        geometric = element_stiffness(chunk.dN, chunk.dV, _tensor(S))
        for a in range(3):
            K[:, a::3, a::3] += geometric
        return np.asarray(0.5 * (K + K.transpose(0, 2, 1)))

    def refuse_inverted(self, x: Floats) -> None:
        """Refuses a configuration with elements inside out.

        Raises:
            SolverError: det F <= 0 at a point.
        """
        count, least = 0, np.inf
        for chunk in self._chunks():
            J = np.linalg.det(self._gradients(chunk, x)[0] + np.eye(3)).min(axis=1)
            count, least = count + int((J <= 0).sum()), min(least, float(J.min()))
        if count:
            raise SolverError(
                f"{count} elements are inside out (smallest volume ratio {least:.2g}); strains are too large for the "
                "material, or the mesh is too coarse",
                keyword="elements",
            )


def _rule(block: ElementBlock) -> Rule:
    """Where a block is integrated.

    Raises:
        InputError: a formulation whose strain is not that of the field at its points.
    """
    formulation = formulation_of(block)
    if not formulation.is_plain:
        raise InputError(
            f"{len(block.ids)} elements {block.type} have the formulation {block.formulation!r}, which takes small "
            'strains; large displacements need those of the field: give their block formulation = "full" '
            "(dataclasses.replace) and assemble the mesh again, or mesh with quadratic elements",
            kind="unsupported",
            keyword="formulation",
        )
    return formulation.points(TYPES[block.type])


def _voigt(E: Floats) -> Floats:
    """(..., 6) of symmetric strains (..., 3, 3), shear doubled."""
    return np.stack([E[..., a, b] * (1.0 if a == b else 2.0) for a, b in VOIGT], axis=-1)


def _tensor(S: Floats) -> Floats:
    """(..., 3, 3) of stresses (..., 6)."""
    result = np.empty((*S.shape[:-1], 3, 3))
    for p, (a, b) in enumerate(VOIGT):
        result[..., a, b] = result[..., b, a] = S[..., p]
    return result
