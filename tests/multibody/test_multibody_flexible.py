"""Elastic bodies in the simulator: inertia forces, motion, frames, order, stiffening."""

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
from scipy.integrate import solve_ivp

from morembs.base.errors import SolverError
from morembs.body.floating.frame import FloatingFrame, floating_frame
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.dynamics.multibody import (
    DrivenAngle,
    FixedJoint,
    FlexibleBody,
    LinearBody,
    Motion,
    PointLoad,
    RevoluteJoint,
    RigidBody,
    SphericalJoint,
    System,
    ground,
    simulate,
)
from morembs.dynamics.multibody.inertia import Foreshortening, Inertia
from morembs.dynamics.multibody.rotations import exponential
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

DOWN = (0.0, 0.0, -9.81)


def integrals(m, x, shapes):
    """Integrals of a scalar consistent mass m (N, N), positions x (N, 3) and shapes (N, 3, n), by brute force."""
    mx = m @ x
    of_shapes = np.einsum("ij,jbl->ibl", m, shapes)
    x_phi = np.einsum("ia,ibl->abl", x, of_shapes)
    second = x.T @ mx
    return ShapeIntegrals(
        mass=m.sum(),
        first=mx.sum(axis=0),
        inertia=np.trace(second) * np.eye(3) - second,
        second=second,
        Ct=of_shapes.sum(axis=0).T,
        Cr=np.einsum("abl->lab", x_phi)[:, [1, 2, 0], [2, 0, 1]]
        - np.einsum("abl->lab", x_phi)[:, [2, 0, 1], [1, 2, 0]],
        Me=np.einsum("iak,ial->kl", shapes, of_shapes),
        x_phi=x_phi,
        phi_phi=np.einsum("iak,ibl->abkl", shapes, of_shapes),
    )


def tiny(kind, rng, nodes=9, n=4):
    """A tiny model: scalar mass, positions and shapes, free (mean axes) or clamped at its first node."""
    half = rng.standard_normal((nodes, nodes))
    m = half @ half.T + np.eye(nodes)
    x, shapes = rng.standard_normal((nodes, 3)), rng.standard_normal((nodes, 3, n))
    if kind == "clamped":
        shapes[0] = 0
    else:
        R = np.zeros((nodes, 3, 6))
        R[:, :, :3] = np.eye(3)
        for a in range(3):
            R[:, :, 3 + a] = np.cross(np.eye(3)[a], x)
        mR = np.einsum("ij,jal->ial", m, R)
        shapes -= R @ np.linalg.solve(np.einsum("iak,ial->kl", R, mR), np.einsum("iak,ial->kl", mR, shapes))
    return m, x, shapes


def frame_of(parts, rng):
    n = parts.count
    K = rng.standard_normal((n, n))
    return FloatingFrame(
        kind="tangent",
        interfaces=(),
        origin=np.zeros(3),
        elastic=np.eye(n),
        rigid=np.zeros((n, 6)),
        integrals=parts,
        Ke=K @ K.T,
        De=0.1 * K @ K.T,
        markers={},
    )


@pytest.mark.parametrize("kind", ["free", "clamped"])
def test_forces_equal_direct_integration_over_the_body(kind):
    rng = np.random.default_rng(1)
    m, x, shapes = tiny(kind, rng)
    frame = frame_of(integrals(m, x, shapes), rng)
    body = FlexibleBody(frame)
    if kind == "free":
        assert np.abs(frame.integrals.Ct).max() < 1e-12 and np.abs(frame.integrals.Cr).max() < 1e-11
    for _ in range(5):
        R, r0 = exponential(rng.standard_normal(3)), rng.standard_normal(3)
        q, rate, q2 = rng.standard_normal((3, 4))
        v, w, a, w1, gravity = rng.standard_normal((5, 3))
        M, g = body.dynamics(0.0, np.concatenate((r0, R.ravel(), q)), np.concatenate((v, w, rate)), gravity)
        residual = M @ np.concatenate((a, w1, q2)) + g
        s, s1, s2 = x + shapes @ q, shapes @ rate, shapes @ q2
        inner = np.cross(w1, s) + s2 + 2 * np.cross(w, s1) + np.cross(w, np.cross(w, s))
        field = m @ (a - gravity + inner @ R.T)
        turned = field @ R
        direct = np.concatenate(
            (
                field.sum(axis=0),
                np.cross(s, turned).sum(axis=0),
                np.einsum("ia,ial->l", turned, shapes) + frame.Ke @ q + frame.De @ rate,
            )
        )
        for row in (slice(3), slice(3, 6), slice(6, None)):
            assert np.abs(residual - direct)[row].max() < 1e-12 * np.abs(direct[row]).max()
        velocities = v + (np.cross(w, s) + s1) @ R.T
        T, V = body.energy(np.concatenate((r0, R.ravel(), q)), np.concatenate((v, w, rate)), gravity)
        assert pytest.approx(0.5 * np.sum(velocities * (m @ velocities)), rel=1e-12) == T
        height = np.sum(m @ (r0 + s @ R.T) @ gravity)
        assert pytest.approx(0.5 * q @ frame.Ke @ q - height, rel=1e-12) == V


def test_second_order_displacements_move_the_mass():
    """A body that deforms by w(q) = sum w_kl q_k q_l / 2 only: forces to first order in w."""
    rng = np.random.default_rng(2)
    nodes, n = 7, 3
    m, x, _ = tiny("clamped", rng, nodes, n)
    w_kl = 1e-7 * rng.standard_normal((nodes, 3, n, n))
    w_kl = w_kl + w_kl.swapaxes(2, 3)
    load = np.einsum("ij,jakl->iakl", m, w_kl)
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
    eye, centrifugal = np.eye(3), []
    for a, b in pairs:
        field = np.cross(eye[a], np.cross(eye[b], x))
        if a != b:
            field = field + np.cross(eye[b], np.cross(eye[a], x))
        centrifugal.append(np.einsum("ia,iakl->kl", field, load))
    angular = [np.einsum("ia,iakl->kl", np.cross(eye[a], x), load) for a in range(3)]
    short = Foreshortening(linear=load.sum(axis=0), angular=np.array(angular), centrifugal=np.array(centrifugal))
    parts = integrals(m, x, np.zeros((nodes, 3, n)))

    def kernel(foreshortening):
        return Inertia(
            mass=parts.mass,
            first=parts.first,
            inertia=parts.inertia,
            Ct=parts.Ct,
            Cr=parts.Cr,
            Me=parts.Me,
            x_phi=parts.x_phi,
            phi_phi=parts.phi_phi,
            foreshortening=foreshortening,
        )

    q, rate, q2 = rng.standard_normal((3, n))
    w, a, w1 = rng.standard_normal((3, 3))
    accelerations = np.concatenate((a, w1, q2))

    def forces(foreshortening):
        M, g = kernel(foreshortening).evaluate(w, q, rate)
        return M @ accelerations + g

    bent = w_kl @ q
    s, s1, s2 = x + 0.5 * bent @ q, bent @ rate, bent @ q2 + w_kl @ rate @ rate
    field = m @ (a + np.cross(w1, s) + s2 + 2 * np.cross(w, s1) + np.cross(w, np.cross(w, s)))
    direct = np.concatenate((field.sum(axis=0), np.cross(s, field).sum(axis=0), np.einsum("ia,ial->l", field, bent)))
    change, second_order = direct - forces(None), forces(short) - forces(None)
    for row in (slice(3), slice(3, 6), slice(6, None)):
        assert np.abs(second_order - change)[row].max() < 1e-5 * np.abs(change[row]).max()


@pytest.fixture(scope="module")
def rod():
    """A soft rod with an interface at each end: kind of frame -> frame with 12 modes, tangent with stiffening."""
    model = steel(box("hex20", (8, 1, 1), (0.5, 0.02, 0.01)), young=2e9)
    interfaces = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling="rigid")
        for name, x in (("left", 0.0), ("right", 0.5))
    ]
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=6).reduce(problem)
        tangent = floating_frame(problem, reduced, kind="tangent", interfaces=("left",))
        return {
            "tangent": replace(tangent, stiffening=geometric_stiffening(problem, reduced, tangent)),
            "mean-axes": floating_frame(problem, reduced),
        }


def pendulum(frame, **options):
    """The rod hung at its left end, horizontal at the start: system, body and joint."""
    system = System(gravity=DOWN)
    body = system.add(FlexibleBody(frame, position=frame.origin, name="rod", **options))
    at = body.marker("left").place(body.start()[0]).position
    joint = system.add(RevoluteJoint(ground.marker_at(at), body.marker("left"), axis=(0, 1, 0)))
    return system, body, joint


def slow_modes(frame, keep=3):
    """The body with its few slowest shapes, those that bend in the plane of gravity included."""
    _, Y = sl.eigh(frame.Ke, frame.integrals.Me)
    Y = Y[:, :keep]
    old = frame.integrals
    parts = replace(
        old,
        Ct=Y.T @ old.Ct,
        Cr=Y.T @ old.Cr,
        Me=Y.T @ old.Me @ Y,
        x_phi=old.x_phi @ Y,
        phi_phi=np.einsum("abkl,ki,lj->abij", old.phi_phi, Y, Y),
    )
    markers = {name: replace(marker, motion=marker.motion @ Y) for name, marker in frame.markers.items()}
    return replace(
        frame,
        elastic=frame.elastic @ Y,
        integrals=parts,
        Ke=Y.T @ frame.Ke @ Y,
        De=Y.T @ frame.De @ Y,
        markers=markers,
        stiffening=None,
    )


def test_flexible_pendulum_against_an_ode_in_independent_coordinates(rod):
    """Angle and elastic coordinates alone (the tangent frame does not move in the joint), by another integrator."""
    frame = slow_modes(rod["tangent"])
    system, body, _ = pendulum(frame)
    n, origin = frame.count, body.start()[0][:3]
    arm = body.marker("left").point
    L = np.zeros((6 + n, 1 + n))
    L[4, 0] = 1.0
    L[6:, 1:] = np.eye(n)

    def full(y):
        R = exponential(np.array([0.0, y[0], 0.0]))
        rates = y[1 + n :]
        L[:3, 0] = -R @ np.cross([0.0, 1.0, 0.0], arm)
        x = np.concatenate((origin + arm - R @ arm, R.ravel(), y[1 : 1 + n]))
        still = np.zeros(6 + n)
        still[:3] = R @ np.cross([0.0, 1.0, 0.0], np.cross([0.0, 1.0, 0.0], arm)) * -(rates[0] ** 2)
        return x, L @ rates, still

    def rate(t, y):
        x, v, still = full(y)
        M, g = body.dynamics(t, x, v, np.array(DOWN))
        return np.concatenate((y[1 + n :], np.linalg.solve(L.T @ M @ L, -L.T @ (g + M @ still))))

    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13, "dense_output": True}
    path = solve_ivp(rate, (0, 0.1), np.zeros(2 + 2 * n), **options).sol
    tip, error = body.marker("right"), []
    for step in (4e-4, 2e-4):
        result = simulate(system, end=0.1, step=step, rho=0.9)
        exact = [path(t) for t in result.time]
        tips = [tip.place(full(y)[0]).position for y in exact]
        far = np.abs(result.position(tip) - tips).max()
        bent = np.abs(result.elastic(body) - np.array(exact)[:, 1 : 1 + n]).max() / np.abs(exact)[:, 1 : 1 + n].max()
        error.append([far, bent])
    error = np.array(error)
    assert np.log2(error[:-1] / error[1:]) == pytest.approx(2.0, abs=0.1)
    assert error[-1, 0] < 2e-5


def test_two_frames_of_one_body_move_alike(rod):
    """Same shapes, other frame: the difference is of second order in the deformation."""
    tips, bending = [], []
    for kind in ("tangent", "mean-axes"):
        system, body, _ = pendulum(rod[kind])
        result = simulate(system, end=0.1, step=5e-4)
        held = result.position(body.marker("left"))
        assert held[-1] == pytest.approx(held[0], abs=1e-9)
        tips.append(result.position(body.marker("right")))
        bending.append(np.abs(result.elastic(body) @ body.marker("right").motion[2]).max())
    deflection = bending[0]
    assert 1e-3 < deflection < 0.02
    assert np.abs(tips[0] - tips[1]).max() < 2 * deflection**2 / 0.5


def test_energy_and_time_of_a_pendulum_with_twelve_modes(rod):
    for options in ({}, {"stiffening": True}):
        system, body, _ = pendulum(rod["tangent"], **options)
        assert body.size == 18
        result = simulate(system, end=0.05, step=2.5e-4)
        energy = result.energy()
        assert np.abs(energy.total - energy.total[0]).max() < 2e-6 * energy.kinetic.max()


def test_damped_cantilever_comes_to_rest_at_its_static_deflection(rod):
    frame = rod["tangent"]
    frame = replace(frame, De=2e-2 * frame.Ke)
    system = System()
    body = system.add(FlexibleBody(frame, position=frame.origin))
    joint = system.add(FixedJoint(ground.marker_at(body.marker("left").point), body.marker("left")))
    system.add(PointLoad(body.marker("right"), force=(0, 0, -0.1)))
    result = simulate(system, end=4.0, step=5e-3, rho=0.5)
    q = np.linalg.solve(frame.Ke, -0.1 * frame.markers["right"].motion[2])
    assert result.elastic(body)[-1] == pytest.approx(q, rel=1e-5, abs=1e-8 * np.abs(q).max())
    # The joint holds the load and its moment about the left end.
    assert result.reaction(joint)[-1] == pytest.approx([0, 0, 0.1, 0, -0.05, 0], abs=2e-4)


def test_stiffening_raises_the_frequency_of_a_spinning_cantilever(rod):
    """Southwell: the first flap frequency of a clamped beam on its axis rises by 1.193 W^2."""
    speed, frequencies = 12.0, []
    for stiff, spin in ((False, 0.0), (True, speed)):
        frame = rod["tangent"]
        flap = np.linalg.solve(frame.Ke, frame.markers["right"].motion[2])
        tip = frame.markers["right"].motion[2] @ flap
        left = frame.markers["left"].point
        system = System()
        body = system.add(
            FlexibleBody(
                frame,
                position=frame.origin,
                angular_velocity=(0, 0, spin),
                stiffening=stiff,
                elastic=1e-5 / tip * flap,
                velocity=-np.cross((0, 0, spin), left),
            )
        )
        base = ground.marker_at(left)
        system.add(RevoluteJoint(base, body.marker("left"), axis=(0, 0, 1)))
        system.add(DrivenAngle(base, body.marker("left"), axis=(0, 0, 1), motion=Motion.steady(spin)))
        result = simulate(system, end=1.0, step=1e-3, rho=0.8)
        z = result.position(body.marker("right"))[:, 2] - left[2]
        rising = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
        times = result.time[rising] - z[rising] * np.diff(result.time)[rising] / (z[rising + 1] - z[rising])
        frequencies.append(2 * np.pi * (len(times) - 1) / (times[-1] - times[0]))
    assert (frequencies[1] ** 2 - frequencies[0] ** 2) / speed**2 == pytest.approx(1.193, abs=0.03)


def test_stiffening_keeps_the_mass_matrix_definite_and_the_energy_where_shapes_have_momentum(rod):
    """Elastic shapes of a tangent frame carry most of the momentum; second-order terms must not overtake it."""
    frame = rod["tangent"]
    tip = frame.markers["right"].motion[:3]
    _, modes = sl.eigh(frame.Ke, frame.integrals.Me)
    for mode in modes[:, :3].T:
        # 0.5 % of the length at the tip.
        q = 0.0025 / np.linalg.norm(tip @ mode) * mode
        M, _ = FlexibleBody(frame, stiffening=True).inertia.evaluate(np.zeros(3), q, np.zeros(frame.count))
        d = 1 / np.sqrt(np.diag(M))
        assert np.linalg.eigvalsh(M * np.outer(d, d))[0] > 0
    system = System(gravity=DOWN)
    left, spin = frame.markers["left"].point, np.array([3.0, 5.0, 12.0])
    body = system.add(
        FlexibleBody(
            frame, stiffening=True, position=frame.origin, velocity=-np.cross(spin, left), angular_velocity=spin
        )
    )
    system.add(SphericalJoint(ground.marker_at(left + frame.origin), body.marker("left")))
    result = simulate(system, end=0.02, step=1e-4, rho=0.8)
    energy = result.energy()
    total = energy.total - energy.work
    assert np.linalg.norm(result.elastic(body) @ tip.T, axis=1).max() > 1e-3
    assert np.ptp(total) < 1e-5 * energy.kinetic.max()


def spun(frame, end, spin=80.0, **options):
    """A rod that is turned about its left end faster than its first frequency across the axis, without stiffening."""
    lag = np.linalg.solve(frame.Ke, frame.markers["right"].motion[1])
    left, tip = frame.markers["left"].point, frame.markers["right"].motion[1] @ lag
    system = System()
    body = system.add(
        FlexibleBody(
            frame,
            position=frame.origin,
            angular_velocity=(0, 0, spin),
            elastic=1e-4 / tip * lag,
            velocity=-np.cross((0, 0, spin), left),
            name="rod",
        )
    )
    base = ground.marker_at(left + frame.origin)
    system.add(RevoluteJoint(base, body.marker("left"), axis=(0, 0, 1)))
    system.add(DrivenAngle(base, body.marker("left"), axis=(0, 0, 1), motion=Motion.steady(spin)))
    result = simulate(system, end=end, step=1e-3, **options)
    return body, np.linalg.norm(result.elastic(body) @ frame.markers["right"].motion[:3].T, axis=1)


def test_a_linear_deflection_as_long_as_the_body_stops_the_run(rod):
    frame = slow_modes(rod["tangent"])
    body, far = spun(frame, 0.2, max_deflection=None)
    # The diagonal of the bar, from its inertia.
    assert body.length == pytest.approx(np.sqrt(0.5**2 + 0.02**2 + 0.01**2), rel=1e-6)
    assert far[-1] > 2 * body.length
    for limit, options in ((1.0, {}), (0.1, {"max_deflection": 0.1})):
        with refusal("result", "", "rod", by=SolverError) as caught:
            spun(frame, 0.2, **options)
        time = float(re.search(r"at t = (\S+) s", str(caught.value))[1])
        assert far[round(1e3 * time) - 1] <= limit * body.length < far[round(1e3 * time)]
    with refusal("value", "max_deflection", "-1"):
        spun(frame, 0.2, max_deflection=-1)


def test_tension_at_the_tip_stiffens_a_cantilever_as_beam_theory_says(rod):
    frame, P = rod["tangent"], 20.0
    frame = replace(frame, De=2e-2 * frame.Ke)
    sag = []
    for load in (0.0, P):
        system = System()
        body = system.add(FlexibleBody(frame, position=frame.origin, stiffening=True))
        system.add(FixedJoint(ground.marker_at(body.marker("left").point), body.marker("left")))
        system.add(PointLoad(body.marker("right"), force=(load, 0, -0.1)))
        result = simulate(system, end=4.0, step=5e-3, rho=0.5)
        sag.append(np.ptp(result.position(body.marker("right"))[[0, -1], 2]))
    k = 0.5 * np.sqrt(P / (2e9 * 0.02 * 0.01**3 / 12))
    assert sag[1] / sag[0] == pytest.approx(3 * (k - np.tanh(k)) / k**3, rel=0.01)
    # The rows of the marker are the derivatives of its motion.
    tip, x, e = body.marker("right"), result.configuration(body)[-1], 1e-6
    for i in range(12):
        step = np.zeros(18)
        step[6 + i] = e
        change = tip.place(body.move(x, step)).position - tip.place(body.move(x, -step)).position
        assert change / (2 * e) == pytest.approx(tip.place(x).jacobian[:3, 6 + i], rel=1e-6, abs=1e-6)


def test_loads_of_a_marker_are_those_of_its_joints_and_forces_along_the_body(rod):
    """Either end of a joint, against its reaction and against the force that was put on."""
    turn, force = exponential(np.array([0.4, -0.9, 0.3])), np.array([1.0, -2.0, 0.5])
    loads = []
    for first in (False, True):
        system = System(gravity=DOWN)
        body = system.add(FlexibleBody(rod["tangent"], rotation=turn, name="rod"))
        left, right = body.marker("left"), body.marker("right")
        hold = ground.marker_at(left.place(body.start()[0]).position)
        joint = system.add(SphericalJoint(left, hold) if first else SphericalJoint(hold, left))
        system.add(PointLoad(right, force=force))
        result = simulate(system, end=0.05, step=1e-3)
        motion = result.trajectory(body, interfaces=["left", "right"])
        A, on = motion["rotation"], motion["loads"]
        assert np.allclose(A @ np.swapaxes(A, 1, 2), np.eye(3)) and np.array_equal(motion["times"], result.time)
        assert np.array_equal(motion["coordinates"], result.elastic(body))
        sign = -1 if first else 1
        assert np.allclose(np.einsum("tij,tj->ti", A, on[:, :3]), sign * result.reaction(joint)[:, :3], atol=1e-9)
        assert np.allclose(np.einsum("tij,tj->ti", A, on[:, 6:9]), force, atol=1e-12)
        # The frame lies where the marker of its undeformed origin is.
        origin = body.marker_at((0, 0, 0), np.zeros((6, body.inertia.n)))
        assert np.allclose(motion["position"], result.position(origin), atol=1e-14)
        loads.append(on)
    assert np.allclose(*loads, atol=1e-7 * np.abs(loads[0]).max())


def test_a_restart_comes_once_in_a_trajectory(rod):
    system, body, _ = pendulum(rod["mean-axes"])
    plain = simulate(system, end=0.01, step=1e-3)
    twice = replace(plain, segments=(*plain.segments, replace(plain.segments[0], time=plain.time + plain.time[-1])))
    motion = twice.trajectory(body)
    assert len(motion["times"]) == 2 * len(plain.time) - 1 and (np.diff(motion["times"]) > 0).all()
    assert np.array_equal(motion["position"][10], plain.trajectory(body)["position"][0])
    with refusal("value", "trajectory"):
        plain.trajectory(RigidBody(1.0, (1, 1, 1), name="crank"))
    with refusal("unknown", "", "lift", "left"):
        plain.trajectory(body, interfaces=["lift"])


def test_bad_flexible_bodies_are_told(rod):
    plain = rod["mean-axes"]
    with refusal("missing", "stiffening"):
        FlexibleBody(plain, stiffening=True)
    body = FlexibleBody(plain, name="rod")
    with refusal("unknown", "", "rod", "rigth", "right"):
        body.marker("rigth")
    with refusal("value", "motion"):
        body.marker_at((0, 0, 0), np.zeros((6, 3)))
    with refusal("value", "elastic", "12"):
        FlexibleBody(plain, elastic=np.zeros(3))
    rigid = replace(plain.integrals, Me=np.zeros((12, 12)))
    with refusal("model", "mass"):
        FlexibleBody(replace(plain, integrals=rigid))


def test_a_marker_at_a_node_moves_with_its_rows(rod):
    frame = rod["tangent"]
    body = FlexibleBody(frame, position=(1, 2, 3))
    interface = frame.markers["right"]
    node = body.marker_at(interface.point, interface.motion[:3], name="node")
    x = np.concatenate((body.start()[0][:12], 1e-3 * np.random.default_rng(0).standard_normal(12)))
    assert node.place(x).position == pytest.approx(body.marker("right").place(x).position, abs=1e-15)
    assert body.marker("node") is node


def test_the_work_of_a_circulatory_matrix_is_told():
    """Its body moves as the matrix exponential says, and gains the energy that is put in."""
    K, D = np.array([[4.0, 1.0], [-1.0, 9.0]]), np.array([[0.1, 1.0], [-1.0, 0.1]])
    system = System(gravity=(0, 0, 0))
    body = system.add(LinearBody(np.eye(2), K, D, start=[1.0, 0.5]))
    result = simulate(system, end=3.0, step=2e-3)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -D]])
    np.testing.assert_allclose(result.configuration(body)[-1], (sl.expm(3 * A) @ [1, 0.5, 0, 0])[:2], atol=1e-4)
    energy = result.energy()
    assert np.ptp(energy.total - energy.work) < 1e-4 < np.ptp(energy.total)
