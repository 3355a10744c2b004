"""FMUs in two importers: FMPy (validator, simulation) and CasADi (rates and outputs of the equations)."""

import zipfile

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.signal

from morembs import read_body
from morembs.body.vtkhdf_series import stored_recovery
from morembs.exporters import export_body
from morembs.fem.stress_operator import von_mises
from morembs.reducers import CraigBampton
from tests.support.fmus import HEIGHT, LENGTH, WIDTH, InCasadi, by_axes, exported, needs_compiler, run, strip
from tests.support.refusals import refusal

pytestmark = needs_compiler
VERSIONS = ["2.0", "3.0"]
NODE = 8  # of the strip, away from its ends
HELD = {"held": ["left-end"], "stress": [NODE], "damping_ratio": 0.02}


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy", reason="FMPy is not here: pip install fmpy")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("fmu"), CraigBampton(modes=3))


@pytest.fixture(scope="module")
def held(source):
    return exported(source, "held", **HELD)


def signals(times, inputs):
    """Inputs as FMPy takes them."""
    table = np.zeros(len(times), dtype=[("time", float), *((name, float) for name in inputs)])
    table["time"] = times
    for name, values in inputs.items():
        table[name] = values
    return table


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
    moved = [
        by_axes(*(f"{end}.{kind}" for end in ("left_end", "tip") for kind in kinds))
        for kinds in (("displacement", "rotation"), ("velocity", "angular_velocity"))
    ]
    given = signals(times, dict(zip(names, loads.T, strict=True)) | no_gravity(count + 1))
    motions = run(fmpy, fmu, times[-1], step, [*moved[0], *moved[1]], input=given)
    for at in (slice(3 * k, 3 * k + 3) for k in range(8)):
        assert np.abs(motions[:, at] - expected[:, at]).max() < 1e-10 * np.abs(expected[:, at]).max()


def test_model_exchange_takes_the_same_way(fmpy, source):
    fmu = exported(source, "exchange", structure="linear", damping_ratio=0.05)
    given = {"tip.force.z": 1.0, "tip.moment.x": 0.2, "gravity.y": -9.81}
    names = by_axes("tip.displacement", "left_end.velocity")
    ends = [
        run(fmpy, fmu, 2e-3, 1e-4, names, start_values=given, **options)
        for options in ({}, {"fmi_type": "ModelExchange", "relative_tolerance": 1e-10})
    ]
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
    stresses = run(fmpy, held, 20.0, 10.0, names, start_values=start)[-1]
    assert stresses == pytest.approx([*tensor, float(von_mises(tensor))], abs=1e-9 * np.abs(tensor).max())


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
    for results, expected in zip(accelerated, weighed, strict=True):
        for name, value in results.items():
            assert value == pytest.approx(expected[name], rel=1e-9, abs=1e-9)


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
        (body.getFMUstate, body.setFMUstate, body.serializeFMUstate, body.deSerializeFMUstate)
        if fmi == "2.0"
        else (body.getFMUState, body.setFMUState, body.serializeFMUState, body.deserializeFMUState)
    )
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
    for wrong, arguments in (
        (write, (force, [np.nan])),
        (write, (tip, [1.0])),
        (read, ([100_000],)),
        (body.doStep, (0.0, 0.0)),
        (body.doStep, (0.0, np.inf)),
    ):
        with pytest.raises(Exception, match="failed with status 3"):
            wrong(*arguments)
    body.reset()
    assert read(tip) == [0.0]
    body.terminate()
    body.freeInstance()
    other = kind(guid="another", modelIdentifier=fmu.stem, unzipDirectory=folder, instanceName="body")
    with pytest.raises(Exception, match="nstantiat"):
        other.instantiate()


# Each two of version, interface and structure meet.
@pytest.mark.parametrize(
    ("fmi", "exchange", "options"),
    [
        (fmi, exchange, {"structure": "linear"} if (fmi == VERSIONS[0]) == exchange else {})
        for fmi in VERSIONS
        for exchange in (False, True)
    ],
)
def test_values_that_no_body_has_are_refused_and_leave_it_as_it_was(fmpy, source, fmi, exchange, options):
    fmu = exported(source, f"refusing_{fmi[0]}_{len(options)}", fmi=fmi, **options)
    description, folder = fmpy.read_model_description(str(fmu)), fmpy.extract(str(fmu))
    at = {variable.name: variable.valueReference for variable in description.modelVariables}
    parameters = [variable for variable in description.modelVariables if variable.causality == "parameter"]
    assert parameters and all(variable.min == "0" for variable in parameters)
    module = pytest.importorskip(f"fmpy.fmi{fmi[0]}")
    kind = getattr(module, f"FMU{fmi[0]}{'Model' if exchange else 'Slave'}")
    body = kind(guid=description.guid, modelIdentifier=fmu.stem, unzipDirectory=folder, instanceName="body")
    body.instantiate()
    if fmi == "2.0":
        body.setupExperiment()
    body.enterInitializationMode()
    body.exitInitializationMode()
    second = fmi == "2.0"
    read, write = (body.getReal, body.setReal) if second else (body.getFloat64, body.setFloat64)
    pack, unpack = (
        (body.serializeFMUstate, body.deSerializeFMUstate)
        if second
        else (body.serializeFMUState, body.deserializeFMUState)
    )
    keep = body.getFMUstate if second else body.getFMUState
    outputs = [at[name] for name in ("tip.velocity.x", "tip.velocity.z")]
    write([at["tip.force.z"]], [1.0])
    packed, before = pack(keep()), read([*outputs, at["damping_ratio"], at["tip.force.z"]])
    force, ratio = at["tip.force.z"], at["damping_ratio"]
    # The first of the packed numbers behind the time is a parameter.
    negative = packed[:8] + np.array([-1.0]).tobytes() + packed[16:]
    bad = [
        (write, ([ratio], [-1.0])),
        (write, ([ratio], [np.inf])),
        (write, ([force, ratio], [7.0, -1.0])),
        (unpack, (b"\xff" * len(packed),)),
        (unpack, (negative,)),
    ]
    if not exchange:
        bad += [(body.doStep, (np.nan, 1e-3)), (body.doStep, (0.0, -1.0))]
    for call, arguments in bad:
        with pytest.raises(Exception, match="failed with status 3"):
            call(*arguments)
        assert read([*outputs, at["damping_ratio"], at["tip.force.z"]]) == before
    # Outputs of finite values that are none.
    states = [reference for name, reference in at.items() if f"der({name})" in at]
    write(states, [1.7e308] * len(states))
    with pytest.raises(Exception, match="failed with status 3"):
        read(outputs)
    unpacked = unpack(packed)
    (body.setFMUstate if second else body.setFMUState)(unpacked)
    assert read(outputs) == before[:2]


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


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"held": ["tipp"]}, ("unknown", "", "tip")),
        ({"structure": "floating", "held": ["tip"]}, ("conflict", "structure", "linear")),
        ({"stress": [99999]}, ("unknown", "", "99999")),
        ({"damping_ratio": -0.1}, ("value", "damping_ratio")),
        ({"fmi": "1.0"}, ("value", "fmi", "2.0", "3.0")),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(source, options, words):
    with refusal(*words):
        export_body(source, "fmu", path=source.with_name("refused.fmu"), options=options)
    assert not source.with_name("refused.fmu").exists()
