"""``morembs update``: parameters from measured frequencies."""

import csv
import json
from functools import partial

import numpy as np
import pytest

import morembs
from morembs.parametric.terms import AffineProblem, varied_model
from tests.support import commands
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, parametric_file

HIDDEN = {"E_arm": 1.8e11, "E_rest": 2.35e11, "t": 1.0}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters()[:3], longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        return parametric_file(tmp_path_factory.mktemp("bodies") / "bracket.h5", problem, nodes="skin")


run = partial(commands.run, "update")


def write(file, header, rows):
    with file.open("w", newline="") as text:
        csv.writer(text).writerows([header, *rows])
    return file


@pytest.fixture(scope="module")
def hidden(path):
    return morembs.read_body(path).bodies["some-basis"].parametric.at(**HIDDEN)


def test_hidden_values_are_printed_and_written(path, hidden, tmp_path):
    rows = [(k + 1, repr(f)) for k, f in enumerate(hidden.frequencies_hz[:6].tolist())]
    measured = write(tmp_path / "measured.csv", ["mode", "frequency_hz"], rows)
    out = tmp_path / "updated.h5"
    text = run(path, "--measured", measured, "--fix", "rho", "-o", out)
    assert "rho = 7850 kg/m3  kept" in text and "E_arm = 1.8e+11 Pa  +- " in text and f"written: {out}" in text
    written = morembs.read_body(out).bodies["some-basis"].frequencies_hz[6:12]
    np.testing.assert_allclose(written, hidden.frequencies_hz[:6], rtol=1e-7)
    (document,) = json.loads(run(path, "--measured", measured, "--json"))
    assert set(document["untold"][0]) == {"E_arm", "E_rest", "rho"} and document["sigma"][0] is None
    assert "not identifiable from these frequencies: E_arm" in run(path, "--measured", measured)
    known = json.loads(run(path, "--measured", measured, "--prior", "rho=1", "--json"))[0]
    assert known["untold"] == [] and known["values"]["E_rest"] == pytest.approx(2.35e11, rel=1e-2)


def test_shapes_pair_modes_by_the_nodes_of_the_file(path, hidden, tmp_path):
    source = morembs.read_body(path)
    order, random = [2, 0, 1], np.random.default_rng(3)
    nodes = random.choice(len(source.node_ids), 12, replace=False)
    basis = source.bodies["some-basis"].basis().reshape(len(source.node_ids), 3, -1)
    rows = []
    for number, k in enumerate(order, 1):
        shape = basis[nodes] @ hidden.Y[:, 6 + k]
        rows += [(number, int(source.node_ids[node]), *u) for node, u in zip(nodes, shape.tolist(), strict=True)]
    shapes = write(tmp_path / "shapes.csv", ["mode", "id", "ux", "uy", "uz"], rows)
    frequencies = [(n, repr(float(hidden.frequencies_hz[k])), 5.0) for n, k in enumerate(order, 1)]
    measured = write(tmp_path / "measured.csv", ["mode", "frequency_hz", "sigma_hz"], frequencies)
    (document,) = json.loads(run(path, "--measured", measured, "--shapes", shapes, "--fix", "rho", "--json"))
    assert document["values"] == pytest.approx({**HIDDEN, "rho": 7850.0}, rel=1e-4)


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        (["mode", "hz"], [(1, 2)], "expected mode,frequency_hz"),
        (["mode", "frequency_hz"], [], "above 0 rows"),
        (["mode", "frequency_hz", "sigma"], [(1, 7000, 2)], "expected mode,frequency_hz (sigma_hz if known)"),
        (["mode", "frequency_hz"], [(1, "a")], "row 1 below its header: could not convert"),
        (["mode", "frequency_hz"], [(1, "nan")], "row 1 below its header is 1,nan; expected 2 finite numbers"),
        (["mode", "frequency_hz"], [(1, 7878, 9)], "row 1 below its header has 3 values; expected 2"),
        (["mode", "frequency_hz"], [(1, 7878), (2, 14668, 9)], "row 2 below its header has 3 values"),
        (["mode", "frequency_hz"], [(1.5, 7000)], "expected integers"),
        (["mode", "frequency_hz"], [(1, 7000), (1, 8000)], "expected different ones"),
    ],
)
def test_tables_that_cannot_be_used_are_refused(path, tmp_path, header, rows, message):
    assert message in run(path, "--measured", write(tmp_path / "m.csv", header, rows), code=2)


def test_options_that_cannot_be_used_are_refused(path, tmp_path):
    measured = write(tmp_path / "m.csv", ["mode", "frequency_hz"], [(1, 7000.0), (2, 14000.0)])
    assert "did you mean" in run(path, "--measured", measured, "--fix", "roh", code=2)
    both = run(path, "--measured", measured, "--fix", "rho", "--prior", "rho=1", code=2)
    assert "rho was fixed and given a prior" in both
    assert "--prior rho=x was given" in run(path, "--measured", measured, "--prior", "rho=x", code=2)
    assert "would overwrite a file that is read" in run(path, "--measured", measured, "-o", measured, code=2)
    assert "cannot be read" in run(path, "--measured", tmp_path / "absent.csv", code=2)
    columns = ["mode", "id", "ux", "uy", "uz"]
    shapes = write(tmp_path / "s.csv", columns, [(1, 1234567, 0, 0, 1)])
    assert "the node 1234567" in run(path, "--measured", measured, "--shapes", shapes, code=2)
    node = int(morembs.read_body(path).node_ids[0])
    shapes = write(tmp_path / "s.csv", columns, [(1, node, 0, 0, 1), (2, node, 0, 0, 1), (1, node, 0, 1, 0)])
    assert f"the node {node} twice in mode 1" in run(path, "--measured", measured, "--shapes", shapes, code=2)


def test_headers_may_have_spaces(path, hidden, tmp_path):
    rows = [(k + 1, repr(f)) for k, f in enumerate(hidden.frequencies_hz[:6].tolist())]
    measured = write(tmp_path / "measured.csv", ["mode ", " frequency_hz"], rows)
    assert "E_arm = 1.8e+11 Pa" in run(path, "--measured", measured, "--fix", "rho")
