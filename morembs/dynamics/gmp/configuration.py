"""Where a planar member is between two frames that are held, and what holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError, SolverError, nearest
from morembs.base.types import Floats
from morembs.dynamics.gmp.member import ReducedMember
from morembs.dynamics.gmp.tolerances import TOL

FRAMES = ("start", "end")
# Coordinates of both frames in their order in q.
FRAME_COORDINATES = tuple(f"{frame}.{part}" for frame in FRAMES for part in ("x", "y", "angle"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Configuration:
    """A member in static equilibrium: ``frames`` (6,) as ``FRAME_COORDINATES`` m and rad, bending amplitudes ``eta``
    (m,), ``ends`` (2,) rad of the frames to the chord, ``energy`` J, ``loads`` (6,) N and N m that hold the frames,
    ``places`` (n, 2) m of all nodes, ``rotations`` (r,) rad of nodes that have one."""

    frames: Floats
    eta: Floats
    ends: Floats
    energy: float
    loads: Floats
    places: Floats
    rotations: Floats


@checked
def configuration(member: ReducedMember, at: Mapping[str, float]) -> Configuration:
    """The static equilibrium of a member whose frames are held.

    Args:
        at: values of ``FRAME_COORDINATES`` in m and rad; others are those of the member at rest, from the
            origin along x.

    Raises:
        InputError: an unknown coordinate, frames at one place, or beyond the tables.
        SolverError: no equilibrium was found, as of a member that buckles.
    """
    frames = np.array([0.0, 0.0, 0.0, member.length, 0.0, 0.0])
    for name, value in at.items():
        if name not in FRAME_COORDINATES:
            raise InputError(
                f"a planar member has no coordinate {name!r}; {nearest(name, FRAME_COORDINATES)}",
                kind="unknown",
                keyword="at",
            )
        frames[FRAME_COORDINATES.index(name)] = value
    if not np.hypot(*(frames[3:5] - frames[:2])) > TOL.least_chord * member.length:
        raise InputError(
            "both frames of a planar member were given at one place; expected a distance near its length",
            kind="value",
            keyword="at",
        )
    q = member.start(frames)
    left = member.outside(q)
    if left is not None:
        raise InputError(
            f"the frames turn an end by {left[1]:.4g} rad to the chord, beyond the tables of +-{left[2]:.4g} rad; take "
            "frames within, or reduce the member again with a larger reach",
            keyword="at",
        )
    for _ in range(TOL.configuration_iterations):
        state = member.at(q)
        stiffness = np.asarray(state.stiffness())[6:, 6:]
        step = np.linalg.solve(stiffness, -state.force[6:]) if member.modes else np.zeros(0)
        if member.modes and np.linalg.eigvalsh(stiffness)[0] <= 0:
            raise SolverError(
                "the member is not stable between these frames, as one that buckles; take others", keyword="at"
            )
        q[6:] += step
        moved = float(np.abs(step * member.data.peaks[: member.modes]).max(initial=0.0))
        if moved <= TOL.configuration_step * member.length:
            break
    else:
        raise SolverError("no equilibrium was found between these frames; take frames nearer to those at rest")
    state, fields = member.at(q), member.data.fields
    nodes = member.nodes(state.x)
    return Configuration(
        frames=frames,
        eta=q[6:],
        ends=member.chord(q)[2],
        energy=state.V,
        loads=np.asarray(state.force[:6]),
        places=nodes[fields.translations],
        rotations=nodes[fields.turning] if fields.turn.any() else np.zeros(0),
    )
