"""Contents of a series that shows a recovery, and its limits: notes for a file and its reader."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.recovery.trajectory import Trajectory
from morembs.body.recovery_shapes import Recovery
from morembs.body.stored import StoredBodies
from morembs.body.tolerances import TOL
from morembs.fem.stress_operator import von_mises

# Coordinates that hold the static response to interface loads.
STATIC_KINDS = ("constraint", "attachment")


class ShownStress:
    """Stress at the nodes of a file from that at the points of a recovery, and the peak so far."""

    def __init__(self, recovery: Recovery, source: StoredBodies) -> None:
        self.recovery, self.count = recovery, len(source.node_ids)
        order = np.argsort(source.node_ids, kind="stable")
        labels = source.node_ids[order]
        at = np.minimum(np.searchsorted(labels, recovery.points), len(labels) - 1)
        self.known = labels[at] == recovery.points
        self.rows = order[at]
        self.widths = {"stress": 6, "von_mises": 1, **({} if recovery.jump is None else {"von_mises_jump": 1})}
        self.peak: tuple[float, int, float] | None = None
        self.worst_jump: tuple[float, int, float] | None = None
        self.peak_jump: float | None = None

    def fields(self, stress: Floats, jump: Floats | None, time: float) -> dict[str, Floats]:
        """Stress (n, 6), von Mises stress (n,) and its jumps (n,) at the nodes, by the names of the fields."""
        size = von_mises(stress)
        before = self.peak
        self.peak = self._larger(before, size, time)
        if jump is not None:
            self.worst_jump = self._larger(self.worst_jump, jump, time)
            self.peak_jump = self.peak_jump if self.peak is before else float(jump[int(np.argmax(size))])
        points = np.flatnonzero(self.known)
        if self.recovery.seams:
            # The last of several assignments stays.
            points = points[np.argsort(size[points], kind="stable")]
        fields = {}
        for (name, width), values in zip(self.widths.items(), (stress, size, jump), strict=False):
            fields[name] = np.full((self.count, width) if width > 1 else self.count, np.nan)
            if values is not None:
                fields[name][self.rows[points]] = values[points]
        return fields

    def _larger(
        self, before: tuple[float, int, float] | None, sizes: Floats, time: float
    ) -> tuple[float, int, float] | None:
        """The largest value so far, its node and its time."""
        top = int(np.argmax(sizes)) if len(sizes) else -1
        if top < 0 or (before is not None and not sizes[top] > before[0]):
            return before
        return float(sizes[top]), int(self.recovery.points[top]), time

    def notes(self) -> tuple[str, ...]:
        """What a user should know about the stress in the file."""
        notes = []
        bare = self.count - len(np.unique(self.rows[self.known]))
        if bare:
            notes.append(
                f"{bare} of {self.count} nodes have no stress recovery; their stress is NaN "
                '(nodes = "all" in [stress] covers them)'
            )
        if not self.known.all():
            lost = len(np.unique(self.recovery.points[~self.known]))
            notes.append(f"{lost} nodes with stress are not among the nodes of the file; they only count for the peak")
        if self.recovery.jump is None:
            notes.append(
                "the file does not tell stresses of single elements, so nothing says whether the mesh is too "
                "coarse for them (jump = true in [stress])"
            )
        if self.peak is not None and self.peak_jump is not None and self.peak_jump > TOL.large_jump * self.peak[0]:
            notes.append(
                f"around node {self.peak[1]} with the largest stress, elements miss the average by "
                f"{self.peak_jump / self.peak[0]:.0%}: the mesh is coarse there, and the true stress may be larger by "
                "as much or more; refine it and compare"
            )
        return tuple(notes)


class LargestDisplacement:
    """Displacements within the frame beside the size of the body: a linear one bends little."""

    def __init__(self, source: StoredBodies, rigid: bool) -> None:
        self.size = 0.0 if rigid else float(np.linalg.norm(np.ptp(source.coordinates, axis=0)))
        self.largest, self.time = 0.0, 0.0

    def look(self, displacement: Floats, time: float) -> None:
        """Take another step into account; displacements (n, 3) m."""
        size = float(np.linalg.norm(displacement, axis=1).max(initial=0.0))
        if size > self.largest:
            self.largest, self.time = size, time

    def notes(self) -> tuple[str, ...]:
        """What to say of displacements that a linear body should not have."""
        if self.largest <= TOL.large_displacement * self.size or not self.size:
            return ()
        return (
            f"the body deforms by {self.largest:.3g} m at {self.time:g} s and is {self.size:.3g} m large: check the "
            "units of the coordinates (SI); a linear body is right up to about a tenth of its size",
        )


def notes_on_frame(body: Body, trajectory: Trajectory) -> tuple[str, ...]:
    """A note on a body that floats, of which only the elastic coordinates were given."""
    if body.floating is None or trajectory.coordinates.shape[1] == len(body.stiffness_matrix):
        return ()
    missing = [name for name in ("position", "rotation") if getattr(trajectory, name) is None]
    what = " and ".join(missing)
    still = "motions are those seen from the body's frame" if len(missing) == 2 else f"the {what} of the frame is fixed"
    return (f"no {what} of the frame was given: {still}; give it to see the body move",) if missing else ()


def notes_on_correction(body: Body, recovery: Recovery | None, trajectory: Trajectory, stress: bool) -> tuple[str, ...]:
    """Notes on what lacks its mode-acceleration correction, and why."""
    if not body.input_matrix.shape[1]:
        return ()
    loads = trajectory.loads
    held = {
        "stress": recovery is not None and recovery.correction is not None,
        "displacements": recovery is not None and recovery.displacement is not None,
    }
    # Static shapes of all interfaces are in the basis: nothing to speak of is missing from displacements.
    complete = any(kind in STATIC_KINDS for kind in body.mode_kind)
    shown = (*(("stress",) if stress else ()), *(() if complete else ("displacements",)))
    able = " and ".join(name for name in shown if held[name])
    unable = " and ".join(name for name in shown if not held[name])
    notes = []
    if able and loads is None:
        notes.append(f"no loads were given, so no mode-acceleration correction is in {able}; give those of the joints")
    elif able and loads is not None and not loads.any():
        notes.append(
            f"all loads are zero, so no mode-acceleration correction is in {able}; right only for a body that nothing "
            "touches"
        )
    if unable:
        unused = "; the loads were not used for them" if loads is not None else ""
        notes.append(
            f"the file has no mode-acceleration correction for {unable}: what the basis misses of them under interface "
            f"loads is not there{unused} (write it again with [stress] and correction = true)"
        )
    return tuple(notes)
