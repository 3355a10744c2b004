"""A body in small motion, held at some interfaces or at none, in its normal coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.exporters.base import ExportContext
from morembs.exporters.fmu.system import (
    ACCELERATIONS,
    GRAVITY,
    LOADS,
    MOTIONS,
    REACTIONS,
    VELOCITIES,
    StressRows,
    System,
    Variable,
    labels,
    oscillators,
    renamed_note,
    stress_rows,
    variables,
)
from morembs.exporters.read_back import FirstOrder
from morembs.exporters.real_time import Truncation, gyration, refuse_nothing_left, slow_modes, static_response
from morembs.exporters.reduced import refuse_two_sided, to_interfaces
from morembs.exporters.tolerances import TOL
from morembs.linalg.dense import symmetric
from morembs.linalg.eigen import accurate_eigh


@dataclass(frozen=True, kw_only=True, eq=False)
class _Coordinates:
    """Reduced coordinates = X (motions of the held degrees of freedom) + Y (normal coordinates); ``omega`` (n,) rad/s,
    zero for rigid motions."""

    X: Floats
    Y: Floats
    omega: Floats
    notes: tuple[str, ...] = ()


def linear_system(
    context: ExportContext, *, held: Sequence[str], stress: Sequence[int], damping_ratio: float
) -> System:
    """The body as p' = -omega^2 q - D p + B u, q' = p, in normal coordinates with the interfaces ``held`` at rest.

    Inputs are loads of all other interface degrees of freedom, gravity where the body has a floating frame, and
    displacements, velocities and accelerations of those held; outputs are reactions, motions and stresses.

    Raises:
        InputError: the body is not symmetric, an unknown interface, interface degrees of freedom that depend on each
            other, or nothing that would come out.
    """
    body, source = context.body, context.source
    refuse_two_sided(body)
    columns, known = labels(context)
    fixed = _held_columns(context, held)
    free = np.setdiff1d(np.arange(len(columns)), fixed)
    at = _coordinates(context, fixed)
    rows = stress_rows(context, stress)
    if not len(columns) and not rows.count:
        raise InputError(
            f"body {body.name!r} has no interface, so the FMU has no inputs and outputs; add an [[interface]] to "
            "its job"
        )
    components = source.input_component.tolist()

    def of(which: Ints, kinds: Sequence[tuple[str, str]], about: str, **values: object) -> tuple[Variable, ...]:
        return variables([columns[k] for k in which], [components[k] for k in which], kinds, about, **values)

    weight = _weight(context)
    inputs = (
        *of(free, LOADS, "on the body", start=0.0),
        *(GRAVITY if weight.shape[1] else ()),
        *(
            variable
            for kinds in (MOTIONS, VELOCITIES, ACCELERATIONS)
            for variable in of(fixed, kinds, "motion of the held interface", start=0.0)
        ),
    )
    tables = _tables(context, at, free, fixed, weight, rows)
    moves = bool(len(fixed)) and bool((body.output_matrix[free] @ at.X).any())
    outputs = (
        *of(fixed, REACTIONS, "of what holds the body, on the body", direct=True),
        *of(free, MOTIONS, "of the interface", direct=moves),
        *of(free, VELOCITIES, "of the interface", direct=moves),
        *rows.outputs,
    )
    n = len(at.omega)
    return System(
        structure="linear",
        inputs=inputs,
        outputs=outputs,
        tables=tables,
        parameters=(damping_parameter(damping_ratio),),
        states=_states(context, at.omega),
        constants={
            "MODES": n,
            "LINEAR_OUTPUTS": len(outputs) - rows.count,
            "REACTIONS": len(fixed),
            "STRESSES": rows.count,
            "DAMPING_RATIO": 0,
        },
        notes=(*at.notes, *renamed_note(known)),
    )


def damping_parameter(start: float) -> Variable:
    """Modal damping beside the damping matrix of the body."""
    about = "ratio of critical damping of all modes, beside the damping matrix of the body"
    return Variable(name="damping_ratio", unit="1", about=about, start=start)


def _held_columns(context: ExportContext, held: Sequence[str]) -> Ints:
    names = list(context.source.interfaces)
    for name in held:
        if name not in names:
            raise InputError(f"held: there is no interface {name!r}; {nearest(name, names)}", kind="unknown")
    return np.flatnonzero(np.isin(context.source.input_interface, [names.index(name) for name in held]))


def _coordinates(context: ExportContext, fixed: Ints) -> _Coordinates:
    body = context.body
    values, Y = body.reduced.modes()
    rigid = body.rigid_count
    X = np.zeros((len(values), 0))
    notes: tuple[str, ...] = ()
    if len(fixed):
        C = body.output_matrix[fixed]
        T, notes = to_interfaces(body, C)
        X, N = T[:, : len(fixed)], T[:, len(fixed) :]
        K, M = (symmetric(N.T @ A @ N) for A in (body.stiffness_matrix, body.mass_matrix))
        moved = C @ Y[:, :rigid]
        size = np.linalg.norm(moved, axis=1)
        moved = moved / np.where(size > 0, size, 1.0)[:, None]
        rigid -= int((np.linalg.svd(moved, compute_uv=False) > TOL.held_motion).sum()) if rigid else 0
        values, inner = accurate_eigh(K, M) if N.shape[1] else (np.zeros(0), np.zeros((0, 0)))
        Y = N @ inner
    values[:rigid] = 0.0
    if (values[rigid:] <= 0).any():
        raise InputError(
            f"body {body.name!r} has {int((values[rigid:] <= 0).sum())} modes without stiffness beside its {rigid} "
            "rigid motions and would run away; reduce it again",
            kind="model",
        )
    # Motions of the held degrees of freedom take the body along at rest.
    soft, elastic = Y[:, rigid:], values[rigid:, None]
    X = X - soft @ ((soft.T @ body.stiffness_matrix @ X) / elastic)
    return _Coordinates(X=X, Y=Y, omega=np.sqrt(values), notes=notes)


def _weight(context: ExportContext) -> Floats:
    """(nr, 3): loads on the reduced coordinates under unit gravity along each axis; (nr, 0) where nobody knows."""
    floating, M = context.body.floating, context.body.mass_matrix
    return M @ floating.rigid[:, :3] if floating is not None else np.zeros((len(M), 0))


def _tables(
    context: ExportContext, at: _Coordinates, free: Ints, fixed: Ints, weight: Floats, rows: StressRows
) -> dict[str, Floats]:
    """B, D and the output matrices, all for u = [loads; gravity; motions, velocities, accelerations of the held].

    With r the reactions: 0 = X' (M q'' + D q' + K q - B_r u) - r for reduced coordinates q = X x + Y y.
    """
    body, X, Y = context.body, at.X, at.Y
    M, D, K = body.mass_matrix, body.damping_matrix, body.stiffness_matrix
    loads = np.hstack([body.input_matrix[:, free], weight])
    held, omega = len(fixed), at.omega
    n, k = len(omega), loads.shape[1]

    def on(Z: Floats) -> Floats:
        """Inputs in the equations along Z, on the side of the loads."""
        return np.hstack([Z.T @ loads, *(-(Z.T @ A @ X) for A in (K, D, M))])

    C, S, on_held = body.output_matrix[free], rows.shapes, rows.loads[:, fixed]
    reactions = np.hstack([X.T @ K @ Y, X.T @ D @ Y]), -on(X), X.T @ M @ Y
    no_loads = np.zeros((2 * len(free), k))
    motions = (
        np.kron(np.eye(2), C @ Y),
        np.hstack([no_loads, np.kron(np.eye(2, 3), C @ X)]),
        np.zeros((2 * len(free), n)),
    )
    # Stresses of the shapes, of the loads that come in, and of the reactions.
    others = np.zeros((len(S), weight.shape[1])), S @ X, np.zeros((len(S), 2 * held))
    of_shapes = np.hstack([S @ Y, 0 * (S @ Y)]), np.hstack([rows.loads[:, free], *others]), 0 * (S @ Y)
    stresses = tuple(part + on_held @ reaction for part, reaction in zip(of_shapes, reactions, strict=True))
    YX, YU, YA = (np.vstack(parts) for parts in zip(reactions, motions, stresses, strict=True))
    return {"OMEGA": omega, "MINUS_D": -symmetric(Y.T @ D @ Y), "B": on(Y), "YX": YX, "YU": YU, "YA": YA}


def _states(context: ExportContext, omega: Floats) -> tuple[Variable, ...]:
    nodes = context.source.coordinates
    length = float(np.linalg.norm(np.ptp(nodes, axis=0))) if len(nodes) > 1 else 1.0
    mass = max(context.source.mass, TOL.least_nominal_mass_kg)
    return oscillators(length * np.sqrt(mass), omega, "normal coordinate")


def state_space(system: System) -> tuple[Floats, Floats]:
    """A (2n, 2n), B (2n, k) of x' = A x + B u, x = [q; p], with the damping ratio that the parameter starts with."""
    omega, n = system.tables["OMEGA"], len(system.tables["OMEGA"])
    ratio = system.parameters[0].start or 0.0
    damping = 2 * ratio * np.diag(omega) - system.tables["MINUS_D"]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(omega**2), -damping]])
    return A, np.vstack([np.zeros_like(system.tables["B"]), system.tables["B"]])


def truncate(system: System, context: ExportContext, time_step: float) -> System:
    """The linear ``system`` of a body without the modes that ``time_step`` in s does not resolve: their
    compliance is in the outputs.

    Raises:
        InputError: nothing is left.
    """
    tables, (A, B) = system.tables, state_space(system)
    omega, n = tables["OMEGA"], len(tables["OMEGA"])
    slow = slow_modes(omega, -np.diag(A[n:, n:]), time_step)
    kept, fast = np.flatnonzero(np.tile(slow, 2)), np.flatnonzero(np.tile(~slow, 2))
    refuse_nothing_left(context.body.name, time_step, len(kept))
    linear = system.outputs[: len(tables["YU"])]
    held = int(system.constants["REACTIONS"])
    inputs = len(system.inputs) - 3 * held
    found = Truncation(
        # Accelerations are the lower rows of the rates.
        system=FirstOrder(A=A, B=B, C=tables["YX"] + tables["YA"] @ A[n:], D=tables["YU"] + tables["YA"] @ B[n:]),
        fast=fast,
        moving=np.flatnonzero(np.tile(omega == 0, 2)),
        units=([variable.unit for variable in linear], [variable.unit for variable in system.inputs]),
        derivatives=[(at, 0) for at in range(inputs)] + [(inputs + at, k) for k in range(3) for at in range(held)],
        length=gyration(context.source),
        step=time_step,
    ).measure(n)
    if slow.all():
        return replace(system, real_time=found)
    by_states, by_inputs = static_response(A, B, fast)
    YU = tables["YU"] + tables["YX"][:, fast] @ by_inputs
    direct: list[bool] = np.any(YU != 0, axis=1).tolist()
    stresses = any(direct[len(linear) - 6 * int(system.constants["STRESSES"]) :]) and bool(system.constants["STRESSES"])
    direct += [stresses] * (len(system.outputs) - len(linear))
    return replace(
        system,
        tables={
            "OMEGA": omega[slow],
            "MINUS_D": tables["MINUS_D"][np.ix_(slow, slow)],
            "B": tables["B"][slow],
            "YX": tables["YX"][:, kept] + tables["YX"][:, fast] @ by_states,
            "YU": YU,
            "YA": tables["YA"][:, slow],
        },
        states=tuple(system.states[at] for at in kept),
        outputs=tuple(
            replace(variable, direct=variable.direct or at_once)
            for variable, at_once in zip(system.outputs, direct, strict=True)
        ),
        constants={**system.constants, "MODES": int(slow.sum())},
        real_time=found,
    )
