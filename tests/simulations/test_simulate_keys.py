"""Keys of system files, each against a closed form: where bodies begin, laws and motions, frames of markers."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import morembs
from morembs.app.jobs.job import job_of_text
from morembs.app.jobs.run import run_job
from morembs.app.simulations.check import check_system
from morembs.app.simulations.result_file import Recording, read_recording
from morembs.app.simulations.run import run_system
from morembs.app.simulations.system_file import load_system
from morembs.dynamics.gmp import ReducedMember
from morembs.dynamics.gmp.stored import write_members
from morembs.dynamics.multibody import rotation
from morembs.dynamics.nonlinear import PlanarBeam, Section
from morembs.parametric.terms import AffineProblem, varied_model
from tests.support import parametric
from tests.support.refusals import refusal

G = 9.81
BODY = "name = '{}', mass = 2.0, inertia = [1, 1, 0.5], markers = {{ c = [0, 0, 0] }}"
STRIP = """
model = { mesh = "MESH", units = "UNITS" }
material = [{ young = 2e9, poisson = 0.3, density = 1200.0 }]
interface = [
    { name = "ROOT", nodes = "set:ROOT", coupling = "rigid" },
    { name = "TIP", nodes = "set:TIP", coupling = "rigid" },
]
reduce = [
    { name = "fine", method = "craig-bampton", modes = 4 },
    { name = "coarse", method = "craig-bampton", modes = 1 },
]
frame = { origin = "center-of-mass" }
output = { path = "NAME.h5", nodes = "all" }
"""


def simulated(folder: Path, text: str, *changes: str) -> Recording:
    path = folder / "system.toml"
    path.write_text(f'{text}\n[output]\npath = "result.h5"\n')
    return read_recording(run_system(load_system(path, changes)).built.file.output)


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory, small_meshes: Path) -> Path:
    """A folder with the strip of 0.5 m in a frame of mean axes, and with the same read in mm."""
    folder = tmp_path_factory.mktemp("strip")
    for name, units in (("strip", "m-kg-s"), ("small", "mm-kg-s")):
        text = STRIP.replace("MESH", str(small_meshes / "beam.msh")).replace("UNITS", units).replace("NAME", name)
        run_job(job_of_text(text, folder / f"{name}.toml"))
    return folder


def test_bodies_begin_where_and_as_fast_as_they_are_told(strip: Path) -> None:
    """The origin of the model of an elastic body is a corner of it, that of its frame the centre of mass."""
    beam = PlanarBeam.straight(0.3, 6, Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770))
    write_members(strip / "rod.h5", {"rod": ReducedMember(beam, modes=2, formulation="membrane", reach=0.6).data})
    place = "position = [1, 2, 3], rotation = { axis = [0, 0, 1], degrees = 30 }, velocity = [0.1, 0.2, 0.3]"
    text = f"""
    simulation = {{ end = 1e-4, step = 1e-4, corrected_start = false }}
    body = [
        {{ name = "fine", file = "strip.h5", reduction = "fine", {place}, angular_velocity = [2, 3, 4] }},
        {{ name = "coarse", file = "strip.h5", reduction = "coarse" }},
    ]
    rigid_body = [{{ {BODY.format("rigid")}, center_of_mass = [0.1, 0, 0], {place}, angular_velocity = [2, 3, 4] }}]
    [[member]]
    name = "rod"
    file = "rod.h5"
    position = [1, 0, 0]
    rotation = {{ axis = [0, 0, 1], degrees = 90 }}
    velocity = [0.1, 0, 0]
    spin = 5.0
    ends = [0.1, -0.1]
    [[marker]]
    name = "arm"
    body = "rigid"
    point = [0.5, 0, 0]
    rotation = {{ axis = [0, 1, 0], degrees = 90 }}
    """
    bodies = simulated(strip, text).bodies
    R, v = rotation((0, 0, 1), math.radians(30)), np.array([0.1, 0.2, 0.3])
    w = R @ np.array([2.0, 3, 4])
    stored = morembs.read_body(strip / "strip.h5")
    at = {"fine": ("TIP", stored.interfaces["TIP"].point), "rigid": ("arm", np.array([0.5, 0, 0]))}
    for name, (marker, point) in at.items():
        told = bodies[name].markers[marker]
        assert told.position[0] == pytest.approx(np.array([1, 2, 3]) + R @ point, abs=1e-12), name
        assert told.velocity[0] == pytest.approx(v + np.cross(w, R @ point), abs=1e-9), name
        assert told.angular_velocity[0] == pytest.approx(w, abs=1e-9), name
    assert bodies["rigid"].markers["arm"].axes[0] == pytest.approx(R @ rotation((0, 1, 0), math.pi / 2), abs=1e-12)
    assert bodies["fine"].coordinates.shape[1] == bodies["coarse"].coordinates.shape[1] + 3
    end = bodies["rod"].markers["end"]
    assert end.position[0] == pytest.approx([1, 0.3, 0], abs=1e-12)
    assert end.velocity[0] == pytest.approx([0.1 - 5 * 0.3, 0, 0], abs=1e-9)
    assert end.axes[0] == pytest.approx(rotation((0, 0, 1), math.pi / 2 - 0.1), abs=1e-12)


def test_motions_and_laws_are_what_they_are_called(tmp_path: Path) -> None:
    joints = [
        '{ kind = "revolute", between = ["ground", "BODY:c"] }, '
        '{ kind = "angle", between = ["ground", "BODY:c"], MOTION }',
        '{ kind = "prismatic", between = ["ground", "BODY:c"] }, '
        '{ kind = "position", between = ["ground", "BODY:c"], MOTION }',
    ]
    sine = 'motion = { kind = "sine", amplitude = 0.3, frequency_hz = 5, phase_degrees = 90, start = -0.3 }'
    smooth = 'motion = { kind = "smooth", change = 0.2, duration = 0.05, begin = 0.02 }'
    rise = 'law = { kind = "rise", duration = 0.1 }'
    text = f"""
    simulation = {{ end = 0.1, step = 5e-4 }}
    rigid_body = [
        {{ {BODY.format("turned")} }}, {{ {BODY.format("moved")} }}, {{ {BODY.format("pushed")} }},
        {{ {BODY.format("carried")}, rotation = {{ axis = [0, 0, 1], degrees = 90 }} }},
    ]
    joint = [
        {joints[0].replace("BODY", "turned").replace("MOTION", sine)},
        {joints[1].replace("BODY", "moved").replace("MOTION", smooth)},
    ]
    load = [
        {{ marker = "pushed:c", force = [2, 0, 0], {rise} }},
        {{ marker = "carried:c", force = [2, 0, 0], follows = true }},
    ]
    """
    done = simulated(tmp_path, text)
    t, at = done.time, {name: body.markers["c"] for name, body in done.bodies.items()}
    w = 2 * np.pi * 5
    assert at["turned"].axes[:, 1, 0] == pytest.approx(np.sin(0.3 * np.cos(w * t) - 0.3), abs=1e-9)
    assert at["turned"].angular_velocity[:, 2] == pytest.approx(-0.3 * w * np.sin(w * t), abs=1e-3)
    s = np.clip((t - 0.02) / 0.05, 0, 1)
    assert at["moved"].position[:, 2] == pytest.approx(0.2 * s**3 * (10 - 15 * s + 6 * s * s), abs=1e-9)
    # The integral of 10 s^3 - 15 s^4 + 6 s^5, twice; 2 N on 2 kg.
    s = t / 0.1
    assert at["pushed"].position[:, 0] == pytest.approx(0.01 * (s**5 / 2 - s**6 / 2 + s**7 / 7), abs=1e-7)
    assert at["carried"].position[-1] == pytest.approx([0, 0.005, 0], abs=1e-9)


def test_a_joint_has_its_axis_along_its_first_marker(tmp_path: Path) -> None:
    text = f"""
    simulation = {{ end = 0.1, step = 1e-3 }}
    gravity = {{ acceleration = [-{G}, -{G}, 0] }}
    rigid_body = [{{ {BODY.format("slide")}, position = [1, 1, 0] }}]
    marker = [{{ name = "rail", point = [1, 0, 0], rotation = {{ axis = [0, 0, 1], degrees = 90 }} }}]
    joint = [{{ kind = "prismatic", between = ["ground:rail", "slide:c"], axis = [1, 0, 0] }}]
    """
    done = simulated(tmp_path, text)
    assert done.bodies["slide"].position == pytest.approx(
        np.stack([1 + 0 * done.time, 1 - G * done.time**2 / 2, 0 * done.time], axis=1), abs=1e-9
    )
    # Weight across the rail, and its moment about the rail at the slide, which sits on it.
    assert done.joints["joint_1"].reaction[-1] == pytest.approx([2 * G, 0, 0, 0, 0, 0], abs=1e-8)


def test_nodes_of_a_region_touch_the_floor_when_the_body_has_fallen(strip: Path) -> None:
    height = 0.02
    text = f"""
    simulation = {{ end = 0.1, step = 1e-3 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    body = [{{ name = "strip", file = "strip.h5", reduction = "coarse", position = [0, 0, {height}] }}]
    contact = [{{ points = ["strip:box:0,0,0,0,0.05,0", "strip:box:0.5,0,0,0.5,0.05,0"], restitution = 0.2 }}]
    """
    done = simulated(strip, text)
    assert done.impacts is not None
    assert done.impacts.time[0] == pytest.approx(math.sqrt(2 * height / G), abs=1e-6)
    contact = done.contacts["contact_1"]
    nodes = morembs.read_body(strip / "strip.h5").coordinates
    on_edges = np.isin(nodes[:, 0].round(9), (0, 0.5)) & (np.abs(nodes[:, 2]) < 1e-9)
    assert contact.gap.shape[1] == on_edges.sum() > 4
    assert contact.gap[0] == pytest.approx(height, abs=1e-9) and contact.gap.min() > -1e-7
    with refusal("unknown", "points", "[[contact]]", "contact_1", "strip:box:9,9,9,10,10,10"):
        simulated(strip, text.replace("0,0,0,0,0.05,0", "9,9,9,10,10,10"))


def test_a_point_that_yields_bears_a_weight_at_rest(tmp_path: Path) -> None:
    """A compliant point sinks by force times compliance, without impact."""
    text = f"""
    simulation = {{ end = 0.01, step = 1e-4 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    rigid_body = [{{ {BODY.format("ball")}, position = [0, 0, {-2 * G * 1e-5}] }}]
    contact = [{{ points = ["ball:c"], compliance = 1e-5 }}]
    """
    done = simulated(tmp_path, text)
    assert done.contacts["contact_1"].force[:, 0] == pytest.approx(2 * G, rel=1e-6)
    assert done.impacts is not None and not len(done.impacts.time)


def test_a_body_with_parameters_is_taken_at_their_values(tmp_path: Path) -> None:
    """A tenth more density, a tenth more weight in the joint."""
    varied = varied_model(parametric.bracket(), [parametric.STEEL], parametric.parameters())
    with AffineProblem(varied, parametric.interfaces(varied.model(varied.box.nominal))) as problem:
        parametric.parametric_file(tmp_path / "bracket.h5", problem, name="parametric", nodes="skin")
    stored = morembs.read_body(tmp_path / "bracket.h5")
    name = next(iter(stored.interfaces))
    text = f"""
    simulation = {{ end = 1e-4, step = 1e-4 }}
    gravity = {{ acceleration = [0, 0, -{G}] }}
    equilibrium = {{}}
    body = [{{ name = "bracket", file = "bracket.h5", at = {{ rho = RHO }} }}]
    joint = [{{ kind = "fixed", between = ["ground", "bracket:{name}"] }}]
    """
    weights = [
        simulated(tmp_path, text.replace("RHO", str(rho))).joints["joint_1"].reaction[0, 2] for rho in (7850.0, 8635.0)
    ]
    assert weights == pytest.approx([stored.mass * G, 1.1 * stored.mass * G], rel=1e-6)


def test_bodies_of_other_units_are_told(strip: Path) -> None:
    """A model in m whose job says mm is a thousandth as long as its neighbour."""
    text = """
    simulation = { end = 0.01, step = 1e-6 }
    body = [
        { name = "large", file = "strip.h5", reduction = "coarse" },
        { name = "small", file = "small.h5", reduction = "coarse" },
    ]
    joint = [{ name = "weld", kind = "fixed", between = ["large:TIP", "small:ROOT"] }]
    output = { path = "result.h5" }
    """
    (strip / "units.toml").write_text(text)
    with refusal("model", "joint", "weld", "large", "0.50", "small"):
        check_system(load_system(strip / "units.toml"))
    (strip / "units.toml").write_text(text.partition("joint =")[0] + 'output = { path = "result.h5" }')
    (sentence,) = check_system(load_system(strip / "units.toml")).warnings
    assert "other [model] units" in sentence
