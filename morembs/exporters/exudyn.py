"""Exudyn (Gerstmayr 2023): the reduced file that ObjectFFRFreducedOrderInterface().LoadFromFile reads.

Names and signs are those of Zwoelfer and Gerstmayr (2020), with ~ the skew matrix of a vector. Read with Exudyn 1.13.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError, nearest
from morembs.base.limits import Positive
from morembs.base.optional import optional
from morembs.base.types import Floats, Ints
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.body.stored import StoredBodies
from morembs.body.stored_check import check_grid
from morembs.body.vtkhdf_series import read_grid
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.real_time import RealTime, certificate_note, gyration, price_note, slide_note
from morembs.exporters.slow_frame import SplitFrame
from morembs.exporters.tolerances import TOL
from morembs.fem import ElementBlock, Mesh, Nodes, skew
from morembs.fem.elements import FACES, TYPES
from morembs.fem.interface import Interface
from morembs.fem.interface.nodes import condition_of
from morembs.fem.surface import outer_faces
from morembs.fem.tolerances import TOL as FEM
from morembs.storage.writer import writing

_SPAN = (
    "Exudyn computes the rotation of a marker from three or more nodes that do not lie on one line; reduce again with "
    'the nodes of the face, such as nodes = "set:NAME", and coupling = "average"'
)


class FrameNode:
    """Coordinates of the frame, Exudyn's NodeRigidBodyEP (its manual, items): positions, then Euler parameters."""

    POSITIONS = 3
    EULER_PARAMETERS = 4
    ALL = POSITIONS + EULER_PARAMETERS


class MarkerNodes(NamedTuple):
    """Arguments of Exudyn's MarkerSuperElementRigid: ``numbers`` (ns,) meshNodeNumbers from 0, ``weights`` (ns,)
    weightingFactors with the sum 1, ``offset`` (3,) m from their mean to the point of the interface."""

    numbers: Ints
    weights: Floats
    offset: Floats


@dataclass(frozen=True, kw_only=True)
class Exudyn(Exporter):
    """File ``.exudyn.hdf5`` with the shapes at all stored nodes; ``triangles`` puts the skin in it to be drawn.

    Modes that a ``time_step`` in s does not resolve give way to shapes with their compliance at the interfaces, which
    vibrate as fast as it resolves.
    """

    name: ClassVar[str] = "exudyn"
    suffix: ClassVar[str] = ".exudyn.hdf5"
    about: ClassVar[str] = "Exudyn, ObjectFFRFreducedOrder"

    triangles: bool = True
    time_step: Positive | None = None

    def _write(self, context: ExportContext) -> Exported:
        if context.path.suffix != ".hdf5":
            raise InputError(
                f"{context.path} was given; Exudyn opens only names that end in .hdf5, choose such a name",
                keyword="out",
            )
        if not len(context.source.coordinates):
            raise InputError(f"{context.file or 'the body file'} holds no nodes; Exudyn attaches markers to nodes")
        faces = (
            _triangles(context.file, len(context.source.coordinates))
            if self.triangles and context.file is not None
            else np.zeros((0, 3), dtype=np.int64)
        )
        notes: tuple[str, ...] = ()
        if self.time_step is not None:
            run, found = for_time_step(context, self.time_step)
            context = replace(context, body=replace(context.body, floating=run))
            notes = (*found.notes, *slide_note(found, run.count), *certificate_note(context.body))
        with writing(context.path, sealed=False) as out:
            if self.time_step is not None:
                out.file.attrs["time_step"], out.file.attrs["real_time"] = self.time_step, list(notes)
            for name, value in _values(context, faces).items():
                out.name_step(name)
                _put(out.file, name, value)
                out.check()
            out.name_step("modeBasis")
            _put_shapes(out.file, context)
        if self.time_step is not None:
            notes += price_note(_seconds_of_step(context.path, self.time_step), self.time_step)
        drawn = bool(len(faces)) or not self.triangles
        return Exported(paths=(context.path,), notes=(*notes, *_notes(context, self.time_step, drawn=drawn)))

    def truncate(self, context: ExportContext, step: float) -> RealTime:
        return for_time_step(context, step)[1]

    def step_error(self, context: ExportContext, angle: float) -> float:
        # Newmark's steps, which those of Exudyn are without numerical damping: 2 / h atan(w h / 2).
        return float(1 - 2 * np.arctan(angle / 2) / angle)


def for_time_step(context: ExportContext, step: float) -> tuple[FloatingFrame, RealTime]:
    """The floating frame that the file has for a time ``step`` in s, and its errors.

    Raises:
        InputError: the body has no interface frames.
    """
    context.markers("a time step")
    split = SplitFrame.of(context.frame, step)
    run, stand_in = split.with_static_shapes(gyration(context.source))
    return run, split.measure(context.source, stand_in)


def _seconds_of_step(path: Path, step: float) -> float | None:
    """Processor time in s of one step of the free body, the mean of ``timed_steps``; None where Exudyn is not
    installed."""
    try:
        exu, fem = (optional(name, "the price of a step") for name in ("exudyn", "exudyn.FEM"))
    except InputError:
        return None
    cms = fem.ObjectFFRFreducedOrderInterface()
    cms.LoadFromFile(str(path))
    mbs = exu.SystemContainer().AddSystem()
    cms.AddObjectFFRFreducedOrder(mbs)
    mbs.Assemble()
    settings = exu.SimulationSettings()
    run = settings.timeIntegration
    run.numberOfSteps, run.endTime, run.verboseMode = TOL.timed_steps, TOL.timed_steps * step, 0
    run.newton.useModifiedNewton = True
    settings.solution.file.write = False
    start = time.process_time()
    mbs.SolveDynamic(settings)
    return (time.process_time() - start) / TOL.timed_steps


def exudyn_marker(source: StoredBodies, name: str) -> MarkerNodes:
    """Nodes, weights and offset that make Exudyn follow the interface ``name``.

    Exudyn takes the weighted mean of the nodes, as an average interface does; a rigid one has equal weights.

    Raises:
        InputError: no such interface, nodes that the file does not hold, or that span no plane.
    """
    if name not in source.interfaces:
        raise InputError(f"there is no interface {name!r}; {nearest(name, source.interfaces)}", kind="unknown")
    interface = source.interfaces[name]
    row = {label: at for at, label in enumerate(source.node_ids.tolist())}
    missing = [label for label in interface.node_ids.tolist() if label not in row]
    if missing:
        raise InputError(f"the file lacks node {missing[0]} of the interface {name!r}; write it again", kind="file")
    numbers = np.array([row[label] for label in interface.node_ids.tolist()], dtype=np.int64)
    weights = _weights(interface)
    if not _follows_rotations(source, interface):
        raise InputError(f"no Exudyn marker can follow the interface {name!r}: {_SPAN}", kind="unsupported")
    used = weights != 0
    numbers, weights = numbers[used], weights[used] / weights.sum()
    return MarkerNodes(numbers, weights, interface.point - weights @ source.coordinates[numbers])


def _follows_rotations(source: StoredBodies, interface: Interface) -> bool:
    """True unless the nodes of an interface lie on a line, or are one reference node."""
    if not len(interface.nodes):
        return False
    xyz, weights = source.coordinates[interface.nodes], _weights(interface)
    arms = xyz - weights @ xyz / weights.sum()
    return condition_of(arms, weights) < FEM.collinear_condition


def _weights(interface: Interface) -> Floats:
    return interface.weights if interface.kind.weighted else np.ones(len(interface.nodes))


def _values(context: ExportContext, faces: Ints) -> Mapping[str, Any]:
    """All but the mode basis, by Exudyn's names."""
    frame = context.frame
    terms = _terms(frame.integrals)
    m, n = frame.count, len(context.source.coordinates)
    turning = FrameNode.POSITIONS, FrameNode.EULER_PARAMETERS
    return {
        "fileVersion": 1,
        "type": "ObjectFFRFreducedOrderInterface",
        "rigidBodyNodeType": "NodeType.RotationEulerParameters",
        "infoList": np.array([m, n, *turning, FrameNode.ALL, FrameNode.ALL + m], dtype=np.int64),
        "xRef": context.coordinates.ravel(),
        "trigList": faces if len(faces) else [],
        "postProcessingModes": {},
        "massMatrixReduced": frame.integrals.Me,
        "stiffnessMatrixReduced": frame.Ke,
        **terms,
    }


def _terms(integrals: ShapeIntegrals) -> dict[str, float | Floats]:
    """Integrals (psi for the shapes, x for the positions), one column or row for each shape and axis."""
    n = integrals.count
    return {
        "totalMass": float(integrals.mass),
        "Mtt": integrals.mass * np.eye(3),
        "chiU": integrals.center,
        "chiUtilde": skew(integrals.center),
        "inertiaLocal": integrals.inertia,
        "mPhitTPsi": integrals.Ct.T,
        "mPhitTPsiTilde": np.hstack(list(skew(integrals.Ct))),
        "mXRefTildePsi": -integrals.Cr.T,
        "mXRefTildePsiTilde": -np.hstack(list(integrals.C4)),
        "mPsiTildePsi": -integrals.Cr1.transpose(1, 2, 0).reshape(3 * n, n),
        "mPsiTildePsiTilde": -integrals.C6.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n),
    }


def _put(file: Any, name: str, value: Any) -> None:
    """One object with the attribute ``datatype`` that Exudyn wants of each."""
    if isinstance(value, np.ndarray):
        item, kind = file.create_dataset(name, data=np.ascontiguousarray(value)), "ndarray"
    elif isinstance(value, list | dict):
        item, kind = file.create_group(name), type(value).__name__
    else:
        item, kind = file.create_dataset(name, data=value), type(value).__name__
    item.attrs["datatype"] = kind


def _put_shapes(file: Any, context: ExportContext) -> None:
    rows, count = 3 * len(context.source.coordinates), context.frame.count
    data = file.create_dataset("modeBasis", (rows, count), np.float64)
    data.attrs["datatype"] = "ndarray"
    step = max(1, TOL.exudyn_block_bytes // (8 * rows))
    for start in range(0, count, step):
        block = slice(start, min(start + step, count))
        data[:, block] = context.shapes(block)


def _triangles(path: Path, count: int) -> Ints:
    """Outer faces (t, 3) of the mesh in the body file, rows of its nodes; faces with mid-nodes are split at them."""
    grid = read_grid(path)
    check_grid(path, count, grid.points, grid.connectivity, grid.offsets, grid.types)
    known = {element.vtk for element in (*TYPES.values(), *FACES.values())}
    cells = {
        vtk: _cells(grid.types == vtk, grid.offsets, grid.connectivity)
        for vtk in np.unique(grid.types).tolist()
        if vtk in known
    }
    flat = {kind: cells[face.vtk] for kind, face in FACES.items() if face.vtk in cells}
    blocks = tuple(
        ElementBlock(type=kind, nodes=cells[solid.vtk], ids=np.arange(1, len(cells[solid.vtk]) + 1))
        for kind, solid in TYPES.items()
        if solid.vtk in cells
    )
    outer = list(flat.items())
    if blocks:
        nodes = Nodes(ids=np.arange(1, count + 1), xyz=np.zeros((count, 3)))
        outer += list(outer_faces(Mesh(nodes=nodes, blocks=blocks)).items())
    split = [faces[:, _SPLIT[kind]].reshape(-1, 3) for kind, faces in outer if len(faces)]
    return np.concatenate([np.zeros((0, 3), dtype=np.int64), *split])


# Triangles of each face, in its local nodes; corners first, then mid-nodes, then the centre.
_SPLIT = {
    "tri3": [(0, 1, 2)],
    "tri6": [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    "quad4": [(0, 1, 2), (0, 2, 3)],
    "quad8": [(0, 4, 7), (4, 1, 5), (5, 2, 6), (6, 3, 7), (4, 5, 6), (4, 6, 7)],
    "quad9": [(a, b, 8) for a, b in ((0, 4), (4, 1), (1, 5), (5, 2), (2, 6), (6, 3), (3, 7), (7, 0))],
}


def _cells(chosen: NDArray[np.bool_], offsets: Ints, links: Ints) -> Ints:
    """Connectivity (nc, k) of the chosen cells, which are of one type."""
    first = offsets[:-1][chosen]
    size = int(offsets[1:][chosen][0] - first[0])
    return np.asarray(links[first[:, None] + np.arange(size)])


def _notes(context: ExportContext, step: float | None, *, drawn: bool) -> tuple[str, ...]:
    frame, notes = context.frame, []
    if np.any(frame.De):
        De = "body.floating.De" if step is None else f"ExudynBody.of(FILE, time_step={step:g}).floating.De"
        notes.append(
            f"its damping matrix is given by hand: after AddObjectFFRFreducedOrder set {De} with "
            "mbs.SetObjectParameter(object, 'dampingMatrixReduced', MatrixContainer)"
        )
    if not drawn:
        notes.append("the stored nodes have no faces between them, so the body cannot be drawn")
    if frame.origin.any():
        place = ", ".join(f"{value:.9g}" for value in frame.origin)
        notes.append(f"node positions count from the origin of the floating frame, ({place}) m in the model")
    if context.source.interfaces:
        notes.append(
            "morembs.exporters.exudyn_system puts the body into a system with joints at its interfaces "
            "(docs/howto/recipes.md); nodes, weights and offset of their markers: "
            "morembs.exporters.exudyn.exudyn_marker"
        )
        source = context.source
        still = [
            name
            for name, each in source.interfaces.items()
            if (each.nodes >= 0).all() and not _follows_rotations(source, each)
        ]
        if still:
            notes.append(f"no Exudyn marker can follow {', '.join(map(repr, still))}: {_SPAN}")
    return (*notes, *frame.notes)


__all__ = ["Exudyn", "MarkerNodes", "exudyn_marker"]
