"""Meshes read with their sets, labels and node order."""

import meshio
import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.base.units import parse_units
from morembs.fem.elements import TYPES
from morembs.importers import read_mesh
from morembs.importers.meshes import SOLIDS
from tests.support.meshes import STEEL, box, steel
from tests.support.refusals import refusal

# Element type, nodes, exact volume of the shape in the file's units to the power three, its node sets.
SMALL = {
    "conrod.msh": ("tet10", 3652, 95_965.0, {"BIGEND", "SMALLEND"}),
    "bracket.msh": ("hex20", 844, 32_858.4, {"FOOT", "TIP"}),
    "bracket.inp": ("hex20", 844, 32_858.4, {"FOOT", "TIP"}),
    "plate.msh": ("hex8", 1425, 480_000.0, set()),
    "beam.msh": ("hex20", 621, 7.5e-4, {"ROOT", "TIP"}),
    "wedge.msh": ("wedge6", 42, 3600.0, set()),
    "wedge15.msh": ("wedge15", 141, 3600.0, set()),
    "block.msh": ("tet4", 105, 6000.0, set()),
}


@pytest.mark.parametrize("name", SMALL)
def test_small_meshes(small_meshes, name):
    kind, nodes, volume, sets = SMALL[name]
    mesh = read_mesh(small_meshes / name)
    assert [block.type for block in mesh.blocks] == [kind]
    assert len(mesh.nodes) == nodes and sets <= set(mesh.nodes.sets)
    assert "BODY" in mesh.element_sets
    mass = steel(mesh).M.sum() / 3
    assert mass == pytest.approx(volume * STEEL["density"], rel=2e-5)


def test_units_of_a_mesh_as_text(small_meshes):
    path = small_meshes / "plate.msh"
    assert np.array_equal(read_mesh(path, "mm-t-s").nodes.xyz, read_mesh(path, parse_units("mm-t-s")).nodes.xyz)
    with refusal("value", "units", "length-mass-time"):
        read_mesh(path, "mm")
    with refusal("value", "units", "0.001"):
        read_mesh(path, 1e-3)


def test_one_mesh_as_msh_and_as_deck_is_the_same_model(small_meshes):
    a, b = (steel(read_mesh(small_meshes / name)) for name in ("bracket.msh", "bracket.inp"))
    assert np.allclose(np.sort(a.nodes.xyz, axis=0), np.sort(b.nodes.xyz, axis=0), rtol=0, atol=1e-9)
    assert a.K.diagonal().sum() == pytest.approx(b.K.diagonal().sum(), rel=1e-12)
    for name in ("FOOT", "TIP"):
        points = [np.round(m.nodes.xyz[m.nodes.sets[name]], 6) for m in (a, b)]
        assert np.allclose(*(p[np.lexsort(p.T)] for p in points), atol=2e-6)


@pytest.mark.parametrize("kind", TYPES)
def test_every_type_comes_back_from_vtk_in_its_own_order(kind, tmp_path):
    """Written by meshio in VTK order and read: the same stiffness."""
    mesh = box(kind, (2, 1, 1), (0.3, 0.2, 0.1))
    name = next(theirs for theirs, ours in SOLIDS.items() if ours == kind)
    path = tmp_path / "mesh.vtu"
    part = [np.ones(len(mesh.blocks[0].ids), int)]
    meshio.Mesh(mesh.nodes.xyz, [(name, mesh.blocks[0].nodes)], cell_data={"part": part}).write(path)
    read = read_mesh(path)
    assert np.array_equal(read.blocks[0].nodes, mesh.blocks[0].nodes) and "part:1" in read.element_sets
    assert abs(steel(read).K - steel(mesh).K).max() == 0


def test_deck_keeps_labels_and_sets(tmp_path):
    path = tmp_path / "deck.inp"
    path.write_text(
        "** a comment\n*HEADING\n anything\n*NODE, NSET=EVERY\n"
        "10, 0,0,0\n20, 1,0,0\n30, 1,1,0\n40, 0,1,0\n50, 0,0,1\n60, 1,0,1\n70, 1,1,1\n80, 0,1,1\n99, 5,5,5\n"
        "*ELEMENT, TYPE=C3D8, ELSET=CUBE\n7, 10,20,30,40,\n50,60,70,80\n"
        "*NSET, NSET=BOTTOM, GENERATE\n10, 40, 10\n*NSET, NSET=BOTH\nBOTTOM, 50\n*ELSET,ELSET=ALIAS\nCUBE\n"
    )
    mesh = read_mesh(path, parse_units("mm-t-s"))
    assert mesh.nodes.ids.tolist() == [10, 20, 30, 40, 50, 60, 70, 80]  # 99 belongs to no element
    assert mesh.blocks[0].ids.tolist() == [7]
    assert mesh.nodes.ids[mesh.nodes.sets["BOTH"]].tolist() == [10, 20, 30, 40, 50]
    assert len(mesh.nodes.sets["EVERY"]) == 8
    assert mesh.element_sets["ALIAS"][0].tolist() == [0]
    assert mesh.nodes.xyz.max() == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("*NODE\n1,0,0,0\n*ELEMENT,TYPE=S4\n1,1,1,1,1\n", ("unsupported", "ELEMENT", "S4")),
        ("*NODE\n1,0,0,zero\n", ("value", "NODE")),
        ("hello", ("value", "", "*NODE")),
        ("*NODE\n1,0,0,0\n*ELEMENT,TYPE=C3D4\n1,1,2,3,4\n", ("unknown", "node")),
        ("*NODE\n1,0,0,0\n1,0,0,1\n*ELEMENT,TYPE=C3D4\n1,1,1,1,1\n", ("conflict", "node")),
        ("*NODE\n1,0,0,0\n*ELEMENT,TYPE=C3D4\n1,1,2,3\n", ("file", "ELEMENT", "5")),
        ("*NODE\n1,0,0,0\n*INSTANCE,NAME=A\n1,0,0\n", ("unsupported", "INSTANCE")),
    ],
)
def test_decks_that_cannot_be_used_are_refused(tmp_path, text, words):
    path = tmp_path / "deck.inp"
    path.write_text(text)
    with refusal(*words):
        read_mesh(path)


def test_unreadable_files_are_refused(tmp_path):
    path = tmp_path / "mesh.msh"
    path.write_text("not a mesh")
    with refusal("file", "mesh.msh"):
        read_mesh(path)
    with refusal("file", "none.msh"):
        read_mesh(tmp_path / "none.msh")
    flat = tmp_path / "flat.vtu"
    meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])]).write(flat)
    with refusal("missing", "", "flat.vtu"):
        read_mesh(flat)


def test_units_scale_to_si():
    units = parse_units("mm-t-s")
    assert units.stress == pytest.approx(1e6) and units.density == pytest.approx(1e12)
    assert parse_units({"length": "in", "mass": "slinch", "time": "s"}).stress == pytest.approx(6894.757, rel=1e-6)
    for bad in ("mm-t", {"length": "mm"}, {"length": "mm", "mass": "t", "time": "fortnight"}, {"lenght": "mm"}):
        with pytest.raises(InputError):
            parse_units(bad)
