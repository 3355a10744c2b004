"""Planar members of meshes: plane elements with a thickness, and solids, against beams and closed forms."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.dynamics.gmp import Parameterised, ParameterisedBody, ReducedMember
from morembs.dynamics.gmp.export import export_member
from morembs.dynamics.gmp.stored import read_members
from morembs.dynamics.nonlinear import PlanarBeam, Section
from morembs.importers.plane_mesh import read_plane_mesh
from tests.support.fmus import InCasadi, needs_compiler
from tests.support.processes import morembs
from tests.support.refusals import Refusal, refusal

LENGTH, SIDE, E, DENSITY = 0.152, 8.862e-3, 3e6, 2770.0
JOB = f"""
[member]
mesh = "strip.inp"
thickness = {SIDE}
young = {E}
density = {DENSITY}
start = "set:LEFT"
end = "set:RIGHT"

[[reduce]]
name = "strip"
method = "global-modal-parameterisation"
modes = 1
reach = 0.3
points_per_angle = 3

[output]
path = "strip.h5"
"""
# Cells of meshio in a square of nine points, row by row from the lower left one.
CELLS = {
    "triangle": [[0, 2, 8], [8, 0, 6]],
    "triangle6": [[0, 2, 8, 1, 5, 4], [0, 8, 6, 4, 7, 3]],
    "quad": [[0, 2, 8, 6]],
    "quad8": [[0, 2, 8, 6, 1, 5, 7, 3]],
    "quad9": [[0, 6, 8, 2, 3, 7, 5, 1, 4]],  # clockwise
}


def strip(folder: Path, kind: str = "quad8", *, turn: float = 0.0, count: int = 8, name: str = "strip.inp") -> Path:
    """A mesh of ``count`` squares of nine points along x from (1, 2), turned about it; its ends are LEFT and RIGHT."""
    x, y = np.meshgrid(np.linspace(0, LENGTH, 2 * count + 1), np.linspace(-SIDE / 2, SIDE / 2, 3))
    at = np.array([[j * (2 * count + 1) + i for j in range(3) for i in range(2 * k, 2 * k + 3)] for k in range(count)])
    cells = np.concatenate([at[:, cell] for cell in CELLS[kind]])
    used, rows = np.unique(cells, return_inverse=True)
    c, s = np.cos(turn), np.sin(turn)
    places = np.column_stack((1 + c * x.ravel() - s * y.ravel(), 2 + s * x.ravel() + c * y.ravel(), 0 * x.ravel()))
    ends = {"LEFT": x.ravel()[used] == 0, "RIGHT": x.ravel()[used] == LENGTH}
    sets = {name: np.flatnonzero(chosen) for name, chosen in ends.items()}
    meshio.Mesh(places[used], [(kind, rows.reshape(cells.shape))], point_sets=sets).write(folder / name)
    return folder / name


def made(folder: Path, text: str = JOB, *changes: str) -> Parameterised:
    (folder / "strip.toml").write_text(text)
    return read_members(run_job(load_job(folder / "strip.toml", changes)).job.output)["strip"]


@pytest.fixture(scope="module")
def beam() -> Parameterised:
    """Without Poisson's ratio, so that rigid ends do not hold sections from widening, and without rotary inertia, as
    the modes of a solid are those of inertia across it."""
    A, I = SIDE**2, SIDE**4 / 12  # noqa: E741
    section = Section(EA=E * A, GA=5 / 6 * E * A / 2, EI=E * I, mass=DENSITY * A, rotary=1e-6 * DENSITY * I)
    return ReducedMember(PlanarBeam.straight(LENGTH, 16, section), modes=1, reach=0.3, points_per_angle=3).data


@pytest.mark.parametrize("kind", CELLS)
def test_a_slender_strip_is_a_beam(tmp_path: Path, beam: Parameterised, kind: str) -> None:
    strip(tmp_path, kind, count=16)
    found = made(tmp_path, JOB, "member.poisson=0.0")
    ends = np.array([0.3, -0.3])
    assert found.length == pytest.approx(LENGTH, rel=1e-12)
    assert found.squares[0] == pytest.approx(beam.squares[0], rel=0.01)
    energy, expected = (float(data.at(ends)[2][0]) for data in (found, beam))
    assert energy == pytest.approx(expected, rel=0.01)
    # A circle of the angle 0.6: half of EI angle^2 / length.
    assert energy == pytest.approx(0.5 * E * SIDE**4 / 12 * 0.6**2 / LENGTH, rel=0.01)


def test_the_first_frequency_tends_to_that_of_a_clamped_beam(tmp_path: Path) -> None:
    """Of a strip that is thin in its plane, whose shear and rotary inertia do little: 22.373 sqrt(EI / m) / L^2."""
    x, y, size = np.linspace(0, LENGTH, 49), np.linspace(-SIDE / 8, SIDE / 8, 3), 49
    places = np.array([(a, b, 0.0) for b in y for a in x])
    at = [[size * j + i for j in range(3) for i in range(2 * k, 2 * k + 3)] for k in range(24)]
    cells = np.array(at)[:, CELLS["quad8"][0]]
    used, rows = np.unique(cells, return_inverse=True)
    ends = {name: np.flatnonzero(places[used][:, 0] == value) for name, value in (("LEFT", 0.0), ("RIGHT", LENGTH))}
    meshio.Mesh(places[used], [("quad8", rows.reshape(cells.shape))], point_sets=ends).write(tmp_path / "strip.inp")
    height = SIDE / 4
    found = made(tmp_path, JOB, f"member.thickness={height}", "reduce.reach=0.1", "member.poisson=0.0")
    expected = 22.3733 * np.sqrt(E * height**2 / 12 / DENSITY) / LENGTH**2
    assert np.sqrt(found.squares[0]) == pytest.approx(expected, rel=5e-3)


def test_where_a_mesh_lies_and_its_units_do_not_matter(tmp_path: Path) -> None:
    strip(tmp_path, count=4)
    here = made(tmp_path)
    strip(tmp_path, turn=2.0, count=4)
    there = made(tmp_path)
    for name in ("squares", "length", "peaks"):
        assert np.asarray(getattr(there, name)) == pytest.approx(np.asarray(getattr(here, name)), rel=1e-6)
    assert there.energy.coefficients == pytest.approx(
        here.energy.coefficients, abs=1e-8 * np.abs(here.energy.coefficients).max()
    )
    mesh = meshio.read(tmp_path / "strip.inp")
    meshio.Mesh(1e3 * mesh.points, mesh.cells, point_sets=mesh.point_sets).write(tmp_path / "strip.inp")
    text = '[model]\nunits = "mm-t-s"\n' + JOB.replace(str(SIDE), str(1e3 * SIDE)).replace(str(E), "3.0")
    scaled = made(tmp_path, text.replace(str(DENSITY), "2.77e-9"))
    assert scaled.squares == pytest.approx(here.squares, rel=1e-6)


def test_a_mesh_of_solids_is_the_same_member(tmp_path: Path) -> None:
    """The layer of solids that plane elements become, read from a file of its own."""
    layer = read_plane_mesh(strip(tmp_path, count=4), SIDE)
    plane = made(tmp_path)
    cells = [("hexahedron20", np.asarray(layer.blocks[0].nodes))]
    meshio.Mesh(np.asarray(layer.nodes.xyz), cells).write(tmp_path / "solid.vtk")
    text = JOB.replace(f"thickness = {SIDE}\n", "").replace("strip.inp", "solid.vtk")
    for name, rows in layer.nodes.sets.items():
        text = text.replace(f"set:{name}", f"ids:{','.join(map(str, rows + 1))}")
    solid = made(tmp_path, text)
    assert solid.squares == pytest.approx(plane.squares, rel=1e-9)
    assert solid.energy.coefficients == pytest.approx(
        plane.energy.coefficients, abs=1e-9 * plane.energy.coefficients.max()
    )


def test_edges_that_are_named_take_their_middles(tmp_path: Path) -> None:
    """Lines of a physical group in a mesh of linear triangles."""
    path = strip(tmp_path, "triangle", count=2)
    flat = meshio.read(path)
    left = flat.point_sets["LEFT"]
    lines, groups = np.array([left]), {"LEFT": np.array([1, 1]), "PART": np.array([2, 2])}
    tags = [np.ones(1, dtype=int), np.full(len(flat.cells[0].data), 2)]
    cells = [("line", lines), ("triangle", flat.cells[0].data)]
    named = meshio.Mesh(
        flat.points, cells, cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags}, field_data=groups
    )
    named.write(tmp_path / "strip.msh", file_format="gmsh22", binary=False)
    mesh = read_plane_mesh(tmp_path / "strip.msh", SIDE)
    ends = mesh.nodes.xyz[mesh.nodes.sets["LEFT"]]
    assert len(ends) == 8 and np.unique(np.round(ends[:, 1] - 2, 9)).tolist() == pytest.approx([-SIDE / 2, 0, SIDE / 2])


@needs_compiler
def test_the_fmu_of_a_mesh_accelerates_as_the_member(tmp_path: Path) -> None:
    """Its fields have a full mass matrix and no rotations, other than those of beams."""
    strip(tmp_path, count=4)
    member = ReducedMember.of(made(tmp_path))
    system = InCasadi(export_member(tmp_path / "strip.h5", "fmu", options={"held": []}).paths[0])
    c, s = LENGTH * np.cos(0.1), LENGTH * np.sin(0.1)
    q = np.array([0.1, 0.2, 0.3, 0.1 + c, 0.2 + s, -0.1, 1e-5])
    v = np.concatenate((np.random.default_rng(1).standard_normal(6), [1e-2]))
    M, force = ParameterisedBody(member).dynamics(0.0, q, v, np.array([0.0, -9.81, 0.0]))
    expected = np.linalg.solve(M, -force)
    frames = ("start", "end")
    places = [f"{frame}.{part}" for frame in frames for part in ("position.x", "position.y", "angle.z")]
    speeds = [f"{frame}.{part}" for frame in frames for part in ("velocity.x", "velocity.y", "angular_velocity.z")]
    names = [*(f"state.{name}" for name in places), "q[1]"], [*(f"state.{name}" for name in speeds), "q_rate[1]"]
    states = dict(zip([*names[0], *names[1]], [*q, *v], strict=True))
    rates, _ = system(states, {"gravity.y": -9.81})
    assert [rates[name] for name in names[1]] == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


def test_the_command_line_checks_a_mesh(tmp_path: Path) -> None:
    strip(tmp_path, count=4)
    (tmp_path / "strip.toml").write_text(JOB)
    checked = morembs("check", "strip.toml", folder=tmp_path)
    assert (
        checked.code == 0 and "a solid in large displacements" in checked.output and "start 8, end 8" in checked.output
    )
    (tmp_path / "strip.inp").unlink()
    refused = morembs("reduce", "strip.toml", folder=tmp_path)
    assert refused.code == 2 and "strip.inp" in refused.errors


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("young = 3000000.0\n", "", ("missing",)),
        ('start = "set:LEFT"\n', "", ("missing",)),
        ("[member]\n", "[member]\nlength = 1.0\n", ("conflict", "length")),
        ("modes = 1", 'modes = 1\nformulation = "membrane"', ("value", "formulation", "membrane")),
        ('mesh = "strip.inp"\n', "length = 1.0\nelements = 3\n", ("missing",)),
    ],
)
def test_keys_that_do_not_fit_are_named(tmp_path: Path, old: str, new: str, words: Refusal) -> None:
    assert old in JOB
    (tmp_path / "strip.toml").write_text(JOB.replace(old, new))
    with refusal(*words):
        load_job(tmp_path / "strip.toml")


@pytest.mark.parametrize(
    ("change", "words"),
    [('member.start="set:TOP"', ("unknown", "", "[member]")), ('member.end="set:LEFT"', ("value", "member"))],
)
def test_frames_that_are_not_there_are_named(tmp_path: Path, change: str, words: Refusal) -> None:
    strip(tmp_path, count=2)
    with refusal(*words):
        made(tmp_path, JOB, change)


def test_meshes_of_no_plane_part_are_named(tmp_path: Path) -> None:
    path = strip(tmp_path, count=2)
    mesh = meshio.read(path)
    bent = mesh.points + np.array([0, 0, 1.0]) * mesh.points[:, :1]
    meshio.Mesh(bent, mesh.cells).write(tmp_path / "bent.inp")
    with refusal("unsupported", "mesh"):
        read_plane_mesh(tmp_path / "bent.inp", SIDE)
    meshio.Mesh(mesh.points, [("line", np.array([[0, 1]]))]).write(tmp_path / "line.vtk")
    with refusal("missing", "elements"):
        read_plane_mesh(tmp_path / "line.vtk", SIDE)
    both = [("quad8", mesh.cells[0].data[:1]), ("quad", mesh.cells[0].data[1:, :4])]
    meshio.Mesh(mesh.points, both).write(tmp_path / "both.vtk")
    with refusal("unsupported", "mesh"):
        read_plane_mesh(tmp_path / "both.vtk", SIDE)
