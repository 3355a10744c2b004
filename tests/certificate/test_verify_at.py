"""Limits of bodies with parameters at values of them, proven again from the terms of the model file."""

import re
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.certificates import dense_errors
from benchmarks.verification import reseal
from morembs.app.cli import commands as cli
from morembs.app.jobs.witness import problem_at_values, witness_at_values
from morembs.body import make_part
from morembs.body.build import BodyOptions, build_body
from morembs.body.file import write_body
from morembs.certificate import morembs_verify
from morembs.certificate.certify import certify
from morembs.fem.interface import make_interface
from morembs.importers.model_file import read_model, write_model
from morembs.parametric.parameter import Parameter
from morembs.parametric.stored_terms import terms_of
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.problem import Damping
from tests.support.meshes import box, where
from tests.support.parametric import STEEL, SomeBasis
from tests.support.refusals import refusal

RUNNER = CliRunner()
BAND, HERE = (0.0, 3000.0), {"E": 1.6e11, "t": 0.02}
MESH = ((4, 1, 1), (0.5, 0.05, 0.03))


def longer(mesh):
    d = np.zeros_like(mesh.nodes.xyz)
    d[:, 0] = np.clip((mesh.nodes.xyz[:, 0] - 0.125) / 0.25, 0, 1)
    return Parameter(name="t", kind="morph", low=-0.05, high=0.05, nominal=0.0, displacement=d)


def parameters(mesh):
    return (
        Parameter(name="E", kind="young", low=1.5e11, high=2.7e11, nominal=2.1e11),
        Parameter(name="rho", kind="density", low=7000.0, high=8700.0, nominal=7850.0),
        Parameter(name="alpha", kind="alpha", low=0.0, high=50.0, nominal=10.0),
        longer(mesh),
    )


def written(folder, damping, chosen=None):
    files = tuple(folder / f"{name}.h5" for name in ("body", "model", "witness"))
    mesh = box("hex20", *MESH)
    varied = varied_model(mesh, [STEEL], chosen or parameters(mesh))
    model = varied.model(varied.box.nominal)
    ends = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling)
        for name, x, coupling in (("left", 0.0, "rigid"), ("right", 0.5, "average"))
    ]
    with AffineProblem(varied, ends, damping=damping) as problem:
        reducer = SomeBasis()
        reduced = reducer.reduce(problem)
        (certificate,) = certify(problem, [reduced], BAND, points=5)
        variation = reducer.variation(problem, reduced)
        part = make_part(problem, "all")
        body = build_body(problem, reduced, part, BodyOptions(), certificate=certificate, variation=variation)
        write_body(files[0], [body])
        write_model(files[1], problem.model, terms=terms_of(problem.varied))
    return files


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    files = written(tmp_path_factory.mktemp("sound"), Damping(alpha=10.0, beta=4e-7))
    witness_at_values(*files, HERE)
    return files


def options(values):
    return [part for name, value in values.items() for part in ("--at", f"{name}={value!r}")]


def exact_error(files, values):
    """The largest envelope error that dense solutions at values find, against the sum of the terms."""
    with h5py.File(files[2]) as file:
        stated = file["certificates/some-basis/limits/envelope"][()]
    at = problem_at_values(*files[:2], values)
    with at.problem as problem:
        return dense_errors(problem, at.bodies[0], BAND, [stated[2]])[1][:, 0].max(), stated


@pytest.mark.parametrize(
    ("damping", "values"),
    [
        (Damping(alpha=10.0, beta=4e-7), HERE),
        (Damping(alpha=10.0, beta=4e-7), {"rho": 8300.0, "alpha": 31.0, "t": -0.05, "E": 2.7e11}),
        (Damping(structural=0.02), {"t": 0.013}),
    ],
)
def test_limits_at_values_are_proven_and_not_below_the_exact_error(tmp_path, damping, values):
    files = written(tmp_path, damping)
    witness_at_values(*files, values)
    found = []
    belongs, proven, said = morembs_verify.verify(*map(str, files), found, values)
    assert belongs and proven, said
    at = ", ".join(f"{name} = " for name in ("E", "rho", "alpha", "t")).split(", ")
    assert re.search("verified: error <= .* Hz at " + r"\S+, ".join(at), said)
    exact, stated = exact_error(files, values)
    assert stated[0] <= exact * (1 + 1e-6) and exact <= float(found[0][0]) * stated[1]
    # Its own limits are not empty either.
    assert (found[0] > 0.9).all() and (found[0] <= 1).all()


def test_modal_damping_of_a_body_at_values_is_that_of_its_own_modes(tmp_path):
    mesh = box("hex20", *MESH)
    chosen = (parameters(mesh)[0], longer(mesh))
    files = written(tmp_path, Damping(modal=0.01), chosen)
    witness_at_values(*files, HERE)
    proven, said = morembs_verify.verify(*map(str, files), None, HERE)[1:]
    assert proven and "modal 0.01" in said, said
    # The bound of what its matrix is off by covers vectors that are not quite the modes.
    rng, theta = np.random.default_rng(3), np.sort(10 ** rng_uniform(2, 6, 9))
    for size in (1e-13, 1e-11):
        T = np.eye(9) + size * rng.standard_normal((9, 9))
        K, M = T.T @ np.diag(theta) @ T, T.T @ T
        off = [np.abs(K - np.diag(theta)) + 1e-15 * theta.max(), None, np.abs(M - np.eye(9)) + 1e-15]
        near, unsure = morembs_verify.modal_damping(0.01, theta, off)
        assert (np.abs(0.02 * T.T @ np.diag(np.sqrt(theta)) @ T - near) <= unsure).all()


def rng_uniform(low, high, count):
    return np.random.default_rng(1).uniform(low, high, count)


def test_the_commands_write_and_prove_a_witness_at_values(sound, tmp_path):
    witness = tmp_path / "w.h5"
    made = RUNNER.invoke(
        cli.app, ["certify", *map(str, sound[:1]), "--model", str(sound[1]), "--witness", str(witness), *options(HERE)]
    )
    assert made.exit_code == 0 and "--at E=160000000000.0 --at t=0.02" in made.stdout.replace("\n", " "), made.output
    assert witness.read_bytes() == Path(sound[2]).read_bytes()
    for command in (
        [sys.executable, morembs_verify.__file__, *sound, *options(HERE)],
        [sys.executable, morembs_verify.__file__, *sound, "--at", "t=0.02, E=1.6e11"],
    ):
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        assert run.returncode == 0 and "E = 160000000000, rho = 7850, alpha = 10, t = 0.02" in run.stdout, run
    shown = RUNNER.invoke(cli.app, ["verify", *map(str, sound), *options(HERE)])
    assert shown.exit_code == 0


@pytest.mark.parametrize(
    ("given", "code", "words"),
    [
        ([], 1, "lemma sum-of-terms fails: the witness is of E = 160000000000"),
        (["--at", "t=0.021"], 1, "lemma sum-of-terms fails: the witness is of"),
        (["--at", "E=1.6e11,t=0.02,rho=7851"], 1, "lemma sum-of-terms fails: the witness is of"),
        (["--at", "thickness=2"], 2, "parameter 'thickness' was given; the model has E, rho, alpha, t"),
        (["--at", "t"], 2, "--at t was given; expected NAME=NUMBER"),
        (["--at", "t=1", "--at", "t=1"], 2, "each name once"),
        (["--at", "t=nan"], 2, "expected NAME=NUMBER"),
    ],
)
def test_other_values_than_those_of_the_witness_are_refused(sound, given, code, words):
    shown = RUNNER.invoke(cli.app, ["verify", *map(str, sound), *given])
    assert shown.exit_code == code and words in " ".join(shown.output.split()), shown.output


def put(file, name, value):
    del file[name]
    file[name] = value


def change_term(file):
    file["terms/K_3/data"][:] *= 1.01


def drop_term(file):
    last = len(file["terms/law/M"]) - 1
    file[f"terms/M_{last}/data"][:] = 0.0


def change_law(file):
    law = file["terms/law/K"][()]
    put(file, "terms/law/K", np.where(law == 1, 2, law))


def change_order(file):
    law = file["terms/law/K"][()]
    put(file, "terms/law/K", law[::-1].copy())


def change_points(file):
    (name,) = [name for name in file["terms/law/points_K"]]
    file[f"terms/law/points_K/{name}"][:] *= 1.05


def change_unknown_law(file):
    law = file["terms/law/K"][()]
    law[0, 0] = 99
    put(file, "terms/law/K", law)


def change_range(file):
    file["terms/high"][-1] = 0.01


def change_ranges_of_both(file):
    place = "terms" if "terms" in file else "bodies/some-basis/parametric"
    file[f"{place}/high"][-1] = 0.01


def change_displacement(file):
    moves = file["terms/displacement/t"]
    moves[:] += np.random.default_rng(5).standard_normal(moves.shape)


def add_term(file):
    count = len(file["terms/law/K"])
    file.copy("terms/K_0", f"terms/K_{count}")


def change_body_term(file):
    file["bodies/some-basis/parametric/K"][0] *= 1.02


def change_body_damping(file):
    put(file, "bodies/some-basis/parametric/damping", np.bytes_('{"alpha": 10.0, "beta": 4e-5, "modal": 0.0}'))


def change_limit(file):
    lower = file["certificates/some-basis/limits/envelope"][0]
    file["certificates/some-basis/limits/envelope"][1] = 0.999 * lower


def change_cells(file):
    put(file, "certificates/some-basis/cells_hz", file["certificates/some-basis/cells_hz"][1:])
    put(file, "certificates/some-basis/cell_limit", file["certificates/some-basis/cell_limit"][1:])


def change_value(file):
    file["at/values"][-1] = 0.021


def change_alpha(file):
    text = file["damping"][()].decode().replace('"alpha": 10.0', '"alpha": 11.0')
    put(file, "damping", np.bytes_(text))


@pytest.mark.parametrize(
    ("which", "change", "lemma"),
    [
        (1, change_term, "ritz-values|rigid-motions|cells-of-the-band"),
        (1, drop_term, "."),
        (1, change_law, "sum-of-terms|rigid-motions|ritz-values|sturm-count|complement-bound"),
        (1, change_order, "."),
        (1, change_points, "."),
        (1, change_unknown_law, "sum-of-terms"),
        (1, change_range, "sum-of-terms"),
        ((0, 1), change_ranges_of_both, "sum-of-terms"),
        (1, change_displacement, "."),
        (1, add_term, "sum-of-terms"),
        (0, change_body_term, "body-response|rigid-motions|cells-of-the-band"),
        (0, change_body_damping, "cells-of-the-band"),
        (2, change_limit, "cells-of-the-band"),
        (2, change_cells, "cells-of-the-band"),
        (2, change_value, "sum-of-terms"),
        (2, change_alpha, "damping"),
    ],
)
def test_what_is_false_at_values_is_refused_by_its_lemma(sound, tmp_path, which, change, lemma):
    copies = [Path(shutil.copy(file, tmp_path)) for file in sound]
    for number in (which,) if isinstance(which, int) else which:
        with h5py.File(copies[number], "r+") as file:
            change(file)
    assert morembs_verify.belong(*map(str, copies))
    reseal(*copies)
    belongs, proven, said = morembs_verify.verify(*map(str, copies), None, HERE)
    assert belongs and not proven, said
    refused = re.search(r"not verified: lemma (\S+) fails", said)
    assert refused and re.fullmatch(lemma.replace(".", ".*"), refused[1]), said


def test_coefficients_are_rounded_once():
    rng = np.random.default_rng(7)
    with h5py.File("coefficients", "w", driver="core", backing_store=False) as file:
        points = np.sort(rng.uniform(-3, 3, 7))
        file["law/K"] = np.array([[1, 3], [2, 5], [0, 9], [0, 0]])
        file["law/points_K/t"] = points
        for x, t in rng.uniform(-3, 3, (5, 2)).tolist():
            found = morembs_verify.Parameters(["E", "t"], ["young", "morph"], [x, t]).coefficients(file, "K")
            grid, t = [Fraction(p) for p in points.tolist()], Fraction(t)
            for theta, power, k in zip(found, (1, 2, 0), (0, 2, 6), strict=False):
                exact = Fraction(x) ** power
                for j, p in enumerate(grid):
                    exact *= 1 if j == k else (t - p) / (grid[k] - p)
                high = float(theta)
                rest = Fraction(high) + Fraction(float(theta - np.longdouble(high))) - exact
                assert abs(rest) <= 2 * Fraction(float(np.finfo(np.longdouble).eps)) * abs(exact)
            assert found[3] == 1


def test_entries_of_a_sum_of_terms_are_as_good_as_they_say(sound):
    with h5py.File(sound[1], "r") as model:
        n = len(model["dofs/node"])
        names = [name.decode() for name in model["terms/names"]]
        kinds = [kind.decode() for kind in model["terms/kinds"]]
        at = morembs_verify.Parameters(names, kinds, [1.63e11, 8111.0, 10.0, 0.0173])
        total, size, rounded = morembs_verify.sum_of_terms(model, "K", at, n)
        theta = at.coefficients(model["terms"], "K")
        exact = [Fraction(float(x)) + Fraction(float(x - np.longdouble(float(x)))) for x in theta]
        terms = [morembs_verify.matrix_of(model, f"terms/K_{q}")[0] for q in range(len(theta))]
        rng = np.random.default_rng(2)
        for _ in range(40):
            i = int(rng.integers(n))
            j = int(rng.choice(total[[i]].indices))
            entry = sum(a * Fraction(float(term[i, j])) for a, term in zip(exact, terms, strict=True))
            value = total[i, j]
            away = Fraction(float(value)) + Fraction(float(value - np.longdouble(float(value)))) - entry
            assert abs(float(away)) <= morembs_verify.gamma(rounded, morembs_verify.U_LONG) * size[i, j]


def test_what_has_no_terms_or_values_is_told(sound, tmp_path):
    files = list(sound)
    bare = tmp_path / "bare.h5"
    write_model(bare, read_model(files[1]))
    with refusal("missing", "bare.h5"):
        witness_at_values(files[0], bare, tmp_path / "w.h5", HERE)
    with refusal("value", "t"):
        witness_at_values(files[0], files[1], tmp_path / "w.h5", {"t": 0.2})
    with refusal("unknown", "thickness"):
        witness_at_values(files[0], files[1], tmp_path / "w.h5", {"thickness": 0.2})
    assert not (tmp_path / "w.h5").exists()
