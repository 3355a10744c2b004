"""A body file and a trajectory make a time series for ParaView: displacements, stresses and what to say of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.body.file import read_body
from morembs.body.stored import StoredBodies, StoredBody
from morembs.body.stored_check import check_grid
from morembs.body.stress_shapes import Recovery
from morembs.body.vtkhdf_series import read_grid, stored_recovery, write_series
from morembs.errors import InputError, nearest
from morembs.model.stress_operator import von_mises
from morembs.progress import SILENT, Progress
from morembs.recovery.expansion import Expander, expand, is_reduced, reduced_coordinates
from morembs.recovery.trajectory import Trajectory, read_trajectory
from morembs.storage.safefile import check_writable
from morembs.storage.table_check import refuse_not_finite

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SERIES = (".vtkhdf", ".hdf")
# Jumps between elements, relative to the largest stress, from which its mesh is called coarse.
LARGE_JUMP = 0.05
# Displacements within the frame, relative to the size of the body, that no linear body should have.
LARGE_DISPLACEMENT = 0.3
# Coordinates that hold the static response to interface loads.
STATIC_KINDS = ("constraint", "attachment")


@dataclass(frozen=True, kw_only=True)
class Recovered:
    """What ``recover`` wrote; ``peak`` is the largest von Mises stress in Pa, the label of its node and its time in s.

    ``peak_jump`` Pa is how far elements around that node miss the average then, ``worst_jump`` the largest of these
    anywhere and at any time, as ``peak``. ``notes`` say what the file lacks.
    """

    path: Path
    body: str
    steps: int
    nodes: int
    peak: tuple[float, int, float] | None = None
    peak_jump: float | None = None
    worst_jump: tuple[float, int, float] | None = None
    notes: tuple[str, ...] = ()


def recover(
    body_file: str | Path, trajectory_file: str | Path | Trajectory, out: str | Path, *, body: str | None = None,
    stress: bool = True, scale: float = 1.0, every: int = 1, progress: Progress = SILENT,
) -> Recovered:  # fmt: skip
    """Write a trajectory at the nodes of a body as a VTKHDF time series for ParaView.

    Point data: displacement, motion (where a frame moves, or deformations are magnified by ``scale``; warp by this
    one), and with ``stress`` the tensor stress (xx, yy, zz, xy, yz, zx along the body's axes), von_mises and, where the
    file has it, von_mises_jump (how far elements miss the average around a node) in Pa.
    A node where materials meet shows the stress with the larger von Mises; nodes without stress are NaN.

    Args:
        body: name of the body; may be left out where the file has one only.
        every: n to take every n-th step.

    Raises:
        InputError: files that cannot be read or do not fit each other, or an option out of range.
        OutputError: ``out`` cannot be written; a file that was there before is unchanged.

    >>> path = write_body("bar.h5", [body])
    >>> rest = Trajectory(times=np.array([0.0, 1.0]), coordinates=np.zeros((2, 18)))
    >>> recover(path, rest, "bar.vtkhdf", stress=False).steps
    2
    """
    place, target = Path(body_file), Path(out)
    _check_options(place, trajectory_file, target, scale, every)
    source = read_body(place)
    chosen = choose_body(place, source, body)
    whole = trajectory_file if isinstance(trajectory_file, Trajectory) else read_trajectory(trajectory_file)
    trajectory = whole.part(slice(None, None, every))
    reduced_coordinates(chosen, trajectory.part(slice(0, 1)))
    recovery = stored_recovery(place, chosen.name, stress=stress)
    if stress and recovery is None:
        raise InputError(
            f"{place}: body {chosen.name!r} has no stress recovery; write the file with [stress], or ask for no stress"
        )
    if recovery is not None:
        _check_recovery(place, chosen, recovery)
    grid = read_grid(place)
    check_grid(place, len(source.node_ids), grid.points, grid.connectivity, grid.offsets, grid.types)
    progress.stage(f"expanding {chosen.name}")
    shown = _Shown(recovery, source) if recovery is not None and stress else None
    moved = trajectory.position is not None or trajectory.rotation is not None or scale != 1.0
    wanted = {"displacement": 3, **({"motion": 3} if moved else {}), **({} if shown is None else shown.widths)}

    far = _Far(source, is_reduced(chosen, trajectory))

    def steps() -> Iterator[Mapping[str, Any]]:
        for block in Expander(source, chosen, recovery, scale).blocks(trajectory):
            for number, time in enumerate(block.times):
                step = {"displacement": block.displacement[number]}
                far.look(block.displacement[number], float(time))
                if block.motion is not None:
                    step["motion"] = block.motion[number]
                if shown is not None and block.stress is not None:
                    jump = None if block.jump is None else block.jump[number]
                    step |= shown.fields(block.stress[number], jump, float(time))
                yield step

    def notes() -> tuple[str, ...]:
        about = () if shown is None else shown.notes()
        return (*_still(chosen, trajectory), *far.notes(), *_uncorrected(chosen, recovery, trajectory, stress), *about)

    write_series(target, grid, trajectory.times, wanted, steps(), progress, notes=notes)
    return Recovered(
        path=target, body=chosen.name, steps=len(trajectory.times), nodes=len(grid.points),
        peak=None if shown is None else shown.peak, peak_jump=None if shown is None else shown.peak_jump,
        worst_jump=None if shown is None else shown.worst_jump, notes=notes(),
    )  # fmt: skip


def _check_recovery(path: Path, body: StoredBody, recovery: Recovery) -> None:
    """Shapes that are not finite, or lack what the frame of the body follows.

    Raises:
        InputError: there are some.
    """
    group = f"bodies/{body.name}/recovery"
    for name in ("stress", "correction", "displacement", "jump", "jump_correction"):
        if getattr(recovery, name) is not None:
            refuse_not_finite(path, f"{group}/{name}", getattr(recovery, name))
    if recovery.jump is not None and (recovery.jump_point is None or recovery.jump_element is None):
        raise InputError(f"{path} is incomplete; missing: /{group}/jump_point or jump_element; write it again")
    if (point := recovery.jump_point) is not None:
        last = len(recovery.points) - 1
        if not np.array_equal(np.unique(point), np.arange(last + 1)) or np.any(np.diff(point) < 0):
            raise InputError(
                f"{path}: /{group}/jump_point does not ascend from 0 to {last}, the last point, over all of them; the "
                "file is damaged, write it again"
            )
    followed = () if body.floating is None or recovery.displacement is None else body.floating.interfaces
    for name in followed:
        if name not in recovery.markers:
            raise InputError(
                f"{path} is an incomplete body file; missing: /bodies/{body.name}/recovery/markers/{name}, which the "
                "frame follows; write it again"
            )


def _uncorrected(body: StoredBody, recovery: Recovery | None, trajectory: Trajectory, stress: bool) -> tuple[str, ...]:
    """Notes on what lacks its mode-acceleration correction, and why."""
    if not body.input_matrix.shape[1]:
        return ()
    loads = trajectory.loads
    held = {"stress": recovery is not None and recovery.correction is not None,
            "displacements": recovery is not None and recovery.displacement is not None}  # fmt: skip
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


class _Far:
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
        if self.largest <= LARGE_DISPLACEMENT * self.size or not self.size:
            return ()
        return (
            f"the body deforms by {self.largest:.3g} m at {self.time:g} s and is {self.size:.3g} m large: check the "
            "units of the coordinates (SI); a linear body is right up to about a tenth of its size",
        )


class _Shown:
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
            notes.append("the file does not tell stresses of single elements, so nothing says whether the mesh is too "
                         "coarse for them (jump = true in [stress])")  # fmt: skip
        if self.peak is not None and self.peak_jump is not None and self.peak_jump > LARGE_JUMP * self.peak[0]:
            notes.append(
                f"around node {self.peak[1]} with the largest stress, elements miss the average by "
                f"{self.peak_jump / self.peak[0]:.0%}: the mesh is coarse there, and the true stress may be larger by "
                "as much or more; refine it and compare"
            )
        return tuple(notes)


def _still(body: StoredBody, trajectory: Trajectory) -> tuple[str, ...]:
    """A note on a body that floats, of which only the elastic coordinates were given."""
    if body.floating is None or trajectory.coordinates.shape[1] == len(body.stiffness_matrix):
        return ()
    missing = [name for name in ("position", "rotation") if getattr(trajectory, name) is None]
    what = " and ".join(missing)
    still = "motions are those seen from the body's frame" if len(missing) == 2 else f"the {what} of the frame is fixed"
    return (f"no {what} of the frame was given: {still}; give it to see the body move",) if missing else ()


def choose_body(path: Path, source: StoredBodies, name: str | None) -> StoredBody:
    """The body called ``name``, or the only one.

    Raises:
        InputError: there is none of that name, or no name and several bodies.
    """
    names = list(source.bodies)
    if name is None and len(names) > 1:
        raise InputError(f"{path} holds {len(names)} bodies; name one of {', '.join(names)}")
    if name is not None and name not in names:
        raise InputError(f"{path} holds no body {name!r}; {nearest(name, names)}")
    return source.bodies[names[0] if name is None else name]


def _check_options(place: Path, trajectory: str | Path | Trajectory, target: Path, scale: float, every: int) -> None:
    if target.suffix not in SERIES:
        raise InputError(f"{target} was given for the result; expected a name that ends with {' or '.join(SERIES)}")
    for given in (place, *(() if isinstance(trajectory, Trajectory) else (Path(trajectory),))):
        if given.resolve() == target.resolve():
            raise InputError(f"{target} would overwrite what it is made from; give the result another name")
    if not np.isfinite(scale):
        raise InputError(f"scale = {scale} was given; expected a number, 1 for true deformations")
    if every < 1:
        raise InputError(f"every = {every} was given; expected n = 1 or more, to take every n-th step")
    check_writable(target)


__all__ = ["Recovered", "Trajectory", "expand", "read_trajectory", "recover"]
