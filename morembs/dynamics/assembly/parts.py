"""Bodies as parts of an assembly: turned and moved to their places, with interface motions as coordinates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.body import Body
from morembs.body.stored import StoredBodies, choose_body
from morembs.dynamics.assembly.tolerances import TOL
from morembs.exporters.ports import ports_of_file
from morembs.exporters.reduced import to_interfaces
from morembs.fem.fe_model import Component, rigid_motion
from morembs.linalg.dense import symmetric
from morembs.problem import STRUCTURAL, Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class Substructure:
    """A part of an assembly: one of ``bodies``, named ``reduction`` where there are several, at ``position`` (3,) in m,
    turned by ``rotation`` (3, 3).

    ``problem`` is what the body was reduced from, for certificates against the unreduced parts (``Unreduced``);
    ``basis`` gives (Nc, n) of the body in its coupled dofs, where the file does not keep all of its displacements.

    >>> stored = read_body(write_body("bar.h5", [body]))
    >>> part = Substructure(name="arm", bodies=stored, position=(0.4, 0, 0))
    """

    name: str
    bodies: StoredBodies
    reduction: str | None = None
    position: ArrayLike = (0.0, 0.0, 0.0)
    rotation: ArrayLike = field(default_factory=lambda: np.eye(3))
    problem: Problem | None = None
    basis: Callable[[], Floats] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Placed:
    """A part in its place: ``matrices`` in its dofs, of which the last follow the first by ``basis`` (last, first), as
    the displacements of the nodes that a body keeps do. ``sets`` are the nodes of its interfaces."""

    name: str
    matrices: Mapping[str, sp.csr_array]
    xyz: Floats
    node: Ints
    component: Ints
    sets: Mapping[str, Ints]
    basis: Floats | sp.csr_array


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacedBody(Placed):
    """A ``body`` in its place, ``place`` (3,) and ``turn`` (3, 3): its coordinates are ``coordinates`` (n, n) times its
    first n dofs, of which the first ``inputs`` are the interface motions; ``shown`` are labels of nodes that it keeps.
    """

    body: Body
    turn: Floats
    place: Floats
    coordinates: Floats
    inputs: int
    shown: Ints

    @classmethod
    def of(cls, part: Substructure) -> PlacedBody:
        source, body = part.bodies, choose_body(part.bodies, part.reduction, f"part {part.name!r}")
        turn, place = rotation_matrix(part), np.asarray(part.position, dtype=float)
        _refuse(part.name, source, body)
        T, _ = to_interfaces(body, body.output_matrix)
        ports = ports_of_file(source)
        m, n = len(ports), T.shape[1]
        keys = list(dict.fromkeys((port.interface, port.node) for port in ports))
        at = {key: np.array([row for row, p in enumerate(ports) if (p.interface, p.node) == key]) for key in keys}
        node = np.empty(n, dtype=np.int64)
        for number, key in enumerate(keys):
            node[at[key]] = number
            _turn(T, at[key], [ports[row].component for row in at[key]], turn, part.name)
        node[m:] = 0
        points = np.array([ports[at[key][0]].point for key in keys])
        shown = np.flatnonzero(~np.isin(source.node_ids, [key[1] for key in keys]))
        basis = body.basis().reshape(-1, 3, n)[shown] @ T if len(shown) else np.zeros((0, 3, n))
        matrices = {"K": body.stiffness_matrix, "M": body.mass_matrix, "D": body.damping_matrix}
        component = np.concatenate([[port.component for port in ports], np.full(n - m, Component.SCALAR)])
        empty = sp.csr_array((3 * len(shown), 3 * len(shown)))
        ready = {key: sp.block_diag([symmetric(T.T @ A @ T), empty], "csr") for key, A in matrices.items()}
        inside = np.vstack((points, source.coordinates[shown]))
        xyz = inside @ turn.T + place
        _refuse_loose(part.name, ready["K"], xyz[node[:m]], component[:m])
        if m == TOL.frame_dofs:
            # One frame moves the part as a whole: what stiffness it seems to have is round-off.
            free = sp.diags_array((np.arange(ready["K"].shape[0]) >= m).astype(float))
            ready["K"] = sp.csr_array(free @ ready["K"] @ free)
        shown_nodes = np.arange(len(inside) - len(shown), len(inside))
        return cls(
            name=part.name,
            matrices=ready,
            xyz=xyz,
            node=np.concatenate([node, np.repeat(shown_nodes, 3)]),
            component=np.concatenate([component, np.tile([0, 1, 2], len(shown_nodes))]),
            sets={name: np.array([k for k, key in enumerate(keys) if key[0] == name]) for name in source.interfaces},
            basis=(turn @ basis).reshape(-1, n),
            body=body,
            turn=turn,
            place=place,
            coordinates=T,
            inputs=m,
            shown=source.node_ids[shown],
        )


def rotation_matrix(part: Substructure) -> Floats:
    """The rotation (3, 3) of ``part``, made orthogonal.

    Raises:
        InputError: one that is not, or a position that is none.
    """
    try:
        R, place = (np.asarray(value, dtype=float) for value in (part.rotation, part.position))
    except (TypeError, ValueError):
        raise InputError(f"part {part.name!r}: position or rotation are no numbers") from None
    if place.shape != (3,) or not np.isfinite(place).all() or not np.isfinite(R).all():
        raise InputError(
            f"part {part.name!r}: position = {place.tolist()} was given; expected three finite numbers",
            keyword="position",
        )
    if R.shape != (3, 3) or not np.allclose(R.T @ R, np.eye(3), atol=TOL.rotation_error) or np.linalg.det(R) < 0:
        raise InputError(
            f"part {part.name!r}: rotation is no rotation matrix (3, 3); expected R'R = 1 and det R = 1",
            keyword="rotation",
        )
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)


def _refuse(name: str, source: StoredBodies, body: Body) -> None:
    """Refuse bodies that cannot be coupled."""
    if not source.interfaces:
        raise InputError(f"part {name!r}: body {body.name!r} has no interfaces to couple; reduce it with some")
    if not np.array_equal(body.output_matrix, body.input_matrix.T):
        raise InputError(
            f"part {name!r}: body {body.name!r} comes from a two-sided reduction; take a one-sided method",
            kind="unsupported",
        )
    if not body.symmetric:
        raise InputError(f"part {name!r}: body {body.name!r} has gyroscopic or circulatory terms; couple full models")
    if (source.input_component == Component.SCALAR).any():
        raise InputError(
            f"part {name!r}: its interfaces have generalised forces, which have no place; leave them out",
            kind="unsupported",
        )
    if float(body.recipe.get(STRUCTURAL, 0.0)):
        raise InputError(
            f"part {name!r}: body {body.name!r} has structural damping; reduce the parts without it and give [damping] "
            "structural to the assembly",
            kind="unsupported",
            keyword="damping",
        )


def _refuse_loose(name: str, K: sp.csr_array, points: Floats, component: Ints) -> None:
    """Refuse a body whose rigid motion its interfaces do not tell: it would strain it."""
    m = len(component)
    R = rigid_motion(points - points.mean(axis=0), component)
    force, size = K[:, :m] @ R, abs(K[:, :m]) @ np.abs(R)
    level = TOL.rigid_strain * size.max(axis=0) + TOL.rigid_force * np.abs(K.data).max(initial=0.0) * np.abs(R).max(
        axis=0
    )
    if np.linalg.matrix_rank(R) < 6 or (np.abs(force) > level).any():
        raise InputError(
            f"part {name!r}: its interfaces do not determine its rigid motion, or the part is held; take a free part "
            "and interfaces with rotations or three nodes",
            kind="model",
        )


def _turn(T: Floats, rows: Ints, component: Sequence[int], turn: Floats, name: str) -> None:
    """Columns of T (n, n) for the dofs ``rows`` of a node along the axes of the assembly, in place."""
    for group in ((0, 1, 2), (3, 4, 5)):
        own = [row for row, c in zip(rows.tolist(), component, strict=True) if c in group]
        if len(own) == 3:
            T[:, own] = T[:, own] @ turn.T
        elif own and not np.array_equal(turn, np.eye(3)):
            raise InputError(f"part {name!r} is turned, and has an interface of one or two components; give three")
