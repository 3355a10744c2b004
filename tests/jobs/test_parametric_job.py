"""Jobs with [[parameter]]: what they take, what they refuse, and the page that shows them."""

import re
from pathlib import Path

import numpy as np
import pytest

from morembs.errors import InputError
from morembs.jobs.check import check_job
from morembs.jobs.inputs import mesh_of
from morembs.jobs.job import load_job
from morembs.jobs.parameters import parameters_of
from morembs.parametric.terms import AffineProblem, varied_model
from tests.support.parametric import BRACKET, STEEL, bracket, interfaces, longer, parameters, parametric_file

PAGE = (Path(__file__).parents[2] / "docs" / "parametric.md").read_text()
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


def test_the_program_of_the_page_runs(folder, monkeypatch):
    monkeypatch.chdir(folder)
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        parametric_file("bracket.h5", problem, name="parametric", nodes="skin")
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL):
        exec(block, names)
    assert np.abs(names["slope"].position(names["part"].marker("TIP"))).max() > 0
    assert (folder / "at.h5").exists()


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
        (('property = "young"', 'property = "yong"'), "did you mean 'young'"),
        (('property = "young"', 'property = "spring"'), "not supported yet"),
        (('"Volume2", ', '"Volume22", '), "did you mean 'Volume2'"),
        (("range = [1.5e5, 2.7e5]", "range = [2.7e5, 1.5e5]"), r"expected \[LOW, HIGH\]"),
        (("range = [1.5e5, 2.7e5]", "range = [0, 2.7e5]"), "positive values"),
        (("range = [1.5e5, 2.7e5]", "range = [1.5e5, 2.0e5]"), "nominal = 2.1e.11 lies outside"),
        (('displacement = "longer.csv"', 'displacement = "absent.csv"'), "cannot be read"),
        (('displacement = "longer.csv"\n', ""), "a morph needs displacement or mesh"),
        (('method = "parametric"\nband_hz = [0, 30000]\ntolerance = 1e-3', 'method = "guyan"'), "add a .*reduce"),
        (('name = "t"', 'name = "2t"'), "letters, digits"),
    ],
)
def test_wrong_parameters_of_jobs_are_refused(folder, change, message):
    with pytest.raises(InputError, match=message):
        parameters_in(folder, change)


def test_a_method_without_parameters_and_parameters_without_a_mesh_are_refused(folder):
    text = JOB[: JOB.index("[[parameter]]")] + JOB[JOB.index("[[reduce]]") :]
    (folder / "job.toml").write_text(text)
    with pytest.raises(InputError, match="needs parameters"):
        load_job(folder / "job.toml")
    text = JOB[JOB.index("[[parameter]]") :]
    (folder / "job.toml").write_text('[model]\nfile = "a.model.h5"\n' + text)
    with pytest.raises(InputError, match=r"parameters need a mesh \(\[model\] mesh\)"):
        load_job(folder / "job.toml")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("id,x,y,z\n3,0,0,1\n", "expected the header 'id,dx,dy,dz'"),
        ("id,dx,dy,dz\n3,0,0\n", "three numbers"),
        ("id,dx,dy,dz\n99999,0,0,1\n", "names the node 99999"),
        ("id,dx,dy,dz\n3,0,0,1\n3,0,0,1\n", "twice"),
    ],
)
def test_wrong_tables_of_displacements_are_refused(folder, table, message):
    (folder / "longer.csv").write_text(table)
    with pytest.raises(InputError, match=message):
        parameters_in(folder)


def test_displacements_that_are_not_finite_are_refused(folder):
    (folder / "longer.csv").write_text("id,dx,dy,dz\n1,0,0,nan\n")
    with pytest.raises(InputError, match="has a displacement that is not finite"):
        parameters_in(folder)


def test_a_table_of_displacements_with_another_header_is_told_once(folder):
    (folder / "longer.csv").write_text("node;dx;dy;dz\n1;0;0;1\n")
    with pytest.raises(InputError) as caught:
        parameters_in(folder)
    assert "expected the header 'id,dx,dy,dz'" in str(caught.value) and "cannot be read" not in str(caught.value)


def test_a_table_of_displacements_may_have_the_mark_of_its_encoding(folder):
    (folder / "longer.csv").write_text((folder / "longer.csv").read_text(), encoding="utf-8-sig")
    np.testing.assert_allclose(parameters_in(folder)[1][1].displacement, longer(bracket()).displacement, atol=1e-15)


def test_another_mesh_must_have_the_same_nodes(folder):
    (folder / "block.msh").write_bytes((BRACKET.parent / "block.msh").read_bytes())
    with pytest.raises(InputError, match=r"block.msh has \d+ nodes, bracket.inp 844; a morph needs the same labels"):
        parameters_in(folder, ('displacement = "longer.csv"', 'mesh = "block.msh"'))
