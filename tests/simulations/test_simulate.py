"""Systems of bodies from files: against closed forms, against the full model, and against calls of the simulator."""

from __future__ import annotations

import json
import math
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from scipy.special import ellipk

import morembs
from morembs.app.jobs.job import job_of_text
from morembs.app.jobs.run import run_job
from morembs.app.simulations.result_file import Recording, read_recording
from morembs.app.simulations.run import run_system
from morembs.app.simulations.system_file import load_system
from morembs.base.errors import InputError, SolverError
from morembs.body.file import read_body
from morembs.dynamics.multibody import FlexibleBody, PointLoad, RevoluteJoint, System, ground, rotation
from morembs.dynamics.multibody import simulate as simulate_in_python
from tests.support.processes import morembs as command
from tests.support.refusals import refusal

G = 9.81
ENDS = """
    { name = "ROOT", nodes = "set:ROOT", coupling = "rigid" },
    { name = "TIP", nodes = "set:TIP", coupling = "rigid" },
"""
LINE = """    { name = "LINE", nodes = "box:0.2,-1,-1,0.21,0.001,0.001", coupling = "direct" },
"""
STRIP = """
model = { mesh = "MESH" }
material = [{ young = 2e9, poisson = 0.3, density = 1200.0 }]
interface = [INTERFACES]
reduce = [{ name = "strip", method = "craig-bampton", modes = 4 }]
frame = { kind = "tangent", interfaces = ["ROOT"], origin = [0.1, 0.02, 0.01] }
stress = {}
stiffening = {}
output = { path = "NAME.h5" }
"""
PLACE = "position = [0.1, 0.2, 0.3], rotation = { axis = [0, 1, 0], degrees = 20 }"
SINE = 'kind = "sine", frequency_hz = 30, phase_degrees = 30, offset = 0.5'
SWING = f"""
simulation = {{ end = 0.05, step = 1e-3 }}
gravity = {{ acceleration = [0, 0, -9.81] }}
body = [{{ name = "strip", file = "strip.h5", {PLACE} }}]
joint = [{{ name = "hinge", kind = "revolute", between = ["ground", "strip:ROOT"], axis = [0, 1, 0] }}]
load = [{{ marker = "strip:TIP", force = [0, 1, -2], law = {{ {SINE} }} }}]
"""


def simulated(folder: Path, text: str, *changes: str) -> Recording:
    """What the file of a run holds; ``text`` is the system without its output."""
    path = folder / "system.toml"
    path.write_text(f'{text}\n[output]\npath = "result.h5"\n')
    return read_recording(run_system(load_system(path, changes)).built.file.output)


@pytest.fixture(scope="module")
def strip(tmp_path_factory: pytest.TempPathFactory, small_meshes: Path) -> Path:
    """A folder with body files of a strip of 0.5 m with rigid ends, of which one has a line of direct nodes too."""
    folder = tmp_path_factory.mktemp("strip")
    for name, interfaces in (("strip", ENDS), ("line", ENDS + LINE)):
        words = {"MESH": str(small_meshes / "beam.msh"), "INTERFACES": interfaces, "NAME": name}
        text = STRIP
        for word, value in words.items():
            text = text.replace(word, value)
        run_job(job_of_text(text, folder / f"{name}.toml"))
    return folder


@pytest.mark.parametrize("degrees", [20.0, 120.0])
def test_a_pendulum_comes_back_after_the_period_of_elliptic_integrals(tmp_path: Path, degrees: float) -> None:
    m, J, arm = 2.0, 0.1, 0.5
    amplitude = math.radians(degrees)
    # Compound pendulum; K(m) of SciPy takes m = k^2.
    period = 4 * math.sqrt((J + m * arm**2) / (m * G * arm)) * ellipk(math.sin(amplitude / 2) ** 2)
    done = simulated(
        tmp_path,
        f"""
        [simulation]
        end = {period}
        step = {period / 2000}
        rho = 1.0
        [gravity]
        acceleration = [0, 0, -{G}]
        [[rigid_body]]
        name = "rod"
        mass = {m}
        inertia = [{J}, {J}, 0.01]
        position = [{-arm * math.sin(amplitude)}, 0, {-arm * math.cos(amplitude)}]
        rotation = {{ axis = [0, 1, 0], degrees = {degrees} }}
        markers = {{ pin = [0, 0, {arm}] }}
        [[joint]]
        kind = "revolute"
        between = ["ground", "rod:pin"]
        axis = [0, 1, 0]
        name = "hinge"
        """,
    )
    place = done.bodies["rod"].position
    assert place is not None
    assert np.abs(place[-1] - place[0]).max() < 2e-5 * arm
    half = len(place) // 2
    assert place[half, 0] == pytest.approx(-place[0, 0], abs=2e-5 * arm)
    # At the lowest place the hinge carries weight and m v^2 / arm, by energy.
    lowest = np.argmin(place[:, 2])
    pull = m * G + m * arm * 2 * m * G * arm * (1 - math.cos(amplitude)) / (J + m * arm**2)
    assert np.linalg.norm(done.joints["hinge"].reaction[lowest, :3]) == pytest.approx(pull, rel=1e-4)
    assert np.ptp(done.energy.kinetic + done.energy.potential) < 1e-4 * done.energy.kinetic.max()


def test_a_symmetric_top_precesses_while_it_falls(tmp_path: Path) -> None:
    across, along, spin, tilt = 0.3, 0.1, 20.0, 2.0
    done = simulated(
        tmp_path,
        f"""
        simulation = {{ end = 0.5, step = 2.5e-4 }}
        gravity = {{ acceleration = [0, 0, -{G}] }}
        [[rigid_body]]
        name = "top"
        mass = 3.0
        inertia = [{across}, {across}, {along}]
        velocity = [1, 0, 2]
        angular_velocity = [{tilt}, 0, {spin}]
        markers = {{ center = [0, 0, 0] }}
        """,
    )
    t = done.time
    fall = np.stack([t, 0 * t, 2 * t - G * t**2 / 2], axis=1)
    assert np.abs(done.bodies["top"].markers["center"].position - fall).max() < 1e-9
    # Euler's equations of a symmetric top: the tilt turns about the axis with (along - across) / across * spin.
    rate = (along - across) / across * spin
    w = done.bodies["top"].speeds[:, 3:6]
    assert np.abs(w - np.stack([tilt * np.cos(rate * t), tilt * np.sin(rate * t), spin + 0 * t], axis=1)).max() < 2e-5


def test_a_cantilever_bends_as_its_full_model(strip: Path, small_meshes: Path) -> None:
    done = simulated(
        strip,
        """
        simulation = { end = 0.01, step = 1e-3 }
        equilibrium = {}
        body = [{ name = "strip", file = "strip.h5" }]
        joint = [{ kind = "fixed", between = ["ground", "strip:ROOT"] }]
        load = [{ marker = "strip:TIP", force = [0, 0, -0.01] }]
        """,
    )
    mesh = morembs.read_mesh(small_meshes / "beam.msh")
    model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=2e9, poisson=0.3, density=1200.0)])
    ends = [
        morembs.make_interface(model, name=name, nodes=morembs.select_nodes(model, f"set:{name}"), coupling="rigid")
        for name in ("ROOT", "TIP")
    ]
    with morembs.Problem(model, ends) as problem:
        K, B = sp.csc_array(problem.K), np.asarray(sp.csc_array(problem.B).todense())
    root, down = B[:, :6], -0.01 * B[:, 8]
    saddle = sp.block_array([[K, sp.csc_array(root)], [sp.csc_array(root.T), None]]).tocsc()
    whole = spl.spsolve(saddle, np.concatenate((down, np.zeros(6))))[: len(K.indptr) - 1]
    tip = done.bodies["strip"].markers["TIP"].position
    assert tip[-1, 2] - ends[1].point[2] == pytest.approx(B[:, 8] @ whole, rel=1e-6)
    # Euler and Bernoulli leave out shear.
    assert B[:, 8] @ whole == pytest.approx(-0.01 * 0.5**3 / (3 * 2e9 * 0.05 * 0.03**3 / 12), rel=0.05)
    # It stays where it is.
    assert np.ptp(tip, axis=0).max() < 1e-6 * abs(B[:, 8] @ whole)
    assert done.joints["joint_1"].reaction[-1, 2] == pytest.approx(0.01, rel=1e-6)


def test_it_is_what_calls_of_the_simulator_give(strip: Path) -> None:
    """Placed by the origin of its model, as the frame of the body is by its own."""
    done = simulated(strip, SWING)
    frame = read_body(strip / "strip.h5").bodies["strip"].floating
    R = rotation((0, 1, 0), np.radians(20.0))
    system = System(gravity=(0, 0, -G))
    body = system.add(FlexibleBody(frame, position=[0.1, 0.2, 0.3] + R @ frame.origin, rotation=R))
    root, tip = body.marker("ROOT"), body.marker("TIP")
    hinge = system.add(RevoluteJoint(ground.marker_at(root.place(body.start()[0]).position), root, axis=(0, 1, 0)))
    push = np.array([0.0, 1.0, -2.0])
    system.add(PointLoad(tip, force=lambda t: (0.5 + np.sin(2 * np.pi * 30 * t + np.pi / 6)) * push))
    want = simulate_in_python(system, end=0.05, step=1e-3)
    told = done.bodies["strip"]
    for got, expected in (
        (told.markers["TIP"].position, want.position(tip)),
        (told.markers["TIP"].axes, want.axes(tip)),
        (told.markers["TIP"].velocity, want.velocity(tip)),
        (told.markers["TIP"].angular_velocity, want.angular_velocity(tip)),
        (told.coordinates, want.elastic(body)),
        (done.joints["hinge"].reaction, want.reaction(hinge)),
        (done.energy.work, want.energy().work),
    ):
        assert np.abs(got - expected).max() < 1e-10 * np.abs(expected).max()


def test_a_node_of_the_file_is_a_marker(strip: Path) -> None:
    """A node of the rigid end moves as the frame of that end does, to first order."""
    stored = read_body(strip / "strip.h5")
    row = stored.interfaces["TIP"].nodes[0]
    label, arm = stored.node_ids[row], stored.coordinates[row] - stored.interfaces["TIP"].point
    markers = simulated(strip, SWING, f"body.strip.nodes={{ corner = {label} }}").bodies["strip"].markers
    tip = markers["TIP"].position + markers["TIP"].axes @ arm
    bent = np.abs(markers["TIP"].axes[:, 0, 2] - markers["ROOT"].axes[:, 0, 2]).max()
    assert np.abs(markers["corner"].position - tip).max() < 2 * bent**2 * np.linalg.norm(arm) + 1e-9
    with refusal("unknown", "nodes", "99999"):
        simulated(strip, SWING, "body.strip.nodes={ corner = 99999 }")


def test_every_other_step_is_kept_and_the_end(strip: Path) -> None:
    whole, some = (simulated(strip, SWING, f"output.every={n}", "simulation.end=0.021") for n in (1, 4))
    rows = [*range(0, 21, 4), 21]
    assert np.array_equal(some.time, whole.time[rows])
    for name in ("work", "kinetic"):
        assert np.array_equal(getattr(some.energy, name), getattr(whole.energy, name)[rows])
    assert np.array_equal(some.joints["hinge"].reaction, whole.joints["hinge"].reaction[rows])


def test_loads_and_motions_follow_their_tables(tmp_path: Path) -> None:
    t = np.linspace(0, 0.1, 201)
    for name, value in (("load", "factor"), ("turn", "value")):
        rows = [f"{a},{b}" for a, b in zip(t, 50 * t**2, strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join([f"t,{value}", *rows]))
    (tmp_path / "all.csv").write_text("t,fx,mz\n0,1,0\n0.1,1,0.2\n")
    body = "{{ name = '{}', mass = 2.0, inertia = [1, 1, 0.5], markers = {{ c = [0, 0, 0] }} }}"
    done = simulated(
        tmp_path,
        f"""
        simulation = {{ end = 0.1, step = 5e-4 }}
        rigid_body = [{body.format("pushed")}, {body.format("driven")}, {body.format("both")}]
        load = [
            {{ marker = "pushed:c", force = [4, 0, 0], law = {{ kind = "table", file = "load.csv" }} }},
            {{ marker = "both:c", law = {{ kind = "table", file = "all.csv" }} }},
        ]
        joint = [
            {{ kind = "revolute", between = ["ground", "driven:c"] }},
            {{ kind = "angle", between = ["ground", "driven:c"], motion = {{ kind = "table", file = "turn.csv" }} }},
        ]
        """,
    )
    at = {name: body.markers["c"] for name, body in done.bodies.items()}
    # 4 N times 50 t^2 on 2 kg; the spline through a parabola is the parabola; constant force, moment that grows.
    assert at["pushed"].position[:, 0] == pytest.approx(100 * done.time**4 / 12, abs=1e-7)
    assert at["driven"].angular_velocity[:, 2] == pytest.approx(100 * done.time, abs=1e-9)
    assert at["both"].position[:, 0] == pytest.approx(done.time**2 / 4, abs=1e-7)
    assert at["both"].angular_velocity[:, 2] == pytest.approx(2 * done.time**2, abs=1e-6)


def test_a_moving_mesh_has_the_markers_where_the_run_has_them(strip: Path) -> None:
    seen = 'observe = [{ body = "strip", path = "strip.vtkhdf" }]'
    done = simulated(strip, f"{SWING}{seen}", "simulation.end=0.01")
    mesh = read_body(strip / "strip.h5")
    with h5py.File(strip / "strip.vtkhdf") as file:
        group = file["VTKHDF"]
        steps, nodes = len(group["Steps/Values"]), len(group["Points"])
        moved = group["Points"][()] + group["PointData/motion"][()].reshape(steps, nodes, 3)
        assert np.nanmax(group["PointData/von_mises"][()]) > 1e3
    assert steps == len(done.time)
    tip = mesh.interfaces["TIP"].nodes
    assert np.abs(moved[:, tip].mean(axis=1) - done.bodies["strip"].markers["TIP"].position).max() < 1e-5


WRONG = {
    "an unknown key": ("simulation.stop=2", "unknown key 'stop'; did you mean 'step'?"),
    "a missing interface": ('joint.hinge.between=["ground", "strip:TOP"]', "no interface 'TOP'; it has ROOT, TIP"),
    "a missing body": ('joint.hinge.between=["ground", "stirp:TIP"]', "did you mean 'strip'?"),
    "an end before the begin": ("simulation.end=-1", "expected an end after it"),
    "a step beyond the end": ("simulation.step=1", "expected a shorter step"),
    "a marker that no file can name": (
        'body.strip.nodes={ "." = 1 }',
        "nodes: the name '.' was given; expected a name",
    ),
    "steps without end": ("simulation.end=1e300", "expected 1,000,000,000 steps at most"),
    "steps of nothing": ("simulation.step=1e-320", "expected 1,000,000,000 steps at most"),
    "no file": ("body.strip.file=other.h5", "other.h5 was given as a body file; there is no such file"),
    "a file of another kind": ("body.strip.file=strip.toml", "[[body]] 'strip'"),
    "another frame": ("body.strip.frame=chord:ROOT", "[[body]] 'strip'"),
    "an axis of no direction": ("joint.hinge.axis=[0, 0, 0]", "[[joint]] 'hinge'"),
    "its own body file": ("output.path=strip.h5", "would overwrite [[body]] 'strip' file"),
    "the ground twice": ('joint.hinge.between=["ground", "ground"]', "names the ground twice"),
    "a direct interface": (
        'body.strip.file="line.h5"',
        'joint.hinge.between=["ground","strip:LINE"]',
        "'direct' and no frame",
    ),
    "a motion without a driven joint": ('joint.hinge.motion={kind="steady",rate=1}', '"angle" or "position"'),
    "no law": ('joint.hinge.kind="angle"', "without motion"),
    "a key of another law": (
        'joint.hinge.kind="angle"',
        'joint.hinge.motion={kind="steady",rate=1,change=1}',
        "change was given",
    ),
    "a fast load": ("load.law.frequency_hz=600", "600 Hz"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_told_before_a_step(strip: Path, case: str) -> None:
    *changes, expected = WRONG[case]
    with pytest.raises(InputError) as caught:
        simulated(strip, SWING, *changes)
    assert expected in str(caught.value)


def test_the_command_says_what_it_did(strip: Path, tmp_path: Path) -> None:
    """Result, page and JSON; check and info; the body file is named relative to the system, results are not."""
    (strip / "swing.toml").write_text(SWING)
    out, page = tmp_path / "swing.h5", tmp_path / "swing.html"
    done = command("simulate", strip / "swing.toml", "-o", out, "--report", page, "--json", folder=tmp_path)
    assert done.code == 0, done.errors
    (told,) = json.loads(done.output)
    recording = read_recording(out)
    reaction = np.linalg.norm(recording.joints["hinge"].reaction[:, :3], axis=1)
    assert told["largest_reactions"]["hinge"]["force"] == pytest.approx(reaction.max())
    assert told["times"] == 51 and told["written"] == [str(out), str(page)]
    assert told["bodies"]["strip"]["kind"] == "elastic"
    text = page.read_text()
    # Two markers, elastic coordinates, reactions, energy.
    assert text.count("data:image/png") == 5 and "largest reactions" in text and "strip.h5" in text
    shown = command("info", out, folder=tmp_path)
    assert shown.code == 0 and "hinge" in shown.output and "0 to 0.05 s, 51 times" in shown.output
    checked = command("check", strip / "swing.toml", "--set", "output.path=swing.h5", "--json", folder=tmp_path)
    (forecast,) = json.loads(checked.output)
    assert (forecast["constraints"], forecast["steps"]) == (5, 50)
    assert forecast["coordinates"] == recording.bodies["strip"].speeds.shape[1]
    assert forecast["degrees_of_freedom"] == forecast["coordinates"] - 5
    states = 8 * (recording.time.size * (forecast["coordinates"] + 12))
    assert states < forecast["result_bytes"] < 1.3 * out.stat().st_size
    assert recording.provenance["inputs"]["file"][-1].endswith(b"strip.h5")


def test_the_schema_of_systems_knows_their_keys(strip: Path) -> None:
    done = command("schema", "--system", folder=strip)
    schema = json.loads(done.output)
    assert done.code == 0 and set(schema["required"]) == {"simulation", "output"}
    assert schema["$defs"]["JointTable"]["properties"]["kind"]["enum"][:2] == ["fixed", "revolute"]


REFUSED = {
    "an unknown table": ("simulate", f"{SWING}\nbdoy = []", "did you mean 'body'?"),
    "a joint twice": (
        "simulate",
        SWING.replace("joint = [", 'joint = [{ kind = "fixed", between = ["ground", "strip:ROOT"] }, '),
        "joint equations are redundant: FixedJoint 'joint_1'",
    ),
    "an open joint": (
        "simulate",
        SWING.replace('["ground", "strip:ROOT"]', '["ground:wall", "strip:ROOT"]') + 'marker = [{ name = "wall" }]',
        "joints are open at t = 0 s: RevoluteJoint 'hinge'",
    ),
    "a job": ("simulate", "model = { mesh = 'bar.msh' }", "a job was given, expected a system of bodies"),
    "a system for reduce": ("reduce", SWING, "a system of bodies was given, expected a job: morembs simulate"),
    "no TOML": ("simulate", "[simulation]\nend = = 1", "is not valid TOML"),
    "a deflection beyond the limit": (
        "simulate",
        SWING.replace("step = 1e-3", "step = 1e-3, max_deflection = 1e-4"),
        "body 'strip' deflects by",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_run_ends_with_two_and_keeps_the_old_result(strip: Path, case: str) -> None:
    verb, text, expected = REFUSED[case]
    (strip / "bad.toml").write_text(f'{text}\noutput = {{ path = "old.h5" }}\n')
    (strip / "old.h5").write_bytes(b"an older result")
    done = command(verb, "bad.toml", folder=strip)
    assert done.code == 2 and expected in done.errors and "Traceback" not in done.errors
    assert done.errors.count("error:") == 1
    assert (strip / "old.h5").read_bytes() == b"an older result"
    assert verb == "reduce" or command("check", "bad.toml", folder=strip).code == (0 if "deflection" in case else 2)


def test_a_run_that_cannot_go_on_says_when_and_which(strip: Path) -> None:
    with refusal("result", "", "0.0", "strip", by=SolverError):
        simulated(strip, SWING, "simulation.max_deflection=1e-4")
    with refusal("result", "", "0.00", "strip", by=SolverError):
        simulated(strip, SWING, f"body.strip.elastic={[1e-1] * 10}", "simulation.max_deflection=none")


def test_what_a_body_has_is_taken(strip: Path) -> None:
    """Stiffening, another frame, elastic coordinates at the start: as the simulator has them."""
    brief = "simulation.step=1e-4", "simulation.end=0.01"
    plain = simulated(strip, SWING, *brief).bodies["strip"].markers["TIP"].position
    stored = read_body(strip / "strip.h5").bodies["strip"].floating
    assert stored is not None
    for change, body in {
        "body.strip.stiffening=true": FlexibleBody(stored, stiffening=True),
        "body.strip.frame=mean-axes": FlexibleBody(stored.in_frame("mean-axes")),
        f"body.strip.elastic={[1e-6] * stored.count}": FlexibleBody(stored, elastic=[1e-6] * stored.count),
    }.items():
        text = SWING.replace(f", {PLACE}", "")
        moved = simulated(strip, text, change, *brief).bodies["strip"].markers["TIP"].position
        origin = body.frame.origin
        system = System(gravity=(0, 0, -G))
        made = system.add(
            FlexibleBody(body.frame, position=origin, elastic=body.start()[0][12:], stiffening="stiffening" in change)
        )
        root = made.marker("ROOT")
        system.add(RevoluteJoint(ground.marker_at(root.place(made.start()[0]).position), root, axis=(0, 1, 0)))
        system.add(
            PointLoad(
                made.marker("TIP"),
                force=lambda t: (0.5 + np.sin(2 * np.pi * 30 * t + np.pi / 6)) * np.array([0, 1, -2]),
            )
        )
        want = simulate_in_python(system, end=0.01, step=1e-4).position(made.marker("TIP"))
        assert np.abs(moved - want).max() < 1e-10
        assert np.abs(moved - plain).max() > 1e-6
