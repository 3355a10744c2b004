"""Every job in pipelines/ runs as a user runs it, and the numbers that matter hold."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from morembs.body.file import read_body

ROOT = Path(__file__).parents[2]
# The last three run in test_pipelines_multibody.py.
NAMES = {"connecting_rod", "flexible_swing", "rotating_beam", "slider_crank"}
PIPELINES = ROOT / "pipelines"


def run(*command):
    return subprocess.run([sys.executable, *map(str, command)], check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def connecting_rod(tmp_path_factory):
    """Job, mesh and results in a folder of their own."""
    folder = tmp_path_factory.mktemp("rod")
    run(ROOT / "data" / "make_connecting_rod.py", "--output", folder / "connecting_rod.msh")
    job = folder / "connecting_rod.toml"
    job.write_text((PIPELINES / "connecting_rod.toml").read_text())
    return folder, json.loads(run("-m", "morembs", "reduce", job, "--json"))


def test_no_pipeline_is_left_out():
    assert {path.stem for path in PIPELINES.glob("*.toml")} == NAMES


def test_connecting_rod_meets_its_accuracy(connecting_rod):
    folder, result = connecting_rod
    assert result["dofs"] >= 60_000
    assert result["bodies"]["cb30"]["order"] == 12 + 30
    full, reduced = (np.array(result[key])[6:16] for key in ("full_frequencies_hz", "frequencies_hz"))
    assert full[0] > 1000.0
    assert np.abs(reduced / full - 1).max() < 1e-3
    # 95,848 mm3 of steel.
    assert result["mass"] == pytest.approx(95_848e-9 * 7850, rel=1e-4)
    assert abs(result["center_of_mass"][1]) < 1e-6 and 0.02 < result["center_of_mass"][0] < 0.075
    assert result["peak_memory_bytes"] and all(bytes_ > 0 for bytes_ in result["peak_memory_bytes"].values())
    assert (folder / "connecting_rod.png").stat().st_size > 50_000


def test_connecting_rod_keeps_its_tolerance(connecting_rod):
    folder, result = connecting_rod
    its = result["bodies"]["certified"]["certificate"]
    assert result["bodies"]["certified"]["order"] <= 60
    assert its["bound_kind"] == "bound" and len(its["frequencies_hz"]) >= 200
    assert max(its["error"]) <= its["limits"]["pointwise"]["upper"]
    assert its["limits"]["envelope"]["upper"] <= 1e-4 and its["measure"] == "envelope"
    # The other body is certified over the same band, and stored with it.
    stored = read_body(folder / "connecting_rod.h5").bodies["cb30"].certificate
    assert stored["error"].tolist() == result["bodies"]["cb30"]["certificate"]["error"]


def test_connecting_rod_body_file_is_what_was_reported(connecting_rod):
    folder, result = connecting_rod
    stored = read_body(folder / "connecting_rod.h5")
    body = stored.bodies["cb30"]
    assert body.frequencies_hz.tolist() == result["frequencies_hz"]
    assert np.abs(body.stiffness_matrix - body.stiffness_matrix.T).max() == 0
    # Its interface degrees of freedom are its first coordinates.
    assert np.array_equal(body.input_matrix, np.eye(42, 12))


def test_the_falling_beam_touches_when_it_must(tmp_path):
    """Free fall of the gap takes sqrt(2 gap / g); the pipeline prints the time of its first touch."""
    text = run(PIPELINES / "falling_beam.py", "--quick", "--folder", tmp_path)
    first = float(re.search(r"first touch[^0-9]*([0-9.]+)", text)[1])
    assert first == pytest.approx(0.100964, rel=1e-4)
    assert (tmp_path / "falling_beam.png").stat().st_size > 20_000
