"""A body file and a trajectory make a time series for ParaView: displacements, stresses and what to say of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from morembs.base import progress
from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.limits import number
from morembs.body.body import Body
from morembs.body.file import read_body
from morembs.body.recovery.expansion import Expander, Expansion, expand, is_reduced, reduced_coordinates
from morembs.body.recovery.shown import LargestDisplacement, ShownStress, notes_on_correction, notes_on_frame
from morembs.body.recovery.trajectory import Trajectory, read_trajectory
from morembs.body.recovery_shapes import Recovery
from morembs.body.stored import StoredBodies, choose_body
from morembs.body.stored_check import check_grid
from morembs.body.vtkhdf_series import read_grid, stored_recovery, write_series
from morembs.storage.contents import keeping_ledger
from morembs.storage.safefile import check_writable

SERIES = (".vtkhdf", ".hdf")


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


@keeping_ledger()
def recover(
    body_file: str | Path,
    trajectory_file: str | Path | Trajectory,
    out: str | Path,
    *,
    body: str | None = None,
    stress: bool = True,
    scale: float = 1.0,
    every: int = 1,
) -> Recovered:
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
    _check_options(target, scale, every)
    source = read_body(place)
    chosen = choose_body(source, body, place)
    whole = trajectory_file if isinstance(trajectory_file, Trajectory) else read_trajectory(trajectory_file)
    trajectory = whole.part(slice(None, None, every))
    reduced_coordinates(chosen, trajectory.part(slice(0, 1)))
    recovery = _recovery_of(place, chosen, stress)
    grid = read_grid(place)
    check_grid(place, len(source.node_ids), grid.points, grid.connectivity, grid.offsets, grid.types)
    progress.stage(f"expanding {chosen.name}")
    shown = ShownStress(recovery, source) if recovery is not None and stress else None
    far = LargestDisplacement(source, is_reduced(chosen, trajectory))
    moved = trajectory.position is not None or trajectory.rotation is not None or scale != 1.0
    wanted = {"displacement": 3, **({"motion": 3} if moved else {}), **({} if shown is None else shown.widths)}
    steps = _steps(Expander(source, chosen, recovery, scale).blocks(trajectory), far, shown)

    def notes() -> tuple[str, ...]:
        about = () if shown is None else shown.notes()
        lacking = notes_on_correction(chosen, recovery, trajectory, stress)
        return (*notes_on_frame(chosen, trajectory), *far.notes(), *lacking, *about)

    write_series(target, grid, trajectory.times, wanted, steps, notes=notes, beside=_beside(source))
    return Recovered(
        path=target,
        body=chosen.name,
        steps=len(trajectory.times),
        nodes=len(grid.points),
        peak=None if shown is None else shown.peak,
        peak_jump=None if shown is None else shown.peak_jump,
        worst_jump=None if shown is None else shown.worst_jump,
        notes=notes(),
    )


def _steps(
    blocks: Iterable[Expansion], far: LargestDisplacement, shown: ShownStress | None
) -> Iterator[Mapping[str, Any]]:
    """Fields of each step by their names; what is noted of all of them is known behind the last."""
    for block in blocks:
        for row, time in enumerate(block.times):
            step = {"displacement": block.displacement[row]}
            far.look(block.displacement[row], float(time))
            if block.motion is not None:
                step["motion"] = block.motion[row]
            if shown is not None and block.stress is not None:
                jump = None if block.jump is None else block.jump[row]
                step |= shown.fields(block.stress[row], jump, float(time))
            yield step


def _recovery_of(path: Path, body: Body, stress: bool) -> Recovery | None:
    """What the file has for displacements, and with ``stress`` for these.

    Raises:
        InputError: shapes that are asked for and not there, not finite, or lack what the frame of the body follows.
    """
    recovery = stored_recovery(path, body.name, stress=stress)
    if recovery is None:
        if stress:
            raise InputError(
                f"{path}: body {body.name!r} has no stress recovery; write the file with [stress], or leave stress out",
                kind="missing",
                keyword="stress",
            )
        return None
    group = f"bodies/{body.name}/recovery"
    if recovery.jump is not None and (recovery.jump_point is None or recovery.jump_element is None):
        raise InputError(
            f"{path} is incomplete; missing: /{group}/jump_point or jump_element; write it again",
            kind="file",
            keyword=path.name,
        )
    if (point := recovery.jump_point) is not None:
        last = len(recovery.points) - 1
        if not np.array_equal(np.unique(point), np.arange(last + 1)) or np.any(np.diff(point) < 0):
            raise InputError(
                f"{path}: /{group}/jump_point does not ascend from 0 to {last}, the last point, over all of them; the "
                "file is damaged, write it again",
                kind="file",
                keyword=path.name,
            )
    followed = () if body.floating is None or recovery.displacement is None else body.floating.interfaces
    for name in followed:
        if name not in recovery.markers:
            raise InputError(
                f"{path} is an incomplete body file; missing: /bodies/{body.name}/recovery/markers/{name}, which the "
                "frame follows; write it again",
                kind="file",
                keyword=path.name,
            )
    return recovery


def _beside(source: StoredBodies) -> dict[str, Any]:
    """What the viewer shows of a motion beside it: labels of nodes, and interfaces with their frames (4, 3) in m."""
    found: dict[str, Any] = {"node_ids": source.node_ids}
    for name, each in source.interfaces.items():
        found[f"interfaces/{name}/frame"] = np.vstack([each.point, each.axes])
        found[f"interfaces/{name}/node_ids"] = each.node_ids
    return found


def _check_options(target: Path, scale: float, every: int) -> None:
    if target.suffix not in SERIES:
        raise InputError(
            f"{target} was given for the result; expected a name that ends with {' or '.join(SERIES)}", keyword="out"
        )
    check_value("scale", scale, Annotated[float, number("a number, 1 for true deformations")])
    check_value("every", every, Annotated[int, number("n = 1 or more, to take every n-th step", ge=1)])
    check_writable(target)


__all__ = ["Recovered", "Trajectory", "expand", "read_trajectory", "recover"]
