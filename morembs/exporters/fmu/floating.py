"""A body of large rotations: the tables of its floating frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg as sl

from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame
from morembs.exporters.base import ExportContext, refuse_rigid
from morembs.exporters.fmu.linear import damping_parameter
from morembs.exporters.fmu.system import (
    AXES,
    GRAVITY,
    LOADS,
    VELOCITIES,
    System,
    Variable,
    identifiers,
    oscillators,
    renamed_note,
    stress_rows,
    variables,
)
from morembs.exporters.slow_frame import SplitFrame
from morembs.exporters.tolerances import TOL

_QUATERNION = "wxyz"


def floating_system(
    context: ExportContext, *, stress: Sequence[int], damping_ratio: float, time_step: float | None = None
) -> System:
    """The body in its floating frame, as ``morembs.dynamics.multibody`` has it without stiffening.

    Modes that a ``time_step`` in s does not resolve follow loads and spin at once.

    Inputs are gravity, forces and moments at the interfaces that have a frame; outputs are where these are and how
    they move, all along inertial axes, and stresses along the axes of the body. The frame starts where it is in the
    model.

    Raises:
        InputError: a body without a floating frame or interface frames, or with rigid motion in its shapes.
    """
    frame, markers = context.frame, context.markers("a floating body")
    refuse_rigid(context)
    rows = stress_rows(context, stress)
    split = None if time_step is None else SplitFrame.of(frame, time_step)
    if split is not None:
        frame = split.slow_frame
    known = identifiers(markers)
    names = [name for name in known.values() for _ in range(6)]
    inputs = (*GRAVITY, *variables(names, [*range(6)] * len(markers), LOADS, "on the body", start=0.0))
    outputs = [variable for name in known.values() for variable in _motion(name)]
    length = _length(frame)
    tolerance = Variable(
        name="tolerance", unit="1", start=TOL.step_error, about="co-simulation: error of a step per length of the body"
    )
    system = System(
        structure="floating",
        inputs=inputs,
        outputs=(*outputs, *rows.outputs),
        states=_states(frame, length),
        parameters=(damping_parameter(damping_ratio), tolerance),
        tables={
            **_tables(frame),
            "STRESS": rows.shapes @ frame.elastic,
            "STRESS_LOAD": _on_markers(context, rows.loads),
        },
        constants={
            "MODES": frame.count,
            "MARKERS": len(markers),
            "STRESSES": rows.count,
            "DAMPING_RATIO": 0,
            "TOLERANCE": 1,
            "MASS": float(frame.integrals.mass),
            "LENGTH": length,
        },
        buffers={"at_q": 9 * frame.count, "at_rate": 3 * frame.count, "J": 9, "Cr": 3 * frame.count, "moment": 3},
        notes=(*_losses_of(context), *frame.notes, *renamed_note(known)),
    )
    if split is None:
        return system
    stresses = rows.shapes @ context.frame.elastic
    system = replace(system, real_time=split.measure(context.source, stress=stresses))
    return system if split.slow.all() else _with_compliance(system, split, stresses)


def _with_compliance(system: System, split: SplitFrame, stress: Floats) -> System:
    """The ``system`` with the static deflection of the modes that are not slow; ``stress`` (6 s, n) is that of the
    elastic coordinates."""
    gone = split.static_modes
    stresses = stress @ gone.shapes
    tables = {
        **system.tables,
        "STRESS_LOAD": system.tables["STRESS_LOAD"] + stresses @ gone.motion.T,
        "COMPLIANCE": gone.motion @ gone.motion.T,
        "SPIN_COMPLIANCE": gone.motion @ gone.x_phi.T,
        "SPIN_STRESS": stresses @ gone.x_phi.T,
    }
    buffers = {**system.buffers, "deflection": len(gone.motion), "deflection_rate": len(gone.motion)}
    outputs = tuple(replace(variable, direct=True) for variable in system.outputs)
    return replace(system, tables=tables, buffers=buffers, outputs=outputs)


def _motion(name: str) -> tuple[Variable, ...]:
    place = [Variable(name=f"{name}.position.{a}", unit="m", about="of the interface") for a in AXES]
    turn = [Variable(name=f"{name}.quaternion.{a}", unit="1", about="rotation of the interface") for a in _QUATERNION]
    return (*place, *turn, *variables([name] * 6, range(6), VELOCITIES, "of the interface"))


def _losses_of(context: ExportContext) -> tuple[str, ...]:
    left = ", ".join(name for name in context.source.interfaces if name not in context.frame.markers)
    return (f"interfaces without a frame have no loads and motions here: {left}",) if left else ()


def _tables(frame: FloatingFrame) -> dict[str, Floats]:
    """By columns: what C goes through with the innermost index first."""
    parts, n = frame.integrals, frame.count
    motion = np.array([marker.motion for marker in frame.markers.values()])
    return {
        "FIRST": parts.first,
        "INERTIA": parts.inertia.ravel(),
        "CT": parts.Ct.T.ravel(),
        "CR": parts.Cr.T.ravel(),
        "ME": parts.Me,
        "X_PHI": parts.x_phi.ravel(),
        "PHI_PHI": parts.phi_phi.transpose(0, 1, 3, 2).reshape(9 * n, n),
        "CR_Q": parts.Cr1.transpose(2, 0, 1).reshape(3 * n, n),
        "KE": frame.Ke,
        "DE": frame.De,
        "D_UNIT": _unit_damping(frame),
        "POINT": np.array([marker.point for marker in frame.markers.values()]).ravel(),
        "MOTION": motion.ravel(),
    }


def _unit_damping(frame: FloatingFrame) -> Floats:
    """(n, n): damping matrix of critical damping in all modes of the free body, which those of mean axes are."""
    M = frame.in_frame("mean-axes").integrals.Me
    values, Y = sl.eigh(frame.Ke, M)
    MY = M @ Y
    return np.asarray((MY * (2 * np.sqrt(np.maximum(values, 0.0)))) @ MY.T)


def _on_markers(context: ExportContext, loads: Floats) -> Floats:
    """(6 s, 6 k): stresses of loads on the k markers, from those of the columns of the input matrix."""
    source, names = context.source, list(context.source.interfaces)
    order = {name: k for k, name in enumerate(context.markers("a floating body"))}
    result = np.zeros((len(loads), 6 * len(order)))
    for column, (index, component) in enumerate(zip(source.input_interface, source.input_component, strict=True)):
        if names[index] in order and component < 6:
            result[:, 6 * order[names[index]] + component] = loads[:, column]
    return result


def _length(frame: FloatingFrame) -> float:
    """Diagonal of the box with the inertia of the undeformed body, m."""
    parts = frame.integrals
    gyration = float(np.trace(parts.inertia)) / (2 * parts.mass) - float(parts.center @ parts.center)
    return float(np.sqrt(12 * max(gyration, np.finfo(float).tiny)))


def _states(frame: FloatingFrame, length: float) -> tuple[Variable, ...]:
    Me, Ke = np.diag(frame.integrals.Me), np.diag(frame.Ke)
    place = [
        Variable(name=f"position.{a}", unit="m", about="of the frame", start=x, nominal=length)
        for a, x in zip(AXES, frame.origin.tolist(), strict=True)
    ]
    turn = [
        Variable(name=f"quaternion.{a}", unit="1", about="rotation of the frame", start=float(a == "w"))
        for a in _QUATERNION
    ]
    velocity = [Variable(name=f"velocity.{a}", unit="m/s", about="of the frame", start=0.0) for a in AXES]
    spin = [
        Variable(name=f"angular_velocity.{a}", unit="rad/s", about="of the frame, along its axes", start=0.0)
        for a in AXES
    ]
    omega = np.sqrt(np.maximum(Ke / Me, 0.0))
    both = oscillators(length * np.sqrt(frame.integrals.mass / Me), omega, "elastic coordinate")
    return (*place, *turn, *both[: len(omega)], *velocity, *spin, *both[len(omega) :])
