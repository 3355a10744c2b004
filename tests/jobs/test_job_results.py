"""Whole jobs: the same input gives the same bytes, and units do not matter."""

import os
import signal
import sys

import h5py
import meshio
import numpy as np
import pytest

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.solver import budget_of, solver_of
from morembs.body.file import read_body
from morembs.exporters.state_space import state_space
from morembs.exporters.state_space_files import read_state_space
from morembs.linalg.sparse.mumps import EmbeddedMumps
from morembs.problem import Problem
from tests.support import decks
from tests.support.processes import apart, morembs, program
from tests.support.refusals import refusal
from tests.support.stored import everything

JOB = """
[model]
mesh = "{mesh}"
units = "{units}"
[[material]]
young = {young}
poisson = 0.3
density = {density}
[[interface]]
name = "root"
nodes = "set:ROOT"
coupling = "rigid"
[[interface]]
name = "tip"
nodes = "{tip}"
coupling = "average"
point = {point}
[damping]
rayleigh = {{ alpha = 5.0, beta = 2e-6 }}
[[reduce]]
name = "cb"
method = "craig-bampton"
modes = 16
inertia_modes = true
[[reduce]]
method = "free-interface"
up_to_hz = 6000.0
[output]
path = "{name}.h5"
nodes = "skin"
"""


def reduce(folder, name, **values):
    (folder / f"{name}.toml").write_text(JOB.format(name=name, **values))
    done = morembs("reduce", f"{name}.toml", folder=folder)
    assert done.code == 0, done.errors
    return folder / f"{name}.h5"


OUT_OF_CORE = 'name = "mumps-embedded"\nout_of_core = true'
SI = {"units": "m-kg-s", "young": 2.1e11, "density": 7850.0, "tip": "set:TIP", "point": "[0.5, 0.02, 0.01]"}


def test_two_runs_give_the_same_bytes(small_meshes, tmp_path):
    a, b = (reduce(tmp_path, name, mesh=small_meshes / "beam.msh", **SI) for name in ("one", "two"))
    with h5py.File(a) as file_a, h5py.File(b) as file_b:
        first, second = everything(file_a), everything(file_b)
    assert len(first) > 40 and first == second


def test_millimetres_and_metres_give_the_same_body(small_meshes, tmp_path):
    mesh = meshio.read(small_meshes / "beam.msh")
    mesh.points *= 1e3
    mesh.write(tmp_path / "mm.msh", file_format="gmsh")
    values = {"units": "mm-t-s", "young": 2.1e5, "density": 7.85e-9, "tip": "box:500,-1e3,-1e3,500,1e3,1e3"}
    mm = read_body(reduce(tmp_path, "mm", mesh="mm.msh", point="[500.0, 20.0, 10.0]", **values))
    si = read_body(reduce(tmp_path, "si", mesh=small_meshes / "beam.msh", **SI))
    assert mm.mass == pytest.approx(si.mass, rel=1e-9)
    assert mm.inertia == pytest.approx(si.inertia, rel=1e-9, abs=1e-12)
    for name in ("cb", "free-interface"):
        a, b = mm.bodies[name], si.bodies[name]
        assert a.frequencies_hz == pytest.approx(b.frequencies_hz, rel=1e-9, abs=1e-9)
        assert np.abs(a.stiffness_matrix - b.stiffness_matrix).max() < 1e-9 * np.abs(b.stiffness_matrix).max()
        assert np.abs(a.damping_matrix - b.damping_matrix).max() < 1e-9 * np.abs(b.damping_matrix).max()


@pytest.mark.parametrize("fault", ["mesh", "job", "picture"])
def test_results_never_overwrite_what_they_come_from(small_meshes, tmp_path, fault):
    (tmp_path / "beam.msh").write_bytes((small_meshes / "beam.msh").read_bytes())
    text = JOB.format(name="body", mesh="beam.msh", **SI)
    path = {"mesh": "beam.msh", "job": "job.toml", "picture": "same.png"}[fault]
    text = text.replace('path = "body.h5"', f'path = "{path}"\npicture = "same.png"')
    (tmp_path / "job.toml").write_text(text)
    for verb in ("check", "reduce"):
        done = morembs(verb, "job.toml", folder=tmp_path)
        assert done.code == 2 and "would overwrite" in done.errors and "Traceback" not in done.errors
    assert (tmp_path / "beam.msh").read_bytes() == (small_meshes / "beam.msh").read_bytes()
    assert (tmp_path / "job.toml").read_text() == text and not (tmp_path / "same.png").exists()


def test_a_terminated_run_leaves_nothing_behind(small_meshes, tmp_path):
    """SIGTERM while factors are on disk: no scratch, no temporary file, the old result untouched."""
    if reason := EmbeddedMumps.unavailable():
        pytest.skip(reason)
    (tmp_path / "scratch").mkdir()
    text = JOB.format(name="body", mesh=small_meshes / "beam.msh", **SI)
    # A budget would not do: it is that of the whole process, whose libraries take more than this factor.
    (tmp_path / "job.toml").write_text(f'{text}[solver]\nscratch = "scratch"\n{OUT_OF_CORE}\n')
    (tmp_path / "body.h5").write_text("old")
    command = program(["reduce", "job.toml"])

    def end(self, **options):
        sys.stdout.write(f"{len(os.listdir('scratch'))} {self.statics.factor.stats.out_of_core}")
        sys.stdout.flush()
        os.kill(os.getpid(), signal.SIGTERM)

    def work():
        Problem.fixed_modes = end
        command()

    done = apart(work, tmp_path)
    assert done.code == 143, done.errors
    files, on_disk = done.output.split()
    # Arrays are in files without names, beside the factor.
    assert int(files) >= 1 and on_disk == "True"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["body.h5", "job.toml", "scratch"]
    assert not list((tmp_path / "scratch").iterdir()) and (tmp_path / "body.h5").read_text() == "old"


def test_a_job_out_of_core_gives_the_same_body(tmp_path):
    """Factor and arrays on disk, of which a small model would need nothing."""
    if reason := EmbeddedMumps.unavailable():
        pytest.skip(reason)
    results = []
    for text in ('name = "mumps-embedded"', OUT_OF_CORE):
        job = load_job(decks.folder(tmp_path, {"solver": text}))
        results.append(run_job(job))
        solver = solver_of(job)
        assert results[-1].factor.out_of_core == (text == OUT_OF_CORE)
        with budget_of(job, solver) as budget:
            array = budget.empty(3)  # held, as files without a holder are given up
            assert array.base is None or text == OUT_OF_CORE
            assert budget.files == (text == OUT_OF_CORE)
    first, second = (result.bodies[0].reduced.K for result in results)
    assert np.abs(first - second).max() < 1e-9 * np.abs(first).max()


def test_out_of_core_needs_a_solver_that_can(tmp_path):
    job = load_job(decks.folder(tmp_path, {"solver": "out_of_core = true"}))
    with refusal("missing", "solver", "out_of_core"):
        run_job(job)


@pytest.mark.parametrize("step", [None, 1e-6])
def test_a_state_space_beside_the_body(tmp_path, step):
    """It is that of the stored body; of two bodies it is the one that is named."""
    asked = 'path = "x.npz"\ninputs = ["left:acceleration:z"]\noutputs = ["left:reaction", "right:acceleration"]\n'
    asked += 'held = ["left:x+y+rx+ry+rz"]\nbody = "small"' + ("" if step is None else f"\nstep = {step}")
    second = 'name = "small"\nmethod = "craig-bampton"\nmodes = 2'
    run_job(load_job(decks.folder(tmp_path, {"state_space": asked, "reduce2": second})))
    system = read_state_space(tmp_path / "x.npz")
    wanted = state_space(
        read_body(tmp_path / "part.h5"),
        ["left:acceleration:z"],
        ["left:reaction", "right:acceleration"],
        held=["left:x+y+rx+ry+rz"],
        name="small",
    )
    wanted = wanted if step is None else wanted.discrete(step)
    assert system.dt == (step or 0.0) and system.names == wanted.names and len(system.A) == 16
    for key in "ABCD":
        matrix = getattr(wanted, key)
        assert getattr(system, key) == pytest.approx(matrix, rel=1e-9, abs=1e-12 * np.abs(matrix).max()), key
