"""True if a body was reduced from a problem: by its mass, interfaces, nodes, and a few products with its basis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.dynamics.assembly.parts import Substructure
from morembs.dynamics.assembly.tolerances import TOL
from morembs.fem.interface.base import Elimination
from morembs.problem import Problem

MEND = "run the job that made the body again, or name that job"


def eliminations(problem: Problem) -> Mapping[str, Elimination]:
    """The interfaces of ``problem`` whose frames take the place of dofs, in the order of their frames."""
    attached = {each.name: each.kind.attach(problem.model, each) for each in problem.interfaces}
    return {name: found for name, found in attached.items() if isinstance(found, Elimination)}


def _keeps_all(part: Substructure, problem: Problem) -> bool:
    """True if the body file of ``part`` keeps the motion of all dofs of ``problem``."""
    ids, own = part.bodies.node_ids, problem.model.nodes.ids
    return problem.model.dofs.is_solid and len(ids) == len(own) and set(ids.tolist()) == set(own.tolist())


def basis_of(part: Substructure, body: Body, problem: Problem) -> Floats:
    """Columns (Nc, n) of the coupled dofs of ``problem`` for the coordinates of ``body``.

    Raises:
        InputError: the file does not keep all displacements, and ``part`` has no basis.
    """
    if not _keeps_all(part, problem):
        if part.basis is not None:
            return part.basis()
        raise InputError(
            f"part {part.name!r}: its body keeps the displacements of {len(part.bodies.node_ids):,} nodes, which are "
            f"not all {problem.model.size:,} dofs of its model; give its basis too"
        )
    model, coupling = problem.model, problem.coupling
    order = np.argsort(part.bodies.node_ids)
    rows = order[np.searchsorted(part.bodies.node_ids[order], model.nodes.ids)]
    n = len(body.stiffness_matrix)
    U = body.basis().reshape(-1, 3, n)[rows].reshape(-1, n)
    frames = [np.linalg.lstsq(e.motion, U[e.dofs], rcond=None)[0] for e in eliminations(problem).values()]
    return np.vstack([U[coupling.kept], *frames])


def check_same_model(part: Substructure, problem: Problem) -> None:
    """Refuse a body of another part than that of ``problem``: other interfaces, mass or nodes, or a loss factor.

    Raises:
        InputError: in these cases, with both.
    """
    source, what = part.bodies, f"part {part.name!r}: its body was not reduced from its model"
    if problem.damping.structural:
        # No matrix of a body would show it, and it acts on the part alone.
        raise InputError(
            f"part {part.name!r}: the model of its body has structural damping of {problem.damping.structural:g}; "
            "reduce the parts without it and give [damping] structural to the assembly"
        )
    theirs = {each.name: each for each in problem.interfaces}
    if list(theirs) != list(source.interfaces):
        raise InputError(
            f"{what}: the interfaces are {_list_names(source.interfaces)} and {_list_names(theirs)}; {MEND}"
        )
    size = max(float(np.ptp(problem.model.nodes.xyz, axis=0).max()), np.finfo(float).tiny)
    for name, stored in source.interfaces.items():
        own = theirs[name]
        if (stored.coupling, stored.components) != (own.coupling, own.components):
            given = [f"{each.coupling} {list(each.components)}" for each in (stored, own)]
            raise InputError(f"{what}: interface {name!r} is {' and '.join(given)}; {MEND}")
        _refuse_apart(f"{what}: interface {name!r} is at", stored.point, own.point, TOL.same_part * size)
    mass, center, inertia = problem.mass_properties
    if abs(source.mass - mass) > TOL.same_part * mass:
        raise InputError(f"{what}: the masses are {source.mass:.10g} and {mass:.10g} kg; {MEND}")
    _refuse_apart(f"{what}: the centre of mass is at", source.center_of_mass, center, TOL.same_part * size)
    _refuse_apart(f"{what}: the inertia is", source.inertia, inertia, TOL.same_part * float(np.abs(inertia).max()))
    dofs = source.recipe.get("dofs", problem.model.size)
    if dofs != problem.model.size:
        raise InputError(f"{what}: the models have {dofs:,} and {problem.model.size:,} dofs; {MEND}")
    nodes = problem.model.nodes
    order = np.argsort(nodes.ids)
    rows = order[np.minimum(np.searchsorted(nodes.ids[order], source.node_ids), len(order) - 1)]
    for label in source.node_ids[nodes.ids[rows] != source.node_ids][:1].tolist():
        raise InputError(f"{what}: it keeps node {label}, which the model does not have; {MEND}", kind="unsupported")
    far = np.flatnonzero((np.abs(nodes.xyz[rows] - source.coordinates) > TOL.same_part * size).any(axis=1))
    for at in far[:1]:
        _refuse_apart(f"{what}: node {source.node_ids[at]} is at", source.coordinates[at], nodes.xyz[rows[at]], 0.0)


def refuse_other_matrices(part: Substructure, body: Body, problem: Problem, V: Floats) -> None:
    """Refuse a body whose matrices are not the projections of those of ``problem`` on its basis ``V`` (Nc, n).

    Raises:
        InputError: in these cases, with the differences.
    """
    n, what = len(body.stiffness_matrix), f"part {part.name!r}: its body was not reduced from its model"
    if V.shape != (len(problem.rigid), n):
        raise InputError(f"part {part.name!r}: its basis has the shape {V.shape}; expected {(len(problem.rigid), n)}")
    rigid = body.reduced.modes()[1][:, : body.rigid_count]
    damped = problem.damping.matrix(body.mass_matrix, body.stiffness_matrix, rigid)
    products: dict[str, tuple[Any, Floats, Floats]] = {
        "stiffness": (problem.K, body.stiffness_matrix, np.zeros((n, n))),
        "mass": (problem.M, body.mass_matrix, np.zeros((n, n))),
        "damping": (problem.D, body.damping_matrix, damped),
    }
    x = np.random.default_rng(7).standard_normal((n, 2))
    for name, (A, stored, more) in products.items():
        scale = _scale(stored)
        y = scale[:, None] * x
        true = more @ y if A is None else more @ y + V.T @ (A @ (V @ y))
        off, size = (np.linalg.norm(scale[:, None] * value) for value in (true - stored @ y, stored @ y))
        if not off <= TOL.same_product * size:
            difference = f"by {off / size:.1e} of it" if size else "and it has none"
            raise InputError(f"{what}: its {name} is not V' A V of the model, {difference}; {MEND}")
    motions = problem.B.T @ V
    if not np.abs(motions - body.output_matrix).max() <= TOL.same_product * np.abs(body.output_matrix).max():
        raise InputError(f"{what}: the motions of its interfaces are others; {MEND}")


def _scale(A: Floats) -> Floats:
    """Of each coordinate, so that all entries of ``A`` (n, n) count alike; those without any as the smallest."""
    size = np.abs(np.diag(A))
    least = float(size[size > TOL.same_part * size.max(initial=0.0)].min(initial=np.inf))
    return np.asarray(1.0 / np.sqrt(np.maximum(size, least if np.isfinite(least) else 1.0)))


def _refuse_apart(what: str, one: Floats, other: Floats, tolerance: float) -> None:
    if not np.abs(one - other).max() <= tolerance:
        raise InputError(f"{what} {np.round(one, 9).tolist()} and {np.round(other, 9).tolist()}; {MEND}")


def _list_names(names: Mapping[str, object]) -> str:
    return ", ".join(names) or "none"
