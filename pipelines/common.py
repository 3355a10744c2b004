"""What pipelines and studies share: command line, the body of a bar from a job, pictures, a beam, unfinished runs."""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import meshio
import numpy as np
import scipy.sparse as sp
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from morembs.app.jobs.job import load_job
from morembs.app.jobs.picture import save
from morembs.app.jobs.run import run_job
from morembs.base.types import Floats
from morembs.dynamics.multibody import Result, SlidingSwitch, System, UnfinishedRunError, simulate_sliding
from morembs.dynamics.nonlinear import Section
from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.grid import box_mesh
from morembs.storage.safefile import replacing

OURS, THEIRS, THIRD = "#d1495b", "#2e86ab", "#3d9970"
STEEL = {"young": 2.1e11, "poisson": 0.3, "density": 7850.0}


def parse(arguments: Sequence[str] | None, about: str, here: str) -> argparse.Namespace:
    """Reads the command line: ``folder``, which is made, and ``quick``. ``here`` is the file of the program."""
    parser = argparse.ArgumentParser(description=about)
    place = Path(here).resolve().parent
    parser.add_argument("--folder", type=Path, default=place, help="where all files go (default: beside the program)")
    parser.add_argument("--quick", action="store_true", help="a shorter run, for a first look")
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    return options


def make_body(job: Path, folder: Path, size: Sequence[float], cells: Sequence[int]) -> ExudynBody:
    """Runs a job, copied to ``folder``, on a bar along x of ``cells`` hexahedra, its left end centred at the origin."""
    toml = folder / job.name
    if folder.resolve() != job.resolve().parent:
        shutil.copyfile(job, toml)
    loaded, mesh = load_job(toml), box_mesh(size, cells)
    points = mesh.nodes.xyz - [0, size[1] / 2, size[2] / 2]
    cells_of = [("hexahedron20", mesh.blocks[0].nodes)]
    meshio.Mesh(points, cells_of).write(loaded.resolve(loaded.tables.model.mesh), file_format="gmsh")
    run_job(loaded)
    return ExudynBody.of(loaded.output)


@dataclass(frozen=True, eq=False)
class Curve:
    """One line (or dots) of a panel."""

    x: Floats
    y: Floats
    label: str = ""
    color: str = OURS
    style: str = "-"
    width: float = 1.6


@dataclass(frozen=True, eq=False)
class Panel:
    """One diagram of a picture."""

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    logarithmic: bool = False


def draw(path: Path, title: str, panels: Sequence[Panel]) -> None:
    """Writes the panels below one another and prints the path; the old picture stays if that fails."""
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
    print(path)


def difference(time: Floats, gap: Floats, length: float) -> Panel:
    """Distance (s,) m of the two simulators as a part of the length; what is below 1e-12 is drawn there."""
    curve = Curve(time, np.maximum(gap / length, 1e-12), color="#607d8b", width=1.0)
    return Panel("Difference of the two simulators", "time, s", "part of the length", [curve], logarithmic=True)


def hermite_beam(n: int) -> FEModel:
    """Beam of unit length, bending stiffness and mass per length in n elements, held at both ends."""
    h = 1.0 / n
    k = (
        np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
        / h**3
    )
    m = (
        h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
            ]
        )
    )
    dofs = 2 * np.arange(n)[:, None] + np.arange(4)
    rows, columns = np.repeat(dofs, 4, axis=1).ravel(), np.tile(dofs, (1, 4)).ravel()
    K, M = (sp.csr_array(sp.coo_array((np.tile(e.ravel(), n), (rows, columns)))) for e in (k, m))
    keep = np.setdiff1d(np.arange(2 * n + 2), [0, 2 * n])
    xyz = np.zeros((n + 1, 3))
    xyz[:, 0] = np.linspace(0, 1, n + 1)
    return FEModel(
        K=sp.csr_array(K[keep][:, keep]),
        M=sp.csr_array(M[keep][:, keep]),
        nodes=Nodes(ids=np.arange(1, n + 2), xyz=xyz, sets={"BEAM": np.arange(n + 1)}),
        dofs=DofMap(node=keep // 2, component=np.where(keep % 2, 5, 1)),
        source="simply supported beam",
    )


def simulate_kept(
    system: System, switch: SlidingSwitch, end: float, step: float, keep: Path | None, rho: float = 0.9
) -> Result:
    """A run; what there is of one that fails is kept."""
    try:
        return simulate_sliding(system, switch, end=end, step=step, rho=rho)
    except UnfinishedRunError as error:
        if keep is not None and error.result is not None:
            write_run(keep, error.result)
        raise


def write_run(path: Path, result: Result) -> None:
    """Times and configurations of a run, whole or not at all."""
    with replacing(path) as file:
        np.savez(file, time=result.time, x=np.concatenate([segment.x for segment in result.segments]))


class ExudynBeams:
    """Planar mechanisms of geometrically exact beams in Exudyn, which must be installed."""

    def __init__(self) -> None:
        self.system = ExudynSystem()
        self.items, self.mbs = self.system.items, self.system.mbs
        self.ground = self.at(self.mbs.AddNode(self.items.NodePointGround()), 0)

    def at(self, node: int, k: int) -> int:
        """A marker on a coordinate of a node."""
        return int(self.mbs.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=node, coordinate=k)))

    def bar(self, start: Sequence[float], length: float, count: int, section: Section) -> list[int]:
        """Nodes of ``count`` elements along x from ``start`` (2,)."""
        places = start[0] + length * np.arange(count + 1) / count
        nodes = [self.mbs.AddNode(self.items.NodeRigidBody2D(referenceCoordinates=[x, start[1], 0])) for x in places]
        for pair in pairwise(nodes):
            self.mbs.AddObject(
                self.items.ObjectBeamGeometricallyExact2D(
                    nodeNumbers=list(pair),
                    length=length / count,
                    massPerLength=section.mass,
                    crossSectionInertia=section.rotary,
                    bendingStiffness=section.EI,
                    axialStiffness=section.EA,
                    shearStiffness=section.GA,
                )
            )
        return nodes

    def _constrain(self, first: int, second: int, **options: object) -> None:
        self.mbs.AddObject(self.items.CoordinateConstraint(markerNumbers=[first, second], **options))

    def join(self, first: int, second: int, coordinates: Sequence[int] = (0, 1)) -> None:
        """Two nodes with common coordinates."""
        for k in coordinates:
            self._constrain(self.at(first, k), self.at(second, k))

    def hold(self, node: int, coordinates: Sequence[int], motion: Callable[[float], float] | None = None) -> None:
        """Coordinates of a node that stay, or move as told."""
        given = {} if motion is None else {"offsetUserFunction": lambda _mbs, t, _item, _offset: motion(t)}
        for k in coordinates:
            self._constrain(self.ground, self.at(node, k), **given)

    def mass(self, node: int, mass: float) -> None:
        """A point mass at a node."""
        place = self.mbs.GetNode(node)["referenceCoordinates"][:2]
        point = self.mbs.AddNode(self.items.NodePoint2D(referenceCoordinates=list(place)))
        self.mbs.AddObject(self.items.ObjectMassPoint2D(mass=mass, nodeNumber=point))
        self.join(node, point)

    def turn(self, node: int, torque: Callable[[float], float]) -> None:
        """A torque over time on a node."""
        self.mbs.AddLoad(
            self.items.LoadCoordinate(
                markerNumber=self.at(node, 2), load=1.0, loadUserFunction=lambda _mbs, t, _load: torque(t)
            )
        )

    def solve(
        self, end: float, step: float, rho: float, watch: Sequence[int], floor: float = 1e-10
    ) -> tuple[Floats, list[Floats], float]:
        """Times (T,), positions (T, 2) of the watched nodes, processor seconds per step; residuals end at ``floor``."""
        position = self.system.exu.OutputVariableType.Position
        sensors = [
            self.mbs.AddSensor(self.items.SensorNode(nodeNumber=n, outputVariableType=position, storeInternal=True))
            for n in watch
        ]
        self.mbs.Assemble()
        settings, count = self.system.exu.SimulationSettings(), round(end / step)
        integration = settings.timeIntegration
        integration.numberOfSteps, integration.endTime, integration.verboseMode = count, end, 0
        integration.generalizedAlpha.spectralRadius, integration.newton.absoluteTolerance = rho, floor
        settings.linearSolver.solverType = self.system.exu.LinearSolverType.EigenSparse
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = step
        begin = time.process_time()
        self.mbs.SolveDynamic(settings)
        seconds = (time.process_time() - begin) / count
        data = [np.array(self.mbs.GetSensorStoredData(sensor)) for sensor in sensors]
        return data[0][:, 0], [samples[:, 1:3] for samples in data], seconds
