"""Point masses, and the dofs that nodes outside elements need to carry them or to lead other nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.base.units import Units
from morembs.fem import DofMap, FEModel, skew
from morembs.fem.constraints import AverageElement, Equations, RigidElement
from morembs.fem.fe_model import MATRICES
from morembs.importers.dependent_dofs import dof_table
from morembs.importers.imported import DiscreteElement, PointMass, Ties, nodes_of
from morembs.importers.tolerances import TOL


def si_mass(mass: PointMass, units: Units) -> PointMass:
    """The point mass in SI units.

    Raises:
        InputError: a mass or inertia that is negative or not finite.
    """
    inertia, offset = mass.inertia * units.mass * units.length**2, mass.offset * units.length
    finite = np.isfinite(mass.mass) and np.isfinite(inertia).all() and np.isfinite(offset).all()
    J = 0.5 * (inertia + inertia.T)
    small = TOL.negative_inertia * max(float(np.abs(J).max(initial=0.0)), np.finfo(float).tiny)
    if not finite or mass.mass < 0 or np.linalg.eigvalsh(J)[0] < -small:
        raise InputError(
            f"point mass {mass.name!r} has a negative or infinite mass or inertia; mend the file",
            kind="value",
            keyword="mass",
        )
    return replace(mass, mass=mass.mass * units.mass, inertia=J, offset=offset)


def mass_about_node(mass: PointMass) -> Floats:
    """Mass matrix (6, 6) of a point mass in the dofs of its node."""
    arm, M = skew(mass.offset), np.zeros((6, 6))
    M[:3, :3] = mass.mass * np.eye(3)
    M[:3, 3:], M[3:, :3] = -mass.mass * arm, mass.mass * arm
    M[3:, 3:] = mass.inertia - mass.mass * arm @ arm
    return M


def with_dofs(model: FEModel, ties: Sequence[Ties]) -> FEModel:
    """The model with the dofs that masters, references, equations and nodes outside elements need."""
    table = dof_table(model)
    width = table.shape[1]
    bare = np.asarray((table < 0).all(axis=1))
    needed: list[Ints] = [np.empty(0, dtype=np.int64)]
    six = np.arange(6)
    for tie in ties:
        if isinstance(tie, RigidElement):
            needed.append(width * tie.master + six)
            alone = tie.slaves[bare[tie.slaves]]
            needed.append((width * alone[:, None] + np.array(tie.components, dtype=np.int64)).ravel())
        elif isinstance(tie, AverageElement):
            needed.append(width * tie.reference + np.array(tie.components, dtype=np.int64))
        elif isinstance(tie, Equations):
            needed += [width * tie.nodes + tie.components, width * tie.term_nodes + tie.term_components]
        elif isinstance(tie, DiscreteElement):
            loose = bare[tie.nodes]
            # A node of its own moves along all axes, and turns where something resists that.
            needed += [(width * tie.nodes[loose][:, None] + six[:3]).ravel()]
            needed += [(width * tie.nodes + tie.components)[loose]]
    codes = np.unique(np.concatenate(needed))
    new = codes[table.ravel()[codes] < 0]
    if not len(new):
        return model
    dofs = DofMap(
        node=np.concatenate([model.dofs.node, new // width]),
        component=np.concatenate([model.dofs.component, new % width]),
    )
    grown: dict[str, Any] = {name: _extend(getattr(model, name), len(new)) for name in MATRICES}
    return replace(model, dofs=dofs, **grown)


def _extend(A: sp.csr_array | None, count: int) -> sp.csr_array | None:
    """A with ``count`` empty rows and columns at the end."""
    if A is None:
        return None
    indptr = np.concatenate([A.indptr, np.full(count, A.indptr[-1], dtype=A.indptr.dtype)])
    return sp.csr_array((A.data, A.indices, indptr), shape=(A.shape[0] + count,) * 2)


def with_masses(model: FEModel, masses: Sequence[PointMass]) -> FEModel:
    """The model with the point masses in M.

    Raises:
        InputError: a mass needs rotations that its node lacks.
    """
    if not masses:
        return model
    table = dof_table(model)
    rows, columns, values = [], [], []
    for mass in masses:
        M, dofs = mass_about_node(mass), table[mass.node, :6]
        lost = np.flatnonzero((dofs < 0) & (np.abs(M) > 0).any(axis=1))
        if len(lost):
            raise InputError(
                f"point mass {mass.name!r} on node {model.nodes.ids[mass.node]} needs the components "
                f"{', '.join(map(str, lost))}, which this node does not have (a solid has no rotations); "
                "couple the node by a rigid element, or leave out offset and inertia",
                kind="unsupported",
                keyword="mass",
            )
        here = np.flatnonzero(dofs >= 0)
        rows.append(np.repeat(dofs[here], len(here)))
        columns.append(np.tile(dofs[here], len(here)))
        values.append(M[np.ix_(here, here)].ravel())
    added = sp.coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), model.M.shape)
    added = added.tocsr()
    added.eliminate_zeros()
    return replace(model, M=sp.csr_array(model.M + added))


def refuse_loose(model: FEModel, ties: Sequence[Ties]) -> None:
    """Refuse point masses on nodes that neither have stiffness nor take part in a coupling, a spring or an equation.

    Raises:
        InputError: in these cases.
    """
    held = np.zeros(len(model.nodes), dtype=bool)
    held[model.dofs.node[np.diff(model.K.indptr) > 0]] = True
    held[nodes_of(tie for tie in ties if not isinstance(tie, PointMass))] = True
    for tie in ties:
        if isinstance(tie, PointMass) and not held[tie.node]:
            raise InputError(
                f"point mass {tie.name!r} is on node {model.nodes.ids[tie.node]}, which belongs to no element; "
                "couple it to the part by a rigid or an average element",
                kind="model",
                keyword="mass",
            )
