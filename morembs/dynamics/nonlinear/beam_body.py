"""A geometrically exact beam in space as a body of dynamics.multibody, with the frames of its nodes as coordinates.

Positions of nodes move along the inertial axes, sections spin along their own: the mass matrix is constant, and no
rotation vector limits how far a section turns. An element holds constant strain for any rotation, so that a coarse
chain is the reduced member: bending that is even within an element costs one element, whatever its angle.

rope = BeamBody(SpatialBeam.arc(100.0, np.pi / 4, 8, section), name="bend")
system.add(rope)
system.add(FixedJoint(ground.marker_at(), rope.marker("start")))
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg as sl
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from morembs.base.arguments import checked
from morembs.base.errors import InputError, nearest
from morembs.base.limits import NotNegative
from morembs.base.types import Floats
from morembs.dynamics.multibody.component import Component, Marker, MarkerState, checked_rotation, vector
from morembs.dynamics.multibody.divided import END, START
from morembs.dynamics.nonlinear.rotation_vectors import tangents
from morembs.dynamics.nonlinear.spatial_beam import SpatialBeam
from morembs.dynamics.nonlinear.tolerances import TOL
from morembs.fem import DofMap, FEModel, Nodes


@checked
class BeamBody(Component):
    """A beam in space; markers ``start``, ``end`` and those of ``marker_at``.

    ``configuration``: per node its position (3,) m and section (9,) by rows; ``velocity``: per node velocity (3,) m/s
    along the inertial axes and angular velocity (3,) rad/s along the axes of its section.

    Args:
        beam: its nodes without load.
        position, rotation: (3,) m and (3, 3), how the beam is moved from where its nodes are.
        velocity, angular_velocity: (3,) m/s of its origin and (3,) rad/s along the inertial axes, at the start.
        damping: s, of Rayleigh damping in proportion to the stiffness of strains; rigid motion is free of it.

    Raises:
        InputError: wrong shapes, negative damping, a section without rotary inertia.
    """

    def __init__(
        self,
        beam: SpatialBeam,
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        rotation: ArrayLike | None = None,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        damping: NotNegative = 0.0,
        name: str = "beam",
    ) -> None:
        label, n = f"body {name!r}", len(beam.nodes)
        if min(beam.section.rotary) <= 0:
            raise InputError(
                f"{label}: rotary = {beam.section.rotary} was given for its section; expected three positive inertias, "
                "without which a section has no mass to turn",
                kind="model",
                keyword="rotary",
            )
        self.name, self.beam, self.damping = name, beam, float(damping)
        self.size, self.configuration_size = 6 * n, 12 * n
        turn, origin = checked_rotation(f"{label}: rotation", rotation), vector(f"{label}: position", position)
        arms = beam.nodes @ turn.T
        frames = turn @ beam.sections
        spin = vector(f"{label}: angular_velocity", angular_velocity)
        speed = vector(f"{label}: velocity", velocity) + np.cross(spin, arms)
        self._start = (
            np.hstack((origin + arms, frames.reshape(n, 9))).ravel(),
            np.hstack((speed, spin @ frames)).ravel(),
        )
        # Positions as in the beam; rotary inertia is that of half the elements beside a node, in its section.
        share = np.zeros(n)
        share[:-1] += beam.lengths / 2
        share[1:] += beam.lengths / 2
        self._inertia = share[:, None] * np.array(beam.section.rotary)
        self._M = beam.M.toarray()
        turning = np.arange(6 * n).reshape(n, 6)[:, 3:]
        self._M[turning.ravel()] = 0
        self._M[turning, turning] = self._inertia
        self._M.flags.writeable = False
        self._masses = self._M[:, 0::6].sum(axis=1)[0::6]

    def start(self) -> tuple[Floats, Floats]:
        return self._start

    @staticmethod
    def _parts(x: Floats) -> tuple[Floats, Floats]:
        table = x.reshape(-1, 12)
        return table[:, :3], table[:, 3:].reshape(-1, 3, 3)

    def nodes(self, x: Floats) -> Floats:
        """Positions (n, 3) m of all nodes."""
        return self._parts(x)[0]

    def move(self, x: Floats, step: Floats) -> Floats:
        table, by = x.reshape(-1, 12).copy(), step.reshape(-1, 6)
        table[:, :3] += by[:, :3]
        R = table[:, 3:].reshape(-1, 3, 3) @ Rotation.from_rotvec(by[:, 3:]).as_matrix()
        # Round-off is taken out, so that the sections stay orthonormal.
        R = R @ (1.5 * np.eye(3) - 0.5 * np.swapaxes(R, 1, 2) @ R)
        table[:, 3:] = R.reshape(-1, 9)
        return table.ravel()

    def tangent(self, step: Floats) -> Floats | None:
        return np.asarray(sl.block_diag(*(b for T in tangents(step.reshape(-1, 6)[:, 3:]) for b in (np.eye(3), T))))

    def bracket(self, a: Floats, b: Floats) -> Floats:
        value = np.zeros((self.size // 6, 6))
        value[:, 3:] = np.cross(a.reshape(-1, 6)[:, 3:], b.reshape(-1, 6)[:, 3:])
        return value.ravel()

    def dynamics(self, t: float, x: Floats, v: Floats, gravity: Floats) -> tuple[Floats, Floats]:
        rates = v.reshape(-1, 6)
        force = self.beam.of_frames(*self._parts(x), rates, self.damping)[1]
        force[:, :3] -= self._masses[:, None] * gravity
        force[:, 3:] += np.cross(rates[:, 3:], self._inertia * rates[:, 3:])
        return self._M.copy(), force.ravel()

    def slopes(self, t: float, x: Floats, v: Floats) -> tuple[Floats, Floats] | None:
        """By differences of every third node at once: a node feels no others than its neighbours."""
        n, still = self.size // 6, np.zeros(3)
        base = self.dynamics(t, x, v, still)[1]
        K, C = np.zeros((2, n, 6, n, 6))
        for first in range(min(3, n)):
            moving = np.arange(first, n, 3)
            for axis in range(6):
                step = np.zeros((n, 6))
                step[moving, axis] = TOL.forward_step
                for slope, at in ((K, (self.move(x, step.ravel()), v)), (C, (x, v + step.ravel()))):
                    change = ((self.dynamics(t, *at, still)[1] - base) / TOL.forward_step).reshape(n, 6)
                    for shift in (-1, 0, 1):
                        by = moving[(moving + shift >= 0) & (moving + shift < n)]
                        slope[by + shift, :, by, axis] = change[by + shift]
        return K.reshape(self.size, self.size), C.reshape(self.size, self.size)

    def energy(self, x: Floats, v: Floats, gravity: Floats) -> tuple[float, float]:
        r, R = self._parts(x)
        strain = self.beam.of_frames(r, R)[0]
        return 0.5 * float(v @ self._M @ v), strain - float(self._masses @ r @ gravity)

    def power(self, x: Floats, v: Floats) -> float:
        return self.beam.of_frames(*self._parts(x), v.reshape(-1, 6), self.damping)[2]

    def marker(self, name: str) -> Marker:
        ends = {"start": 0, "end": len(self.beam.nodes) - 1}
        if name not in ends:
            raise InputError(f"body {self.name!r} has no marker {name!r}; {nearest(name, list(ends))}", kind="unknown")
        return SectionMarker(self, name, ends[name])

    def marker_at(self, node: int) -> Marker:
        """Marker on the section of a node, by its number along the beam.

        Raises:
            InputError: no such node.
        """
        if not 0 <= node < len(self.beam.nodes):
            raise InputError(
                f"body {self.name!r}: node {node} was given; expected a number from 0 to {len(self.beam.nodes) - 1}",
                keyword="node",
            )
        return SectionMarker(self, f"node {node}", node)


@dataclass(frozen=True, eq=False)
class SectionMarker(Marker):
    """The section of one node."""

    component: BeamBody
    name: str
    node: int

    def place(self, x: Floats) -> MarkerState:
        own = x[12 * self.node : 12 * self.node + 12]
        R, at = own[3:].reshape(3, 3), 6 * self.node
        jacobian = np.zeros((6, self.component.size))
        jacobian[:3, at : at + 3], jacobian[3:, at + 3 : at + 6] = np.eye(3), R
        return MarkerState(position=own[:3], axes=R, jacobian=jacobian)


@checked
def beam_pieces(beam: SpatialBeam, pieces: int) -> list[FEModel]:
    """Linear models of a beam without load, cut into ``pieces`` of nearly equal numbers of elements.

    They are for ``morembs.dynamics.multibody.divided_body``.

    Args:
        beam: the beam, without load.
        pieces: their number, at most that of the elements.

    Raises:
        InputError: fewer than one piece, or more than elements.
    """
    elements = len(beam.lengths)
    if not 1 <= pieces <= elements:
        raise InputError(
            f"{pieces} pieces of {elements} elements were asked for; expected 1 to {elements}", keyword="pieces"
        )
    models = []
    cuts = np.rint(np.linspace(0, elements, pieces + 1)).astype(int)
    for a, b in pairwise(cuts):
        part = SpatialBeam(beam.nodes[a : b + 1], beam.sections[a : b + 1], beam.section, corrected=beam.corrected)
        n = len(part.nodes)
        nodes = Nodes(ids=np.arange(a + 1, b + 2), xyz=part.nodes, sets={START: np.array([0]), END: np.array([n - 1])})
        dofs = DofMap(node=np.repeat(np.arange(n), 6), component=np.tile(np.arange(6), n))
        models.append(FEModel(K=part.tangent(part.reference), M=part.M, nodes=nodes, dofs=dofs, source="beam"))
    return models
