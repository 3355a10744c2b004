"""Members as FMUs and C sources: equations in CasADi, motions in FMPy and in C, beside ``ParameterisedBody``."""

import ctypes
import subprocess

import numpy as np
import pytest
import scipy.integrate

from morembs import read_body
from morembs.dynamics.gmp import ParameterisedBody, PlaneJoint, ReducedMember
from morembs.dynamics.gmp.export import export_member
from morembs.dynamics.gmp.stored import write_members
from morembs.dynamics.multibody import System, ground, simulate
from morembs.dynamics.nonlinear import PlanarBeam, Section
from tests.exporters.test_linear_inputs import Slave, follow, orders
from tests.support.fmus import InCasadi, needs_compiler, run
from tests.support.processes import morembs
from tests.support.refusals import refusal

pytestmark = needs_compiler
LENGTH, PIN = 0.304, ["start.x", "start.y"]
COORDINATES = [f"{frame}.{part}" for frame in ("start", "end") for part in ("x", "y", "angle")]
KINDS = {
    "position": ("position", "angle"),
    "velocity": ("velocity", "angular_velocity"),
    "acceleration": ("acceleration", "angular_acceleration"),
    "load": ("force", "moment"),
    "reaction": ("reaction_force", "reaction_moment"),
}


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy", reason="FMPy is not here: pip install fmpy")


@pytest.fixture(scope="module")
def member():
    beam = PlanarBeam.straight(LENGTH, 12, Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770))
    return ReducedMember(beam, modes=3, formulation="membrane", reach=0.85, points_per_angle=9)


@pytest.fixture(scope="module")
def source(member, tmp_path_factory):
    return write_members(tmp_path_factory.mktemp("members") / "rod.h5", {"rod": member.data})


def named(kind, number):
    """Of a coordinate of the frames the name of its position, rate ..."""
    frame, part = COORDINATES[number].split(".")
    line, turn = KINDS[kind]
    return f"{frame}.{turn}.z" if part == "angle" else f"{frame}.{line}.{part}"


def exported(source, name, to="fmu", **options):
    return export_member(source, to, path=source.with_name(f"{name}.{to}"), options=options).paths[0]


@pytest.mark.parametrize(
    ("name", "held", "damping"),
    [
        ("both", ["start", "end"], 0.0),
        ("pinned", PIN, 2e-3),
        ("free", [], 0.0),
        ("slid", ["end.angle", "start.y"], 0.0),
    ],
)
def test_accelerations_and_reactions_are_those_of_the_simulator(member, source, name, held, damping):
    """Far from rest, turned by more than a full turn, bent, vibrating, under loads and gravity."""
    system, rng = InCasadi(exported(source, name, held=held)), np.random.default_rng(3)
    turn, c, s = 7.0, np.cos(7.0), np.sin(7.0)
    q = np.array([0.1, 0.2, turn + 0.3, 0.1 + 0.3 * c, 0.2 + 0.3 * s, turn - 0.4, *(rng.standard_normal(3) * 1e-4)])
    v = np.concatenate((rng.standard_normal(6) * 3, rng.standard_normal(3) * 1e-2))
    gravity = np.array([1.0, -9.81, 0.0])
    M, force = ParameterisedBody(member).dynamics(0.0, q, v, gravity)
    force = force + damping * member.at(q).strains() @ v
    fixed = [k for k, known in enumerate(COORDINATES) if known in held or known.partition(".")[0] in held]
    free, inner = [k for k in range(9) if k not in fixed], [k for k in range(6) if k not in fixed]
    load, a = np.zeros(9), np.zeros(9)
    load[inner], a[fixed] = rng.standard_normal(len(inner)) * 0.1, rng.standard_normal(len(fixed)) * 10
    known = (load - force)[free] - M[np.ix_(free, fixed)] @ a[fixed]
    a[free] = np.linalg.solve(M[np.ix_(free, free)], known)
    inputs = {"gravity.x": gravity[0], "gravity.y": gravity[1]} | {named("load", k): load[k] for k in inner}
    for kind, values in (("position", q), ("velocity", v), ("acceleration", a)):
        inputs |= {named(kind, k): values[k] for k in fixed}
    states = {f"state.{named('position', k)}": q[k] for k in inner} | {f"q[{k + 1}]": q[6 + k] for k in range(3)}
    states |= {f"state.{named('velocity', k)}": v[k] for k in inner} | {f"q_rate[{k + 1}]": v[6 + k] for k in range(3)}
    rates, outputs = system(states, inputs, {"damping": damping})
    found = [rates[f"state.{named('velocity', k)}"] for k in inner] + [rates[f"q_rate[{k + 1}]"] for k in range(3)]
    assert found == pytest.approx(a[free], abs=1e-11 * np.abs(a[free]).max())
    reactions = (M @ a + force)[fixed]
    assert [outputs[named("reaction", k)] for k in fixed] == pytest.approx(
        reactions, abs=1e-11 * np.abs(reactions).max(initial=1.0)
    )
    for kind, values in (("position", q), ("velocity", v), ("acceleration", a)):
        assert [outputs[named(kind, k)] for k in inner] == pytest.approx(values[inner], rel=1e-11)


def pendulum(member, end, steps):
    """Path of the tip in the reference simulator, from three step sizes to the limit of no step (Richardson)."""

    def path(count):
        system = System(gravity=(0, -9.81, 0))
        body = system.add(ParameterisedBody(member))
        system.add(PlaneJoint(ground.marker_at(), body.marker("start")))
        result = simulate(system, end=end, step=end / count, rho=1.0, tolerance=1e-13)
        return result.position(body.marker("end"))[:, :2]

    a, b, c = (path(steps * 2**k)[:: 2**k] for k in range(3))
    return (16 * (4 * c - b) / 3 - (4 * b - a) / 3) / 15


@pytest.fixture(scope="module")
def expected(member):
    return pendulum(member, 0.05, 200)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_pendulum_swings_as_in_the_simulator(fmpy, source, expected, fmi):
    fmu = exported(source, f"pendulum_{fmi[0]}", held=PIN, fmi=fmi)
    assert pytest.importorskip("fmpy.validation").validate_fmu(str(fmu)) == []
    start, place = {"gravity.y": -9.81, "tolerance": 1e-11}, ["end.position.x", "end.position.y"]
    path = run(fmpy, fmu, 0.05, 0.05 / 200, place, start_values=start)
    assert np.abs(expected - expected[0]).max() > 0.02 * LENGTH
    assert np.abs(path - expected).max() < 1e-8 * LENGTH


def test_a_pendulum_whose_frames_another_program_moves(fmpy, source, expected):
    """Motion in, force out: the program has the equations of both frames, and the FMU those within."""
    fmu = exported(source, "driven")
    description, folder = fmpy.read_model_description(str(fmu)), fmpy.extract(str(fmu))
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    body = pytest.importorskip("fmpy.fmi2").FMU2Model(
        guid=description.guid, modelIdentifier="driven", unzipDirectory=folder, instanceName="body"
    )
    body.instantiate()
    body.setupExperiment()
    body.enterInitializationMode()
    body.setReal([at["gravity.y"]], [-9.81])
    body.exitInitializationMode()
    body.enterContinuousTimeMode()
    seen = {kind: [at[named(kind, k)] for k in range(6)] for kind in KINDS if kind != "load"}
    free, n = [2, 3, 4, 5], 6
    x, rate = (ctypes.c_double * n)(), (ctypes.c_double * n)()

    def reactions(a):
        body.setReal(seen["acceleration"], a)
        return np.array(body.getReal(seen["reaction"]))[free]

    def rates(_, state):
        # The start stays where it is; both angles and the place of the end are free of loads.
        frames, speeds, x[:] = np.zeros(6), np.zeros(6), state[8:].tolist()
        frames[free], speeds[free] = state[:4], state[4:8]
        body.setContinuousStates(x, n)
        body.setReal([*seen["position"], *seen["velocity"]], [*frames, *speeds])
        without = reactions(np.zeros(6))
        M = np.array([reactions(np.eye(6)[k]) - without for k in free]).T
        a = np.zeros(6)
        a[free] = np.linalg.solve(M, -without)
        reactions(a)
        body.getDerivatives(rate, n)
        return np.array([*speeds[free], *a[free], *rate])

    start = np.zeros(14)
    start[1] = LENGTH
    times = np.linspace(0, 0.05, 201)
    way = scipy.integrate.solve_ivp(rates, (0, 0.05), start, "DOP853", times, rtol=1e-11, atol=1e-13)
    body.terminate()
    body.freeInstance()
    assert np.abs(way.y[1:3].T - expected).max() < 1e-8 * LENGTH


PROGRAM = """
#include <stdio.h>
#include "swing.h"

static swing_body body;

int main(void)
{
    swing_start(&body);
    body.u[SWING_U_GRAVITY_Y] = -9.81;
    for (int k = 0; k < STEPS; k++)
        if (swing_step(&body))
            return 1;
    printf("%.17g %.17g", body.y[SWING_Y_END_POSITION_X], body.y[SWING_Y_END_POSITION_Y]);
    return 0;
}
"""


def test_c_code_of_a_pendulum_converges_to_the_simulator(source, expected):
    """By the midpoint rule of second order; two step sizes give its limit."""
    found = []
    for steps in (400, 800, 1600):
        path = exported(source, "swing", to="c", held=PIN, step=0.05 / steps)
        (path.parent / "main.c").write_text(PROGRAM.replace("STEPS", str(steps)))
        flags = ["-std=c99", "-pedantic", "-O2", "-Wall", "-Wextra", "-Werror"]
        command = ["cc", *flags, "swing.c", "main.c", "-o", "swing", "-lm"]
        subprocess.run(command, cwd=path.parent, check=True, capture_output=True, text=True)
        ran = subprocess.run([path.parent / "swing"], check=True, capture_output=True, text=True)
        found.append(np.array(ran.stdout.split(), dtype=float))
    a, b, c = found
    assert np.abs((16 * (4 * c - b) / 3 - (4 * b - a) / 3) / 15 - expected[-1]).max() < 1e-8 * LENGTH


def test_gravity_that_changes_goes_in_a_line(fmpy, source):
    """Of a pendulum whose frame of reference rises and falls; held gravity is off by the step."""
    fmu = exported(source, "lifted", held=PIN, interpolate_inputs=True)
    place, end = ["end.position.x", "end.position.y"], 0.05

    def moved(count, linear):
        times, slave = np.linspace(0, end, count + 1), Slave(fmpy, fmu)
        slave.set({"tolerance": 1e-11})
        given = {"gravity.y": -9.81 + 30 * np.sin(2 * np.pi * 30 * times)}
        return follow(slave, times, given, place, linear=linear)[-1]

    wanted = moved(640, True)
    held, linear = ([np.abs(moved(count, line) - wanted).max() for count in (20, 40, 80)] for line in (False, True))
    assert orders(linear)[-1] == pytest.approx(2.0, abs=0.2)
    assert linear[-1] < 0.25 * held[-1]


def test_beyond_the_tables_nothing_comes_out(fmpy, source):
    """Neither an output nor a step: tables say nothing there."""
    fmu, seen = exported(source, "beyond"), ["start.reaction_moment.z"]
    assert np.isfinite(run(fmpy, fmu, 1e-4, 1e-4, seen, start_values={"start.angle.z": 0.84})).all()
    with pytest.raises(Exception, match="fmi2"):
        run(fmpy, fmu, 1e-4, 1e-4, seen, start_values={"start.angle.z": 0.86})


def test_the_damping_ratio_is_that_of_the_first_mode(member, source):
    system = InCasadi(exported(source, "damped", damping_ratio=0.05))
    inputs = {"end.position.x": LENGTH}
    omega = float(np.sqrt(member.data.squares[0]))
    factor = {"damping": 2 * 0.05 / omega}
    rates, _ = system({"q_rate[1]": 1e-3}, inputs, factor)
    assert rates["q_rate[1]"] == pytest.approx(-2 * 0.05 * omega * 1e-3, rel=1e-6)
    text = source.with_name("damped").joinpath("modelDescription.xml").read_text()
    assert f'start="{factor["damping"]!r}"' in text


def test_the_command_line_exports_members(source, tmp_path):
    rod = tmp_path / "rod.h5"
    rod.write_bytes(source.read_bytes())
    done = morembs("export", "rod.h5", "--to", "fmu", folder=tmp_path)
    assert done.code == 0 and "rod.fmu" in done.output and "planar member" in done.output
    done = morembs("export", "rod.h5", "--to", "c", "--set", "held=start.x,start.y", folder=tmp_path)
    assert done.code == 0 and (tmp_path / "rod.c").exists() and (tmp_path / "rod.h").exists()


@pytest.mark.parametrize(
    ("to", "options", "words"),
    [
        ("exudyn", {}, ("unsupported", "to", "exudyn", "fmu", "c")),
        ("fmu", {"held": ["start.z"]}, ("unknown", "", "start.z")),
        ("fmu", {"structure": "linear"}, ("unsupported", "structure", "rod")),
        ("fmu", {"stress": [1]}, ("unsupported", "structure")),
        ("c", {"time_step": 1e-4}, ("unsupported", "time_step", "rod")),
        ("c", {"precision": "single"}, ("unsupported", "precision", "double")),
        ("c", {"method": "exponential"}, ("value", "method", "midpoint")),
    ],
)
def test_what_is_no_export_of_a_member_is_named(source, tmp_path, to, options, words):
    with refusal(*words):
        export_member(source, to, path=tmp_path / f"rod.{to}", options=options)
    assert not list(tmp_path.iterdir())


def test_names_of_members(member, source, tmp_path):
    both = write_members(tmp_path / "two.h5", {"a": member.data, "b": member.data})
    with refusal("missing", "", "two.h5", "a,", "b;", "--body"):
        export_member(both, "c")
    with refusal("unknown", "", "c"):
        export_member(both, "c", member="c")
    assert [path.name for path in export_member(both, "c", member="b").paths] == ["two_b.c", "two_b.h"]
    with refusal("output", "out"):
        export_member(both, "fmu", path=both, member="a")


def test_verbs_that_take_no_members_say_what_does(source, tmp_path):
    (tmp_path / "rod.h5").write_bytes(source.read_bytes())
    for words, said in (
        (("modes", "rod.h5"), "a file of planar members was given, expected a job: morembs info rod.h5"),
        (("reduce", "rod.h5"), "a file of planar members was given, expected a job: morembs info rod.h5"),
        (("doctor", "rod.h5"), "rod.h5 is a file of planar members, the result of a reduction and not a model"),
        (("recover", "rod.h5", "a.csv", "-o", "b.vtkhdf"), "morembs info, evaluate and export take members"),
    ):
        refused = morembs(*words, folder=tmp_path)
        assert refused.code == 2 and said in refused.errors, refused.errors
    assert "planar members" in morembs("rod.h5", folder=tmp_path).output


def test_readers_of_bodies_name_members(source):
    with refusal("unsupported", "rod.h5"):
        read_body(source)
