"""Jobs with parameters whose box has corners that differ in kind: without damping, without the shape of a support."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.body.file import read_body
from tests.support.mesh_decks import abaqus_mesh
from tests.support.meshes import box

SIZE, BAND = (0.3, 0.03, 0.03), 3000.0
JOB = """
[model]
mesh = "bar.inp"
units = "m-kg-s"
[[material]]
young = 2.1e11
poisson = 0.3
density = 7850.0
[[interface]]
name = "L"
nodes = "set:L"
[[interface]]
name = "R"
nodes = "set:R"
PARAMETERS
[[reduce]]
method = "parametric"
band_hz = [0, HIGH]
tolerance = 1e-3
training = 8
MORE
[output]
path = "bar.h5"
"""
BETA = '[[parameter]]\nname = "b"\nproperty = "beta"\nrange = [0, 1e-5]\nnominal = 5e-6'
SPRING = """
[[parameter]]
name = "k"
property = "spring"
interface = "L"
stiffness = [3e7, 2e7, 2e7, 4e3, 5e3, 6e3]
range = [0.5, 4.0]
"""
MORPH = '[[parameter]]\nname = "t"\nproperty = "morph"\ndisplacement = "longer.csv"\nrange = [0, 0.05]\n'


def reduced(folder: Path, parameters: str, more: str = "", high: float = 6000.0):
    mesh = box("hex8", (3, 1, 1), SIZE)
    sets = ""
    for name, x in (("L", 0.0), ("R", SIZE[0])):
        rows = mesh.nodes.ids[np.isclose(mesh.nodes.xyz[:, 0], x)]
        sets += f"*NSET, NSET={name}\n" + ",\n".join(map(str, rows)) + "\n"
    (folder / "bar.inp").write_text(abaqus_mesh(mesh) + sets)
    places = zip(mesh.nodes.ids.tolist(), (mesh.nodes.xyz[:, 0] / SIZE[0]).tolist(), strict=True)
    (folder / "longer.csv").write_text("id,dx,dy,dz\n" + "\n".join(f"{label},{x!r},0,0" for label, x in places))
    job = folder / "job.toml"
    job.write_text(JOB.replace("PARAMETERS", parameters).replace("MORE", more).replace("HIGH", str(high)))
    return CliRunner().invoke(app, ["reduce", str(job)])


def test_a_box_that_begins_without_damping_has_a_body(tmp_path):
    done = reduced(tmp_path, BETA)
    assert done.exit_code == 0, done.stderr
    model = read_body(tmp_path / "bar.h5").bodies["parametric"].parametric.model
    assert model.floor > 0 and model.box_bound <= 1e-3


@pytest.mark.parametrize("parameters", [BETA, BETA.replace("beta", "alpha").replace("5e-6", "0")])
def test_resonances_without_damping_are_refused_where_none_is_to_be_assumed(tmp_path, parameters):
    done = reduced(tmp_path, parameters, "damping_floor = 0.0")
    assert done.exit_code == 2
    assert "at b = 0" in done.stderr and "no damping at 3 resonances of the band, the first at 4,3" in done.stderr


def test_rayleigh_parameters_are_refused_by_name_beside_modal_damping(tmp_path):
    done = reduced(tmp_path, BETA, "[damping]\nmodal = 0.01")
    assert done.exit_code == 2 and "parameter b (beta) was given beside modal damping" in done.stderr


def test_a_ground_spring_holds_a_body_that_a_morph_turns_about_other_places(tmp_path):
    done = reduced(tmp_path, SPRING + MORPH, high=BAND)
    assert done.exit_code == 0, done.stderr
    body = read_body(tmp_path / "bar.h5").bodies["parametric"].parametric
    assert body.model.box_bound <= 1e-3
    stiff, long = body.at(k=4.0, t=0.0).frequencies_hz[0], body.at(k=0.5, t=0.05).frequencies_hz[0]
    assert stiff > 2 * long > 0


def test_a_wide_range_of_a_modulus_has_a_body(tmp_path):
    """Modes of the softest body lie five times lower beside the band than those of the stiffest one."""
    done = reduced(tmp_path, '[[parameter]]\nname = "E"\nproperty = "young"\nrange = [4.2e10, 1.05e12]')
    assert done.exit_code == 0, done.stderr
    body = read_body(tmp_path / "bar.h5").bodies["parametric"].parametric
    assert body.model.box_bound <= 1e-3
    # Every frequency is proportional to the root of the one modulus.
    low, high = (body.at(E=E) for E in (4.2e10, 1.05e12))
    np.testing.assert_allclose(high.frequencies_hz[:3], 5 * low.frequencies_hz[:3], rtol=1e-9)
    slope = body.sensitivity(E=4.2e10).frequencies_hz["E"][:3]
    np.testing.assert_allclose(slope, low.frequencies_hz[:3] / (2 * 4.2e10), rtol=1e-9)
    # What lies above the band belongs to the basis, and is said to be rough.
    count = int((high.frequencies_hz <= 6000.0).sum())
    assert count < len(high.frequencies_hz) and body.sensitivity(E=1.05e12).in_band.sum() == count
    asked = ["--at", "E=1.05e12", "--sensitivity", "--frequencies", f"{count + 1}"]
    words = CliRunner().invoke(app, ["evaluate", str(tmp_path / "bar.h5"), *asked])
    assert words.exit_code == 0 and f"note: frequencies {count + 1} lie above the band" in words.stdout


def test_a_soft_ground_spring_beside_a_morph_has_a_proven_bound(tmp_path):
    """Rigid motion of the longer bar strains elements of the shorter one, a thousand times as much as the spring."""
    spring = SPRING.replace("[3e7, 2e7, 2e7, 4e3, 5e3, 6e3]", "[3e3, 2e3, 2e3, 0.4, 0.5, 0.6]")
    done = reduced(tmp_path, spring + MORPH, high=BAND)
    assert done.exit_code == 0, done.stderr
    at = read_body(tmp_path / "bar.h5").bodies["parametric"].parametric.at(k=0.7, t=0.04)
    bound = at.bound([100.0, 1500.0, 2900.0])
    size = np.linalg.norm(at.response([100.0, 1500.0, 2900.0]), axis=(1, 2))
    assert at.bound_kind == "bound" and (bound < 0.1 * size).all()


def test_an_infinite_bound_is_refused_by_its_factor_and_the_range_that_has_one(tmp_path):
    young = '[[parameter]]\nname = "E"\nproperty = "young"\nrange = [1e7, 1e13]\nset = "all"\n'
    done = reduced(tmp_path, young, high=12000.0)
    assert done.exit_code == 2
    assert "the bound is infinite at E = " in done.stderr and "(Lam), and the band goes up to 1.2e+04 Hz" in done.stderr
    assert "narrow the range" in done.stderr
