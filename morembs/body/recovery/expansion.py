"""From a reduced trajectory back to the nodes: displacements, motion and stresses over time.

A simulator gives the coordinates of a body over time, and for a body in a floating frame the position p and the
rotation A of that frame. Node i then lies at p + A (x_i - origin + u_i), u = V q + U_res f; U_res, which adds what the
basis lacks under interface loads f, and the stresses follow from ``Recovery``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.recovery.trajectory import Trajectory
from morembs.body.recovery_shapes import Recovery
from morembs.body.stored import StoredBodies


@dataclass(frozen=True, kw_only=True, eq=False)
class Expansion:
    """A trajectory at the nodes: ``times`` (nt,) s, ``displacement`` (nt, n, 3) m of the nodes of the body file.

    Displacements are along the model's axes, as the coordinates give them (within the frame for elastic ones).
    ``motion`` (nt, n, 3) m leads from where the nodes lie in the file to where they are, with deformations
    magnified; None where it is the displacement. ``stress`` (nt, np, 6) Pa at the points of the recovery, ``jump``
    (nt, np) Pa how far elements miss it around each (``Recovery.jumps_at``).
    """

    times: Floats
    displacement: Floats
    motion: Floats | None = None
    stress: Floats | None = None
    jump: Floats | None = None


def expand(
    source: StoredBodies,
    body: Body,
    trajectory: Trajectory,
    *,
    recovery: Recovery | None = None,
    scale: float = 1.0,
    kept_bytes: int = 2**30,
) -> Expansion:
    """Displacements at all times, and stresses if ``recovery`` is given; all in memory.

    ``scale`` magnifies the deformation in ``motion``. A basis of up to ``kept_bytes`` is read whole. Loads correct
    displacements where ``recovery`` is that of a body file (``stored_recovery``).

    Args:
        source: file of the body.
        body: one of its bodies.
        trajectory: coordinates over time.
        recovery: stress shapes, None without stress.
        scale: factor of the deformation in ``motion``.
        kept_bytes: largest basis that is read whole, in bytes.

    Raises:
        InputError: a trajectory that does not fit the body, or results too large for single precision.

    >>> write_body("bar.h5", [body])
    PosixPath('bar.h5')
    >>> stored = read_body("bar.h5")
    >>> rest = Trajectory(times=np.array([0.0, 1.0]), coordinates=np.zeros((2, 18)))
    >>> expand(stored, stored.bodies["craig-bampton"], rest).displacement.shape
    (2, 20, 3)
    """
    return Expander(source, body, recovery, scale, kept_bytes).expand(trajectory)


@dataclass(frozen=True, eq=False)
class Expander:
    """What takes trajectories of one body to its nodes.

    A basis of up to ``kept_bytes`` is read once, a larger one again for each block of steps, of ``block_bytes``.
    """

    source: StoredBodies
    body: Body
    recovery: Recovery | None
    scale: float
    kept_bytes: int = 2**30
    block_bytes: int = 2**27
    kept: list[Floats] = field(default_factory=list)

    def blocks(self, trajectory: Trajectory) -> Iterator[Expansion]:
        """The expansion, some steps at a time."""
        recovery = self.recovery
        points = 0 if recovery is None else len(recovery.points)
        pairs = 0 if recovery is None or recovery.jump is None else len(recovery.jump) // 6
        step = max(1, self.block_bytes // (8 * (18 * len(self.source.node_ids) + 18 * points + 24 * pairs + 1)))
        for at in range(0, len(trajectory.times), step):
            yield self.expand(trajectory.part(slice(at, at + step)))

    def expand(self, trajectory: Trajectory) -> Expansion:
        """The expansion of all steps."""
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
            q = reduced_coordinates(self.body, trajectory)
            missing = self._missing(trajectory)
            u = self._nodes(q) + missing
            recovery = self.recovery
            stressed = None if recovery is None or not len(recovery.points) else recovery
            stress = None if stressed is None else stressed.at(q, trajectory.loads)
            jump = None if stressed is None else stressed.jumps_at(q, trajectory.loads)
            motion = self._motion(trajectory, q, u, missing)
        for name, values in (("displacement", u), ("motion", motion), ("stress", stress)):
            if values is not None:
                trajectory.refuse_too_large(name, values)
        return Expansion(times=trajectory.times, displacement=u, motion=motion, stress=stress, jump=jump)

    def _motion(self, trajectory: Trajectory, q: Floats, u: Floats, missing: Floats | float) -> Floats | None:
        p, A = trajectory.position, trajectory.rotation
        if p is not None or A is not None:
            x, origin = self.source.coordinates, _origin(self.body)
            arms = x - origin + self.scale * u
            turned = arms if A is None else arms @ np.swapaxes(A, 1, 2)
            return np.asarray(turned + (origin if p is None else p[:, None]) - x)
        if self.scale == 1.0:
            return None
        return u + (self.scale - 1.0) * (self._nodes(q @ _deformation(self.body).T) + missing)

    def _missing(self, trajectory: Trajectory) -> Floats | float:
        """U_res f (nt, n, 3), as the frame sees it, which follows its interfaces also where they move by that."""
        recovery, loads, body = self.recovery, trajectory.loads, self.body
        if recovery is None or recovery.displacement is None or loads is None:
            return 0.0
        missing = (recovery.displacement @ loads.T.astype(recovery.displacement.dtype)).T.astype(np.float64)
        u = np.ascontiguousarray(missing).reshape(len(loads), -1, 3)
        if body.floating is not None and not is_reduced(body, trajectory):
            moved = body.floating.follow_interfaces(recovery.markers, loads.shape[1]) @ loads.T
            u -= moved[:3].T[:, None] + np.cross(moved[3:].T[:, None], self.source.coordinates - _origin(body))
        return u

    def _nodes(self, q: Floats) -> Floats:
        """V q as (nt, n, 3)."""
        rows, order = 3 * len(self.source.node_ids), q.shape[1]
        moved = np.zeros((rows, len(q)))
        width = max(1, self.kept_bytes // (8 * max(rows, 1)))
        for at in range(0, order, width):
            if order <= width:
                if not self.kept:
                    self.kept.append(self.body.basis())
                block = self.kept[0]
            else:
                block = self.body.basis(slice(at, at + width))
            moved += block @ q[:, at : at + width].T
        return np.ascontiguousarray(moved.T).reshape(len(q), -1, 3)


def reduced_coordinates(body: Body, trajectory: Trajectory) -> Floats:
    """Reduced coordinates (nt, nr) of a trajectory in these or in elastic coordinates.

    Raises:
        InputError: neither fits, loads of another count, or a frame that the body does not have.
    """
    width, order, inputs = trajectory.coordinates.shape[1], len(body.stiffness_matrix), body.input_matrix.shape[1]
    elastic = None if body.floating is None else body.floating.elastic.shape[1]
    if width != order and width != elastic:
        also = "" if elastic is None else f" or the {elastic} elastic ones of its floating frame"
        raise InputError(
            f"the trajectory has {width} coordinates; body {body.name!r} has {order}: give all of its reduced "
            f"coordinates{also}, in the order of the file",
            keyword="coordinates",
        )
    if trajectory.loads is not None and trajectory.loads.shape[1] != inputs:
        raise InputError(
            f"the trajectory has {trajectory.loads.shape[1]} loads; body {body.name!r} has {inputs} interface degrees "
            "of freedom: give one load for each column of its input matrix",
            keyword="loads",
        )
    framed = trajectory.position is not None or trajectory.rotation is not None
    if framed and width != elastic:
        cure = (
            "leave position and rotation out" if elastic is None else f"give the {elastic} elastic coordinates with it"
        )
        raise InputError(
            f"the trajectory moves a frame, but its {width} coordinates of body {body.name!r} are not those of a "
            f"floating frame; {cure}",
            kind="conflict",
            keyword="frame",
        )
    if body.floating is None or is_reduced(body, trajectory):
        return trajectory.coordinates
    return np.asarray(trajectory.coordinates @ body.floating.elastic.T)


def is_reduced(body: Body, trajectory: Trajectory) -> bool:
    """True if the coordinates are the reduced ones, not the elastic ones of the floating frame."""
    return bool(trajectory.coordinates.shape[1] == len(body.stiffness_matrix))


def _origin(body: Body) -> Floats:
    return np.zeros(3) if body.floating is None else body.floating.origin


def _deformation(body: Body) -> Floats:
    """What takes the rigid motion out of reduced coordinates (nr, nr)."""
    r, order = body.rigid_count, len(body.stiffness_matrix)
    if body.mode_kind[:r] == ("rigid",) * r:
        return np.diag(np.concatenate([np.zeros(r), np.ones(order - r)]))
    M = body.mass_matrix
    Z = sl.eigh(body.stiffness_matrix, M, subset_by_index=[0, r - 1])[1]
    return np.asarray(np.eye(order) - Z @ (Z.T @ M))
