"""Placed parts and their couplings as one finite-element model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.summary import summarised
from morembs.dynamics.assembly.belonging import check_same_model
from morembs.dynamics.assembly.joints import Couple, Joints
from morembs.dynamics.assembly.parts import Placed, PlacedBody, Substructure
from morembs.fem import DofMap, FEModel, Nodes, rigid_motion
from morembs.fem.constraints import DependentDofs
from morembs.fem.fe_model import Component
from morembs.importers.dependent_dofs import dependent_dofs
from morembs.linalg.congruence import abs_products
from morembs.linalg.tolerances import TOL as LINALG

REDUCED = "certificates of an assembly are against the bodies that were assembled, whose own errors are not in them"
TURNING = (
    "inertia terms of second order in the elastic coordinates are not those of the parts, which matters where an "
    "assembly spins or turns fast: simulate the parts, coupled, there"
)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class AssembledModel(FEModel):
    """The model of an assembly, with the ``parts`` and ``couples`` that it was made of.

    ``free_motions`` are relative motions of the parts that no coupling holds, in words: a mechanism, which reductions
    refuse.
    """

    parts: tuple[Substructure, ...] = ()
    couples: tuple[Couple, ...] = ()
    free_motions: tuple[str, ...] = ()


def assemble_bodies(
    parts: Sequence[Substructure], couples: Sequence[Couple], *, name: str = "assembly"
) -> AssembledModel:
    """The coupled parts as a model, whose node sets "part:INTERFACE" are for interfaces of the assembly.

    Peak memory: the matrices (sum of n^2) and, for the nodes that parts keep, their shapes twice.

    Args:
        parts: bodies and their places.
        couples: pairs of interfaces that move as one.
        name: of the assembly.

    Raises:
        InputError: parts or interfaces that are not there, are apart or coupled twice, or bodies that are two-sided,
            have generalised forces or structural damping, or whose interfaces do not tell their rigid motion; some
            parts with and some without the problem that they were reduced from.

    >>> stored = read_body(write_body("bar.h5", [body]))
    >>> bars = [Substructure(name="a", bodies=stored), Substructure(name="b", bodies=stored, position=(0.4, 0, 0))]
    >>> assemble_bodies(bars, [Couple(between=("a:RIGHT", "b:LEFT"))]).size > 2 * 12
    True
    """
    names = [part.name for part in parts]
    if not parts or len(set(names)) < len(names) or any(":" in name for name in names):
        given = ", ".join(map(repr, names)) or "none"
        raise InputError(
            f"the parts {given} were given; expected one or more, each with a name of its own, no colons",
            keyword="parts",
        )
    without = [part.name for part in parts if part.problem is None]
    if 0 < len(without) < len(parts):
        raise InputError(
            f"the parts {', '.join(map(repr, without))} have no job, other parts have one; give the job of every "
            "part, for "
            "certificates against the unreduced parts, or of none"
        )
    for part in parts:
        if part.problem is not None:
            check_same_model(part, part.problem)
    placed = [PlacedBody.of(part) for part in parts]
    model = join_parts(placed, couples, name)
    warnings = dict.fromkeys(f"{part.name}: {warning}" for part in parts for warning in part.bodies.warnings)
    own = {item.name: getattr(model, item.name) for item in fields(FEModel)} | {
        "warnings": (*model.warnings, *warnings, *([REDUCED] if without else []), TURNING),
        "notes": (f"{len(parts)} bodies, {len(couples)} couplings",),
    }
    owner = np.repeat(np.arange(len(placed)), [len(part.xyz) for part in placed])
    free = _joints(placed, couples).free_motions(owner)
    return AssembledModel(**own, parts=tuple(parts), couples=tuple(couples), free_motions=tuple(free))


def join_parts(placed: Sequence[Placed], couples: Sequence[Couple], name: str) -> FEModel:
    """One model of all parts, whose couplings are equations and springs.

    Raises:
        InputError: couplings that do not fit the parts or each other.
    """
    joints = _joints(placed, couples)
    nodes, dofs = joints.nodes, joints.dofs
    # Interfaces that follow others altogether are these.
    nodes = replace(nodes, sets={key: joints.leading(rows) for key, rows in nodes.sets.items()})
    K, M, D = (sp.block_diag([part.matrices[key] for part in placed], "csr") for key in ("K", "M", "D"))
    K, D = K + joints.springs("stiffness"), D + joints.springs("damping")
    model = FEModel(
        K=K,
        M=M,
        D=D if D.nnz else None,
        nodes=nodes,
        dofs=dofs,
        source=name,
        equations=tuple(joints.equations()),
        warnings=tuple(joints.warnings),
    )
    model = replace(model, dependent=_dependent(model, placed))
    return replace(model, strained=_measure_rigid_residual(model))


def _joints(placed: Sequence[Placed], couples: Sequence[Couple]) -> Joints:
    """The couplings between the nodes of all parts."""
    ends = np.cumsum([0, *(len(part.xyz) for part in placed)])
    xyz = np.vstack([part.xyz for part in placed])
    sets = {
        f"{part.name}:{key}": rows + first
        for part, first in zip(placed, ends.tolist(), strict=False)
        for key, rows in part.sets.items()
    }
    nodes = Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz, sets=sets)
    dofs = DofMap(
        node=np.concatenate([part.node + first for part, first in zip(placed, ends, strict=False)]),
        component=np.concatenate([part.component for part in placed]),
    )
    return Joints(nodes, dofs, couples)


def _measure_rigid_residual(model: FEModel) -> float:
    """What rigid motions leave of the terms that cancel in the rows of K: parts are free and nothing holds them, so
    that it is round-off of their reductions, turns and places."""
    K, xyz, component = model.K, model.nodes.xyz[model.dofs.node], model.dofs.component
    S = sp.eye_array(model.size, format="csr") if model.dependent is None else model.dependent.S
    xyz = xyz - xyz.mean(axis=0)
    # Rotations per radius, so that all motions move nodes as far.
    radius = float(np.sqrt((xyz**2).sum(axis=1).mean())) or 1.0
    R = rigid_motion(xyz, component) / np.repeat([1.0, radius], 3)
    size = (abs(S).T @ abs_products(K, abs(S) @ np.abs(R), component == Component.SCALAR)).max(axis=1)
    force = np.abs(S.T @ (K @ (S @ R))).max(axis=1)
    left = float(np.divide(force, size, out=np.zeros_like(force), where=size > 0).max(initial=0.0))
    # Stiff springs feel the last digit of a place, which is larger far from the origin.
    return LINALG.clear_support * (left + LINALG.roundoff * float(np.abs(model.nodes.xyz).max()) / radius)


def _dependent(model: FEModel, placed: Sequence[Placed]) -> DependentDofs | None:
    """What follows what: the couplings, and nodes that follow the dofs of their part."""
    known = dependent_dofs(model, (), (), model.equations)
    if not any(len(part.node) > part.basis.shape[1] for part in placed):
        return known
    if known is None:
        known = DependentDofs(S=sp.eye_array(model.size, format="csr"), owner=np.full(model.size, -1), names=())
    is_dependent = np.concatenate([np.repeat([False, True], part.basis.T.shape) for part in placed])
    shapes = sp.block_diag(
        [
            sp.block_array([[sp.csr_array((n, n)), None], [part.basis, sp.csr_array((rows, rows))]])
            for part in placed
            for rows, n in [part.basis.shape]
        ],
        "csr",
    )
    S = sp.csr_array((sp.diags_array((~is_dependent).astype(float)) + shapes) @ known.S)
    S.eliminate_zeros()
    owner = np.where(is_dependent, len(known.names), known.owner)
    return DependentDofs(S=S, owner=owner, names=(*known.names, "shapes of the parts"))
