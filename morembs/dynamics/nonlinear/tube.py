"""A planar beam within a tube of constant curvature: contact by a penalty, at the points of Simpson's rule.

Walls are concentric circles; where the axis of the beam is beyond one of them by g, a pressure ``penalty`` g acts per
length (Meijaard 2012). Points are the nodes and the middles of elements, which follow a cubic through both nodes and
their directions. There is no friction. The energy of the contact is part of that of the component.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Positive
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.planar_beam import PlanarBeam


@checked
@dataclass(frozen=True, kw_only=True)
class CurvedTube:
    """About ``centre`` (2,) m: ``radius`` m of its axis, ``clearance`` m of the wire's axis to either side, ``penalty``
    N/m2."""

    radius: Positive
    clearance: Positive
    penalty: Positive
    centre: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if self.clearance >= self.radius:
            raise InputError(
                f"tube: clearance = {self.clearance} m was given; expected less than the radius, {self.radius} m",
                keyword="clearance",
            )


@checked
class BeamInTube:
    """A beam whose axis stays within a tube; a NonlinearComponent, with the coordinates of the beam."""

    def __init__(self, beam: PlanarBeam, tube: CurvedTube) -> None:
        self.beam, self.tube = beam, tube
        lengths, count = beam.lengths, len(beam.lengths)
        # Points in order along the beam: node, middle, node, ...
        self._weights = np.zeros(2 * count + 1)
        self._weights[1::2] = lengths * (4 / 6)
        for at in (slice(0, -1, 2), slice(2, None, 2)):
            self._weights[at] += lengths / 6
        self.along = np.concatenate(([0.0], np.cumsum(np.repeat(lengths / 2, 2))))
        # Coordinates of both nodes of each middle, and of each node.
        self._middles = 3 * np.arange(count)[:, None] + np.arange(6)
        self._nodes = 3 * np.arange(count + 1)[:, None] + np.arange(2)
        # Directions (e, 2) of the axis at the ends of elements, less the rotations of their nodes.
        rotations = np.reshape(beam.reference, (-1, 3))[:, 2]
        self._offsets = beam.directions - np.column_stack((rotations[:-1], rotations[1:]))

    @property
    def size(self) -> int:
        return self.beam.size

    @property
    def frames(self) -> Mapping[str, Ints]:
        return self.beam.frames

    @property
    def translations(self) -> Ints:
        return self.beam.translations

    @property
    def reference(self) -> Floats:
        return self.beam.reference

    @property
    def M(self) -> sp.csr_matrix:
        return self.beam.M

    def _points(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Points (p, 2), and the directions (e, 2, 2) along and across the axis at both ends of elements."""
        table = np.reshape(x, (-1, 3))
        turn = self._offsets + np.column_stack((table[:-1, 2], table[1:, 2]))
        along = np.stack((np.cos(turn), np.sin(turn)), axis=2)
        points = np.empty((len(self._weights), 2))
        points[::2] = table[:, :2]
        arm = self.beam.lengths[:, None] / 8
        points[1::2] = (table[1:, :2] + table[:-1, :2]) / 2 + arm * (along[:, 0] - along[:, 1])
        return points, along, np.stack((-along[:, :, 1], along[:, :, 0]), axis=2)

    def _depths(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Depth (p,) m in a wall, positive in the outer one; directions (p, 2) and distances (p,) from the centre."""
        arm = points - self.tube.centre
        distance = np.hypot(*arm.T)
        offset = distance - self.tube.radius
        return offset - np.clip(offset, -self.tube.clearance, self.tube.clearance), arm / distance[:, None], distance

    def contact(self, x: ArrayLike) -> Floats:
        """Forces (p,) N of the walls at the points ``along`` (p,) m, positive inwards, as those of the outer wall."""
        return self.tube.penalty * self._weights * self._depths(self._points(np.asarray(x, dtype=float))[0])[0]

    def energy(self, x: Floats) -> float:
        depth = self._depths(self._points(x)[0])[0]
        return self.beam.energy(x) + 0.5 * self.tube.penalty * float(self._weights @ depth**2)

    def _middle(self, across: Floats) -> Floats:
        """Derivative (e, 2, 6) of the middles by the coordinates of both nodes."""
        D = np.zeros((len(self.beam.lengths), 2, 6))
        D[:, [0, 1], [0, 1]] = D[:, [0, 1], [3, 4]] = 0.5
        arm = self.beam.lengths[:, None] / 8
        D[:, :, 2], D[:, :, 5] = arm * across[:, 0], -arm * across[:, 1]
        return D

    def force(self, x: Floats) -> Floats:
        points, _, across = self._points(x)
        depth, out, _ = self._depths(points)
        load = (self.tube.penalty * self._weights * depth)[:, None] * out
        total = self.beam.force(x)
        total[self._nodes] += load[::2]
        np.add.at(total, self._middles, np.einsum("eik,ei->ek", self._middle(across), load[1::2]))
        return total

    def tangent(self, x: Floats) -> sp.csr_matrix:
        points, along, across = self._points(x)
        depth, out, distance = self._depths(points)
        k = self.tube.penalty * self._weights
        normal = out[:, :, None] * out[:, None, :]
        # Second derivative of depth^2 / 2 by the place; the curvature of the wall counts where it is touched.
        H = np.where(depth != 0, k, 0.0)[:, None, None] * normal
        H += (k * depth / distance)[:, None, None] * (np.eye(2) - normal)
        D = self._middle(across)
        blocks = np.einsum("eik,eij,ejl->ekl", D, H[1::2], D)
        pull, arm = (k * depth)[1::2, None] * out[1::2], self.beam.lengths / 8
        blocks[:, 2, 2] -= arm * np.einsum("ei,ei->e", pull, along[:, 0])
        blocks[:, 5, 5] += arm * np.einsum("ei,ei->e", pull, along[:, 1])
        entries = [(self._nodes, H[::2]), (self._middles, blocks)]
        rows = np.concatenate([np.repeat(at, at.shape[1], axis=1).ravel() for at, _ in entries])
        columns = np.concatenate([np.tile(at, (1, at.shape[1])).ravel() for at, _ in entries])
        values = np.concatenate([block.ravel() for _, block in entries])
        return (self.beam.tangent(x) + sp.coo_matrix((values, (rows, columns)), shape=(self.size, self.size))).tocsr()
