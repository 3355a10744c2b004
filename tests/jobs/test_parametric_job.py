"""Jobs with [[parameter]]: what they take, what they refuse, and the page that shows them."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
import scipy.linalg as sl
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.app.jobs.check import check_job
from morembs.app.jobs.job import load_job
from morembs.app.jobs.stages.model import mesh_of
from morembs.app.jobs.stages.parameters import parameters_of
from morembs.base.errors import InputError
from morembs.body.file import read_body
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.problem import Problem
from tests.support.meshes import box
from tests.support.parametric import BRACKET, STEEL, bracket, interfaces, longer, parameters, parametric_file
from tests.support.refusals import refusal

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "parametric.md").read_text()
JOB = re.search(r"```toml\n(.*?)```", PAGE, re.DOTALL)[1]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "bracket.inp").write_bytes(BRACKET.read_bytes())
    mesh = bracket()
    rows = zip(mesh.nodes.ids.tolist(), (1e3 * longer(mesh).displacement).tolist(), strict=True)
    lines = [f"{label},{x!r},{y!r},{z!r}" for label, (x, y, z) in rows if z]
    (tmp_path / "longer.csv").write_text("\n".join(["id,dx,dy,dz", *lines]))
    return tmp_path


def job(folder, *changes):
    text = JOB
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / "job.toml").write_text(text)
    return load_job(folder / "job.toml")


def parameters_in(folder, *changes):
    loaded = job(folder, *changes)
    return parameters_of(loaded, mesh_of(loaded))


def test_the_job_of_the_page_has_its_parameters_in_si_units(folder):
    loaded = job(folder)
    E, t = parameters_of(loaded, mesh_of(loaded))[1]
    assert (E.low, E.high, E.nominal) == pytest.approx((1.5e11, 2.7e11, 2.1e11))
    assert (t.low, t.high, t.nominal) == (-3.0, 3.0, 0.0)
    np.testing.assert_allclose(t.displacement, longer(bracket()).displacement, atol=1e-15)
    assert check_job(loaded).coupled_dofs == 1839


@pytest.fixture(scope="module")
def bracket_file(tmp_path_factory):
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        return parametric_file(
            tmp_path_factory.mktemp("bracket") / "bracket.h5", problem, name="parametric", nodes="skin"
        )


def test_the_program_of_the_page_runs(bracket_file, tmp_path, monkeypatch):
    shutil.copyfile(bracket_file, tmp_path / "bracket.h5")
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, names)
    assert np.abs(names["slope"].position(names["part"].marker("TIP"))).max() > 0
    assert (tmp_path / "at.h5").exists()


def test_a_morph_may_be_another_mesh(folder):
    mesh = bracket()
    moved = mesh.nodes.xyz + longer(mesh).displacement
    head, _, tail = BRACKET.read_text().partition("*NODE\n")
    elements = tail[tail.index("*") :]
    rows = (f"{i}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in zip(mesh.nodes.ids, (1e3 * moved).tolist(), strict=True))
    (folder / "other.inp").write_text(head + "*NODE\n" + "\n".join(rows) + "\n" + elements)
    _, (_, t) = parameters_in(folder, ('displacement = "longer.csv"', 'mesh = "other.inp"'))
    np.testing.assert_allclose(t.displacement, longer(mesh).displacement, atol=1e-12)


def test_elements_may_be_chosen_by_the_place_of_their_centres(folder):
    mesh, (E, _) = parameters_in(
        folder, ('set = ["Volume2", "Volume3", "Volume4", "Volume5"]', 'set = "box:-50,0,0,50,10,50"')
    )
    (block,) = mesh.blocks
    centres = 1e3 * mesh.nodes.xyz[block.nodes].mean(axis=1)
    expected = np.flatnonzero((centres[:, 1] <= 10) & (centres[:, 2] <= 50) & (centres[:, 2] >= 0))
    assert np.array_equal(mesh.element_sets[E.sets[0]][0], expected)
    assert 0 < len(expected) < len(centres)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('property = "young"', 'property = "yong"'), ("unknown", "property", "young")),
        (('property = "young"', 'property = "speed"'), ("value", "property", "[spin]")),
        (('property = "young"', 'property = "spring"'), ("missing", "stiffness")),
        (('property = "young"', 'property = "preload"'), ("conflict", "set", "preload")),
        (("range = [-3.0, 3.0]", 'range = [-3.0, 3.0]\nto = "TIP"'), ("conflict", "property")),
        (("[[reduce]]", "[preload]\nwrench = { TIP = [1, 0, 0, 0, 0, 0] }\n[[reduce]]"), ("conflict", "preload")),
        (('"Volume2", ', '"Volume22", '), ("unknown", "set", "Volume2")),
        (("range = [1.5e5, 2.7e5]", "range = [2.7e5, 1.5e5]"), ("value", "range", "HIGH")),
        (("range = [1.5e5, 2.7e5]", "range = [0, 2.7e5]"), ("value", "range")),
        (("range = [1.5e5, 2.7e5]", "range = [1.5e5, 2.0e5]"), ("value", "nominal")),
        (('displacement = "longer.csv"', 'displacement = "absent.csv"'), ("file", "table")),
        (('displacement = "longer.csv"\n', ""), ("missing", "displacement")),
        (
            ('method = "parametric"\nband_hz = [0, 30000]\ntolerance = 1e-3', 'method = "guyan"'),
            ("missing", "parameter"),
        ),
        (('name = "t"', 'name = "2t"'), ("value", "name")),
    ],
)
def test_wrong_parameters_of_jobs_are_refused(folder, change, message):
    with refusal(*message):
        parameters_in(folder, change)


def test_a_method_without_parameters_and_parameters_without_a_mesh_are_refused(folder):
    text = JOB[: JOB.index("[[parameter]]")] + JOB[JOB.index("[[reduce]]") :]
    (folder / "job.toml").write_text(text)
    with refusal("missing", "method"):
        load_job(folder / "job.toml")
    text = JOB[JOB.index("[[parameter]]") :]
    (folder / "job.toml").write_text('[model]\nfile = "a.model.h5"\n' + text)
    with refusal("unsupported", "file", "[model]"):
        load_job(folder / "job.toml")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("id,x,y,z\n3,0,0,1\n", ("value", "columns")),
        ("id,dx,dy,dz\n3,0,0\n", ("value", "columns", "4")),
        ("id,dx,dy,dz\n99999,0,0,1\n", ("unknown", "displacement", "99999")),
        ("id,dx,dy,dz\n3.5,0,0,1\n", ("unknown", "displacement", "3.5")),
        ("id,dx,dy,dz\n3,0,0,1\n3,0,0,1\n", ("conflict", "displacement")),
    ],
)
def test_wrong_tables_of_displacements_are_refused(folder, table, message):
    (folder / "longer.csv").write_text(table)
    with refusal(*message):
        parameters_in(folder)


def test_displacements_that_are_not_finite_are_refused(folder):
    (folder / "longer.csv").write_text("id,dx,dy,dz\n1,0,0,nan\n")
    with refusal("value", "values", "4"):
        parameters_in(folder)


def test_a_table_of_displacements_with_another_header_is_told_once(folder):
    (folder / "longer.csv").write_text("node;dx;dy;dz\n1;0;0;1\n")
    with pytest.raises(InputError) as caught:
        parameters_in(folder)
    assert "expected id,dx,dy,dz" in str(caught.value) and "cannot be read" not in str(caught.value)


def test_a_table_of_displacements_may_have_the_mark_of_its_encoding(folder):
    (folder / "longer.csv").write_text((folder / "longer.csv").read_text(), encoding="utf-8-sig")
    np.testing.assert_allclose(parameters_in(folder)[1][1].displacement, longer(bracket()).displacement, atol=1e-15)


def test_another_mesh_must_have_the_same_nodes(folder):
    (folder / "block.msh").write_bytes((BRACKET.parent / "block.msh").read_bytes())
    with refusal("conflict", "", "bracket.inp", "844"):
        parameters_in(folder, ('displacement = "longer.csv"', 'mesh = "block.msh"'))


BEAM = """
[model]
mesh = "beam.vtk"
units = "mm-t-s"
[[material]]
young = {young}
poisson = 0.3
density = 7.85e-9
[[interface]]
name = "root"
nodes = "box:0,0,0,0,20,20"
[[interface]]
name = "tip"
nodes = "box:500,0,0,500,20,20"
{more}
[[reduce]]
name = "beam"
method = "{method}"
{options}
[output]
path = "{method}.h5"
"""
YOUNG = """
[[parameter]]
name = "E"
property = "young"
range = [1.5e5, 2.5e5]
"""
SEARCH = "band_hz = [0, 3000]\ntolerance = 1e-2\ntraining = 8"
PULLED = "[preload]\nwrench = {{ root = [{0}, 0, 0, 0, 0, 0], tip = [{1}, 0, 0, 0, 0, 0] }}\n"


def beam(folder, method, options, more, young=2.1e5):
    """The body file of a beam, written by the command line."""
    mesh = box("hex20", (6, 1, 1), (500.0, 20.0, 20.0))
    cells = [("hexahedron20", mesh.blocks[0].nodes)]
    meshio.Mesh(np.array(mesh.nodes.xyz), cells).write(folder / "beam.vtk", binary=True)
    (folder / f"{method}.toml").write_text(BEAM.format(method=method, options=options, more=more, young=young))
    result = CliRunner().invoke(app, ["reduce", str(folder / f"{method}.toml")])
    assert result.exit_code == 0, result.stderr
    return folder / f"{method}.h5"


def at_values(path, values):
    result = CliRunner().invoke(app, ["evaluate", str(path), "--at", values, "-o", str(path.with_name("at.h5"))])
    assert result.exit_code == 0, result.stderr
    return next(iter(read_body(path.with_name("at.h5")).bodies.values()))


def test_a_preload_is_a_factor_of_the_loads_of_the_job(tmp_path):
    load = '[[parameter]]\nname = "f"\nproperty = "preload"\nrange = [0, 2]\n'
    path = beam(tmp_path, "parametric", SEARCH, PULLED.format(-4e4, 4e4) + YOUNG + load)
    found = at_values(path, "f=1.75,E=1.8e11")
    plain = beam(tmp_path, "craig-bampton", "modes = 40", PULLED.format(-7e4, 7e4), young=1.8e5)
    expected = next(iter(read_body(plain).bodies.values()))
    np.testing.assert_allclose(found.frequencies_hz[6:9], expected.frequencies_hz[6:9], rtol=1e-4)
    assert found.floating is not None
    rest = at_values(path, "f=0,E=1.8e11")
    assert expected.frequencies_hz[6] > 1.02 * rest.frequencies_hz[6]


def test_the_spring_of_the_page_holds_a_body(tmp_path):
    spring = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[1].replace("FOOT", "root")
    found = at_values(beam(tmp_path, "parametric", SEARCH, YOUNG + spring), "k=3,E=1.8e11")
    model = assemble(box("hex20", (6, 1, 1), (0.5, 0.02, 0.02)), [replace(STEEL, stiffness=STEEL.stiffness * 6 / 7)])
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(np.isclose(model.nodes.xyz[:, 0], x)))
        for name, x in (("root", 0.0), ("tip", 0.5))
    ]
    with Problem(model, ends) as free:
        F = free.coupling.frames[:, free.coupling.frame_columns["root"]].toarray()
        K = free.K.toarray() + 3.0 * F @ np.diag([3e7, 3e7, 3e7, 1e3, 1e3, 1e3]) @ F.T
        true = np.sqrt(sl.eigh(K, free.M.toarray(), eigvals_only=True, subset_by_index=[0, 4])) / (2 * np.pi)
    np.testing.assert_allclose(found.frequencies_hz[:5], true, rtol=1e-4)


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """The file of a beam with its modulus as a parameter, and what its comparison with another reduction says."""
    folder = tmp_path_factory.mktemp("compared")
    second = '\n[[reduce]]\nname = "fixed"\nmethod = "craig-bampton"\nmodes = 30'
    path = beam(folder, "parametric", SEARCH + second + "\n[certify]\nband_hz = [0, 3000]", YOUNG)
    result = CliRunner().invoke(app, ["compare", str(path.with_suffix(".toml")), "--json"])
    assert result.exit_code == 0, result.stderr
    return path, json.loads(result.stdout)


def test_a_comparison_is_of_nominal_values(compared):
    found = {each["name"]: each for each in compared[1][0]["contenders"]}
    assert found["beam"]["bound"] < 1e-2 and found["fixed"]["method"] == "craig-bampton"


def test_a_part_of_an_assembly_takes_values(compared, tmp_path):
    path, _ = compared
    parts = '[[substructure]]\nname = "{}"\nbody = "{}"\nreduction = "beam"\nposition = [{}, 0, 0]\n{}\n'
    job = """[[couple]]
between = ["a:tip", "b:root"]
[model]
units = "mm-t-s"
[[reduce]]
method = "modal"
modes = 6
[output]
path = "two.h5"
"""

    def frequencies(first, given):
        text = parts.format("a", first, 0, given) + parts.format("b", path, 500, "") + job
        (tmp_path / "two.toml").write_text(text)
        result = CliRunner().invoke(app, ["reduce", str(tmp_path / "two.toml")])
        if result.exit_code:
            return result.stderr
        return next(iter(read_body(tmp_path / "two.h5").bodies.values())).frequencies_hz

    at = tmp_path / "soft.h5"
    command = ["evaluate", str(path), "--body", "beam", "--at", "E=1.6e11", "-o", str(at)]
    assert CliRunner().invoke(app, command).exit_code == 0
    soft = frequencies(path, "at = { E = 1.6e11 }")
    np.testing.assert_allclose(soft[6:], frequencies(at, "")[6:], rtol=1e-9)
    assert soft[6] < 0.97 * frequencies(path, "")[6]
    error = " ".join(frequencies(path, "at = { E = 1e11 }").split())
    assert "substructure 'a': at was given: E = 1e+11 lies outside [1.5e+11, 2.5e+11]" in error
    error = " ".join(frequencies(at, "at = { E = 1.6e11 }").split())
    assert "substructure 'a': at was given: body 'beam' has no parameters" in error


def test_motions_are_recovered_on_the_mesh_of_a_value(bracket_file, tmp_path):
    body = read_body(bracket_file).bodies["parametric"].parametric
    n = len(body.at().M)
    q = np.random.default_rng(4).standard_normal((2, n)) * 1e-9
    np.savez(tmp_path / "motion.npz", times=[0.0, 1.0], coordinates=q)
    out = tmp_path / "motion.vtkhdf"
    command = ["recover", str(bracket_file), str(tmp_path / "motion.npz"), "-o", str(out), "--at", "t=2"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2 and "add --no-stress" in " ".join(result.stderr.split())
    result = CliRunner().invoke(app, [*command, "--no-stress"])
    assert result.exit_code == 0, result.stderr
    with h5py.File(out) as file:
        points, shown = file["VTKHDF/Points"][()], file["VTKHDF/PointData/displacement"][()]
    places, nominal = body.at(t=2.0).bodies.coordinates, body.source.coordinates
    np.testing.assert_allclose(points[: len(places)], places, atol=1e-7)
    assert np.abs(places - nominal).max() == pytest.approx(2e-3)
    basis = np.asarray(body.stored.basis()).reshape(len(places), 3, n)
    np.testing.assert_allclose(shown[: len(places)], basis @ q[0], rtol=1e-5, atol=1e-15)
