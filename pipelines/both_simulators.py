"""What the pipelines with two simulators share: the mesh of a bar, the job, Exudyn's side, the picture.

morembs.multibody runs everywhere. Exudyn is the other, independent simulator: it reads the body from the file that
`morembs.exporters` writes. Where Exudyn is not installed, the pipelines say so and show one simulator alone.
"""

from __future__ import annotations

import argparse
import importlib
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from morembs.body.file import read_body
from morembs.body.stored import StoredBodies, StoredBody
from morembs.exporters import export_body
from morembs.exporters.exudyn import exudyn_marker
from morembs.jobs.job import load_job
from morembs.jobs.picture import save
from morembs.jobs.run import run_job

HERE = Path(__file__).resolve().parent
Floats = NDArray[np.float64]
OURS, THEIRS, THIRD = "#d1495b", "#2e86ab", "#3d9970"
# Corners of a hexahedron, then the pairs of corners whose middles are its other nodes.
_CORNERS = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 2], [2, 0, 2], [2, 2, 2], [0, 2, 2]])
_EDGES = ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))


# ---------------------------------------------------------------------------------------------------------
# Mesh and body


def write_bar(path: Path, size: Sequence[float], cells: Sequence[int]) -> None:
    """Writes a bar along x of ``cells`` hexahedra of twenty nodes; its left end is centred at the origin."""
    shape = 2 * np.asarray(cells) + 1
    local = np.vstack([_CORNERS, [(_CORNERS[a] + _CORNERS[b]) // 2 for a, b in _EDGES]])
    first = 2 * np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 1, 3)
    numbers = np.ravel_multi_index(np.moveaxis(first + local, -1, 0), tuple(shape))
    used, connectivity = np.unique(numbers, return_inverse=True)
    steps = np.stack(np.unravel_index(used, tuple(shape)), axis=1)
    points = steps / (shape - 1) * np.asarray(size) - [0, size[1] / 2, size[2] / 2]
    meshio.Mesh(points, [("hexahedron20", connectivity.reshape(numbers.shape))]).write(path, file_format="gmsh")


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """A reduced body: the body file as it is read back, its one body, and the file for Exudyn."""

    source: StoredBodies
    body: StoredBody
    exudyn_file: Path


def make_body(folder: Path, name: str, size: Sequence[float], cells: Sequence[int]) -> Made:
    """Runs the job ``name``.toml in ``folder`` on the mesh of a bar, and exports the body to Exudyn."""
    folder.mkdir(parents=True, exist_ok=True)
    toml = folder / f"{name}.toml"
    if folder.resolve() != HERE:
        shutil.copyfile(HERE / toml.name, toml)
    job = load_job(toml)
    write_bar(job.resolve(job.tables.model.mesh), size, cells)
    run_job(job)
    source = read_body(job.output)
    (body,) = source.bodies.values()
    return Made(source=source, body=body, exudyn_file=export_body(job.output, "exudyn").paths[0])


def shapes(made: Made) -> Floats:
    """Displacements (n, 3, k) of the stored nodes for each elastic coordinate in the floating frame."""
    moved = made.body.basis() @ made.body.floating.elastic
    return np.asarray(moved.reshape(len(made.source.coordinates), 3, -1))


def mass_weights(made: Made) -> Floats:
    """(n,) weights of the stored nodes whose mean is the centre of mass of the body, however it deforms.

    The smallest that give the integrals of the consistent mass. Raises RuntimeError where the nodes are too few.
    """
    frame, its = made.body.floating, made.body.floating.integrals
    rows = [np.ones((1, len(made.source.coordinates))), (made.source.coordinates - frame.origin).T]
    phi = shapes(made).transpose(1, 2, 0).reshape(-1, len(made.source.coordinates))
    scale = np.abs(phi).max()
    A = np.vstack([*rows, phi / scale])
    b = np.concatenate([[1.0], its.first / its.mass, its.Ct.T.ravel() / (scale * its.mass)])
    weights = np.linalg.lstsq(A, b, rcond=1e-12)[0]
    if np.abs(A @ weights - b).max() > 1e-9:
        raise RuntimeError('the stored nodes cannot carry the weight of the body; store more (nodes = "all")')
    return np.asarray(weights)


# ---------------------------------------------------------------------------------------------------------
# Exudyn


def exudyn_missing() -> str:
    """Why Exudyn cannot run here; "" where it can."""
    try:
        importlib.import_module("exudyn")
    except ImportError as reason:
        return f"Exudyn is not here ({reason}); to get it: pip install exudyn. One simulator is shown alone."
    return ""


class ExudynSystem:
    """A system of Exudyn, with the few parts that the pipelines need. Points and velocities along inertial axes."""

    def __init__(self, gravity: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.exu, self.fem, self.items, self.utilities = (
            importlib.import_module(name)
            for name in ("exudyn", "exudyn.FEM", "exudyn.itemInterface", "exudyn.utilities")
        )
        self.gravity = list(gravity)
        self.container = self.exu.SystemContainer()
        self.mbs = self.container.AddSystem()
        self.ground = self.mbs.AddObject(self.items.ObjectGround())
        self._sensors: list[Any] = []

    def elastic(
        self, made: Made, *, position: ArrayLike = (0, 0, 0), rotation: ArrayLike | None = None,
        velocity: ArrayLike = (0, 0, 0), angular_velocity: ArrayLike = (0, 0, 0), elastic: Floats | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        """The elastic body with its damping, which the file cannot hold; the numbers that Exudyn gave its items."""
        cms = self.fem.ObjectFFRFreducedOrderInterface()
        cms.LoadFromFile(str(made.exudyn_file))
        parts: dict[str, Any] = cms.AddObjectFFRFreducedOrder(
            self.mbs, positionRef=list(position), initialVelocity=list(velocity),
            rotationMatrixRef=np.eye(3) if rotation is None else np.asarray(rotation),
            initialAngularVelocity=list(angular_velocity),
        )  # fmt: skip
        if any(self.gravity):
            self._weigh(parts, made)
        damping = self.exu.MatrixContainer()
        damping.SetWithDenseMatrix(made.body.floating.De, useDenseMatrix=True)
        self.mbs.SetObjectParameter(parts["oFFRFreducedOrder"], "dampingMatrixReduced", damping)
        if elastic is not None:
            self.mbs.SetNodeParameter(parts["nGenericODE2"], "initialCoordinates", list(elastic))
        return parts

    def _weigh(self, elastic: dict[str, Any], made: Made) -> None:
        """Gravity, as a force on the centre of mass that moves with the deformation.

        The mass-proportional load that AddObjectFFRFreducedOrder makes of ``gravity`` takes its moment about the frame
        at the undeformed centre of mass (Exudyn 1.13), which costs energy in swings that bend.
        """
        its, weights = made.body.floating.integrals, mass_weights(made)
        marker = self.items.MarkerSuperElementPosition(
            bodyNumber=elastic["oFFRFreducedOrder"], meshNodeNumbers=np.arange(len(weights)), weightingFactors=weights
        )
        force = list(its.mass * np.array(self.gravity))
        self.mbs.AddLoad(self.items.LoadForceVector(markerNumber=self.mbs.AddMarker(marker), loadVector=force))

    def rigid(
        self, mass: float, inertia: Sequence[float], *, position: ArrayLike, velocity: ArrayLike = (0, 0, 0),
        angular_velocity: ArrayLike = (0, 0, 0),
    ) -> dict[str, Any]:  # fmt: skip
        """A rigid body with its origin in its centre of mass and its axes along the inertial ones.

        Its coordinates are angles (about x, y, z), so that a steady turn about z is exact; Euler parameters lag behind
        by errors of the steps.
        """
        made = self.mbs.CreateRigidBody(
            referencePosition=list(position), initialVelocity=list(velocity),
            initialAngularVelocity=list(angular_velocity), gravity=self.gravity, returnDict=True,
            inertia=self.utilities.RigidBodyInertia(mass, np.diag(inertia)),
            nodeType=self.exu.NodeType.RotationRxyz,
        )  # fmt: skip
        return {"node": made["nodeNumber"], "body": made["bodyNumber"]}

    def at_ground(self, point: ArrayLike = (0, 0, 0)) -> int:
        """Marker on the ground."""
        return int(self.mbs.AddMarker(self.items.MarkerBodyRigid(bodyNumber=self.ground, localPosition=list(point))))

    def at_body(self, rigid: dict[str, Any], point: ArrayLike = (0, 0, 0)) -> int:
        """Marker on a rigid body."""
        return int(self.mbs.AddMarker(self.items.MarkerBodyRigid(bodyNumber=rigid["body"], localPosition=list(point))))

    def at_interface(self, elastic: dict[str, Any], made: Made, name: str) -> int:
        """Marker that follows an interface of the elastic body."""
        nodes = exudyn_marker(made.source, name)
        marker = self.items.MarkerSuperElementRigid(
            bodyNumber=elastic["oFFRFreducedOrder"], meshNodeNumbers=nodes.numbers, weightingFactors=nodes.weights,
            offset=nodes.offset,
        )  # fmt: skip
        return int(self.mbs.AddMarker(marker))

    def joint(self, first: int, second: int, held: Sequence[int]) -> None:
        """Joint between two markers; ``held`` says which displacements and rotations about x, y, z it holds."""
        self.mbs.AddObject(self.items.GenericJoint(markerNumbers=[first, second], constrainedAxes=list(held)))

    def drive(self, node: int, axis: int, speed: float) -> None:
        """Constant angular velocity of a rigid-body node about an axis of its own."""
        turn = self.mbs.AddMarker(self.items.MarkerNodeRotationCoordinate(nodeNumber=node, rotationCoordinate=axis))
        still = self.mbs.AddNode(self.items.NodePointGround())
        fixed = self.mbs.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=still, coordinate=0))
        self.mbs.AddObject(
            self.items.CoordinateConstraint(markerNumbers=[fixed, turn], velocityLevel=True, offset=speed)
        )

    def watch(self, marker: int) -> None:
        """Have the position of a marker recorded at every step."""
        position = self.exu.OutputVariableType.Position
        sensor = self.items.SensorMarker(markerNumber=marker, outputVariableType=position, storeInternal=True)
        self._sensors.append(self.mbs.AddSensor(sensor))

    def solve(self, *, end: float, step: float, rho: float) -> tuple[Floats, list[Floats]]:
        """Times (s,) and the position (s, 3) of each watched marker, from the start on."""
        self.mbs.Assemble()
        settings = self.exu.SimulationSettings()
        time = settings.timeIntegration
        # As morembs.multibody does: equal steps of at most ``step``.
        count = max(1, math.ceil(end / step * (1 - 1e-12)))
        time.numberOfSteps, time.endTime, time.verboseMode = count, end, 0
        time.generalizedAlpha.spectralRadius = rho
        time.newton.useModifiedNewton = True
        time.newton.relativeTolerance = 1e-11
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = end / count
        self.mbs.SolveDynamic(settings)
        data = [np.array(self.mbs.GetSensorStoredData(sensor)) for sensor in self._sensors]
        return data[0][:, 0], [table[:, 1:4] for table in data]


# ---------------------------------------------------------------------------------------------------------
# Picture and command line


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """One line (or dots) of a panel."""

    x: Floats
    y: Floats
    label: str = ""
    color: str = OURS
    style: str = "-"
    width: float = 1.6


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """One diagram of a picture."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    logarithmic: bool = False


def draw(path: Path, title: str, panels: Sequence[Panel]) -> None:
    """Writes the panels below one another; the old picture stays if that fails."""
    figure = Figure(figsize=(8.5, 0.6 + 2.7 * len(panels)), dpi=130, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    for axes, panel in zip(figure.subplots(len(panels), 1, squeeze=False)[:, 0], panels, strict=True):
        for curve in panel.curves:
            look = {"color": curve.color, "lw": curve.width, "ms": 9, "mfc": "none"}
            axes.plot(curve.x, curve.y, curve.style, label=curve.label or None, **look)
        axes.set_title(panel.title, fontsize=9, loc="left")
        axes.set_xlabel(panel.x)
        axes.set_ylabel(panel.y)
        axes.grid(alpha=0.3)
        if panel.logarithmic:
            axes.set_yscale("log")
        if any(curve.label for curve in panel.curves):
            axes.legend(fontsize=8)
    save(figure, path)


def difference(time: Floats, gap: Floats, length: float) -> Panel:
    """Distance (s,) m of the two simulators as a part of the length; what is below 1e-12 is drawn there."""
    return Panel(
        title="Difference of the two simulators", x="time, s", y="part of the length", logarithmic=True,
        curves=[Curve(x=time, y=np.maximum(gap / length, 1e-12), color="#607d8b", width=1.0)],
    )  # fmt: skip


def parse(arguments: Sequence[str] | None, about: str) -> argparse.Namespace:
    """Reads the command line: ``folder`` and ``quick``."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--folder", type=Path, default=HERE, help="where mesh, bodies and picture go (default: here)")
    parser.add_argument("--quick", action="store_true", help="a shorter run, for a first look")
    return parser.parse_args(arguments)
