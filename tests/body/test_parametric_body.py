"""Body files with parameters: the nominal body, bodies at other values, and what is written of them."""

import shutil

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

import morembs
from morembs.app.cli import app
from morembs.body.build import BodyOptions
from morembs.exporters import EXPORTERS, export_body
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.storage.checksums import seal
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, parametric_file
from tests.support.refusals import refusal

VALUES = {"E_arm": 1.9e11, "rho": 8000.0, "alpha": 30.0, "t": 1.1}


@pytest.fixture(scope="module")
def problem():
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        yield problem


@pytest.fixture(scope="module")
def path(problem, tmp_path_factory):
    options = BodyOptions(kind="chord", interfaces=("FOOT", "TIP"), origin=(0.0, 0.01, 0.0))
    return parametric_file(tmp_path_factory.mktemp("bodies") / "bracket.h5", problem, options)


@pytest.fixture(scope="module")
def body(path):
    return morembs.read_body(path).bodies["some-basis"].parametric


@pytest.fixture(scope="module")
def written(body, path):
    return body.at(**VALUES).write(path.with_name("at.h5"))


def same(given, expected, tolerance=1e-12):
    given, expected = np.asarray(given), np.asarray(expected)
    return np.abs(given - expected).max(initial=0.0) <= tolerance * np.abs(expected).max(initial=0.0)


def test_the_body_of_nominal_values_is_that_of_the_file(body):
    at, stored = body.at(), body.stored
    assert body.names == ("E_arm", "E_rest", "rho", "alpha", "t")
    for key, name in (("K", "stiffness_matrix"), ("M", "mass_matrix"), ("D", "damping_matrix"), ("B", "input_matrix")):
        assert same(getattr(at, key), getattr(stored, name)), key
    np.testing.assert_allclose(at.frequencies_hz, stored.frequencies_hz[6:], rtol=1e-9)
    frame, known = at.body.floating, stored.floating
    assert (frame.kind, frame.interfaces) == (known.kind, known.interfaces)
    assert same(frame.integrals.inertia, known.integrals.inertia, 1e-10)
    assert at.bodies.mass == pytest.approx(body.source.mass, rel=1e-12)
    np.testing.assert_allclose(at.bodies.center_of_mass, body.source.center_of_mass, atol=1e-12)
    np.testing.assert_allclose(at.bodies.inertia, body.source.inertia, rtol=1e-9, atol=1e-12)


def test_a_body_at_other_values_is_an_ordinary_body_file(problem, body, written):
    read = morembs.read_body(written, whole=True)
    here = read.bodies["some-basis"]
    p = problem.box.point(VALUES)
    with problem.at(p, assembled=True) as there:
        mass, center, inertia = there.mass_properties
        assert read.mass == pytest.approx(mass, rel=1e-10)
        np.testing.assert_allclose(read.center_of_mass, center, atol=1e-10)
        np.testing.assert_allclose(read.inertia, inertia, rtol=1e-7, atol=1e-12)
        np.testing.assert_allclose(read.coordinates, there.model.nodes.xyz, atol=1e-15)
        for interface in there.interfaces:
            np.testing.assert_allclose(read.interfaces[interface.name].point, interface.point, atol=1e-15)
        full = there.elastic_modes(count=2).frequencies_hz
    np.testing.assert_allclose(here.frequencies_hz[6:8], full, rtol=1e-3)
    assert here.recipe["at"] == pytest.approx(body.at(**VALUES).values)
    assert np.array_equal(here.basis(slice(0, 3)), body.stored.basis(slice(0, 3)))
    with refusal("missing", "", "some-basis", "parametric"):
        here.parametric  # noqa: B018


def test_shapes_for_paraview_are_modes_on_the_moved_nodes(written, body):
    at = body.at(**VALUES)
    with h5py.File(written) as file, h5py.File(body.path) as source:
        grid = file["VTKHDF"]
        assert np.array_equal(grid["Points"][()], at.bodies.coordinates)
        assert np.array_equal(grid["Connectivity"][()], source["VTKHDF/Connectivity"][()])
        assert np.array_equal(grid["Types"][()], source["VTKHDF/Types"][()])
        shape = grid["PointData/some-basis_mode_001"][()].ravel()
        mode = at.body.basis() @ at.body.reduced.modes()[1][:, 6]
    assert abs(shape @ mode) == pytest.approx(np.linalg.norm(shape) * np.linalg.norm(mode), rel=1e-5)


@pytest.mark.parametrize("target", [name for name in EXPORTERS if name not in ("fmu",)])
def test_bodies_at_other_values_go_to_every_program(written, target, tmp_path):
    options = {
        "statespace": {"inputs": ["FOOT:acceleration"], "outputs": ["TIP:displacement"], "held": ["FOOT"]},
        "mujoco": {"share": 1e-4},
    }.get(target, {})
    done = export_body(written, target, path=tmp_path / f"out{EXPORTERS[target].suffix}", options=options)
    assert all(file.stat().st_size for file in done.paths)


def test_old_readers_see_a_body_of_version_1(path):
    with h5py.File(path) as file:
        assert file["format_version"][()] == 1


def test_values_outside_the_box_and_unknown_names_are_refused(body):
    with refusal("value", "E_arm", "3e+11", "1.5e+11", "2.7e+11"):
        body.at(E_arm=3e11)
    with refusal("unknown", "rh0", "rho"):
        body.at(rh0=7000.0)
    with refusal("value", "E_arm"):
        body.frequencies_hz(np.vstack([body.nominal, 1.5 * body.nominal]))


def test_a_body_does_not_overwrite_its_own_file(body):
    with refusal("output", "", "bracket.h5"):
        body.at().write(body.path)


def test_damaged_terms_are_refused(path, tmp_path):
    copy = tmp_path / "damaged.h5"
    copy.write_bytes(path.read_bytes())
    with h5py.File(copy, "r+") as file:
        file["bodies/some-basis/parametric/K"][0, 0, 0] += 1.0
    stored = morembs.read_body(copy).bodies["some-basis"]
    with refusal("file", "damaged.h5"):
        stored.parametric  # noqa: B018


def test_without_a_bound_there_is_none(body):
    H, bound = body.response(np.array([100.0, 5000.0]), t=1.0)
    assert H.shape == (2, 12, 12)
    assert np.isinf(bound).all()
    assert body.at().bound_kind == "none"


@pytest.mark.parametrize("name", ["K", "M"])
def test_parameters_of_another_body_are_refused(path, tmp_path, name):
    other = shutil.copy(path, tmp_path / "other.h5")
    with h5py.File(other, "r+") as file:
        file[f"bodies/some-basis/parametric/{name}"][...] *= 4
        seal(file)
    result = CliRunner().invoke(app, ["evaluate", str(other), "--at", "rho=8000"])
    assert result.exit_code == 2
    assert f"other.h5: {name} of the parameters of body 'some-basis' is not that of the body" in result.stderr
