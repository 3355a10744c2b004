"""Contact, sliding loads, members and springs of system files: against closed forms, and against the simulator."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from scipy.special import ellipk

import morembs
from morembs.app.simulations.check import check_system
from morembs.app.simulations.result_file import Recording, read_recording
from morembs.app.simulations.run import run_system
from morembs.app.simulations.system_file import load_system
from morembs.app.simulations.template import system_text
from morembs.base.errors import InputError, MorembsError
from morembs.dynamics.gmp import ParameterisedBody, PlaneJoint, ReducedMember
from morembs.dynamics.gmp.stored import write_members
from morembs.dynamics.multibody import (
    LinearBody,
    MovingLoad,
    SlidingSwitch,
    SwitchingBody,
    System,
    ground,
    local_response,
    rotation,
    simulate,
    simulate_sliding,
)
from morembs.dynamics.nonlinear import PlanarBeam, Section
from morembs.problem import Problem
from morembs.reducers import StaticModesSwitching
from tests.support.refusals import refusal
from tests.support.sliding import hermite_beam

G = 9.81
BALL = "name = 'ball', mass = 2.0, inertia = [1, 1, 1], markers = { c = [0, 0, 0] }"


def simulated(folder: Path, text: str, *changes: str) -> Recording:
    path = folder / "system.toml"
    path.write_text(f'{text}\n[output]\npath = "result.h5"\n')
    return read_recording(run_system(load_system(path, changes)).built.file.output)


def falling(surface: str, more: str = "restitution = 0.8") -> str:
    return f"""
    simulation = {{ end = 1.5, step = 0.01 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    rigid_body = [{{ {BALL}, position = [0.1, 0.2, 1] }}]
    contact = [{{ points = ["ball:c"], surface = {{ {surface} }}, {more} }}]
    """


@pytest.mark.parametrize("surface", ["plane", "grid", "triangles", "sphere"])
def test_a_ball_bounces_at_the_times_of_free_fall(tmp_path: Path, surface: str) -> None:
    xy = [(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)]
    (tmp_path / "grid.csv").write_text("\n".join(["x,y,z", *(f"{x},{y},0" for x, y in xy)]))
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    meshio.Mesh(corners[[0, 1, 2, 0, 2, 3]], [("triangle", np.arange(6).reshape(2, 3))]).write(tmp_path / "floor.stl")
    keys = {
        "plane": 'kind = "plane"',
        "grid": 'kind = "grid", file = "grid.csv", columns = 3',
        "triangles": 'kind = "triangles", file = "floor.stl"',
        "sphere": 'kind = "sphere", center = [0.1, 0.2, -3], radius = 3',
    }
    done = simulated(tmp_path, falling(keys[surface]))
    fall = math.sqrt(2 / G)
    times = [fall, fall * (1 + 2 * 0.8), fall * (1 + 2 * 0.8 + 2 * 0.64)]
    assert done.impacts is not None
    assert done.impacts.time[: len(times) - 1] == pytest.approx(times[:-1], abs=1e-8)
    # A rebound takes 1 - e^2 of the kinetic energy.
    assert done.impacts.loss[0] == pytest.approx(2.0 * G * (1 - 0.64), rel=1e-9)
    assert set(done.impacts.contact) == {"contact_1"}
    contact, energy = done.contacts["contact_1"], done.energy
    assert contact.gap[:, 0] == pytest.approx(done.bodies["ball"].markers["c"].position[:, 2], abs=1e-9)
    assert np.ptp(energy.kinetic + energy.potential - energy.work) < 1e-8


def test_a_block_slides_until_friction_stops_it(tmp_path: Path) -> None:
    speed, friction = 2.0, 0.4
    text = f"""
    simulation = {{ end = 0.7, step = 1e-3 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    rigid_body = [{{ {BALL}, velocity = [{speed}, 0, 0] }}]
    contact = [{{ name = "floor", points = ["ball:c"], friction = {friction} }}]
    """
    done = simulated(tmp_path, text)
    assert done.bodies["ball"].position[-1, 0] == pytest.approx(speed**2 / (2 * friction * G), abs=1e-8)
    moving = done.time < 0.9 * speed / (friction * G)
    assert done.contacts["floor"].friction[moving, 0, 0] == pytest.approx(-friction * 2 * G, rel=1e-6)


def test_a_contact_element_carries_a_weight_as_hertz_says(tmp_path: Path) -> None:
    text = f"""
    simulation = {{ end = 0.01, step = 1e-4 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    equilibrium = {{ load_steps = 2 }}
    rigid_body = [{{ {BALL}, position = [0, 0, 0.0199] }}]
    marker = [{{ name = "floor" }}]
    joint = [{{ kind = "prismatic", between = ["ground", "ball:c"] }}]
    contact_element = [
        {{ between = ["ball:c", "ground:floor"], stiffness = 1e9, direction = [0, 0, 1], distance = 0.02 }},
    ]
    """
    done = simulated(tmp_path, text)
    assert done.bodies["ball"].position[:, 2] == pytest.approx(0.02 - (2.0 * G / 1e9) ** (2 / 3), abs=1e-9)


def test_springs_swing_with_their_frequencies(tmp_path: Path) -> None:
    """A mass on a line spring with damping, a disc on a torsion spring."""
    k, c, turn, m = 200.0, 4.0, 50.0, 2.0
    text = f"""
    simulation = {{ end = 0.5, step = 2.5e-4 }}
    rigid_body = [
        {{ {BALL}, position = [1.1, 0, 0] }},
        {{ name = "disc", {BALL.partition(", ")[2]}, angular_velocity = [0, 0, 3] }},
    ]
    marker = [{{ name = "wall" }}]
    spring = [
        {{ between = ["ground:wall", "ball:c"], stiffness = {k}, damping = {c}, length = 1.0 }},
        {{ kind = "torsion", between = ["ground", "disc:c"], stiffness = {turn}, axis = [0, 0, 1] }},
    ]
    """
    done = simulated(tmp_path, text)
    t, decay = done.time, c / (2 * m)
    w = math.sqrt(k / m - decay**2)
    swing = 0.1 * np.exp(-decay * t) * (np.cos(w * t) + decay / w * np.sin(w * t))
    assert done.bodies["ball"].position[:, 0] - 1 == pytest.approx(swing, abs=1e-6)
    assert done.bodies["ball"].markers["c"].load[0, 0] == pytest.approx(-0.1 * k, rel=1e-9)
    disc = 3 * np.cos(math.sqrt(turn) * t)
    assert done.bodies["disc"].markers["c"].angular_velocity[:, 2] == pytest.approx(disc, abs=1e-3)


@pytest.fixture(scope="module")
def beam(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a simply supported beam of unit length, stiffness and mass, with static modes of all nodes."""
    folder = tmp_path_factory.mktemp("beam")
    reducer = StaticModesSwitching(base_options={"modes": 4}, candidates="set:RAIL", directions=[1, 5])
    with Problem(hermite_beam()) as problem:
        reduced = reducer.reduce(problem, name="beam")
        body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="all"))
        morembs.write_body(
            folder / "beam.h5", [replace(body, switching=reducer.tabulate_static_modes(problem, reduced))]
        )
    return folder


SPEED = 0.617 * math.pi
CROSSING = f"""
simulation = {{ end = {1 / SPEED}, step = {1 / SPEED / 600} }}
body = [{{ name = "beam", file = "beam.h5", held = true }}]
sliding = [{{ name = "wheel", body = "beam", speed = {SPEED}, force = [0, 1, 0] }}]
"""


def test_a_load_that_crosses_a_beam_deflects_it_as_fryba_says(beam: Path) -> None:
    wheel = simulated(beam, CROSSING).sliders["wheel"]
    x, k, alpha = wheel.position, np.arange(1, 400)[:, None], 0.617
    # Fryba (1999): unit load, length, stiffness and mass per length; under the load.
    shape = np.sin(k * np.pi * x) - alpha / k * np.sin((k * np.pi) ** 2 * x / SPEED)
    want = 2 / np.pi**4 * np.sum(shape / (k**2 * (k**2 - alpha**2)) * np.sin(k * np.pi * x), axis=0)
    assert np.abs(wheel.displacement[:, 1] - want).max() < 3e-3 * np.abs(want).max()
    # Where the load stands on a node, the static mode of that node alone bears it.
    assert wheel.largest_amplitude.max() == pytest.approx(1.0, abs=0.01)


def test_sliding_is_what_calls_of_the_simulator_give(beam: Path) -> None:
    done = simulated(beam, CROSSING, "output.every=3")
    stored = morembs.read_body(beam / "beam.h5").bodies["beam"]
    tables = stored.switching()
    inner = LinearBody(stored.mass_matrix, stored.stiffness_matrix, stored.damping_matrix, weight=tables.weight)
    body = SwitchingBody(inner, tables, at=0.0)
    system, switch = System(), SlidingSwitch(body)
    system.add(body)
    load = system.add(MovingLoad(body.path(), position=lambda t: SPEED * t, force=(0, 1, 0)))
    want = simulate_sliding(system, switch, end=1 / SPEED, step=1 / SPEED / 600)
    told = local_response(want, body, load)
    rows = np.flatnonzero(np.isin(want.time, done.time))
    some = done.sliders["wheel"]
    assert np.abs(some.displacement[-1] - told.displacement[-1]).max() < 1e-12
    assert len(rows) >= len(done.time) > 200 and np.isin(done.time, want.time).all()
    # Each third step of the run, across restarts, which come twice.
    steps = np.unique(want.time)
    assert np.isin(steps[::3], done.time).all()
    assert done.switches is not None
    assert done.switches.time.tolist() == [each.time for each in switch.log] and len(switch.log) > 10


def test_a_rider_needs_the_variant_that_it_is_for(beam: Path) -> None:
    text = f"""
    simulation = {{ end = 0.01, step = 1e-4 }}
    body = [{{ name = "beam", file = "beam.h5", held = true }}]
    rigid_body = [{{ {BALL}, position = [0.5, 0, 0] }}]
    sliding = [{{ name = "mass", kind = "support", body = "beam", marker = "ball:c", up = [0, 1, 0] }}]
    """
    assert simulated(beam, text).sliders["mass"].position == pytest.approx(0.5, abs=1e-9)
    with refusal("unsupported", "variant", "[[sliding]]", "mass"):
        simulated(beam, text, 'sliding.kind="point"')
    assert simulated(beam, text, 'sliding.kind="point"', 'body.switching.variant="dynamic"').switches is not None
    with refusal("value", "s"):
        simulated(beam, text, "sliding.at=2.0")
    with refusal("value", "body", "[[sliding]]"):
        simulated(beam, text.partition("sliding =")[0])


@pytest.fixture(scope="module")
def rod(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a stiff and a soft member."""
    folder = tmp_path_factory.mktemp("rod")
    members = {}
    for name, young in (("stiff", 2e11), ("soft", 3e6)):
        beam = PlanarBeam.straight(0.304, 6, Section.of(E=young, A=7.854e-5, I=4.909e-10, density=2770))
        members[name] = ReducedMember(beam, modes=2, formulation="membrane", reach=0.6).data
    write_members(folder / "rod.h5", members)
    return folder


def swinging(end: float, step: float, member: str) -> str:
    return f"""
    simulation = {{ end = {end}, step = {step}, rho = 1.0 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    joint = [{{ name = "hinge", kind = "plane", between = ["ground", "rod:start"], axis = [0, -1, 0] }}]
    [[member]]
    name = "rod"
    file = "rod.h5"
    member = "{member}"
    rotation = {{ axis = [1, 0, 0], degrees = 90 }}
    """


def test_a_stiff_member_swings_as_a_rigid_rod(rod: Path) -> None:
    """From the horizontal: a quarter of the period of elliptic integrals to the lowest place."""
    length, section = 0.304, 4.909e-10 / 7.854e-5
    quarter = math.sqrt((length**2 / 3 + section) / (G * length / 2)) * ellipk(math.sin(math.pi / 4) ** 2)
    end = simulated(rod, swinging(quarter, quarter / 500, "stiff")).bodies["rod"].markers["end"].position[-1]
    assert end == pytest.approx([0, 0, -length], abs=2e-5 * length)


def test_a_member_is_what_calls_of_the_simulator_give(rod: Path) -> None:
    done = simulated(rod, swinging(0.05, 1e-3, "soft"))
    beam = PlanarBeam.straight(0.304, 6, Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770))
    member = ReducedMember(beam, modes=2, formulation="membrane", reach=0.6)
    system = System(gravity=(0, 0, -G))
    body = system.add(ParameterisedBody(member, rotation=rotation((1, 0, 0), np.pi / 2)))
    hinge = system.add(PlaneJoint(ground.marker_at(), body.marker("start"), normal=(0, -1, 0)))
    want = simulate(system, end=0.05, step=1e-3, rho=1.0)
    tip = want.position(body.marker("end"))
    assert np.abs(done.bodies["rod"].markers["end"].position - tip).max() < 1e-10
    assert done.bodies["rod"].coordinates == pytest.approx(want.configuration(body), abs=1e-10)
    assert done.joints["hinge"].reaction == pytest.approx(want.reaction(hinge), abs=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("axis = [0, -1, 0]", "axis = [0, 0, 1]", "the axis [0.0, 0.0, 1.0] was given, but the plane of body 'rod' is"),
        ('kind = "plane"', 'kind = "revolute"', "expected \"plane\" at member 'rod'"),
        ('kind = "plane"', 'kind = "spherical"', "expected \"plane\" at member 'rod'"),
        ('kind = "plane"', 'kind = "fixed"', "expected \"plane-fixed\" at member 'rod'"),
    ],
)
def test_a_joint_that_does_not_fit_the_plane_of_a_member_is_told(rod: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        simulated(rod, swinging(0.01, 1e-3, "soft").replace(old, new))
    assert said in str(caught.value)


def test_members_of_two_planes_share_a_point_by_a_joint_of_space(rod: Path) -> None:
    text = (
        swinging(0.01, 1e-3, "stiff")
        + """
    [[member]]
    name = "flat"
    file = "rod.h5"
    member = "stiff"
    position = [0.304, 0, 0]
    """
    )
    ball = '}, { name = "ball", kind = "spherical", between = ["rod:end", "flat:start"] }]'
    done = simulated(rod, text.replace("}]", ball))
    one, other = (done.bodies[name].markers[at].position for name, at in (("rod", "end"), ("flat", "start")))
    assert np.abs(one - other).max() < 1e-9


def test_gravity_across_the_plane_of_a_member_is_told(rod: Path) -> None:
    text = swinging(0.01, 1e-3, "soft")
    flat = text.replace("degrees = 90", "degrees = 0").replace("[0, -1, 0]", "[0, 0, 1]")
    for told, system in (([], text), (["gravity is across its plane"], flat)):
        (rod / "weight.toml").write_text(f'{system}\n[output]\npath = "weight.h5"\n')
        said = check_system(load_system(rod / "weight.toml")).warnings
        assert len(said) == len(told) and all(words in each for words, each in zip(told, said, strict=True))


def test_a_first_system_of_a_member_swings(rod: Path) -> None:
    """The tip falls towards -z as that of a rigid rod; of two members the text names one and tells both."""
    (rod / "first.toml").write_text(system_text(rod / "rod.h5", rod))
    file = run_system(load_system(rod / "first.toml", ["simulation.end=0.02", 'member.rod.member="stiff"'])).built.file
    end = read_recording(file.output).bodies["rod"].markers["end"].position[-1]
    # The tip of a rod falls with 1.5 g from the horizontal; bending adds 5 F L^3 / (384 E I) of 1e-5 m at most.
    assert end[2] == pytest.approx(-0.75 * G * 0.02**2, rel=0.01)
    assert 'member = "soft"             # of soft, stiff' in (rod / "first.toml").read_text()


WRONG = {
    "a point inside": (falling('kind = "sphere", center = [0.1, 0.2, 1], radius = 0.5'), "inside their surfaces"),
    "a key of another surface": (falling('kind = "plane", radius = 1.0'), "radius was given"),
    "no radius": (falling('kind = "sphere"'), "without radius"),
    "no such grid": (falling('kind = "grid", file = "none.csv", columns = 2'), "none.csv cannot be read"),
    "no such triangles": (falling('kind = "triangles", file = "none.stl"'), "none.stl cannot be read"),
    "contact of a body with itself": (falling('kind = "plane"', 'on = "ball:c"'), "on one body"),
    "impacts of compliant points": (falling('kind = "plane"', "restitution = 0.5, compliance = 1e-6"), "no impacts"),
    "equilibrium and contact": (falling('kind = "plane"') + "equilibrium = {}", "[equilibrium] was given beside"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_with_a_contact_is_told(tmp_path: Path, case: str) -> None:
    text, expected = WRONG[case]
    with pytest.raises(MorembsError) as caught:
        simulated(tmp_path, text)
    assert expected in str(caught.value)
    assert not (tmp_path / "result.h5").exists()
