"""Exact beams in space against circles, elastica, an ODE of the rod, published bends and lateral buckling."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from morembs.dynamics.nonlinear.continuation import follow_equilibrium
from morembs.dynamics.nonlinear.rotation_vectors import curvature, shorten_vectors, tangents
from morembs.dynamics.nonlinear.spatial_beam import SpatialBeam, SpatialSection
from tests.support.elastica import tip_of_elastica
from tests.support.refusals import refusal

CLAMPED = np.arange(6)


def section(**other):
    soft = {"EA": 3.0, "GA2": 1.0, "GA3": 1.5, "GJ": 0.3, "EI2": 0.2, "EI3": 0.4, "mass": 1.3}
    return SpatialSection(**{**soft, **other})


def slender(**other):
    stiff = {"EA": 1e7, "GA2": 1e7, "GA3": 1e7, "GJ": 1.0, "EI2": 1.0, "EI3": 1.0}
    return section(**{**stiff, **other})


def end_load(beam, *force):
    load = np.zeros(beam.size)
    load[-6 : len(force) - 6 or None] = force
    return load


def crooked(beam, amplitude, seed=0):
    return beam.reference + amplitude * np.random.default_rng(seed).standard_normal(beam.size)


@pytest.mark.parametrize("amplitude", [0.0, 0.03, 0.6])
@pytest.mark.parametrize("beam", [SpatialBeam.straight(1.0, 3, section()), SpatialBeam.arc(1.0, 1.2, 3, section())])
def test_forces_and_tangent_are_derivatives_of_the_energy(beam, amplitude):
    x, d, h = crooked(beam, amplitude), np.random.default_rng(5).standard_normal(beam.size), 1e-5
    slope = (beam.energy(x + h * d) - beam.energy(x - h * d)) / (2 * h)
    assert slope == pytest.approx(beam.force(x) @ d, rel=1e-7, abs=1e-8)
    change = (beam.force(x + h * d) - beam.force(x - h * d)) / (2 * h)
    K = beam.tangent(x)
    assert np.abs(K @ d - change).max() < 1e-7 * np.abs(change).max()
    assert abs(K - K.T).max() < 1e-13 * abs(K).max()
    stress = (beam.resultants(x + h * d) - beam.resultants(x - h * d)) / (2 * h)
    assert np.allclose(beam.resultants_after(x, d) - beam.resultants(x), stress, atol=1e-7)


@pytest.mark.parametrize("amplitude", [1e-6, 0.7, 1.99, 2.01, 5.5])
@pytest.mark.parametrize("fixed", [False, True])
def test_the_curvature_of_the_chart_is_the_derivative_of_its_tangent(amplitude, fixed):
    p, f, d = np.random.default_rng(1).standard_normal((3, 3))
    p, h = p * amplitude / np.linalg.norm(p), 1e-5

    def T(q):
        return tangents(q[None])[0].T if fixed else tangents(q[None])[0]

    slope = f @ (T(p + h * d) - T(p - h * d)) @ d / (2 * h)
    assert slope == pytest.approx(float(d @ curvature(p[None], f[None], fixed=fixed)[0] @ d), abs=1e-9)
    assert np.allclose(
        Rotation.from_rotvec(shorten_vectors(p)).as_matrix(), Rotation.from_rotvec(p).as_matrix(), atol=1e-14
    )


@pytest.mark.parametrize("axis", [(0, 1, 0), (0.6, 0, 0.8)])
def test_an_end_moment_turns_a_beam_by_a_full_turn(axis):
    # All stiffnesses of turning are one: the frames turn evenly about the axis of the moment, in torsion, too.
    beam = SpatialBeam.straight(1.0, 8, section(EA=1e4, GA2=1e4, GA3=1e4, GJ=1.0, EI2=1.0, EI3=1.0))
    moment = 2 * np.pi * np.array(axis)
    path = follow_equilibrium(beam, held=CLAMPED, load=end_load(beam, 0, 0, 0, *moment), stable=False)
    s = np.linspace(0, 1, 9)
    line = np.linspace(0, 1, 8 * 40 + 1)
    rate = Rotation.from_rotvec(line[:, None] * moment).apply([1.0, 0, 0])
    # Simpson's rule along the axis, which is smooth.
    half = line[1] / 2
    middle = Rotation.from_rotvec((line[:-1, None] + half) * moment).apply([1.0, 0, 0])
    steps = (rate[:-1] + 4 * middle + rate[1:]) * half / 3
    exact = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))[::40]
    table = path.x.reshape(-1, 6)
    assert np.abs(table[:, :3] - exact).max() < 1e-9
    frames = Rotation.from_rotvec(table[:, 3:]).inv() * Rotation.from_rotvec(s[:, None] * moment)
    assert np.abs(frames.as_rotvec()).max() < 1e-11
    assert beam.energy(path.x) == pytest.approx((2 * np.pi) ** 2 / 2, rel=1e-12)
    assert np.abs(path.reaction[3:] + moment).max() < 1e-9


@pytest.mark.parametrize(("load", "angle"), [(1.0, 2.0), (10.0, 0.0)])
def test_a_cantilever_follows_the_elastica(load, angle):
    along, across, slope = tip_of_elastica(load)
    side = np.array([0.0, np.cos(angle), np.sin(angle)])
    errors = []
    for elements in (8, 16):
        beam = SpatialBeam.straight(1.0, elements, slender())
        tip = follow_equilibrium(beam, held=CLAMPED, load=end_load(beam, *(load * side)), steps=4).x[-6:]
        axis = slope * np.cross([1.0, 0, 0], side)
        errors.append(np.abs(tip - np.concatenate((along * np.eye(3)[0] + across * side, axis))).max())
    assert errors[1] < 2e-5 and np.log2(errors[0] / errors[1]) > 1.9


def rod_by_shooting(beam_section, radius, angle, force):
    """Tip of an arc under a dead end force, from the differential equations of the rod."""
    s, span = beam_section, radius * angle
    stiff, turn = np.array([s.EA, s.GA2, s.GA3]), np.array([s.GJ, s.EI2, s.EI3])

    def rate(_, y):
        R, m = y[3:12].reshape(3, 3), y[12:]
        moved = R @ (np.array([1.0, 0, 0]) + R.T @ force / stiff)
        k = R.T @ m / turn + np.array([0, 0, 1 / radius])
        spin = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
        return np.concatenate((moved, (R @ spin).ravel(), -np.cross(moved, force)))

    def end(moment):
        start = np.concatenate((np.zeros(3), np.eye(3).ravel(), moment))
        return solve_ivp(rate, (0, span), start, rtol=1e-9, atol=1e-9, method="DOP853").y[:, -1]

    guess = np.zeros(3)
    for share in (0.25, 0.5, 0.75, 1.0):
        full, force = force, share * force
        solution = root(lambda moment: end(moment)[12:], guess, tol=1e-10)
        assert solution.success
        guess, tip, force = solution.x, end(solution.x)[:3], full
    return tip


# The data of Bathe and Bolourchi (1979): unit square, radius 100, no lateral contraction, torsion constant 1/6.
BEND = SpatialSection(EA=1e7, GA2=0.5e7, GA3=0.5e7, GJ=1e7 / 12, EI2=1e7 / 12, EI3=1e7 / 12, mass=1.0)


@pytest.mark.parametrize(("force", "published"), [(300.0, (58.84, 22.33, 40.08)), (600.0, (47.23, 15.79, 53.37))])
def test_the_bend_of_45_degrees(force, published):
    """Positions of Simo and Vu-Quoc (1986), who took eight straight linear elements."""
    beam = SpatialBeam.arc(100.0, np.pi / 4, 8, BEND)
    tip = follow_equilibrium(beam, held=CLAMPED, load=end_load(beam, 0, 0, force), steps=4).x[-6:-3]
    assert np.abs(tip / published - 1).max() < 0.01


def test_the_bend_converges_to_the_differential_equations_of_the_rod():
    exact = rod_by_shooting(BEND, 100.0, np.pi / 4, np.array([0, 0, 600.0]))
    errors = []
    for elements in (8, 16):
        beam = SpatialBeam.arc(100.0, np.pi / 4, elements, BEND)
        tip = follow_equilibrium(beam, held=CLAMPED, load=end_load(beam, 0, 0, 600.0), steps=4).x[-6:-3]
        errors.append(np.abs(tip - exact).max() / 100)
    assert errors[0] < 2e-4 and np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.2)


@pytest.mark.parametrize("amplitude", [0.05, 0.5])
def test_rigid_motions_change_neither_energy_nor_forces_of_the_section(amplitude):
    beam = SpatialBeam.arc(1.0, 1.2, 4, section())
    x = crooked(beam, amplitude)
    Q = Rotation.from_rotvec([1.1, -2.0, 0.7])
    y = beam.move_rigidly(x, Q.as_matrix(), np.array([3.0, -1.0, 2.0]))
    assert beam.energy(y) == pytest.approx(beam.energy(x), rel=1e-13)
    assert np.allclose(beam.resultants(y), beam.resultants(x), rtol=0, atol=1e-13 * np.abs(beam.resultants(x)).max())

    def physical(state):
        table = beam.force(state).reshape(-1, 6)
        moments = np.linalg.solve(tangents(state.reshape(-1, 6)[:, 3:]), table[:, 3:, None])
        return np.hstack((table[:, :3], moments[:, :, 0]))

    before, after = physical(x), physical(y)
    turned = np.hstack((Q.apply(before[:, :3]), Q.apply(before[:, 3:])))
    assert np.abs(after - turned).max() < 1e-12 * np.abs(before).max()
    # Forces and moments balance, whatever the state.
    assert np.abs(before[:, :3].sum(axis=0)).max() < 1e-13 * np.abs(before).max()
    arms = np.cross(x.reshape(-1, 6)[:, :3], before[:, :3]) + before[:, 3:]
    assert np.abs(arms.sum(axis=0)).max() < 1e-12 * np.abs(before).max()


@pytest.mark.parametrize("slenderness", [2.0, 1e2, 1e4])
def test_nothing_locks(slenderness):
    """One element is exact under small end loads, from stocky to thin."""
    s = SpatialSection.rectangle(1.0, 0.5, E=1.0, nu=0.3, density=1.0)
    beam = SpatialBeam.straight(slenderness, 1, s)
    K, L = beam.tangent(beam.reference)[6:, 6:].toarray(), slenderness
    answer = np.linalg.inv(K)
    exact = [L / s.EA, L**3 / (3 * s.EI3) + L / s.GA2, L**3 / (3 * s.EI2) + L / s.GA3, L / s.GJ, L / s.EI2, L / s.EI3]
    assert np.allclose(np.diag(answer), exact, rtol=1e-6)
    assert answer[1, 5] == pytest.approx(L**2 / (2 * s.EI3), rel=1e-6)
    assert answer[2, 4] == pytest.approx(-(L**2) / (2 * s.EI2), rel=1e-6)


def test_torsion_of_rectangles():
    """Constants of Timoshenko and Goodier: 0.1406 a^4 for a square, b t^3 / 3 (1 - 0.63 t / b) for a strip."""
    square = SpatialSection.rectangle(2.0, 2.0, E=2.0, nu=0.0, density=1.0)
    strip = SpatialSection.rectangle(10.0, 1.0, E=2.0, nu=0.0, density=1.0)
    constants = [s.GJ for s in (square, strip)]
    assert constants == pytest.approx([0.14058 * 16, 10 / 3 * (1 - 0.63025 / 10)], rel=1e-4)


def test_a_strip_buckles_sideways_at_prandtls_load():
    s = slender(EI2=1.0, EI3=1e5, GJ=0.5, EA=1e9, GA2=1e9, GA3=1e9)
    critical = 4.01260 * np.sqrt(s.EI2 * s.GJ)
    beam = SpatialBeam.straight(1.0, 12, s)
    follow_equilibrium(beam, held=CLAMPED, load=end_load(beam, 0, 0.99 * critical), steps=1)
    with refusal("result", "", "0.9"):
        follow_equilibrium(beam, held=CLAMPED, load=end_load(beam, 0, 1.05 * critical), steps=40)


def test_a_spinning_beam_stretches():
    """Simo and Vu-Quoc (1986), spin-up at 6 rad/s: the tip moves out by w^2 m L^3 / (3 EA) = 5.142857e-4."""
    s = slender(EA=2.8e7, GA2=1e7, GA3=1e7, EI2=1.4e4, EI3=1.4e4, GJ=1e4, mass=1.2)
    beam = SpatialBeam.straight(10.0, 10, s)

    def centrifugal(x):
        radial = np.zeros(beam.size)
        radial[beam.translations[:, :2]] = x[beam.translations[:, :2]]
        return 36 * (beam.M @ radial)

    tip = follow_equilibrium(beam, held=CLAMPED, load=centrifugal, steps=1).x[-6] - 10
    assert tip == pytest.approx(5.142857e-4, rel=0.01)


def test_held_frames_can_be_moved():
    """A straight beam rolled up by a prescribed turn of its end, beyond a full one: even curvature, no force."""
    beam = SpatialBeam.straight(1.0, 12, slender(EA=1e3, GA2=1e3, GA3=1e3))
    held = np.concatenate((CLAMPED, beam.frames["end"][3:]))
    motion = np.zeros(9)
    motion[8] = angle = 2 * np.pi * 1.6
    path = follow_equilibrium(beam, held=held, motion=motion, steps=8, stable=False)
    assert path.x[-6:-3] == pytest.approx([np.sin(angle) / angle, (1 - np.cos(angle)) / angle, 0], abs=1e-9)
    assert path.reaction[-1] == pytest.approx(angle, rel=1e-9)
    # The frames are moved by a linear step of the whole beam; alone they would leave it torn.
    assert path.factorisations <= 4 * path.steps


def test_mass_of_rigid_motions():
    s = section(rotary=(0.3, 0.1, 0.2))
    beam = SpatialBeam.straight(2.0, 3, s)
    motion = np.zeros((4, 6, 6))
    motion[:, :, :] = np.eye(6)
    x = beam.nodes[:, 0]
    motion[:, 1, 5], motion[:, 2, 4] = x, -x
    R = motion.reshape(-1, 6)
    rigid = R.T @ (beam.M @ R)
    slewing = s.mass * 8 / 3
    exact = np.diag([2.6, 2.6, 2.6, 0.6, 0.2 + slewing, 0.4 + slewing])
    exact[1, 5] = exact[5, 1] = s.mass * 2
    exact[2, 4] = exact[4, 2] = -s.mass * 2
    assert np.allclose(rigid, exact)


def test_bad_input_is_named():
    with refusal("value", "EI2"):
        section(EI2=0)
    with refusal("value", "rotary"):
        section(rotary=(1.0, -1.0, 0.0))
    with refusal("value", "nu"):
        SpatialSection.rectangle(1.0, 1.0, E=1.0, nu=0.5, density=1.0)
    with refusal("value", "frames"):
        SpatialBeam(np.eye(3), [np.eye(3)], section())
    with refusal("value", "frames"):
        SpatialBeam([[0, 0, 0], [1, 0, 0]], [np.eye(3), -np.eye(3)], section())
    with refusal("model", "nodes"):
        SpatialBeam([[0, 0, 0], [0, 1, 0]], [np.eye(3)] * 2, section())
    with refusal("value", "elements"):
        SpatialBeam.straight(1.0, 0, section())
    beam = SpatialBeam.straight(1.0, 2, section())
    with refusal("value", "load", "18"):
        follow_equilibrium(beam, held=CLAMPED, load=np.zeros(3))
    with refusal("value", "", "17"):
        follow_equilibrium(beam, held=np.array([0, 0]))
    with refusal("result", "", "1e+14"):
        follow_equilibrium(beam, held=np.arange(3), load=end_load(beam, 0.1, 0.1, 0.1))
