"""Members made of solids: equilibria, tables and motion against beams, arcs and the solid itself."""

import numpy as np
import pytest
import scipy.sparse.linalg as spl

from morembs.dynamics.gmp import ReducedMember
from morembs.dynamics.gmp.manifold import Solver
from morembs.dynamics.gmp.solid_manifold import SolidEquilibria, plane_bending_modes
from morembs.dynamics.gmp.solid_member import solid_member
from morembs.dynamics.nonlinear import FullMember, Mechanism, PlanarBeam, Section, simulate
from morembs.dynamics.nonlinear.continuation import follow_equilibrium
from morembs.dynamics.nonlinear.solid import NonlinearSolid
from morembs.fem.interface import make_interface
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

# Half of the rod of Escalona, Hussien and Shabana (1998) with a square section, very soft.
E, DENSITY, LENGTH, SIDE = 3e6, 2770.0, 0.152, 8.862e-3
REACH = 0.6


def prism(elements=8, *, width=SIDE, poisson=0.3, shift=(0.0, 0.0, 0.0), names=("start", "end")):
    """A solid along x, SIDE high (y) and ``width`` wide (z)."""
    center = np.array([0, SIDE / 2, width / 2]) - shift
    mesh = box("hex20", (elements, 1, 1), (LENGTH, SIDE, width), lambda x: x - center)
    model = steel(mesh, young=E, poisson=poisson, density=DENSITY)
    faces = [where(model, 0, shift[0]), where(model, 0, shift[0] + LENGTH)]
    return NonlinearSolid(
        model, [make_interface(model, name=n, nodes=f, coupling="rigid") for n, f in zip(names, faces, strict=True)]
    )


@pytest.fixture(scope="module")
def member():
    return solid_member(prism(6), modes=2, reach=REACH)


class InPlane:
    """The solid as a planar component of the solver for beams: frames of three coordinates, the rest of them held."""

    def __init__(self, solid):
        self.solid = solid
        out = [solid.frames[name][2:5] for name in ("start", "end")]
        self.own = np.setdiff1d(np.arange(solid.size), np.concatenate(out))
        place = {int(number): k for k, number in enumerate(self.own)}
        held = {name: solid.frames[name][[0, 1, 5]].tolist() for name in ("start", "end")}
        self.frames = {name: np.array([place[number] for number in numbers]) for name, numbers in held.items()}
        self.size, self.reference = len(self.own), solid.reference[self.own]

    def full(self, x):
        whole = self.solid.reference
        whole[self.own] = x
        return whole

    def energy(self, x):
        return self.solid.energy(self.full(x))

    def force(self, x):
        return self.solid.force(self.full(x))[self.own]

    def tangent(self, x):
        return self.solid.tangent(self.full(x))[self.own][:, self.own]


def test_equilibria_are_those_of_the_solver_for_beams():
    """Another Newton's method, another sparse solver, modes against differences."""
    solid, t = prism(6), np.array([0.5, -0.2])
    other = InPlane(solid)
    solver = Solver(other)
    expected = solver.toward(solver.straight(), t)
    with SolidEquilibria(solid) as equilibria:
        start = equilibria.straight()
        state = equilibria.toward(start.X, start.modes, t)
        assert np.abs(state.X[other.own] - expected.X).max() < 1e-9
        energy = state.W
        assert energy == pytest.approx(expected.W, rel=1e-9)
        assert state.moments == pytest.approx(expected.moments, rel=1e-7)
        assert np.abs(state.modes[other.own] - expected.modes).max() < 1e-7
        h = 1e-4
        ahead, behind = (equilibria.toward(state.X, state.modes, t + np.array([d, 0])).X for d in (h, -h))
        assert np.abs((ahead - behind) / (2 * h) - state.modes[:, 0]).max() < 1e-6


def test_opposite_end_angles_give_an_arc_and_its_energy():
    solid, t = prism(16, poisson=0.0), 0.5
    EI = E * SIDE**4 / 12
    with SolidEquilibria(solid) as equilibria:
        start = equilibria.straight()
        state = equilibria.toward(start.X, start.modes, np.array([-t, t]))
    # The outer fibres have 3 % strain, whose square is a stretch.
    assert state.X[equilibria.second[0]] == pytest.approx(LENGTH * np.sin(t) / t, rel=1e-3)
    energy = state.W
    assert energy == pytest.approx(EI * (2 * t) ** 2 / (2 * LENGTH), rel=2e-3)
    assert state.moments == pytest.approx([-EI * 2 * t / LENGTH, EI * 2 * t / LENGTH], rel=2e-3)


def test_the_bending_modes_of_a_square_section_stay_in_the_plane():
    """Both bendings have one frequency; the modes must not mix them, and leave torsion out."""
    solid = prism()
    modes = plane_bending_modes(solid, 4)
    moved = np.abs(np.stack([solid.step_of_nodes(solid.reference, column) for column in modes.Psi.T])).max(axis=1)
    assert (moved[:, 2] < 0.1 * moved[:, 1]).all()
    EI, line = E * SIDE**4 / 12, DENSITY * SIDE**2
    exact = np.array([4.73004, 7.85320]) ** 2 / LENGTH**2 * np.sqrt(EI / line)
    assert np.sqrt(modes.squares[:2]) == pytest.approx(exact, rel=0.03)


def test_small_motions_have_the_frequencies_of_the_solid():
    solid = prism(5, width=1.5 * SIDE)
    member = solid_member(solid, modes=2, reach=0.1, points_per_angle=3)
    held = np.concatenate([solid.frames["start"], solid.frames["end"]])
    free = np.setdiff1d(np.arange(solid.size), held)
    K, M = solid.tangent(solid.reference)[free][:, free].tocsc(), solid.M[free][:, free].tocsc()
    lowest = np.sqrt(spl.eigsh(K, 3, M, sigma=0.0, v0=np.ones(len(free)))[0])
    q = member.start(np.array([0, 0, 0, LENGTH, 0, 0]))
    moment = member.at(q)
    J = moment.J[:, 6:]
    squares = np.linalg.eigvals(np.linalg.solve(J.T @ (member.M @ J), moment.stiffness()[6:, 6:]))
    # Of the three lowest of the solid the second bends across the plane.
    assert np.sqrt(np.sort(squares.real))[0] == pytest.approx(lowest[0], rel=1e-3)


def test_tension_stiffens_the_modes_as_it_does_the_solid(member):
    solid, share = prism(6), 1e-3
    held = np.concatenate([solid.frames["start"], solid.frames["end"]])
    motion = np.zeros(12)
    motion[6] = share * LENGTH
    stretched = follow_equilibrium(solid, held=held, motion=motion, steps=1).x
    Psi = plane_bending_modes(solid, 4).Psi[:, :2]
    more = Psi.T @ ((solid.tangent(stretched) - solid.tangent(solid.reference)) @ Psi)
    q = [member.start(np.array([0, 0, 0, (1 + s) * LENGTH, 0, 0])) for s in (0, share)]
    change = member.at(q[1]).stiffness()[6:, 6:] - member.at(q[0]).stiffness()[6:, 6:]
    assert np.abs(change - more).max() < 0.01 * np.abs(more).max()
    assert np.abs(more).max() > 0.01 * member.data.squares[0]


def test_tables_have_the_slopes_of_modes_and_moments(member):
    shape, moment = member.data.errors
    assert shape < 2e-3 and moment < 1e-3


def test_motion_and_forces_are_derivatives(member):
    q = member.start(np.array([0.01, -0.02, 0.5, 0.01 + 0.93 * LENGTH * np.cos(0.3), 0.0, 0.1]))
    q[6:] = [2e-4, -1e-4]
    moment, h = member.at(q), 1e-6
    for k in range(len(q)):
        e = h * np.eye(len(q))[k] * (1e-2 if k > 5 else 1.0)
        ahead, behind = member.at(q + e), member.at(q - e)
        slope = (ahead.x - behind.x) / (2 * e[k])
        assert np.abs(moment.J[:, k] - slope).max() < 1e-6 * np.abs(slope).max()
        assert moment.force[k] == pytest.approx((ahead.V - behind.V) / (2 * e[k]), rel=1e-4, abs=1e-7)


def test_rigid_motions_have_the_mass_and_inertia_of_the_solid(member):
    frames = np.array([0, 0, 0.4, LENGTH * np.cos(0.4), LENGTH * np.sin(0.4), 0.4])
    J = member.at(member.start(frames)).J
    turn = J @ np.r_[0, 0, 1, -LENGTH * np.sin(0.4), LENGTH * np.cos(0.4), 1, 0, 0]
    lift = J @ np.r_[0, 1, 0, 0, 1, 0, 0, 0]
    mass = DENSITY * SIDE**2 * LENGTH
    assert lift @ (member.M @ lift) == pytest.approx(mass, rel=1e-10)
    assert turn @ (member.M @ turn) == pytest.approx(mass * (LENGTH**2 / 3 + SIDE**2 / 12), rel=1e-9)
    assert lift @ (member.M @ turn) == pytest.approx(mass * LENGTH / 2 * np.cos(0.4), rel=1e-9)


def test_the_mass_of_the_motion_is_that_of_the_nodes(member):
    functions = member.nodes(np.eye(member.data.fields.size))
    exact = functions.T @ (prism(6).model.M @ functions)
    assert np.abs(member.M - exact).max() < 1e-12 * np.abs(exact).max()


def test_positions_of_nodes_are_recovered(member):
    solid, t = prism(6), np.array([REACH, -REACH])
    with SolidEquilibria(solid) as equilibria:
        start = equilibria.straight()
        state = equilibria.toward(start.X, start.modes, t)
    exact, d0 = solid.positions(state.X), state.X[equilibria.second[0]]
    q = member.start(np.array([0, 0, t[0], d0, 0, t[1]]))
    assert np.abs(member.nodes(member.at(q).x).reshape(-1, 3) - exact).max() < 1e-7 * LENGTH
    energies = member.at(q).V, state.W
    assert energies[0] == pytest.approx(energies[1], rel=1e-7)


def fallen(component, *, end=0.32, step=4e-3):
    """Tip of a pendulum of two equal members, released along x; shares of the length."""
    mechanism = Mechanism(gravity=(0, -9.81))
    points = [mechanism.point((k * LENGTH, 0), fixed="" if k else "xy") for k in range(3)]
    angles = [mechanism.angle(0.0) for _ in range(3)]
    for k in range(2):
        mechanism.add(component, points[k], points[k + 1], start=angles[k], end=angles[k + 1])
    motion = simulate(mechanism, end=end, step=step)
    assert not motion.warnings
    return motion.q[:, points[-1].numbers] / (2 * LENGTH)


def test_a_pendulum_of_solid_members_swings_like_one_of_full_beams(member):
    section = Section.of(E=E, A=SIDE**2, I=SIDE**4 / 12, density=DENSITY, shear=5 / 6)
    beam = PlanarBeam.straight(LENGTH, 12, section)
    full = fallen(FullMember(beam))
    linear = fallen(ReducedMember(beam, modes=2, formulation="linear", reach=REACH))

    def rms(tip):
        return np.sqrt(np.mean(np.sum((tip - full) ** 2, axis=1)))

    assert rms(fallen(member)) < 0.002
    assert rms(linear) > 0.02


def test_bad_input_is_named():
    with refusal("missing", "interfaces", "left", "right", "start", "end"):
        SolidEquilibria(prism(2, names=("left", "right")))
    with refusal("value", "interfaces"):
        SolidEquilibria(prism(2, shift=(0.1, 0.0, 0.0)))
    with refusal("value", "modes"):
        plane_bending_modes(prism(2), 50)
    with refusal("value", "reach", "3.2"):
        solid_member(prism(2), modes=0, reach=3.2)


def test_a_range_in_which_the_ends_meet_is_refused():
    with refusal("result", "reach"):
        solid_member(prism(3), modes=0, reach=3.0, points_per_angle=2)
