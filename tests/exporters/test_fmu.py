"""FMUs in two importers: FMPy (validator, simulation) and CasADi (rates and outputs of the equations)."""

import ctypes
import zipfile

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg as sl
import scipy.signal

from morembs import read_body
from morembs.body.vtkhdf_series import stored_recovery
from morembs.errors import InputError
from morembs.exporters import export_body
from morembs.model.stress_operator import von_mises
from morembs.multibody import FlexibleBody, PointLoad, SpringDamper, System, ground, simulate
from morembs.multibody.rotations import rotation
from morembs.reducers import CraigBampton, Modal
from tests.support.fmus import HEIGHT, LENGTH, WIDTH, InCasadi, by_axes, exported, needs_compiler, strip

pytestmark = needs_compiler
VERSIONS = ["2.0", "3.0"]
NODE = 8  # of the strip, away from its ends
HELD = {"held": ["left-end"], "stress": [NODE], "damping_ratio": 0.02}
SPIN, SLOW = (5.0, -10.0, 20.0), (0.5, -1.0, 2.0)  # rad/s
TURN = rotation((1.0, 2.0, -0.5), 1.1)
# (w, x, y, z) of TURN, from its axis and angle.
QUATERNION = [np.cos(0.55), *(np.sin(0.55) * np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5]))]


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy", reason="FMPy is not here: pip install fmpy")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("fmu"), CraigBampton(modes=3))


@pytest.fixture(scope="module")
def held(source):
    return exported(source, "held", **HELD)


@pytest.fixture(scope="module")
def soft(tmp_path_factory):
    """A strip with two slow bending modes, which the reference simulator follows with moderate steps."""
    return strip(tmp_path_factory.mktemp("soft"), Modal(modes=2), young=2e8)


def signals(times, inputs):
    """Inputs as FMPy takes them."""
    table = np.zeros(len(times), dtype=[("time", float), *((name, float) for name in inputs)])
    table["time"] = times
    for name, values in inputs.items():
        table[name] = values
    return table


def run(fmpy, fmu, end, step, outputs, **options):
    options.setdefault("fmi_type", "CoSimulation")
    result = fmpy.simulate_fmu(str(fmu), stop_time=end, output_interval=step, output=outputs, **options)
    return np.array([result[name] for name in outputs]).T


def no_gravity(count):
    return {name: np.zeros(count) for name in by_axes("gravity")}


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_validator_has_no_complaint(fmpy, source, fmi):
    validate = pytest.importorskip("fmpy.validation").validate_fmu
    for name, options in (("linear", {"structure": "linear"}), ("held", {"held": ["left-end"]}), ("floating", {})):
        path = exported(source, f"valid_{name}", fmi=fmi, stress=[NODE], **options)
        assert validate(str(path)) == []
        assert fmpy.read_model_description(str(path)).fmiVersion == fmi


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_free_body_moves_as_scipy_has_it(fmpy, source, fmi):
    """All loads random and held over each step, and some modal damping beside that of the body."""
    body = read_body(source).bodies["strip"]
    fmu = exported(source, f"free_{fmi[0]}", fmi=fmi, structure="linear", damping_ratio=0.01)
    values, Y = sl.eigh(body.stiffness_matrix, body.mass_matrix)
    omega = np.where(np.arange(len(values)) < 6, 0.0, np.sqrt(np.abs(values)))
    n, scale = len(omega), np.maximum(omega, 1.0)
    damping = Y.T @ body.damping_matrix @ Y + 2 * 0.01 * np.diag(omega)
    B, C = Y.T @ body.input_matrix, body.output_matrix @ Y
    A = np.block([[np.zeros((n, n)), np.diag(scale)], [-np.diag(omega**2 / scale), -damping]])
    outputs = np.block([[C / scale, 0 * C], [0 * C, C]])
    step, count = 2e-5, 400
    times = np.arange(count + 1) * step
    loads = np.random.default_rng(1).standard_normal((count + 1, 12))
    system = A, np.vstack([0 * B, B]), outputs, np.zeros((24, 12))
    _, expected, _ = scipy.signal.lsim(system, loads, times, interp=False)
    names = by_axes("left_end.force", "left_end.moment", "tip.force", "tip.moment")
    moved = [by_axes(*(f"{end}.{kind}" for end in ("left_end", "tip") for kind in kinds))
             for kinds in (("displacement", "rotation"), ("velocity", "angular_velocity"))]  # fmt: skip
    given = signals(times, dict(zip(names, loads.T, strict=True)) | no_gravity(count + 1))
    found = run(fmpy, fmu, times[-1], step, [*moved[0], *moved[1]], input=given)
    for at in (slice(3 * k, 3 * k + 3) for k in range(8)):
        assert np.abs(found[:, at] - expected[:, at]).max() < 1e-10 * np.abs(expected[:, at]).max()


def test_model_exchange_takes_the_same_way(fmpy, source):
    fmu = exported(source, "exchange", structure="linear", damping_ratio=0.05)
    given = {"tip.force.z": 1.0, "tip.moment.x": 0.2, "gravity.y": -9.81}
    names = by_axes("tip.displacement", "left_end.velocity")
    ends = [run(fmpy, fmu, 2e-3, 1e-4, names, start_values=given, **options)
            for options in ({}, {"fmi_type": "ModelExchange", "relative_tolerance": 1e-10})]  # fmt: skip
    # What the integrator of the importer leaves, at its tolerance, of modes up to 1e5 rad/s.
    assert np.abs(ends[0] - ends[1]).max() < 1e-5 * np.abs(ends[0]).max()


def test_a_held_body_rests_as_a_cantilever_and_its_support_carries_it(fmpy, source, held):
    """After a step of which each is many periods: weight and tip force at rest."""
    body = read_body(source)
    force, g, still = 3.0, 9.81, {"damping_ratio": 0.5, "tip.force.z": 3.0, "gravity.z": -9.81}
    names = by_axes("tip.displacement", "tip.velocity", "left_end.reaction_force", "left_end.reaction_moment")
    values = dict(zip(names, run(fmpy, held, 20.0, 10.0, names, start_values=still)[-1], strict=True))
    stiffness = 2e9 * WIDTH * HEIGHT**3 / 12
    bent = force * LENGTH**3 / (3 * stiffness) - body.mass * g * LENGTH**3 / (8 * stiffness)
    assert values["tip.displacement.z"] == pytest.approx(bent, rel=0.05)
    assert abs(values["tip.velocity.z"]) < 1e-9
    assert values["left_end.reaction_force.z"] == pytest.approx(body.mass * g - force, rel=1e-9)
    # The moment about y of a force along z at the arm x is -x F.
    assert values["left_end.reaction_moment.y"] == pytest.approx(-(body.mass * g * 0.5 - force) * LENGTH, rel=1e-9)


def test_stresses_are_those_of_the_recovery(fmpy, source, held):
    """At rest under a tip load; the recovery takes coordinates and reactions of a solution with multipliers."""
    body, load = read_body(source).bodies["strip"], np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    n, C = len(body.stiffness_matrix), body.output_matrix
    saddle = np.block([[body.stiffness_matrix, -C[:6].T], [C[:6], np.zeros((6, 6))]])
    solution = np.linalg.solve(saddle, np.concatenate([C[6:].T @ load, np.zeros(6)]))
    recovery = stored_recovery(source, "strip")
    tensor = recovery.at(solution[None, :n], np.concatenate([solution[n:], load])[None])[0, recovery.points == NODE][0]
    names = [f"stress.node_{NODE}.{part}" for part in ("xx", "yy", "zz", "xy", "yz", "zx", "von_mises")]
    start = dict(zip(by_axes("tip.force", "tip.moment"), load, strict=True)) | {"damping_ratio": 0.5}
    found = run(fmpy, held, 20.0, 10.0, names, start_values=start)[-1]
    assert found == pytest.approx([*tensor, float(von_mises(tensor))], abs=1e-9 * np.abs(tensor).max())


def test_a_support_moves_the_body_with_it(held):
    """Displaced rigidly nothing is strained; accelerated, the body feels what it feels under the opposite gravity."""
    system, rng = InCasadi(held), np.random.default_rng(2)
    states = {name: rng.standard_normal() * 1e-4 for name in system.x}
    shift, turn = rng.standard_normal((2, 3)) * 1e-3
    moved = dict(zip(by_axes("left_end.displacement", "left_end.rotation"), [*shift, *turn], strict=True))
    rates, outputs = system({}, moved)
    follows = shift + np.cross(turn, [LENGTH, 0.0, 0.0])
    assert [outputs[name] for name in by_axes("tip.displacement")] == pytest.approx(follows, abs=1e-12)
    assert max(abs(rate) for rate in rates.values()) < 1e-6
    assert abs(outputs["left_end.reaction_force.z"]) < 1e-6 and outputs["stress.node_8.von_mises"] < 1.0
    pull = rng.standard_normal(3)
    accelerated = system(states, dict(zip(by_axes("left_end.acceleration"), pull, strict=True)))
    weighed = system(states, dict(zip(by_axes("gravity"), -pull, strict=True)))
    for one, other in zip(accelerated, weighed, strict=True):
        for name, value in one.items():
            assert value == pytest.approx(other[name], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("fmi", VERSIONS)
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
        twist = [outputs[one] for one in by_axes(f"{name}.velocity", f"{name}.angular_velocity")]
        assert twist == pytest.approx(marker.jacobian @ speed, abs=1e-12 * np.abs(marker.jacobian @ speed).max())
        turn = np.array([outputs[f"{name}.quaternion.{a}"] for a in "wxyz"])
        # R e of a unit quaternion, by e + 2 s x (s x e + w e).
        for e, column in zip(np.eye(3), marker.axes.T, strict=True):
            assert e + 2 * np.cross(turn[1:], np.cross(turn[1:], e) + turn[0] * e) == pytest.approx(column, abs=1e-13)
    recovery = stored_recovery(source, "strip")
    in_body = (loads.reshape(4, 3) @ TURN).reshape(1, 12)
    tensor = recovery.at((frame.elastic @ q)[None], in_body)[0, np.flatnonzero(recovery.points == NODE)[0]]
    found = [outputs[f"stress.node_{NODE}.{part}"] for part in ("xx", "yy", "zz", "xy", "yz", "zx")]
    assert found == pytest.approx(tensor, rel=1e-9, abs=1e-9 * np.abs(tensor).max())
    assert outputs[f"stress.node_{NODE}.von_mises"] == pytest.approx(float(von_mises(tensor)), rel=1e-9)


def test_damping_of_a_floating_body_is_that_of_its_modes(source):
    """The rate of one mode changes by 2 zeta omega of its rate in mean axes, where modes do not couple."""
    system = InCasadi(export_body(source, "fmu", path=source.with_name("mean.fmu"), frame="mean-axes").paths[0])
    states = {"quaternion.w": 1.0, "q_rate[2]": 1e-3}
    (one, _), (two, _) = (system(states, {}, {"damping_ratio": ratio}) for ratio in (0.0, 0.1))
    omega = 2 * np.pi * read_body(source).bodies["strip"].frequencies_hz[7]
    assert two["q_rate[2]"] - one["q_rate[2]"] == pytest.approx(-2 * 0.1 * omega * 1e-3, rel=1e-9)
    assert abs(two["q_rate[3]"] - one["q_rate[3]"]) < 1e-6 * omega * 1e-3


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
    expected = reference(frame, end, 100, lambda body: SpringDamper(
        ground.marker_at(hinge), body.marker("left-end"), stiffness=k, damping=d, length=0.0), SLOW)  # fmt: skip
    fmu = exported(soft, "swinging")
    description, folder = fmpy.read_model_description(str(fmu)), fmpy.extract(str(fmu))
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    body = pytest.importorskip("fmpy.fmi2").FMU2Model(
        guid=description.guid, modelIdentifier="swinging", unzipDirectory=folder, instanceName="body")  # fmt: skip
    body.instantiate()
    body.setupExperiment()
    body.enterInitializationMode()
    body.setReal([at[name] for name in (*by_axes("angular_velocity"), "gravity.z")], [*SLOW, -9.81])
    body.exitInitializationMode()
    body.enterContinuousTimeMode()
    n = description.numberOfContinuousStates
    x, rate = (ctypes.c_double * n)(), (ctypes.c_double * n)()
    seen, force, tip = ([at[name] for name in by_axes(*names)] for names in (
        ("left_end.position", "left_end.velocity"), ("left_end.force",), ("tip.position",)))  # fmt: skip

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


@pytest.mark.parametrize("fmi", VERSIONS)
def test_states_are_kept_and_nonsense_is_refused(fmpy, held, source, fmi):
    fmu = held if fmi == "2.0" else exported(source, "held_3", fmi=fmi, held=["left-end"])
    description, folder = fmpy.read_model_description(str(fmu)), fmpy.extract(str(fmu))
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    module = pytest.importorskip(f"fmpy.fmi{fmi[0]}")
    kind = module.FMU2Slave if fmi == "2.0" else module.FMU3Slave
    body = kind(guid=description.guid, modelIdentifier=fmu.stem, unzipDirectory=folder, instanceName="body")
    body.instantiate()
    if fmi == "2.0":
        body.setupExperiment()
    body.enterInitializationMode()
    body.exitInitializationMode()
    read, write = (body.getReal, body.setReal) if fmi == "2.0" else (body.getFloat64, body.setFloat64)
    keep, bring, pack, unpack = (
        (body.getFMUstate, body.setFMUstate, body.serializeFMUstate, body.deSerializeFMUstate) if fmi == "2.0"
        else (body.getFMUState, body.setFMUState, body.serializeFMUState, body.deserializeFMUState)
    )  # fmt: skip
    tip = [at["tip.displacement.z"]]
    write([at["tip.force.z"]], [1.0])
    body.doStep(0.0, 1e-3)
    state = keep()
    packed = pack(state)
    body.doStep(1e-3, 1e-3)
    first = read(tip)
    bring(state)
    body.doStep(1e-3, 1e-3)
    assert read(tip) == first and first[0] != 0
    bring(unpack(packed))
    body.doStep(1e-3, 1e-3)
    assert read(tip) == first
    force = [at["tip.force.z"]]
    for wrong, arguments in ((write, (force, [np.nan])), (write, (tip, [1.0])), (read, ([100_000],)),
                             (body.doStep, (0.0, 0.0)), (body.doStep, (0.0, np.inf))):  # fmt: skip
        with pytest.raises(Exception, match="failed with status 3"):
            wrong(*arguments)
    body.reset()
    assert read(tip) == [0.0]
    body.terminate()
    body.freeInstance()
    other = kind(guid="another", modelIdentifier=fmu.stem, unzipDirectory=folder, instanceName="body")
    with pytest.raises(Exception, match="nstantiat"):
        other.instantiate()


def test_the_same_body_gives_the_same_bytes(source, held):
    before = held.read_bytes()
    assert exported(source, "held", **HELD).read_bytes() == before


def test_names_that_c_does_not_take_are_mapped_and_listed(source):
    done = export_body(source, "fmu", path=source.with_name("2nd part.fmu"), options={"held": ["left-end"]})
    told = " ".join(done.notes)
    assert "'left-end' is left_end" in told and "'2nd part' is n_2nd_part" in told and "linear body" in told
    with zipfile.ZipFile(done.paths[0]) as archive:
        assert {"binaries/linux64/n_2nd_part.so", "sources/n_2nd_part.h"} <= set(archive.namelist())


def test_without_a_compiler_the_sources_are_there(source, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    for fmi in VERSIONS:
        done = export_body(source, "fmu", path=source.with_name("sources.fmu"), options={"fmi": fmi})
        (note,) = (note for note in done.notes if "sources only" in note)
        assert "there is no C compiler here" in note and "apt-get install gcc" in note
        with zipfile.ZipFile(done.paths[0]) as archive:
            names = archive.namelist()
        assert {"modelDescription.xml", "sources/sources.c", f"sources/fmi{fmi[0]}.c"} <= set(names)
        assert not any(name.startswith("binaries") for name in names)
        assert ("sources/buildDescription.xml" in names) == (fmi == "3.0")


def test_a_compiler_that_fails_is_told_of(source, monkeypatch):
    monkeypatch.setenv("CC", "false")
    done = export_body(source, "fmu", path=source.with_name("failed.fmu"), options={"structure": "linear"})
    assert any("the C compiler false failed" in note for note in done.notes) and done.paths[0].exists()


@pytest.mark.parametrize(("options", "words"), [
    ({"held": ["tipp"]}, "did you mean 'tip'"),
    ({"structure": "floating", "held": ["tip"]}, 'take structure = "linear"'),
    ({"stress": [99999]}, "node 99999 has no stress in the file; the nearest labels are"),
    ({"damping_ratio": -0.1}, "zero or more"), ({"fmi": "1.0"}, "'2.0' or '3.0'"),
])  # fmt: skip
def test_what_cannot_be_is_refused_before_anything_is_written(source, options, words):
    with pytest.raises(InputError, match=words):
        export_body(source, "fmu", path=source.with_name("refused.fmu"), options=options)
    assert not source.with_name("refused.fmu").exists()
