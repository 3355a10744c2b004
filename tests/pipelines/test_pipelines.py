"""Every job, pipeline and study runs as a user runs it, and the numbers that matter hold."""

import importlib
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from data import make_connecting_rod
from morembs.body.file import read_body
from morembs.exporters.exudyn_system import exudyn_missing
from morembs.exporters.fmu.compiler import compiler
from tests.support.processes import morembs

ROOT = Path(__file__).parents[2]
PIPELINES = ROOT / "pipelines"
sys.path.insert(0, str(PIPELINES))

SCRIPTS = sorted(path.stem for path in PIPELINES.glob("*.py") if path.stem != "common")
STUDIES = sorted(f"studies.{path.stem}" for path in (ROOT / "studies").glob("*.py") if path.stem != "__init__")
# These run in processes of their own, as scripts do and as modules do; the others here, which saves the imports.
APART = {"flexible_pendulum": "pipelines/flexible_pendulum.py", "studies.moving_load": "-mstudies.moving_load"}


def run(*command):
    done = subprocess.run([sys.executable, *map(str, command)], check=True, capture_output=True, text=True, cwd=ROOT)
    return done.stdout


def number(pattern, text):
    return float(re.search(pattern, text)[1])


def touches_when_it_must(text):
    """Free fall of the gap takes sqrt(2 gap / g)."""
    assert number(r"first touch[^0-9]*([0-9.]+)", text) == pytest.approx(0.100964, rel=1e-4)


def follows_the_full_model(text):
    assert number(r"error / length (\S+) rms", text) < 0.003


def swings_alike_as_fmu(text):
    assert number(r"drift of the energy (\S+)", text) < 1e-5
    if compiler() and importlib.util.find_spec("fmpy"):
        # Of the implicit steps of the mechanism: those of the FMU are as small as its tolerance asks for.
        assert number(r"FMU in FMPy: (\S+) of", text) < 5e-5


def runs_in_exudyn(text):
    assert ("in Exudyn" in text) != bool(exudyn_missing())


def has_the_factors_of_fryba(text):
    factors = re.findall(r"dynamic factor (\S+) \(Fryba (\S+)\)", text)
    assert len(factors) == 5
    for computed, exact in factors:
        assert float(computed) == pytest.approx(float(exact), rel=3e-3)


def has_the_moment_with_static_modes_alone(text):
    with_static, without = map(float, re.search(r"error (\S+) % with static modes, (\S+) % without", text).groups())
    assert with_static < 1.6 and without > 9


def is_as_good_as_all_dofs(text):
    deflection, stress = map(float, re.search(r"deflection (\S+) %, stress (\S+) %", text).groups())
    assert deflection < 1 and stress < 1
    switched, static = map(int, re.search(r"coordinates: (\d+) switched, (\d+) with all", text).groups())
    assert static == 101 + switched - 1
    low, high = map(float, re.search(r"force (\S+) to (\S+) of the weight", text).groups())
    assert 0.3 < low < 1 < high < 2


def has_the_coefficient_of_southwell(text):
    coefficients = dict(re.findall(r"flap, simulated, (.*): c = (\S+)$", text, re.MULTILINE))
    assert float(coefficients["morembs with stiffening"]) == pytest.approx(1.19, abs=0.01)
    assert abs(float(coefficients["morembs without"])) < 5e-3
    if not exudyn_missing():
        assert abs(float(coefficients["Exudyn"])) < 5e-3


def needs_few_candidates(text):
    low, high, candidates = map(int, re.search(r"active candidates: (\d+) to (\d+) of (\d+)", text).groups())
    assert 0 < low < high < candidates / 2
    assert number(r"from all of the model by (\S+) of it", text) < 1e-8


def meshes_as_with_all_static_modes(text):
    error, force = map(float, re.search(r"differ by (\S+) of the .* and (\S+) of the force", text).groups())
    assert error < 1e-3 and force < 2e-3
    switched, whole = map(int, re.findall(r"(\d+) coordinates", text))
    assert whole > 4 * switched


def needs_two_modes_of_the_start(text):
    # Of the deformation coordinates of three elements per link, by another program.
    frequencies = re.search(r"start (\S+), (\S+) \.\. (\S+) Hz, end (\S+), (\S+) Hz", text).groups()
    assert [float(f) for f in frequencies] == pytest.approx([3.071, 21.92, 4232, 3.112, 19.17], rel=3e-4)
    one, two = (float(part) for part in re.findall(r"^ +[12] +\S+ +\S+ +(\S+) +\S+$", text, re.MULTILINE))
    assert one == pytest.approx(1.1e-3, rel=0.1) and two == pytest.approx(1.8e-5, rel=0.1)
    assert number(r"exact beams by (\S+) of the deflection", text) < 1e-3


def moves_as_the_linear_mast(text):
    assert number(r"amplitude 0.0001 m: (\S+) of the linear", text) < 1e-6
    whole, chains = number(r"up to (\S+) m", text), re.findall(r"tip within (\S+) m", text)
    assert whole > 0.2 and len(chains) == (2 if exudyn_missing() else 3) and all(float(gap) < 1e-4 for gap in chains)


def moves_as_a_ring(text):
    # Of an inextensional ring, by another program; that of the script is its own solution of the same equations.
    exact = [float(f) for f in re.search(r"^ring: +(.*) Hz", text, re.MULTILINE)[1].split()]
    assert exact == pytest.approx([25.655, 56.477, 104.87, 161.05], rel=1e-4)
    gaps = [float(gap) for gap in re.findall(r"(-?\d\.\d\d) %", text)]
    assert len(gaps) == 4 and all(0 <= gap < limit for gap, limit in zip(gaps, (0.03, 0.08, 0.2, 0.3), strict=True))
    assert number(r"100 times EA.*moment (\S+) Nm", text) == pytest.approx(0.065405, rel=1e-5)
    still, moving = (float(gap) for gap in re.findall(r"(\d\.\d{3}) %", text))
    assert still < 0.03 and moving < 0.7


def presses_with_two_forces_at_each_end(text):
    rows = [[float(x) for x in line.split()] for line in re.findall(r"^ +0\.\d+ .*", text, re.MULTILINE)]
    assert len(rows) == 3
    for play, _, tip, _, distance, total, moment, inside in rows:
        # What is left out is of the order of a / R.
        order = (6e-3 * play * 0.2) ** 0.5 / 0.2
        assert abs(tip - 1) < 3e-3 and abs(distance - 1) < order and abs(total - 1) < order
        assert abs(moment - 1) < 0.03 and inside < 0.02


def shares_the_load_as_springs_do(text):
    rows = re.findall(r"^ +\d +(?:\S+ +){3}(\S+) N +(\S+) /s$", text, re.MULTILINE)
    # With rigid links it falls as exp(sqrt(P / (m l + m_link l)) t), elastic ones are a little faster.
    falls = (1000 / ((2.0 + 0.9) * 0.5)) ** 0.5
    assert len(rows) == 3 and all(float(gap) < 1e-5 for gap, _ in rows)
    assert all(falls < float(growth) < 1.01 * falls for _, growth in rows)
    assert re.search(r"^ +3 +7 of 30 joint equations are redundant: .*link 0\.ROOT.*link 2\.TIP", text, re.MULTILINE)
    assert re.search(r"^ +1 +1000\.000 +-?0\.000 +-?0\.000 N$", text, re.MULTILINE)


def shares_the_load_as_stribeck_says(text):
    ratios = [float(ratio) for ratio in re.findall(r"^ +\S+ +\S+ +(\d\.\d{4})$", text, re.MULTILINE)]
    assert len(ratios) == 4 and all(abs(ratio - 1) < 0.01 for ratio in ratios)
    # 0.5432 for the exponent 1.5; the table has that of its elements.
    assert number(r"largest ball carries (\S+) of", text) == pytest.approx(0.5432, rel=5e-3)


def moves_the_tip_as_planned(text):
    moments = dict(re.findall(r"(a\d) = (\S+)", text))
    # From the inverse transfer function of the beam of eight elements, in rational arithmetic.
    for name, value in {"a0": 0.194, "a1": 1.87142e-4, "a2": 5.3261e-8}.items():
        assert float(moments[name]) == pytest.approx(value, rel=2e-5)
    errors = [float(error) for error in re.findall(r"error of the tip (\S+) rad", text)]
    assert errors == pytest.approx([0.02293, 1.317e-3, 1.27e-4, 8.1e-5], rel=0.01)


def sees_the_flow_and_the_mounts(text):
    # Dense QZ of all dofs, by a program of its own.
    hz = [float(f) for f in re.search(r"held: (.*) Hz", text)[1].split(", ")]
    assert hz == pytest.approx([65.01, 94.58, 126.19, 218.4], rel=2e-4)
    assert number(r"Hz; (\S+) rad per kg/s", text) == pytest.approx(-2.3854, rel=1e-3)
    phases = {(k, d): float(value) for k, d, value in re.findall(r"^ +(\S+) +(\S+) +(\S+)$", text, re.MULTILINE)}
    assert phases["1000", "253.9"] == pytest.approx(1.340e-3, rel=1e-2)
    assert phases["2.05e+05", "10"] == pytest.approx(7.5e-3, rel=1e-2)
    assert number(r"largest at (\S+) Ns/m", text) == pytest.approx(253.9, rel=1e-2)


def gives_the_restitution_of_each_law(text):
    assert number(r"largest gap to the quadrature: (\S+)", text) < 1e-3


def keeps_its_limit_in_the_full_model(text):
    # Models assembled at the values know nothing of the basis.
    full = number(r"full model (\S+) Hz", text)
    assert full == pytest.approx(1325.0, rel=1e-4)
    assert number(r"mass (\S+) of nominal", text) < 0.98
    # The frequency ends the depth, not its range.
    assert -0.19 < number(r"t (\S+) mm", text) < 0.19
    assert number(r"against full models (\S+)", text) < 1e-4
    # About 95 of 100 draws are.
    rows = [tuple(map(int, row)) for row in re.findall(r"hidden \S+; (\d+) of (\d+) draws", text)]
    assert len(rows) == 3 and all(within >= 0.7 * count for within, count in rows)


def differentiates_whole_runs(text):
    rows = re.findall(r"^\w+ .* MPa (\S+) .* N (\S+) .* Hz (\S+)$", text, re.MULTILINE)
    assert len(rows) == 4
    assert all(float(stress) < 1e-3 and float(force) < 1e-3 and float(hz) < 1e-6 for stress, force, hz in rows)
    before, after = number(r"stress (\S+) MPa", text), number(r"expected, (\S+) MPa in the run", text)
    assert after < 0.95 * before


def draws_six_plots(text):
    drawn = Path(text.splitlines()[-1])
    names = ("plots", *(f"plots_{kind}" for kind in ("response", "density", "mac", "campbell", "cost")))
    # Small enough for a page of the site.
    assert all(20_000 < drawn.with_name(f"{name}.png").stat().st_size < 100_000 for name in names)
    assert number(r"error at most (\S+),", text) < 3


PROMISES = {
    "rod_design": differentiates_whole_runs,
    "design_study": keeps_its_limit_in_the_full_model,
    "base_excitation": moves_as_the_linear_mast,
    "bearing": shares_the_load_as_stribeck_says,
    "coriolis_meter": sees_the_flow_and_the_mounts,
    "feedforward": moves_the_tip_as_planned,
    "hose": moves_as_a_ring,
    "impact_laws": gives_the_restitution_of_each_law,
    "falling_beam": touches_when_it_must,
    "flexible_pendulum": follows_the_full_model,
    "flexible_swing": runs_in_exudyn,
    "moving_load": has_the_factors_of_fryba,
    "parallelogram": shares_the_load_as_springs_do,
    "slider_crank": runs_in_exudyn,
    "tapered_pendulum": swings_alike_as_fmu,
    "two_link_manipulator": needs_two_modes_of_the_start,
    "wire_in_tube": presses_with_two_forces_at_each_end,
    "plots": draws_six_plots,
    "studies.flexible_rail": is_as_good_as_all_dofs,
    "studies.gear_dynamics": meshes_as_with_all_static_modes,
    "studies.gear_teeth": needs_few_candidates,
    "studies.moving_load": has_the_moment_with_static_modes_alone,
    "studies.rotating_beam": has_the_coefficient_of_southwell,
}


@pytest.mark.parametrize("name", SCRIPTS + STUDIES)
def test_each_runs_draws_its_picture_and_keeps_its_promise(name, tmp_path, capsys):
    arguments = ["--folder", str(tmp_path), "--quick"]
    if name in APART:
        text = run(APART[name], *arguments)
    else:
        assert importlib.import_module(name).main(arguments) == 0
        text = capsys.readouterr().out
    drawn = Path(text.splitlines()[-1])
    assert drawn.parent == tmp_path and drawn.stat().st_size > 20_000
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 3e6
    if name in PROMISES:
        PROMISES[name](text)


def test_every_job_belongs_to_a_script():
    jobs = {path.stem for folder in ("pipelines", "studies") for path in (ROOT / folder).glob("*.toml")}
    assert jobs == {
        "connecting_rod",
        "design_study",
        "flexible_pendulum",
        "flexible_swing",
        "rotating_beam",
        "slider_crank",
        # A system of bodies: test_pipelines_multibody runs it.
        "slider_crank_system",
        "tapered_pendulum",
    }


def test_the_connecting_rod_of_the_demo(tmp_path, capsys):
    """The mesh of the demo, and its job on elements without middle nodes: accuracy, tolerance, and that the file holds
    what was reported."""
    mesh = tmp_path / "connecting_rod.msh"
    sizes = []
    for order in ("2", "1"):
        assert make_connecting_rod.main(["--output", str(mesh), "--order", order]) == 0
        sizes.append([*map(int, re.search(r": (\d+) nodes.* (\d+) mm\^3", capsys.readouterr().out).groups())])
    assert 3 * sizes[0][0] >= 60_000 and sizes[0][1] == 95_848
    (tmp_path / "connecting_rod.toml").write_text((PIPELINES / "connecting_rod.toml").read_text())
    done = morembs("reduce", "connecting_rod.toml", "--json", "--report", "rod.html", folder=tmp_path)
    assert done.code == 0, done.errors
    # With a viewer of twelve modes on the skin, which both meshes have in common.
    assert (tmp_path / "rod.html").stat().st_size <= 350_000
    result = json.loads(done.output)[0]
    assert result["dofs"] == 3 * sizes[1][0]
    assert result["bodies"]["cb30"]["order"] == 12 + 30
    full, reduced = (np.array(result[key])[6:16] for key in ("full_frequencies_hz", "frequencies_hz"))
    assert full[0] > 1000.0
    assert np.abs(reduced / full - 1).max() < 1e-3
    assert result["mass"] == pytest.approx(sizes[1][1] * 1e-9 * 7850, rel=1e-5)
    assert abs(result["center_of_mass"][1]) < 1e-6 and 0.02 < result["center_of_mass"][0] < 0.075
    assert result["peak_memory_bytes"] and all(bytes_ > 0 for bytes_ in result["peak_memory_bytes"].values())
    assert (tmp_path / "connecting_rod.png").stat().st_size > 50_000
    certificate = result["bodies"]["certified"]["certificate"]
    assert result["bodies"]["certified"]["order"] <= 60
    assert certificate["bound_kind"] == "bound" and len(certificate["frequencies_hz"]) >= 200
    assert max(certificate["error"]) <= certificate["limits"]["pointwise"]["upper"]
    assert certificate["limits"]["envelope"]["upper"] <= 1e-4 and certificate["measure"] == "envelope"
    # The other body is certified over the same band, and stored with it.
    body = read_body(tmp_path / "connecting_rod.h5").bodies["cb30"]
    assert body.certificate.error.tolist() == result["bodies"]["cb30"]["certificate"]["error"]
    assert body.frequencies_hz.tolist() == result["frequencies_hz"]
    assert np.abs(body.stiffness_matrix - body.stiffness_matrix.T).max() == 0
    # Its interface degrees of freedom are its first coordinates.
    assert np.array_equal(body.input_matrix, np.eye(42, 12))
