"""Loads and masses that slide along a beam with switched static modes, against analytic and full models."""

from functools import cache

import numpy as np
import pytest
import scipy.linalg as sl
from scipy.integrate import solve_ivp

from morembs.dynamics.multibody import RigidBody, System
from morembs.dynamics.multibody.linear_body import LinearBody
from morembs.dynamics.multibody.sliding.body import SwitchingBody
from morembs.dynamics.multibody.sliding.handler import (
    SlidingSwitch,
    project_in_mass,
    project_in_stiffness,
    simulate_sliding,
)
from morembs.dynamics.multibody.sliding.loads import MovingLoad, PathSupport, PointOnPath
from morembs.dynamics.multibody.sliding.response import amplitudes, local_response, state_of
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import StaticModesSwitching
from tests.support.sliding import ELEMENTS, hermite_beam, reduced_beam


@pytest.fixture(scope="module")
def beam():
    return reduced_beam(4)


def passage(beam, alpha, variant="quasi-static", steps=1600, **keys):
    """A unit load crosses the beam with ``alpha`` times the critical speed."""
    reduced, tables = beam
    v = alpha * np.pi
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, variant=variant, **keys)
    system, switch = System(), SlidingSwitch(body)
    system.add(body)
    system.add(MovingLoad(body.path(), position=lambda t: v * t, force=(0.0, 1.0, 0.0)))
    return simulate_sliding(system, switch, end=1 / v, step=1 / v / steps), body, switch, v


@pytest.mark.parametrize(("alpha", "factor"), [(0.1, 1.096), (0.25, 1.258), (0.617, 1.732)])
def test_dynamic_factors_of_a_moving_load(beam, alpha, factor):
    result, body, _, _ = passage(beam, alpha, steps=600)
    middle = local_response(result, body, lambda t: 0.5).displacement[:, 1]
    assert np.abs(middle).max() * 48 == pytest.approx(factor, rel=3e-3)


def exact_moment(t, v, n=4000):
    """Bending moment under the load, by the series of Fryba."""
    k, alpha = np.arange(1, n + 1), v / np.pi
    s = np.sin(k * np.pi * v * t)
    return 2 / np.pi**2 * np.sum((s - alpha / k * np.sin((k * np.pi) ** 2 * t)) * s / (k**2 - alpha**2))


def element_moment(u, s):
    """Moment of the element about s from its four displacements, u (2 nodes,)."""
    h = 1 / ELEMENTS
    e = min(int(s / h), ELEMENTS - 1)
    x = (s - e * h) / h
    return -np.array([12 * x - 6, h * (6 * x - 4), 6 - 12 * x, h * (6 * x - 2)]) @ u[2 * e : 2 * e + 4] / h**2


def whole(u):
    """With the held displacements."""
    return np.insert(u, [0, 2 * ELEMENTS - 1], 0.0)


def states(result):
    for segment in result.segments:
        for k in range(len(segment.time)):
            yield k == 0, state_of(segment, k)


def full_beam_moments(v, steps):
    """Moments under the load of all 64 dofs, trapezoidal rule."""
    model, h = hermite_beam(), 1 / v / steps
    K, M = model.K.toarray(), model.M.toarray()

    def load(t):
        e = min(int(v * t * ELEMENTS), ELEMENTS - 1)
        x, f = v * t * ELEMENTS - e, np.zeros(2 * ELEMENTS + 2)
        f[2 * e : 2 * e + 4] = 1 - 3 * x**2 + 2 * x**3, x * (1 - x) ** 2 / 32, x**2 * (3 - 2 * x), x**2 * (x - 1) / 32
        return np.delete(f, [0, 2 * ELEMENTS])

    u, rate, factor = np.zeros(len(K)), np.zeros(len(K)), sl.lu_factor(M + h * h / 4 * K)
    a = np.linalg.solve(M, load(0.0))
    moments = []
    for k in range(1, steps + 1):
        u, rate = u + h * rate + h * h / 4 * a, rate + h / 2 * a
        a = sl.lu_solve(factor, load(k * h) - K @ u)
        u, rate = u + h * h / 4 * a, rate + h / 2 * a
        moments.append((k * h, element_moment(whole(u), v * k * h)))
    return moments


def test_bending_moment_under_the_load_with_four_modes(beam):
    result, body, _, v = passage(beam, 0.25)
    tables = beam[1]
    every, rows = np.arange(tables.count), []
    for number, (_, state) in enumerate(states(result)):
        if number % 10 == 0:
            q, candidates, a = amplitudes(state, body)
            u, s = tables.modes @ q + tables.R(every, candidates) @ a, v * state.time
            rows.append(
                (exact_moment(state.time, v), element_moment(whole(u), s), element_moment(whole(tables.modes @ q), s))
            )
    exact, switched, modes = np.array(rows).T
    full = np.array([(exact_moment(t, v), value) for t, value in full_beam_moments(v, 1600)[::10]])
    size = np.abs(exact).max()
    of_full = np.abs(full[:, 1] - full[:, 0]).max() / size
    assert of_full == pytest.approx(1.5e-2, rel=0.1)
    assert np.abs(switched - exact).max() / size == pytest.approx(of_full, rel=0.05)
    assert 0.09 < np.abs(modes - exact).max() / size < 0.115


@pytest.mark.parametrize("variant", ["quasi-static", "dynamic"])
def test_displacement_is_continuous_and_no_energy_grows_at_switches(beam, variant):
    result, body, switch, _ = passage(beam, 0.25, variant, steps=800)
    tables, every = beam[1], np.arange(beam[1].count)
    last, jump, largest = np.zeros(tables.count), 0.0, 0.0
    moves = ~tables.turns
    for first, state in states(result):
        q, candidates, a = amplitudes(state, body)
        u = tables.modes @ q + tables.R(every, candidates) @ a
        if first and state.time > 0:
            jump = max(jump, np.abs(u - last)[moves].max())
        last, largest = u, max(largest, np.abs(u[moves]).max())
    assert jump <= (0.0 if variant == "quasi-static" else 1e-3 * largest)
    assert len(result.segments) == len(switch.log) + 1 > 20
    for entry in switch.log:
        for before, after in (entry.kinetic, entry.strain):
            assert after <= before + 1e-12 * max(abs(before), 1e-9)
    # Every node beyond the first window is activated once; what goes has been on.
    on = [node for entry in switch.log for node in entry.on]
    assert sorted(on) == list(range(7, ELEMENTS + 2))
    assert set(node for entry in switch.log for node in entry.off) <= {*range(1, 7), *on}
    if variant == "dynamic":
        assert {entry.rank for entry in switch.log} <= set(range(1, 13))


def beam_with_interface():
    """Craig and Bampton's modes of an interface in the middle, and the loads (N, c) of the other nodes."""
    model, held = hermite_beam(), ELEMENTS // 2
    ids = ",".join(str(k) for k in model.nodes.ids if k != held + 1)
    reducer = StaticModesSwitching(
        base="craig-bampton", base_options={"modes": 3}, candidates=f"ids:{ids}", directions=[1, 5]
    )
    interface = make_interface(model, name="middle", nodes=np.array([held]), coupling="direct")
    with Problem(model, [interface]) as problem:
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
    loads = np.zeros((model.size, tables.count))
    for column, (node, turns) in enumerate(zip(tables.node_ids[tables.node], tables.turns, strict=True)):
        loads[(model.dofs.node == node - 1) & (model.dofs.component == (5 if turns else 1)), column] = 1.0
    assert np.abs(tables.coupling).max() > 0
    return reduced, tables, loads


@pytest.mark.parametrize("base", ["modal", "craig-bampton"])
def test_projection_at_a_switch_is_the_nearest_in_stiffness_and_mass(base):
    """Against dense projections with explicit shapes; constraint modes share mass with static ones."""
    reduced, tables, loads = beam_with_interface() if base == "craig-bampton" else (*reduced_beam(3), None)
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=0.4, variant="dynamic")
    rng = np.random.default_rng(3)
    with Problem(hermite_beam()) as problem:
        K, M = problem.K.toarray(), problem.M.toarray()
    Psi = np.linalg.solve(K, np.eye(len(K)) if loads is None else loads)
    Psi -= reduced.V @ np.linalg.solve(reduced.K, reduced.V.T @ K @ Psi)
    old = body.firsts(body.start()[0])
    new = (old[0] + 2,)
    a, b = (body.active_of(k).set for k in (old, new))
    z, rate = rng.standard_normal(body.extra), rng.standard_normal(body.extra)
    projected = project_in_stiffness(body, body.active_of(old), body.active_of(new), z)
    before, basis = Psi[:, a.candidates] @ a.Y @ z, Psi[:, b.candidates]
    want = basis @ np.linalg.lstsq(basis.T @ K @ basis, basis.T @ K @ before, rcond=1e-11)[0]
    after = basis @ (b.Y @ projected)
    assert np.abs(after - want).max() < 1e-5 * np.abs(before).max()
    # Displacements of all candidates that stay on are kept.
    stay = np.intersect1d(a.candidates, b.candidates)
    kept = (after - before) if loads is None else loads.T @ (after - before)
    assert np.abs(kept[stay]).max() < 1e-6 * np.abs(before).max()
    assert after @ K @ after <= before @ K @ before
    # Velocities of basis and static modes together, in the norm of the mass.
    v = np.concatenate((rng.standard_normal(body.inner.size), rate))
    x = body.start()[0]
    projected = project_in_mass(body, x, body.active_of(old), body.active_of(new), v)
    before = reduced.V @ v[: body.inner.size] + Psi[:, a.candidates] @ a.Y @ rate
    after = reduced.V @ projected[: body.inner.size] + Psi[:, b.candidates] @ b.Y @ projected[body.inner.size :]
    basis = np.hstack((reduced.V, Psi[:, b.candidates] @ b.Y[:, np.any(b.Y != 0, axis=0)]))
    want = basis @ np.linalg.solve(basis.T @ M @ basis, basis.T @ M @ before)
    assert np.abs(after - want).max() < 1e-6 * np.abs(before).max()
    assert after @ M @ after <= before @ M @ before


@cache
def moving_mass(speed, mass, gravity, start, end, n=ELEMENTS):
    """(t, y) of a mass that keeps its speed along the whole beam: (M + m b b') u'' + ... = -m g b."""
    model = hermite_beam(n)
    K, M = model.K.toarray(), model.M.toarray()

    def shape(s, order):
        e = min(int(s * n), n - 1)
        x, h, row = s * n - e, 1 / n, np.zeros(2 * n + 2)
        row[2 * e : 2 * e + 4] = (
            (1 - 3 * x**2 + 2 * x**3, h * x * (1 - x) ** 2, x**2 * (3 - 2 * x), h * x**2 * (x - 1)),
            (6 * x * (x - 1), h * (1 - x) * (1 - 3 * x), 6 * x * (1 - x), h * x * (3 * x - 2)),
            (12 * x - 6, h * (6 * x - 4), 6 - 12 * x, h * (6 * x - 2)),
        )[order]
        return np.delete(row, [0, 2 * n]) / h**order

    values, Y = sl.eigh(K, M)
    few = 20

    def rates(t, state):
        q, p = np.split(state, 2)
        b, b1, b2 = (Y[:, :few].T @ shape(start + speed * t, k) for k in range(3))
        force = -mass * b * (gravity + 2 * speed * b1 @ p + speed**2 * b2 @ q) - values[:few] * q
        return np.concatenate((p, np.linalg.solve(np.eye(few) + mass * np.outer(b, b), force)))

    run = solve_ivp(
        rates, (0, (end - start) / speed), np.zeros(2 * few), rtol=1e-6, atol=1e-10, method="LSODA", dense_output=True
    )
    return lambda t: (Y[:, :few].T @ shape(start + speed * t, 0)) @ run.sol(t)[:few]


@pytest.mark.parametrize("variant", ["quasi-static", "dynamic"])
def test_travelling_mass(variant):
    reduced, tables = reduced_beam(2)
    # Deflections so small that the mass keeps its speed; and it is heavy: half of the beam. Without damping, as work of
    # dampers comes from the trapezoidal rule, which is far off for static modes that are faster than a step.
    speed, mass, g, start, end = 0.25 * np.pi, 0.5, 1e-3, 0.05, 0.95
    body = SwitchingBody(
        LinearBody(reduced.M, reduced.K), tables, at=start, variant=variant, look_ahead=2, damping_ratio=0.0
    )
    system = System(gravity=(0.0, -g, 0.0))
    system.add(body)
    rider = system.add(
        RigidBody(
            mass, (1, 1, 1), position=(start, 0, 0), velocity=(speed, 0, 0), name="rider", markers={"c": (0, 0, 0)}
        )
    )
    kind = PointOnPath if variant == "dynamic" else PathSupport
    system.add(kind(body.path(), rider.marker("c"), up=(0, 1, 0), name="rail"))
    switch = SlidingSwitch(body)
    duration = (end - start) / speed
    result = simulate_sliding(system, switch, end=duration, step=duration / (500 if variant == "dynamic" else 150))
    y, reference = result.position(rider.marker("c"))[:, 1], moving_mass(speed, mass, g, start, end)
    want = np.array([reference(t) for t in result.time])
    # Half of the static deflection and more: the dynamics are not small.
    assert np.abs(want).max() > mass * g / 48
    assert np.abs(y - want).max() < 1e-2 * np.abs(want).max()
    energy = result.energy()
    assert np.abs(energy.work).max() == 0
    drift, exchanged = energy.total - energy.total[0], np.abs(energy.kinetic - energy.kinetic[0]).max()
    assert drift.max() < 1e-3 * exchanged and -drift.min() < 1e-2 * exchanged
    assert {entry.slider for entry in switch.log} == {"rail"}


@pytest.mark.parametrize("variant", ["quasi-static", "dynamic"])
def test_a_step_handles_as_much_with_ten_times_as_many_candidates_and_dofs(variant):
    sizes = []
    for n in (40, 400):
        reduced, tables = reduced_beam(4, n, band=12)
        body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=0.5, variant=variant)
        place, active = body.path().place(body.start()[0]), body.active(body.start()[0])
        arrays = [place.jacobian, place.R, place.amplitudes, place.at(0.5).G, active.on_inner, *active.rows]
        sizes.append((tables.count // 10, body.size, body.configuration_size, [array.shape for array in arrays]))
    assert sizes[1][0] >= 9 * sizes[0][0] and sizes[0][1:] == sizes[1][1:]


def test_two_wheels_share_a_beam(beam):
    """Superposition: each load in a window of its own, static modes of one seen by the other."""
    reduced, tables = beam
    v = 0.2 * np.pi

    def run(at, forces):
        body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=at)
        system = System()
        system.add(body)
        for number, (s, F) in enumerate(zip(at, forces, strict=True)):
            system.add(
                MovingLoad(body.path(number), position=lambda t, s=s: s + v * t, force=(0, F, 0), name=f"w{number}")
            )
        result = simulate_sliding(system, SlidingSwitch(body), end=0.5, step=1e-3)
        return result.time, local_response(result, body, lambda t: 0.1 + v * t).displacement[:, 1]

    both, first, second = (run(*args) for args in (((0.1, 0.4), (1.0, 2.0)), ((0.1,), (1.0,)), ((0.4,), (2.0,))))
    times = np.linspace(0.01, 0.49, 50)
    a, b, c = (np.interp(times, *pair) for pair in (both, first, second))
    assert np.abs(a - b - c).max() < 1e-5 * np.abs(a).max()
