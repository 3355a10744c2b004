"""Bodies for real time: fast modes become compliance, and the error that is told holds."""

import subprocess
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from morembs import elastic_body, make_part, read_body, write_body
from morembs.exporters import export_body, step_for_band
from morembs.exporters.read_back import FirstOrder
from morembs.exporters.real_time import Truncation, resolved_hz, slow_modes, without_fast
from morembs.exporters.state_space_files import read_state_space
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.exporters.test_c_source import run
from tests.support.fmus import exported, needs_compiler, strip
from tests.support.meshes import box, steel, where
from tests.support.processes import morembs as command
from tests.support.refusals import refusal

STEP = 1e-4


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("step"), CraigBampton(modes=8))


def chain(damping):
    """Two slow and two fast oscillators, damped each by itself or across."""
    rng = np.random.default_rng(3)
    omega = np.array([100.0, 300.0, 2000.0, 9000.0])
    D = np.diag(0.02 * omega) if damping == "own" else 20.0 * (np.ones((4, 4)) + np.eye(4))
    B, C = rng.standard_normal((4, 2)), rng.standard_normal((3, 4))
    system = FirstOrder(
        A=np.block([[np.zeros((4, 4)), np.eye(4)], [-np.diag(omega**2), -D]]),
        B=np.vstack([0 * B, B]),
        C=np.hstack([C, 0.01 * C]),
        D=np.zeros((3, 2)),
    )
    return Truncation(
        system=system,
        fast=np.array([2, 3, 6, 7]),
        moving=np.zeros(0, dtype=int),
        units=(["m", "m", "m/s"], ["N", "N"]),
        derivatives=[(0, 0), (1, 0)],
        length=1.0,
        step=1e-3,
    )


def value(system, s):
    return system.C @ np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B) + system.D


@pytest.mark.parametrize("stands_in", [False, True])
def test_the_error_is_an_upper_limit_and_a_sharp_one(stands_in):
    truncation = chain("own")
    if stands_in:
        # One mode of the same static response for each input.
        gain = value(truncation.system, 0.0) - value(drop(truncation), 0.0)
        one, omega = np.eye(2), 5000.0
        A = np.block([[0 * one, one], [-(omega**2) * one, -0.02 * omega * one]])
        stand_in = FirstOrder(A=A, B=np.vstack([0 * one, one]), C=np.hstack([omega**2 * gain, 0 * gain]), D=0 * gain)
        truncation = replace(truncation, stand_in=stand_in)
    assert truncation.is_proven
    short = without_fast(truncation.system, truncation.fast)
    for band in (100.0, 500.0, 1000.0):
        limit, true = truncation.error(band), 0.0
        for s in 1j * np.linspace(0, band, 301):
            found = value(short, s)
            if stands_in:
                found = value(drop(truncation), s) + value(truncation.stand_in, s)
            true = np.maximum(true, np.abs(value(truncation.system, s) - found))
        assert (true <= limit * (1 + 1e-9)).all()
        assert (limit < 1.5 * true).all()


def drop(truncation):
    """The system without its fast states, and without their static response."""
    system, slow = truncation.system, np.setdiff1d(np.arange(8), truncation.fast)
    return replace(system, A=system.A[np.ix_(slow, slow)], B=system.B[slow], C=system.C[:, slow])


def test_an_error_across_damping_is_told_as_one_of_samples():
    truncation = chain("across")
    assert not truncation.is_proven
    found = truncation.measure(4)
    assert found.kept == 2 and "sampled at 200 frequencies" in found.notes[1]
    short = without_fast(truncation.system, truncation.fast)
    assert value(short, 0.0) == pytest.approx(value(truncation.system, 0.0), rel=1e-12)
    difference = np.abs(value(short, 500j) - value(truncation.system, 500j))
    assert (truncation.error(500.0) >= difference * (1 - 1e-9)).all()


def test_an_overdamped_mode_is_as_slow_as_its_slowest_pole():
    """Poles of w = 2000 and d = 1e5 rad/s are at 40 and 1e5 rad/s."""
    assert slow_modes(np.array([500.0, 2000.0, 2000.0]), np.array([0.0, 0.0, 1e5]), 1e-3).tolist() == [
        True,
        False,
        True,
    ]


def test_state_space_keeps_slow_poles_and_the_static_gain(source, tmp_path):
    options = {"held": ["left-end"], "inputs": ["tip:force"], "outputs": ["tip:displacement", "left-end:reaction"]}
    whole, short = (
        read_state_space(
            export_body(source, "statespace", path=tmp_path / f"{at}.npz", options=options | more).paths[0]
        )
        for at, more in enumerate(({}, {"time_step": STEP}))
    )
    assert len(short.A) < len(whole.A)
    assert np.abs(short.poles()).max() * STEP <= 1 + 1e-9
    assert short.poles() == pytest.approx(whole.poles()[: len(short.A)], rel=1e-9)
    assert short.dc_gain() == pytest.approx(whole.dc_gain(), rel=1e-9, abs=1e-12 * np.abs(whole.dc_gain()).max())
    # Without the feedthrough 5 % of the rotation would be lost.
    assert np.abs(short.D).max() > 0.05 * np.abs(whole.dc_gain()).max()
    with np.load(tmp_path / "1.npz") as file:
        assert file["time_step"] == STEP and "static compliance" in file["real_time"][0]


@needs_compiler
def test_c_code_carries_the_static_compliance(source, tmp_path):
    """A held body under constant loads comes to rest where the whole body does."""
    options = {"structure": "linear", "held": ["left-end"], "damping_ratio": 0.7}
    loads = [3.0, -2.0, 5.0, 0.4, 0.3, -0.2, *[0.0] * 21]
    paths = [
        exported(source, name, to="c", **options, **more)
        for name, more in (("every", {"step": STEP}), ("slow", {"time_step": STEP}))
    ]
    whole, short = (run(path, 4000, loads)[-1] for path in paths)
    assert short[:12] == pytest.approx(whole[:12], rel=1e-8, abs=1e-10 * np.abs(whole).max())
    text = paths[1].with_suffix(".h").read_text()
    assert "/* time step 0.0001 s: 10 of 14 modes" in text and "displacements" in text
    assert "time step" not in paths[0].with_suffix(".h").read_text()


@needs_compiler
def test_a_step_that_resolves_all_modes_changes_nothing_but_the_words(source):
    options = {"structure": "linear"}
    plain = exported(source, "same", to="c", step=1e-6, **options).read_bytes()
    header = (source.parent / "same.h").read_text()
    held = {"time_step": 1e-6, "interpolate_inputs": False}
    assert exported(source, "same", to="c", **held, **options).read_bytes() == plain
    told = (source.parent / "same.h").read_text()
    assert told != header and told.endswith(header)


@needs_compiler
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_an_fmu_follows_loads_at_once_and_says_what_it_is(source, fmi):
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    fmu = exported(source, f"step{fmi[0]}", structure="linear", time_step=STEP, fmi=fmi)
    assert not validation.validate_fmu(str(fmu))
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    assert 'stepSize="0.0001"' in text and "static compliance" in text and "error against the body" in text
    # At once: the compliance of the modes that are gone, before anything has moved.
    start = {"tip.moment.z": 1.0}
    result = fmpy.simulate_fmu(
        str(fmu), stop_time=STEP, output_interval=STEP, start_values=start, output=["tip.rotation.z"]
    )
    body = read_body(source).bodies["strip"]
    values, Y = body.reduced.modes()
    fast = np.sqrt(np.maximum(values, 0.0)) * STEP > 1
    motion = (body.output_matrix @ Y)[11, fast]
    assert result["tip.rotation.z"][0] == pytest.approx((motion**2 / values[fast]).sum(), rel=1e-9)


@needs_compiler
def test_the_price_of_a_second_is_told_where_it_can_be_measured(source, tmp_path, monkeypatch):
    def prices(step):
        notes = export_body(source, "c", path=tmp_path / "x.c", options={"time_step": step}).notes
        told = [note.split() for note in notes if note.startswith("1 s costs")]
        assert all(words[4:] == f"s on this machine, step {step:g} s".split() for words in told)
        return [float(words[3]) for words in told]

    # Of FMUs of both structures, too.
    for structure in ("linear", "floating"):
        options = {"time_step": STEP, "structure": structure}
        notes = export_body(source, "fmu", path=tmp_path / "x.fmu", options=options).notes
        assert sum(note.startswith("1 s costs") for note in notes) == 1
    # The state space runs in NumPy, and needs no compiler.
    notes = export_body(source, "statespace", path=tmp_path / "x.npz", options={"time_step": STEP}).notes
    assert sum(note.startswith("1 s costs") and note.endswith("step 0.0001 s") for note in notes) == 1
    # Ten times the steps, of more modes.
    [slow], [fast] = prices(1e-4), prices(1e-5)
    assert 0 < 3 * slow < fast
    monkeypatch.setenv("CC", "/no/compiler")
    assert prices(1e-4) == []


@needs_compiler
def test_a_floating_body_has_no_states_of_its_fast_modes_and_says_so(source):
    done = export_body(source, "c", path=source.with_name("large.c"), options={"time_step": STEP})
    assert "6 of 14 modes, up to 1592 Hz; the others are static compliance" in done.notes[2]
    assert "LARGE_STATES = 25" in done.paths[1].read_text()
    subprocess.run(["cc", "-c", "-Wall", "-Werror", "large.c"], cwd=source.parent, check=True)


def test_what_cannot_be_is_refused(source, tmp_path):
    assert resolved_hz(STEP) == pytest.approx(1591.5, rel=1e-4)
    for to, options, words in (
        ("c", {"time_step": STEP, "step": 1e-3}, ("value", "step", "0.001", "0.0001")),
        ("c", {"time_step": 1.0, "held": ["left-end"]}, ("value", "time_step", "0.1592", "'strip'")),
        ("c", {"time_step": -1.0}, ("value", "time_step", "-1.0")),
    ):
        with refusal(*words):
            export_body(source, to, path=tmp_path / f"x.{to}", options=options)
    assert not list(tmp_path.iterdir())


def test_the_command_line_takes_a_time_step(source, tmp_path):
    done = command(
        "export", source, "--to", "statespace", "--time-step", "1e-4", "-o", tmp_path / "x.npz", folder=tmp_path
    )
    assert done.code == 0 and "note: time step 0.0001 s: 12 of 20 modes" in done.output
    refused = command("export", source, "--to", "sid", "--time-step", "1e-4", "-o", tmp_path / "x.sid", folder=tmp_path)
    assert refused.code == 2 and "time_step" in refused.errors


def test_a_check_names_the_longest_step_that_is_good_enough(source, tmp_path):
    found, errors = step_for_band(source, "statespace", 100.0)
    assert 0 < found.kept < found.count and errors["displacements"] <= 1e-3
    # What the export of that step tells itself; twice the step is too long.
    done = export_body(source, "statespace", path=tmp_path / "x.npz", options={"time_step": found.step})
    assert done.notes[:2] == found.notes
    twice = export_body(source, "statespace", path=tmp_path / "x.npz", options={"time_step": 2 * found.step})
    assert float(twice.notes[1].partition("displacements ")[2].partition(",")[0]) > 1e-3
    # The steps of MuJoCo count too: (w h)^2 / 24.
    steps = step_for_band(source, "mujoco", 100.0)
    assert steps[1]["steps"] == pytest.approx((2 * np.pi * 100 * steps[0].step) ** 2 / 24, rel=0.01)
    # So do those of C code by the midpoint rule, (w h)^2 / 12; the exponential and FMUs have none.
    for to, options, has_steps in (
        ("c", {"structure": "linear", "method": "midpoint"}, True),
        ("c", {"structure": "floating"}, True),
        ("c", {"structure": "linear"}, False),
        ("fmu", {}, False),
    ):
        found_to, errors_to = step_for_band(source, to, 100.0, options=options)
        assert ("steps" in errors_to) is has_steps
        if has_steps:
            assert errors_to["steps"] == pytest.approx((2 * np.pi * 100 * found_to.step) ** 2 / 12, rel=0.01)
    said = command("export", source, "--to", "statespace", "--check", 100, folder=tmp_path)
    assert said.code == 0 and f"time step for motion up to 100 Hz: {found.step:g} s" in said.output
    for to, band, words in (("sid", 100.0, ("unsupported", "to")), ("c", -1.0, ("value", "band_hz"))):
        with refusal(*words):
            step_for_band(source, to, band)
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_a_floating_body_without_interface_frames_is_refused(tmp_path):
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.04, 0.02)))
    ends = [make_interface(model, name="tip", coupling="direct", nodes=where(model, 0, 0.4))]
    with Problem(model, ends) as problem:
        body = elastic_body(problem, CraigBampton(modes=4).reduce(problem, "bar"), make_part(problem))
    path = write_body(tmp_path / "bar.h5", [body])
    with refusal("unsupported", "coupling"):
        export_body(path, "c", path=tmp_path / "bar.c", options={"structure": "floating", "time_step": 1e-4})
