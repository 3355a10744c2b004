"""Pipelines and studies with two simulators: both agree, and with beam theory."""

import re
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.linalg as sl
from numpy.polynomial import Legendre

from morembs.app.simulations.result_file import read_recording
from morembs.app.simulations.run import run_system
from morembs.app.simulations.system_file import load_system
from morembs.body.recovery.recover import recover
from morembs.exporters.exudyn_system import exudyn_missing
from tests.support.processes import python

ROOT = Path(__file__).parents[2]
PIPELINES = ROOT / "pipelines"
sys.path.insert(0, str(PIPELINES))

import common  # noqa: E402
import flexible_swing  # noqa: E402
import slider_crank  # noqa: E402

from studies import rotating_beam  # noqa: E402

needs_exudyn = pytest.mark.skipif(bool(exudyn_missing()), reason="Exudyn is not installed")

STEP = slider_crank.TURN / 1000


@pytest.fixture(scope="module")
def body_of(tmp_path_factory):
    """The body of a pipeline or study, made once."""
    done = {}

    def of(script):
        name = script.__name__
        if name not in done:
            job = Path(script.__file__).with_suffix(".toml")
            done[name] = common.make_body(job, tmp_path_factory.mktemp(job.stem), script.SIZE, script.CELLS)
        return done[name]

    return of


def test_mesh_of_a_bar_has_its_volume_and_inertia(body_of):
    strip = body_of(flexible_swing)
    a, b, c = flexible_swing.SIZE
    mass = 7850.0 * a * b * c
    assert strip.source.mass == pytest.approx(mass, rel=1e-12)
    assert strip.source.center_of_mass == pytest.approx([a / 2, 0, 0], abs=1e-12)
    assert np.diag(strip.source.inertia) * 12 / mass == pytest.approx([b**2 + c**2, a**2 + c**2, a**2 + b**2])


@needs_exudyn
def test_swing_is_that_of_exudyn(body_of):
    """Whole swing; the difference is of the steps, and of second order in them."""
    strip = body_of(flexible_swing)
    gaps = []
    for step in (2e-3, 1e-3):
        swing = flexible_swing.run(strip, end=1.0, step=step)
        gaps.append(swing.gap.max() / flexible_swing.SIZE[0])
    assert gaps[-1] < 1e-5
    assert np.log2(gaps[0] / gaps[1]) == pytest.approx(2.0, abs=0.3)
    # It is a swing, and it bends.
    assert swing.ours[:, 2].min() < -0.99 and swing.ours[-1, 0] < -0.99
    assert 1e-3 < np.abs(swing.bending).max() < 3e-3


@needs_exudyn
def test_slider_crank_is_that_of_exudyn(body_of):
    rod = body_of(slider_crank)
    ours, theirs = (run(rod, slider_crank.TURN / 4, STEP) for run in (slider_crank.run_ours, slider_crank.run_theirs))
    assert ours.gap(theirs).max() < 1e-6 * slider_crank.LENGTH
    assert 0.01 < np.abs(ours.deflection).max() / slider_crank.LENGTH < 0.02
    # The crank turns as it is told, and the slider follows.
    angle = slider_crank.SPEED * ours.time
    pin = slider_crank.CRANK * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    assert np.abs(ours.pin - pin).max() < 1e-9 and np.abs(theirs.pin - pin).max() < 1e-9
    assert np.abs(ours.wrist[:, 1:]).max() < 1e-9 and np.abs(ours.lead).max() < 1e-4


def test_the_slider_crank_of_a_file_is_that_of_the_program_and_of_exudyn(body_of, tmp_path):
    rod = body_of(slider_crank)
    for name in ("slider_crank_system.toml", "slider_crank.h5"):
        place = PIPELINES if name.endswith(".toml") else Path(rod.file).parent
        shutil.copy(place / name, tmp_path / name)
    changes = [f"simulation.end={slider_crank.TURN / 4!r}", f"simulation.step={STEP!r}"]
    file = run_system(load_system(tmp_path / "slider_crank_system.toml", changes)).built.file
    told = read_recording(file.output)
    markers = told.bodies["rod"].markers
    from_file = slider_crank.Run(told.time, *(markers[name].position for name in slider_crank.POINTS))
    assert from_file.gap(slider_crank.run_ours(rod, slider_crank.TURN / 4, STEP)).max() < 1e-10 * slider_crank.LENGTH
    assert (tmp_path / "slider_crank_system.vtkhdf").stat().st_size > 10_000
    if not exudyn_missing():
        theirs = slider_crank.run_theirs(rod, slider_crank.TURN / 4, STEP)
        assert from_file.gap(theirs).max() < 1e-6 * slider_crank.LENGTH


def test_a_rod_that_bends_draws_the_slider_in(body_of):
    """A half wave of height d shortens the chord by pi^2 d^2 / 4 l: of the body with stiffening only."""
    rod = body_of(slider_crank)
    plain, stiff = (slider_crank.run_ours(rod, slider_crank.TURN / 6, STEP, stiffening=s) for s in (False, True))
    at = int(np.argmax(stiff.deflection))
    drawn_in = np.pi**2 * stiff.deflection[at] ** 2 / (4 * slider_crank.LENGTH)
    assert plain.lead[at] - stiff.lead[at] == pytest.approx(drawn_in, rel=0.1)
    # Pulled by the slider, the rod bends less.
    assert 0.8 < stiff.deflection.max() / plain.deflection.max() < 0.95


def southwell(parts, count=8):
    """c of the first flap mode of a thin clamped beam by Ritz's method: speeds as parts of its frequency at rest."""
    x, weight = np.polynomial.legendre.leggauss(40)
    x, weight = (x + 1) / 2, weight / 2
    shapes = [Legendre.basis(k, domain=[0, 1]).convert(kind=np.polynomial.Polynomial) for k in range(count)]
    shapes = [np.polynomial.Polynomial([0, 0, 1]) * shape for shape in shapes]
    y, y1, y2 = (np.array([(shape.deriv(k) if k else shape)(x) for shape in shapes]) for k in range(3))
    M, K, T = (y * weight) @ y.T, (y2 * weight) @ y2.T, (y1 * (weight * (1 - x**2) / 2)) @ y1.T
    rest = sl.eigh(K, M, eigvals_only=True)[0]
    assert np.sqrt(rest) == pytest.approx(3.516015, rel=1e-6)
    squares = np.array(parts) ** 2 * rest
    return np.array([(sl.eigh(K + square * T, M, eigvals_only=True)[0] - rest) / square for square in squares])


def test_rotating_beam_stiffens_as_beam_theory_says(body_of):
    blade = body_of(rotating_beam)
    exact = southwell(rotating_beam.SPEEDS)
    assert exact[0] == pytest.approx(1.193, abs=5e-4)
    flap, lag = (rotating_beam.coefficients(blade, axis, stiffening=True) for axis in (2, 1))
    assert np.abs(flap - 1.19).max() < 0.01 and np.abs(flap - exact).max() < 0.005
    assert np.abs(lag - (exact - 1)).max() < 0.01
    # Without stiffening: no change of flapping, and a lag mode that grows softer.
    flap, lag = (rotating_beam.coefficients(blade, axis, stiffening=False) for axis in (2, 1))
    assert np.abs(flap).max() < 1e-3 and np.abs(lag + 1).max() < 5e-3


def test_without_exudyn_one_simulator_is_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "exudyn", None)
    assert flexible_swing.main(["--folder", str(tmp_path), "--quick"]) == 0
    assert "pip install exudyn" in capsys.readouterr().out
    assert (tmp_path / "flexible_swing.png").stat().st_size > 20_000


@pytest.mark.parametrize("point", [(0.5, 0.025, 0.015), (0.52, 0.035, 0.021)], ids=["on the beam", "beside it"])
def test_examples_of_the_documentation(tmp_path, point):
    """Also for a tip that is not the mean of its nodes: Exudyn gives it an offset, which turns with the body."""
    own, other = ((ROOT / "docs" / "howto" / f"multibody{name}.md").read_text() for name in ("", "_exudyn"))
    (in_exudyn,) = re.findall(r"```python\n(.*?)```", other, re.DOTALL)
    code = "".join(re.findall(r"```python\n(.*?)```", own, re.DOTALL))
    if not exudyn_missing():
        # The rod of that page is this beam.
        for rod, beam in (("rod.h5", "beam.h5"), ("BIGEND", "ROOT"), ("SMALLEND", "TIP")):
            in_exudyn = in_exudyn.replace(rod, beam)
        code += in_exudyn
    code = code.replace("data/small_meshes", str(ROOT / "data" / "small_meshes"))
    code = code.replace('coupling="rigid")', f'coupling="rigid", point={point} if name == "TIP" else None)')
    done = python(code, tmp_path)
    assert done.code == 0, done.errors
    *tip, energy = map(float, re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", done.output.splitlines()[0]))
    # A rod of 0.5 m that fell for 0.3 s, and bent little; its energy is what it was at the start: none.
    assert np.hypot(tip[0], tip[2]) == pytest.approx(np.hypot(point[0], point[2] - 0.015), abs=2e-3)
    assert -0.52 < tip[2] < -0.3
    assert abs(energy) < 1e-3
    if not exudyn_missing():
        other = list(map(float, re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", done.output.splitlines()[-1])))
        assert np.abs(np.array(tip) - other).max() < 5e-4
    motion = recover(tmp_path / "beam.h5", tmp_path / "motion.npz", tmp_path / "again.vtkhdf")
    assert motion.steps == 301 and f"{motion.peak[0] / 1e6:.3f} MPa at node {motion.peak[1]}" in done.output
    if not exudyn_missing():
        series = [vtk_points(tmp_path / name) for name in ("again.vtkhdf", "exudyn.vtkhdf")]
        assert np.abs(series[0] - series[1]).max() < 5e-4
        with h5py.File(tmp_path / "exudyn.vtkhdf") as file:
            assert file["VTKHDF/Steps"].attrs["NSteps"] == motion.steps


def vtk_points(path):
    """Motion of the nodes at the last step."""
    with h5py.File(path) as file:
        steps = file["VTKHDF/Steps"]
        count = int(file["VTKHDF/NumberOfPoints"][0])
        start = int(steps["PointDataOffsets/motion"][-1])
        return file["VTKHDF/PointData/motion"][start : start + count]
