"""modes and campbell: tables of full models and of one body over its speed."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.body.file import read_body
from morembs.body.floating.spin import campbell
from morembs.fem.tubes import tube_model
from morembs.importers.model_file import write_model
from tests.support.commands import refused, run
from tests.support.meshes import box
from tests.support.tubes import PIPE

JOB = """
[model]
mesh = "blade.vtk"
units = "mm-t-s"
[[material]]
young = 2.1e5
poisson = 0.3
density = 7.85e-9
[[interface]]
name = "root"
nodes = "box:-1,-20,-20,1,20,20"
point = [0, 0, 0]
{tables}
[[reduce]]
method = "craig-bampton"
modes = 4
[output]
path = "part.h5"
[check]
full_modes = 0
"""
SPIN = '[spin]\nspeed = [0, 20, 42, 60]\naxis = [0, 0, 1]\nheld = ["root"]\nmodes = 4'


# A tube along x, held at one end.
TUBE = """
[model]
file = "tube.model.h5"
[[interface]]
name = "tip"
nodes = "ids:13"
[damping]
rayleigh = { beta = 2e-5 }
[[reduce]]
method = "modal"
modes = 4
[modes]
count = 4
[output]
path = "tube.h5"
"""


def job(folder, tables=SPIN):
    mesh = box("hex20", (12, 1, 1), (1000, 30, 10), lambda x: x - [0, 15, 5])
    meshio.Mesh(np.array(mesh.nodes.xyz), [("hexahedron20", mesh.blocks[0].nodes)]).write(folder / "blade.vtk")
    path = folder / "job.toml"
    path.write_text(JOB.format(tables=tables))
    return path


@pytest.fixture(scope="module")
def blade(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blade")
    path = job(folder)
    run("campbell", path, "-o", folder / "campbell.csv", "--png", "--points", 7, "--count", 4)
    return folder


def test_campbell_writes_modes_of_one_body_that_agree_with_the_full_model(blade):
    with open(blade / "campbell.csv") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 28
    shown = json.loads(run("modes", blade / "job.toml", "--complex", "--count", 4, "--json"))[0]
    assert shown["complete"]["60"].startswith("complete below")
    full = {(row["speed"], row["number"]): row["damped_hz"] for row in shown["modes"]}
    assert len(full) == 16
    some = {(float(row["speed_rad_s"]), int(row["mode"])): float(row["damped_hz"]) for row in rows}
    common = full.keys() & some.keys()
    assert len(common) == 12  # 0, 20 and 60
    assert [some[key] for key in common] == pytest.approx([full[key] for key in common], rel=1e-6)
    # Southwell, in the units of the job.
    flap = [2 * np.pi * some[speed, 1] for speed in (0.0, 60.0)]
    assert (flap[1] ** 2 - flap[0] ** 2) / 60**2 == pytest.approx(1.193, rel=1e-2)
    assert (blade / "campbell.png").read_bytes()[:4] == b"\x89PNG"


def test_the_body_file_keeps_its_spin(blade):
    stored = read_body(blade / "part.h5", whole=True)
    (body,) = stored.bodies.values()
    assert body.floating is None
    spin = body.spin
    assert np.array_equal(spin.C, -spin.C.T)
    assert np.array_equal(spin.speeds, [0, 20, 42, 60])
    assert max(body.recipe["spin_mode_deviation"].values()) < 1e-6
    tip = np.abs(stored.coordinates[:, 0] - 1.0) < 1e-9
    stretch = spin.elongation.reshape(-1, 3)[tip, 0].mean()
    assert stretch == pytest.approx(7850 / 3 / 2.1e11, rel=5e-3)
    told = run("export", blade / "part.h5", "--to", "matrix-market", "-o", blade / "part.mtx")
    assert "the matrices are those at rest" in told
    refused = CliRunner().invoke(app, ["export", str(blade / "part.h5"), "--to", "exudyn"])
    assert refused.exit_code == 2 and "reduce it without [spin]" in refused.stderr
    # From the file as from the job.
    (whirl,) = campbell(body, [60.0], 4)
    run("campbell", blade / "part.h5", "-o", blade / "again.csv", "--points", 7, "--count", 4)
    assert (blade / "again.csv").read_bytes() == (blade / "campbell.csv").read_bytes()
    with open(blade / "again.csv") as file:
        last = [float(row["damped_hz"]) for row in csv.DictReader(file)][-4:]
    assert whirl.eigenvalues.imag / (2 * np.pi) == pytest.approx(last)


def test_modes_of_a_damped_model_that_is_held(tmp_path):
    path = job(tmp_path, '[modes]\nkind = "complex"\ncount = 3\nheld = ["root"]\n[damping]\nrayleigh = { beta = 1e-5 }')
    text = run("modes", path, "-o", tmp_path / "modes.csv")
    assert "no count of modes: damping" in text
    with open(tmp_path / "modes.csv") as file:
        rows = list(csv.DictReader(file))
    # Stiffness damping: ratio = beta w / 2.
    for row in rows:
        undamped = 2 * np.pi * float(row["damped_hz"]) / np.sqrt(1 - float(row["ratio"]) ** 2)
        assert float(row["ratio"]) == pytest.approx(1e-5 * undamped / 2, rel=1e-6)
        assert row["inertial_hz"] == ""


def test_real_modes_are_those_of_the_free_body(tmp_path):
    path = job(tmp_path, "")
    shown = json.loads(run("modes", path, "--count", 2, "--json"))[0]
    # Free-free beam, 10 mm high: 22.3733 sqrt(EI / m L^4).
    exact = 22.3733 * np.sqrt(2.1e11 * 0.01**2 / 12 / 7850) / (2 * np.pi)
    assert shown["modes"][0]["damped_hz"] == pytest.approx(exact, rel=5e-3)


def test_real_modes_have_the_damping_of_the_model_and_of_the_job(tmp_path):
    tube = tube_model(np.linspace([0, 0, 0], [1.0, 0, 0], 13), PIPE, held=(0,))
    write_model(tmp_path / "tube.model.h5", replace(tube, D=3.0 * tube.M + 1e-5 * tube.K))
    path = tmp_path / "job.toml"
    path.write_text(TUBE)
    real, full = (json.loads(run("modes", path, "--json", *more))[0] for more in ((), ("--complex",)))
    assert real["complete"]["0"].endswith("Hz without damping")
    for a, b in zip(real["modes"], full["modes"], strict=True):
        omega = 2 * np.pi * a["damped_hz"] / np.sqrt(1 - a["ratio"] ** 2)
        assert a["ratio"] == pytest.approx((3.0 / omega + 3e-5 * omega) / 2, rel=1e-6)
        assert [a["damped_hz"], a["ratio"], a["real"]] == pytest.approx(
            [b["damped_hz"], b["ratio"], b["real"]], rel=1e-6
        )


def test_real_modes_of_a_coupling_damper_say_what_they_leave_out(tmp_path):
    tube = tube_model(np.linspace([0, 0, 0], [1.0, 0, 0], 13), PIPE, held=(0,))
    tip = np.flatnonzero((tube.dofs.node == 12) & (tube.dofs.component == 1))[0]
    D = sp.csr_array(([300.0], ([tip], [tip])), shape=tube.K.shape)
    write_model(tmp_path / "tube.model.h5", replace(tube, D=D))
    path = tmp_path / "job.toml"
    path.write_text(TUBE.replace("rayleigh = { beta = 2e-5 }", ""))
    result = CliRunner().invoke(app, ["modes", str(path), "--json"])
    values, Y = sl.eigh(tube.K.toarray(), tube.M.toarray(), subset_by_index=[0, 3])
    # Two planes bend alike: across the damper and along it.
    across = [300.0 * (Y[tip, k : k + 2] ** 2).sum() / (2 * np.sqrt(values[k])) for k in (0, 2)]
    rows = json.loads(result.stdout)[0]["modes"]
    assert [row["ratio"] for row in rows] == pytest.approx([0.0, across[0], 0.0, across[1]], rel=1e-5, abs=1e-9)
    assert [row["damped_hz"] == 0 for row in rows] == [False, True, False, True]
    assert "--complex has what D couples of them" in result.stderr
    # Where the count cuts a pair, the first of it is none of its mixtures.
    for count in (1, 3):
        cut = json.loads(run("modes", path, "--count", count, "--json"))[0]
        ratios = [[row["ratio"] for row in some] for some in (cut["modes"], rows[:count])]
        assert ratios[0] == pytest.approx(ratios[1], rel=1e-6, abs=1e-9)
        assert float(cut["complete"]["0"].split()[2]) <= np.sqrt(values[count]) / (2 * np.pi) * (1 + 1e-5)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (SPIN.replace("[0, 0, 1]", "[0, 0, 0]"), "axis = [0.0, 0.0, 0.0] was given; expected a direction"),
        (SPIN + '\n[frame]\nkind = "mean-axes"', "[frame] was given beside [spin]"),
        (
            SPIN + '\n[state_space]\npath = "a.npz"\ninputs = ["root:force"]\noutputs = ["root:displacement"]',
            "[state_space] was given beside [spin]",
        ),
        (SPIN.replace("root", "rot"), "held names the interface 'rot'; did you mean 'root'?"),
        (SPIN + "\n[damping]\nmodal = 0.02", "complex modes take rayleigh damping"),
        (SPIN + "\n[damping]\nrayleigh = { alpha = 2.0 }", "alpha = 2 damps the elastic motion of a free body"),
        (SPIN.replace("[0, 20, 42, 60]", "[]"), "speed = [] was given; expected speeds"),
    ],
)
def test_what_cannot_spin_is_refused_before_any_work(tmp_path, tables, message):
    assert message in refused(job(tmp_path, tables))


def test_the_table_of_the_documentation_is_taken(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "reference" / "job" / "spin.md").read_text()
    (block,) = re.findall(r"^```toml\n(\[spin\].*?)^```", text, re.MULTILINE | re.DOTALL)
    assert "reduction" in run("check", job(tmp_path, block.replace("bearing", "root")))


def test_campbell_says_what_it_needs(tmp_path):
    path = job(tmp_path, "")
    for words, message in (
        ([path, "-o", tmp_path / "a.csv"], "has no table [spin]"),
        ([path, "-o", tmp_path / "a.txt"], "expected a name that ends in .csv"),
    ):
        result = CliRunner().invoke(app, ["campbell", *map(str, words)])
        assert result.exit_code == 2
        assert message in result.stderr
    assert not (tmp_path / "part.h5").exists()


@pytest.mark.parametrize(("command", "words"), [("campbell", 2), ("modes", 1)])
def test_help_shows_names_of_tables(command, words):
    assert run(command, "--help").count("[spin]") == words
