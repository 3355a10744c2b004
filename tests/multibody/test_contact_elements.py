"""Contact as a force: laws of restitution, tables, balls in a ring."""

from __future__ import annotations

import numpy as np
import pytest

import morembs
from morembs.base.errors import SolverError
from morembs.dynamics.multibody import (
    ContactElement,
    ContactTable,
    Cylinder,
    PointLoad,
    PowerLaw,
    PrismaticJoint,
    RigidBody,
    Sphere,
    System,
    contact_table,
    equilibrium,
    ground,
    linearize,
    simulate,
)
from morembs.fem import DofMap, FEModel
from morembs.fem.grid import grid_mesh
from tests.support.refusals import refusal

STIFFNESS = 1e9
# Rebound over approach of a sphere with the exponent 1.5, from a quadrature of each law: independent of mass and speed.
REBOUND = {
    "hunt-crossley": {0.3: 0.5813, 0.9: 0.9090},
    "lankarani-nikravesh": {0.3: 0.6842, 0.9: 0.9132},
    "flores": {0.3: 0.2562, 0.9: 0.8939},
}
STEEL = {"young": 2.1e11, "poisson": 0.3, "density": 7850.0}


def ball_and_wall(speed, wall=None, direction=(0, 0, 1), **law):
    """A ball of 1 kg, 0.01 mm before it meets a wall; the duration of a touch without dissipation."""
    system = System()
    ball = system.add(
        RigidBody(1.0, (1, 1, 1), position=(0, 0, 0.01001), velocity=(0, 0, -speed), markers={"c": (0, 0, 0)})
    )
    wall = ground.marker_at((0, 0, 0)) if wall is None else system.add(wall).marker("w")
    stiffness = law.pop("stiffness", PowerLaw(STIFFNESS))
    system.add(ContactElement(ball.marker("c"), wall, stiffness=stiffness, direction=direction, distance=0.01, **law))
    return system, ball.marker("c"), 2.94 * (1.25 / STIFFNESS * speed**-0.5) ** 0.4


def rebound(speed, **law):
    system, ball, touch = ball_and_wall(speed, **law)
    return system, ball, simulate(system, end=3 * touch, step=touch / 100)


@pytest.mark.parametrize(("law", "restitution"), [(law, e) for law, values in REBOUND.items() for e in values])
def test_a_ball_rebounds_as_the_law_says(law, restitution):
    _, ball, result = rebound(1.0, law=law, restitution=restitution)
    assert result.velocity(ball)[-1, 2] == pytest.approx(REBOUND[law][restitution], abs=1e-3)


def test_the_law_is_that_of_each_touch_and_each_run():
    system, ball, result = rebound(4.0, law="flores", restitution=0.5)
    assert result.velocity(ball)[-1, 2] == pytest.approx(4 * 0.4704, abs=4e-3)
    again = simulate(system, end=result.time[-1], step=1.0000001 * np.diff(result.time).max())
    assert np.array_equal(again.velocity(ball), result.velocity(ball))


def test_energy_balances_between_two_bodies_that_turn():
    wall = RigidBody(
        1.0,
        (1, 2, 3),
        position=(0, 0.3, 0),
        velocity=(0, 0, 1),
        rotation=((0, 0, 1), (1, 0, 0), (0, 1, 0)),
        angular_velocity=(0.3, 0.1, 0.2),
        markers={"w": (-0.3, 0, 0)},
        name="wall",
    )
    system, _, touch = ball_and_wall(1.0, wall, (0, 1, 0), restitution=0.6)
    coarse, fine = (simulate(system, end=3 * touch, step=touch / count).energy() for count in (50, 100))
    off = [np.abs(energy.total - energy.total[0] - energy.work).max() for energy in (coarse, fine)]
    assert off[1] < min(1e-3, 0.4 * off[0])
    assert fine.work[-1] < -0.1 * fine.total[0]


def test_balls_of_a_bearing_share_its_load():
    system, load, at_rest = System(), 1000.0, (np.zeros(6), np.zeros(6))
    shaft = system.add(RigidBody(1.0, (1, 1, 1), position=(1e-5, 0, 0), markers={"c": (0, 0, 0)}))
    balls = [
        system.add(
            ContactElement(
                shaft.marker("c"),
                ground.marker_at((0, 0, 0)),
                stiffness=PowerLaw(1e10),
                direction=(-np.cos(a), -np.sin(a), 0),
                name=f"ball {k}",
            )
        )
        for k, a in enumerate(2 * np.pi * np.arange(8) / 8)
    ]
    system.add(PrismaticJoint(ground.marker_at((0, 0, 0)), shaft.marker("c"), axis=(1, 0, 0)))
    system.add(PointLoad(shaft.marker("c"), force=(load, 0, 0)))
    state = equilibrium(system).state
    forces = [ball.force(0.0, [state.assembly.place(m, state.x) for m in ball.markers], at_rest) for ball in balls]
    # 1 / sum of cos^2.5 over the balls under load, by hand; Stribeck's 4.37 / 8 is 0.546.
    assert forces[0] == pytest.approx(0.5432 * load, rel=1e-4)
    assert forces[4] == 0


def test_a_table_of_a_power_law_is_that_law():
    law, depth = PowerLaw(2e9), np.linspace(1e-6, 2e-5, 12)
    table = ContactTable(depth, [law.force(d) for d in depth])
    assert table.exponent == pytest.approx(1.5, abs=1e-9)
    for d in (0.0, 3e-7, 1e-6, 7.7e-6, 2e-5):
        assert table.force(d) == pytest.approx(law.force(d), rel=1e-12)
        assert table.energy(d) == pytest.approx(law.energy(d), rel=1e-12)
    softer = table.without(-1e-9)
    assert softer.force(depth[3] + 1e-9 * law.force(depth[3])) == pytest.approx(law.force(depth[3]), rel=1e-12)


def graded(first, count, ratio, end):
    """Points from 0 to ``end``: ``count`` cells of size ``first``, then growing by ``ratio``."""
    sizes = [first] * count
    while sum(sizes) < end:
        sizes.append(min(ratio * sizes[-1], end - sum(sizes)))
    return np.cumsum([0.0, *sizes])


def quarter_block(x):
    """A block [0, x] by [0, x] under z = 0 with two planes of symmetry, held below."""
    grid = np.stack(np.meshgrid(x, x, -x[::-1], indexing="ij"), axis=-1)
    model = morembs.assemble(grid_mesh(grid, "hex8"), [morembs.isotropic(set="all", **STEEL)])
    at, component = model.nodes.xyz[model.dofs.node], model.dofs.component
    held = ((component < 2) & (at[np.arange(len(at)), component % 3] == 0)) | np.isclose(at[:, 2], -x[-1])
    free = np.flatnonzero(~held)
    return FEModel(
        K=model.K[free][:, free],
        M=model.M[free][:, free],
        nodes=model.nodes,
        mesh=model.mesh,
        dofs=DofMap(node=model.dofs.node[free], component=component[free]),
    )


def test_the_table_of_a_ball_is_hertz_and_tells_where_elements_are_too_large(caplog):
    radius, depth = 0.01, np.array([2e-6, 1.4e-5, 1.8e-5, 2.2e-5])
    with morembs.Problem(quarter_block(graded(8e-5, 7, 1.6, 0.012))) as problem:
        table = contact_table(
            problem,
            Sphere((0, 0, radius), radius),
            surface="box:0,0,-1e-9,5.7e-4,5.7e-4,1e-9",
            penetration=depth,
            push=(0, 0, -1),
        )
    hertz = PowerLaw(4 / 3 * STEEL["young"] / (1 - STEEL["poisson"] ** 2) * np.sqrt(radius))
    # The block ends at 12 mm: from there on a half space moves by (1 + nu) (3 - 2 nu) / (2 pi E 12 mm) times the load.
    missing = 1.3 * 2.4 / (2 * np.pi * STEEL["young"] * 0.012)
    force = 4 * np.asarray(table.forces)
    wanted = [hertz.force(d + missing * f) for d, f in zip(depth, force, strict=True)]
    assert force[1:] == pytest.approx(wanted[1:], rel=0.01)
    assert np.asarray(table.area)[1:] * 4 == pytest.approx(np.pi * radius * depth[1:], rel=0.12)
    assert [record.args[0] for record in caplog.records] == [2e-6]


def test_a_roller_on_a_mounted_block_meets_a_line():
    # Between planes of symmetry a roller without crown is a plane problem: its force is that of any length of it.
    mesh = grid_mesh(
        np.stack(
            np.meshgrid(
                graded(1e-4, 6, 1.7, 0.01), [0.0, 1e-3, 2e-3], -graded(1e-4, 6, 1.7, 0.01)[::-1], indexing="ij"
            ),
            axis=-1,
        ),
        "hex8",
    )
    model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=2.1e11, poisson=0.0, density=7850.0)])
    bottom = morembs.make_interface(
        model, name="FOOT", nodes=morembs.select_nodes(model, "box:0,0,-0.0101,0.01,0.002,-0.0099"), coupling="rigid"
    )
    surface, depth = "box:0,0,-1e-9,6.1e-4,0.002,1e-9", [4e-6, 8e-6]
    with morembs.Problem(model, [bottom]) as problem:
        line, crowned = (
            contact_table(
                problem,
                Cylinder((0, 1e-3, 0.02), (0, 1, 0), 0.02, crown=crown),
                surface=surface,
                penetration=depth,
                push=(0, 0, -1),
            )
            for crown in (np.inf, 0.1)
        )
        with refusal("value", "push"):
            contact_table(
                problem, Cylinder((0, 0, 1), (0, 0, 1), 0.1), surface=surface, penetration=depth, push=(0, 0, -1)
            )
        with refusal("value", "penetration"):
            contact_table(problem, Sphere((0, 0, 1), 1), surface=surface, penetration=[2e-6, 1e-6], push=(0, 0, -1))
    # A line load sinks in a little more than in proportion (Johnson 1985, section 5.6: with a logarithm).
    assert 2.0 < line.forces[1] / line.forces[0] < 2.5
    assert (np.asarray(crowned.forces) < np.asarray(line.forces)).all()
    with morembs.Problem(model) as problem, refusal("model", "", "6"):
        contact_table(problem, Sphere((0, 0, 1), 1), surface=surface, penetration=depth, push=(0, 0, -1))


def test_beyond_its_table_a_run_ends_with_a_message():
    system, _, _ = ball_and_wall(1.0, stiffness=ContactTable([1e-5, 2e-5], [30.0, 90.0]))
    with refusal("result", "", "2e-05", by=SolverError):
        simulate(system, end=2e-3, step=1e-5)


def test_bad_numbers_are_named():
    ball = RigidBody(1.0, (1, 1, 1), position=(0, 0, 1), markers={"c": (0, 0, 0)})
    ends = ball.marker("c"), ground.marker_at((0, 0, 0))
    for wrong, message in (
        ({"restitution": 0.0}, ("conflict", "restitution")),
        ({"restitution": 1.2}, ("value", "restitution")),
        ({"law": "florse"}, ("unknown", "law")),
        ({"direction": (0, 0, 0)}, ("value", "direction")),
        ({"direction": None}, ("value", "distance", "0.0")),
    ):
        with refusal(*message):
            ContactElement(*ends, **{"stiffness": PowerLaw(1.0), "direction": (0, 0, 1)} | wrong)
    with refusal("value", "stiffness", "-1"):
        PowerLaw(-1)
    with refusal("value", "force"):
        ContactTable([1e-6, 2e-6], [3.0, 2.0])


@pytest.mark.parametrize("restitution", [0.6, 0.05])
def test_a_contact_at_rest_is_a_spring(restitution):
    """A body that rests on a contact with restitution: nothing damps by the sign of the rate, and runs begin there."""
    system = System(gravity=(0, 0, -9.81))
    body = system.add(RigidBody(1.0, (1, 1, 1), position=(0, 0, 0.0196), markers={"c": (0, 0, 0)}))
    contact = ContactElement(
        body.marker("c"),
        ground.marker_at((0, 0, 0)),
        stiffness=PowerLaw(1e6, 1.5),
        direction=(0, 0, 1),
        distance=0.02,
        restitution=restitution,
    )
    system.add(contact)
    rest = equilibrium(system)
    about = linearize(rest.state)
    depth = (9.81 / 1e6) ** (2 / 3)
    assert np.abs(about.C).max() < 1e-9
    assert about.squares[-1] == pytest.approx(1.5e6 * depth**0.5, rel=1e-4)
    result = simulate(system, end=0.02, step=2e-4, start=rest.state)
    assert result.position(body.marker("c"))[:, 2] == pytest.approx(0.02 - depth, abs=1e-12)
