"""``morembs evaluate`` and the export of bodies at values of their parameters."""

import csv
import json
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

import morembs
from morembs.app.cli import app
from morembs.body import make_part
from morembs.body.build import BodyOptions, build_body
from morembs.body.file import write_body
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.reducers import ParametricReducer
from tests.support.commands import run
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, parametric_file
from tests.support.stored import datasets


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        return parametric_file(tmp_path_factory.mktemp("bodies") / "bracket.h5", problem, nodes="interfaces")


@pytest.fixture(scope="module")
def proven(tmp_path_factory):
    """A body with a bound."""
    varied = varied_model(bracket(), [STEEL], parameters()[:2])
    reducer = ParametricReducer(band_hz=[0.0, 12000.0], tolerance=1e-2, training=4)
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        reduced = reducer.reduce(problem)
        variation = reducer.variation(problem, reduced)
        body = build_body(problem, reduced, make_part(problem, "interfaces"), BodyOptions(), variation=variation)
        return write_body(tmp_path_factory.mktemp("proven") / "bracket.h5", [body])


@pytest.fixture
def table(tmp_path):
    file = tmp_path / "p.csv"
    file.write_text("E_arm,t\n1.6e11,-2\n2.6e11,2.5\n")
    return file


def test_a_body_at_values_is_written(path, tmp_path):
    out = tmp_path / "at.h5"
    text = run("evaluate", path, "--at", "E_arm=2.0e11, t=1.5", "-o", out)
    body = morembs.read_body(path).bodies["some-basis"].parametric
    expected = body.at(E_arm=2.0e11, t=1.5).frequencies_hz
    assert f"{expected[0]:,.7g}" in text
    assert "E_arm = 2e+11 Pa" in text
    np.testing.assert_allclose(morembs.read_body(out).bodies["some-basis"].frequencies_hz[6:], expected, rtol=1e-12)


def test_derivatives_of_frequencies_are_shown(path):
    (document,) = json.loads(run("evaluate", path, "--at", "t=1.0", "--sensitivity", "--frequencies", "4", "--json"))
    s = morembs.read_body(path).bodies["some-basis"].parametric.sensitivity(t=1.0)
    assert document["frequency_slopes"]["t"] == pytest.approx(s.frequencies_hz["t"][:4].tolist())
    assert document["clustered"] == [False] * 4
    assert document["bound_kind"] == "none"


def test_tables_give_frequencies_and_matrices(path, table, tmp_path):
    body = morembs.read_body(path).bodies["some-basis"].parametric
    rows = list(csv.DictReader(run("evaluate", path, "--table", table, "--frequencies", "3").splitlines()))
    assert [float(row["t"]) for row in rows] == [-2.0, 2.5]
    assert [float(row["rho"]) for row in rows] == [7850.0] * 2
    for row in rows:
        expected = body.at(E_arm=float(row["E_arm"]), t=float(row["t"])).frequencies_hz[:3]
        assert [float(row[f"frequency_{k}_hz"]) for k in (1, 2, 3)] == pytest.approx(expected.tolist(), rel=1e-8)
    out = tmp_path / "t.h5"
    run("evaluate", path, "--table", table, "--out", out, "--matrices")
    with h5py.File(out) as file:
        assert np.array_equal(file["K"][1], body.at(E_arm=2.6e11, t=2.5).K)
        assert file["frequencies_hz"].shape == (2, 6)


def test_a_body_at_values_is_exported(path, tmp_path):
    whole, nominal = tmp_path / "whole.h5", tmp_path / "nominal.hdf5"
    run("evaluate", path, "--at", "t=1.5", "-o", whole)
    run("export", path, "--to", "exudyn", "-o", nominal)
    files = [tmp_path / "at.hdf5", tmp_path / "other.hdf5", nominal]
    run("export", path, "--at", "t=1.5", "--to", "exudyn", "-o", files[0])
    run("export", whole, "--to", "exudyn", "-o", files[1])
    one, other, nominal = (numbers(file) for file in files)
    assert one.keys() == other.keys()
    assert all(np.array_equal(values, other[name]) for name, values in one.items())
    assert any(not np.array_equal(values, nominal[name]) for name, values in one.items())


def numbers(file):
    return {name: value for name, value in datasets(file).items() if value.dtype.kind in "iuf"}


def test_a_family_is_exported_with_an_index(path, table, tmp_path):
    run("export", path, "--table", table, "--to", "sid", "-o", tmp_path / "arm.SID_FEM")
    rows = list(csv.DictReader((tmp_path / "index.csv").read_text().splitlines()))
    assert [row["file"] for row in rows] == ["arm_1.SID_FEM", "arm_2.SID_FEM"]
    assert float(rows[1]["E_arm"]) == 2.6e11
    assert all((tmp_path / row["file"]).stat().st_size for row in rows)
    assert (tmp_path / "arm_1.SID_FEM").read_bytes() != (tmp_path / "arm_2.SID_FEM").read_bytes()


def test_an_index_never_tells_of_values_that_its_files_no_longer_have(path, table, tmp_path):
    first = tmp_path / "arm.SID_FEM"
    assert "2 bodies as arm_N.SID_FEM" in run("export", path, "--table", table, "--to", "sid", "-o", tmp_path / "arm")
    table.write_text("E_arm,t\n2.6e11,-1\n1.6e11,2\n")
    # The export ends at its second file.
    (tmp_path / "arm_2.SID_FEM").unlink()
    (tmp_path / "arm_2.SID_FEM").mkdir()
    before = (tmp_path / "arm_1.SID_FEM").read_bytes()
    run("export", path, "--table", table, "--to", "sid", "-o", first, code=2)
    assert (tmp_path / "arm_1.SID_FEM").read_bytes() != before and not (tmp_path / "index.csv").exists()


def test_a_smaller_family_does_not_leave_files_of_the_one_before(path, table, tmp_path):
    out = tmp_path / "arm.SID_FEM"
    table.write_text(table.read_text() + "2.0e11,1.5\n")
    run("export", path, "--table", table, "--to", "sid", "-o", out)
    index, first = (tmp_path / "index.csv").read_bytes(), (tmp_path / "arm_1.SID_FEM").read_bytes()
    table.write_text("E_arm,t\n2.6e11,-1\n")
    error = run("export", path, "--table", table, "--to", "sid", "-o", out, code=2).replace("\n", " ")
    assert "arm_2.SID_FEM, arm_3.SID_FEM" in error and "delete them, or give another folder" in error
    assert (tmp_path / "index.csv").read_bytes() == index and (tmp_path / "arm_1.SID_FEM").read_bytes() == first
    for name in ("arm_2.SID_FEM", "arm_3.SID_FEM"):
        (tmp_path / name).unlink()
    run("export", path, "--table", table, "--to", "sid", "-o", out)
    assert [row["file"] for row in csv.DictReader((tmp_path / "index.csv").read_text().splitlines())] == [
        "arm_1.SID_FEM"
    ]


def test_frequencies_that_a_body_does_not_have_are_told(path):
    result = CliRunner().invoke(app, ["evaluate", str(path), "--at", "t=1.0", "--frequencies", "500", "--json"])
    (document,) = json.loads(result.stdout)
    has = len(document["frequencies_hz"])
    assert has < 500 and f"500 frequencies were asked for; the body has {has}" in result.stderr
    assert run("evaluate", path, "--at", "t=1.0", "--frequencies", str(has))
    error = run("evaluate", path, "--at", "E_arm=3e11", "--frequencies", "500", code=2)
    assert "were asked for" not in error


def test_a_family_does_not_replace_the_index_of_another(path, table, tmp_path):
    run("export", path, "--table", table, "--to", "sid", "-o", tmp_path / "arm.SID_FEM")
    index = (tmp_path / "index.csv").read_bytes()
    error = run("export", path, "--table", table, "--to", "sid", "-o", tmp_path / "leg.SID_FEM", code=2)
    assert "tells the values of arm_1.SID_FEM, of another family; give this one a folder" in error.replace("\n", " ")
    assert (tmp_path / "index.csv").read_bytes() == index and not list(tmp_path.glob("leg*"))
    run("export", path, "--table", table, "--to", "sid", "-o", tmp_path / "arm.SID_FEM")
    (tmp_path / "index.csv").write_text("my notes\n")
    error = run("export", path, "--table", table, "--to", "sid", "-o", tmp_path / "arm.SID_FEM", code=2)
    assert "is no list of files" in error and (tmp_path / "index.csv").read_text() == "my notes\n"


def test_bounds_are_a_column_for_each_frequency(proven, tmp_path):
    body = morembs.read_body(proven).bodies["parametric"].parametric
    table = tmp_path / "p.csv"
    table.write_text("E_arm\n1.6e11\n2.6e11\n")
    out = tmp_path / "t.h5"
    rows = list(csv.DictReader(run("evaluate", proven, "--table", table, "--bound", "0,1e4").splitlines()))
    run("evaluate", proven, "--table", table, "--bound", "0,1e4", "--out", out)
    (document,) = json.loads(run("evaluate", proven, "--at", "E_arm=2.6e11", "--bound", "0,1e4", "--json"))
    with h5py.File(out) as file:
        for row, stored, E in zip(rows, file["bound"][()], (1.6e11, 2.6e11), strict=True):
            bounds = body.at(E_arm=E).bound([0.0, 1e4])
            assert (np.isfinite(bounds) & (bounds > 0)).all() and np.array_equal(stored, bounds)
            assert [float(row["bound_at_0_hz"]), float(row["bound_at_10000_hz"])] == bounds.tolist()
            assert row["bound_kind"] == "bound"
        assert document["bound"] == pytest.approx(file["bound"][1].tolist(), rel=1e-9)
    assert "error of H at 10000 Hz, proven bound: " in run("evaluate", proven, "--at", "E_arm=2e11", "--bound", "1e4")


def test_the_lemmas_of_the_bound_are_stored_printed_and_documented(path, proven):
    proof = [asdict(lemma) for lemma in morembs.read_body(proven).bodies["parametric"].parametric.proof]
    with h5py.File(proven) as file:
        assert json.loads(file["bodies/parametric/parametric/proof"][()])["lemmas"] == proof
    with h5py.File(path) as file:
        assert "proof" not in file["bodies/some-basis/parametric"]
    shown = run("info", proven, "--proof")
    proofs = (Path(__file__).parents[2] / "docs" / "background" / "proofs.md").read_text()
    assert "bounds of parametric at all values" in shown
    for lemma in proof:
        assert f"  {lemma['name']} (proven): {lemma['statement']}" in shown and f"\n### {lemma['name']}\n" in proofs
    (document,) = json.loads(run("info", proven, "--proof", "--json"))
    assert document["bodies"]["parametric"]["bound_proof"] == proof


def test_an_update_names_the_modes_above_the_band_of_the_bound(proven, tmp_path):
    measured = tmp_path / "measured.csv"
    measured.write_text("mode,frequency_hz\n1,7800\n2,14500\n")
    assert "note: modes 2 lie above the band" in run("update", proven, "--measured", measured)
    (document,) = json.loads(run("update", proven, "--measured", measured, "--json"))
    assert document["above_band"] == [2]


def test_where_there_is_no_bound_it_is_said(path, proven, table):
    for file, hz, kind in ((proven, "1e6,9", "bound"), (path, "9", "none")):
        text = run("evaluate", file, "--at", "E_arm=2e11", "--bound", hz)
        assert f"error of H at {float(hz.partition(',')[0]):.12g} Hz, no bound there" in text
        (document,) = json.loads(run("evaluate", file, "--at", "E_arm=2e11", "--bound", hz, "--json"))
        assert document["bound"][0] is None and document["bound_kind"] == kind
    (document,) = json.loads(run("evaluate", path, "--table", table, "--bound", "9,10", "--json"))
    assert document["bound"] == [[None, None]] * 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at", "E_arm=3e11"], "E_arm = 3e+11 lies outside [1.5e+11, 2.7e+11]; the bound does not hold there"),
        (["--at", "E_amr=2e11"], "did you mean 'E_arm'"),
        (["--at", "E_arm=soft"], "expected NAME=NUMBER"),
        (["--at", "t=1,t=2"], "given twice"),
        ([], "--at NAME=VALUE,... for one body, or --table"),
        (["--table", "absent.csv"], "cannot be read"),
        (["--at", "t=1", "--table", "absent.csv"], "evaluate needs values"),
        (["--at", "t=1", "--matrices"], "it needs --table"),
        (["--at", "t=1", "--out", "f.csv"], "--out f.csv was given for --at, which writes a body file"),
        (["--at", "t=1", "--frequencies", "-3"], "--frequencies -3 was given; expected a number, 1 or more"),
        (["--at", "t=1", "--bound", "100,-3"], "--bound 100,-3 was given; expected frequencies in Hz"),
        (["--at", "t=1", "--bound", "nan"], "--bound nan was given; expected frequencies in Hz"),
    ],
)
def test_wrong_values_are_refused(path, arguments, message):
    error = run("evaluate", path, *arguments, code=2)
    assert error.startswith("error: ")
    assert message in error.replace("\n", " ")


def test_wrong_rows_of_tables_are_named(path, tmp_path):
    table = tmp_path / "p.csv"
    for text, message in (
        ("E_arm,t\n2e11,0\n2e11,5\n", "row 2 below its header: t = 5 lies outside [-3, 3]"),
        ("E_arm,t\n2e11,0\n2e11\n", "row 2 below its header has 1 values; expected 2"),
        ("E_arm,t\n2e11,soft\n", "expected 2 finite numbers"),
        ("E_arm,E_arm\n2e11,2e11\n", "each name once"),
        ("E_arm\n", "above 0 rows"),
    ):
        table.write_text(text)
        error = run("evaluate", path, "--table", table, code=2)
        assert message in error.replace("\n", " ")


def test_a_table_of_a_spreadsheet_with_a_mark_of_its_encoding_is_read(path, table):
    plain = run("evaluate", path, "--table", table)
    table.write_text(table.read_text(), encoding="utf-8-sig")
    assert run("evaluate", path, "--table", table) == plain


def test_the_index_of_a_family_does_not_overwrite_its_table(path, table, tmp_path):
    given = table.rename(tmp_path / "index.csv").read_bytes()
    error = run("export", path, "--table", tmp_path / "index.csv", "--to", "sid", "-o", tmp_path / "a.SID_FEM", code=2)
    assert "index.csv would overwrite a file that is read" in error.replace("\n", " ")
    assert [file.name for file in tmp_path.iterdir()] == ["index.csv"]
    assert (tmp_path / "index.csv").read_bytes() == given


def test_info_says_that_figures_are_those_of_nominal_values(path, tmp_path):
    assert "parameters, shown at nominal values" in run("info", path)
    run("evaluate", path, "--at", "t=1", "-o", tmp_path / "at.h5")
    assert "nominal" not in run("info", tmp_path / "at.h5")


def test_a_body_without_parameters_says_so(path, tmp_path):
    out = tmp_path / "at.h5"
    run("evaluate", path, "--at", "t=1", "-o", out)
    assert 'has no parameters; make it with method = "parametric"' in run("evaluate", out, "--at", "t=1", code=2)
