"""Checks a system file: what will run, and what to know before it does."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from morembs.app.simulations.build import build
from morembs.app.simulations.built import Built
from morembs.app.simulations.laws import LawTable, MotionTable
from morembs.app.simulations.system_file import SystemFile
from morembs.app.simulations.tables import SystemTables
from morembs.app.simulations.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.progress import Progress, listening
from morembs.base.units import in_hz
from morembs.dynamics.gmp import ParameterisedBody
from morembs.dynamics.multibody import FlexibleBody, System
from morembs.dynamics.multibody.system import Assembly
from morembs.storage.contents import keeping_ledger


@dataclass(frozen=True, kw_only=True)
class SystemForecast:
    """What a system file asks for: bodies with their coordinates, constraints, steps, memory of the states."""

    bodies: dict[str, str]
    joints: int
    forces: int
    coordinates: int
    constraints: int
    degrees_of_freedom: int
    steps: int
    memory_bytes: int
    result_bytes: int
    lowest_frequency_hz: float | None
    warnings: list[str]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


@keeping_ledger()
def check_system(file: SystemFile, progress: Progress | None = None) -> SystemForecast:
    """Check all that can be checked without a step, and say what will run.

    Raises:
        MorembsError: what ``run_system`` would refuse too.
    """
    file.prepare_output()
    with listening(progress):
        built = build(file)
        assembly = checked_start(built)
        x = assembly.start()[0]
        steps, markers = file.tables.simulation.steps, sum(map(len, built.markers.values()))
        # Configuration, velocity, acceleration and multipliers, once as states and once joined.
        state = len(x) + 2 * assembly.size + assembly.rows
        kept = steps // file.tables.output.every + 1
        row = len(x) + assembly.size + 18 * markers + 6 * len(built.joints) + 4
        lowest = lowest_frequencies(built)
        return SystemForecast(
            bodies={name: f"{built.kinds[name]}, {body.size} coordinates" for name, body in built.bodies.items()},
            joints=len(built.joints),
            forces=len(built.forces),
            coordinates=assembly.size,
            constraints=assembly.rows,
            degrees_of_freedom=assembly.size - assembly.rows,
            steps=steps,
            memory_bytes=2 * 8 * state * steps + 8 * row * kept,
            result_bytes=8 * row * kept,
            lowest_frequency_hz=min(lowest.values(), default=None),
            warnings=list(warnings_of(built)),
        )


def lowest_frequencies(built: Built) -> dict[str, float]:
    """The lowest elastic frequency in Hz of each elastic body, free, by name."""
    lowest = {}
    for name, body in built.bodies.items():
        if isinstance(body, FlexibleBody) and body.inertia.n:
            system = System()
            x, v = body.start()
            M, _ = body.dynamics(0.0, x, np.zeros_like(v), system.gravity)
            # Free of forces the frame follows: what is left of the mass of the elastic coordinates.
            Me = M[6:, 6:] - M[6:, :6] @ np.linalg.solve(M[:6, :6], M[:6, 6:])
            square = float(np.linalg.eigvals(np.linalg.solve(Me, body.Ke)).real.min())
            lowest[name] = float(in_hz(np.sqrt(max(square, 0.0))))
    return lowest


def refuse_unresolved(tables: SystemTables) -> list[str]:
    """Warnings about sines that steps follow roughly.

    Raises:
        InputError: sines that steps do not follow at all: their samples have another frequency.
    """
    step, warnings = tables.simulation.step, []
    laws: list[tuple[str, LawTable | MotionTable | None]] = []
    laws += [(f"[[load]] {table.name!r}", table.law) for table in tables.load]
    laws += [(f"[[joint]] {table.name!r}", table.motion) for table in tables.joint]
    for where, law in laws:
        hz = 0.0 if law is None else law.frequency_hz or 0.0
        if not hz * step > 1 / TOL.steps_per_period:
            continue
        message = (
            f"{where}: a sine of {hz:g} Hz was given, of which a step of {step:g} s leaves {1 / (step * hz):.2g} in a "
            f"period; take step = {1 / (hz * TOL.steps_per_period):.1g}"
        )
        if hz * step > 1 / TOL.sampled_steps_per_period:
            raise InputError(message)
        warnings.append(message)
    return warnings


def warnings_of(built: Built) -> tuple[str, ...]:
    """What to know before the run begins: steps that do not resolve motions, bodies of other units.

    Raises:
        InputError: steps that do not follow a sine at all.
    """
    warnings, step = refuse_unresolved(built.tables), built.tables.simulation.step
    for name, hz in lowest_frequencies(built).items():
        if hz > 0 and step * hz > 1 / TOL.steps_per_period:
            warnings.append(
                f"body {name!r}: its lowest elastic frequency is {hz:.4g} Hz, of which a step of {step:g} s leaves "
                f"{1 / (step * hz):.2g} in a period: it bends quasi-statically, for its vibration take step = "
                f"{1 / (hz * TOL.steps_per_period):.1g}"
            )
    return (*warnings, *_without_weight(built), *_units_in_doubt(built))


def _without_weight(built: Built) -> list[str]:
    """A sentence for each member that gravity pulls out of its plane alone."""
    gravity = np.array(built.tables.gravity.acceleration)
    size = float(np.linalg.norm(gravity))
    return [
        f"member {name!r}: gravity is across its plane and does not move it; turn the member by its rotation, such as "
        "{ axis = [1, 0, 0], degrees = 90 }"
        for name, body in built.bodies.items()
        if isinstance(body, ParameterisedBody)
        and size > 0
        and np.linalg.norm(gravity @ body.axes[:, :2]) <= TOL.gravity_in_plane * size
    ]


def _units_in_doubt(built: Built) -> list[str]:
    """A sentence on elastic bodies whose sizes are as different as units are."""
    sizes = {name: body.length for name, body in built.bodies.items() if isinstance(body, FlexibleBody)}
    if not sizes or max(sizes.values()) <= TOL.size_ratio * min(sizes.values()):
        return []
    large, small = max(sizes, key=sizes.__getitem__), min(sizes, key=sizes.__getitem__)
    return [
        f"body {large!r} is {sizes[large]:.4g} m long and body {small!r} {sizes[small]:.4g} m: if that is wrong, the "
        "job of one of them has other [model] units than its mesh"
    ]


def checked_start(built: Built) -> Assembly:
    """The system with its coordinates, whose joints are closed at the start.

    Raises:
        InputError: joints that are open or redundant, or velocities that violate them.
    """
    assembly = Assembly(built.system)
    if built.tables.equilibrium is None:
        try:
            assembly.check_start(built.tables.simulation.begin, *assembly.start())
        except InputError as error:
            raise error.restate("; ".join([str(error), *_units_in_doubt(built)])) from error
    return assembly
