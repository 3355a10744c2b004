"""``morembs init``: examples and what is proposed for parts reduce as they are, and nothing is written over."""

from __future__ import annotations

import sys
import tomllib
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
import scipy.io
from typer.testing import CliRunner

import morembs
from morembs import read_mesh
from morembs.app.cli.commands import app
from morembs.app.jobs.job import load_job
from morembs.app.jobs.template import job_text
from morembs.base.units import parse_units
from morembs.examples import EXAMPLES
from tests.conftest import ROOT
from tests.support import commands, structures
from tests.support.mesh_decks import ansys_archive
from tests.support.meshes import box
from tests.support.refusals import refusal

RUNNER = CliRunner()
MESHES = sorted((ROOT / "data" / "small_meshes").glob("*.[mi][sn][hp]"))
# Volumes in mm^3 of the bushes of the rod and of the bracket.
BUSHES = np.pi * 16 * (12.5**2 - 10**2 + 8**2 - 6**2)
BRACKET = 8 * (3 * 40**2 + 8 * 80 - np.pi * (2 * 5.5**2 + 8**2))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(*arguments: str, code: int = 0) -> str:
    """What a command says."""
    done = RUNNER.invoke(app, list(arguments))
    assert done.exit_code == code, done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, morembs.Body]:
    """Bodies of all examples, each by the commands that are said."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("examples"))
        for name in EXAMPLES:
            words = said("init", "--example", *([] if name == "rod" else [name]))
            command = words.partition("then: morembs ")[2].split()
            assert command == ["reduce", f"{name}.toml"]
            said(*command, "-q")
            assert Path(f"{name}.png").stat().st_size > 10_000
            (found[name],) = morembs.read_body(f"{name}.h5").bodies.values()
    return found


def test_examples_reduce_to_bodies_of_their_shapes(bodies: dict[str, morembs.Body]) -> None:
    mass = {name: bodies[name].floating.integrals.mass for name in ("rod", "bracket", "deck")}
    assert mass["bracket"] == pytest.approx(BRACKET * 7.85e-6, rel=1e-5)
    # The bushes of the deck are of bronze, all else of the rod is the same.
    assert mass["deck"] - mass["rod"] == pytest.approx(BUSHES * (8.8e-6 - 7.85e-6), rel=1e-3)
    for name, ends in (("rod", ["BIGEND", "SMALLEND"]), ("deck", ["BIGEND", "SMALLEND"])):
        points = [bodies[name].floating.markers[end].point for end in ends]
        np.testing.assert_allclose(points, [[0, 0, 0], [0.12, 0, 0]], atol=1e-9)
    # A cantilever of Euler and Bernoulli, 200 x 20 x 10 mm, which its held end makes stiffer by some per cent.
    first = 1.8751**2 / (2 * np.pi * 0.2**2) * np.sqrt(210e9 * 0.01**2 / 12 / 7850)
    assert first < bodies["matrices"].frequencies_hz[0] < 1.03 * first


def test_an_example_writes_over_nothing(folder: Path) -> None:
    for there in ("rod.toml", "rod.msh"):
        (folder / there).write_text("mine")
        assert f"{there} is there already" in said("init", "--example", code=2)
        assert [path.name for path in folder.iterdir()] == [there] and (folder / there).read_text() == "mine"
        (folder / there).unlink()
    said("init", "--example", "matrices")
    assert "K.mtx is there already" in said("init", "--example", "matrices", "-o", "other.toml", code=2)
    assert not (folder / "other.toml").exists()


@pytest.mark.usefixtures("folder")
def test_an_example_that_is_not_there_is_named() -> None:
    assert "did you mean 'bracket'?" in said("init", "--example", "braket", code=2)
    assert "leave --units out" in said("init", "--example", "--units", "m-kg-s", code=2)
    assert "NAME" not in said("init", "--example", "deck", "-o", "part.toml")
    assert 'path = "deck.h5"' in Path("part.toml").read_text()


@pytest.mark.usefixtures("folder")
def test_examples_in_python_are_there_twice_and_take_nothing_away() -> None:
    Path("other").mkdir()
    for name, example in EXAMPLES.items():
        write = getattr(morembs.examples, name)
        assert write() == Path(example.files[0]) and write("other") == Path("other") / example.files[0]
        written = Path(example.files[0]).read_bytes()
        # The same again: a cell of a notebook that is run a second time.
        assert write() == Path(example.files[0]) and Path(example.files[0]).read_bytes() == written
        Path(example.files[0]).write_bytes(b"mine")
        with refusal("output", example.files[0]):
            write()
        assert Path(example.files[0]).read_bytes() == b"mine"


def bare(mesh: Path, folder: Path) -> Path:
    """The solids of a mesh without any name."""
    read = morembs.read_mesh(mesh)
    names = {"tet4": "tetra", "tet10": "tetra10", "hex8": "hexahedron", "hex20": "hexahedron20", "wedge6": "wedge"}
    blocks = [(names.get(block.type, block.type), block.nodes) for block in read.blocks]
    path = folder / f"{mesh.stem}.vtu"
    meshio.Mesh(read.nodes.xyz, blocks).write(path)
    return path


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("named", [True, False], ids=["named", "bare"])
@pytest.mark.parametrize("mesh", MESHES, ids=lambda mesh: mesh.name)
def test_the_job_that_is_proposed_for_a_mesh_runs(mesh: Path, named: bool, tmp_path: Path) -> None:
    file = mesh if named else bare(mesh, tmp_path)
    assert "then: morembs check job.toml" in said("init", str(file), "-o", "job.toml")
    said("check", "job.toml", "-q")
    said("reduce", "job.toml", "-q")
    (body,) = morembs.read_body(f"{mesh.stem}.h5").bodies.values()
    assert 6 < len(body.stiffness_matrix) <= 44


# Sets that the meshes have, and what is found in their place where they have none.
FOUND = [
    ("conrod.msh", {"BIGEND": "hole_1_d50mm", "SMALLEND": "hole_2_d22mm"}),
    ("bracket.msh", {"TIP": "hole_1_d20mm", "FOOT": "end_1"}),
    ("plate.msh", {"LEFT": "end_1", "RIGHT": "end_2"}),
    ("beam.msh", {"ROOT": "end_1", "TIP": "end_2"}),
    ("wedge.msh", {"ROOT": "end_1", "TIP": "end_2"}),
    ("wedge15.msh", {"ROOT": "end_1", "TIP": "end_2"}),
    ("block.msh", {"ROOT": "end_1", "TIP": "end_2"}),
]


@pytest.mark.parametrize(("name", "names"), FOUND, ids=[name for name, _ in FOUND])
def test_interfaces_are_found_where_a_mesh_names_none(name: str, names: dict[str, str], tmp_path: Path) -> None:
    whole = morembs.read_mesh(ROOT / "data" / "small_meshes" / name)
    text = job_text(bare(ROOT / "data" / "small_meshes" / name, tmp_path), tmp_path)
    (tmp_path / "job.toml").write_text(text)
    proposed = {table.name: table.nodes for table in load_job(tmp_path / "job.toml").tables.interface}
    steel = morembs.isotropic(set="all", young=1.0, poisson=0.3, density=1.0)
    model = morembs.assemble(whole, [steel])
    for known, found in names.items():
        rows = morembs.select_nodes(model, proposed[found])
        np.testing.assert_array_equal(rows, whole.nodes.sets[known])
        # The comment above says how many.
        assert f': {len(rows)} nodes\n[[interface]]\nname = "{found}"' in text
    assert len(proposed) <= 4


def test_what_is_proposed_does_not_hang_on_the_order_of_elements(tmp_path: Path) -> None:
    read = morembs.read_mesh(ROOT / "data" / "small_meshes" / "conrod.msh")
    (block,) = read.blocks
    texts = set()
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(block.nodes))
        meshio.Mesh(read.nodes.xyz, [("tetra10", block.nodes[order])]).write(tmp_path / "part.vtu")
        texts.add(job_text(tmp_path / "part.vtu", tmp_path))
    assert len(texts) == 1


@pytest.mark.parametrize(("name", "kind", "sets"), [
    ("wedge15.msh", "wedge15", ("ROOT", "TIP")), ("bracket.msh", "hexahedron20", ("FOOT", "TIP")),
])  # fmt: skip
def test_faces_and_holes_across_no_axis_are_selected_whole(
    name: str, kind: str, sets: tuple[str, str], tmp_path: Path
) -> None:
    axes = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3
    whole = morembs.read_mesh(ROOT / "data" / "small_meshes" / name)
    meshio.Mesh(whole.nodes.xyz @ axes, [(kind, whole.blocks[0].nodes)]).write(tmp_path / "part.vtu")
    (tmp_path / "job.toml").write_text(job_text(tmp_path / "part.vtu", tmp_path))
    tables = load_job(tmp_path / "job.toml").tables.interface
    model = morembs.assemble(
        morembs.read_mesh(tmp_path / "part.vtu"), [morembs.isotropic(set="all", young=1.0, poisson=0.3, density=1.0)]
    )
    assert [table.nodes.partition(":")[0] for table in tables] == ["cylinder", "cylinder"]
    found = {tuple(morembs.select_nodes(model, table.nodes)) for table in tables}
    assert found == {tuple(whole.nodes.sets[each]) for each in sets}


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("kind", "points", "method"),
    [
        ("tetra", [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "modal"),
        ("hexahedron", [*[[x, y, 0] for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))],
                        *[[x, y, 2] for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]], "guyan"),
    ],
)  # fmt: skip
def test_one_element_reduces(kind: str, points: list[list[float]], method: str) -> None:
    """Interfaces of a tetrahedron would hold most of its nodes; those of a hexahedron leave none for modes."""
    meshio.Mesh(np.array(points, dtype=float), [(kind, [list(range(len(points)))])]).write("one.vtu")
    said("init", "one.vtu")
    assert f'\nmethod = "{method}"' in Path("one.toml").read_text()
    said("reduce", "one.toml", "-q")
    assert list(morembs.read_body("one.h5").bodies) == [method]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("sets", "names"), [("", ["end_1", "end_2"]), ("*NSET, NSET=CORNER\n1, 2, 5\n", ["CORNER"])])
def test_a_deck_of_shells_has_interfaces_that_do_not_hold_its_thickness(sets: str, names: list[str]) -> None:
    """Nodes at both sides of a shell follow those in its middle, and cannot follow an interface too."""
    lines = ["*NODE", *(f"{1 + i + 4 * j}, {10 * i}, {10 * j}, 0" for j in range(3) for i in range(4))]
    lines += ["*ELEMENT, TYPE=S4, ELSET=E"]
    for number, first in enumerate((1, 2, 3, 5, 6, 7), start=1):
        lines.append(f"{number}, {first}, {first + 1}, {first + 5}, {first + 4}")
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1e5, 0.3", "*DENSITY", "7.85e-9"]
    lines += ["*SHELL SECTION, ELSET=E, MATERIAL=STEEL", "0.5", sets]
    Path("plate.inp").write_text("\n".join(lines))
    said("init", "plate.inp")
    tables = load_job(Path("plate.toml")).tables
    assert [table.name for table in tables.interface] == names
    said("reduce", "plate.toml", "-q")
    assert morembs.read_body("plate.h5").mass == pytest.approx(30 * 20 * 0.5 * 7.85e-6)


@pytest.fixture(scope="module")
def step(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate of 60 x 20 x 10 mm with a hole of 8 mm."""
    gmsh = pytest.importorskip("gmsh", reason="Gmsh is not installed: pip install 'morembs[mesh]'")
    path = tmp_path_factory.mktemp("cad") / "part.step"
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        plate, drill = gmsh.model.occ.addBox(0, 0, 0, 60, 20, 10), gmsh.model.occ.addCylinder(10, 10, -1, 0, 0, 12, 4)
        gmsh.model.occ.cut([(3, plate)], [(3, drill)])
        gmsh.model.occ.synchronize()
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def test_a_cad_part_is_meshed_and_reduced(step: Path, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (folder / "part.step").write_bytes(step.read_bytes())
    words = said("init", "part.step", "--size", "0.4cm")
    assert "part.msh (elements up to 4 mm)" in words and not capfd.readouterr().out
    first = (folder / "part.msh").read_bytes()
    mesh = morembs.read_mesh("part.msh", "mm-t-s")
    assert {block.type for block in mesh.blocks} == {"tet10"} and list(mesh.element_sets) == ["SOLID_1"]
    tables = load_job(folder / "part.toml").tables
    assert [table.name for table in tables.interface] == ["hole_1_d8mm", "end_1"]
    said("reduce", "part.toml", "-q")
    stored = morembs.read_body("part.h5")
    # Curved edges are parabolas: 30 degrees of a circle miss its area by 1e-4 of the hole.
    assert stored.mass == pytest.approx((60 * 20 - np.pi * 4**2) * 10 * 7.85e-6, rel=1e-4)
    assert "part.toml is there already" in said("init", "part.step", code=2)
    (folder / "part.toml").unlink()
    assert "part.msh is there already" in said("init", "part.step", code=2)
    assert (folder / "part.msh").read_bytes() == first and not (folder / "part.toml").exists()
    said("init", "part.step", "--size", "4mm", "-o", "again.toml")
    assert (folder / "again.msh").read_bytes() == first


def test_cad_parts_that_cannot_be_meshed_leave_nothing(
    step: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "part.step").write_bytes(step.read_bytes())
    (folder / "cut.step").write_bytes(step.read_bytes()[:2000])
    (folder / "part.igs").write_text("no part\n")
    for arguments, words in (
        (["part.step", "--size", "3"], "such as 3mm"),
        (["part.step", "--size", "-3mm"], "such as 3mm"),
        (["part.step", "--units", "m-kg-s"], "leave --units out"),
        (["part.step", "--show"], "morembs init part.step --size 3mm"),
        (["cut.step"], "cannot be meshed by Gmsh"),
        (["part.igs"], "meshed by Gmsh"),
        (["gone.step"], "gone.step is not there"),
        ([str(MESHES[0]), "-o", "mesh.toml", "--size", "3mm"], "--size is for CAD parts"),
    ):
        assert words in said("init", *arguments, code=2)
    monkeypatch.setitem(sys.modules, "gmsh", None)
    assert "pip install 'morembs[mesh]'" in said("init", "part.step", code=2)
    assert {path.name for path in folder.iterdir()} == {"part.step", "cut.step", "part.igs"}


def test_a_deck_of_shells_becomes_a_job_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its file with the density that its material lacks, in units that its modulus tells."""
    monkeypatch.chdir(tmp_path)
    text = structures.plate("S8R").replace("*DENSITY\n7850.\n", "").replace("2.1e11", "210000.")
    (tmp_path / "plate.inp").write_text(text)
    commands.run("init", "plate.inp")
    job = (tmp_path / "plate.toml").read_text()
    assert 'file = "plate.inp"' in job and "density = 7.85e-09" in job and 'units = "mm-t-s"' in job
    commands.run("reduce", "plate.toml", "-q")
    grids = "GRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,1.,1.,0.\n"
    bulk = f"{grids}CTRIA3,1,1,1,2,3\nPSHELL,1,1,.1,1\nMAT1,1,2.1+11,,.3,7850.\n"
    (tmp_path / "plate.bdf").write_text(f"BEGIN BULK\n{bulk}ENDDATA\n")
    said = commands.run("init", "plate.bdf", "-o", "bulk.toml", code=2)
    assert "morembs import plate.bdf --engine auto -o part.model.h5" in said


def test_matrices_of_an_example_lie_beside_their_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path)
    commands.run("init", "--example", "matrices", "-o", "sub/m.toml")
    assert str(tmp_path) not in (tmp_path / "sub" / "m.toml").read_text()
    (tmp_path / "sub").rename(tmp_path / "moved")
    commands.run("reduce", "moved/m.toml", "-q")
    assert (tmp_path / "moved" / "m.h5").is_file()


@pytest.mark.parametrize("ending", ["mat", "npz", "model.h5"])
def test_inputs_of_a_file_of_matrices_become_the_interface(ending: str, tmp_path: Path) -> None:
    held = {"K": np.diag([2e4, 3e4, 5e4]) - 1e4 * np.diag([1, 1], 1) - 1e4 * np.diag([1, 1], -1), "M": np.eye(3)}
    held |= {"B": np.array([[0.0], [0.0], [1.0]]), "C": np.eye(3)[:2]}
    file = tmp_path / f"chain.{ending}"
    if ending == "mat":
        scipy.io.savemat(file, held)
    elif ending == "npz":
        np.savez(file, **held)
    else:
        morembs.write_model(file, morembs.from_matrices(**held))
    commands.run("init", file)
    job = tmp_path / "chain.toml"
    tables = tomllib.loads(job.read_text())
    assert [(one["name"], one["matrix"]) for one in tables["interface"]] == [("B", "B"), ("C", "C")]
    commands.run("reduce", job, "--set", "reduce.order=3", "-o", tmp_path / "b.h5")
    (body,) = morembs.read_body(tmp_path / "b.h5").bodies.values()
    exact = np.sqrt(np.linalg.eigvalsh(held["K"])) / (2 * np.pi)
    assert np.allclose(body.frequencies_hz, exact, rtol=1e-9)


def test_an_archive_without_materials_is_a_mesh(folder: Path) -> None:
    Path("part.cdb").write_text(ansys_archive(box("hex8", (4, 1, 1), (0.4, 0.1, 0.1))))
    said("init", "part.cdb")
    job = tomllib.loads(Path("part.toml").read_text())
    assert job["model"]["mesh"] == "part.cdb" and len(job["material"]) == 1
    assert "end_1 4, end_2 4" in said("check", "part.toml")


def test_a_deck_in_other_units_is_warned_of_as_by_an_import(tmp_path: Path) -> None:
    deck = tmp_path / "part.inp"
    nodes = "1, 0, 0, 0\n2, 100, 0, 0\n3, 0, 100, 0\n4, 0, 0, 100\n"
    material = "*MATERIAL, NAME=S\n*ELASTIC\n210000., 0.3\n*DENSITY\n{}\n*SOLID SECTION, ELSET=E, MATERIAL=S\n"
    text = f"*NODE\n{nodes}*ELEMENT, TYPE=C3D4, ELSET=E\n1, 1, 2, 3, 4\n{material}"
    deck.write_text(text.format("7850."))
    with pytest.warns(UserWarning) as told:
        job_text(deck, tmp_path)
    (said,) = [str(each.message) for each in told if "m/s" in str(each.message)]
    imported = ["import", str(deck), "--units", "mm-t-s", "-o", str(tmp_path / "part.model.h5")]
    assert f"warning: {said}\n" in RUNNER.invoke(app, imported).output
    deck.write_text(text.format("7.85e-9"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        job_text(deck, tmp_path)
    # A mesh is one of steel, so that its size alone can be odd.
    with pytest.warns(UserWarning, match="0.0001 x 0.0001 x 0.0001 m"):
        write_mesh(tmp_path / "tiny.bdf", 0.1)
        job_text(tmp_path / "tiny.bdf", tmp_path, parse_units("mm-t-s"))


def write_mesh(path: Path, size: float) -> None:
    """A tetrahedron in bulk data without a material."""
    grids = "".join(f"GRID,{i},,{x},{y},{z}\n" for i, (x, y, z) in enumerate(size * np.eye(4, 3, -1), 1))
    path.write_text(f"CEND\nBEGIN BULK\n{grids}CTETRA,1,1,1,2,3,4\nPSOLID,1,1\nENDDATA\n")


def test_bulk_data_without_materials_are_read_under_each_of_their_endings(tmp_path: Path) -> None:
    texts = set()
    for name in ("part.dat", "part.bdf"):
        write_mesh(tmp_path / name, 1.0)
        texts.add(job_text(tmp_path / name, tmp_path).replace(name, "part"))
    assert len(texts) == 1
    (tmp_path / "part.dat").write_text("hello\n")
    with refusal("missing", "GRID", "part.dat"):
        job_text(tmp_path / "part.dat", tmp_path)


def test_a_mesh_of_tecplot_is_told_from_bulk_data(tmp_path: Path) -> None:
    points = np.eye(4, 3, -1)
    meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))]).write(tmp_path / "part.dat", file_format="tecplot")
    assert len(read_mesh(tmp_path / "part.dat").nodes) == 4
