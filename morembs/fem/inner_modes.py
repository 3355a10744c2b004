"""Incompatible modes of hexahedra that are dofs with mass, as CalculiX has them in C3D8I.

Each element has three modes 1 - xi_k^2 in three directions (Wilson 1973), which it shares with no other: nine scalars
behind the displacements of all nodes. Rigid motion leaves them at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.elements import TYPES
from morembs.fem.fe_model import Component, DofMap, FEModel
from morembs.fem.formulations import formulation_of, jacobian, mass_rule, mode_strains, strain_operator
from morembs.fem.material import Material
from morembs.fem.mesh import ElementBlock, Mesh
from morembs.fem.tolerances import TOL

# K and M between nodes and modes (ne, 24, 9), and of modes (ne, 9, 9).
_Parts = tuple[Floats, Floats]


def has_inner_modes(mesh: Mesh) -> bool:
    """True if elements have modes that are dofs."""
    return any(formulation_of(block).has_modes for block in mesh.blocks)


def refuse_inner_modes(mesh: Mesh, what: str) -> None:
    """Refuse elements whose modes are dofs.

    Raises:
        InputError: there are some, which ``what`` cannot have.
    """
    if has_inner_modes(mesh):
        raise InputError(
            f"{what} cannot have elements with internal modes (S4, B31 and C3D8I of CalculiX); take other elements",
            kind="unsupported",
            keyword="elements",
        )


def with_inner_modes(
    model: FEModel, mesh: Mesh, materials: Sequence[Material], owner: Mapping[int, Ints], mass_integration: str
) -> FEModel:
    """The model with the modes inside the elements of ``mesh``, of which it has the displacements.

    Args:
        owner, mass_integration: as of ``integrate``.
    """
    if not has_inner_modes(mesh):
        return model
    couplings: dict[str, list[tuple[Ints, Ints, _Parts]]] = {"K": [], "M": []}
    nodes, size = [model.dofs.node], model.size
    for block in mesh.blocks:
        if not formulation_of(block).has_modes:
            continue
        rows = (3 * block.nodes[:, :, None] + np.arange(3)).reshape(len(block.nodes), -1)
        modes = size + np.arange(9 * len(block.nodes)).reshape(-1, 9)
        x, which = mesh.nodes.xyz[block.nodes], owner[id(block)]
        rule = block.mass if mass_integration == "element" else mass_integration
        couplings["K"].append((rows, modes, _stiffness(block, x, materials, which)))
        couplings["M"].append((rows, modes, _mass(block, rule, x, materials, which)))
        nodes.append(np.repeat(block.nodes[:, 0], modes.shape[1]))
        size += modes.size
    node = np.concatenate(nodes)
    component = np.concatenate([model.dofs.component, np.full(size - model.size, int(Component.SCALAR))])
    grown = {name: _extend(getattr(model, name), size, parts) for name, parts in couplings.items()}
    return replace(model, dofs=DofMap(node=node, component=component), **grown)


def _stiffness(block: ElementBlock, x: Floats, materials: Sequence[Material], which: Ints) -> _Parts:
    constants = np.stack([material.stiffness for material in materials])
    formulation, kind, parts = formulation_of(block), TYPES[block.type], list[_Parts]()
    size = max(1, TOL.numbers_at_once // constants[0].size ** 2)
    for first in range(0, len(x), size):
        part = slice(first, first + size)
        elements = formulation.elements(kind, x[part], block.ids[part], constants[which[part]])
        inner, dV = mode_strains(elements, patched=False), elements.here.dV[..., None, None]
        weighted = _flat(np.matmul(elements.C[:, None], inner) * dV)
        B, own = _flat(strain_operator(elements.here.dN)), _flat(inner)
        of_modes = np.matmul(own.transpose(0, 2, 1), weighted)
        parts.append((np.matmul(B.transpose(0, 2, 1), weighted), 0.5 * (of_modes + of_modes.transpose(0, 2, 1))))
    return np.concatenate([between for between, _ in parts]), np.concatenate([own for _, own in parts])


def _flat(B: Floats) -> Floats:
    """Strains (ne, nq, 6, k) of all points (ne, 6 nq, k)."""
    return B.reshape(len(B), -1, B.shape[-1])


def _mass(block: ElementBlock, rule_name: str, x: Floats, materials: Sequence[Material], which: Ints) -> _Parts:
    rule = mass_rule(block, rule_name)
    density = np.array([material.density for material in materials])[which]
    dm = np.linalg.det(jacobian(x, rule)) * rule.weights * density[:, None]
    modes = 1 - np.square(2 * rule.points - 1)
    between, own = np.einsum("eq,qa,qk->eak", dm, rule.N, modes), np.einsum("eq,qj,qk->ejk", dm, modes, modes)
    return _on_axes(between), _on_axes(own)


def _on_axes(scalar: Floats) -> Floats:
    """Scalar masses (ne, j, k) along each of three axes (ne, 3 j, 3 k)."""
    ne, j, k = scalar.shape
    return np.asarray(np.einsum("ejk,ab->ejakb", scalar, np.eye(3)).reshape(ne, 3 * j, 3 * k))


def _extend(A: sp.csr_array, size: int, parts: Sequence[tuple[Ints, Ints, _Parts]]) -> sp.csr_array:
    """A with rows and columns of modes (ne, 9) beside those of nodes (ne, 24)."""
    entries = [A.tocoo()]
    rows, columns, values = [entries[0].row], [entries[0].col], [entries[0].data]
    for nodes, modes, (between, own) in parts:
        for first, second, data in (
            (nodes, modes, between),
            (modes, nodes, between.transpose(0, 2, 1)),
            (modes, modes, own),
        ):
            rows.append(np.repeat(first, second.shape[1], axis=1).ravel())
            columns.append(np.tile(second, (1, first.shape[1])).ravel())
            values.append(data.ravel())
    whole = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csr_array(sp.coo_array(whole, shape=(size, size)))
