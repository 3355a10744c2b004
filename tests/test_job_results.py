"""Whole jobs: the same input gives the same bytes, and units do not matter."""

import subprocess
import sys

import h5py
import meshio
import numpy as np
import pytest
from test_storage import everything

from morembs.storage import read_body

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
    subprocess.run([sys.executable, "-m", "morembs.cli", "reduce", f"{name}.toml"], cwd=folder, check=True,
                   capture_output=True)  # fmt: skip
    return folder / f"{name}.h5"


SI = {"units": "m-kg-s", "young": 2.1e11, "density": 7850.0, "tip": "set:TIP", "point": "[0.5, 0.02, 0.01]"}


def test_two_runs_give_the_same_bytes(small_meshes, tmp_path):
    a, b = (reduce(tmp_path, name, mesh=small_meshes / "beam.msh", **SI) for name in ("one", "two"))
    with h5py.File(a) as one, h5py.File(b) as two:
        mine, other = everything(one), everything(two)
    # The recipe names the output file, which differs here on purpose.
    assert mine.pop("recipe") != other.pop("recipe")
    assert len(mine) > 40 and mine == other


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
