"""A window of the path of a body as joints and loads see it: its candidates, and the curve through its nodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.component import MarkerState
from morembs.dynamics.multibody.rotations import cross, hat
from morembs.dynamics.multibody.tolerances import TOL
from morembs.responses.static_mode_tables import Curve, StaticModeTables


@dataclass(frozen=True, kw_only=True, eq=False, slots=True)
class PathState(MarkerState):
    """A window of the path: ``amplitudes`` (k,) are the displacements of its ``candidates``.

    ``position`` and ``axes`` are those of the frame of the body. Rows of ``jacobian`` (6 + k, .): velocity and angular
    velocity of the frame along the inertial axes, then the rates of the amplitudes. Forces on these are wrenches.
    ``R`` (k, k) is the compliance of the static modes, ``offset`` (3,) the origin of the frame in the model.
    """

    switching: StaticModeTables
    candidates: Ints
    amplitudes: Floats
    R: Floats
    offset: Floats
    first: int
    width: int
    interpolation: str

    def at(self, s: float) -> PointOfPath:
        """The point of the path at ``s`` (m), beyond the window on the polynomial at its end."""
        tables = self.switching
        interval = min(max(tables.interval(s), self.first), self.first + self.width - 2)
        curve = tables.curve(s, self.interpolation, interval)
        W = curve.rows(self.candidates)
        arm = self.axes @ (curve.point - self.offset + W @ self.amplitudes)
        return PointOfPath(self, curve, self.position + arm, arm, W)

    def nearest(self, point: Floats) -> float:
        """Position s (m) along the path whose point is nearest to ``point`` (3,), within a little of the window."""
        tables = self.switching
        inside = self.axes.T @ (point - self.position) + self.offset
        nodes = tables.xyz[self.first : self.first + self.width]
        s = float(tables.s[self.first + int(np.argmin(np.linalg.norm(nodes - inside, axis=1)))])
        for _ in range(30):
            here = self.at(s)
            step = float(here.slope @ (point - here.position) / (here.slope @ here.slope))
            s += step
            if abs(step) <= TOL.path_change * max(tables.length, abs(s)):
                break
        return s


@dataclass(frozen=True, eq=False)
class PointOfPath:
    """``position`` (3,) m and ``arm`` (3,) m from the origin of the frame, along the inertial axes; ``W`` (3, k)
    displacement along the axes of the body by the candidates."""

    place: PathState
    curve: Curve
    position: Floats
    arm: Floats
    W: Floats

    @cached_property
    def dW(self) -> Floats:
        """(3, k) derivative of W by s."""
        return self.curve.rows(self.place.candidates, derivative=True)

    @cached_property
    def slope(self) -> Floats:
        """(3,) derivative of the position by s, along the inertial axes."""
        return np.asarray(self.place.axes @ (self.curve.tangent + self.dW @ self.place.amplitudes))

    @cached_property
    def G(self) -> Floats:
        """(3, 6 + k): velocity of the point by the rows of the window."""
        return np.hstack((np.eye(3), -hat(self.arm), self.place.axes @ self.W))

    def wrench(self, force: Floats) -> Floats:
        """(6 + k,) force (3,) N, along the inertial axes, on the rows of the window: force @ G."""
        return np.concatenate((force, cross(self.arm, force), (self.place.axes.T @ force) @ self.W))
