"""Inputs that go in a line over a step: FMUs in FMPy and C code, beside held ones and a fine solution."""

import subprocess
import zipfile

import numpy as np
import pytest
import scipy.linalg as sl

from morembs import read_body
from morembs.exporters import export_body
from morembs.reducers import CraigBampton, Modal
from tests.exporters.test_c_source import FLAGS
from tests.support.fmus import by_axes, exported, needs_compiler, strip
from tests.support.refusals import refusal

pytestmark = needs_compiler
VERSIONS = ["2.0", "3.0"]
HZ, END = 400.0, 5e-3
HELD = {"held": ["left-end"], "damping_ratio": 0.02}
MOTIONS = [f"left_end.{kind}.z" for kind in ("displacement", "velocity", "acceleration")]


# Reads all inputs of each time from the standard input, goes on lines between them, and prints the outputs.
PROGRAM = """
#include <stdio.h>
#include "NAME.h"

static NAME_body body;

static int read(NAME_real *u)
{
    double value;
    for (int i = 0; i < UPPER_INPUTS; i++) {
        if (scanf("%lf", &value) != 1)
            return 0;
        u[i] = (NAME_real)value;
    }
    return 1;
}

int main(void)
{
    static NAME_real u_end[UPPER_INPUTS];
    NAME_start(&body);
    if (!read(body.u))
        return 1;
    while (read(u_end)) {
        if (NAME_step_linear(&body, u_end))
            return 1;
        for (int i = 0; i < UPPER_OUTPUTS; i++)
            printf("%.17g%c", (double)body.y[i], i + 1 < UPPER_OUTPUTS ? ' ' : '\\n');
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def fmpy():
    return pytest.importorskip("fmpy", reason="FMPy is not here: pip install fmpy")


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("line"), CraigBampton(modes=3))


def support(times):
    """Displacement, velocity, acceleration (3, n) of a support that starts at rest: 1 - cos of 400 Hz."""
    w = 2 * np.pi * HZ
    return 1e-4 * np.array([1 - np.cos(w * times), w * np.sin(w * times), w**2 * np.cos(w * times)])


def exact(source, times):
    """Displacement of the tip: matrices of the body file with the support as it moves, in sines, so without steps."""
    body = read_body(source).bodies["strip"]
    C, K, M, D = body.output_matrix, body.stiffness_matrix, body.mass_matrix, body.damping_matrix
    # Reduced coordinates = X (motion of the support) + N (others).
    X, N = np.linalg.pinv(C[:6])[:, 2], sl.null_space(C[:6])
    Kn, Mn, Dn = (N.T @ A @ N for A in (K, M, D))
    # The body at rest on its support: what damping of modes counts from.
    X = X - N @ np.linalg.solve(Kn, N.T @ (K @ X))
    values, Y = sl.eigh(Kn, Mn)
    omega, n = np.sqrt(values), len(values)
    damping = Y.T @ Dn @ Y + 2 * HELD["damping_ratio"] * np.diag(omega)
    on = [Y.T @ (N.T @ (A @ X)) for A in (K, D, M)]
    # The force is f0 + f1 cos w t + f2 sin w t; states and these two as states of one system.
    w = 2 * np.pi * HZ
    f0, f1, f2 = -1e-4 * on[0], 1e-4 * (on[0] - w**2 * on[2]), -1e-4 * w * on[1]
    A = np.zeros((2 * n + 3, 2 * n + 3))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n] = np.hstack([-np.diag(values), -damping, np.array([f0, f1, f2]).T])
    A[-2, -1], A[-1, -2] = -w, w
    start = np.concatenate([np.zeros(2 * n), [1.0, 1.0, 0.0]])
    states = np.array([sl.expm(A * time) @ start for time in times])
    return states[:, :n] @ (C[8] @ N @ Y) + support(times)[0] * (C[8] @ X)


class Slave:
    """An FMU for co-simulation in FMPy, whose inputs are named; rates of inputs by what each version has for them.

    (``simulate_fmu`` of FMPy 0.3.32 holds derivatives of at most nine inputs.)
    """

    def __init__(self, fmpy, fmu):
        description = fmpy.read_model_description(str(fmu))
        self.second = description.fmiVersion == "2.0"
        module = pytest.importorskip(f"fmpy.fmi{description.fmiVersion[0]}")
        self.at = {variable.name: variable.valueReference for variable in description.modelVariables}
        kind = module.FMU2Slave if self.second else module.FMU3Slave
        self.body = kind(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=fmpy.extract(str(fmu)),
            instanceName="body",
        )
        self.body.instantiate()
        if self.second:
            self.body.setupExperiment()
        self.body.enterInitializationMode()
        self.body.exitInitializationMode()

    def get(self, names):
        return (self.body.getReal if self.second else self.body.getFloat64)([self.at[name] for name in names])

    def set(self, values):
        write = self.body.setReal if self.second else self.body.setFloat64
        write([self.at[name] for name in values], list(values.values()))

    def set_rates(self, values):
        if self.second:
            references = [self.at[name] for name in values]
            self.body.setRealInputDerivatives(references, [1] * len(values), list(values.values()))
        else:
            self.set({f"der({name})": value for name, value in values.items()})


def follow(slave, times, inputs, outputs, *, linear):
    """Outputs (n, m) at ``times`` of inputs by name, held over each step or on lines to their next values."""
    result = [slave.get(outputs)]
    for k, step in enumerate(np.diff(times)):
        slave.set({name: values[k] for name, values in inputs.items()})
        if linear:
            slave.set_rates({name: (values[k + 1] - values[k]) / step for name, values in inputs.items()})
        slave.body.doStep(times[k], step)
        if not linear:
            slave.set({name: values[k + 1] for name, values in inputs.items()})
        result.append(slave.get(outputs))
    return np.array(result)


def orders(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.parametrize("fmi", VERSIONS)
def test_support_motion_is_of_second_order_where_held_inputs_are_of_first(fmpy, source, fmi):
    fmu = exported(source, f"support{fmi[0]}", fmi=fmi, interpolate_inputs=True, **HELD)
    errors = {False: [], True: []}
    for step in (4e-5, 2e-5, 1e-5):
        times = np.arange(round(END / step) + 1) * step
        wanted = exact(source, times)
        for linear, found in errors.items():
            given = dict(zip(MOTIONS, support(times), strict=True))
            tip = follow(Slave(fmpy, fmu), times, given, ["tip.displacement.z"], linear=linear)[1:, 0]
            found.append(np.abs(tip - wanted[1:]).max() / np.abs(wanted).max())
    assert orders(errors[False]) == pytest.approx(1.0, abs=0.1)
    assert orders(errors[True]) == pytest.approx(2.0, abs=0.1)
    assert errors[False][-1] > 5e-3 and errors[True][-1] < 2e-4


def in_c(path, inputs):
    """Outputs (n - 1, m) of the program with that body, of ``inputs`` (n, k)."""
    name, folder = path.stem, path.parent
    (folder / f"{name}_main.c").write_text(PROGRAM.replace("NAME", name).replace("UPPER", name.upper()))
    command = ["cc", *FLAGS, f"{name}.c", f"{name}_main.c", "-o", name, "-lm"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    given = "\n".join(" ".join(map(repr, row)) for row in inputs.tolist())
    ran = subprocess.run([folder / name], input=given, check=True, capture_output=True, text=True)
    return np.array([line.split() for line in ran.stdout.splitlines()], dtype=float)


def moved_support(times):
    """All inputs (n, 27) of the held strip: loads of the tip, gravity, motions of the support along z."""
    inputs = np.zeros((len(times), 27))
    inputs[:, [11, 17, 23]] = support(times).T
    return inputs


def test_c_code_moves_as_the_fmu(fmpy, source):
    """The exponential is exact on lines; the midpoint rule is of second order itself."""
    fmu = exported(source, "line_fmu", interpolate_inputs=True, **HELD)
    # The longer step is some radians of the fastest mode.
    for step in (1e-3, 1e-5):
        times = np.arange(201) * step
        path = exported(source, "line", to="c", step=step, interpolate_inputs=True, **HELD)
        # Six reactions come first, then motions of the tip.
        tip = in_c(path, moved_support(times))[:, 8]
        given = dict(zip(MOTIONS, support(times), strict=True))
        same = follow(Slave(fmpy, fmu), times, given, ["tip.displacement.z"], linear=True)[1:, 0]
        assert np.abs(tip - same).max() < 1e-10 * np.abs(same).max()
    wanted = exact(source, times)[1:]
    assert np.abs(tip - wanted).max() < 2e-4 * np.abs(wanted).max()
    errors = []
    for count in (1, 2, 4):
        path = exported(
            source, f"middle{count}", to="c", step=step / count, method="midpoint", interpolate_inputs=True, **HELD
        )
        finer = np.arange(200 * count + 1) * step / count
        tip = in_c(path, moved_support(finer))[count - 1 :: count, 8]
        errors.append(np.abs(tip - wanted).max() / np.abs(wanted).max())
    assert orders(errors) == pytest.approx(2.0, abs=0.15)


def pull(times):
    """Force (n,) on the tip of a free body."""
    return 200 * np.sin(2 * np.pi * 60 * times)


def test_large_rotations_under_loads_that_change_are_of_second_order(fmpy, tmp_path):
    """Gauss's method follows lines to fourth order, so that what is left is that of the line; halves go along it."""
    source, end, name = strip(tmp_path, Modal(modes=2), young=2e8), 0.02, "tip.force.z"
    fmu = exported(source, "large", interpolate_inputs=True)
    path = exported(source, "large_c", to="c", step=end / 160, interpolate_inputs=True)

    def moved(count, *, linear, tolerance=1e-11):
        times = np.linspace(0, end, count + 1)
        slave = Slave(fmpy, fmu)
        slave.set({"tolerance": tolerance})
        places = follow(slave, times, {name: pull(times)}, by_axes("tip.position"), linear=linear)
        return places[-1] - places[0]

    wanted = moved(640, linear=True)
    errors = {
        linear: [np.abs(moved(count, linear=linear) - wanted).max() for count in (20, 40, 80)]
        for linear in (False, True)
    }
    assert orders(errors[False])[-1] == pytest.approx(1.0, abs=0.2)
    assert orders(errors[True])[-1] == pytest.approx(2.0, abs=0.2)
    # Two halves of a step each, whatever they differ from the whole by: both have inputs of their own.
    loose = moved(640, linear=True, tolerance=1e-6)
    assert np.abs(loose - wanted).max() < 2e-4 * np.abs(wanted).max()
    times = np.linspace(0, end, 161)
    inputs = np.zeros((161, 15))
    inputs[:, 11] = pull(times)
    tip = in_c(path, inputs)[-1, 13:16] - Slave(fmpy, fmu).get(by_axes("tip.position"))
    assert np.abs(wanted).max() > 0.05
    assert np.abs(tip - wanted).max() < 2e-3 * np.abs(wanted).max()


@pytest.mark.parametrize("fmi", VERSIONS)
def test_rates_of_inputs_are_part_of_the_state(fmpy, source, fmi):
    fmu = exported(source, f"kept{fmi[0]}", fmi=fmi, interpolate_inputs=True, **HELD)
    slave, tip = Slave(fmpy, fmu), ["tip.displacement.z", "left_end.displacement.z"]
    body, second = slave.body, fmi == "2.0"
    slave.set_rates({MOTIONS[0]: 2.0, MOTIONS[2]: 1e5})
    body.doStep(0.0, 1e-4)
    state = body.getFMUstate() if second else body.getFMUState()
    packed = (body.serializeFMUstate if second else body.serializeFMUState)(state)
    assert slave.get(tip[1:]) == pytest.approx([2e-4])
    body.doStep(1e-4, 1e-4)
    first = slave.get(tip)
    assert first[1] == pytest.approx(4e-4) and first[0] != 0
    slave.set_rates({MOTIONS[0]: 0.0, MOTIONS[2]: 0.0})
    state = (body.deSerializeFMUstate if second else body.deserializeFMUState)(packed)
    (body.setFMUstate if second else body.setFMUState)(state)
    body.doStep(1e-4, 1e-4)
    assert slave.get(tip) == first
    # A step that does not succeed leaves inputs where they were.
    with pytest.raises(Exception, match="failed with status 3"):
        body.doStep(2e-4, np.inf)
    assert slave.get(tip) == first
    body.reset()
    body.doStep(0.0, 1e-4)
    assert slave.get(tip) == [0.0, 0.0]
    with pytest.raises(Exception, match="failed with status 3"):
        slave.set_rates({MOTIONS[0]: np.nan})
    if second:
        for references, order in ([[slave.at["tip.displacement.z"]], 1], [[slave.at[MOTIONS[0]]], 2]):
            with pytest.raises(Exception, match="failed with status 3"):
                body.setRealInputDerivatives(references, [order], [1.0])


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_description_says_what_an_importer_may_do(fmpy, source, fmi):
    validate = pytest.importorskip("fmpy.validation").validate_fmu
    for options in ({"held": ["left-end"], "stress": [8]}, {"structure": "linear"}, {}):
        fmu = exported(source, "told", fmi=fmi, interpolate_inputs=True, **options)
        assert validate(str(fmu)) == []
        description = fmpy.read_model_description(str(fmu))
        inputs = {variable.name: variable for variable in description.modelVariables if variable.causality == "input"}
        rates = {name: variable for name, variable in inputs.items() if name.startswith("der(")}
        assert description.coSimulation.canInterpolateInputs is (fmi == "2.0")
        assert len(rates) == (0 if fmi == "2.0" else len(inputs) // 2)
        assert all(variable.derivative.name == name[4:-1] for name, variable in rates.items())
        if rates:
            assert (rates["der(gravity.x)"].unit, rates["der(tip.moment.y)"].unit) == ("m/s3", "N.m/s")
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    # Nothing depends on a rate of an input.
    references = {str(variable.valueReference) for variable in rates.values()}
    depended = [part.partition('"')[0].split() for part in text.split('dependencies="')[1:]]
    assert depended and not references & {word for words in depended for word in words}


def test_inputs_are_held_unless_something_asks_for_lines(source):
    """A time step does; without one, the bytes are those of an export that was told to hold."""
    for to, text in (("c", "_step_linear("), ("fmu", "canInterpolateInputs")):
        paths = [
            exported(source, f"asked{at}", to=to, structure="linear", **options)
            for at, options in enumerate(
                (
                    {},
                    {"interpolate_inputs": True},
                    {"time_step": 1e-4},
                    {"time_step": 1e-4, "interpolate_inputs": False},
                )
            )
        ]
        read = [_text(path) for path in paths]
        assert [text in each for each in read] == [False, True, True, False]
        assert not any("LINEAR_INPUTS" in each for each in read)
    with refusal("value", "interpolate_inputs"):
        export_body(source, "c", path=source.with_name("no.c"), options={"interpolate_inputs": "maybe"})


def _text(path):
    if path.suffix == ".c":
        return path.read_text() + path.with_suffix(".h").read_text()
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if not name.startswith("binaries")]
        return "".join(archive.read(name).decode() for name in names)
