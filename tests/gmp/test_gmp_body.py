"""Parameterised members as bodies of morembs.dynamics.multibody, against the nodal mechanism and conservation laws."""

import re
from pathlib import Path

import numpy as np
import pytest

from morembs.base.errors import SolverError
from morembs.dynamics.gmp import ParameterisedBody, PlaneJoint, ReducedMember, solid_member
from morembs.dynamics.multibody import RevoluteJoint, RigidBody, System, ground, rotation, simulate
from morembs.dynamics.nonlinear import Mechanism
from morembs.dynamics.nonlinear import simulate as simulate_nodes
from tests.gmp.test_gmp import LENGTH, bent, pendulum, rod
from tests.gmp.test_solid_member import prism
from tests.support.refusals import refusal

DOCS = Path(__file__).parents[2] / "docs" / "howto" / "gmp_python.md"
# The plane of the motion stands upright: x stays, y becomes z.
UPRIGHT = rotation((1, 0, 0), np.pi / 2)
AT = np.array([0.3, -0.2, 1.0])


@pytest.fixture(scope="module")
def member():
    return ReducedMember(rod(), modes=3, formulation="membrane", reach=0.83, points_per_angle=9)


def hung(body, **options):
    """A system with the body pinned to the ground at its start, under gravity."""
    system = System(gravity=(0, 0, -9.81))
    system.add(body)
    system.add(PlaneJoint(ground.marker_at(AT), body.marker("start"), normal=(0, -1, 0), **options))
    return system


def in_plane(positions):
    assert np.abs(positions[:, 1] - AT[1]).max() < 1e-12
    return positions[:, [0, 2]] - AT[[0, 2]]


@pytest.mark.parametrize("kind", ["beam", "solid"])
def test_accelerations_of_a_steady_rate_are_derivatives_of_the_jacobian(member, kind):
    component = member if kind == "beam" else solid_member(prism(3), modes=3, reach=0.6, points_per_angle=7)
    q, h = bent(component), 1e-5
    q[6:] *= component.length / LENGTH / 10
    v = np.random.default_rng(4).standard_normal(9) * np.array([1, 1, 3, 1, 1, 3, 1e-2, 1e-2, 1e-2])
    numeric = (component.at(q + h * v).J - component.at(q - h * v).J) @ v / (2 * h)
    assert np.abs(component.bending(q, v) - numeric).max() < 1e-7 * np.abs(numeric).max()


def test_the_flexible_pendulum_swings_as_in_the_nodal_mechanism(member):
    body = ParameterisedBody(member, position=AT, rotation=UPRIGHT, name="rod")
    run = simulate(hung(body), end=0.3, step=5e-4, rho=1.0)
    motion, tip = pendulum(member, 1, end=0.3, step=5e-4, rho=1.0)
    assert np.abs(in_plane(run.position(body.marker("end"))) - tip).max() < 2e-5 * LENGTH
    energy = run.energy()
    assert np.abs(energy.total - energy.total[0]).max() < 5e-5 * energy.kinetic.max()
    assert energy.kinetic.max() == pytest.approx(motion.kinetic.max(), rel=1e-3)
    # The whole rod, not only its end.
    last = body.nodes(run.configuration(body)[-1])
    assert np.abs(last - member.nodes(motion.x[0])[:, -1])[body.member.data.fields.translations].max() < 2e-4 * LENGTH
    # The marker turns with the end.
    turn = run.configuration(body)[-1][5]
    assert np.allclose(run.axes(body.marker("end"))[-1][:, 0], [np.cos(turn), 0, np.sin(turn)], atol=1e-12)
    rates = run.speeds(body)[-1]
    assert np.allclose(run.angular_velocity(body.marker("end"))[-1], [0, -rates[5], 0])
    assert np.allclose(run.velocity(body.marker("end"))[-1], [rates[3], 0, rates[4]])


def test_two_members_that_are_clamped_together_are_those_of_the_mechanism():
    half = ReducedMember(rod(length=LENGTH / 2, elements=6), modes=1, formulation="membrane", reach=0.6)
    first = ParameterisedBody(half, position=AT, rotation=UPRIGHT, name="first")
    second = ParameterisedBody(half, position=AT + np.array([LENGTH / 2, 0, 0]), rotation=UPRIGHT, name="second")
    system = hung(first)
    system.add(second)
    system.add(PlaneJoint(first.marker("end"), second.marker("start"), fixed=True))
    run = simulate(system, end=0.15, step=1e-3)
    tip = pendulum(half, 2, end=0.15)[1]
    assert np.abs(in_plane(run.position(second.marker("end"))) - tip).max() < 1e-4 * LENGTH


def test_a_rigid_body_on_a_revolute_joint_is_the_point_mass_of_the_mechanism(member):
    mass = 0.01
    body = ParameterisedBody(member, position=AT, rotation=UPRIGHT, name="rod")
    system = hung(body)
    end, inertia = AT + np.array([LENGTH, 0, 0]), (1e-6, 2e-6, 1.5e-6)
    ball = system.add(RigidBody(mass, inertia, position=end, markers={"middle": (0, 0, 0)}, name="ball"))
    joint = system.add(RevoluteJoint(body.marker("end"), ball.marker("middle"), axis=(0, 0, 1)))
    run = simulate(system, end=0.15, step=5e-4, rho=1.0)
    mechanism = Mechanism(gravity=(0, -9.81))
    a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((LENGTH, 0))
    mechanism.add(member, a, b)
    mechanism.mass(b, mass)
    motion = simulate_nodes(mechanism, end=0.15, step=5e-4, rho=1.0)
    assert np.abs(in_plane(run.position(ball.marker("middle"))) - motion.q[:, b.numbers]).max() < 2e-5 * LENGTH
    energy = run.energy()
    assert np.abs(energy.total - energy.total[0]).max() < 1e-4 * energy.kinetic.max()
    # The joint carries what accelerates the ball: Newton's law in the middle of the run.
    v, k, h = run.velocity(ball.marker("middle")), 150, 5e-4
    force = mass * ((v[k + 1] - v[k - 1]) / (2 * h) + [0, 0, 9.81])
    assert np.allclose(run.reaction(joint)[k, :3], force, atol=0.02 * np.abs(force).max())


def test_a_free_spinning_member_keeps_its_momenta_and_its_energy(member):
    turned = rotation((1, 2, 3), 0.7)
    # Along its chord and across it; its spin stretches and bends it.
    speed, spin = turned @ np.array([0.4, -0.3, 0.0]), 12.0
    body = ParameterisedBody(member, rotation=turned, velocity=speed, spin=spin, ends=(0.2, -0.25))
    system = System()
    system.add(body)
    run = simulate(system, end=0.1, step=2e-4, rho=1.0)
    for name, angle in (("start", 0.2), ("end", -0.25)):
        across = turned @ [-np.sin(angle), np.cos(angle), 0.0]
        assert run.axes(body.marker(name))[0][:, 1] == pytest.approx(across, abs=1e-12), name
    momenta = []
    for q, v in zip(run.configuration(body), run.speeds(body), strict=True):
        at = member.at(q)
        p = member.M @ (at.J @ v)
        # A turn of everything about the origin moves x and y by each other.
        r = len(member.data.fields.one)
        about = member.rigid[:, 2].copy()
        about[:r], about[r : 2 * r] = -at.x[r : 2 * r], at.x[:r]
        momenta.append([*(member.rigid[:, :2].T @ p), about @ p])
    momenta = np.array(momenta)
    assert np.abs(momenta - momenta[0]).max(axis=0) == pytest.approx(0, abs=1e-4 * np.abs(momenta).max())
    energy = run.energy()
    assert np.abs(energy.total - energy.total[0]).max() < 1e-4 * energy.kinetic.max()
    assert np.ptp(energy.potential) > 1e-3 * energy.kinetic.max()


def test_the_example_of_the_documentation_runs():
    (code,) = re.findall(r"```python body\n(.*?)```", DOCS.read_text(), re.DOTALL)
    space = {}
    exec(code, space)
    assert space["path"].shape == (101, 3) and space["path"][-1][2] < -0.02


def test_gravity_acts_along_the_plane_only(member):
    body = ParameterisedBody(member, rotation=UPRIGHT)
    q, v = body.start()
    M, g = body.dynamics(0.0, q, v, np.array([1.0, 50.0, -9.81]))
    rate = np.linalg.solve(M, -g)
    assert np.allclose(rate[:6], [1.0, -9.81, 0, 1.0, -9.81, 0], atol=1e-6)
    kinetic, height = body.energy(q, v, np.array([0, 0, -9.81]))
    up = q + np.array([0, 0.5, 0, 0, 0.5, 0, 0, 0, 0])
    mass = rod().section.mass * LENGTH
    assert body.energy(up, v, np.array([0, 0, -9.81]))[1] - height == pytest.approx(mass * 9.81 * 0.5, rel=1e-9)
    assert kinetic == 0


def test_bad_input_and_leaving_the_tables_are_named(member):
    with refusal("value", "velocity"):
        ParameterisedBody(member, velocity=(0, 0, 1))
    with refusal("unknown", "", "ent"):
        ParameterisedBody(member).marker("ent")
    short = ReducedMember(rod(), modes=2, reach=0.25)
    with refusal("result", "", "rod", "t1", "-0.25", by=SolverError):
        simulate(hung(ParameterisedBody(short, position=AT, rotation=UPRIGHT, name="rod")), end=0.3, step=1e-3)
