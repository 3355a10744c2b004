"""The simulator with rigid bodies: joints, loads, springs, energy, switches, own components, bad input."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from morembs.base.errors import InputError, SolverError
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.dynamics.multibody import (
    Assembly,
    DrivenAngle,
    DrivenPosition,
    EventHandler,
    FixedJoint,
    FlexibleBody,
    Motion,
    PointLoad,
    PrismaticJoint,
    RestartState,
    RevoluteJoint,
    RigidBody,
    SphericalJoint,
    SpringDamper,
    System,
    TorsionSpring,
    VectorComponent,
    ground,
    rotation,
    simulate,
)
from morembs.dynamics.multibody.rotations import exponential, logarithm, tangent
from tests.support.refusals import refusal

DOWN = (0.0, 0.0, -9.81)


def link(name="link", **options):
    """A rod along x, 1 m, 2 kg, with markers at both ends."""
    ends = {"left": (-0.5, 0, 0), "right": (0.5, 0, 0)}
    return RigidBody(2.0, (0.01, 1 / 6, 1 / 6), markers=ends, name=name, **options)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.99e-3, 1.01e-3, 1.0, 3.0, np.pi - 1e-9])
def test_rotations(angle):
    axis = np.array([1.0, -2.0, 3.0]) / np.sqrt(14)
    p = angle * axis
    A = np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
    power, R = np.eye(3), np.eye(3)
    for k in range(1, 40):
        power = power @ A / k
        R = R + power
    assert exponential(p) == pytest.approx(R, abs=1e-14)
    assert logarithm(R) == pytest.approx(p, abs=1e-8 if angle > 3 else 1e-14)
    step, e = np.array([0.3, 0.2, -0.1]), 1e-5
    change = exponential(p).T @ (exponential(p + e * step) - exponential(p - e * step)) / (2 * e)
    rate = tangent(p) @ step
    assert change == pytest.approx(np.cross(rate, np.eye(3)).T, abs=1e-9)


@pytest.mark.parametrize("axis", [(0, 0, 0), (1, 0), (1, np.nan, 0)])
def test_a_rotation_needs_an_axis(axis):
    with refusal("value", "axis"):
        rotation(axis, 0.5)


def flexible():
    """An elastic body with made-up integrals: three shapes without coupling to rigid motion."""
    zero = np.zeros
    parts = ShapeIntegrals(
        mass=1.0,
        first=zero(3),
        inertia=np.eye(3),
        second=zero((3, 3)),
        Ct=zero((3, 3)),
        Cr=zero((3, 3)),
        Me=np.eye(3),
        x_phi=zero((3, 3, 3)),
        phi_phi=zero((3, 3, 3, 3)),
    )
    frame = FloatingFrame(
        kind="mean-axes",
        origin=zero(3),
        elastic=np.eye(3),
        rigid=zero((3, 6)),
        integrals=parts,
        Ke=np.eye(3),
        De=zero((3, 3)),
        markers={},
    )
    return FlexibleBody(frame, name="elastic")


JOINTS = (SphericalJoint, RevoluteJoint, PrismaticJoint, FixedJoint, DrivenAngle, DrivenPosition)


@pytest.mark.parametrize("joint", JOINTS)
def test_jacobians_are_derivatives(joint):
    rng = np.random.default_rng(5)
    system = System()
    first = system.add(link(position=(0.2, 0.1, 0.4), rotation=rotation((1, 2, 3), 0.7)))
    second = system.add(flexible())
    options = {} if joint is SphericalJoint else {"axis": (1, -1, 0.5)}
    if joint in (DrivenAngle, DrivenPosition):
        options["motion"] = Motion.steady(0.0)
    turned = first.marker_at((0.1, 0.2, 0.3), axes=rotation((0, 1, 1), 0.4))
    node = second.marker_at((1, 0, 0), rng.standard_normal((6, 3)))
    constraint = system.add(joint(turned, node, **options))
    assembly = Assembly(system)
    x, _ = assembly.start()
    x = assembly.move(x, 0.4 * rng.standard_normal(assembly.size))
    Phi, B = assembly.constraints(0.0, assembly.places(x))
    assert len(Phi) == constraint.count
    e = 1e-5
    for k, unit in enumerate(np.eye(assembly.size)):
        ahead, behind = (assembly.constraints(0.0, assembly.places(assembly.move(x, s * unit)))[0] for s in (e, -e))
        assert (ahead - behind) / (2 * e) == pytest.approx(B[:, k], abs=1e-8)
    # The second derivative along a motion, against a difference with another step.
    v = rng.standard_normal(assembly.size)
    ahead, behind = (assembly.constraints(0.0, assembly.places(assembly.move(x, s * v)))[1] @ v for s in (e, -e))
    assert assembly.curvature(x, v, 1.0) == pytest.approx((ahead - behind) / (2 * e), rel=1e-7, abs=1e-7)


def double_pendulum(kind):
    system = System(gravity=DOWN)
    a, b = system.add(link("a", position=(0.5, 0, 0))), system.add(link("b", position=(1.5, 0, 0)))
    options = {"axis": (0, 1, 0)} if kind is RevoluteJoint else {}
    system.add(kind(ground.marker_at(), a.marker("left"), **options))
    system.add(kind(a.marker("right"), b.marker("left"), **options))
    return system, a, b


def angles(t, y):
    """Equations of the double pendulum in absolute angles below the x axis."""
    (p, q), (dp, dq) = y[:2], y[2:]
    half = 2.0 * 0.5 * np.cos(p - q)
    M = np.array([[1 / 6 + 2 * 0.25 + 2.0, half], [half, 1 / 6 + 2 * 0.25]])
    spin = 2.0 * 0.5 * np.sin(p - q)
    weight = 2.0 * 9.81 * np.array([1.5 * np.cos(p), 0.5 * np.cos(q)])
    return np.concatenate(((dp, dq), np.linalg.solve(M, weight - spin * np.array([dq**2, -(dp**2)]))))


@pytest.mark.parametrize("kind", [RevoluteJoint, SphericalJoint])
def test_double_pendulum_against_its_equations_in_angles(kind):
    exact = solve_ivp(angles, (0, 1), np.zeros(4), rtol=1e-11, atol=1e-12).y[:, -1]
    tip = np.array([np.cos(exact[0]) + np.cos(exact[1]), 0, -np.sin(exact[0]) - np.sin(exact[1])])
    system, _, b = double_pendulum(kind)
    error = []
    for step in (4e-3, 2e-3):
        result = simulate(system, end=1.0, step=step)
        error.append(np.abs(result.position(b.marker("right"))[-1] - tip).max())
        energy = result.energy()
        assert np.abs(energy.total - energy.total[0]).max() < 20 * step**2 * energy.kinetic.max()
    assert np.log2(np.divide(error[:-1], error[1:])) == pytest.approx(2.0, abs=0.1)
    assert error[-1] < 1e-4


class TwoAngles(VectorComponent):
    """The same double pendulum as a component of its own with a mass matrix that depends on the angles."""

    name, size, configuration_size = "angles", 2, 2

    def start(self):
        return np.zeros(2), np.zeros(2)

    def dynamics(self, t, x, v, gravity):
        half = np.cos(x[0] - x[1])
        M = np.array([[1 / 6 + 2.5, half], [half, 1 / 6 + 0.5]])
        return M, -M @ angles(t, np.concatenate((x, v)))[2:]

    def energy(self, x, v, gravity):
        M, _ = self.dynamics(0.0, x, v, gravity)
        return 0.5 * v @ M @ v, -2.0 * 9.81 * (1.5 * np.sin(x[0]) + 0.5 * np.sin(x[1]))

    def power(self, x, v):
        return 0.0

    def marker(self, name):
        raise InputError("no markers")


def test_a_component_with_its_own_mass_matrix():
    system = System(gravity=DOWN)
    own = system.add(TwoAngles())
    result = simulate(system, end=1.0, step=1e-3)
    exact = solve_ivp(angles, (0, 1), np.zeros(4), rtol=1e-11, atol=1e-12).y[:, -1]
    assert result.configuration(own)[-1] == pytest.approx(exact[:2], abs=5e-5)
    assert result.speeds(own)[-1] == pytest.approx(exact[2:], abs=5e-4)
    total = result.energy().total
    assert np.abs(total - total[0]).max() < 2e-4


def test_a_driven_joint_follows_its_motion_through_more_than_a_turn():
    motion = Motion(lambda t: 5 - 5 * np.cos(4 * t), lambda t: 20 * np.sin(4 * t), lambda t: 80 * np.cos(4 * t))
    system = System()
    body = system.add(link(position=(0.5, 0, 0)))
    base = ground.marker_at(axes=rotation((1, 0, 0), 0.3))
    axis = rotation((1, 0, 0), 0.3) @ (0, 0, 1)
    system.add(RevoluteJoint(base, body.marker("left"), axis=(0, 0, 1)))
    driver = system.add(DrivenAngle(base, body.marker("left"), axis=(0, 0, 1), motion=motion))
    result = simulate(system, end=1.0, step=5e-4)
    for t, R in list(zip(result.time, result.axes(body.marker("left")), strict=True))[::50]:
        assert np.abs(R - rotation(axis, motion.value(t))).max() < 1e-9
    about_end = 1 / 6 + 2 * 0.25
    torque = [about_end * motion.acceleration(t) for t in result.time]
    largest = np.abs(torque).max()
    assert result.reaction(driver)[:, 3:] @ axis == pytest.approx(torque, abs=5e-4 * largest)
    energy = result.energy()
    assert energy.work == pytest.approx(energy.total - energy.total[0], abs=5e-5 * energy.kinetic.max())


def test_sliding_down_an_incline():
    slope = 0.6
    system = System(gravity=DOWN)
    body = system.add(link(rotation=rotation((0, 1, 0), slope)))
    down = (np.cos(slope), 0, -np.sin(slope))
    joint = system.add(PrismaticJoint(ground.marker_at(), body.marker_at((0, 0, 0)), axis=down))
    result = simulate(system, end=1.0, step=0.01)
    way = 0.5 * 9.81 * np.sin(slope) * result.time**2
    assert result.position(joint.second) == pytest.approx(way[:, None] * down, abs=1e-9)
    across = 2 * 9.81 * np.cos(slope) * np.array([np.sin(slope), 0, np.cos(slope)])
    assert result.reaction(joint)[:, :3] == pytest.approx(np.tile(across, (101, 1)), abs=1e-7)


def test_a_driven_slider():
    motion = Motion.smooth(0.4, 0.5)
    assert (motion.value(-1), motion.value(0.25), motion.value(9)) == pytest.approx((0, 0.2, 0.4))
    for t in (0.1, 0.3):
        for low, high in ((motion.value, motion.rate), (motion.rate, motion.acceleration)):
            assert (low(t + 1e-6) - low(t - 1e-6)) / 2e-6 == pytest.approx(high(t), rel=1e-7)
    system = System(gravity=DOWN)
    body = system.add(link())
    center = body.marker_at((0, 0, 0))
    system.add(PrismaticJoint(ground.marker_at(), center, axis=(0, 1, 0)))
    driver = system.add(DrivenPosition(ground.marker_at(), center, axis=(0, 1, 0), motion=motion))
    result = simulate(system, end=0.6, step=1e-3, rho=0.6)
    assert result.position(center)[:, 1] == pytest.approx([motion.value(t) for t in result.time], abs=1e-10)
    expected = np.array([2 * motion.acceleration(t) for t in result.time])
    smooth = np.abs(result.time - 0.25) < 0.2
    assert result.reaction(driver)[smooth, 1] == pytest.approx(expected[smooth], abs=5e-4 * expected.max())


def test_spring_and_damper_against_the_analytic_oscillator():
    k, c, m = 50.0, 0.8, 2.0
    system = System()
    body = system.add(link(position=(1.3, 0, 0)))
    center = body.marker_at((0, 0, 0))
    system.add(PrismaticJoint(ground.marker_at(), center, axis=(1, 0, 0)))
    system.add(SpringDamper(ground.marker_at(), center, stiffness=k, damping=c, length=1.0))
    decay, error = c / (2 * m), []
    w = np.sqrt(k / m - decay**2)
    for step in (4e-3, 2e-3):
        result = simulate(system, end=1.0, step=step)
        t = result.time
        exact = 1 + 0.3 * np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))
        error.append(np.abs(result.position(center)[:, 0] - exact).max())
        energy = result.energy()
        assert energy.total - energy.work == pytest.approx(np.full(len(t), 0.5 * k * 0.3**2), rel=5e-4)
    assert error[1] < 1e-4 and np.log2(error[0] / error[1]) == pytest.approx(2.0, abs=0.1)


def test_torsion_spring_and_spring_without_length():
    system = System()
    body = system.add(link(angular_velocity=(0, 0, 1.0), velocity=(0, 0.5, 0), position=(0.5, 0, 0)))
    system.add(RevoluteJoint(ground.marker_at(), body.marker("left"), axis=(0, 0, 1)))
    system.add(TorsionSpring(ground.marker_at(), body.marker("left"), axis=(0, 0, 1), stiffness=6.0, angle=0.1))
    w = np.sqrt(6.0 / (1 / 6 + 0.5))
    result = simulate(system, end=0.8, step=1e-3)
    turn = 0.1 - 0.1 * np.cos(w * result.time) + np.sin(w * result.time) / w
    assert result.position(body.marker("right")) == pytest.approx(
        np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1), abs=5e-5
    )
    assert np.ptp(result.energy().total) < 1e-5
    system = System()
    body = system.add(link(position=(0.1, 0.2, 0), velocity=(0, 0, 1)))
    system.add(SpringDamper(ground.marker_at(), body.marker_at((0, 0, 0), name="center"), stiffness=50.0, length=0.0))
    result = simulate(system, end=0.6, step=1e-3)
    c, s = np.cos(5 * result.time), np.sin(5 * result.time)
    center = np.stack((0.1 * c, 0.2 * c, s / 5), axis=1)
    assert result.position(body.marker("center")) == pytest.approx(center, abs=2e-5)


def test_loads_on_a_free_body():
    system = System()
    body = system.add(link())
    center = body.marker_at((0, 0, 0))
    system.add(PointLoad(center, force=lambda t: (6 * t, 0, 0), moment=(0, 0, 0.5)))
    result = simulate(system, end=1.0, step=1e-3)
    assert result.position(center)[-1] == pytest.approx([0.5, 0, 0], abs=1e-6)
    assert logarithm(result.axes(center)[-1]) == pytest.approx([0, 0, 1.5], abs=1e-8)
    energy = result.energy()
    assert energy.work[-1] == pytest.approx(energy.kinetic[-1], rel=1e-5)
    # A force that follows the end of the rod turns it like a moment of constant size.
    system = System()
    body = system.add(link())
    system.add(PointLoad(body.marker("right"), force=(0, 0.2, 0), follows=True))
    result = simulate(system, end=1.0, step=1e-3)
    assert logarithm(result.axes(body.marker("right"))[-1]) == pytest.approx([0, 0, 0.5 * 0.1 * 6], abs=1e-6)


def test_two_bodies_fixed_together_move_as_one():
    """A tumbling pair against one body with the inertia of both; no torque, so it keeps its angular momentum."""
    spin = np.array([3.0, 2.0, 1.0])
    system = System()
    a = system.add(link("a", position=(-0.5, 0, 0), angular_velocity=spin, velocity=np.cross(spin, (-0.5, 0, 0))))
    turn = rotation((1, 0, 0), 0.8)
    b = system.add(
        link(
            "b",
            position=(0.5, 0, 0),
            rotation=turn,
            angular_velocity=turn.T @ spin,
            velocity=np.cross(spin, (0.5, 0, 0)),
        )
    )
    joint = system.add(FixedJoint(a.marker("right"), b.marker("left")))
    pair = simulate(system, end=0.5, step=1e-3)
    system = System()
    both = system.add(RigidBody(4.0, (0.02, 1 / 3 + 1, 1 / 3 + 1), angular_velocity=spin, markers={"c": (0, 0, 0)}))
    result = simulate(system, end=0.5, step=1e-3)
    assert pair.axes(a.marker("left"))[-1] == pytest.approx(result.axes(both.marker("c"))[-1], abs=2e-5)
    assert pair.axes(b.marker("left"))[-1] == pytest.approx(pair.axes(a.marker("left"))[-1] @ turn, abs=1e-9)
    assert pair.position(a.marker("right")) == pytest.approx(np.zeros((501, 3)), abs=1e-7)
    assert pair.multipliers(joint).shape == (501, 6)


class Floor(EventHandler):
    """A body that falls on the floor at z = 0 and leaves it with the same speed."""

    def time(self, before, after):
        z0, z1, v0 = before.x[2], after.x[2], before.v[2]
        if z1 > 0 or before.v[2] > 0:
            return None
        t = (v0 + np.sqrt(v0**2 + 2 * 9.81 * z0)) / 9.81
        return before.time + t

    def change(self, state):
        v = state.v.copy()
        v[2] = -v[2]
        return RestartState(x=state.x, v=v)


def test_an_event_stops_inside_a_step_and_restarts():
    system = System(gravity=DOWN)
    ball = system.add(RigidBody(1.0, (1, 1, 1), position=(0, 0, 1), markers={"c": (0, 0, 0)}))
    result = simulate(system, end=2.0, step=7e-3, events=Floor())
    fall = np.sqrt(2 / 9.81)
    assert [s.time[0] for s in result.segments[1:]] == pytest.approx([fall, 3 * fall], abs=1e-9)
    phase = (result.time + fall) % (2 * fall) - fall
    assert result.position(ball.marker("c"))[:, 2] == pytest.approx(1 - 9.81 / 2 * phase**2, abs=1e-7)
    assert result.time[-1] == 2.0 and (np.diff(result.time) <= 7e-3 * (1 + 1e-9)).all()


class Break(EventHandler):
    """Takes the joint away at a time, and names the body anew in another system."""

    def __init__(self, when, system):
        self.when, self.system = when, system

    def time(self, before, after):
        return self.when if before.time < self.when <= after.time else None

    def change(self, state):
        return RestartState(x=state.x, v=state.v, system=self.system)


def test_an_event_may_change_the_system():
    """A pendulum that comes off its joint flies on as a free body."""

    def hung(joined):
        system = System(gravity=DOWN)
        body = system.add(link(position=(0.5, 0, 0)))
        if joined:
            system.add(RevoluteJoint(ground.marker_at(), body.marker("left"), axis=(0, 1, 0)))
        return system, body

    (system, body), (free, _) = hung(True), hung(False)
    result = simulate(system, end=0.8, step=1.7e-3, events=Break(0.5, free))
    center = 0.5 * (result.position(body.marker("left")) + result.position(body.marker("right")))
    velocity = 0.5 * (result.velocity(body.marker("left")) + result.velocity(body.marker("right")))
    k = len(result.segments[0].time) - 1
    assert result.time[k] == result.time[k + 1] == 0.5
    later = (result.time[k:] - 0.5)[:, None]
    assert center[k:] == pytest.approx(center[k] + later * velocity[k] + 0.5 * later**2 * DOWN, abs=1e-6)
    energy = result.energy()
    assert np.abs(energy.total - energy.total[0]).max() < 3e-4


def test_multipliers_stay_of_second_order_after_a_restart():
    """A switch that changes nothing, in a fast spin: the error of the joint force must not jump."""
    about_end, errors = 1 / 6 + 0.5, []
    options = {"rtol": 1e-11, "atol": 1e-12, "dense_output": True}
    path = solve_ivp(lambda t, y: (y[1], 9.81 * np.cos(y[0]) / about_end), (0, 0.6), (0, 4.0), **options).sol
    for step in (2e-3, 1e-3):
        system = System(gravity=DOWN)
        body = system.add(link(position=(0.5, 0, 0), angular_velocity=(0, 4.0, 0), velocity=(0, 0, -2.0)))
        joint = system.add(RevoluteJoint(ground.marker_at(), body.marker("left"), axis=(0, 1, 0)))
        restarted = simulate(system, end=0.6, step=step, events=Break(0.3001, system))
        angle = path(restarted.time)
        c, s = np.cos(angle[0]), np.sin(angle[0])
        turning, spin = 9.81 * c / about_end, angle[1] ** 2
        force = 2 * np.stack((-0.5 * (turning * s + spin * c), 0 * c, 9.81 - 0.5 * (turning * c - spin * s)), axis=1)
        errors.append(np.abs(restarted.reaction(joint)[:, :3] - force).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.25)


def chain():
    system = System()
    a, b = system.add(link("a", position=(0.5, 0, 0))), system.add(link("b", position=(1.5, 0, 0)))
    return system, a, b


def test_redundant_joints_are_named():
    system, a, b = chain()
    system.add(RevoluteJoint(ground.marker_at(), a.marker("left"), name="foot"))
    system.add(RevoluteJoint(a.marker("right"), b.marker("left"), axis=(0, 0, 1), name="knee"))
    system.add(FixedJoint(ground.marker_at((2, 0, 0)), b.marker("right"), name="head"))
    with refusal("model", "joint", "4", "16", "foot", "knee"):
        simulate(system, end=1, step=0.1)
    system, a, b = chain()
    system.add(SphericalJoint(ground.marker_at(), a.marker("left"), name="good"))
    for name in ("one", "two"):
        system.add(SphericalJoint(a.marker("right"), b.marker("left"), name=name))
    with refusal("model", "joint", "9") as caught:
        simulate(system, end=1, step=0.1)
    assert "'one'" in str(caught.value) and "'two'" in str(caught.value) and "'good'" not in str(caught.value)


def test_bad_starts_are_told():
    system, a, _ = chain()
    system.add(SphericalJoint(ground.marker_at((0, 0, 1)), a.marker("left"), name="foot"))
    with refusal("model", "joint", "foot"):
        simulate(system, end=1, step=0.1)
    system = System()
    body = system.add(link(position=(0.5, 0, 0), velocity=(1, 0, 0)))
    system.add(SphericalJoint(ground.marker_at(), body.marker("left"), name="foot"))
    with refusal("model", "velocity", "foot"):
        simulate(system, end=1, step=0.1)
    system = System()
    body = system.add(link(position=(0.5, 0, 0)))
    system.add(RevoluteJoint(ground.marker_at(), body.marker("left")))
    system.add(DrivenAngle(ground.marker_at(), body.marker("left"), motion=Motion.steady(2.0)))
    with refusal("model", "velocity"):
        simulate(system, end=1, step=0.1)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"end": 0.0}, ("conflict", "end")),
        ({"end": np.nan}, ("value", "end")),
        ({"step": 0.0}, ("value", "step")),
        ({"step": -1.0}, ("value", "step", "-1")),
        ({"step": 2.0}, ("value", "step")),
        ({"rho": 1.5}, ("value", "rho", "1.5")),
        ({"rho": np.nan}, ("value", "rho")),
        ({"tolerance": 0.0}, ("value", "tolerance")),
        ({"begin": 5.0}, ("conflict", "end", "5")),
    ],
)
def test_nonsense_times_are_told(change, message):
    with refusal(*message):
        simulate(double_pendulum(SphericalJoint)[0], **{"end": 1.0, "step": 0.1, **change})


def test_bad_parts_are_told():
    with refusal("value", "mass", "0.0"):
        RigidBody(0.0, (1, 1, 1))
    for inertia in ((1, 1, 0), np.diag([1, 1, -1]), [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]):
        with refusal("model", "inertia"):
            RigidBody(1.0, inertia)
    with refusal("value", "position"):
        RigidBody(1.0, (1, 1, 1), position=(1, 2))
    with refusal("value", "rotation"):
        RigidBody(1.0, (1, 1, 1), rotation=2 * np.eye(3))
    body = link()
    with refusal("unknown", "", "link", "lift", "left"):
        body.marker("lift")
    with refusal("missing", "", "'left'", "ground.marker_at(point)"):
        ground.marker("left")
    with refusal("conflict", "", "left"):
        body.marker_at((0, 0, 0), name="left")
    with refusal("value", "direction"):
        RevoluteJoint(ground.marker_at(), body.marker("left"), axis=(0, 0, 0))
    with refusal("model", "markers"):
        SpringDamper(ground.marker_at(), body.marker_at((0, 0, 0)), stiffness=1.0, length=0.5)
    with refusal("value", "stiffness", "-1"):
        SpringDamper(ground.marker_at(), body.marker("left"), stiffness=-1.0)
    with refusal("value", "duration"):
        Motion.smooth(1.0, 0.0)


def test_bad_systems_are_told():
    with refusal("missing", "bodies"):
        simulate(System(), end=1, step=0.1)
    system, body = System(), link()
    with refusal("unknown", "", "SphericalJoint", "link.left"):
        system.add(SphericalJoint(ground.marker_at(), body.marker("left")))
    system.add(body)
    with refusal("conflict", "name", "link"):
        system.add(link())
    with refusal("conflict", "", "link.left", "link.right"):
        system.add(SphericalJoint(body.marker("left"), body.marker("right")))
    with refusal("value", "add"):
        system.add("a rod")
    with refusal("unknown", "", "lonk", "link"):
        system.component("lonk")
    with refusal("result", "events", by=SolverError):
        simulate(system, end=1, step=0.1, events=Again())


class Again(EventHandler):
    def time(self, before, after):
        return before.time + 1e-12

    def change(self, state):
        return RestartState(x=state.x, v=state.v)
