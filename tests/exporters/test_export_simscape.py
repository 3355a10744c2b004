"""The MATLAB file for Simscape: the same body in coordinates that begin with the motions of its interfaces."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import scipy.io as sio
import scipy.linalg as sl

from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.exporters import export_body
from morembs.exporters.simscape import Simscape, quaternion
from morembs.fem import rigid_motion
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Krylov, Modal
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

LENGTH = 0.5
REDUCERS = {
    "cb": CraigBampton(modes=4),
    "more": CraigBampton(modes=20, inertia_modes=True),
    "krylov": Krylov(moments=2),
}


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A damped bar with two frames and a direct interface between them, reduced in several ways."""
    model = steel(box("hex8", (6, 2, 2), (LENGTH, 0.05, 0.03)))
    # "cb" begins with the frames already, but the direct interface moves with them.
    chosen = (("left", 0.0, "rigid"), ("right", LENGTH, "average"), ("mid", LENGTH / 2, "direct"))
    faces = [
        make_interface(model, name=n, nodes=where(model, 0, x)[:2] if c == "direct" else where(model, 0, x), coupling=c)
        for n, x, c in chosen
    ]
    path = tmp_path_factory.mktemp("simscape") / "bar.h5"
    with Problem(model, faces, damping=Damping(alpha=2.0, beta=1e-5)) as problem:
        part = make_part(problem)
        reduced = [reducer.reduce(problem, name) for name, reducer in {**REDUCERS, "few": Modal(modes=2)}.items()]
        write_body(path, [elastic_body(problem, reduced_model, part) for reduced_model in reduced])
    return path


def frame_rows(source):
    """Rows of the output matrix: six of "left", then six of "right"."""
    names = list(source.interfaces)
    return np.concatenate([np.flatnonzero(source.input_interface == names.index(n)) for n in ("left", "right")])


@pytest.mark.parametrize("name", REDUCERS)
def test_same_body_with_the_interfaces_first(stored, tmp_path, name):
    written = export_body(stored, "simscape", body=name, path=tmp_path / "a.mat")
    mat = sio.loadmat(written.paths[0], squeeze_me=True)
    source = read_body(stored)
    body = source.bodies[name]
    K, M, D = mat["K"], mat["M"], mat["D"]
    assert K.shape == body.stiffness_matrix.shape and all(np.array_equal(A, A.T) for A in (K, M, D))
    own = sl.eigh(body.stiffness_matrix, body.mass_matrix, eigvals_only=True)
    assert sl.eigh(K, M, eigvals_only=True)[6:] == pytest.approx(own[6:], rel=1e-7)
    # Motions of the frames under forces on them, at a frequency: the first coordinates, with nothing between.
    s = 2j * np.pi * 700.0
    C = body.output_matrix[frame_rows(source)]
    wanted = C @ np.linalg.solve(s**2 * body.mass_matrix + s * body.damping_matrix + body.stiffness_matrix, C.T)
    response = np.linalg.inv(s**2 * M + s * D + K)[:12, :12]
    assert np.abs(response - wanted).max() < 1e-7 * np.abs(wanted).max()


@pytest.mark.parametrize("name", REDUCERS)
def test_rigid_motion_of_the_frames_has_mass_and_no_stiffness(stored, tmp_path, name):
    """Frames moved as one rigid body, no modes: mass, centre and inertia from M, nothing from K."""
    mat = sio.loadmat(export_body(stored, "simscape", body=name, path=tmp_path / "a.mat").paths[0], squeeze_me=True)
    origins, n = mat["interface_origins"], len(mat["K"])
    assert origins == pytest.approx(np.array([[0, 0.025, 0.015], [LENGTH, 0.025, 0.015]]), abs=1e-12)
    assert np.array_equal(mat["interface_quaternions"], [[1, 0, 0, 0]] * 2)
    assert list(mat["interface_names"]) == ["left", "right"]
    R = np.zeros((n, 6))
    R[:12] = np.vstack([rigid_motion(np.tile(p, (6, 1)), np.arange(6)) for p in origins - mat["center_of_mass"]])
    assert np.abs(mat["K"] @ R).max() < 1e-7 * np.abs(mat["K"]).max()
    mass = R.T @ mat["M"] @ R
    wanted = sl.block_diag(mat["mass"] * np.eye(3), mat["inertia_about_center_of_mass"])
    assert np.abs(mass - wanted).max() < 1e-7 * mat["mass"]
    frequencies = np.atleast_1d(mat["fixed_interface_frequencies_hz"])
    assert frequencies.min() > 500 and len(frequencies) == n - 12


def test_frames_at_an_angle_and_same_bytes(stored, tmp_path):
    source = read_body(stored)
    a = np.deg2rad(30)
    turned = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    left = replace(source.interfaces["left"], axes=turned)
    source = replace(source, interfaces={**source.interfaces, "left": left})
    for name in ("a", "b"):
        Simscape().export(source, source.bodies["cb"], tmp_path / f"{name}.mat")
    quaternions = sio.loadmat(tmp_path / "a.mat")["interface_quaternions"]
    assert quaternions[0] == pytest.approx([np.cos(a / 2), 0, 0, np.sin(a / 2)], abs=1e-14)
    assert (tmp_path / "a.mat").read_bytes() == (tmp_path / "b.mat").read_bytes()
    assert b"Created" not in (tmp_path / "a.mat").read_bytes()[:116]  # the time of day
    rng = np.random.default_rng(0)
    for _ in range(200):
        q = rng.normal(size=4) * rng.choice([1, 1e-3], size=4)
        q *= np.sign(q[0]) / np.linalg.norm(q)
        w, x, y, z = q
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        assert quaternion(R) == pytest.approx(q, abs=1e-12)


@pytest.mark.skipif(shutil.which("octave") is None, reason="octave is not installed")
def test_octave_reads_it(stored, tmp_path):
    path = export_body(stored, "simscape", body="cb", path=tmp_path / "a.mat").paths[0]
    script = (
        "s = load('a.mat'); printf('%.15g %d %d %s %s', s.K(1,1), size(s.interface_origins), "
        "s.interface_names{2}, class(s.dof_order));"
    )
    printed = subprocess.run(
        ["octave", "--no-gui", "--no-init-file", "--eval", script],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split()
    assert float(printed[0]) == pytest.approx(sio.loadmat(path)["K"][0, 0], rel=1e-14)
    assert printed[1:] == ["2", "3", "right", "char"]


def test_notes_and_name(stored):
    written = export_body(stored, "simscape", body="cb")
    assert written.paths == (stored.with_name("bar_cb.mat"),)
    notes = " | ".join(written.notes)
    for words in ("left, right", "left out: mid", "variable D"):
        assert words in notes
    written.paths[0].unlink()


def test_bad_input(stored, tmp_path):
    source = read_body(stored)
    body = source.bodies["cb"]
    short = {n: replace(interface, components=interface.components[:3]) for n, interface in source.interfaces.items()}
    direct = {n: replace(interface, coupling="direct") for n, interface in source.interfaces.items()}
    skew = body.stiffness_matrix + np.triu(body.stiffness_matrix, 1)
    cases = (
        (source, source.bodies["few"], ("model", "modes", "12")),
        (replace(source, interfaces=short), body, ("value", "components", "left")),
        (replace(source, interfaces=direct), body, ("unsupported", "coupling")),
        (source, replace(body, rigid_count=0), ("unsupported", "supports")),
        (source, replace(body, stiffness_matrix=skew), ("unsupported",)),
    )
    for altered, wrong, message in cases:
        with refusal(*message):
            Simscape().export(altered, wrong, tmp_path / "a.mat")
    assert not list(tmp_path.iterdir())
    with refusal("missing", "", "4"):
        export_body(stored, "simscape")
