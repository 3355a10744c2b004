"""``[effective_mass]`` against the clamped-free beam of the books (Blevins 1979; Girard and Roy 2008)."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import morembs
from morembs.app.cli import commands as cli
from morembs.importers.model_file import write_model
from tests.support import decks

RUN = CliRunner().invoke
LENGTH, TUBE = 2.0, morembs.Tube(outer=0.012, inner=0.010, young=2e11, density=7850.0)
# Roots of cos(b) cosh(b) = -1.
ROOTS = np.array([1.8751040687, 4.6940911330, 7.8547574382])
JOB = """
[model]
file = "beam.model.h5"
[[interface]]
name = "root"
nodes = "ids:1"
[[interface]]
name = "tip"
nodes = "ids:41"
[[reduce]]
method = "craig-bampton"
modes = 60
[effective_mass]
path = "beam.csv"
held = ["root"]
[check]
full_modes = 0
[output]
path = "beam.h5"
"""


def beam(path: Path, text: str = JOB) -> str:
    """A free beam along x from the origin, as a model file, and the path of its job."""
    write_model(path / "beam.model.h5", morembs.tube_model(np.linspace([0.0, 0, 0], [LENGTH, 0, 0], 41), TUBE))
    (path / "job.toml").write_text(text)
    return str(path / "job.toml")


def test_a_clamped_free_beam_has_the_effective_masses_of_the_books(tmp_path: Path) -> None:
    done = RUN(cli.app, ["reduce", beam(tmp_path), "-q", "--json", "--report", str(tmp_path / "report.html")])
    assert done.exit_code == 0, done.stderr
    (document,) = json.loads(done.stdout)
    told = document["effective_mass"]
    hz, masses, total = (np.array(told[key]) for key in ("frequencies_hz", "masses", "total"))
    area = np.pi * (TUBE.outer**2 - TUBE.inner**2) / 4
    mass = TUBE.density * area * LENGTH
    assert total[:3] == pytest.approx(mass, rel=1e-9) and total[4] == pytest.approx(mass * LENGTH**2 / 3, rel=1e-3)
    share = masses / total
    assert (share.sum(axis=0) > 0.95).all() and (share.sum(axis=0) < 1).all()
    # Bending in pairs, y and z, with s = (sinh b - sin b) / (cosh b + cos b): int phi / L = 2 s / b, int x phi / L^2 =
    # 2 / b^2.
    s = (np.sinh(ROOTS) - np.sin(ROOTS)) / (np.cosh(ROOTS) + np.cos(ROOTS))
    expected = (2 * s / ROOTS) ** 2
    assert expected == pytest.approx([0.6131, 0.1883, 0.0647], abs=1e-4)
    stiffness = TUBE.young * np.pi * (TUBE.outer**4 - TUBE.inner**4) / 64
    exact = ROOTS**2 / (2 * np.pi * LENGTH**2) * np.sqrt(stiffness / (TUBE.density * area))
    # Both modes of a pair are any turn of bending along y and z; together they have the mass of one along each.
    pairs = np.flatnonzero(share[:, 1:3].sum(axis=1) > 0.01)[:6].reshape(3, 2)
    assert hz[pairs] == pytest.approx(np.column_stack([exact, exact]), rel=2e-3)
    for way, turning in ((1, 5), (2, 4)):
        assert share[pairs, way].sum(axis=1) == pytest.approx(expected, rel=2e-3)
        assert share[pairs, turning].sum(axis=1) == pytest.approx(12 / ROOTS**4, rel=5e-3)
    # Along its axis a quarter wave has 8 / pi^2 of the mass.
    assert share[:, 0].max() == pytest.approx(8 / np.pi**2, rel=1e-3)
    rows = list(csv.DictReader((tmp_path / "beam.csv").open()))
    assert len(rows) == len(hz) and float(rows[0]["hz"]) == hz[0]
    assert [float(rows[k]["participation_y"]) ** 2 for k in range(4)] == pytest.approx(masses[:4, 1], rel=1e-12)
    assert document["written"] == [str(tmp_path / "beam.h5"), str(tmp_path / "beam.csv")]
    # The terminal and the page show what the document has.
    shown = RUN(cli.app, ["reduce", str(tmp_path / "job.toml"), "-q"]).stdout
    page = (tmp_path / "report.html").read_text()
    for text in ("effective masses of craig-bampton with root held", f"{100 * share[0, 1:3].max():.2f}"):
        assert text in shown and text in page


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('path = "part.csv"\nheld = ["lef"]', "held = 'lef' was given; did you mean 'left'?"),
        ('path = "part.csv"\nbody = "cd"', "body = 'cd' was given; did you mean 'cb'?"),
        ('path = "part.txt"', "the path of a .csv file"),
        ('path = "part.inp"', "the path of a .csv file"),
    ],
)
def test_what_cannot_be_held_is_refused_before_anything_is_factorised(tmp_path: Path, table: str, said: str) -> None:
    job = decks.folder(tmp_path, {"effective_mass": table})
    for verb in ("check", "reduce"):
        done = RUN(cli.app, [verb, str(job)])
        assert done.exit_code == 2 and said in done.stderr
    assert not (tmp_path / "part.h5").exists()


def test_a_point_of_the_support_moves_the_inertia(tmp_path: Path) -> None:
    """About the tip the same beam has the same inertia; about its middle a quarter of it."""
    totals = {}
    for name, x in (("root", 0.0), ("middle", LENGTH / 2), ("tip", LENGTH)):
        text = JOB.replace('held = ["root"]', f'held = ["root"]\npoint = [{x}, 0, 0]')
        (document,) = json.loads(RUN(cli.app, ["reduce", beam(tmp_path, text), "-q", "--json"]).stdout)
        totals[name] = document["effective_mass"]["total"][4]
    assert totals["tip"] == pytest.approx(totals["root"], rel=1e-9)
    assert totals["middle"] == pytest.approx(totals["root"] / 4, rel=1e-3)
