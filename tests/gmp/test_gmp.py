"""Global modal parameterisation against arcs, reactions, the full models of a flexible pendulum and a slider-crank."""

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.base.errors import SolverError
from morembs.dynamics.gmp import ChebyshevTable, ReducedMember, Solver, bending_modes, manifold, points
from morembs.dynamics.nonlinear import FullMember, Mechanism, PlanarBeam, Section, simulate
from tests.support.refusals import refusal

LENGTH = 0.304
FORMULATIONS = ("linear", "foreshortened", "membrane", "tangent")


def rod(E=3e6, length=LENGTH, elements=12):
    return PlanarBeam.straight(length, elements, Section.of(E=E, A=7.854e-5, I=4.909e-10, density=2770))


class Softening:
    """A rod whose middle is pushed away the more, the further it is from the chord: it loses its stability."""

    def __init__(self, strength):
        self.rod, self.strength = rod(), strength
        self.middle = 3 * 6 + 1
        for name in ("size", "frames", "translations", "reference", "M"):
            setattr(self, name, getattr(self.rod, name))

    def energy(self, x):
        return self.rod.energy(x) - self.strength * x[self.middle] ** 4 / 12

    def force(self, x):
        f = self.rod.force(x)
        f[self.middle] -= self.strength * x[self.middle] ** 3 / 3
        return f

    def tangent(self, x):
        K = self.rod.tangent(x).tolil()
        K[self.middle, self.middle] -= self.strength * x[self.middle] ** 2
        return K.tocsr()


# ---------------------------------------------------------------------------------------------------------
# Tables


def test_a_table_reproduces_polynomials_and_their_derivatives():
    grid = points(0.7, 5)

    def f(a, b):
        return np.array([1 + a - 2 * b + a**4 * b**3, a**2 * b**2 - 3 * b**4])

    table = ChebyshevTable.through(0.7, np.array([[f(a, b) for b in grid] for a in grid]))
    a, b = t = np.array([0.31, -0.55])
    value, first, second = table.at(t)
    assert np.allclose(value, f(a, b), atol=1e-12)
    assert np.allclose(first, [[1 + 4 * a**3 * b**3, 2 * a * b**2], [-2 + 3 * a**4 * b**2, 2 * a**2 * b - 12 * b**3]])
    assert np.allclose(second[0, 0], [12 * a**2 * b**3, 2 * b**2])
    assert np.allclose(second[0, 1], [12 * a**3 * b**2, 4 * a * b])


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("t", [(0.9, 0.2), (0.9, -1.1), (-0.3, 0.75)])
def test_a_table_goes_on_smoothly_outside_its_range(curved, t):
    grid, h, t = points(0.7, 5), 1e-6, np.array(t)
    samples = np.array([[a**3 * b + a * b**2 - b for b in grid] for a in grid])
    table = ChebyshevTable.through(0.7, samples, curved=curved)
    inside = np.clip(t, -0.7, 0.7)
    close = inside + 1e-9 * (t - inside)
    assert np.allclose(table.at(close)[0], table.at(inside)[0]) and np.allclose(table.at(close)[1], table.at(inside)[1])
    # Derivatives are those of what the table gives, so that energy stays a potential.
    slope = [(table.at(t + d)[0] - table.at(t - d)[0]) / (2 * h) for d in h * np.eye(2)]
    assert np.allclose(table.at(t)[1], slope, atol=1e-7)


# ---------------------------------------------------------------------------------------------------------
# Manifold


def test_opposite_end_angles_give_an_arc_and_its_energy():
    beam = rod(elements=12)
    state = Solver(beam).toward(Solver(beam).straight(), np.array([1.2, -1.2]))
    assert state.X[-3] / LENGTH == pytest.approx(np.sin(1.2) / 1.2, rel=1e-9)
    assert np.isclose(state.W, beam.section.EI * 2.4**2 / (2 * LENGTH), rtol=1e-12)
    assert np.allclose(state.moments, beam.section.EI * 2.4 / LENGTH * np.array([1, -1]), rtol=1e-10)


def test_constraint_modes_are_derivatives_of_the_equilibria():
    solver, h, t = Solver(rod()), 1e-4, np.array([0.9, -0.3])
    at = solver.toward(solver.straight(), t)
    for k, d in enumerate(h * np.eye(2)):
        ahead, behind = solver.toward(at, t + d), solver.toward(at, t - d)
        assert np.allclose((ahead.X - behind.X) / (2 * h), at.modes[:, k], atol=1e-8)
        assert (ahead.W - behind.W) / (2 * h) == pytest.approx(at.moments[k], rel=1e-7)
    # No force acts along the chord, nor within.
    free = np.concatenate((np.arange(3, at.X.size - 3), [at.X.size - 3]))
    assert np.abs(solver.component.force(at.X)[free]).max() < 1e-10


def test_derivatives_of_the_tables_are_modes_and_reactions():
    modes, moments = manifold(rod(), reach=0.85, points_per_angle=11).errors()
    assert modes < 1e-8 and moments < 1e-8


def test_a_range_that_crosses_a_bifurcation_is_refused():
    assert manifold(Softening(1e4), reach=0.2, points_per_angle=5).errors()[0] < 1e-2
    # The last is near enough for Newton's method to jump to shapes that have nothing to do with the first ones.
    for strength, reach in ((1e4, 1.2), (3e4, 0.2), (2e4, 0.2)):
        with refusal("result", "reach", "t1"):
            manifold(Softening(strength), reach=reach, points_per_angle=5)


def test_too_few_points_for_a_range_are_refused():
    with refusal("result", "points", "-1.2"):
        manifold(rod(), reach=1.2, points_per_angle=3)


def test_a_range_in_which_the_ends_meet_is_refused():
    with refusal("result", "reach"):
        manifold(rod(), reach=3.0, points_per_angle=5)


# ---------------------------------------------------------------------------------------------------------
# Members


def bent(member, seed=1):
    """A configuration of a member, bent and stretched, somewhere in the plane."""
    d, phi = 0.96 * member.length, 5.9
    start = np.array([0.1, -0.2])
    end = start + d * np.array([np.cos(phi), np.sin(phi)])
    eta = 1e-3 * np.random.default_rng(seed).standard_normal(member.modes)
    return np.concatenate((start, [phi + 0.5], end, [phi - 0.35], eta))


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_motion_and_forces_are_derivatives(formulation):
    member, h = ReducedMember(rod(), modes=3, formulation=formulation, reach=0.8, points_per_angle=5), 1e-6
    q, d = bent(member), np.random.default_rng(3).standard_normal(9)
    at, ahead, behind = member.at(q), member.at(q + h * d), member.at(q - h * d)
    assert np.allclose((ahead.x - behind.x) / (2 * h), at.J @ d, atol=1e-6 * np.abs(at.J @ d).max())
    assert (ahead.V - behind.V) / (2 * h) == pytest.approx(at.force @ d, rel=1e-4)
    # The frames are coordinates: exactly where q says.
    x = member.nodes(at.x)
    assert np.allclose(x[:3], q[:3], atol=1e-10) and np.allclose(x[-3:], q[3:6], atol=1e-10)
    assert np.linalg.eigvalsh(at.J.T @ member.M @ at.J)[0] > 0


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_rigid_motions_of_the_frames_change_no_energy(formulation):
    member = ReducedMember(rod(), modes=2, formulation=formulation, reach=0.8, points_per_angle=5)
    q, turn = bent(member), 2.5
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = q.copy()
    moved[[0, 1]], moved[[3, 4]] = R @ q[[0, 1]] + 1, R @ q[[3, 4]] + 1
    moved[[2, 5]] += turn
    assert np.isclose(member.at(moved).V, member.at(q).V, rtol=1e-9)
    x, y = (member.nodes(member.at(p).x).reshape(-1, 3) for p in (q, moved))
    assert np.allclose(y, np.column_stack((x[:, :2] @ R.T + 1, x[:, 2] + turn)), atol=1e-12)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_small_motions_have_the_frequencies_of_component_modes(formulation):
    beam = rod(elements=10)
    member = ReducedMember(beam, modes=3, formulation=formulation, reach=0.4, points_per_angle=5)
    at = member.at(member.start(np.array([0, 0, 0, LENGTH, 0, 0])))
    reduced = sl.eigh(at.stiffness(), at.J.T @ member.M @ at.J, eigvals_only=True)
    assert np.abs(reduced[:3]).max() < 1e-6 * reduced[3] and abs(at.V) < 1e-15
    # Craig-Bampton by hand: static modes of the two frames and three fixed-interface modes of bending.
    K, M = beam.tangent(beam.reference).toarray(), beam.M.toarray()
    inner, frames = np.arange(3, 30), np.array([0, 1, 2, 30, 31, 32])
    T = np.zeros((33, 9))
    T[frames, range(6)] = 1
    T[inner, :6] = -np.linalg.solve(K[np.ix_(inner, inner)], K[np.ix_(inner, frames)])
    shapes = sl.eigh(K[np.ix_(inner, inner)], M[np.ix_(inner, inner)])[1]
    bending = [k for k in range(27) if np.abs(shapes[::3, k]).max() < 1e-6][:3]
    T[inner, 6:] = shapes[:, bending]
    exact = sl.eigh(T.T @ K @ T, T.T @ M @ T, eigvals_only=True)
    assert np.allclose(reduced[3:], exact[3:], rtol=1e-4)


def test_modes_of_stretching_are_left_out():
    # So soft along its axis that the first mode of stretching comes before the third of bending.
    beam = PlanarBeam.straight(1.0, 12, Section(EA=30.0, GA=400.0, EI=1.0, mass=1.0, rotary=1e-3))
    modes = bending_modes(beam, 4)
    assert len(modes.excluded) >= 1
    along = modes.Psi.reshape(-1, 3, 4)[:, 0]
    assert np.abs(along).max() < 1e-9
    with refusal("value", "modes", "90"):
        bending_modes(beam, 90)


# ---------------------------------------------------------------------------------------------------------
# Pendulum


def pendulum(member, count, *, end, step=1e-3, **options):
    """A chain of ``count`` members falls from the horizontal; motion and path of the tip."""
    mechanism = Mechanism(gravity=(0, -9.81))
    at = [mechanism.point((0, 0), fixed="xy")]
    at += [mechanism.point((LENGTH * (k + 1) / count, 0)) for k in range(count)]
    angles = [mechanism.angle(0.0) for _ in range(count + 1)]
    for k in range(count):
        mechanism.add(member, at[k], at[k + 1], start=angles[k], end=angles[k + 1])
    motion = simulate(mechanism, end=end, step=step, **options)
    return motion, motion.q[:, at[-1].numbers]


@pytest.fixture(scope="module")
def fallen():
    """The full model of 12 elements over 0.35 s."""
    return pendulum(FullMember(rod()), 1, end=0.35)[1]


def rms(tip, reference):
    return np.sqrt(np.mean(np.sum((tip - reference) ** 2, axis=1))) / LENGTH


def test_one_member_follows_the_very_flexible_pendulum(fallen):
    errors = {}
    for formulation in ("foreshortened", "membrane", "tangent"):
        member = ReducedMember(rod(), modes=3, formulation=formulation, reach=0.7, points_per_angle=7)
        motion, tip = pendulum(member, 1, end=0.35)
        assert motion.warnings == () and motion.q.shape[1] == 7
        total = motion.kinetic + motion.potential
        assert np.abs(total - total[0]).max() < 2e-4 * motion.kinetic.max()
        errors[formulation] = rms(tip, fallen)
    assert errors["membrane"] < 0.005 and errors["tangent"] < 0.006
    assert errors["foreshortened"] < 0.01
    # The tables of the manifold are worth their price only here, with one member.
    assert errors["membrane"] < 0.7 * errors["foreshortened"]


def test_two_members_gain_an_order_and_linear_shapes_do_not_do(fallen):
    half = rod(length=LENGTH / 2, elements=6)
    errors = {}
    for formulation in ("linear", "membrane"):
        member = ReducedMember(half, modes=2, formulation=formulation, reach=0.6, points_per_angle=5)
        errors[formulation] = rms(pendulum(member, 2, end=0.35)[1], fallen)
    assert errors["membrane"] < 6e-4 and errors["linear"] > 30 * errors["membrane"]


def test_leaving_the_tables_stops_or_is_said():
    member = ReducedMember(rod(), modes=2, reach=0.25, points_per_angle=5)
    with refusal("result", "", "t1", "0.2", "-0.25", by=SolverError):
        pendulum(member, 1, end=0.3)
    motion, _ = pendulum(member, 1, end=0.3, outside="continue")
    assert any("left its tabulated range" in text for text in motion.warnings)


def test_without_numerical_damping_energy_stays():
    member = ReducedMember(rod(), modes=3, formulation="tangent", reach=0.83, points_per_angle=9)
    motion, _ = pendulum(member, 1, end=0.3, rho=1.0)
    total = motion.kinetic + motion.potential
    assert np.abs(total - total[0]).max() < 1e-4 * motion.kinetic.max()
    assert motion.warnings == ()


@pytest.mark.parametrize("formulation", ["membrane", "tangent"])
def test_the_reduced_mass_is_positive_definite_on_the_whole_grid(formulation):
    member = ReducedMember(rod(), modes=3, formulation=formulation, reach=0.83, points_per_angle=7)
    for a in points(0.83, 7):
        for b in points(0.83, 7):
            d0 = float(member.data.parts(member.data.table.at(np.array([a, b]))[0])[2])
            J = member.at(np.array([0, 0, a, d0, 0, b, 0, 0, 0])).J
            M = J.T @ member.M @ J
            assert np.abs(M - M.T).max() < 1e-12 * np.abs(M).max()
            scaled = M / np.sqrt(np.outer(np.diag(M), np.diag(M)))
            assert np.linalg.eigvalsh(scaled)[0] > 1e-4


def test_amplitudes_of_fields_are_the_nodes():
    beam = rod()
    member = ReducedMember(beam, modes=3, formulation="membrane", reach=0.8, points_per_angle=7)
    at = member.at(bent(member))
    J = member.nodes(at.J)
    assert np.allclose(J.T @ (beam.M @ J), at.J.T @ (member.M @ at.J), rtol=1e-9, atol=1e-12 * abs(beam.M).max())
    assert np.allclose(member.data.fields.condense(member.nodes(at.x)), at.x, atol=1e-12)


def test_a_member_without_stretch_has_the_shape_of_its_equilibrium():
    beam, t = rod(elements=24), points(0.8, 7)[[1, 5]]
    member, solver = ReducedMember(beam, modes=1, formulation="tangent", reach=0.8, points_per_angle=7), Solver(beam)
    state = solver.toward(solver.straight(), t)
    at = member.at(np.array([0, 0, t[0], state.X[-3], 0, t[1], 0]))
    assert np.allclose(member.nodes(at.x), state.X, atol=1e-9)
    assert np.isclose(at.V, state.W, rtol=1e-9)


def test_a_mass_matrix_that_depends_on_the_direction_is_refused():
    beam = Softening(0.0)
    M = beam.M.tolil()
    M[4, 4] *= 1.5
    beam.M = M.tocsr()
    with refusal("unsupported", "mass"):
        ReducedMember(beam, modes=1, points_per_angle=5)


def test_driven_joints_turn_a_stiff_arm_as_they_say():
    mechanism, beam = Mechanism(), rod(1e12, 0.2, 2)
    a, b, c = mechanism.point((0, 0), fixed="xy"), mechanism.point((0.2, 0)), mechanism.point((0.2, 0.2))

    def swing(t):
        return 10 * t**3

    elbow = mechanism.angle(0.0)
    mechanism.add(FullMember(beam), a, b, start=mechanism.drive(0.0, swing), end=elbow)
    joint = mechanism.drive(np.pi / 2, lambda t: -2 * swing(t), seen_from=elbow)
    mechanism.add(FullMember(beam), b, c, start=joint)
    motion = simulate(mechanism, end=0.4, step=2e-3)
    first, second = swing(motion.times), np.pi / 2 - swing(motion.times)
    tip = 0.2 * np.column_stack((np.cos(first) + np.cos(second), np.sin(first) + np.sin(second)))
    assert np.abs(motion.q[:, c.numbers] - tip).max() < 1e-4
    with refusal("conflict", "seen_from"):
        mechanism.drive(0.0, swing, seen_from=joint)
    with refusal("value", "motion"):
        mechanism.drive(0.0, lambda t: 1.0)


def test_too_few_modes_are_said():
    motion, _ = pendulum(ReducedMember(rod(), modes=0, points_per_angle=5), 1, end=0.1)
    assert any("modes left out would answer with" in text for text in motion.warnings)
    motion, _ = pendulum(ReducedMember(rod(), modes=2, points_per_angle=5), 1, end=0.1)
    assert motion.warnings == ()


# ---------------------------------------------------------------------------------------------------------
# Slider-crank


def slider_crank(members, *, end, step, slider=0.01, torque=0.01):
    """Crank angle and slider position; the crank is driven from the straight position, without gravity."""
    mechanism = Mechanism()
    a, b = mechanism.point((0, 0), fixed="xy"), mechanism.point((0.152, 0))
    c, turn = mechanism.point((0.456, 0), fixed="y"), mechanism.angle(0.0)
    mechanism.add(members[0], a, b, start=turn)
    mechanism.add(members[1], b, c)
    mechanism.mass(c, slider)
    mechanism.torque(turn, lambda t: torque * (1 - np.exp(-t / 0.167)))
    motion = simulate(mechanism, end=end, step=step)
    return motion.q[:, turn.number], motion.q[:, c.numbers[0]], motion


def test_three_models_of_a_stiff_slider_crank_agree():
    bars = rod(1e11, 0.152, 4), rod(5e9, 0.304, 8)
    angle, position, _ = slider_crank([FullMember(bar) for bar in bars], end=0.8, step=4e-3)
    assert angle[-1] > 1.2
    for formulation in ("linear", "tangent"):
        members = [ReducedMember(bar, modes=2, formulation=formulation, reach=0.2, points_per_angle=3) for bar in bars]
        other, at, motion = slider_crank(members, end=0.8, step=4e-3)
        assert np.abs(other - angle).max() < 1e-4 and np.abs(at - position).max() < 1e-4 * np.ptp(position)
        assert motion.q.shape[1] == 11


# ---------------------------------------------------------------------------------------------------------
# Bad input


def test_bad_input_is_named():
    with refusal("value", "formulation", "cubic", "linear"):
        ReducedMember(rod(), modes=1, formulation="cubic")
    with refusal("value", "modes", "-1"):
        ReducedMember(rod(), modes=-1)
    with refusal("value", "reach", "3.5"):
        ReducedMember(rod(), modes=1, reach=3.5)
    with refusal("value", "points_per_angle"):
        ReducedMember(rod(), modes=1, points_per_angle=1)
    with refusal("unsupported", "formulation", "membrane", "tangent"):
        ReducedMember(Softening(0.0), modes=1, formulation="membrane")
    with refusal("value", "outside", "ignore"):
        pendulum(FullMember(rod()), 1, end=0.1, outside="ignore")
