"""Coulomb's cone: sliding in any direction against analytic and fine solutions, random problems, energy."""

import json
import subprocess

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from morembs.base.errors import SolverError
from morembs.dynamics.multibody import Contact, Plane, RigidBody, System, ground, rotation, simulate_contact
from morembs.dynamics.multibody.contact.cone import coulomb
from tests.support.refusals import refusal

G = 9.81


def feet(places, *, friction, velocity, spin=0.0, inertia=(0.02, 0.02, 0.02), slope=0.0, height=0.0, **options):
    """A body of 2 kg on points at ``places`` (r, 2), in the axes of a plane that falls along its x by ``slope``."""
    R = rotation((0, 1, 0), slope)
    system = System(gravity=(0, 0, -G))
    body = system.add(
        RigidBody(
            2.0,
            inertia,
            position=height * R[:, 2],
            rotation=R,
            velocity=R @ (*velocity, 0.0),
            angular_velocity=(0, 0, spin),
            markers={str(k): (x, y, -height) for k, (x, y) in enumerate(places)},
        )
    )
    points = list(body.markers.values())
    contact = Contact(points, Plane((0, 0, 0), R[:, 2]), on=ground.marker_at(), friction=friction, axis=R[:, 0])
    result = simulate_contact(system, [contact], **options)
    return result, contact, result.configuration(body)[:, :3] @ R, result.speeds(body)


@pytest.mark.parametrize("angle", [0.0, 0.3, 4.5])
@pytest.mark.parametrize("places", [[(0.0, 0.0)], [(0.1, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.1, -0.1)]])
def test_the_distance_of_a_slide_does_not_depend_on_its_direction(angle, places):
    """v^2 / (2 friction g), also for a block whose front corners carry more than those behind."""
    along = np.array([np.cos(angle), np.sin(angle)])
    height = 0.05 if len(places) > 1 else 0.0
    result, contact, place, speeds = feet(places, friction=0.3, velocity=1.2 * along, height=height, end=0.6, step=0.02)
    t = np.minimum(result.time, 1.2 / (0.3 * G))
    exact = 1.2 * t - 0.5 * 0.3 * G * t**2
    assert place[:, :2] @ along == pytest.approx(exact, abs=1e-10)
    assert place[:, :2] @ (-along[1], along[0]) == pytest.approx(0.0, abs=1e-10)
    assert place[-1, :2] @ along == pytest.approx(1.2**2 / (2 * 0.3 * G), rel=1e-10)
    assert np.abs(speeds[-1]).max() < 1e-10
    pull = np.linalg.norm(result.friction(contact), axis=2)
    assert (pull <= 0.3 * result.force(contact) * (1 + 1e-9) + 1e-10).all()


def test_a_block_pushed_across_a_slope_bends_its_way_down_it_and_stops():
    slope, friction, errors = 0.2, 0.35, []

    def rates(t, y):
        pull = -friction * G * np.cos(slope) * y[2:] / np.hypot(*y[2:])
        return [y[2], y[3], G * np.sin(slope) + pull[0], pull[1]]

    def slow(t, y):
        return np.hypot(y[2], y[3]) - 1e-9

    slow.terminal = True
    exact = solve_ivp(rates, (0, 9), [0, 0, 0.3, 1.0], events=slow, rtol=1e-12, atol=1e-13)
    for step in (0.01, 0.005):
        result, _, place, speeds = feet(
            [(0.0, 0.0)], friction=friction, velocity=(0.3, 1.0), slope=slope, end=0.6, step=step
        )
        errors.append(np.linalg.norm(place[-1, :2] - exact.y[:2, -1]))
        assert np.abs(speeds[-1]).max() < 1e-9
        balance = result.balance()
        assert np.diff(balance.total).max() < 1e-12
    assert exact.t[-1] < 0.6 and errors[-1] < 2e-5
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.1)


def test_a_spinning_tripod_stops_sliding_and_spinning_together():
    """Its centre is at the height of its feet, so each carries a third of the weight."""
    places = 0.1 * np.array([(np.cos(a), np.sin(a)) for a in (0.2, 0.2 + 2 * np.pi / 3, 0.2 + 4 * np.pi / 3)])
    friction, inertia, errors = 0.25, 0.015, []

    def rates(t, y):
        c, s = np.cos(y[2]), np.sin(y[2])
        arms = places @ np.array([[c, s], [-s, c]])
        slip = y[3:5] + y[5] * np.column_stack((-arms[:, 1], arms[:, 0]))
        pull = -friction * 2 * G / 3 * slip / np.linalg.norm(slip, axis=1)[:, None]
        moment = np.sum(arms[:, 0] * pull[:, 1] - arms[:, 1] * pull[:, 0])
        return [*y[3:], *(pull.sum(axis=0) / 2), moment / inertia]

    exact = solve_ivp(rates, (0, 0.3), [0, 0, 0, 0.8, 0.1, 9.0], rtol=1e-11, atol=1e-12)
    for step in (0.01, 0.005):
        result, _, place, speeds = feet(
            places, friction=friction, velocity=(0.8, 0.1), spin=9.0, inertia=(0.01, 0.01, inertia), end=0.3, step=step
        )
        errors.append(np.abs(place[-1, :2] - exact.y[:2, -1]).max())
    assert errors[1] < 4e-5 and np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)
    result, _, _, speeds = feet(
        places, friction=friction, velocity=(0.8, 0.1), spin=9.0, inertia=(0.01, 0.01, inertia), end=0.8, step=0.01
    )
    moving = np.abs(speeds) > 1e-8
    last = [result.time[moving[:, k]].max() for k in (0, 5)]
    assert last[0] == last[1] and np.abs(speeds[-1]).max() < 1e-9


@pytest.mark.parametrize("seed", [18, 30, 95])
def test_an_oblique_impact_with_friction_and_restitution_adds_no_energy(seed):
    """Rods that slide towards their foot: Newton's law alone would add up to a quarter (Kane 1984)."""
    gains = []
    for number in range(40):
        rng = np.random.default_rng(40 * seed + number)
        R = rotation((0, 1, 0), rng.uniform(0, np.pi))
        velocity = 2 * rng.standard_normal(3)
        system = System()
        body = system.add(
            RigidBody(
                1.0,
                (1 / 12, 1 / 12, 1e-3),
                rotation=R,
                velocity=velocity,
                angular_velocity=5 * rng.standard_normal(3),
                markers={"foot": (0, 0, 0.5)},
            )
        )
        contact = Contact(
            [body.marker("foot")],
            Plane(0.5 * R[:, 2]),
            on=ground.marker_at(),
            friction=rng.uniform(0, 1.5),
            restitution=rng.uniform(0.3, 1.0),
        )
        result = simulate_contact(system, [contact], end=1e-6, step=1e-6)
        gains += [-impact.loss / result.balance().kinetic[0] for impact in result.impacts]
    assert len(gains) > 10 and max(gains) < 1e-10


def test_an_impact_that_would_add_energy_leaves_others_alone():
    """A ball on the same plane at the same instant rebounds as it would by itself."""
    speeds = []
    for both in (False, True):
        rng = np.random.default_rng(3089)
        R = rotation((0, 1, 0), rng.uniform(0, np.pi))
        velocity, spin = 2 * rng.standard_normal(3), 5 * rng.standard_normal(3)
        system, plane = System(), Plane(0.5 * R[:, 2])
        rod = system.add(
            RigidBody(
                1.0,
                (1 / 12, 1 / 12, 1e-3),
                rotation=R,
                velocity=velocity,
                angular_velocity=spin,
                markers={"foot": (0, 0, 0.5)},
                name="rod",
            )
        )
        friction, restitution = rng.uniform(0, 1.5), rng.uniform(0.3, 1)
        foot = [rod.marker("foot")]
        contacts = [Contact(foot, plane, on=ground.marker_at(), friction=friction, restitution=restitution, name="rod")]
        if both:
            at = (5, 0, 0.5 * R[2, 2])
            ball = system.add(RigidBody(1.0, (1, 1, 1), position=at, velocity=(0, 0, -1), markers={"c": (0, 0, 0)}))
            contacts.append(Contact([ball.marker("c")], plane, on=ground.marker_at(), restitution=1.0, name="ball"))
        result = simulate_contact(system, contacts, end=1e-6, step=1e-6)
        speeds.append(result.speeds(rod)[-1])
        assert abs(result.impacts[0].loss) < 1e-8 * result.balance().kinetic[0]
    assert result.speeds(ball)[-1, 2] == pytest.approx(1.0, abs=1e-12)
    assert speeds[1] == pytest.approx(speeds[0], abs=1e-9)


# Forces of many points at once.


def points(seed):
    """W, q and friction of points on bodies that approach a surface: redundant ones too, always with a solution."""
    rng = np.random.default_rng(seed)
    r = int(rng.integers(1, 8))
    if seed % 2:
        bodies = int(rng.integers(1, 4))
        H, mass = rng.standard_normal((3 * r, 6 * bodies)), 10.0 ** rng.uniform(-1, 1, 6 * bodies)
    else:
        feet = np.column_stack((rng.standard_normal((r, 2)), np.full(r, -0.5)))
        H = np.array([np.concatenate((d, np.cross(p, d))) for p in feet for d in np.eye(3)[[2, 0, 1]]])
        mass = np.array([2, 2, 2, 0.3, 0.2, 0.4])
    v = 3 * rng.standard_normal(H.shape[1])
    v[2] = -1.0
    return (H / mass) @ H.T, H @ v, rng.uniform(0, 1.2, r)


def broken(W, q, friction, p):
    """The largest violation of Coulomb's law, from its definition, relative to the problem."""
    u = (W @ p.ravel() + q).reshape(p.shape)
    pull, slip = np.linalg.norm(p[:, 1:], axis=1), np.linalg.norm(u[:, 1:], axis=1)
    against = np.einsum("ia,ia->i", p[:, 1:], u[:, 1:]) + friction * p[:, 0] * slip
    size = np.abs(q).max() * max(1.0, np.abs(p).max())
    parts = (np.abs(np.minimum(p[:, 0], u[:, 0])), np.maximum(pull - friction * p[:, 0], 0.0), np.abs(against))
    return max(float(part.max()) for part in parts) / size


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_forces_of_random_points_obey_the_law(first):
    for seed in range(first, first + 50):
        W, q, friction = points(seed)
        p = coulomb(W, q, friction, np.zeros((len(friction), 3)))
        assert broken(W, q, friction, p) < 1e-10


def test_no_forces_keep_apart_points_that_are_held():
    with refusal("result", "friction", by=SolverError):
        coulomb(np.zeros((3, 3)), np.array([-1.0, 0, 0]), np.array([0.3]), np.zeros((1, 3)))


SICONOS = """
import json, sys
import numpy as np
import siconos.numerics as sn
out = []
for W, q, mu, ours in json.load(sys.stdin):
    problem = sn.FrictionContactProblem(3, np.array(W), np.array(q), np.array(mu))
    options = sn.SolverOptions(sn.SICONOS_FRICTION_3D_NSGS)
    options.iparam[0], options.dparam[0] = 100000, 1e-12
    p, u, ours = np.zeros(len(q)), np.zeros(len(q)), np.array(ours)
    info = sn.fc3d_driver(problem, p, u, options)
    free = np.array(W) @ ours + np.array(q)
    error = sn.fc3d_compute_error(problem, ours, free, 1e-10, options, float(np.linalg.norm(q)))
    out.append([int(info), float(error[1]), p.tolist(), u.tolist()])
json.dump(out, sys.stdout)
"""


def test_siconos_agrees_with_the_forces_and_has_mostly_the_same_velocities():
    """Of an impact with friction there may be several, all of which obey the law."""
    if subprocess.run(["/usr/bin/python3", "-c", "import siconos.numerics"], capture_output=True).returncode:
        pytest.skip("Siconos is not installed (apt-get install python3-siconos): no second code for Coulomb's cone")
    problems = [points(seed) for seed in range(40)]
    ours = [coulomb(W, q, friction, np.zeros((len(friction), 3))) for W, q, friction in problems]
    given = [
        [part.ravel().tolist() for part in (q, friction, p)] for (_, q, friction), p in zip(problems, ours, strict=True)
    ]
    given = json.dumps([[W.tolist(), *rest] for (W, *_), rest in zip(problems, given, strict=True)])
    run = subprocess.run(["/usr/bin/python3", "-c", SICONOS], input=given, capture_output=True, text=True, timeout=60)
    answers, same = json.loads(run.stdout[run.stdout.index("[[") :]), 0
    for (W, q, friction), p, (info, error, other, velocity) in zip(problems, ours, answers, strict=True):
        assert info == 0 and error < 1e-10
        assert broken(W, q, friction, np.reshape(other, (-1, 3))) < 1e-10
        same += bool(np.abs(W @ p.ravel() + q - velocity).max() < 1e-9 * np.abs(q).max())
    assert same >= 25
