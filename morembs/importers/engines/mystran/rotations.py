"""Rotations that no element resists: about the normal of flat shells, and across rods.

Such a rotation has no stiffness and no mass, so nothing changes where it follows the motion of an element beside it: a
spring between them carries no force. It keeps K regular, and rigid motion, in which all turn, strains nothing. (Holding
it, as Nastran's AUTOSPC does, would.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from morembs.fem import rigid_motion
from morembs.fem.constraints import AverageElement, Equations, RigidElement
from morembs.importers.engines.mystran.cards import Block
from morembs.importers.imported import DiscreteElement, PointMass, Ties
from morembs.importers.point_masses import mass_about_node
from morembs.importers.tolerances import TOL


def turning(ties: Sequence[Ties], count: int) -> NDArray[np.bool_]:
    """Which of ``count`` grids have rotations that couplings, springs or equations move."""
    result = np.zeros(count, dtype=bool)
    for tie in ties:
        if isinstance(tie, RigidElement):
            result[tie.master] = True
            result[tie.slaves] |= max(tie.components) > 2
        elif isinstance(tie, AverageElement):
            result[tie.reference] = True
        elif isinstance(tie, Equations):
            result[tie.nodes[tie.components > 2]] = True
            result[tie.term_nodes[tie.term_components > 2]] = True
        elif isinstance(tie, DiscreteElement) and tie.matrix == "K":
            result[tie.nodes[tie.components > 2]] = True
        elif isinstance(tie, PointMass):
            pass  # a mass needs the spring as well
    return result


def with_springs(
    K: sp.csr_array,
    M: sp.csr_array,
    blocks: Sequence[Block],
    xyz: Floats,
    tied: NDArray[np.bool_],
    masses: Sequence[PointMass],
    held: dict[int, Floats],
) -> tuple[sp.csr_array, int]:
    """K (6 n, 6 n) with springs at grids whose rotations K leaves free, and how many grids these are.

    Args:
        tied: grids (n,) that couplings turn.
        masses: on grids, whose inertia needs rotations that elements do not fill.
        held: directions (k, 6) of grids that are held.
    """
    stiff, heavy = _rotational(K, len(xyz)), _rotational(M, len(xyz))
    for mass in masses:
        heavy[mass.node] += mass_about_node(mass)[3:, 3:]
    values = np.linalg.eigvalsh(stiff)
    loose = (values[:, 2] > 0) & (values[:, 0] < TOL.no_rotational_stiffness * values[:, 2]) & ~tied
    beside = _elements_of(blocks, loose)
    rows, columns, entries = [], [], []
    count = 0
    for grid in np.flatnonzero(loose).tolist():
        free = _free(stiff[grid], heavy[grid], held.get(grid))
        motions = _follow(grid, free, beside[grid], xyz) if len(free) else []
        count += bool(motions)
        for motion, dofs in motions:
            rows.append(np.repeat(dofs, len(dofs)))
            columns.append(np.tile(dofs, len(dofs)))
            entries.append((values[grid, 2] * np.outer(motion, motion)).ravel())
    if not count:
        return K, 0
    added = sp.coo_array((np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), shape=K.shape)
    return sp.csr_array(K + added.tocsr()), count


def _rotational(A: sp.csr_array, count: int) -> Floats:
    """Blocks (n, 3, 3) of rotations of each grid with themselves."""
    entries = A.tocoo()
    own = (entries.row // 6 == entries.col // 6) & (entries.row % 6 > 2) & (entries.col % 6 > 2)
    blocks = np.zeros((count, 3, 3))
    row, column = entries.row[own], entries.col[own]
    blocks[row // 6, row % 6 - 3, column % 6 - 3] = entries.data[own]
    return blocks


def _elements_of(blocks: Sequence[Block], wanted: NDArray[np.bool_]) -> dict[int, list[Ints]]:
    """The grids of the elements at each of the ``wanted`` grids (n,)."""
    beside: dict[int, list[Ints]] = {grid: [] for grid in np.flatnonzero(wanted).tolist()}
    for block in blocks:
        for element in block.nodes[wanted[block.nodes].any(axis=1)]:
            for grid in element[wanted[element]].tolist():
                beside[grid].append(element)
    return beside


def _free(stiff: Floats, heavy: Floats, held: Floats | None) -> Floats:
    """Axes (m, 3) about which a grid turns freely, but for those whose rows are empty and are left out."""
    there = np.flatnonzero((np.diag(stiff) > 0) | (np.diag(heavy) > 0))
    values, vectors = np.linalg.eigh(stiff[np.ix_(there, there)])
    axes = np.zeros((int((values < TOL.no_rotational_stiffness * values[-1]).sum()), 3))
    axes[:, there] = vectors[:, : len(axes)].T
    if held is None or not len(axes):
        return axes
    # What holds a rotation about such an axis holds it.
    touched = (np.abs(held[:, 3:] @ axes.T) > TOL.told_direction).any(axis=0)
    return np.asarray(axes[~touched])


def _follow(grid: int, axes: Floats, elements: Sequence[Ints], xyz: Floats) -> list[tuple[Floats, Ints]]:
    """Rotation of a grid about each axis less that of an element beside it: coefficients and dofs.

    The rotation of an element is that of the rigid motion next to the displacements of its grids.
    """
    result = []
    for axis in axes:
        for nodes in elements:
            x = xyz[nodes] - xyz[nodes].mean(axis=0)
            size = np.abs(x).max()
            R = rigid_motion(np.repeat(x / size, 3, axis=0), np.tile(np.arange(3), len(nodes)))
            weights = axis @ np.linalg.pinv(R, rcond=TOL.told_rotation)[3:] / size
            turned = weights @ R[:, 3:] * size
            if np.abs(turned - axis).max() < TOL.told_direction:
                dofs = (6 * nodes[:, None] + np.arange(3)).ravel()
                own = 6 * grid + 3 + np.arange(3)
                result.append((np.concatenate([axis, -weights]), np.concatenate([own, dofs])))
                break
    return result
