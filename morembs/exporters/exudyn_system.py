"""Elastic bodies in Exudyn (``pip install exudyn``), with what its file cannot hold: damping, and a right weight.

body = ExudynBody.of("swing.h5")
system = ExudynSystem(gravity=(0, 0, -9.81))
strip = system.elastic(body, position=body.floating.origin)
system.joint(system.at_ground(), system.at_interface(strip, "hinge"), (1, 1, 1, 1, 0, 1))
tip = system.at_interface(strip, "tip")
times, (path,) = system.solve(end=1.0, step=1e-3, watch=[tip])
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.file import read_body
from morembs.body.floating.frame import FloatingFrame
from morembs.body.stored import StoredBodies, choose_body
from morembs.exporters import ExportContext, export_body
from morembs.exporters.exudyn import exudyn_marker, for_time_step
from morembs.exporters.tolerances import TOL

Point = Sequence[float] | Floats


def exudyn_missing() -> str:
    """Why Exudyn cannot run here; "" where it can."""
    try:
        importlib.import_module("exudyn")
    except ImportError as reason:
        return f"Exudyn is not here ({reason}); to get it: pip install exudyn"
    return ""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExudynBody:
    """An elastic body of a body file, and ``file`` for Exudyn beside it."""

    source: StoredBodies
    body: Body
    file: Path

    @classmethod
    def of(cls, path: str | Path, name: str | None = None, *, time_step: float | None = None) -> ExudynBody:
        """The body ``name`` (or the only one) of the body file ``path``, exported to Exudyn, by default with all modes.

        Raises:
            InputError: no such body, one without a floating frame or without nodes, or with a ``time_step`` in s
                without interface frames.
        """
        source = read_body(path)
        body = choose_body(source, name, Path(path))
        options = {} if time_step is None else {"time_step": time_step}
        file = export_body(path, "exudyn", body=name, options=options).paths[0]
        if time_step is not None:
            context = ExportContext(source=source, body=body, path=file, file=Path(path))
            body = replace(body, floating=for_time_step(context, time_step)[0])
        return cls(source=source, body=body, file=file)

    @property
    def floating(self) -> FloatingFrame:
        """Its floating frame."""
        if self.body.floating is None:
            raise InputError(f"the body {self.body.name!r} has no floating frame; Exudyn needs one", kind="unsupported")
        return self.body.floating

    def shapes(self) -> Floats:
        """Displacements (n, 3, k) of the stored nodes for each elastic coordinate in the floating frame."""
        moved = self.body.basis() @ self.floating.elastic
        return np.asarray(moved.reshape(len(self.source.coordinates), 3, -1))

    def mass_weights(self) -> Floats:
        """(n,) weights of the stored nodes whose mean is the centre of mass of the body, however it deforms.

        The smallest that give the integrals of the consistent mass. Raises InputError where the nodes are too few.
        """
        nodes, frame = self.source.coordinates, self.floating
        integrals, phi = frame.integrals, self.shapes().transpose(1, 2, 0).reshape(-1, len(nodes))
        scale = np.abs(phi).max()
        A = np.vstack([np.ones((1, len(nodes))), (nodes - frame.origin).T, phi / scale])
        b = np.concatenate([[1.0], integrals.first / integrals.mass, integrals.Ct.T.ravel() / (scale * integrals.mass)])
        weights = np.linalg.lstsq(A, b, rcond=TOL.dependent_weights)[0]
        if np.abs(A @ weights - b).max() > TOL.weights_error:
            raise InputError(
                'the stored nodes cannot carry the weight of the body; store more (nodes = "all")', kind="unsupported"
            )
        return np.asarray(weights)


@dataclass(frozen=True, eq=False)
class ExudynPart:
    """A body in a system: numbers that Exudyn gave its items, by their names, and where it is elastic, its ``body``."""

    items: dict[str, int]
    body: ExudynBody | None = None


class ExudynSystem:
    """A system ``mbs`` of Exudyn that elastic bodies are added to. Points (m) and velocities along inertial axes.

    What it has no method for goes in by Exudyn's own: ``exu``, ``items`` (exudyn.itemInterface) and ``mbs``.
    """

    def __init__(self, gravity: Point = (0.0, 0.0, 0.0)) -> None:
        self.exu, self.fem, self.items, self.utilities = (
            importlib.import_module(name)
            for name in ("exudyn", "exudyn.FEM", "exudyn.itemInterface", "exudyn.utilities")
        )
        self.gravity = list(gravity)
        self.container = self.exu.SystemContainer()
        self.mbs = self.container.AddSystem()
        self.ground = ExudynPart({"body": self.mbs.AddObject(self.items.ObjectGround())})

    def elastic(
        self,
        body: ExudynBody,
        *,
        position: Point = (0, 0, 0),
        rotation: Floats | None = None,
        velocity: Point = (0, 0, 0),
        angular_velocity: Point = (0, 0, 0),
        elastic: Floats | None = None,
    ) -> ExudynPart:
        """The elastic body with its damping, which the file cannot hold. ``elastic`` (k,): where it starts."""
        cms = self.fem.ObjectFFRFreducedOrderInterface()
        cms.LoadFromFile(str(body.file))
        items: dict[str, Any] = cms.AddObjectFFRFreducedOrder(
            self.mbs,
            positionRef=list(position),
            initialVelocity=list(velocity),
            rotationMatrixRef=np.eye(3) if rotation is None else rotation,
            initialAngularVelocity=list(angular_velocity),
        )
        part = ExudynPart(items, body)
        if any(self.gravity):
            self._weigh(part, body)
        damping = self.exu.MatrixContainer()
        damping.SetWithDenseMatrix(body.floating.De, useDenseMatrix=True)
        self.mbs.SetObjectParameter(items["oFFRFreducedOrder"], "dampingMatrixReduced", damping)
        if elastic is not None:
            self.mbs.SetNodeParameter(items["nGenericODE2"], "initialCoordinates", list(elastic))
        return part

    def _weigh(self, part: ExudynPart, body: ExudynBody) -> None:
        """Gravity, as a force on the centre of mass that moves with the deformation.

        The mass-proportional load that AddObjectFFRFreducedOrder makes of ``gravity`` takes its moment about the frame
        at the undeformed centre of mass (Exudyn 1.13), which costs energy in swings that bend.
        """
        weights = body.mass_weights()
        marker = self.items.MarkerSuperElementPosition(
            bodyNumber=part.items["oFFRFreducedOrder"],
            meshNodeNumbers=np.arange(len(weights)),
            weightingFactors=weights,
        )
        force = list(body.floating.integrals.mass * np.array(self.gravity))
        self.mbs.AddLoad(self.items.LoadForceVector(markerNumber=self.mbs.AddMarker(marker), loadVector=force))

    def rigid(
        self,
        mass: float,
        inertia: Point,
        *,
        position: Point,
        velocity: Point = (0, 0, 0),
        angular_velocity: Point = (0, 0, 0),
    ) -> ExudynPart:
        """A rigid body with its origin in its centre of mass and its axes along the inertial ones.

        Its coordinates are angles (about x, y, z), so that a steady turn about z is exact; Euler parameters lag behind
        by errors of the steps.
        """
        items = self.mbs.CreateRigidBody(
            referencePosition=list(position),
            initialVelocity=list(velocity),
            initialAngularVelocity=list(angular_velocity),
            gravity=self.gravity,
            returnDict=True,
            inertia=self.utilities.RigidBodyInertia(mass, np.diag(inertia)),
            nodeType=self.exu.NodeType.RotationRxyz,
        )
        return ExudynPart({"nRigidBody": items["nodeNumber"], "body": items["bodyNumber"]})

    def at_ground(self, point: Point = (0, 0, 0)) -> int:
        """Marker on the ground."""
        return self.at_body(self.ground, point)

    def at_body(self, rigid: ExudynPart, point: Point = (0, 0, 0)) -> int:
        """Marker on a rigid body."""
        marker = self.items.MarkerBodyRigid(bodyNumber=rigid.items["body"], localPosition=list(point))
        return int(self.mbs.AddMarker(marker))

    def at_interface(self, elastic: ExudynPart, name: str) -> int:
        """Marker that follows an interface of an elastic body."""
        if elastic.body is None:
            raise InputError(f"a rigid body was given; only elastic ones have interfaces such as {name!r}")
        nodes = exudyn_marker(elastic.body.source, name)
        marker = self.items.MarkerSuperElementRigid(
            bodyNumber=elastic.items["oFFRFreducedOrder"],
            meshNodeNumbers=nodes.numbers,
            weightingFactors=nodes.weights,
            offset=nodes.offset,
        )
        return int(self.mbs.AddMarker(marker))

    def joint(self, first: int, second: int, held: Sequence[int]) -> None:
        """Joint between two markers; ``held`` says which displacements and rotations about x, y, z it holds."""
        self.mbs.AddObject(self.items.GenericJoint(markerNumbers=[first, second], constrainedAxes=list(held)))

    def drive(self, part: ExudynPart, *, axis: int, speed: float) -> None:
        """Constant angular velocity (rad/s) of the frame of a body about an axis of its own."""
        node = part.items["nRigidBody"]
        turn = self.mbs.AddMarker(self.items.MarkerNodeRotationCoordinate(nodeNumber=node, rotationCoordinate=axis))
        still = self.mbs.AddNode(self.items.NodePointGround())
        fixed = self.mbs.AddMarker(self.items.MarkerNodeCoordinate(nodeNumber=still, coordinate=0))
        self.mbs.AddObject(
            self.items.CoordinateConstraint(markerNumbers=[fixed, turn], velocityLevel=True, offset=speed)
        )

    def solve(
        self, *, end: float, step: float, rho: float = TOL.spectral_radius, watch: Sequence[int]
    ) -> tuple[Floats, list[Floats]]:
        """Times (s,) and positions (s, 3) of each marker in ``watch``, from the start to ``end`` s.

        Equal steps of at most ``step`` s, as ``simulate`` of ``morembs.dynamics.multibody`` takes;
        generalised-alpha with ``rho``.
        """
        sensors = [
            self.mbs.AddSensor(
                self.items.SensorMarker(
                    markerNumber=marker, outputVariableType=self.exu.OutputVariableType.Position, storeInternal=True
                )
            )
            for marker in watch
        ]
        self.mbs.Assemble()
        settings = self.exu.SimulationSettings()
        time = settings.timeIntegration
        count = max(1, math.ceil(end / step * (1 - TOL.step_roundoff)))
        time.numberOfSteps, time.endTime, time.verboseMode = count, end, 0
        time.generalizedAlpha.spectralRadius = rho
        time.newton.useModifiedNewton = True
        time.newton.relativeTolerance = TOL.newton_error
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = end / count
        self.mbs.SolveDynamic(settings)
        data = [np.array(self.mbs.GetSensorStoredData(sensor)) for sensor in sensors]
        return data[0][:, 0], [table[:, 1:4] for table in data]
