"""Chains of equal pieces, damping and moved points of planar mechanisms."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from morembs.dynamics.gmp import ReducedMember, divide_until_within, divided_member
from morembs.dynamics.nonlinear import FullMember, LeftTablesError, Mechanism, PlanarBeam, Section, simulate
from tests.support.refusals import refusal

# A strip of 1 m by 20 mm by 6 mm, so soft that it folds as it falls.
OF_A_COMPONENT = ("size", "frames", "translations", "reference", "M", "energy", "force", "tangent")
STRIP = Section.of(E=1.2e7, A=1.2e-4, I=0.02 * 0.006**3 / 12, density=1100)


def falling(add, **options):
    mechanism = Mechanism(gravity=(0, -9.81), **options)
    return mechanism, add(mechanism, mechanism.point((0, 0), fixed="xy"), mechanism.point((1, 0)))


def chain(pieces, modes, formulation):
    return divided_member(PlanarBeam.straight(1.0, 24, STRIP), pieces, modes=modes, formulation=formulation)


@pytest.fixture(scope="module")
def tip():
    """(T, 2) of the tip of the strip with all its degrees of freedom."""
    member = FullMember(PlanarBeam.straight(1.0, 24, STRIP))
    mechanism, _ = falling(lambda m, a, b: m.add(member, a, b))
    return member.nodes(simulate(mechanism, end=0.6, step=2e-3).x[0])[-3:-1].T


@pytest.mark.parametrize(
    ("pieces", "modes", "formulation", "rms"), [(2, 2, "membrane", 2.6e-3), (6, 1, "foreshortened", 1.2e-4)]
)
def test_pieces_follow_a_strip_that_folds(tip, pieces, modes, formulation, rms):
    member = chain(pieces, modes, formulation)
    mechanism, numbers = falling(member.add)
    assert mechanism.size == 1 + pieces * (modes + 3) and len(mechanism.members) == pieces
    nodes = member.nodes(simulate(mechanism, end=0.6, step=2e-3), numbers)
    assert nodes.shape == (301, 25, 3) and nodes[0, :, 0] == pytest.approx(np.linspace(0, 1, 25), abs=1e-9)
    # Of the length; the tip ends above and behind the hinge.
    assert tip[-1] == pytest.approx([-0.65489, -0.70275], abs=2e-5)
    assert np.sqrt(np.mean(np.sum((nodes[:, -1, :2] - tip) ** 2, axis=1))) < rms


def test_a_run_that_leaves_its_tables_is_divided():
    with refusal("result", "", "t2", "0.8", "'continue'", by=LeftTablesError) as left:
        simulate(falling(chain(1, 2, "membrane").add)[0], end=0.6, step=2e-3)
    assert 1.0 < left.value.share < 1.1
    motion, pieces = divide_until_within(
        lambda pieces: falling(chain(pieces, 2, "membrane").add)[0], end=0.3, step=2e-3, pieces=1
    )
    assert pieces == 2 and motion.times[-1] == pytest.approx(0.3)
    with pytest.raises(LeftTablesError):
        divide_until_within(lambda pieces: falling(chain(1, 2, "membrane").add)[0], end=0.6, step=2e-3, max_pieces=1)


@pytest.mark.parametrize(("reach", "enough"), [(0.25, True), (0.15, False)])
def test_the_finest_division_is_tried_before_a_run_is_given_up(reach, enough):
    """Twelve elements do not divide into twice four pieces of two: six it is, or the run left its tables."""
    beam = PlanarBeam.straight(1.0, 12, STRIP)

    def build(pieces):
        return falling(divided_member(beam, pieces, modes=1, reach=reach).add)[0]

    if enough:
        assert divide_until_within(build, end=0.3, step=5e-3, pieces=4)[1] == 6
    else:
        with refusal("result", "", "-0.15", by=LeftTablesError):
            divide_until_within(build, end=0.3, step=5e-3, pieces=4)
    with refusal("value", "modes"):
        divide_until_within(build, end=0.3, step=5e-3, pieces=7)


def test_the_example_of_the_document(capsys):
    text = (Path(__file__).parents[2] / "docs" / "howto" / "gmp_python.md").read_text()
    (code,) = re.findall(r"```python divided\n(.*?)```", text, re.DOTALL)
    exec(compile(code, "gmp_python.md", "exec"), {})
    assert capsys.readouterr().out.startswith("2 [")


def arc(elements, angle=np.pi / 2):
    """A line of unit length that bends up."""
    a = np.linspace(0, angle, elements + 1)
    return np.column_stack((np.sin(a), 1 - np.cos(a), angle * a)) / angle


def bent(elements):
    """Half of a unit length along x, then half of it down."""
    s, zero = np.linspace(0, 0.5, elements // 2 + 1), np.zeros(elements // 2 + 1)
    down = np.column_stack((zero + 0.5, -s, zero - np.pi / 2))
    return np.concatenate((np.column_stack((s, zero, zero)), down))


@pytest.mark.parametrize(
    ("line", "E", "tables", "rms"), [(arc(24), 1.2e7, 1, 1.6e-4), (bent(24), 8e7, 1, 1.6e-4)], ids=["arc", "bent"]
)
def test_pieces_follow_curved_and_bent_strips_that_fall(line, E, tables, rms):
    section = Section.of(E=E, A=1.2e-4, I=0.02 * 0.006**3 / 12, density=1100)
    beam = PlanarBeam.along(line, section)
    full = FullMember(beam)
    paths, divided = [], divided_member(beam, 6, modes=1)
    assert len({id(member) for member in divided.members}) == tables
    for add in (lambda m, a, b: m.add(full, a, b), divided.add):
        mechanism = Mechanism(gravity=(0, -9.81))
        numbers = add(mechanism, mechanism.point((0, 0), fixed="xy"), mechanism.point((full.length, 0)))
        motion = simulate(mechanism, end=0.48, step=4e-3)
        nodes = divided.nodes(motion, numbers) if numbers else None
        tip = full.nodes(motion.x[0])[-3:-1].T if nodes is None else nodes[:, -1, :2]
        paths.append(tip)
    assert nodes[0, :, :2] == pytest.approx(beam.reference.reshape(-1, 3)[:, :2], abs=1e-9)
    assert np.ptp(paths[0][:, 0]) > 0.3
    assert np.sqrt(np.mean(np.sum((paths[1] - paths[0]) ** 2, axis=1))) < rms


@pytest.mark.parametrize("formulation", ["linear", "foreshortened", "tangent"])
def test_a_curved_piece_answers_small_loads_as_its_beam(formulation):
    piece = PlanarBeam.along(arc(8, np.pi / 8), STRIP)
    member = ReducedMember(piece, modes=3, formulation=formulation, reach=0.4)
    K = member.at(member.start(np.array([0, 0, 0, member.length, 0, 0]))).stiffness()[3:, 3:]
    load = np.array([1.0, 0.3, 0.2])
    tip = np.linalg.solve(K, np.concatenate((load, np.zeros(3))))[:3]
    full = piece.tangent(piece.reference)[3:, 3:].toarray()
    exact = np.linalg.solve(full, np.concatenate((np.zeros(len(full) - 3), load)))[-3:]
    assert tip == pytest.approx(exact, rel=1e-9 if formulation == "linear" else 2e-3)


@pytest.mark.parametrize("turn", [2.5, np.pi, -2.6])
def test_bent_members_may_point_anywhere(turn):
    """The part before the corner leaves the chord by 45 degrees: seen from x it turns by more than half a turn."""
    divided = divided_member(PlanarBeam.along(bent(8), STRIP), 2, modes=1)
    tips = []
    for angle in (0.0, turn):
        Q = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        mechanism = Mechanism(gravity=Q @ (0, -9.81))
        end = mechanism.point(Q @ (divided.length, 0))
        numbers = divided.add(mechanism, mechanism.point((0, 0), fixed="xy"), end)
        motion = simulate(mechanism, end=0.05, step=5e-3)
        tips.append(divided.nodes(motion, numbers)[:, -1, :2] @ Q)
    assert np.ptp(tips[0][:, 1]) > 5e-3 and tips[1] == pytest.approx(tips[0], abs=1e-10)


def test_a_clamped_corner_keeps_its_angle():
    """Both parts bend as beams under their weight: w L^4 / 8 EI, and the corner turns by the moment of its arm."""
    section = Section.of(E=2e11, A=1.2e-4, I=0.02 * 0.006**3 / 12, density=1100)
    divided = divided_member(PlanarBeam.along(bent(24), section), 4, modes=1)
    mechanism = Mechanism(gravity=(0, -9.81), damping=0.05)
    held = mechanism.point((1, 2), fixed="xy")
    end = np.array([1, 2]) + divided.length * np.array([np.cos(-np.pi / 4), np.sin(-np.pi / 4)])
    root = mechanism.angle(-np.pi / 4, fixed=True)
    numbers = divided.add(mechanism, held, mechanism.point(end), start=root)
    nodes = divided.nodes(simulate(mechanism, end=1.0, step=5e-3), numbers)[-1]
    # An even load and an end load of the same size on half a metre.
    flexible = section.mass * 9.81 / section.EI
    sag, turn = flexible * 0.5**4 * (1 / 8 + 1 / 3), flexible * 0.5**3 * (1 / 6 + 1 / 2)
    assert nodes[12, :2] == pytest.approx([1.5, 2 - sag], abs=2e-3 * sag)
    assert nodes[-1, :2] - nodes[12, :2] == pytest.approx([-0.5 * turn, -0.5], abs=2e-3 * sag)


def test_cuts_lie_at_corners_and_share_length_and_turning():
    straight = np.column_stack((np.linspace(-1, 0, 13), np.zeros(13), np.zeros(13)))
    beam = PlanarBeam.along(np.concatenate((straight, arc(12)[1:])), STRIP)
    divided = divided_member(beam, 4, modes=1)
    # A quarter of both for the straight part, three quarters for the arc.
    places = beam.reference.reshape(-1, 3)[:, :2]
    assert divided.places == pytest.approx(places[[0, 12, 16, 20, 24]], abs=1e-9)
    assert divided_member(PlanarBeam.along(bent(8), STRIP), 3, modes=1).places[2, 1] > 0.3
    chain_of_5 = chain(5, 1, "linear")
    assert chain_of_5.pieces == 5 and len({id(m) for m in chain_of_5.members}) == 2


def test_divisions_that_cannot_be_are_refused():
    with refusal("value", "pieces", "25", "24"):
        chain(25, 2, "linear")
    corner = PlanarBeam.along(bent(8), STRIP)
    with refusal("value", "pieces", "8"):
        divided_member(corner, 1, modes=1)
    with refusal("unsupported", "formulation", "membrane"):
        divided_member(PlanarBeam.along(arc(8), STRIP), 2, modes=1, formulation="membrane")
    with refusal("model", "line"):
        PlanarBeam.along(arc(24, 2 * np.pi), STRIP)
    with refusal("value", "directions"):
        PlanarBeam(np.zeros((3, 3)), STRIP, directions=np.zeros((3, 2)))
    divided, mechanism = divided_member(corner, 2, modes=1), Mechanism()
    points = mechanism.point((0, 0)), mechanism.point((1, 0))
    with refusal("value", "points", "0.707107"):
        divided.add(mechanism, *points)
    with refusal("value", "angle", "0.5"):
        divided.add(mechanism, points[0], mechanism.point((divided.length, 0)), start=mechanism.angle(0.5))


def beams():
    beam = PlanarBeam.straight(0.5, 8, Section.of(E=2e9, A=1e-4, I=1e-9, density=1200))
    return {"full": FullMember(beam), "reduced": ReducedMember(beam, modes=2, formulation="membrane", reach=0.4)}


def swinging(member, damping, end, step):
    """A cantilever that a short torque sets into motion."""
    mechanism = Mechanism(damping=damping)
    root, angle = mechanism.point((0, 0), fixed="xy"), mechanism.angle(0.0, fixed=True)
    mechanism.add(member, root, mechanism.point((0.5, 0)), start=angle)
    mechanism.torque(mechanism.ends(0)[1], lambda t: 0.05 * np.sin(np.pi * t / 0.02) ** 2 if t < 0.02 else 0.0)
    return simulate(mechanism, end=end, step=step, rho=1.0)


@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_small_vibrations_decay_with_the_ratio_of_the_damping(kind):
    f = 1.8751040687**2 / (2 * np.pi) * np.sqrt(2e9 * 1e-9 / (0.12 * 0.5**4))
    damping = 0.03 / (np.pi * f)
    motion = swinging(beams()[kind], damping, 0.6, 2e-3)
    late = motion.times > 0.2
    t, y = motion.times[late], motion.q[late, 1]
    peaks = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] > y[2:])) + 1
    decay = -np.polyfit(t[peaks], np.log(y[peaks]), 1)[0]
    assert decay == pytest.approx(0.03 * 2 * np.pi * f, rel=0.02)


@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_energy_goes_where_the_damping_says(kind):
    off = []
    for step in (1e-3, 5e-4):
        motion = swinging(beams()[kind], 1e-3, 0.1, step)
        total = motion.kinetic + motion.potential + motion.dissipated
        free = motion.times >= 0.02
        off.append(np.ptp(total[free]) / motion.dissipated[-1])
    assert motion.dissipated[-1] > 0 and off[1] < min(0.02, 0.4 * off[0])


@pytest.mark.parametrize("kind", ["full", "reduced"])
def test_rigid_motion_is_not_damped(kind):
    member = beams()[kind]
    q = member.start(np.array([0.0, 0.0, 0.0, member.length, 0.0, 0.0]))
    if kind == "reduced":
        q[[2, 5, 6]] += 0.2, -0.3, 1e-3
    else:
        q[3::3] += 0.01
    turn = member.rigid.copy() if kind == "full" else np.eye(member.size, 3)
    motion = np.zeros(member.size)
    if kind == "full":
        motion = turn[:, 2].copy()
        motion[0::3], motion[1::3] = -q[1::3], q[0::3]
    else:
        motion[:6] = -q[1], q[0], 1, -q[4], q[3], 1
    K = member.at(q).strains()
    assert np.abs(K @ motion).max() < 1e-9 * abs(K).max()
    assert np.linalg.eigvalsh(K.toarray() if kind == "full" else K).min() > -1e-9 * abs(K).max()


def test_a_pendulum_on_a_moved_base_follows_its_equation():
    length, mass, amplitude, rate = 0.4, 0.3, 0.05, 6.0

    def base(t):
        # Starts without speed and acceleration.
        return amplitude * (np.sin(rate * t) - 0.5 * np.sin(2 * rate * t)), 0.0

    def pulled(t, y):
        a = amplitude * rate**2 * (-np.sin(rate * t) + 2 * np.sin(2 * rate * t))
        rod = 1.0 * length
        moment, inertia = mass * length + rod * length / 2, mass * length**2 + rod * length**2 / 3
        # Angle from the direction straight down.
        return [y[1], -(moment / inertia) * (9.81 * np.sin(y[0]) + a * np.cos(y[0]))]

    rod = FullMember(PlanarBeam.straight(length, 2, Section(EA=1e7, GA=1e7, EI=1e4, mass=1.0)))
    mechanism = Mechanism(gravity=(0, -9.81))
    top, end = mechanism.point((0, 0), motion=base), mechanism.point((0, -length))
    mechanism.add(rod, top, end)
    mechanism.mass(end, mass)
    errors = []
    exact = solve_ivp(pulled, (0, 2.0), [0, 0], rtol=1e-10, atol=1e-12, t_eval=[1.0]).y[0, -1]
    for step in (1e-2, 5e-3):
        motion = simulate(mechanism, end=1.0, step=step, rho=0.9)
        x, y = motion.q[-1, :2]
        errors.append(abs(np.arctan2(x - base(1.0)[0], -y) - exact))
    assert abs(exact) > 0.1 and errors[1] < 1e-3 and errors[1] < 0.3 * errors[0]


def test_motions_and_damping_that_cannot_be_used_are_refused():
    mechanism = Mechanism()
    with refusal("value", "motion", "0.0", "1.0"):
        mechanism.point((0, 0), motion=lambda t: (0, 1))
    with refusal("value", "damping", "-1"):
        Mechanism(damping=-1)
    beam = PlanarBeam.straight(1.0, 2, STRIP)
    solid = SimpleNamespace(**{key: getattr(beam, key) for key in OF_A_COMPONENT})
    with refusal("unsupported", "damping"):
        simulate(falling(lambda m, a, b: m.add(FullMember(solid), a, b), damping=1e-3)[0], end=0.1, step=0.01)


def test_motions_that_do_not_start_at_rest_are_refused():
    mechanism = Mechanism()
    with refusal("value", "motion", "0.5"):
        mechanism.point((0, 0), motion=lambda t: (0.5 * t, 0.0))
    with refusal("value", "motion"):
        mechanism.drive(0.0, lambda t: np.sin(3 * t))
    mechanism.point((0, 0), motion=lambda t: (5 * t**3, 1 - np.cos(40 * t)))
