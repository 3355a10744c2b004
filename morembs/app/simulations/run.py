"""Runs a system file: bodies from their files, a run of the simulator, and the file of its result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from morembs.app.simulations.build import build
from morembs.app.simulations.built import Built, told_of
from morembs.app.simulations.check import checked_start, warnings_of
from morembs.app.simulations.histories import histories, kept_rows, select_rows
from morembs.app.simulations.report import outline
from morembs.app.simulations.result_file import Recording, write_recording
from morembs.app.simulations.system_file import SystemFile
from morembs.app.simulations.tables import ObserveTable
from morembs.base.errors import InputError, nearest
from morembs.base.memory import PeakMemory
from morembs.base.progress import Progress, Stage, Stopwatch, listening
from morembs.body.recovery.recover import Recovered, recover
from morembs.body.recovery.trajectory import Trajectory
from morembs.dynamics.multibody import FlexibleBody, Result, equilibrium, simulate, simulate_contact, simulate_sliding
from morembs.storage.contents import keeping_ledger
from morembs.version import VERSION


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationResult:
    """A finished run: files that were written, time and memory."""

    built: Built
    result: Result
    recording: Recording
    stages: tuple[Stage, ...]
    peak_memory_bytes: int
    observed: tuple[Recovered, ...] = ()

    def document(self) -> dict[str, Any]:
        """All there is to tell, SI units."""
        file = self.built.file
        return {
            "job": str(file.path),
            "output": str(file.output),
            **outline(self.recording),
            "stress": {
                each.body: dict(zip(("von_mises_pa", "node", "time_s"), each.peak, strict=True))
                for each in self.observed
                if each.peak is not None
            },
            "notes": [f"{each.path.name}: {note}" for each in self.observed for note in each.notes],
            "written": [str(path) for _, path in file.results()],
            "seconds": {stage.name: stage.seconds for stage in self.stages},
            "peak_memory_bytes": {stage.name: stage.peak_memory_bytes for stage in self.stages},
            "job_peak_memory_bytes": self.peak_memory_bytes,
        }


@keeping_ledger()
def run_system(
    file: SystemFile, progress: Progress | None = None, warn: Callable[[str], None] = lambda _: None
) -> SimulationResult:
    """Simulate the system of ``file`` and write its results; ``warn`` hears what to know before the run begins.

    Raises:
        MorembsError: input that cannot be used, a run that cannot go on, with its time, or a result that cannot be
            written.
    """
    file.prepare_output()
    with listening(progress), PeakMemory() as memory:
        watch = Stopwatch(memory)
        with keeping_ledger() as ledger, watch.stage("read"):
            built = build(file)
            checked_start(built)
            for sentence in warnings_of(built):
                warn(sentence)
        with watch.stage("simulate"):
            result = run_simulation(built)
        with watch.stage("motions"):
            rows = kept_rows(result, file.tables.output.every)
            values = histories(built, result, rows)
        with watch.stage("write"):
            observed = [_observe_body(built, select_rows(result, rows), table) for table in file.tables.observe]
            recording = Recording(
                **values,
                system=file.text,
                changes=file.changes,
                warnings=warnings_of(built),
                provenance={
                    "created": datetime.now(UTC).isoformat(timespec="seconds"),
                    "morembs_version": VERSION,
                    "inputs": [{"file": name, "sha256": each.sha256} for name, each in ledger.contents().items()],
                    "seconds": {stage.name: stage.seconds for stage in watch.stages},
                },
            )
            write_recording(file.output, recording)
    return SimulationResult(
        built=built,
        result=result,
        recording=recording,
        stages=tuple(watch.stages),
        peak_memory_bytes=watch.peak_memory_bytes,
        observed=tuple(observed),
    )


def run_simulation(built: Built) -> Result:
    """The run that the tables ask for.

    Raises:
        InputError, SolverError: what the simulator refuses.
    """
    times, still, start = built.tables.simulation, built.tables.equilibrium, None
    steps = {"begin": times.begin, "end": times.end, "step": times.step, "rho": times.rho, "tolerance": times.tolerance}
    given: dict[str, Any] = {**steps, "max_deflection": times.deflection}
    if built.switch is not None:
        return simulate_sliding(built.system, built.switch, **given)
    given["corrected_start"] = times.corrected_start
    if built.contacts:
        return simulate_contact(built.system, list(built.contacts.values()), **given)
    if still is not None:
        start = equilibrium(built.system, load_steps=still.load_steps, tolerance=still.tolerance, time=times.begin)
    return simulate(built.system, start=start, **given)


def _observe_body(built: Built, result: Result, table: ObserveTable) -> Recovered:
    """The moving mesh of a body, in its file.

    Raises:
        InputError: a body without a mesh, or without the stresses that are asked for.
    """
    with told_of("observe", table.body):
        moving = built.bodies.get(table.body)
        if not isinstance(moving, FlexibleBody):
            raise InputError(
                f"body = {table.body!r} is not of a body file, which has a mesh; {nearest(table.body, built.files)}",
                kind="unknown",
                keyword="body",
            )
        place, bodies, body = built.files[table.body]
        stress = bool(body.recovery) if table.stress is None else table.stress
        framed = [name for name in bodies.interfaces if name in built.markers[table.body]]
        loads = framed if stress and len(framed) == len(bodies.interfaces) else []
        motion = Trajectory(**result.trajectory(moving, loads))
        return recover(
            place,
            motion,
            built.file.resolve(table.path),
            body=body.name,
            stress=stress,
            scale=table.scale,
            every=table.every,
        )
