"""Systems that turn steadily: places and small motion against closed forms of pendulums and blades."""

from dataclasses import replace

import numpy as np
import pytest

from morembs.body.floating.frame import floating_frame
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.dynamics.multibody import (
    DrivenAngle,
    FlexibleBody,
    LinearBody,
    Motion,
    PointLoad,
    RevoluteJoint,
    RigidBody,
    SphericalJoint,
    SpringDamper,
    SteadySpin,
    System,
    equilibrium,
    ground,
    rotation,
)
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

G, W = 9.81, 5.0
Z = (0.0, 0.0, 1.0)


def pendulum(joint, *, start=0.9, inertia=(0.1, 0.1, 0.05), point=(0.0, 0.0, 0.0), turn=0.0):
    """1 kg at 1 m below a hub that turns about the vertical through ``point``, ``start`` rad away from it."""
    system, hub = System(gravity=(0, 0, -G)), np.array(point)
    R = rotation(Z, turn) @ rotation((0, 1, 0), -start)
    bob = system.add(
        RigidBody(1.0, inertia, position=hub - R[:, 2], rotation=R, markers={"top": (0, 0, 1)}, name="bob")
    )
    if joint == "ball":
        system.add(SphericalJoint(ground.marker_at(point), bob.marker("top")))
        return system, bob
    base = ground.marker_at(point)
    wheel = system.add(RigidBody(1.0, (0.1, 0.1, 0.1), position=point, rotation=rotation(Z, turn), name="wheel"))
    center = wheel.marker_at((0, 0, 0))
    system.add(RevoluteJoint(base, center, axis=Z))
    system.add(RevoluteJoint(center, bob.marker("top"), axis=(0, 1, 0)))
    if joint == "driven":
        system.add(DrivenAngle(base, center, axis=Z, motion=Motion.steady(W)))
    return system, bob


@pytest.mark.parametrize("point, turn", [((0, 0, 0), 0.0), ((0.3, -2.0, 1.0), 1.3)])
def test_a_pendulum_on_a_driven_hub(point, turn):
    """(1 + Jx - Jz) cos(angle) = g / W^2, and it swings with W sin(angle) sqrt((1 + Jx - Jz) / (1 + Jy))."""
    system, _ = pendulum("driven", point=point, turn=turn)
    still = equilibrium(system, spin=SteadySpin(axis=(0, 0, 3.0), speed=W, point=point))
    angle = np.arccos(G / W**2 / 1.05)
    arm = still.state.x[still.state.assembly.in_x[0]][:3] - point
    assert -arm[2] == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.hypot(arm[0], arm[1]) == pytest.approx(np.sin(angle), abs=1e-9)
    assert still.stable and still.mobilities == 0
    swing = W * np.sin(angle) * np.sqrt(1.05 / 1.1)
    assert still.linear.frequencies_hz * 2 * np.pi == pytest.approx([swing], rel=1e-7)
    # The reaction carries the weight and the centripetal force.
    reaction = still.result.reaction(system.joints[1])[0, :3]
    assert np.abs(reaction[2]) == pytest.approx(G, rel=1e-8)
    assert np.hypot(*reaction[:2]) == pytest.approx(W**2 * np.sin(angle), rel=1e-8)


def test_a_conical_pendulum_that_nothing_drives():
    """Its momenta about the vertical and about its own axis stay: a top in its effective potential (Goldstein 1980)."""
    system, _ = pendulum("ball", start=1.0)
    still = equilibrium(system, spin=SteadySpin(axis=Z, speed=W))
    top, across, along = np.pi - np.arccos(G / W**2 / 1.05), 1.1, 0.05
    own = along * W * np.cos(top)
    vertical = across * W * np.sin(top) ** 2 + own * np.cos(top)

    def potential(angle):
        return (vertical - own * np.cos(angle)) ** 2 / (2 * across * np.sin(angle) ** 2) + G * np.cos(angle)

    h = 1e-3
    bend = (potential(top + h) - 2 * potential(top) + potential(top - h)) / h**2
    assert len(still.linear.K) == 3 and still.stable
    assert still.linear.frequencies_hz.max() * 2 * np.pi == pytest.approx(np.sqrt(bend / across), rel=1e-5)


def test_hanging_straight_is_unstable_above_the_critical_speed():
    system, _ = pendulum("driven", start=0.0)
    for speed, stable in ((2.9, True), (3.2, False)):
        system.joints[-1] = replace(system.joints[-1], motion=Motion.steady(speed))
        still = equilibrium(system, spin=SteadySpin(axis=Z, speed=speed))
        assert still.stable is stable
        square = G / 1.1 - speed**2 * 1.05 / 1.1
        assert still.linear.K[0, 0] == pytest.approx(square, rel=1e-6)
    assert still.linear.growth == pytest.approx(np.sqrt(-square), rel=1e-6)


@pytest.mark.parametrize("axis, southwell", [((0, 0, 1), 1.193), ((0, 1, 0), 0.193)])
def test_a_blade_stiffens_as_southwell_says(axis, southwell):
    """The lowest mode bends along z: out of the plane of the spin about z, in the plane about y."""
    model = steel(box("hex20", (8, 1, 1), (0.5, 0.02, 0.01)))
    root = make_interface(model, name="root", nodes=where(model, 0, 0.0), coupling="rigid")
    with Problem(model, [root]) as problem:
        reduced = CraigBampton(modes=8).reduce(problem)
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=("root",))
        frame = replace(frame, stiffening=geometric_stiffening(problem, reduced, frame))
    lowest = []
    for speed in (0.0, 60.0):
        system = System()
        blade = system.add(FlexibleBody(frame, position=frame.origin, stiffening=True, name="blade"))
        base = ground.marker_at(blade.marker("root").place(blade.start()[0]).position)
        system.add(RevoluteJoint(base, blade.marker("root"), axis=axis))
        system.add(DrivenAngle(base, blade.marker("root"), axis=axis, motion=Motion.steady(speed)))
        spin = SteadySpin(axis=axis, speed=speed, point=base.place(np.zeros(0)).position)
        lowest.append(equilibrium(system, spin=spin).linear.frequencies_hz[0] * 2 * np.pi)
    assert (lowest[1] ** 2 - lowest[0] ** 2) / 60.0**2 == pytest.approx(southwell, abs=0.015)


def test_what_cannot_spin_steadily_is_refused():
    about = SteadySpin(axis=Z, speed=W)
    system, bob = pendulum("ball")
    with refusal("model", "joint", "5"):
        equilibrium(system, spin=SteadySpin(axis=Z, speed=W, point=(0.2, 0, 0)))
    with refusal("unsupported", "forces"):
        equilibrium(system, spin=SteadySpin(axis=(1, 0, 0), speed=W))
    system.add(PointLoad(bob.marker("top"), force=(1.0, 0, 0)))
    with refusal("unsupported", "forces"):
        equilibrium(system, spin=about)
    system, bob = pendulum("ball")
    system.add(SpringDamper(ground.marker_at((0.5, 0, 0)), bob.marker("top"), stiffness=10.0))
    system.add(LinearBody(np.eye(1), np.eye(1), name="support"))
    with refusal("unsupported", "", "support"):
        equilibrium(system, spin=about)
    with refusal("value", "direction"):
        SteadySpin(axis=(0, 0, 0), speed=1.0)
    with refusal("value", "speed"):
        SteadySpin(axis=Z, speed=float("nan"))
