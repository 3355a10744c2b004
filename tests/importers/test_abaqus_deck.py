"""Abaqus and CalculiX decks: labels, sets, instances, materials, couplings, masses; what is left out is told."""

import meshio
import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.fem.assembly import assemble
from morembs.fem.elements import TYPES
from morembs.fem.mass import mass_properties
from morembs.fem.material import isotropic, orthotropic
from morembs.importers.abaqus.importer import read_abaqus, read_abaqus_deck
from morembs.importers.tolerances import TOL
from morembs.problem import Problem
from tests.support.decks import damaged, filled, refusals
from tests.support.mesh_decks import ABAQUS_CODES, abaqus_mesh
from tests.support.meshes import STEEL, box, fully_integrated, steel
from tests.support.refusals import refusal

STEEL_LINES = "*MATERIAL, NAME=Steel\n*ELASTIC\n2.1E11, .3\n*DENSITY\n7850.\n"
CUBE = (
    "10, 0,0,0\n20, 1,0,0\n30, 1,1,0\n40, 0,1,0\n50, 0,0,1\n60, 1,0,1\n70, 1,1,1\n80, 0,1,1\n"
    "*ELEMENT, TYPE=C3D8, ELSET=Cube\n7, 10,20,30,40,\n50,60,70,80\n"
)
# One hexahedron with all that may hang on it.
FULL = (
    "*HEADING\n any text\n** a comment\n*NODE, NSET=Every\n" + CUBE + "*NODE, NSET=Ref\n 500, .5, .5, 2.\n"
    "*ELEMENT, TYPE=MASS, ELSET=Tip\n900, 500\n*MASS, ELSET=Tip\n2.5,\n"
    "*ELEMENT, TYPE=ROTARYI, ELSET=Spin\n901, 500\n*ROTARY INERTIA, ELSET=Spin\n1., 2., 3., .1, .2, .3\n"
    "*NSET, NSET=Bottom, GENERATE\n10, 40, 10\n*NSET, NSET=Both\nBOTTOM, 50\n*ELSET, ELSET=Alias\nCube\n"
    "*SURFACE, NAME=Top, TYPE=ELEMENT\nAlias, S2\n*SURFACE, NAME=Skin\nCube,\n"
    "*SURFACE, NAME=Points, TYPE=NODE\nBottom, 2.\n50, 1.\n"
    + STEEL_LINES
    + "*SOLID SECTION, ELSET=Cube,\n MATERIAL=Steel\n,\n"
    "*COUPLING, CONSTRAINT NAME=Flange, REF NODE=500, SURFACE=Top\n*KINEMATIC\n1, 3\n"
    "*NODE\n600, .5, .5, -1.\n*COUPLING, CONSTRAINT NAME=Mean, REF NODE=600, SURFACE=Points\n*DISTRIBUTING\n1, 6\n"
    "*BOUNDARY\nBottom, 1, 3\n*STEP\n*STATIC\n*CLOAD\n30, 1, 5.\n*END STEP\n"
)


@pytest.fixture
def deck(tmp_path):
    """Writes a deck and imports it."""

    def write(text, name="deck.inp"):
        path = tmp_path / name
        path.write_text(text)
        return read_abaqus_deck(path).convert()

    return write


@pytest.mark.parametrize("kind", TYPES)
def test_every_type_gives_the_stiffness_of_the_mesh_it_was_written_from(kind, deck):
    mesh = box(kind, (2, 1, 1), (0.3, 0.2, 0.1))
    imported = deck(abaqus_mesh(mesh) + STEEL_LINES + "*SOLID SECTION, ELSET=Body, MATERIAL=STEEL\n")
    assert np.array_equal(imported.mesh.blocks[0].nodes, mesh.blocks[0].nodes)
    model = assemble(fully_integrated(imported.mesh), imported.materials)
    assert abs(model.K - steel(mesh).K).max() == 0 and abs(model.M - steel(mesh).M).max() == 0


def test_inner_nodes_of_hex27_are_taken_from_where_they_are(deck):
    """Abaqus puts the centre before the faces, and lists these bottom, top, front, right, back, left."""
    mesh = box("hex27", (1, 1, 1), (1.0, 1.0, 1.0))
    imported = deck(abaqus_mesh(mesh, order=[*range(20), 26, 24, 25, 22, 21, 23, 20]))
    assert np.array_equal(imported.mesh.blocks[0].nodes, mesh.blocks[0].nodes)


@pytest.mark.parametrize("kind", ["tet4", "hex8", "wedge6"])
def test_what_all_lines_have_beyond_the_last_node_is_passed_over(kind, deck):
    """As in CalculiX; where a line has another number than others, nothing is."""
    mesh = box(kind, (2, 2, 1), (0.3, 0.2, 0.1))
    text = abaqus_mesh(mesh, per_line=30)
    head, lines = text.split("*ELEMENT")[0], text.split("*ELEMENT")[1].splitlines()
    more = "\n".join([lines[0], *(f"{line}, 1, 2," for line in lines[1:])])
    assert np.array_equal(deck(f"{head}*ELEMENT{more}\n").mesh.blocks[0].nodes, mesh.blocks[0].nodes)
    with refusal("value", "ELEMENT"):
        deck(f"{head}*ELEMENT{more[:-4]}\n")


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8", "hex20", "wedge6", "wedge15"])
def test_meshio_reads_the_same_deck_alike(kind, tmp_path, monkeypatch):
    # meshio reads these elements, and does not know that they are solids.
    monkeypatch.setitem(meshio._mesh.topological_dimension, "wedge15", 3)  # noqa: SLF001
    path = tmp_path / "deck.inp"
    path.write_text(abaqus_mesh(box(kind, (2, 2, 1), (0.3, 0.2, 0.1)), per_line=30))
    ours, theirs = read_abaqus(path), meshio.read(path)
    assert np.array_equal(ours.nodes.xyz, theirs.points)
    assert np.array_equal(ours.blocks[0].nodes, theirs.cells[0].data)


def test_all_that_hangs_on_a_body_keeps_its_labels(deck):
    imported = deck(FULL)
    mesh, nodes = imported.mesh, imported.nodes
    assert mesh.nodes.ids.tolist() == [10, 20, 30, 40, 50, 60, 70, 80] and mesh.blocks[0].ids.tolist() == [7]
    assert nodes.ids.tolist() == [*mesh.nodes.ids.tolist(), 500, 600]
    labels = {name: nodes.ids[rows].tolist() for name, rows in {**nodes.sets, **imported.surfaces}.items()}
    assert labels == {
        "Every": [10, 20, 30, 40, 50, 60, 70, 80],
        "Ref": [500],
        "Bottom": [10, 20, 30, 40],
        "Both": [10, 20, 30, 40, 50],
        "Top": [50, 60, 70, 80],
        "Skin": [10, 20, 30, 40, 50, 60, 70, 80],
        "Points": [10, 20, 30, 40, 50],
    }
    assert mesh.element_sets["Alias"][0].tolist() == [0] and "Tip" not in mesh.element_sets
    (rigid,), (average,), (mass, spin) = imported.rigid, imported.average, imported.masses
    assert rigid.name == "Flange" and nodes.ids[rigid.master] == 500 and rigid.components == (0, 1, 2)
    assert nodes.ids[rigid.slaves].tolist() == [50, 60, 70, 80]
    assert nodes.ids[average.reference] == 600 and average.weights.tolist() == [2, 2, 2, 2, 1]
    assert (mass.mass, nodes.ids[mass.node], spin.mass) == (2.5, 500, 0.0)
    assert spin.inertia.tolist() == [[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 3]]
    (material,) = imported.materials
    assert material.set == "Cube" and np.allclose(material.stiffness, isotropic(set="", **STEEL).stiffness)
    told = " ".join(imported.notes)
    assert "*BOUNDARY: supports are not applied" in told and "*CLOAD" in told and "C3D8" in mesh.warnings[0]
    assert assemble(mesh, imported.materials).M.sum() / 3 == pytest.approx(7850.0)


@pytest.mark.parametrize("within", [*range(3, len(FULL), len(FULL) // 8), FULL.index(" MATERIAL=Steel")])
def test_where_pieces_of_a_file_end_does_not_matter(within, deck):
    """Below comments so long that the first piece that is read ends within the text; also within a keyword's lines."""
    text = FULL + abaqus_mesh(box("tet10", (1, 1, 1), (1.0, 1.0, 1.0)), shift=1000)
    whole = deck(text)
    parts = deck(filled("**", TOL.piece_bytes - within) + text)
    assert np.array_equal(whole.nodes.xyz, parts.nodes.xyz) and whole.notes == parts.notes
    assert all(np.array_equal(a.nodes, b.nodes) for a, b in zip(whole.mesh.blocks, parts.mesh.blocks, strict=True))
    assert {k: v.tolist() for k, v in whole.nodes.sets.items()} == {k: v.tolist() for k, v in parts.nodes.sets.items()}


@pytest.mark.parametrize("kind", ["tet4", "hex20", "wedge6", "wedge15"])
def test_faces_of_a_surface_are_those_of_their_numbers(kind, deck):
    """Face k of Abaqus by its corners (manual, element library), middle nodes by where they are."""
    corners = {
        "t": ["1 2 3", "1 4 2", "2 4 3", "3 4 1"],
        "h": ["1 2 3 4", "5 8 7 6", "1 5 6 2", "2 6 7 3", "3 7 8 4", "4 8 5 1"],
        "w": ["1 2 3", "4 6 5", "1 4 5 2", "2 5 6 3", "3 6 4 1"],
    }[kind[0]]
    x = TYPES[kind].reference
    text = "*NODE\n" + "".join(f"{i + 1}, {p[0]}, {p[1]}, {p[2]}\n" for i, p in enumerate(x.tolist()))
    text += f"*ELEMENT, TYPE={ABAQUS_CODES[kind]}\n1, " + ",\n".join(str(i + 1) for i in range(len(x))) + "\n"
    for k in range(len(corners)):
        text += f"*SURFACE, NAME=F{k + 1}\n1, S{k + 1}\n"
    imported = deck(text)
    for k, listed in enumerate(corners):
        plane = x[[int(i) - 1 for i in listed.split()]]
        normal = np.cross(plane[1] - plane[0], plane[2] - plane[0])
        on_it = np.flatnonzero(np.abs((x - plane[0]) @ normal) < 1e-12)
        assert imported.surfaces[f"F{k + 1}"].tolist() == on_it.tolist()


def test_free_faces_leave_out_those_between_elements(deck):
    mesh = box("hex8", (3, 1, 1), (3.0, 1.0, 1.0))
    middle = int(np.argsort(mesh.nodes.xyz[mesh.blocks[0].nodes][:, :, 0].mean(axis=1))[1]) + 1
    imported = deck(abaqus_mesh(mesh) + f"*ELSET, ELSET=M\n{middle}\n*SURFACE, NAME=S\nM,\n*SURFACE, NAME=All\nBody,\n")
    # Weights tell faces from nodes: a distributing coupling gets the area of the four free faces.
    text = abaqus_mesh(mesh) + f"*ELSET, ELSET=M\n{middle}\n*SURFACE, NAME=S\nM,\n*NODE\n99,0,0,0\n"
    tied = deck(text + "*COUPLING, CONSTRAINT NAME=C, REF NODE=99, SURFACE=S\n*DISTRIBUTING\n")
    assert len(imported.surfaces["All"]) == 16 and len(imported.surfaces["S"]) == 8
    assert tied.average[0].weights.sum() == pytest.approx(4.0)


PARTS = (
    "*PART, NAME=Rod\n{mesh}*NSET, NSET=Left\n1\n*ORIENTATION, NAME=O\n1,0,0, 0,1,0\n"
    "*SOLID SECTION, ELSET=Body, MATERIAL=M, ORIENTATION=O\n*END PART\n"
    "*ASSEMBLY, NAME=A\n*INSTANCE, NAME=One, PART=ROD\n*END INSTANCE\n"
    "*INSTANCE, NAME=Two, PART=Rod\n1., 2., 3.\n1., 2., 3., 1., 2., 4., 30.\n*END INSTANCE\n"
    "*NODE\n1, 9, 9, 9\n*NSET, NSET=Both\nOne.Left, Two.LEFT\n*NSET, NSET=Own, INSTANCE=Two\nLeft\n"
    "*RIGID BODY, REF NODE=1, TIE NSET=Both\n*END ASSEMBLY\n"
    "*MATERIAL, NAME=M\n*DENSITY\n2700.\n*ELASTIC, TYPE=ENGINEERING CONSTANTS\n"
    "100E9, 20E9, 10E9, .3, .25, .2, 5E9, 4E9,\n3E9\n"
)


def test_instances_are_moved_with_their_material_directions(deck):
    mesh = box("hex8", (2, 1, 1), (0.3, 0.2, 0.1))
    imported = deck(PARTS.format(mesh=abaqus_mesh(mesh)))
    first, second = (imported.mesh.blocks[0].nodes[rows] for rows in ([0, 1], [2, 3]))
    x, y = (imported.nodes.xyz[e] for e in (first, second))
    # Shifted by (1, 2, 3), then turned by 30 degrees about the upright axis through (1, 2, 3).
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    assert np.allclose((y - [1, 2, 3])[..., 0], c * x[..., 0] - s * x[..., 1])
    assert np.allclose((y - [1, 2, 3])[..., 1:], np.stack([s * x[..., 0] + c * x[..., 1], x[..., 2]], axis=-1))
    constants = {"young": (100e9, 20e9, 10e9), "poisson": (0.3, 0.25, 0.2), "shear": (5e9, 4e9, 3e9), "density": 2700.0}
    turned = orthotropic(set="", **constants, axes=np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
    assert [m.set for m in imported.materials] == ["One.Body", "Two.Body"]
    assert np.allclose(imported.materials[0].stiffness, orthotropic(set="", **constants).stiffness)
    assert np.allclose(imported.materials[1].stiffness, turned.stiffness, atol=1.0)
    count = len(mesh.nodes)
    assert len(np.unique(imported.nodes.ids)) == 2 * count + 1 and any("raised" in note for note in imported.notes)
    sets = {name: imported.nodes.ids[rows].tolist() for name, rows in imported.nodes.sets.items()}
    assert sets["One.Left"] == [1] and sets["Two.Left"] == sets["Own"] and sets["Both"] == [1, *sets["Own"]]
    assert imported.nodes.ids[imported.rigid[0].slaves].tolist() == sets["Both"]
    model = assemble(imported.mesh, imported.materials)
    assert model.M.sum() / 3 == pytest.approx(2 * 0.006 * 2700)


def test_one_instance_keeps_names_and_labels(deck):
    text = "*PART, NAME=P\n*NODE\n" + CUBE + "*NSET, NSET=A\n10\n*NSET, NSET=B\n20\n*END PART\n*ASSEMBLY, NAME=X\n"
    text += "*INSTANCE, NAME=I, PART=P\n*END INSTANCE\n*NSET, NSET=A, INSTANCE=I\n70, 80\n*END ASSEMBLY\n"
    sets = {name: rows.tolist() for name, rows in deck(text).nodes.sets.items()}
    assert sets == {"A": [6, 7], "I.A": [0], "B": [1]}


@pytest.mark.parametrize(
    ("constants", "places"),
    [
        (
            "*ELASTIC, TYPE=ORTHOTROPIC\n11., 2., 12., 3., 4., 13., 7., 8.,\n9.\n",
            {(0, 1): 2, (1, 2): 4, (5, 5): 7, (3, 3): 9},
        ),
        (
            "*ELASTIC, TYPE=ANISO\n11., 2., 12., 3., 4., 13., .1, .2,\n.3, 7., .4, .5, .6, .7, 8., .8,\n"
            ".9, .15, .25, .35, 9.\n",
            {(0, 5): 0.1, (4, 4): 8, (5, 4): 0.7, (3, 0): 0.8, (3, 5): 0.25, (3, 4): 0.35},
        ),
    ],
)
def test_stiffness_given_by_its_entries(deck, constants, places):
    text = "*NODE\n" + CUBE + "*ORIENTATION, NAME=O\n1,0,0,0,1,0\n*MATERIAL, NAME=M\n*DENSITY\n1.\n" + constants
    C = deck(text + "*SOLID SECTION, ELSET=Cube, MATERIAL=M, ORIENTATION=O\n").materials[0].stiffness
    for (i, j), value in places.items():
        assert C[i, j] == pytest.approx(value) and C[j, i] == pytest.approx(value)


def test_turned_orientation_of_a_section(deck):
    """Axes turned by 30 degrees about the third: the material of axes given as rows."""
    text = "*NODE\n" + CUBE + "*ORIENTATION, NAME=O\n2,0,0, 1,1,0\n3, 30.\n*MATERIAL, NAME=M\n*DENSITY\n1.\n"
    text += "*ELASTIC, TYPE=ENGINEERING CONSTANTS\n100., 20., 10., .3, .25, .2, 5., 4.,\n3.\n"
    C = deck(text + "*SOLID SECTION, ELSET=Cube, MATERIAL=M, ORIENTATION=O\n").materials[0].stiffness
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    axes = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    constants = {"young": (100.0, 20.0, 10.0), "poisson": (0.3, 0.25, 0.2), "shear": (5.0, 4.0, 3.0)}
    assert np.allclose(C, orthotropic(set="", **constants, density=1.0, axes=axes).stiffness)


def test_included_files_may_hold_keywords_or_data(tmp_path, deck):
    (tmp_path / "nodes.txt").write_text(CUBE.split("*")[0])
    (tmp_path / "rest.inp").write_text("*ELEMENT" + CUBE.split("*ELEMENT")[1])
    imported = deck("*NODE\n*INCLUDE, INPUT=nodes.txt\n*INCLUDE, INPUT=rest.inp\n*NSET, NSET=A\n10\n")
    again = deck("*NODE, INPUT=nodes.txt\n*INCLUDE, INPUT=rest.inp\n")
    assert len(imported.nodes) == len(again.nodes) == 8 and imported.nodes.sets["A"].tolist() == [0]
    (tmp_path / "loop.inp").write_text("*INCLUDE, INPUT=deck.inp\n")
    with refusal("conflict", "INCLUDE"):
        deck("*INCLUDE, INPUT=loop.inp\n")
    with refusal("file", "INCLUDE"):
        deck("*INCLUDE, INPUT=none.inp\n")


def test_other_ways_to_tie(deck):
    text = "*NODE\n" + CUBE + "*NODE\n500, 0, 0, 2\n501, 3, 3, 3\n*NSET, NSET=T\n50, 60\n*ELSET, ELSET=E\nCube\n"
    text += "*MPC\nBEAM, T, 500\n*KINEMATIC COUPLING, REF NODE=501\nT, 1, 2\n70\n"
    ties = deck(text + "*RIGID BODY, ELSET=E, REF NODE=500\n").rigid
    assert [(len(tie.slaves), tie.components) for tie in ties] == [
        (2, (0, 1, 2, 3, 4, 5)),
        (2, (0, 1)),
        (1, (0, 1, 2, 3, 4, 5)),
        (8, (0, 1, 2, 3, 4, 5)),
    ]
    assert len({tie.name for tie in ties}) == 4


SOLID = "*NODE\n" + CUBE
MATERIAL = "*SOLID SECTION, ELSET=Cube, MATERIAL=M\n*MATERIAL, NAME=M\n*DENSITY\n1.\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SOLID + "*EQUATION\n2\n10,1,0.,20,1,-1.\n", ("value", "EQUATION", "10")),
        (SOLID + "*EQUATION\n3\n10,1,1.,20,1,-1.\n", ("unsupported", "EQUATION")),
        (SOLID + "*TIE, NAME=Glue\nA, B\n", ("unknown", "TIE", "deck.inp", "13", "A")),
        (
            SOLID + "*ELEMENT, TYPE=M3D4\n8, 10,20,30,40\n9, 10,20,30,40\n*ELEMENT,TYPE=T3D2\n11,10,20\n",
            ("unsupported", "ELEMENT", "M3D4", "T3D2"),
        ),
        (SOLID + "*FANCY THING\n1.\n", ("unsupported", "FANCY THING", "FANCY", "THING")),
        (SOLID + "*NSET, NSET=A\n10, 11\n", ("unknown", "node", "A", "11")),
        (SOLID + "*ELSET, ELSET=A\n8\n", ("unknown", "element", "A", "8")),
        (SOLID + "*NSET, NSET=A\nB\n*NSET, NSET=B\nA\n", ("conflict",)),
        (SOLID + "*NSET, NSET=A\nNowhere\n", ("unknown",)),
        (
            "*PREPRINT\n" + SOLID + MATERIAL + "*ELASTIC, TYPE=ORTHO\n1.,.1,1.,.1,.1,1.,1.,1.,\n1.\n",
            ("missing", "SOLID SECTION", "*ORIENTATION"),
        ),
        (SOLID + "*SOLID SECTION, ELSET=Cube, MATERIAL=M\n*MATERIAL, NAME=MM\n", ("unknown", "SOLID SECTION", "MM")),
        (SOLID + "*ELEMENT, TYPE=C3D4\n7, 10,20,30,50\n", ("conflict", "element", "7")),
        (SOLID + "*ELEMENT, TYPE=C3D4\n8, 10,20,30\n9, 10,20,30,50,60\n", ("value", "ELEMENT", "8", "4")),
        (SOLID + "*ELEMENT, TYPE=MASS, ELSET=E\n8, 10\n", ("missing", "MASS")),
        (SOLID + "*ASSEMBLY, NAME=A\n", ("file", "deck.inp", "*ASSEMBLY")),
        (SOLID + "*COUPLING, REF NODE=10, SURFACE=S, CONSTRAINT NAME=C\n*KINEMATIC\n", ("unknown", "COUPLING", "S")),
        (SOLID + "*SURFACE, NAME=S\nCube, S7\n", ("value", "SURFACE", "S1", "S6")),
        (SOLID + "*MPC\nPLANE, 10, 20\n", ("value", "MPC", "PLANE")),
        ("*NODE\n1, 0, 0, nan\n", ("value", "NODE")),
        ("*NODE\n1, 0, 0, 1E999\n", ("value", "NODE")),
        ("*NODE\n1, 0, 0, 0\n", ("missing",)),
        (SOLID + "*NODE, SYSTEM=S\n", ("value", "NODE", "SYSTEM")),
        (SOLID + "\0", ("file", "deck.inp")),
        (SOLID + "*NSET, NSET=A\n10, 20,", ("file", "NSET", "10", "20")),
        (SOLID + "*NSET, NSET=A\n10\n*DENSI", ("file", "DENSI", "*DENSI")),
        (SOLID + "*STEP\n*STATIC\n*END ST", ("file",)),
        (SOLID + "*NODE\n11, 0., 0., 0.\n12, 1., 0.", ("file", "", "12")),
        ("$ a deck\nSOL 103\nCEND\nBEGIN BULK\nGRID,1,,0.,0.,0.\n", ("value", "", "--format")),
    ],
)
def test_what_cannot_be_carried_is_refused_by_name(deck, text, words):
    with refusal(*words):
        deck(text)


def test_a_message_with_a_place_gives_it_to_its_problem(deck):
    """Also where it ends the reading."""
    assert refusals(lambda: deck(SOLID + "*NODE\n11, 1+3, 2., 3.\n")) == [("NODE", 13, ())]


def test_a_mesh_alone_does_not_lose_couplings_in_silence(tmp_path):
    path = tmp_path / "deck.inp"
    path.write_text(FULL)
    with refusal("unsupported", "COUPLING", "*COUPLING"):
        read_abaqus(path)


def test_forms_of_numbers_and_lines(deck):
    """Blank fields are 0, further fields are normals, lines may end with a comma, and in the way of Windows."""
    text = "*NODE\n1, , ,\n2, 1.D0\n3, 0., 1., , 0., 0., 1.\n 4 , 0 , 0 , +1.E0 ,\n"
    text += "*ELEMENT, TYPE=C3D4\n 1 , 1 , 2 , 3 ,\n 4 ,\n"
    imported = deck(text.replace("\n", "\r\n"))
    assert imported.nodes.xyz.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert deck("*NODE, SYSTEM=C\n" + SOLID.split("\n", 1)[1].replace("1,0,0\n", "1,90,0\n")).nodes.xyz[1].tolist() == (
        pytest.approx([0, 1, 0], abs=1e-15)
    )


@pytest.mark.parametrize("other", ["2,1,0,0", "2,1"])
def test_exponents_have_a_letter_whatever_the_other_lines(deck, other):
    with refusal("value", "NODE", "1+3"):
        deck(f"*NODE\n1,1+3,2,3\n{other}\n")
    with refusal("value", "ELEMENT", "1+3"):
        deck(SOLID + "*ELEMENT, TYPE=C3D8\n5,1+3,2,3,4,5,6,7,8\n")


def test_ranges_say_what_they_lack(deck):
    imported = deck(SOLID + "*NSET, NSET=A, GENERATE\n10, 100000000000, 10\n")
    assert len(imported.nodes.sets["A"]) == 8 and any("do not exist" in note for note in imported.notes)


def test_conrod_and_cube_with_the_materials_of_their_decks(shared_data):
    """Frequencies by Abaqus, and those told in the deck of an almost incompressible cube."""
    conrod = read_abaqus_deck(shared_data / "conrod_abaqus" / "job_matrix_generate_conrod.inp").convert()
    with Problem(assemble(conrod.mesh, conrod.materials)) as problem:
        mass, _, _ = mass_properties(problem.M, problem.coupling.R, problem.coupling.pole)
        assert mass == pytest.approx(0.1379211513593743, rel=1e-10)
        expected = [5931.72907, 10572.56166, 13006.48953, 14286.39617]
        assert problem.elastic_modes(count=4).frequencies_hz == pytest.approx(expected, rel=1e-7)
    cube = read_abaqus_deck(shared_data / "finetools" / "unit_cube_modes_h20.inp").convert()
    with Problem(assemble(cube.mesh, cube.materials)) as problem:
        assert problem.elastic_modes(count=1).frequencies_hz[0] == pytest.approx(0.26, abs=0.01)


def test_tet10_block_against_abaqus(shared_data):
    block = read_abaqus_deck(shared_data / "abaqus_block" / "blockC3D10.inp").convert()
    with Problem(assemble(block.mesh, block.materials)) as problem:
        assert problem.M.sum() / 3 == pytest.approx(11600, rel=1e-12)
        expected = [451.333341, 452.009851, 607.870197]
        assert problem.elastic_modes(count=3).frequencies_hz == pytest.approx(expected, rel=5e-7)


def test_surface_of_a_deck_by_abaqus(shared_data):
    imported = read_abaqus_deck(shared_data / "ansys_rotor" / "rotorDiscTest.inp").convert()
    low, high = imported.nodes.xyz.min(axis=0), imported.nodes.xyz.max(axis=0)
    assert len(imported.nodes) == 115 and np.isfinite([low, high]).all()
    on_skin = imported.nodes.xyz[imported.surfaces["Surface"]]
    assert np.allclose([on_skin.min(axis=0), on_skin.max(axis=0)], [low, high])


def test_damaged_decks_end_in_one_message(tmp_path):
    """Cut off, bytes changed, lines swapped or doubled: a deck is read or refused, never a crash."""
    path = tmp_path / "deck.inp"
    sources = [FULL, PARTS.format(mesh=abaqus_mesh(box("tet4", (1, 1, 1), (1, 1, 1))))]
    refused = 0
    for data in damaged(sources, 400, 5, b'0123456789,.*-=\n\r\t AzE"\xff\x00'):
        path.write_bytes(data)
        try:
            read_abaqus_deck(path).convert()
        except InputError:
            refused += 1
    assert refused > 100


def test_comments_behind_a_mark_are_read_over_at_the_top(deck):
    """As by ccx; other lines before the first keyword are no deck."""
    plain, marked = deck(SOLID), deck(">** Structure: a cube\n**\n> ** Test: none\n" + SOLID)
    assert np.array_equal(plain.mesh.nodes.xyz, marked.mesh.nodes.xyz) and not marked.warnings
    with refusal("value", "", "deck.inp", "*NODE"):
        deck(">** Structure\n1, 0., 0., 0.\n" + SOLID)


@pytest.mark.parametrize(
    ("form", "numbers"), [("{:5d},{:13.6e},{:13.6e},{:13.6e}", 1), ("{}, {:.8f}, {:.8f}, {:.8f}", 3)]
)
def test_a_last_number_that_is_shorter_than_those_above_is_cut_off(form, numbers, deck):
    """Of lines that are written in one format; without an end of line the last may be whole.

    The first ``numbers`` cuts leave a number, the others a number without the digits of its exponent.
    """
    nodes = SOLID + "*NODE\n" + "\n".join(form.format(n, n, n, n / 3) for n in range(901, 905))
    assert any("[last-line-open]" in text for text in deck(nodes).warnings)
    for cut in (1, 2, 3):
        last = nodes[:-cut].rsplit(",", 1)[-1].strip()
        with refusal(*(("file", "") if cut <= numbers else ("value", "NODE")), "deck.inp", last):
            deck(nodes[:-cut])


@pytest.mark.parametrize(
    ("last", "warned"),
    [
        ("*NSET, NSET=A\n10, 20", True),
        ("*NODE\n11, 1.5, 0., 0.\n12, 1., 1., 2.5\n13, 1., 1., 2.5\n14, 1., 1., 2", True),
        ("*NODE\n11, 0., 0., 0.\n12, 1., 0., 2.5", True),
        ("*END", False),
        ("** made by hand", False),
        ("*BOUNDARY", False),
        ("*STEP\n*STATIC\n1., 1.", False),
        ("*STEP\n*STATIC\n*END STEP", False),
    ],
)
def test_a_last_line_without_an_end_is_read_where_its_card_may_be_whole(last, warned, deck):
    """What is in a step is not applied, so it may be cut."""
    said = [text for text in deck(SOLID + last).warnings if text.endswith("[last-line-open]")]
    assert len(said) == warned and all(repr(last.rsplit("\n", 1)[-1]) in text for text in said)
