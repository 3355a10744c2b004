"""Modes of the full model of a job, real or complex; tables and pictures of modes over the speed."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from morembs.app.jobs.picture import save
from morembs.app.jobs.solver import SolverTable, budget_of, solver_of
from morembs.app.jobs.stages.couple import damping_of, interfaces_of
from morembs.app.jobs.stages.member_table import MemberTable
from morembs.app.jobs.stages.model import materials_of
from morembs.app.jobs.stages.preload import PreloadTable, preload_of
from morembs.app.jobs.stages.spin import SpinTable, rotation_of
from morembs.app.jobs.stages.stage import MODEL, Work, computes_modes, run_stages, select_stages
from morembs.app.jobs.style import STYLE
from morembs.app.jobs.tables import Job, ModesTable
from morembs.app.jobs.tolerances import TOL
from morembs.base.charts import COLORS
from morembs.base.errors import InputError
from morembs.base.memory import PeakMemory, resident_bytes
from morembs.base.progress import Progress, Stopwatch, listening
from morembs.body.floating.preload import apply_preload
from morembs.body.floating.spin import Whirl, whirl_of
from morembs.body.floating.spinning import Spin, assemble_spin
from morembs.body.floating.spinning_modes import modes_over_speed, still_modes
from morembs.linalg.complex_modes import ComplexModes
from morembs.linalg.eigen import Modes
from morembs.linalg.sparse.threads import limit_threads
from morembs.problem import Problem
from morembs.storage.safefile import replacing

WHIRL_COLORS = dict(zip(("forward", "backward", "mixed"), COLORS, strict=False))


@dataclass(frozen=True, kw_only=True)
class ModeRow:
    """One mode: ``speed`` rad/s; damped frequency in Hz, damping ratio, real part in 1/s, ``residual`` where it is of a
    full model. ``whirl`` and the whirl speed ``inertial_hz`` of an observer at rest are of a body that spins."""

    speed: float
    number: int
    damped_hz: float
    ratio: float
    real: float
    residual: float = math.nan
    whirl: str = ""
    inertial_hz: float = math.nan


@dataclass(frozen=True, kw_only=True)
class ModeTable:
    """Modes of a job; ``complete`` says for each speed below which frequency no mode is missing, or why none counts."""

    rows: tuple[ModeRow, ...]
    complete: Mapping[float, str]
    warnings: tuple[str, ...] = ()


def job_modes(job: Job, *, complex_: bool, count: int, progress: Progress | None = None) -> ModeTable:
    """The ``count`` lowest modes of the full model of ``job``; complex ones at every speed of [spin].

    Raises:
        MorembsError: input that cannot be used, or a model that nothing holds where complex modes are wanted.
    """
    if MemberTable.of(job) is not None:
        raise InputError("[member] was given; morembs modes takes a job with a mesh or a model", keyword="member")
    start, solver = resident_bytes(), solver_of(job)
    materials_of(job)  # faults of materials are told before the mesh is read
    with (
        listening(progress),
        limit_threads(SolverTable.of(job).threads),
        budget_of(job, solver),
        PeakMemory() as memory,
    ):
        work = Work(job=job, solver=solver, start=start, watch=Stopwatch(memory), counts_modes=computes_modes(job))
        run_stages(work, select_stages(job), until=MODEL)
        model = work[MODEL]
        interfaces, damping = interfaces_of(job, model), damping_of(job)
        problem = Problem(model, interfaces, solver=solver, damping=damping)
        rotation = rotation_of(job) if SpinTable.of(job) is not None else None
        if PreloadTable.of(job) is not None:
            with problem:
                model = apply_preload(problem, preload_of(job)).model
            problem = Problem(model, interfaces, solver=solver, damping=damping)
        with problem:
            if not complex_:
                return _real(problem, count)
            if rotation is None:
                modes = still_modes(problem, ModesTable.of(job).held, count)
                return ModeTable(rows=tuple(_rows(0.0, modes, None)), complete={0.0: _complete(modes)})
            if ModesTable.of(job).held:
                raise InputError(
                    "[modes] held was given beside [spin], which has its own; leave it out",
                    kind="conflict",
                    keyword="modes",
                )
            spin = assemble_spin(problem, rotation[0])
            full = modes_over_speed(problem, spin, rotation[1], count)
            return _over_speed(problem, spin, full)


def _real(problem: Problem, count: int) -> ModeTable:
    whole = problem.elastic_modes(count=count) if problem.D is None else _whole(problem, count)
    modes, decay = whole.first(count), _decays(problem, whole)[:count]
    omega = 2 * np.pi * modes.frequencies_hz
    # The roots of s^2 + 2 d s + w^2, of an overdamped mode that which decays least.
    s = np.sqrt(decay**2 - omega**2 + 0j) - decay
    hz, ratios, real = (s.imag / (2 * np.pi)).tolist(), (decay / omega).tolist(), s.real.tolist()
    rows = tuple(
        ModeRow(speed=0.0, number=k + 1, damped_hz=hz[k], ratio=ratios[k], real=real[k]) for k in range(len(omega))
    )
    complete = f"complete below {math.sqrt(modes.verified_below) / (2 * math.pi):.6g} Hz"
    complete += " without damping" if decay.any() else ""
    warnings = []
    if not problem.symmetric:
        warnings.append("modes of M and the symmetric K alone; --complex has the gyroscopic and circulatory matrix too")
    if problem.D is not None:
        warnings.append("damping ratios are those of each real mode by itself; --complex has what D couples of them")
    return ModeTable(rows=rows, complete={0.0: complete}, warnings=tuple(warnings))


def _whole(problem: Problem, count: int) -> Modes:
    """The lowest ``count`` modes and as many more as share the frequency of the last, where there are so many."""
    max_count = max(count, problem.K.shape[0] - problem.rigid.shape[1])
    while count < max_count:
        modes = problem.elastic_modes(count=count + 1)
        last, beyond = modes.frequencies_hz[-2:]
        if beyond - last > TOL.same_frequency * beyond:
            return modes
        count += 1
    return problem.elastic_modes(count=count)


def _decays(problem: Problem, modes: Modes) -> NDArray[np.float64]:
    """Half of the damping in 1/s of each real mode (m,) by itself."""
    damping = problem.damping.at_resonance(modes.eigenvalues)
    if problem.D is None:
        return 0.5 * damping
    omega, P = modes.frequencies_hz, modes.vectors.T @ np.asarray(problem.D @ modes.vectors)
    # Modes of one frequency are any of their span: those that D does not couple have damping of their own.
    together = np.split(np.arange(len(omega)), 1 + np.flatnonzero(np.diff(omega) > TOL.same_frequency * omega[1:]))
    return np.asarray(0.5 * (damping + np.concatenate([np.linalg.eigvalsh(P[np.ix_(k, k)]) for k in together])))


def _over_speed(problem: Problem, spin: Spin, full: Mapping[float, ComplexModes]) -> ModeTable:
    rows: list[ModeRow] = []
    for speed, modes in full.items():
        rows += _rows(speed, modes, whirl_of(modes.eigenvalues, modes.vectors, spin.C, spin.S, problem.M, speed))
    complete = {speed: _complete(modes) for speed, modes in full.items()}
    return ModeTable(rows=tuple(rows), complete=complete, warnings=spin.warnings)


def _rows(speed: float, modes: ComplexModes, whirl: Whirl | None) -> list[ModeRow]:
    rows = whirl_rows(Whirl.unknown(modes.eigenvalues, speed) if whirl is None else whirl)
    return [
        ModeRow(**{**vars(row), "residual": float(residual)})
        for row, residual in zip(rows, modes.residuals, strict=True)
    ]


def whirl_rows(whirl: Whirl) -> list[ModeRow]:
    """Rows of the modes at one speed."""
    return [
        ModeRow(
            speed=whirl.speed,
            number=k + 1,
            damped_hz=float(s.imag) / (2 * math.pi),
            real=float(s.real),
            ratio=float(-s.real / abs(s)) + 0.0 if s else 0.0,
            whirl=word,
            inertial_hz=float(w) / (2 * math.pi),
        )
        for k, (s, word, w) in enumerate(zip(whirl.eigenvalues, whirl.whirl, whirl.inertial, strict=True))
    ]


def _complete(modes: ComplexModes) -> str:
    if not modes.verified_below:
        return f"no count of modes: {modes.no_count}"
    return f"complete below {modes.verified_below / (2 * math.pi):.6g} Hz"


def write_csv(path: Path, rows: Sequence[ModeRow]) -> None:
    """A table with a row for each mode, empty where there is no value.

    Raises:
        OutputError: the file cannot be written.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["speed_rad_s", "mode", "damped_hz", "ratio", "real_1_s", "whirl", "inertial_hz", "residual"])
    for row in rows:
        numbers = (row.damped_hz, row.ratio, row.real, row.inertial_hz, row.residual)
        hz, ratio, real, inertial, residual = ("" if math.isnan(x) else repr(x) for x in numbers)
        table.writerow([repr(row.speed), row.number, hz, ratio, real, row.whirl, inertial, residual])
    with replacing(path) as file:
        file.write(text.getvalue().encode())


def draw_campbell(path: Path, rows: Sequence[ModeRow], title: str) -> None:
    """The Campbell diagram, damped frequencies over the speed in the frame that turns.

    Raises:
        OutputError: the file cannot be written.
    """
    figure = Figure(figsize=(8.0, 5.0), dpi=STYLE.dots_per_inch, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for word, color in WHIRL_COLORS.items():
        chosen = [(row.speed, row.damped_hz) for row in rows if row.whirl == word]
        if chosen:
            axes.plot(*np.array(chosen).T, ".", color=color, markersize=4, label=word)
    top = max(row.damped_hz for row in rows)
    speeds = np.array([min(row.speed for row in rows), max(row.speed for row in rows)])
    axes.plot(
        speeds,
        speeds / (2 * math.pi),
        color="#607d8b",
        linewidth=STYLE.limit_line,
        linestyle=(0, (6, 3)),
        label="speed",
    )
    axes.set_ylim(0, STYLE.frequency_room * top)
    axes.set_title(title, loc="left")
    axes.set_xlabel("speed in rad/s")
    axes.set_ylabel("frequency in the frame that turns, Hz")
    axes.grid(True, color="#d0d4d8", linewidth=STYLE.grid_line)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, ncols=4, loc="lower right", bbox_to_anchor=(1, 1))
    save(figure, path)
