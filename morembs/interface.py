"""Interfaces: where other bodies touch the part, and how its nodes follow a frame.

Three couplings of slave nodes s to a frame at the point c with motion z = (translation, rotation):

* rigid (RBE2): u_s = R_s z; the slave dofs (rotations too) are eliminated, six dofs of the frame replace them;
* average (RBE3): z = T u, T = (R_s' W R_s)^-1 R_s' W; adds no stiffness, forces spread with the weights W;
* direct: the dofs of the nodes themselves, displacements and, where there are any, rotations.

Rigid elements that came with the model are eliminated here too.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError, nearest
from morembs.model import FEModel, frozen, rigid_motion, skew
from morembs.model.constraints import DependentDofs
from morembs.model.fe_model import refuse_complex, refuse_unsymmetric
from morembs.model.surface import nodal_areas, outer_faces

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
COUPLINGS = ("rigid", "average", "direct")
# What other programs call them.
SAME_COUPLING = {
    "rbe2": "rigid", "kinematic": "rigid", "mpc": "rigid", "rbe3": "average", "distributing": "average",
    "mean": "average", "nodes": "direct", "none": "direct",
}  # fmt: skip
# Scaled condition of R_s' W R_s above which the slave nodes count as collinear.
COLLINEAR = 1e8
# Model lengths from the nodes beyond which a frame's point is a mistake.
FAR = 1000.0
log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class Interface:
    """Named interface of a model.

    ``nodes`` (ns,) rows of ``Nodes.xyz``; ``point`` (3,) origin of the frame in m; ``axes`` (3, 3) its
    axes as rows (those of the model); ``weights`` (ns,) areas in m2 where the nodes carry whole faces,
    else ones; ``components`` the motions 0..5 (translations, rotations) that are exposed.
    """

    name: str
    nodes: Ints
    coupling: str
    point: Floats
    weights: Floats
    axes: Floats = field(default_factory=lambda: np.eye(3))
    components: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def __post_init__(self) -> None:
        for name in ("nodes", "point", "weights", "axes"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name))))


def make_interface(
    model: FEModel, *, name: str, nodes: Ints, coupling: str = "rigid",
    point: Sequence[float] | None = None, components: Sequence[int] | None = None,
) -> Interface:  # fmt: skip
    """Interface with checked nodes, area-consistent weights and, if not given, the centroid as point.

    Args:
        nodes: rows of ``model.nodes`` (see ``select_nodes``).
        point: in m.
        components: exposed motions; by default all six, or for "direct" all that every node has.

    Raises:
        InputError: unknown coupling, no nodes, components that a node lacks, or collinear nodes under a rigid or
            average coupling; a text, labels or other numbers in place of rows.
    """
    if coupling not in COUPLINGS:
        meant = SAME_COUPLING.get(str(coupling).lower(), str(coupling).lower())
        raise InputError(f"interface {name!r}: coupling = {coupling!r} was given; {nearest(meant, COUPLINGS)}")
    rows = np.unique(_rows(model, name, nodes))
    if not len(rows):
        raise InputError(f"interface {name!r} has no nodes")
    there = _common_components(model, name, rows) if coupling == "direct" else tuple(range(6))
    chosen = there if components is None else tuple(sorted(set(components)))
    if not chosen or not set(chosen) <= set(there):
        known = f"0..{there[-1]}" if there == tuple(range(len(there))) else ", ".join(map(str, there))
        raise InputError(
            f"interface {name!r}: components = {list(components or [])} was given; expected some of {known}"
        )
    weights, bare = _area_weights(model, rows)
    xyz = model.nodes.xyz[rows]
    origin = weights @ xyz / weights.sum() if point is None else np.asarray(point, dtype=float)
    extent = float(np.linalg.norm(np.ptp(model.nodes.xyz, axis=0)))
    if not np.linalg.norm(origin - xyz.mean(axis=0)) <= FAR * max(extent, np.finfo(float).tiny):
        raise InputError(
            f"interface {name!r}: its point {origin.tolist()} m lies more than {FAR:g} lengths of the model away from "
            "its nodes; check the point and the units"
        )
    if coupling == "average" and bare:
        log.warning(
            "interface %s: %d of %d nodes carry no whole face of the selection and get no weight", name, bare, len(rows)
        )
    interface = Interface(name=name, nodes=rows, coupling=coupling, point=origin, weights=weights, components=chosen)
    if coupling != "direct":
        refuse_collinear(interface, model)
    return interface


def _rows(model: FEModel, name: str, nodes: Ints) -> Ints:
    """``nodes`` as rows of ``model.nodes``."""
    if isinstance(nodes, str):
        raise InputError(
            f"interface {name!r}: nodes = {nodes!r} was given; expected rows of the nodes, "
            f"select_nodes(model, {nodes!r}) gives them"
        )
    rows, count = np.asarray(nodes), len(model.nodes)
    if rows.dtype.kind not in "iu" and rows.size:
        raise InputError(f"interface {name!r}: nodes holds {rows.dtype}; expected rows of the nodes, see select_nodes")
    if rows.size and not (rows.min() >= 0 and rows.max() < count):
        bad = rows[(rows < 0) | (rows >= count)][0]
        raise InputError(
            f"interface {name!r}: nodes holds the row {bad}, and the model has {count}; labels are turned into rows "
            f'by select_nodes(model, "ids:{bad}")'
        )
    return rows.astype(np.int64)


def _common_components(model: FEModel, name: str, rows: Ints) -> tuple[int, ...]:
    """Components that all nodes ``rows`` have."""
    here = np.isin(model.dofs.node, rows)
    count = np.bincount(model.dofs.component[here], minlength=6)
    common = tuple(np.flatnonzero(count == len(rows)).tolist())
    if not common:
        raise InputError(f"interface {name!r}: its nodes have no dof in common; take other nodes")
    return common


def _area_weights(model: FEModel, rows: Ints) -> tuple[Floats, int]:
    """Areas (ns,) in m2 of the whole faces between the nodes, and how many nodes lie on none of these.

    Ones, and no such nodes, where there are no faces at all.
    """
    if model.mesh is not None:
        faces = outer_faces(model.mesh, within=rows)
        areas = nodal_areas(model.nodes.xyz, faces)[rows]
        if areas.sum() > 0:
            on_face = np.isin(rows, np.concatenate([nodes.ravel() for nodes in faces.values()]))
            return areas, int((~on_face).sum())
    return np.ones(len(rows)), 0


def refuse_collinear(interface: Interface, model: FEModel) -> None:
    """Refuse nodes that do not determine the rotations of their frame.

    Raises:
        InputError: as said.
    """
    xyz = model.nodes.xyz[interface.nodes]
    arms = xyz - xyz.mean(axis=0)
    length = np.linalg.norm(arms, axis=1).max()
    condition = np.inf
    turning = model.dofs.component[np.isin(model.dofs.node, interface.nodes)] > 2
    if interface.coupling == "rigid" and turning.any():
        # Nodes that turn with the frame determine it alone.
        dofs = _all_dofs(model, interface)
        at = np.searchsorted(interface.nodes, model.dofs.node[dofs])
        R = rigid_motion(arms[at] / max(length, np.finfo(float).tiny), model.dofs.component[dofs])
        condition = float(np.linalg.cond(R.T @ R / len(R)))
    elif length > 0:
        # Rotations about the centroid, the arms scaled to one, weights as coupled.
        R = _frame_motion(arms / length, np.zeros(3))
        w = interface.weights if interface.coupling == "average" else np.ones(len(arms))
        condition = float(np.linalg.cond(R.T @ (np.repeat(w / np.abs(w).sum(), 3)[:, None] * R)))
    if not condition < COLLINEAR:
        raise InputError(
            f"interface {interface.name!r}: its {len(xyz)} nodes lie on a line or in a point; "
            f"{interface.coupling} coupling needs at least three nodes that span a plane "
            '(take more nodes, or coupling = "direct")'
        )


def _frame_motion(xyz: Floats, point: Floats) -> Floats:
    """R_s (3 ns, 6): displacements of nodes under the motion of a frame at ``point``."""
    component = np.tile(np.arange(3), len(xyz))
    return rigid_motion(np.repeat(xyz - point, 3, axis=0), component)


def averaging(interface: Interface, xyz: Floats) -> Floats:
    """T (6, 3 ns) of the average coupling for slave coordinates ``xyz`` (ns, 3): z = T u_s."""
    w = interface.weights / interface.weights.sum()
    # About the centroid, where translations and rotations separate, then carried to the point.
    center = w @ xyz
    arms = xyz - center
    length = float(np.linalg.norm(arms, axis=1).max())
    scale = np.array([1.0, 1.0, 1.0, length, length, length])
    R = _frame_motion(xyz, center) / scale
    WR = np.repeat(w, 3)[:, None] * R
    carry = np.eye(6)
    carry[:3, 3:] = -skew(interface.point - center)
    return np.asarray(carry @ (np.linalg.solve(R.T @ WR, WR.T) / scale[:, None]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """All interfaces of a model as matrices.

    ``T`` (N, Nc) FE dofs from coupled dofs (FE dofs without dependent ones, then six per rigid frame);
    ``B`` (Nc, m) inputs, one column per exposed interface motion, and also outputs as ``B'``;
    ``R`` (Nc, 6) geometric rigid-body modes with rotations about ``pole`` (3,), a point amid the nodes, so
    that a body far from the origin loses no digits; ``columns`` interface name -> its columns of B.
    ``frames`` (Nc, 6 k) as B, with all six motions of every rigid and average interface, whatever it exposes;
    ``frame_columns`` interface name -> its columns of that.
    """

    T: sp.csr_array
    B: sp.csc_array
    R: Floats
    pole: Floats
    columns: dict[str, slice]
    frames: sp.csc_array
    frame_columns: dict[str, slice]


def couple(model: FEModel, interfaces: Sequence[Interface]) -> Coupling:
    """Matrices of all interfaces.

    Raises:
        InputError: two interfaces of one name, rigid or direct interfaces that share nodes, or one on nodes that
            follow a rigid element of the model; complex matrices, or K and M that are not symmetric.
    """
    refuse_complex(model)
    refuse_unsymmetric(model)
    _refuse_shared(model, interfaces)
    dependent = model.dependent
    rigid = [i for i in interfaces if i.coupling == "rigid" and len(i.nodes) > 1]
    slave = np.zeros(model.size, dtype=bool)
    for interface in interfaces:
        if dependent is not None and interface.coupling != "average":
            _refuse_dependent(model, dependent, interface)
    for interface in rigid:
        slave[_all_dofs(model, interface)] = True
    if dependent is not None:
        slave |= dependent.owner >= 0
    kept = np.flatnonzero(~slave)
    size = len(kept) + 6 * len(rigid)
    rows, cols, values = [kept], [np.arange(len(kept))], [np.ones(len(kept))]
    masters: dict[str, int] = {}
    for number, interface in enumerate(rigid):
        masters[interface.name] = len(kept) + 6 * number
        dofs = _all_dofs(model, interface)
        motion = rigid_motion(model.nodes.xyz[model.dofs.node[dofs]] - interface.point, model.dofs.component[dofs])
        rows.append(np.repeat(dofs, 6))
        cols.append(np.tile(masters[interface.name] + np.arange(6), len(dofs)))
        values.append(motion.ravel())
    data = (np.concatenate(values), (np.concatenate(rows), np.concatenate(cols)))
    T = sp.csr_array(sp.coo_array(data, shape=(model.size, size)))
    if dependent is not None:
        T = sp.csr_array(dependent.S @ T)
    T.eliminate_zeros()
    pole = model.nodes.xyz.mean(axis=0)
    R_fe = rigid_motion(model.nodes.xyz[model.dofs.node] - pole, model.dofs.component)
    R = np.zeros((size, 6))
    R[: len(kept)] = R_fe[kept]
    for interface in rigid:
        at = masters[interface.name]
        R[at : at + 6] = rigid_motion(np.tile(interface.point - pole, (6, 1)), np.arange(6))
    B, columns = _inputs(model, interfaces, T, masters)
    framed = [replace(i, components=tuple(range(6))) for i in interfaces if i.coupling != "direct"]
    frames, frame_columns = _inputs(model, framed, T, masters)
    return Coupling(T=T, B=B, R=R, pole=pole, columns=columns, frames=frames, frame_columns=frame_columns)


def _inputs(
    model: FEModel, interfaces: Sequence[Interface], T: sp.csr_array, masters: dict[str, int]
) -> tuple[sp.csc_array, dict[str, slice]]:
    blocks, columns, at = [], {}, 0
    for interface in interfaces:
        wanted = list(interface.components)
        if interface.name in masters:
            rows = masters[interface.name] + np.array(wanted)
            data = (np.ones(len(rows)), (rows, np.arange(len(rows))))
            block = sp.csc_array(data, shape=(T.shape[1], len(rows)))
        else:
            if interface.coupling == "direct":
                dofs = _direct_dofs(model, interface)
                data = (np.ones(len(dofs)), (dofs, np.arange(len(dofs))))
                on_fe = sp.csc_array(data, shape=(T.shape[0], len(dofs)))
            elif interface.coupling == "rigid":
                dofs, motion = _turning_node(model, interface)
                places = np.tile(dofs, len(wanted)), np.repeat(np.arange(len(wanted)), len(dofs))
                on_fe = sp.csc_array((motion[wanted].ravel(), places), shape=(T.shape[0], len(wanted)))
            else:
                dofs = _displacement_dofs(model, interface)
                average = averaging(interface, model.nodes.xyz[interface.nodes])[wanted]
                at_rows, at_cols = np.tile(dofs, len(wanted)), np.repeat(np.arange(len(wanted)), len(dofs))
                on_fe = sp.csc_array((average.ravel(), (at_rows, at_cols)), shape=(T.shape[0], len(wanted)))
            block = sp.csc_array(T.T @ on_fe)
        columns[interface.name] = slice(at, at + block.shape[1])
        at += block.shape[1]
        blocks.append(block)
    return (sp.csc_array(sp.hstack(blocks)) if blocks else sp.csc_array((T.shape[1], 0))), columns


def _displacement_dofs(model: FEModel, interface: Interface) -> Ints:
    """Dofs (3 ns,) x, y, z of the interface's nodes."""
    dofs = model.dofs.of_nodes(interface.nodes)
    if (dofs < 0).any():
        bare = interface.nodes[(dofs < 0).any(axis=1)][0]
        raise InputError(
            f"interface {interface.name!r}: node {model.nodes.ids[bare]} has no dof for each of x, y and z; "
            "take other nodes"
        )
    return dofs.ravel()


def _all_dofs(model: FEModel, interface: Interface) -> Ints:
    """All dofs of the interface's nodes, rotations too; every node must have x, y and z."""
    displacements = _displacement_dofs(model, interface)
    if model.dofs.component.max(initial=0) < 3:
        return displacements
    return np.flatnonzero(np.isin(model.dofs.node, interface.nodes))


def _turning_node(model: FEModel, interface: Interface) -> tuple[Ints, Floats]:
    """The six dofs of the one node of a rigid interface, and the frame's motion (6, 6) = R^-1 from them.

    Such a node keeps its dofs: the frame is the node itself, seen from another point.
    """
    dofs = _all_dofs(model, interface)
    dofs = dofs[np.argsort(model.dofs.component[dofs])]
    away = interface.point - model.nodes.xyz[interface.nodes[0]]
    return dofs, rigid_motion(np.tile(away, (6, 1)), np.arange(6))


def _direct_dofs(model: FEModel, interface: Interface) -> Ints:
    """The dofs of the interface's components, node after node."""
    table = np.full((len(model.nodes), 6), -1, dtype=np.int64)
    table[model.dofs.node, model.dofs.component] = np.arange(model.size)
    dofs = table[interface.nodes][:, list(interface.components)]
    if (dofs < 0).any():
        node, component = np.argwhere(dofs < 0)[0]
        raise InputError(
            f"interface {interface.name!r}: node {model.nodes.ids[interface.nodes[node]]} has no dof for the component "
            f"{interface.components[component]}; take other nodes or components"
        )
    return dofs.ravel()


def _refuse_dependent(model: FEModel, dependent: DependentDofs, interface: Interface) -> None:
    dofs = np.flatnonzero(np.isin(model.dofs.node, interface.nodes))
    bad = dofs[dependent.owner[dofs] >= 0]
    if len(bad):
        name = dependent.names[dependent.owner[bad[0]]]
        raise InputError(
            f"interface {interface.name!r}: node {model.nodes.ids[model.dofs.node[bad[0]]]} follows the element "
            f'{name!r} of the model; take nodes = "coupling:{name}", other nodes, or coupling = "average"'
        )


def _refuse_shared(model: FEModel, interfaces: Sequence[Interface]) -> None:
    owner: dict[int, Interface] = {}
    names: set[str] = set()
    for interface in interfaces:
        if interface.name in names:
            raise InputError(f"two interfaces are named {interface.name!r}; give each its own name")
        names.add(interface.name)
        if interface.coupling == "average":
            continue
        for row in interface.nodes.tolist():
            if row in owner:
                other = owner[row]
                raise InputError(
                    f"the {other.coupling} interface {other.name!r} and the {interface.coupling} interface "
                    f"{interface.name!r} share node {model.nodes.ids[row]}; a node can belong to one of them only "
                    '(leave it out of one, or take coupling = "average")'
                )
            owner[row] = interface
