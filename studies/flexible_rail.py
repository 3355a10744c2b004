"""A solid rail of 60,000 degrees of freedom: a load that crosses it, and a mass that rides over it.

The load is integrated with all degrees of freedom, with all static modes kept, and with static modes that are switched;
errors, coordinates and times are compared. Then a mass travels along the rail. Draws flexible_rail.png; runs go to
flexible_rail.npz, also unfinished ones.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from common import STEEL, THEIRS, THIRD, Curve, Floats, Panel, draw, parse, simulate_kept, write_run

from morembs.dynamics.multibody import (
    DrivenPosition,
    LinearBody,
    Marker,
    Motion,
    MovingLoad,
    PathSupport,
    Result,
    RigidBody,
    SlidingSwitch,
    SwitchingBody,
    System,
    ground,
    local_response,
    simulate_sliding,
)
from morembs.fem import DofMap, FEModel
from morembs.fem.assembly import assemble
from morembs.fem.grid import box_mesh
from morembs.fem.material import isotropic
from morembs.fem.stress_operator import StressOperator, stress_operator
from morembs.problem import Problem
from morembs.reducers import ReducedModel, StaticModesSwitching
from morembs.responses.static_mode_tables import StaticModeTables

LENGTH, WIDTH, HEIGHT = 5.0, 0.06, 0.12  # m
CELLS, QUICK_CELLS = (500, 4, 7), (100, 2, 3)
MODES, LOOK_AHEAD = 12, 16
LOAD, SPEED, BEGIN, END = 2e4, 30.0, 0.25, 4.75  # N, m/s, m
STEPS, QUICK_STEPS = 1500, 400
SAMPLE = (4, 64)  # steps that are timed with all static modes
MASS, GRAVITY = 150.0, 9.81
RHO = 0.95


@dataclass(frozen=True, kw_only=True, eq=False)
class Rail:
    """The free solid, the rail held at the lower edges of its ends, and the nodes of the path in order."""

    solid: FEModel
    model: FEModel
    path: np.ndarray


def make_rail(cells: Sequence[int]) -> Rail:
    """Bar of 8-node hexahedra; the path is the middle line of its top."""
    mesh = box_mesh((LENGTH, WIDTH, HEIGHT), cells, "hex8")
    xyz = mesh.nodes.xyz
    middle = np.argmin(np.abs(xyz[:, 1] - WIDTH / 2) + HEIGHT - xyz[:, 2])
    path = np.flatnonzero((xyz[:, 1] == xyz[middle, 1]) & (xyz[:, 2] == xyz[middle, 2]))
    named = replace(mesh, nodes=replace(mesh.nodes, sets={"RAIL": path}), source="rail")
    solid = assemble(named, [isotropic(set="all", **STEEL)])
    node, component = solid.dofs.node, solid.dofs.component
    low = xyz[:, 2] == 0
    left, right = (low & (xyz[:, 0] == x) for x in (0.0, LENGTH))
    keep = np.flatnonzero(~(left[node] | (right[node] & (component > 0))))
    K, M = (sp.csr_array(A[keep][:, keep]) for A in (solid.K, solid.M))
    dofs = DofMap(node=node[keep], component=component[keep])
    return Rail(solid=solid, model=replace(solid, K=K, M=M, dofs=dofs), path=path)


def ramp(t: float) -> float:
    """The load comes on within 20 ms."""
    return float(np.sin(0.5 * np.pi * min(max(t / 0.02, 0.0), 1.0)) ** 2)


def reduce(rail: Rail) -> tuple[ReducedModel, StaticModeTables, float]:
    """Modes, static modes of all nodes of the path, and the seconds that took."""
    begin = time.process_time()
    reducer = StaticModesSwitching(base_options={"modes": MODES}, candidates="set:RAIL", directions=[2], stress=True)
    with Problem(rail.model) as problem:
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
    return reduced, tables, time.process_time() - begin


@dataclass(frozen=True, kw_only=True, eq=False)
class Crossing:
    """One way to integrate: time (s,), deflection (s,) m and stress xx (s,) Pa under the load, coordinates, seconds."""

    time: Floats
    deflection: Floats
    stress: Floats
    coordinates: int
    seconds: float


def with_switching(
    reduced: ReducedModel, tables: StaticModeTables, steps: int, keep: Path
) -> tuple[Crossing, SlidingSwitch]:
    """The load on the modes, static modes under it alone."""
    body = SwitchingBody(LinearBody(reduced.M, reduced.K, name="rail"), tables, at=BEGIN, look_ahead=LOOK_AHEAD)
    system, switch = System(), SlidingSwitch(body)
    system.add(body)
    load = system.add(_load(body))
    duration, begin = (END - BEGIN) / SPEED, time.process_time()
    result = simulate_kept(system, switch, duration, duration / steps, keep, RHO)
    seconds = time.process_time() - begin
    local = local_response(result, body, load, stress=True)
    crossing = Crossing(
        time=result.time,
        deflection=local.displacement[:, 2],
        stress=local.stress[:, 0],
        coordinates=body.size + 1,
        seconds=seconds,
    )
    return crossing, switch


def _load(body: SwitchingBody) -> MovingLoad:
    return MovingLoad(
        body.path(), position=lambda t: BEGIN + SPEED * t, force=lambda t: (0.0, 0.0, -LOAD * ramp(t)), name="wheel"
    )


def with_all_static_modes(reduced: ReducedModel, tables: StaticModeTables, steps: int) -> tuple[int, float]:
    """Coordinates, and seconds of the whole run as some of its steps tell, in one window of all candidates."""
    modes = LinearBody(reduced.M, reduced.K, name="rail")
    body = SwitchingBody(modes, tables, at=BEGIN, variant="dynamic", look_ahead=len(tables.node_ids))
    system, switch = System(), SlidingSwitch(body)
    system.add(body)
    system.add(_load(body))
    h, seconds = (END - BEGIN) / SPEED / steps, {}
    for count in (3, *SAMPLE):
        # The first run is to warm up.
        begin = time.process_time()
        simulate_sliding(system, switch, end=count * h, step=h, rho=RHO)
        seconds[count] = time.process_time() - begin
    few, many = SAMPLE
    # The start is paid once, the steps are all alike.
    step = (seconds[many] - seconds[few]) / (many - few)
    return body.size, seconds[few] + (steps - few) * step


def with_all_dofs(rail: Rail, tables: StaticModeTables, steps: int) -> Crossing:
    """The load on the whole model: trapezoidal rule, one factorisation."""
    model, h = rail.model, (END - BEGIN) / SPEED / steps
    table = np.full(len(model.nodes), -1)
    down = model.dofs.component == 2
    table[model.dofs.node[down]] = np.flatnonzero(down)
    dofs, pick = table[rail.path], _StressAt(rail)
    begin = time.process_time()
    factor = spl.splu(
        sp.csc_matrix(model.M + h * h / 4 * model.K),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    u, rate, a = (np.zeros(model.size) for _ in range(3))
    rows, watching = [], 0.0
    for k in range(steps + 1):
        t = k * h
        s = BEGIN + SPEED * t
        curve = tables.curve(s)
        nodes, weights = curve.span.nodes, curve.value @ curve.span.base
        if k:
            u += h * rate + h * h / 4 * a
            rate += h / 2 * a
            f = np.zeros(model.size)
            f[dofs[nodes]] = -LOAD * ramp(t) * weights
            a = factor.solve(f - model.K @ u)
            u += h * h / 4 * a
            rate += h / 2 * a
        pause = time.process_time()
        c = (s - tables.s[curve.span.interval]) / curve.span.length
        ends = pick(u, curve.span.interval)
        rows.append((t, weights @ u[dofs[nodes]], (1 - c) * ends[0] + c * ends[1]))
        watching += time.process_time() - pause
    t_, w, sigma = np.array(rows).T
    seconds = time.process_time() - begin - watching
    return Crossing(time=t_, deflection=w, stress=sigma, coordinates=model.size, seconds=seconds)


class _StressAt:
    """Stress xx at two neighbours of the path from displacements of the held rail."""

    def __init__(self, rail: Rail) -> None:
        model = rail.model
        operator: StressOperator = stress_operator(rail.solid, rail.path)
        self.place = np.searchsorted(operator.nodes, rail.path)
        self.gradient, self.elasticity = operator.gradient, operator.elasticity[0]
        self.node, self.component = model.dofs.node, model.dofs.component
        self.count = len(model.nodes)

    def __call__(self, u: Floats, i: int) -> Floats:
        whole = np.zeros((self.count, 3))
        whole[self.node, self.component] = u
        stress = []
        for p in self.place[i : i + 2]:
            H = self.gradient[3 * p : 3 * p + 3] @ whole
            strain = 0.5 * (H + H.T)
            six = strain[[0, 1, 2, 0, 1, 2], [0, 1, 2, 1, 2, 0]]
            stress.append(float(self.elasticity[0] @ six))
        return np.array(stress)


@dataclass(frozen=True, kw_only=True, eq=False)
class Ride:
    """The mass: position along the rail (s,) m, its drop (s,) m, the force on it (s,) in parts of its weight."""

    position: Floats
    drop: Floats
    force: Floats
    switches: int


def ride(reduced: ReducedModel, tables: StaticModeTables, steps: int, keep: Path) -> Ride:
    """A mass is driven along the rail, on the compliance of its static modes."""
    system = System(gravity=(0, 0, -GRAVITY))
    # It starts in equilibrium, with the mass on it; the mass begins along the slope that the rail has there.
    curve = tables.curve(BEGIN)
    here = tables.of_nodes(int(curve.span.nodes[0]), len(curve.span.nodes))
    row = curve.rows(here)[2]
    down = tables.weight[:, 2] * -GRAVITY + (row @ tables.modes[here]) * -MASS * GRAVITY
    start = np.linalg.solve(reduced.K, down)
    modes = LinearBody(reduced.M, reduced.K, weight=tables.weight, start=start, name="rail")
    body = SwitchingBody(modes, tables, at=BEGIN, look_ahead=LOOK_AHEAD)
    switch = SlidingSwitch(body)
    system.add(body)
    path = body.path()
    there = path.place(body.start()[0]).at(BEGIN)
    start = there.position - [0.0, 0.0, MASS * GRAVITY * float(row @ tables.R(here) @ row)]
    velocity = SPEED * there.slope / there.slope[0]
    mass = system.add(
        RigidBody(MASS, (1, 1, 1), position=start, velocity=velocity, markers={"c": (0, 0, 0)}, name="mass")
    )
    rider: Marker = mass.marker("c")
    support = system.add(PathSupport(path, rider, name="wheel"))
    system.add(
        DrivenPosition(ground.marker_at(start), rider, axis=(1, 0, 0), motion=Motion.steady(SPEED), name="drive")
    )
    duration = (END - BEGIN) / SPEED
    result = simulate_kept(system, switch, duration, duration / steps, keep, RHO)
    local = local_response(result, body, support)
    write_run(keep, result)
    z = result.position(rider)[:, 2]
    return Ride(
        position=local.position,
        drop=z - start[2],
        force=_forces(result, support) / (MASS * GRAVITY),
        switches=len(switch.log),
    )


def _forces(result: Result, support: PathSupport) -> Floats:
    forces = []
    for segment in result.segments:
        for x in segment.x:
            places = [segment.assembly.place(marker, x) for marker in support.markers]
            forces.append(support.wrenches(0.0, places, [])[1][2])
    return np.array(forces)


def compared(full: Crossing, switched: Crossing) -> tuple[float, float]:
    """Largest errors of deflection and stress, as parts of the largest value of the full model."""
    errors = []
    for name in ("deflection", "stress"):
        want = np.interp(switched.time, full.time, getattr(full, name))
        errors.append(float(np.abs(getattr(switched, name) - want).max() / np.abs(want).max()))
    return errors[0], errors[1]


def picture(path: Path, full: Crossing, switched: Crossing, modes: Floats, travel: Ride) -> None:
    """Deflection and stress under the load, drop and force of the mass."""
    s, every = BEGIN + SPEED * switched.time, BEGIN + SPEED * full.time
    draw(
        path,
        "A flexible rail: moving load and travelling mass",
        [
            Panel(
                title=f"Deflection under a load of {LOAD / 1e3:g} kN at {SPEED:g} m/s",
                x="position, m",
                y="mm",
                curves=[
                    Curve(x=every, y=1e3 * full.deflection, label=f"all {full.coordinates} dofs", color=THEIRS),
                    Curve(x=s, y=1e3 * modes, label=f"{MODES} modes alone", color=THIRD, width=1.0),
                    Curve(x=s, y=1e3 * switched.deflection, label="with switched static modes", style="--"),
                ],
            ),
            Panel(
                title="Stress along the rail at its top, under the load",
                x="position, m",
                y="MPa",
                curves=[
                    Curve(x=every, y=1e-6 * full.stress, label="all dofs", color=THEIRS, width=1.0),
                    Curve(x=s, y=1e-6 * switched.stress, label="with switched static modes", style="--", width=1.0),
                ],
            ),
            Panel(
                title=f"A mass of {MASS:g} kg rides over the rail",
                x="position, m",
                y="drop, mm",
                curves=[Curve(x=travel.position, y=1e3 * travel.drop)],
            ),
            Panel(
                title="Force under the mass",
                x="position, m",
                y="parts of its weight",
                curves=[Curve(x=travel.position, y=travel.force)],
            ),
        ],
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs, draws and prints the figures. Returns the exit code."""
    options = parse(arguments, "A flexible rail under a moving load and a travelling mass.", __file__)
    file, steps = options.folder / "flexible_rail.npz", QUICK_STEPS if options.quick else STEPS
    rail = make_rail(QUICK_CELLS if options.quick else CELLS)
    reduced, tables, offline = reduce(rail)
    print(f"rail of {rail.model.size} dofs, {tables.count} candidates; reduced in {offline:.1f} s")
    switched, switch = with_switching(reduced, tables, steps, file)
    print(f"{len(switch.log)} switches in {steps} steps")
    full = with_all_dofs(rail, tables, steps)
    deflection, stress = compared(full, switched)
    print(f"errors against all dofs: deflection {100 * deflection:.2f} %, stress {100 * stress:.2f} %")
    count, seconds = with_all_static_modes(reduced, tables, steps)
    print(f"coordinates: {switched.coordinates} switched, {count} with all static modes, {full.coordinates} in all")
    print(f"seconds: {switched.seconds:.2f} switched, {seconds:.1f} with all static modes, {full.seconds:.1f} in all")
    fewer, faster, than_all = count / switched.coordinates, seconds / switched.seconds, full.seconds / switched.seconds
    print(f"{fewer:.0f} times fewer coordinates than with all static modes, {faster:.0f} times faster")
    print(f"{than_all:.0f} times faster than all dofs")
    travel = ride(reduced, tables, steps, file)
    print(
        f"mass: largest drop {-1e3 * travel.drop.min():.3f} mm, force {travel.force.min():.3f} to "
        f"{travel.force.max():.3f} of the weight, {travel.switches} switches"
    )
    picture(options.folder / "flexible_rail.png", full, switched, _alone(switched, reduced, tables), travel)
    return 0


def _alone(switched: Crossing, reduced: ReducedModel, tables: StaticModeTables) -> Floats:
    """Deflection without the static modes: these are the load times their compliance."""
    deflection = []
    for t, w in zip(switched.time, switched.deflection, strict=True):
        curve = tables.curve(BEGIN + SPEED * float(t))
        here = tables.of_nodes(int(curve.span.nodes[0]), len(curve.span.nodes))
        row = curve.rows(here)[2]
        deflection.append(w + LOAD * ramp(float(t)) * (row @ tables.R(here) @ row))
    return np.array(deflection)


if __name__ == "__main__":
    sys.exit(main())
