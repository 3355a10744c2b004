"""FMUs of floating-frame bodies: equations in CasADi and motions in FMPy, beside the reference simulator."""

import ctypes

import numpy as np
import pytest
import scipy.integrate

from morembs import elastic_body, make_part, read_body, write_body
from morembs.body.vtkhdf_series import stored_recovery
from morembs.dynamics.multibody import FlexibleBody, PointLoad, SpringDamper, System, ground, simulate
from morembs.dynamics.multibody.rotations import rotation
from morembs.exporters import export_body
from morembs.fem.interface import make_interface
from morembs.fem.stress_operator import von_mises
from morembs.problem import Problem
from morembs.reducers import CraigBampton, Modal
from tests.support.fmus import HEIGHT, LENGTH, WIDTH, InCasadi, by_axes, exported, needs_compiler, run, strip
from tests.support.meshes import box, steel, where

pytestmark = needs_compiler
NODE = 8  # of the strip, away from its ends
SPIN, SLOW = (5.0, -10.0, 20.0), (0.5, -1.0, 2.0)  # rad/s
TURN = rotation((1.0, 2.0, -0.5), 1.1)
# (w, x, y, z) of TURN, from its axis and angle.
QUATERNION = [np.cos(0.55), *(np.sin(0.55) * np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5]))]


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy", reason="FMPy is not here: pip install fmpy")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("floating"), CraigBampton(modes=3))


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """A strip with two slow bending modes, which the reference simulator follows with moderate steps."""
    return strip(tmp_path_factory.mktemp("soft"), Modal(modes=2), young=2e8)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_floating_body_accelerates_as_in_the_simulator(source, fmi):
    """Far from rest: turning, deflected, vibrating, under loads and gravity of all directions."""
    stored = read_body(source)
    frame, rng = stored.bodies["strip"].floating, np.random.default_rng(3)
    n = frame.count
    system = InCasadi(exported(source, f"floating_{fmi[0]}", fmi=fmi, stress=[NODE]))
    place, v, w, g = rng.standard_normal((4, 3)) * [[1.0], [2.0], [30.0], [10.0]]
    q, rate, loads = rng.standard_normal(n) * 1e-3, rng.standard_normal(n), rng.standard_normal((2, 6)) * 50
    body = FlexibleBody(
        frame, position=place, rotation=TURN, velocity=v, angular_velocity=w, elastic=q, elastic_rate=rate
    )
    x, speed = body.start()
    M, force = body.dynamics(0.0, x, speed, g)
    at = [body.marker(name).place(x) for name in ("left-end", "tip")]
    expected = np.linalg.solve(M, sum(place.jacobian.T @ load for place, load in zip(at, loads, strict=True)) - force)
    # Quaternions of any length mean the same.
    names = (*by_axes("position"), *by_axes("quaternion", axes="wxyz"), *by_axes("velocity", "angular_velocity"))
    states = dict(zip(names, [*place, *(2 * q for q in QUATERNION), *v, *w], strict=True))
    states |= {f"q[{k + 1}]": q[k] for k in range(n)} | {f"q_rate[{k + 1}]": rate[k] for k in range(n)}
    names = by_axes("gravity", "left_end.force", "left_end.moment", "tip.force", "tip.moment")
    rates, outputs = system(states, dict(zip(names, [*g, *loads.ravel()], strict=True)))
    groups = by_axes("velocity"), by_axes("angular_velocity"), [f"q_rate[{k + 1}]" for k in range(n)]
    for part, group in zip(np.split(expected, [3, 6]), groups, strict=True):
        assert [rates[name] for name in group] == pytest.approx(part, abs=1e-10 * np.abs(part).max())
    assert [rates[name] for name in by_axes("position")] == pytest.approx(v)
    for name, marker in zip(("left_end", "tip"), at, strict=True):
        assert [outputs[f"{name}.position.{a}"] for a in "xyz"] == pytest.approx(marker.position, abs=1e-13)
        twist = [outputs[variable] for variable in by_axes(f"{name}.velocity", f"{name}.angular_velocity")]
        assert twist == pytest.approx(marker.jacobian @ speed, abs=1e-12 * np.abs(marker.jacobian @ speed).max())
        turn = np.array([outputs[f"{name}.quaternion.{a}"] for a in "wxyz"])
        # R e of a unit quaternion, by e + 2 s x (s x e + w e).
        for e, column in zip(np.eye(3), marker.axes.T, strict=True):
            assert e + 2 * np.cross(turn[1:], np.cross(turn[1:], e) + turn[0] * e) == pytest.approx(column, abs=1e-13)
    recovery = stored_recovery(source, "strip")
    in_body = (loads.reshape(4, 3) @ TURN).reshape(1, 12)
    tensor = recovery.at((frame.elastic @ q)[None], in_body)[0, np.flatnonzero(recovery.points == NODE)[0]]
    stresses = [outputs[f"stress.node_{NODE}.{part}"] for part in ("xx", "yy", "zz", "xy", "yz", "zx")]
    assert stresses == pytest.approx(tensor, rel=1e-9, abs=1e-9 * np.abs(tensor).max())
    assert outputs[f"stress.node_{NODE}.von_mises"] == pytest.approx(float(von_mises(tensor)), rel=1e-9)


def test_damping_of_a_floating_body_is_that_of_its_modes(source):
    """The rate of one mode changes by 2 zeta omega of its rate in mean axes, where modes do not couple."""
    system = InCasadi(export_body(source, "fmu", path=source.with_name("mean.fmu"), frame="mean-axes").paths[0])
    states = {"quaternion.w": 1.0, "q_rate[2]": 1e-3}
    (undamped, _), (damped, _) = (system(states, {}, {"damping_ratio": ratio}) for ratio in (0.0, 0.1))
    omega = 2 * np.pi * read_body(source).bodies["strip"].frequencies_hz[7]
    assert damped["q_rate[2]"] - undamped["q_rate[2]"] == pytest.approx(-2 * 0.1 * omega * 1e-3, rel=1e-9)
    assert abs(damped["q_rate[3]"] - undamped["q_rate[3]"]) < 1e-6 * omega * 1e-3


def reference(frame, end, steps, load, spin):
    """Path of the tip in the reference simulator, from three step sizes to the limit of no step (Richardson)."""

    def path(count):
        system = System(gravity=(0, 0, -9.81))
        body = system.add(FlexibleBody(frame, position=frame.origin, angular_velocity=spin))
        system.add(load(body))
        result = simulate(system, end=end, step=end / count, rho=1.0, tolerance=1e-13)
        return result.position(body.marker("tip"))

    a, b, c = (path(steps * 2**k)[:: 2**k] for k in range(3))
    return (16 * (4 * c - b) / 3 - (4 * b - a) / 3) / 15


def test_a_body_tumbles_as_in_the_simulator(fmpy, soft):
    frame, end, load = read_body(soft).bodies["strip"].floating, 0.02, [0.3, -0.2, 0.4, 0.01, 0.02, -0.01]
    expected = reference(
        frame, end, 40, lambda body: PointLoad(body.marker("tip"), force=load[:3], moment=load[3:]), SPIN
    )
    names = (*by_axes("tip.force", "tip.moment", "angular_velocity"), "gravity.z")
    values = dict(zip(names, [*load, *SPIN, -9.81], strict=True))
    fmu, place = exported(soft, "tumbling"), by_axes("tip.position")
    fine = run(fmpy, fmu, end, end / 40, place, start_values={**values, "tolerance": 1e-9})
    assert np.abs(fine - expected).max() < 1e-8 * LENGTH
    # In one step of that length: what the tolerance allows is kept, and taken.
    for tolerance, least, most in ((1e-3, 1e-5, 1e-3), (1e-10, 0.0, 1e-8)):
        once = run(fmpy, fmu, end, end, place, start_values={**values, "tolerance": tolerance})[-1]
        assert least < np.abs(once - expected[-1]).max() / LENGTH < most


def test_a_body_swings_on_a_spring_as_in_the_simulator(fmpy, soft):
    """Model exchange, with the spring of the hinge in another program that sees what comes out."""
    frame, end, (k, d) = read_body(soft).bodies["strip"].floating, 0.1, (500.0, 0.2)
    hinge = np.array([0.0, WIDTH / 2, HEIGHT / 2])
    expected = reference(
        frame,
        end,
        100,
        lambda body: SpringDamper(ground.marker_at(hinge), body.marker("left-end"), stiffness=k, damping=d, length=0.0),
        SLOW,
    )
    fmu = exported(soft, "swinging")
    description, folder = fmpy.read_model_description(str(fmu)), fmpy.extract(str(fmu))
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    body = pytest.importorskip("fmpy.fmi2").FMU2Model(
        guid=description.guid, modelIdentifier="swinging", unzipDirectory=folder, instanceName="body"
    )
    body.instantiate()
    body.setupExperiment()
    body.enterInitializationMode()
    body.setReal([at[name] for name in (*by_axes("angular_velocity"), "gravity.z")], [*SLOW, -9.81])
    body.exitInitializationMode()
    body.enterContinuousTimeMode()
    n = description.numberOfContinuousStates
    x, rate = (ctypes.c_double * n)(), (ctypes.c_double * n)()
    seen, force, tip = (
        [at[name] for name in by_axes(*names)]
        for names in (("left_end.position", "left_end.velocity"), ("left_end.force",), ("tip.position",))
    )

    def rates(_, state):
        x[:] = state.tolist()
        body.setContinuousStates(x, n)
        motion = np.array(body.getReal(seen))
        body.setReal(force, k * (hinge - motion[:3]) - d * motion[3:])
        body.getDerivatives(rate, n)
        return np.array(rate)

    body.getContinuousStates(x, n)
    way = scipy.integrate.solve_ivp(
        rates, (0, end), np.array(x), "DOP853", np.linspace(0, end, 101), rtol=1e-11, atol=1e-13
    )
    path = []
    for state in way.y.T:
        x[:] = state.tolist()
        body.setContinuousStates(x, n)
        path.append(body.getReal(tip))
    body.terminate()
    body.freeInstance()
    assert np.ptp(expected, axis=0).max() > 0.1 * LENGTH
    assert np.abs(np.array(path) - expected).max() < 1e-8 * LENGTH


@needs_compiler
def test_interfaces_that_do_not_stand_by_the_alphabet_keep_their_places_and_loads(tmp_path):
    """Groups of a file are read by the alphabet: "tip" came out as "base", and loads went to the other end."""
    model = steel(box("hex8", (4, 1, 1), (LENGTH, WIDTH, HEIGHT)))
    ends = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("tip", LENGTH), ("base", 0.0))]
    with Problem(model, ends) as problem:
        body = elastic_body(problem, CraigBampton(modes=4).reduce(problem, "bar"), make_part(problem))
    path = write_body(tmp_path / "bar.h5", [body])
    fmu = InCasadi(exported(path, "bar"))
    still = {"quaternion.w": 1.0}
    rates, outputs = fmu(still, {"tip.force.y": 1.0})
    assert outputs["tip.position.x"] == pytest.approx(LENGTH) and outputs["base.position.x"] == pytest.approx(0.0)
    # A force at the tip turns the bar about z, to the left.
    assert rates["angular_velocity.z"] > 1e-3
