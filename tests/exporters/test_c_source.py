"""C sources of bodies: compiled without a warning, run by a program as a user writes it, compared with SciPy."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.signal

from morembs import read_body
from morembs.dynamics.multibody import FlexibleBody, PointLoad, System, simulate
from morembs.exporters import export_body, make_exporter
from morembs.reducers import CraigBampton, Modal
from tests.support.fmus import LENGTH, exported, needs_compiler, strip
from tests.support.refusals import refusal

FLAGS = ["-std=c99", "-pedantic", "-O2", "-Wall", "-Wextra", "-Werror"]
# Reads inputs from the command line, holds them, and prints all outputs after each step.
PROGRAM = """
#include <stdio.h>
#include <stdlib.h>
#include "NAME.h"

static NAME_body body;

int main(int count, char **given)
{
    NAME_start(&body);
    for (int i = 2; i < count; i++)
        body.u[i - 2] = (NAME_real)atof(given[i]);
    for (int k = atoi(given[1]); k > 0; k--) {
        if (NAME_step(&body))
            return 1;
        for (int i = 0; i < UPPER_OUTPUTS; i++)
            printf("%.17g%c", (double)body.y[i], i + 1 < UPPER_OUTPUTS ? ' ' : '\\n');
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("c"), CraigBampton(modes=3))


def run(path, steps, inputs):
    """Outputs (steps, m) of the program with that body."""
    name, folder = path.stem, path.parent
    (folder / f"{name}_main.c").write_text(PROGRAM.replace("NAME", name).replace("UPPER", name.upper()))
    command = ["cc", *FLAGS, f"{name}.c", f"{name}_main.c", "-o", name, "-lm"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    command = [folder / name, str(steps), *map(repr, map(float, inputs))]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)
    return np.array([line.split() for line in ran.stdout.splitlines()], dtype=float)


def expected(source, steps, step, inputs, method):
    """Motions of both ends of the free body, from matrices of the body file, with 1 % of damping beside its own."""
    body = read_body(source).bodies["strip"]
    values, Y = sl.eigh(body.stiffness_matrix, body.mass_matrix)
    omega = np.where(np.arange(len(values)) < 6, 0.0, np.sqrt(np.abs(values)))
    n, scale = len(omega), np.maximum(omega, 1.0)
    damping = Y.T @ body.damping_matrix @ Y + 2 * 0.01 * np.diag(omega)
    A = np.block([[np.zeros((n, n)), np.diag(scale)], [-np.diag(omega**2 / scale), -damping]])
    B, C = Y.T @ body.input_matrix, body.output_matrix @ Y
    outputs = np.block([[C / scale, 0 * C], [0 * C, C]])
    inflow = np.vstack([0 * B, B])
    if method == "exponential":
        times, loads = np.arange(steps + 1) * step, np.tile(inputs, (steps + 1, 1))
        return scipy.signal.lsim((A, inflow, outputs, np.zeros((24, 12))), loads, times, interp=False)[1][1:]
    matrix = sl.lu_factor(np.eye(2 * n) - 0.5 * step * A)
    states = [np.zeros(2 * n)]
    for _ in range(steps):
        x = states[-1]
        states.append(sl.lu_solve(matrix, x + 0.5 * step * (A @ x) + step * (inflow @ inputs)))
    return np.array(states[1:]) @ outputs.T


@needs_compiler
@pytest.mark.parametrize(
    ("method", "precision", "limit"),
    [("exponential", "double", 1e-10), ("midpoint", "double", 1e-10), ("exponential", "single", 1e-4)],
)
def test_a_linear_body_moves_as_scipy_has_it(source, method, precision, limit):
    options = {"structure": "linear", "step": 2e-5, "method": method, "precision": precision, "damping_ratio": 0.01}
    done = export_body(source, "c", path=source.with_name(f"{method}_{precision}.c"), options=options)
    loads = np.random.default_rng(4).standard_normal(12)
    outputs, wanted = run(done.paths[0], 300, loads), expected(source, 300, 2e-5, loads, method)
    for at in (slice(3 * k, 3 * k + 3) for k in range(8)):
        assert np.abs(outputs[:, at] - wanted[:, at]).max() < limit * np.abs(wanted[:, at]).max()
    # What single precision costs was measured with the export.
    told = [note for note in done.notes if note.startswith("single precision: over 1000 steps")]
    assert len(told) == (precision == "single")
    assert all(1e-9 < float(note.partition("by ")[2].split()[0]) < limit for note in told)


@needs_compiler
def test_a_held_body_is_carried_by_its_support(source):
    """Reactions are those of the weight at rest; the last inputs are motions of the support, which stays."""
    path = exported(source, "held", to="c", held=["left-end"], stress=[8], step=5.0, damping_ratio=0.5)
    outputs = run(path, 3, [0, 0, 0, 0, 0, 0, 0, 0, -9.81])[-1]
    mass = read_body(source).mass
    assert outputs[:3] == pytest.approx([0, 0, 9.81 * mass], abs=1e-9)
    assert outputs[4] == pytest.approx(-9.81 * mass * LENGTH / 2, rel=1e-9)


@needs_compiler
def test_a_floating_body_converges_to_the_simulator_by_the_midpoint_rule(tmp_path):
    source, end, load = strip(tmp_path, Modal(modes=2), young=2e8), 0.02, [0.3, -0.2, 0.4, 0.01, 0.02, -0.01]
    frame = read_body(source).bodies["strip"].floating

    def reference(count):
        system = System(gravity=(0, 0, -9.81))
        body = system.add(FlexibleBody(frame, position=frame.origin))
        system.add(PointLoad(body.marker("tip"), force=load[:3], moment=load[3:]))
        return simulate(system, end=end, step=end / count, rho=1.0, tolerance=1e-13).position(body.marker("tip"))[-1]

    a, b, c = (reference(40 * 2**k) for k in range(3))
    wanted, errors = (16 * (4 * c - b) / 3 - (4 * b - a) / 3) / 15, []
    for count in (100, 200):
        path = exported(source, f"floating_{count}", to="c", step=end / count)
        outputs = run(path, count, [0, 0, -9.81, *[0] * 6, *load])[-1]
        # Outputs: position, quaternion and twist of the first end, then of the tip.
        errors.append(np.abs(outputs[13:16] - wanted).max())
    assert errors[0] < 1e-4 * LENGTH and errors[0] / errors[1] == pytest.approx(4, rel=0.05)


@needs_compiler
def test_nothing_is_allocated(source):
    """Beside itself the code calls functions of numbers, and one that fills memory."""
    known = {"memset", "memcpy", "sqrt", "sin", "cos", "sincos", "_GLOBAL_OFFSET_TABLE_"}
    for structure in ("linear", "floating"):
        path = exported(source, f"calls_{structure}", to="c", structure=structure)
        subprocess.run(["cc", *FLAGS, "-c", path.name], cwd=path.parent, check=True)
        listed = subprocess.run(["nm", "-u", path.with_suffix(".o")], check=True, capture_output=True, text=True).stdout
        assert {line.split()[-1] for line in listed.splitlines()} <= known


@needs_compiler
def test_single_precision_is_refused_where_it_costs_too_much(tmp_path):
    """A stiff body without damping in steps of many of its periods; in short ones some per cent are lost, in double
    precision nothing is.
    """
    source, path = strip(tmp_path, CraigBampton(modes=3), young=2e11, damping=0.0), tmp_path / "short.c"
    with refusal("value", "precision", "10", "--frame"):
        export_body(source, "c", path=path, options={"precision": "single", "step": 0.02})
    assert not path.exists() and not path.with_suffix(".h").exists()
    done = export_body(source, "c", path=path, options={"precision": "single"}, frame="mean-axes")
    (told,) = (note for note in done.notes if note.startswith("single precision: over 1000 steps"))
    assert 1e-6 < float(told.partition("by ")[2].split()[0]) < 0.1


def test_without_a_compiler_single_precision_is_not_measured_and_that_is_said(source, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    done = export_body(source, "c", path=source.with_name("unmeasured.c"), options={"precision": "single"})
    assert any("was not measured: there is no C compiler here" in note for note in done.notes)
    assert [path.name for path in done.paths] == ["unmeasured.c", "unmeasured.h"]


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("x.c", {"step": 0.0}, ("value", "step", "0.0")),
        ("x.txt", {}, ("value", "out")),
        ("x.c", {"method": "exponential"}, ("value", "method", "midpoint")),
        ("x.c", {"method": "euler"}, ("value", "method", "auto", "exponential", "midpoint")),
    ],
)
def test_what_cannot_be_is_refused(source, name, options, words):
    with refusal(*words):
        export_body(source, "c", path=source.with_name(name), options=options)
    assert not source.with_name(name).exists()


def test_a_body_of_two_bases_is_refused_by_name(tmp_path):
    """Forces and motions of such a body are not of one coordinate."""
    source = read_body(strip(tmp_path, Modal(modes=2)))
    body = source.bodies["strip"]
    two_sided = replace(body, output_matrix=1.5 * body.output_matrix, floating=None)
    for to in ("c", "fmu"):
        with refusal("unsupported", "method"):
            make_exporter(to).export(source, two_sided, tmp_path / f"x.{to}")
        assert not (tmp_path / f"x.{to}").exists()


REFUSING = """
#include <math.h>
#include "NAME.h"

static NAME_body body;

int main(void)
{
    int refused = 0;
    NAME_start(&body);
    body.p[0] = -1;
    refused += NAME_step(&body);
    NAME_start(&body);
    body.u[0] = (NAME_real)NAN;
    refused += NAME_step(&body);
    NAME_start(&body);
    body.x[0] = (NAME_real)INFINITY;
    refused += NAME_step(&body);
    NAME_start(&body);
    return 10 * NAME_step(&body) + refused;
}
"""


@pytest.mark.parametrize("structure", ["linear", "floating"])
@pytest.mark.parametrize("precision", ["double", "single"])
def test_a_step_from_values_that_no_body_has_says_so(source, structure, precision):
    name = f"refusing_{structure}_{precision}"
    options = {"step": 1e-4, "structure": structure, "precision": precision}
    (path, *_) = export_body(source, "c", path=source.with_name(f"{name}.c"), options=options).paths
    (path.parent / "main.c").write_text(REFUSING.replace("NAME", name))
    command = ["cc", *FLAGS, f"{name}.c", "main.c", "-o", name, "-lm"]
    subprocess.run(command, cwd=path.parent, check=True, capture_output=True, text=True)
    # Steps of one size of a linear body have no parameter.
    expected = 3 if structure == "floating" else 2
    assert subprocess.run([path.parent / name], check=False).returncode == expected
