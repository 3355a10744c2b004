"""Floating frames for real time: free modes that a time step does not resolve answer by their static compliance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame
from morembs.body.stored import StoredBodies
from morembs.exporters.read_back import FirstOrder
from morembs.exporters.real_time import RealTime, Truncation, gyration, slow_modes
from morembs.exporters.sid import in_shapes
from morembs.exporters.tolerances import TOL
from morembs.linalg.eigen import accurate_eigh


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticModes:
    """m free modes of a body that a time step does not resolve, of unit stiffness; in mean axes rigid accelerations do
    not reach them.

    ``shapes`` (n, m) by elastic coordinates, ``motion`` (6 k, m) of the k interface frames, ``x_phi`` (9, m): their
    load by the spin, int x_a phi_b dm of each pair of axes.
    """

    shapes: Floats
    motion: Floats
    x_phi: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class SplitFrame:
    """Free modes of a floating ``frame``, in two parts: ``slow`` (n,) says which a ``step`` in s resolves.

    ``T`` (n, n) has the modes of unit mass by elastic coordinates, ``omega`` (n,) is in rad/s, ``damping`` (n, n) that
    of the modes, ``motion`` (6 k, n) their motion of the interface frames in mean axes.
    """

    frame: FloatingFrame
    step: float
    T: Floats
    omega: Floats
    damping: Floats
    motion: Floats
    slow: np.ndarray

    @classmethod
    def of(cls, frame: FloatingFrame, step: float) -> SplitFrame:
        """Split the free modes of ``frame``; where none is slow, its rigid motion is left."""
        mean = frame.in_frame("mean-axes")
        values, T = accurate_eigh(frame.Ke, mean.integrals.Me)
        T = T * np.where(T[np.argmax(np.abs(T), axis=0), np.arange(len(T))] < 0, -1.0, 1.0)
        omega, damping = np.sqrt(np.maximum(values, 0.0)), T.T @ frame.De @ T
        slow = slow_modes(omega, np.diag(damping), step)
        motion = np.vstack([marker.motion for marker in mean.markers.values()]) @ T
        return cls(frame=frame, step=step, T=T, omega=omega, damping=damping, motion=motion, slow=slow)

    @property
    def slow_frame(self) -> FloatingFrame:
        """The frame with the slow modes alone."""
        return in_shapes(self.frame, self.T[:, self.slow])

    @property
    def static_modes(self) -> StaticModes:
        """The other modes."""
        shapes = self.T[:, ~self.slow] / self.omega[~self.slow]
        x_phi = self.frame.in_frame("mean-axes").integrals.x_phi
        motion = self.motion[:, ~self.slow] / self.omega[~self.slow]
        return StaticModes(shapes=shapes, motion=motion, x_phi=x_phi.reshape(9, -1) @ shapes)

    def with_static_shapes(self, length: float) -> tuple[FloatingFrame, FirstOrder]:
        """Slow modes, then shapes that have the compliance of all others at the interfaces, and equations of these
        shapes as ``measure`` takes them; rotations count at the ``length`` in m.

        Shapes vibrate as fast as the step resolves, by the mass of their own coordinates. Their damping is that of the
        modes that are gone, to first order.
        """
        gone, n = self.static_modes, int(self.slow.sum())
        U = compliance_factor(gone.motion @ gone.motion.T, np.tile(np.repeat([1.0, length], 3), len(gone.motion) // 6))
        # Orthonormal combinations of the modes, so that the stiffness is one.
        parts = np.linalg.pinv(U) @ gone.motion
        joined = in_shapes(self.frame, np.hstack([self.T[:, self.slow], gone.shapes @ parts.T]))
        fastest, m = TOL.resolved_angle / self.step, len(parts)
        Me = np.array(joined.integrals.Me)
        Me[n:, n:] += np.eye(m) / fastest**2 - (parts / self.omega[~self.slow] ** 2) @ parts.T
        run = replace(joined, integrals=replace(joined.integrals, Me=Me))
        return run, _equations(np.full(m, fastest), fastest**2 * joined.De[n:, n:], fastest * U)

    def measure(
        self, source: StoredBodies, stand_in: FirstOrder | None = None, stress: Floats | None = None
    ) -> RealTime:
        """Errors of interface motions, and of ``stress`` (p, n) in Pa per elastic coordinate, under loads at the
        interfaces, where the modes beyond the step are static, or a ``stand_in`` is there for them."""
        frames = len(self.motion) // 6
        loads = (["N"] * 3 + ["N m"] * 3) * frames
        kinds = ["m", "m", "m", "rad", "rad", "rad"] * frames
        shapes = np.zeros((0, len(self.omega))) if stress is None else stress @ self.T
        system = _equations(self.omega, self.damping, self.motion)
        rows = np.hstack([shapes, np.zeros_like(shapes)])
        system = replace(
            system, C=np.vstack([system.C, rows]), D=np.vstack([system.D, np.zeros((len(rows), len(loads)))])
        )
        return Truncation(
            system=system,
            fast=np.flatnonzero(np.tile(~self.slow, 2)),
            moving=np.zeros(0, dtype=np.int64),
            units=(kinds + [f"{unit}/s" for unit in kinds] + ["Pa"] * len(rows), loads),
            derivatives=[(at, 0) for at in range(len(loads))],
            length=gyration(source),
            step=self.step,
            stand_in=stand_in,
        ).measure(len(self.omega))


def compliance_factor(R: Floats, length: Floats) -> Floats:
    """U (p, r) with U U' = R (p, p) as far as that is positive; rows count by ``length`` (p,)."""
    values, U = np.linalg.eigh(R * np.outer(length, length))
    large = values > TOL.dependent_interface * values[-1]
    return np.asarray((U / length[:, None])[:, large] * np.sqrt(values[large]))


def _equations(omega: Floats, damping: Floats, motion: Floats) -> FirstOrder:
    """Displacements and velocities of the rows of ``motion`` (p, n) by loads on them, of modes of unit mass."""
    n, still = len(omega), np.zeros_like(motion)
    return FirstOrder(
        A=np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -damping]]),
        B=np.vstack([still.T, motion.T]),
        C=np.block([[motion, still], [still, motion]]),
        D=np.zeros((2 * len(motion), len(motion))),
    )
