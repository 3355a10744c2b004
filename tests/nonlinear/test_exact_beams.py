"""Geometrically exact planar beams against circles, elastica, linear beams and pendulums."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe as complete
from scipy.special import ellipeinc, ellipk, ellipkinc

from morembs.base.errors import SolverError
from morembs.dynamics.nonlinear import (
    FullMember,
    Mechanism,
    NonlinearComponent,
    PlanarBeam,
    Section,
    equilibrium,
    simulate,
)
from tests.support.refusals import refusal

SLENDER = Section(EA=1e7, GA=1e7, EI=1.0, mass=1.0)


def thick(**other):
    return Section(**{"EA": 3.0, "GA": 1.0, "EI": 0.2, "mass": 1.3, "rotary": 0.02, **other})


def random_state(beam, amplitude=0.5, seed=0):
    return beam.reference + amplitude * np.random.default_rng(seed).standard_normal(beam.size)


def end_load(beam, *, force=0.0, moment=0.0):
    load = np.zeros(beam.size)
    load[-2:] = force, moment
    return load


def elastica(load):
    """Tip x, y and angle of a cantilever (length 1) that can only bend, under P L^2 / EI = load across it."""

    def length(tip):
        m = (1 + np.sin(tip)) / 2
        return ellipk(m) - ellipkinc(np.arcsin(np.sqrt(1 / (2 * m))), m) - np.sqrt(load)

    tip = brentq(length, 1e-9, np.pi / 2 - 1e-12)
    m = (1 + np.sin(tip)) / 2
    y = 1 - 2 / np.sqrt(load) * (complete(m) - ellipeinc(np.arcsin(np.sqrt(1 / (2 * m))), m))
    return np.array([np.sqrt(2 * np.sin(tip) / load), y, tip])


@pytest.mark.parametrize("amplitude", [0.03, 0.6])
def test_forces_and_tangent_are_derivatives_of_the_energy(amplitude):
    beam, h = PlanarBeam.straight(1.0, 3, thick()), 1e-5
    x, d = random_state(beam, amplitude), np.random.default_rng(5).standard_normal(beam.size)
    slope = (beam.energy(x + h * d) - beam.energy(x - h * d)) / (2 * h)
    assert slope == pytest.approx(beam.force(x) @ d, rel=1e-7)
    change = (beam.force(x + h * d) - beam.force(x - h * d)) / (2 * h)
    K = beam.tangent(x)
    assert np.allclose(K @ d, change, rtol=1e-6, atol=1e-7 * np.abs(change).max())
    assert abs(K - K.T).max() < 1e-12 * abs(K).max()
    assert K.nnz <= 36 * 3 and isinstance(beam, NonlinearComponent)


def test_an_end_moment_bends_a_beam_into_a_full_circle():
    beam = PlanarBeam.straight(1.0, 8, Section(EA=1e4, GA=1e4, EI=1.0, mass=1.0))
    x = equilibrium(beam, held=np.arange(3), load=end_load(beam, moment=2 * np.pi)).reshape(-1, 3)
    angle = 2 * np.pi * np.linspace(0, 1, 9)
    exact = np.column_stack((np.sin(angle), 1 - np.cos(angle), 2 * np.pi * angle)) / (2 * np.pi)
    assert np.abs(x - exact).max() < 1e-10
    assert beam.energy(x.ravel()) == pytest.approx((2 * np.pi) ** 2 / 2, rel=1e-12)


@pytest.mark.parametrize("load", [1.0, 10.0])
def test_a_cantilever_follows_the_elastica(load):
    errors = []
    for elements in (8, 16):
        beam = PlanarBeam.straight(1.0, elements, SLENDER)
        x = equilibrium(beam, held=np.arange(3), load=end_load(beam, force=load))
        # Shear and extension of the order load / GA are no part of the elastica.
        errors.append(np.abs(x[-3:] - elastica(load))[[0, 2]].max())
        assert np.abs(x[-3:] - elastica(load)).max() < 1e-4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.15)


def test_without_the_correction_the_order_is_two():
    errors = []
    for elements in (16, 32):
        beam = PlanarBeam.straight(1.0, elements, SLENDER, corrected=False)
        x = equilibrium(beam, held=np.arange(3), load=end_load(beam, force=10.0))
        errors.append(np.abs(x[-3:] - elastica(10.0)).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)


def test_rigid_motions_change_neither_energy_nor_forces_of_the_section():
    beam = PlanarBeam.straight(1.0, 4, thick())
    x = random_state(beam, 0.3).reshape(-1, 3)
    W, f = beam.energy(x.ravel()), beam.force(x.ravel()).reshape(-1, 3)
    for turn in (0.3, 2.0, 7.5):
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        moved = np.column_stack((x[:, :2] @ R.T + [3.0, -1.0], x[:, 2] + turn)).ravel()
        assert beam.energy(moved) == pytest.approx(W, rel=1e-12)
        force = beam.force(moved).reshape(-1, 3)
        assert np.allclose(force, np.column_stack((f[:, :2] @ R.T, f[:, 2])), atol=1e-12 * np.abs(f).max())


@pytest.mark.parametrize("slenderness", [5, 100, 1e4])
def test_nothing_locks(slenderness):
    # Square section: L = 1, height 1 / slenderness. One element is exact at its nodes under an end load.
    a = 1 / slenderness
    section = Section.of(E=1.0, A=a**2, I=a**4 / 12, density=1.0)
    beam = PlanarBeam.straight(1.0, 1, section)
    P = 1e-7 * section.EI
    x = equilibrium(beam, held=np.arange(3), load=end_load(beam, force=P), steps=1)
    assert x[-2] == pytest.approx(P / (3 * section.EI) + P / section.GA, rel=1e-6)


def test_a_curved_beam_is_straightened_by_the_moment_of_its_curvature():
    angle = np.linspace(0, np.pi / 2, 7)
    nodes = np.column_stack((np.sin(angle), 1 - np.cos(angle), angle))
    beam = PlanarBeam(nodes, Section(EA=1e5, GA=1e5, EI=2.0, mass=1.0))
    assert beam.lengths.sum() == pytest.approx(np.pi / 2, rel=1e-12)
    assert np.abs(beam.force(beam.reference)).max() < 1e-9
    x = equilibrium(beam, held=np.arange(3), load=end_load(beam, moment=-2.0))
    assert np.allclose(x[-3:], [np.pi / 2, 0, 0], atol=1e-9)


def test_mass_of_translations_and_rigid_turns():
    beam, section = PlanarBeam.straight(2.0, 5, thick()), thick()
    along = np.tile([1.0, 0, 0], 6)
    assert along @ beam.M @ along == pytest.approx(2 * section.mass, rel=1e-12)
    turn = np.column_stack((np.zeros(6), np.linspace(0, 2, 6), np.ones(6))).ravel()
    assert turn @ beam.M @ turn == pytest.approx(section.mass * 8 / 3 + section.rotary * 2, rel=1e-12)


def pendulum(section, *, step, end, elements=6, rho=0.9, **options):
    mechanism = Mechanism(gravity=(0, -9.81))
    a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((0.3, 0))
    mechanism.add(FullMember(PlanarBeam.straight(0.3, elements, section)), a, b)
    motion = simulate(mechanism, end=end, step=step, rho=rho, **options)
    return motion, motion.q[:, b.numbers]


def test_a_stiff_rod_swings_like_a_rigid_pendulum():
    section = Section.of(E=2e11, A=1e-4, I=1e-9, density=7800)
    # With the rotary inertia of the section.
    quarter = ellipk(0.5) * np.sqrt(2 * (0.3 / 3 + 1e-5 / 0.3) / 9.81)
    motion, tip = pendulum(section, step=quarter / 400, end=quarter)
    assert np.allclose(tip[-1], [0, -0.3], atol=3e-5)
    assert motion.kinetic[-1] == pytest.approx(7800 * 1e-4 * 0.3 * 9.81 * 0.15, rel=1e-4)


def test_the_time_integration_is_of_second_order_and_keeps_energy():
    section = Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770)
    tips = []
    for step in (2e-3, 1e-3, 5e-4):
        motion, tip = pendulum(section, step=step, end=0.12, rho=1.0)
        tips.append(tip[-1])
    drift = np.abs(motion.kinetic + motion.potential - motion.potential[0]).max()
    assert drift < 1e-4 * motion.kinetic.max()
    ratio = np.linalg.norm(tips[0] - tips[1]) / np.linalg.norm(tips[1] - tips[2])
    assert np.log2(ratio) == pytest.approx(2, abs=0.3)


def test_sparse_and_dense_matrices_give_the_same_motion():
    section = Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770)
    dense = pendulum(section, step=2e-3, end=0.05)[1]
    sparse = pendulum(section, step=2e-3, end=0.05, dense_entries=0)[1]
    assert np.allclose(sparse, dense, atol=1e-9)


def test_a_strut_beyond_buckling_is_refused():
    beam = PlanarBeam.straight(1.0, 8, SLENDER)
    load = np.zeros(beam.size)
    load[-3] = -0.97 * np.pi**2 / 4
    equilibrium(beam, held=np.arange(3), load=load)
    load[-3] = -1.03 * np.pi**2 / 4
    with refusal("result", "", "0.9"):
        equilibrium(beam, held=np.arange(3), load=load)


def test_a_beam_without_support_is_refused():
    beam = PlanarBeam.straight(1.0, 2, SLENDER)
    with refusal("result", "", "Newton's"):
        equilibrium(beam, held=np.arange(2), load=end_load(beam, force=1.0))


def test_bad_input_is_named():
    with refusal("value", "EI", "-1"):
        thick(EI=-1.0)
    with refusal("value", "nodes"):
        PlanarBeam(np.zeros((2, 2)), SLENDER)
    with refusal("model", "nodes"):
        PlanarBeam([[0, 0, 0], [0, 1, 0]], SLENDER)
    with refusal("value", "elements", "-1"):
        PlanarBeam.straight(1.0, -1, SLENDER)
    beam = PlanarBeam.straight(1.0, 2, SLENDER)
    with refusal("value", "load", "9"):
        equilibrium(beam, held=np.arange(3), load=np.zeros(4))
    with refusal("value", "frames"):
        FullMember(PlanarBeam([[0, 1, 0], [1, 1, 0]], SLENDER))


def test_bad_mechanisms_are_named():
    mechanism, member = Mechanism(), FullMember(PlanarBeam.straight(1.0, 2, SLENDER))
    with refusal("missing", "members"):
        simulate(mechanism, end=1.0, step=0.1)
    a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((1, 0))
    with refusal("value", "points"):
        mechanism.add(member, a, mechanism.point((2, 0)))
    with refusal("value", "angle", "0.3"):
        mechanism.add(member, a, b, start=mechanism.angle(0.3))
    with refusal("value", "fixed", "z"):
        mechanism.point((0, 0), fixed="z")
    mechanism.add(member, a, b)
    with refusal("model", "points", "4"):
        simulate(mechanism, end=1.0, step=0.1)
    mechanism = Mechanism()
    a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((1, 0))
    mechanism.add(member, a, b)
    with refusal("value", "step"):
        simulate(mechanism, end=1.0, step=2.0)
    mechanism.torque(mechanism.ends(0)[0], lambda t: np.nan if t > 0.15 else 0.0)
    with refusal("result", "", "0.2", by=SolverError):
        simulate(mechanism, end=1.0, step=0.1)
