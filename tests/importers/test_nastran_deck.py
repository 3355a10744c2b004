"""Nastran bulk data: fields of all forms, coordinate systems, node order, materials, rigid elements and masses."""

import meshio
import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.fem import rigid_motion
from morembs.fem.assembly import assemble
from morembs.fem.elements import TYPES
from morembs.fem.material import isotropic, orthotropic
from morembs.fem.surface import nodal_areas, outer_faces
from morembs.importers.nastran.cards import real
from morembs.importers.nastran.importer import read_nastran
from morembs.importers.to_model import model_of
from morembs.importers.tolerances import TOL
from morembs.problem import Problem
from tests.support.decks import damaged, filled, refusals
from tests.support.mesh_decks import nastran_card, nastran_mesh
from tests.support.meshes import STEEL, box, fully_integrated, steel
from tests.support.refusals import refusal

KINDS = [kind for kind in TYPES if kind != "hex27"]
MAT1 = "PSOLID,1,1\nMAT1,1,2.1+11,,.3,7850.\n"
CUBE = (
    "GRID,10,,0.,0.,0.\nGRID,20,,1.,0.,0.\nGRID,30,,1.,1.,0.\nGRID,40,,0.,1.,0.\n"
    "GRID,50,,0.,0.,1.\nGRID,60,,1.,0.,1.\nGRID,70,,1.,1.,1.\nGRID,80,,0.,1.,1.\n"
    "CHEXA,7,1,10,20,30,40,50,60\n,70,80\n"
)
FULL = (
    "SOL 103\nCEND\nTITLE = A $ with a word\nSPC = 1\n"
    "SET 5 = 10, 20,\n  30 THRU 60\nSET 6 = 7\nSET 7 = ALL\nBEGIN BULK\n"
    "$ a comment\nPARAM,WTMASS,.5\nPARAM,POST,-1\n" + CUBE + "PSOLID  1       3\n"
    f"MAT1*   {'3':>16}{'2.1+11':>16}{'':16}{'.3':>16}\n*       {'7850.':>16}\n"
    "GRID    500             .5      .5      2.0\nGRID,600,,.5,.5,-1.\nGRID,700,,9.,9.,9.\n"
    "RBE2    1       500     123456  50      60      70      80\n"
    "RBE3,2,,600,123456,2.,123,10,THRU\n,30,1.,123,40\n"
    "RBAR,3,500,600,123456,,,\n"
    "CONM2   9       500             10.     0.1     0.2     0.3\n        1.      .1      2.      .2      .3      3.\n"
    "SPC1,1,123,10,20\nFORCE,4,30,,1.,1.,0.,0.\nSET1,8,10,THRU,40\nENDDATA\nthis is never read\n"
)


@pytest.fixture
def bulk(tmp_path):
    """Writes bulk data and imports them."""

    def write(text, name="model.bdf"):
        path = tmp_path / name
        path.write_text(text)
        return read_nastran(path).convert()

    return write


@pytest.mark.parametrize("form", ["small", "large", "free"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_type_in_every_form_gives_the_stiffness_of_its_mesh(kind, form, bulk):
    mesh = box(kind, (2, 1, 1), (0.5, 0.25, 0.125))
    imported = bulk("BEGIN BULK\n" + MAT1 + nastran_mesh(mesh, form) + "ENDDATA\n")
    assert np.allclose(imported.nodes.xyz, mesh.nodes.xyz, rtol=1e-9)
    assert np.array_equal(imported.mesh.blocks[0].nodes, mesh.blocks[0].nodes)
    assert imported.mesh.blocks[0].ids.tolist() == mesh.blocks[0].ids.tolist()
    assert "PSOLID_1" in imported.mesh.element_sets
    model = assemble(fully_integrated(imported.mesh), imported.materials)
    assert abs(model.K - steel(mesh).K).max() < 1e-9 * abs(model.K).max()
    assert model.M.sum() / 3 == pytest.approx(7850 * 0.5 * 0.25 * 0.125)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8", "hex20", "wedge6"])
def test_meshio_reads_the_same_elements(kind, tmp_path):
    path = tmp_path / "model.bdf"
    path.write_text("BEGIN BULK\n" + nastran_mesh(box(kind, (2, 1, 1), (0.5, 0.25, 0.125)), "small") + "ENDDATA\n")
    ours, theirs = read_nastran(path).mesh(), meshio.read(path)
    assert np.allclose(ours.nodes.xyz, theirs.points, rtol=0, atol=1e-12)
    assert np.array_equal(ours.blocks[0].nodes, theirs.cells[0].data)


def test_numbers_as_nastran_writes_them():
    known = {"1.0-3": 1e-3, "7.+5": 7e5, "-.5D2": -50, "+3.": 3, "2.1E+11": 2.1e11, "1.-10": 1e-10}
    for text, value in known.items():
        assert real(text, "") == value
    for text in ("1.0-", "E5", "1..2", "nan", "1_0", "1.+999", "--1."):
        with pytest.raises(InputError):
            real(text, "")


def test_everything_that_hangs_on_a_body(bulk):
    imported = bulk(FULL)
    nodes, mesh = imported.nodes, imported.mesh
    assert mesh.nodes.ids.tolist() == [10, 20, 30, 40, 50, 60, 70, 80] and mesh.blocks[0].ids.tolist() == [7]
    assert nodes.ids.tolist() == [*mesh.nodes.ids.tolist(), 500, 600]
    sets = {name: nodes.ids[rows].tolist() for name, rows in nodes.sets.items()}
    assert sets == {"SET1_8": [10, 20, 30, 40], "SET_5": [10, 20, 30, 40, 50, 60]}
    assert mesh.element_sets["SET_6"][0].tolist() == [0]
    rigid, bar = imported.rigid
    assert nodes.ids[rigid.master] == 500 and nodes.ids[rigid.slaves].tolist() == [50, 60, 70, 80]
    assert nodes.ids[bar.master] == 500 and nodes.ids[bar.slaves].tolist() == [600]
    (average,) = imported.average
    assert nodes.ids[average.nodes].tolist() == [10, 20, 30, 40] and average.weights.tolist() == [2, 2, 2, 1]
    # WTMASS halves masses and densities; the card lists products of inertia, the tensor their negatives.
    (mass,) = imported.masses
    assert mass.mass == 5.0 and mass.offset.tolist() == [0.1, 0.2, 0.3]
    assert np.allclose(2 * mass.inertia, [[1, -0.1, -0.2], [-0.1, 2, -0.3], [-0.2, -0.3, 3]])
    (material,) = imported.materials
    assert material.density == 3925 and np.allclose(material.stiffness, isotropic(set="", **STEEL).stiffness)
    told = " ".join(imported.notes)
    for words in ("SPC1: not applied", "FORCE", "POST", "WTMASS", "SET 7", "1 grids belong", "case control"):
        assert words in told


@pytest.mark.parametrize("part", range(9))
def test_where_pieces_of_a_file_end_does_not_matter(part, bulk):
    """Comments so long that a piece ends within what stands above the bulk data, and one within these."""
    whole = bulk(FULL)
    head, begin, data = FULL.partition("BEGIN BULK\n")
    above = filled("$", TOL.piece_bytes - part * len(head + begin) // 8)
    parts = bulk(above + head + begin + filled("$", TOL.piece_bytes - 3 - part * len(data) // 9) + data)
    assert np.array_equal(whole.nodes.xyz, parts.nodes.xyz) and sorted(whole.notes) == sorted(parts.notes)
    assert np.array_equal(whole.mesh.blocks[0].nodes, parts.mesh.blocks[0].nodes)
    assert [tie.name for tie in whole.rigid] == [tie.name for tie in parts.rigid]


def test_scale_of_mass_above_the_bulk_data(bulk):
    imported = bulk("SOL 103\nCEND\nParam, WTMASS, 2.-3\nBEGIN BULK\n" + CUBE + MAT1 + "ENDDATA")
    assert imported.materials[0].density == pytest.approx(15.7)


SYSTEMS = (
    "CORD2R,1,,1.,2.,3.,1.,2.,4.\n,1.,3.,3.\n"  # x along y, y along -x
    "CORD2C,2,1,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    "CORD2S,3,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    "CORD1R,4,901,902,903\nGRID,901,1,0.,0.,0.\nGRID,902,1,0.,0.,5.\nGRID,903,1,0.,7.,0.\n"
    "GRID,911,1,1.,2.,3.\nGRID,912,2,2.,90.,1.\nGRID,913,3,2.,30.,90.\nGRID,914,4,1.,2.,3.\n"
)


def test_grids_in_other_systems(bulk):
    used = "CTETRA,9,1,911,912,913,914\n"
    nodes = bulk(CUBE + SYSTEMS + used).nodes
    xyz = dict(zip(nodes.ids.tolist(), nodes.xyz.tolist(), strict=True))
    assert xyz[911] == pytest.approx([1 - 2, 2 + 1, 3 + 3])
    assert xyz[912] == pytest.approx([1 - 2, 2, 3 + 1])  # 2 along y of system 1
    assert xyz[913] == pytest.approx([0, 2 * np.sin(np.pi / 6), 2 * np.cos(np.pi / 6)], abs=1e-12)
    # System 4 stands in the origin of 1, its x along y of 1, which is -x.
    assert xyz[914] == pytest.approx([1 - 1, 2 - 2, 3 + 3])


def test_grdset_gives_what_grids_leave_blank(bulk):
    text = CUBE.replace("GRID,10,,", "GRID,10,0,") + "GRDSET,,1,,,,,456\nCORD2R,1,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    text = text.replace("CORD2R,1,,0.,0.,0.,0.,0.,1.", "CORD2R,1,,0.,0.,5.,0.,0.,6.").replace("1.,0.,0.\nX", "")
    imported = bulk(text)
    assert imported.nodes.xyz[:2, 2].tolist() == [0.0, 5.0] and any("PS" in note for note in imported.notes)


def test_mat9_of_engineering_constants(bulk):
    """Shear comes as xy, yz, zx on the card; material directions turned by 90 degrees about z."""
    constants = {"young": (100.0, 20.0, 10.0), "poisson": (0.3, 0.25, 0.2), "shear": (5.0, 4.0, 3.0), "density": 2.0}
    C = orthotropic(set="", **constants).stiffness[np.ix_([0, 1, 2, 5, 3, 4], [0, 1, 2, 5, 3, 4])]
    entries = [f"{value:.8E}" if value else "" for value in C[np.triu_indices(6)]]
    mat = nastran_card("MAT9", ["1", *entries, "2."], "large")
    plain = bulk(CUBE + "PSOLID,1,1\n" + mat).materials[0]
    assert np.allclose(plain.stiffness, orthotropic(set="", **constants).stiffness, rtol=1e-7, atol=1e-6)
    system = "CORD2R,4,,0.,0.,0.,0.,0.,1.\n,0.,1.,0.\n"
    turned = bulk(CUBE + system + "PSOLID,1,1,4\n" + mat).materials[0]
    axes = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    assert np.allclose(turned.stiffness, orthotropic(set="", **constants, axes=axes).stiffness, rtol=1e-7, atol=1e-6)


def test_masses_in_other_axes(bulk):
    turned = "CORD2R,4,,0.,0.,0.,0.,0.,1.\n,0.,1.,0.\n"
    imported = bulk(CUBE + turned + "CONM2,1,70,4,3.,1.,2.,3.,\n,5.,,6.,,,7.\nCONM2,2,70,-1,3.,1.5,1.,1.\n")
    assert imported.masses[0].offset == pytest.approx([-2, 1, 3])
    assert np.allclose(imported.masses[0].inertia, np.diag([6.0, 5.0, 7.0]))
    assert imported.masses[1].offset == pytest.approx([0.5, 0, 0])


def test_included_files_are_bulk_data(tmp_path, bulk):
    (tmp_path / "cube.bdf").write_text(CUBE)
    imported = bulk("BEGIN BULK\nINCLUDE 'cube.bdf'\n" + MAT1 + "ENDDATA\n")
    assert len(imported.nodes) == 8 and imported.materials[0].set == "PSOLID_1"
    (tmp_path / "loop.bdf").write_text("INCLUDE 'model.bdf'\n")
    for text, words in (("INCLUDE 'loop.bdf'\n", ("conflict", "INCLUDE")), ("INCLUDE none.bdf\n", ("file", "INCLUDE"))):
        with refusal(*words):
            bulk(CUBE + text)


def test_text_behind_the_fields_of_a_card_is_named(tmp_path, bulk):
    grid = "GRID         900              5.      5."

    def unread(imported):
        return [text for text in imported.mesh.warnings if "beyond column" in text]

    quiet = (
        "$" + 90 * "c" + "\n" + grid.replace("900", "901") + "      5." + 50 * " " + "\n"
        f"GRID*   {902:>16}{'':16}{'5.':>16}{'5.':>16}*MARK12         $ a comment\n*MARK12 {'5.':>16}\n"
        "RBAR,3,10,20,123456,,," + 70 * " " + "123456\n"
    )
    assert not unread(bulk("SOL 103\nBEGIN BULK\n" + CUBE + quiet + MAT1 + "ENDDATA\n"))
    (tmp_path / "more.bdf").write_text(grid + f"{'5.':>50}\n" + 81 * " " + "3.0\n")
    # The third coordinate stands behind column 80, then a whole line does; CR LF ends lines.
    text = "SOL 103\nBEGIN BULK\n" + CUBE + quiet + f"INCLUDE 'more.bdf'\n{MAT1}{grid.replace('900', '903')}"
    text += f"{7000.125:>50}{30 * ' x'}\nENDDATA\n"
    warnings = unread(bulk(text.replace("\n", "\r\n")))
    assert len(warnings) == 2 and all(words in warnings[0] for words in ("more.bdf, line 1", "'5.'", "1 further line"))
    assert all(words in warnings[1] for words in ("model.bdf, line 21", "7000.125", "...' beyond column 80"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "CQUAD4,1,1,10,20,30,40\nCQUAD4,2,1,10,20,30,40\nCBAR,3,1,10,20\n",
            ("unsupported", "CQUAD4", "11", "13", "CBAR"),
        ),
        ("CELAS2,3,5.,10,0\n", ("unsupported", "CELAS2", "10")),
        ("CELAS1,3,7,10,1\n", ("unknown", "CELAS1", "PELAS", "7")),
        ("RBE1,1,10,123456\n", ("model", "RBE1", "6")),
        ("RBE1,1,10,123,20,12,30,1\n,UM,40,123\n", ("model", "RBE1")),
        ("RBE1,1,10\n,UM,40,123\n", ("value", "RBE1")),
        ("RROD,1,10,20\n", ("value", "RROD")),
        ("RROD,1,10,20,2\n", ("unsupported", "RROD")),
        ("BEGIN,1\n", ("unsupported", "BEGIN")),
        ("PLSOLID,1,2\n", ("unsupported", "PLSOLID")),
        ("SOL 103\nCEND\nSPC = 1\n", ("file", "BEGIN BULK", "CEND", "BEGIN", "BULK")),
        ("DMIG,K2GG,0,6,1,0\n", ("unsupported", "DMIG")),
        ("RBE2,1,11,123,10\n", ("unknown", "RBE2", "11")),
        ("RBE2,1,10,129,20\n", ("value", "RBE2", "129")),
        ("RBE3,1,,10,123,1.,12,20\n", ("unsupported", "RBE3")),
        ("RBE3,1,,10,123456,1.,123,20\n,UM,20,123\n", ("value", "RBE3")),
        ("RBAR,1,10,20,123,12\n", ("model", "RBAR", "5")),
        ("GRID,10,,0.,0.,.1\n", ("conflict", "grid", "10")),
        ("GRID,11,5,0.,0.,0.\n", ("unknown", "", "5")),
        ("CTETRA,7,1,10,20,30,50\n", ("conflict", "element", "7")),
        ("CTETRA,8,1,10,20,30,55\n", ("unknown", "grid", "55")),
        ("CTETRA,8,1,10,20,30\n", ("value", "", "CTETRA", "8")),
        ("CTETRA,8,1,10,20,,50,60,70\n", ("value", "", "CTETRA", "8", "5")),
        (
            "CORD2R,1,2,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nCORD2R,2,1,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\nGRID,11,1,0.,0.,0.\n",
            ("conflict",),
        ),
        ("CORD2R,1,,0.,0.,0.,0.,0.,1.\n,0.,0.,2.\nGRID,11,1,0.,0.,0.\n", ("model",)),
        ("PSOLID,1,1\nMAT1,1,,1.,,1.\n", ("value",)),
        ("GRID,11,,0.,zero,0.\n", ("value", "", "11", "GRID", "zero", "5")),
        ("GRID    11              0.5 1   0.      0.\n", ("value", "", "11", "GRID", "0.5", "4")),
        ("GRID,11,,0.,0.00+,0.\n", ("value", "", "11", "GRID", "0.00+", "5")),
        ("GRID    11              +       0.      0.\n", ("value", "", "11", "GRID", "+", "4")),
        ("=,*(1),=\n", ("unsupported", "", "11")),
        ("GRID,90,,1.,2.,3.\n=(3)\n", ("file",)),
        ("CORD2R,x\n=,*1,==\n", ("file",)),
        ("PARAM,WTMASS,0.\n", ("value", "", "WTMASS")),
        ("\0", ("file", "model.bdf")),
        ("GRID,11,,0.,0.,1.\nGRID,12,,0.,1.", ("file", "", "GRID,12,,0.,1")),
        ("GRID    11              0.0     0.0     1.0\nGRID    12              0.0     1.", ("file",)),
        ("RBE2,9,10,123,20,", ("file",)),
        ("ENDDA", ("file",)),
        ("RBE2    1       10      123     20      30      40      50      60      +A\n+B      70\n", ("unsupported",)),
        (
            "GRID    12      1       0.      0.      0.      4\nCORD2R,1,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n",
            ("unknown", "", "4"),
        ),
    ],
)
def test_what_cannot_be_carried_is_refused_by_name(bulk, text, words):
    with refusal(*words):
        bulk(CUBE + text)


# Of a reference at (.4, .6, -.5) by grids of the unit cube: 10 and 20 with the weight 2 in x, y, z, 30 with .5 in y and
# z, 50 with 1.5 in x and z; made with pyYeti 1.4.7 (formrbe3).
MEAN = np.array(
    [
        [
            0.541958041958,
            0.6,
            -0.237762237762,
            0.541958041958,
            -0.48,
            0.416083916084,
            -0.12,
            0.0,
            -0.083916083916,
            -0.178321678322,
        ],
        [
            -0.073426573427,
            0.6,
            -0.083916083916,
            -0.073426573427,
            0.32,
            -0.353146853147,
            0.08,
            0.5,
            0.146853146853,
            -0.062937062937,
        ],
        [
            -0.07972027972,
            0.0,
            0.251748251748,
            -0.07972027972,
            0.0,
            -0.040559440559,
            0.0,
            0.6,
            0.159440559441,
            0.188811188811,
        ],
        [
            -0.146853146853,
            0.0,
            -0.167832167832,
            -0.146853146853,
            0.0,
            -0.706293706294,
            0.0,
            1.0,
            0.293706293706,
            -0.125874125874,
        ],
        [
            -0.230769230769,
            0.0,
            0.307692307692,
            -0.230769230769,
            0.0,
            -0.538461538462,
            0.0,
            0.0,
            0.461538461538,
            0.230769230769,
        ],
        [0.0, -1.0, 0.0, 0.0, 0.8, 0.0, 0.2, 0.0, 0.0, 0.0],
    ]
)
WEIGHTED = CUBE + MAT1 + "GRID,600,,.4,.6,-.5\nRBE3,2,,600,123456,2.,123,10,20\n,.5,23,30,1.5,13,50\n"
TIED = (
    CUBE + MAT1 + "GRID,600,,.4,.6,-.5\nGRID,601,,.5,.6,-.5\n=,*1,,*.1,==\n=2\nCORD2C,4,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    "RBE1,1,600,123456\n,UM,10,123,20,12\nRTRPLT,2,30,40,50,123,23,3\nRBE2,3,601,123,602,THRU,604\n"
    "RBAR,4,600,601,123456\nCBUSH,5,5,70,80,,,,0\nPBUSH,5,K,10.\n"
)
LEADERS = [(10, 0), (10, 1), (10, 2), (20, 0), (20, 1), (20, 2), (30, 1), (30, 2), (50, 0), (50, 2)]


def dof_of(model, label, component):
    node = np.flatnonzero(model.nodes.ids == label)[0]
    return int(np.flatnonzero((model.dofs.node == node) & (model.dofs.component == component))[0])


def rigid_fault(model):
    """The largest part of rigid motion that the dependent dofs do not follow, and that strains the body."""
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    S = model.dependent.S
    K = S.T @ model.K @ S
    return abs(S @ R - R).max(), abs(K @ R).max() / abs(model.K).max()


@pytest.mark.parametrize("behind", ["", ",UM,600,123,10,1,20,23\n"])
def test_a_mean_of_some_directions_is_that_of_nastran(bulk, behind):
    """UM only chooses what depends: the reference moves as the same mean of the grids."""
    model = model_of(bulk(WEIGHTED + behind))
    S = model.dependent.S.toarray()
    u = S @ np.random.default_rng(3).normal(size=len(S))
    reference = [u[dof_of(model, 600, c)] for c in range(6)]
    assert np.allclose(reference, MEAN @ [u[dof_of(model, *leader)] for leader in LEADERS], atol=1e-9)
    assert max(rigid_fault(model)) < 1e-12


def test_rotations_of_a_mean_count_with_the_squared_distance(bulk):
    """Grid 90 is of no solid, so that its rotations take part; rows made with pyYeti 1.4.7 (formrbe3)."""
    grids = "GRID,600,,.4,.6,-.5\nGRID,90,,2.,1.,1.\nCELAS2,5,1.,90,1,30,1\n"
    model = model_of(bulk(CUBE + MAT1 + grids + "RBE3,2,,600,123456,1.,123,10,20\n,.4,123456,90\n"))
    along_x = [
        0.431282332303,
        0.179060208902,
        -0.244830704265,
        0.431282332303,
        -0.112523302295,
        0.13444680075,
        0.137435335394,
        -0.066536906607,
        0.110383903515,
        -0.176920810122,
        -0.282220727614,
        -0.216967549096,
    ]
    about_y = [
        -0.062638567012,
        -0.051740912026,
        0.333614463581,
        -0.062638567012,
        0.065280212489,
        -0.159238063007,
        0.125277134024,
        -0.013539300463,
        -0.174376400574,
        0.160837100111,
        0.366732001821,
        0.087075522461,
    ]
    leaders = [(10, 0), (10, 1), (10, 2), (20, 0), (20, 1), (20, 2), *((90, c) for c in range(6))]
    dofs = [dof_of(model, *leader) for leader in leaders]
    S = model.dependent.S.toarray()
    assert np.allclose(S[dof_of(model, 600, 0), dofs], along_x, atol=1e-11)
    assert np.allclose(S[dof_of(model, 600, 4), dofs], about_y, atol=1e-11)


@pytest.mark.parametrize(
    "element",
    [
        "RBAR,1,10,600,123,456\n",
        "RBAR,1,600,10,12346,5,,\n",
        "RBE1,1,600,123456\n,UM,10,123,20,12\n",
        "RTRPLT,1,10,20,40,123,23,3,\n,,1,12\n",
        "RBE1,1,10,123,20,23,40,3\n,UM,20,1,40,12\n",
        "RBE2,1,600,13,10,20\n",
        "RROD,1,10,20,1\n",
    ],
)
def test_rigid_elements_of_any_components_move_as_one_body(bulk, element):
    """Grid 20 has axes of its own, along those of a cylinder whose axis is turned."""
    system = "CORD2C,4,,.1,.2,.3,.4,.5,1.\n,1.,.1,.2\n"
    cube = CUBE.replace("GRID,20,,1.,0.,0.", "GRID,20,,1.,0.,0.,4")
    model = model_of(bulk(cube + MAT1 + system + "GRID,600,,.4,.6,-.5\n" + element))
    assert max(rigid_fault(model)) < 1e-12
    S, x = model.dependent.S, model.nodes.xyz
    assert (model.dependent.owner >= 0).sum() > 0
    u = S @ np.random.default_rng(5).normal(size=S.shape[1])
    if element.startswith("RROD"):
        return
    if "RBE2" in element or "UM,10,123,20" in element:  # some directions only
        return
    labels = {int(word) for word in element.replace("\n", ",").split(",")[2:] if word.isdigit()} & {10, 20, 40, 600}
    fixed = [dof_of(model, label, c) for label in sorted(labels) for c in range(3)]
    R = rigid_motion(x[model.dofs.node[fixed]], model.dofs.component[fixed])
    assert np.linalg.norm(u[fixed] - R @ np.linalg.lstsq(R, u[fixed])[0]) < 1e-12 * np.linalg.norm(u[fixed])


def test_one_body_by_three_kinds_of_elements(bulk):
    """RBE2 along all directions, RBE1 and RBAR with the same leader give the same matrices."""
    grid = "GRID,600,,.4,.6,-.5\n"
    kinds = [
        "RBE2,1,600,123456,10,20\n",
        "RBE1,1,600,123456\n,UM,10,123456,20,123456\n",
        "RBAR,1,600,10,123456\nRBAR,2,600,20,123456\n",
    ]
    matrices = []
    for text in kinds:
        model = model_of(bulk(CUBE + MAT1 + grid + text))
        S = model.dependent.S
        kept = [dof_of(model, label, c) for label in (30, 40, 50, 600) for c in range(3)]
        matrices.append((S.T @ model.K @ S).toarray()[np.ix_(kept, kept)])
    assert all(np.allclose(matrices[0], A, rtol=0, atol=1e-12 * matrices[0].max()) for A in matrices[1:])


def test_replicated_cards(bulk):
    """The cube by counting up, in free and in fixed fields."""
    cube = (
        "GRID,10,,0.,0.,0.\nGRID,20,,1.,0.,0.\n=,*(20),=,==\n=,*-10,=,*-1.,*1.,==\nGRID,30,,1.,1.,0.\n"
        "GRID    50                      0.       1.0-1\n=       *10     ==\n=(2)\n"
    )
    imported = bulk(
        cube.replace("GRID,20,,1.,0.,0.\n=,*(20),=,==\n=,*-10,=,*-1.,*1.,==\n", "GRID,20,,1.,0.,0.\n")
        + ("GRID,1,,0.,0.,0.\n=,*1,,*.1,==\n=3\nCTETRA,1,1,10,20,30,50\n" + MAT1)
    )
    assert imported.nodes.ids.tolist() == [10, 20, 30, 50]
    chain = bulk(
        "GRID,1,,0.,0.,0.\n=,*1,,*.1,=,*-1.-1\n=3\nGRID,9,,0.,1.,0.\nGRID,10,,0.,0.,1.\n"
        "CTETRA,1,1,1,5,9,10\nRBE2,1,1,123,2,THRU,4\n" + MAT1
    )
    rows = [np.flatnonzero(chain.nodes.ids == label)[0] for label in range(1, 6)]
    assert np.array_equal(chain.nodes.xyz[rows], [[k / 10, 0, -k / 10] for k in range(5)])
    # A card with a name and number of its own copies the further fields.
    copied = bulk(CUBE.replace("CHEXA,7,1", "CHEXA,7,2") + "PSOLID,1,1\nPSOLID,2,==\nMAT1,1,2.1+11,,.3,7850.\n")
    assert [material.set for material in copied.materials] == ["PSOLID_2"] and not copied.incomplete


def test_fields_of_named_cards_are_copied_in_columns_too(bulk):
    """From the card above, one or all further ones; not below fields of 16 columns."""
    above = "GRID    901             1.25    .5      .25\n"
    for below in ("GRID    902             2.25    ==\n", "GRID    902             2.25    =       .25\n"):
        nodes = bulk(CUBE + above + below + "CONM2,9,902,,1.\nRBE2,8,10,123,902\n" + MAT1).nodes
        assert nodes.xyz[nodes.ids == 902].tolist() == [[2.25, 0.5, 0.25]]
    wide = "GRID*                901                            1.25              .5\n"
    with refusal("unsupported", "", "16"):
        bulk(CUBE + wide + "GRID,902,,2.25,==\n")


def test_edges_without_middle_nodes_are_linear(bulk):
    """A tet10 with none of its middle nodes on three edges strains as a patch, and one with all gaps is a tet4."""
    corners = "GRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,0.,1.,0.\nGRID,4,,0.,0.,1.\n"
    tet10 = "GRID,5,,.5,0.,0.\nGRID,6,,.5,.5,0.\nGRID,7,,0.,.5,0.\nCTETRA,8,1,1,2,3,4,5,6\n,7\n"
    imported = bulk(corners + tet10 + MAT1)
    assert imported.nodes.ids.tolist() == [*range(1, 11)] and any("3 edges" in note for note in imported.notes)
    model = model_of(imported)
    assert max(rigid_fault(model)) < 1e-12
    S = model.dependent.S
    assert abs(S.T @ model.M @ S).sum() > 0 and (model.dependent.owner >= 0).sum() == 9
    # The edge 1-5-2 is quadratic: its reduced element is stiffer than tet10 and softer than tet4.
    low = model_of(bulk(corners + "CTETRA,8,1,1,2,3,4\n" + MAT1))
    rows = [dof_of(model, label, c) for label in range(1, 5) for c in range(3)]
    K = (S.T @ model.K @ S).toarray()
    inner = [dof_of(model, label, c) for label in (5, 6, 7) for c in range(3)]
    coupling = K[np.ix_(inner, rows)]
    condensed = K[np.ix_(rows, rows)] - coupling.T @ np.linalg.solve(K[np.ix_(inner, inner)], coupling)
    softer = np.linalg.eigvalsh(low.K.toarray() - condensed)
    assert softer[0] > -1e-12 * softer[-1] and softer[-1] > 1e-3 * condensed.max()


def test_a_quadratic_element_next_to_a_linear_one(bulk):
    """Without middle nodes on their common face they fit: a linear field moves the inner nodes of both without forces,
    and the skin is that of the box. With middle nodes there, and beside two wedges, a warning tells."""
    text, label = "", {}
    for i in range(5):
        for j in range(3):
            for k in range(3):
                if (i in (0, 2, 4) and (j != 1 and k != 1)) or (i < 3 and [i % 2, j % 2, k % 2].count(1) == 1):
                    label[i, j, k] = len(label) + 1
                    text += f"GRID,{label[i, j, k]},,{i / 2},{j / 2},{k / 2}\n"
    corners = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
    edges = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 5), (2, 6), (3, 7), (4, 5), (5, 6), (6, 7), (7, 4)]
    middles = [tuple((np.array(corners[a]) + corners[b]) // 2) for a, b in edges]

    def deck(dropped):
        first = [label[c] for c in corners] + ["" if m[0] == 2 and dropped else label[m] for m in middles]
        second = [label[i + 2, j, k] for i, j, k in corners]
        return (
            text
            + nastran_card("CHEXA", ["1", "1", *map(str, first)], "free")
            + nastran_card("CHEXA", ["2", "1", *map(str, second)], "free")
            + MAT1
            + "PARAM,COUPMASS,1\n"
        )

    model = model_of(bulk(deck(True)))
    assert not any("faces-differ" in each for each in model.warnings)
    S, x = model.dependent.S, model.nodes.xyz[model.dofs.node]
    field = (x @ np.random.default_rng(1).normal(size=(3, 3)))[np.arange(len(x)), model.dofs.component]
    assert abs(S @ field - field).max() < 1e-12
    assert sum(nodal_areas(model.nodes.xyz, outer_faces(model.mesh))) == pytest.approx(10.0)
    open_face = bulk(deck(False))
    assert any("faces-differ" in each for each in model_of(open_face).warnings)
    with refusal("model", "mesh"):
        assemble(open_face.mesh, open_face.materials)
    wedges = "GRID,81,,0.,0.,2.\nGRID,82,,1.,0.,2.\nGRID,83,,1.,1.,2.\nCPENTA,8,1,50,60,70,81,82,83\n"
    assert any("at 1 faces" in each for each in model_of(bulk(CUBE + wedges + MAT1)).warnings)


def test_materials_and_text_as_strangers_have_them(bulk):
    """MAT11 along a system, names behind blanks, grids that are there twice, labels of superelements."""
    orthotropic_card = "MAT11,1,2.+11,1.+11,.5+11,.3,.2,.1,4.+10\n,3.+10,2.+10,7850.\n"
    text = CUBE.replace("GRID,20,,1.,0.,0.", " GRID,20,,1.,0.,0.,,,2") + "GRID,10,,0.,0.,0.\nPSOLID,1,1\n"
    imported = bulk(text + orthotropic_card)
    given = orthotropic(
        set="PSOLID_1", young=(2e11, 1e11, 0.5e11), poisson=(0.3, 0.2, 0.1), shear=(4e10, 3e10, 2e10), density=7850.0
    )
    assert np.allclose(imported.materials[0].stiffness, given.stiffness, rtol=1e-14)
    # A mark of a continuation without its plus sign is no name.
    first = "".join(word.ljust(8) for word in ("CHEXA", "7", "1", "10", "20", "30", "40", "50", "60"))
    marked = f"{CUBE[: CUBE.index('CHEXA')]}{first} ABC\n ABC    70      80\n"
    assert len(bulk(marked + MAT1).mesh.blocks[0].nodes[0]) == 8
    # Of E, G and NU solids take E and NU, E alone means NU = 0.
    for card, nu, words in (("1.,3.,.3", 0.3, "does not fit"), ("1.,,", 0.0, "gives E only")):
        odd = bulk(CUBE + f"PSOLID,1,1\nMAT1,1,{card},1.\n")
        expected = isotropic(set="PSOLID_1", young=1.0, poisson=nu, density=1.0).stiffness
        assert np.array_equal(odd.materials[0].stiffness, expected) and any(words in each for each in odd.warnings)
    assert all(any(words in note for note in imported.notes) for words in ("given twice", "superelements"))
    assert len(imported.nodes) == 8


@pytest.mark.parametrize("line", ["SET1,8,10,THRU\n,40\n", "SET1,8,40,THRU,10\n"])
def test_a_range_without_its_end_is_refused(bulk, line):
    """Its end in the next line's first field, with blanks between; an end below its beginning."""
    with refusal("value", "", "SET1", "8", "THRU"):
        bulk(CUBE + MAT1 + line)


def test_thermal_expansion_of_a_rigid_element_is_no_grid(bulk):
    imported = bulk(CUBE + "RBE2,1,10,123456,20,30,1.2-5\n")
    assert len(imported.rigid[0].slaves) == 2 and any("thermal expansion 1.2-5" in note for note in imported.notes)


def test_two_blocks_by_comsol(shared_data):
    """119 nodes, 358 tetrahedra of two properties fill a box with a volume of its own; no material is named."""
    path = shared_data / "finetools" / "twoblocks.nas"
    imported, theirs = read_nastran(path).convert(), meshio.read(path)
    assert len(imported.nodes) == 119 and np.array_equal(imported.mesh.blocks[0].nodes, theirs.cells[0].data)
    assert not imported.materials
    assert sum("names no material" in why.sentence for why in imported.incomplete.values()) == 2
    parts = [isotropic(set=f"PSOLID_{k}", young=1e9, poisson=0.3, density=float(k)) for k in (1, 2)]
    model = assemble(imported.mesh, parts)
    x = imported.nodes.xyz[imported.mesh.blocks[0].nodes]
    volume = np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    rows = [imported.mesh.element_sets[f"PSOLID_{k}"][0] for k in (1, 2)]
    assert (volume > 0).all() and len(rows[0]) + len(rows[1]) == 358
    assert model.M.sum() / 3 == pytest.approx(volume[rows[0]].sum() + 2 * volume[rows[1]].sum(), rel=1e-12)
    with Problem(model) as problem:
        assert problem.elastic_modes(count=1).frequencies_hz[0] > 1


def test_damaged_files_end_in_one_message(tmp_path):
    """Cut off, bytes changed, lines swapped or doubled: bulk data are read or refused, never a crash."""
    path = tmp_path / "model.bdf"
    sources = [
        FULL,
        CUBE + SYSTEMS + "CTETRA,9,1,911,912,913,914\n" + MAT1,
        MAT1 + nastran_mesh(box("tet10", (1, 1, 1), (1, 1, 1)), "large"),
    ]
    refused = 0
    for data in damaged(sources, 450, 7, b"0123456789,.*-=+\n\r\t AzE$'\xff\x00"):
        path.write_bytes(data)
        try:
            read_nastran(path).convert()
        except InputError:
            refused += 1
    assert refused > 100


def entries(model, matrix="K"):
    """Entries as (label, component, label, component) -> value."""
    A = getattr(model, matrix).tocoo()
    name = [(int(model.nodes.ids[n]), int(c)) for n, c in zip(model.dofs.node, model.dofs.component, strict=True)]
    return {(*name[i], *name[j]): value for i, j, value in zip(*A.coords, A.data, strict=True)}


def added(bulk, cards, matrix="K"):
    """What cards add to the cube's matrix."""
    more, bare = entries(model_of(bulk(CUBE + MAT1 + cards)), matrix), entries(model_of(bulk(CUBE + MAT1)), "K")
    bare = bare if matrix == "K" else entries(model_of(bulk(CUBE + MAT1)), "M") if matrix == "M" else {}
    return {key: more.get(key, 0.0) - bare.get(key, 0.0) for key in more if abs(more[key] - bare.get(key, 0.0)) > 1e-3}


def test_springs_dampers_and_masses_between_components(bulk):
    ground = "CELAS2,1,500.,10,1\nPELAS,4,70.,,,5,90.\nCELAS1,2,5,20,2,30,3\n"
    assert added(bulk, ground) == pytest.approx(
        {
            (10, 0, 10, 0): 500.0,
            (20, 1, 20, 1): 90.0,
            (30, 2, 30, 2): 90.0,
            (20, 1, 30, 2): -90.0,
            (30, 2, 20, 1): -90.0,
        },
        rel=1e-4,
    )
    assert added(bulk, "CMASS2,1,3.,10,1\nPMASS,6,2.\nCMASS1,2,6,20,2\n", "M") == pytest.approx(
        {(10, 0, 10, 0): 3.0, (20, 1, 20, 1): 2.0}
    )
    assert added(bulk, "CDAMP2,1,3.,10,1\nPDAMP,6,2.\nCDAMP1,2,6,20,2\n", "D") == pytest.approx(
        {(10, 0, 10, 0): 3.0, (20, 1, 20, 1): 2.0}
    )
    # Away from the axis of a cylinder at (1, 1): along (1, 1) / sqrt(2).
    turned = CUBE.replace("GRID,30,,1.,1.,0.", "GRID,30,,1.,1.,0.,5") + "CORD2C,5,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n"
    grounded = bulk(turned + MAT1 + "CELAS2,1,500.,30,1\n").discrete[0]
    assert grounded.values == pytest.approx(np.full((2, 2), 250.0)) and grounded.components.tolist() == [0, 1]


def test_bushes_act_at_a_point_between_their_grids(bulk):
    """Against the stiffness of two rigid arms that meet at the point, with free rotations of the solid's grid."""
    loose = "GRID,90,,2.,1.,1.\nCONM2,91,90,,5.,\n,1.,,1.,,,1.\n"
    imported = bulk(CUBE + MAT1 + loose + "PBUSH,3,K,10.,20.,30.,40.,50.,60.\n,B,1.,1.,1.\nCBUSH,1,3,70,90,,,,0\n")
    stiff, damper = imported.discrete
    a = np.eye(6)
    a[:3, 3:] = -np.array([[0, 0, 0], [0, 0, -0.5], [0, 0.5, 0]])
    b = np.eye(6)
    b[:3, 3:] = -np.array([[0, 0, 0], [0, 0, 0.5], [0, -0.5, 0]])
    B = np.hstack([-a, b])
    assert stiff.values == pytest.approx(B.T @ np.diag([10.0, 20, 30, 40, 50, 60]) @ B)
    assert damper.values[:3, :3] == pytest.approx(np.eye(3))
    model = model_of(bulk(CUBE + MAT1 + loose + "PBUSH,3,K,10.,20.,30.,40.,50.,60.\nCBUSH,1,3,70,90,,,,0\n"))
    K = model.K.toarray()
    six = np.flatnonzero(model.nodes.ids[model.dofs.node] == 90)
    whole = stiff.values
    free = [3, 4, 5]  # rotations of grid 70, which its solid does not have
    kept = [0, 1, 2, 6, 7, 8, 9, 10, 11]
    condensed = whole[np.ix_(kept, kept)] - whole[np.ix_(kept, free)] @ np.linalg.solve(
        whole[np.ix_(free, free)], whole[np.ix_(free, kept)]
    )
    assert K[np.ix_(six, six)] == pytest.approx(condensed[3:, 3:], abs=1e-9)
    bush = CUBE + MAT1 + loose + "PBUSH,3,K,10.,20.,30.\nCBUSH,1,3,70,90\n"
    assert refusals(lambda: bulk(bush)) == [("CBUSH", 17, ("--skip CBUSH",))]
    # Both ends of solids turn freely, so that K2 and K3 would do nothing; K1 along the ends acts.
    second = CUBE + "GRID,11,,3.,0.,0.\nGRID,21,,4.,0.,0.\nGRID,31,,3.,1.,0.\nGRID,41,,3.,0.,1.\n"
    between = second + MAT1 + "CTETRA,9,1,11,21,31,41\nCBUSH,1,3,20,11,,,,0\nPBUSH,3,K,10.,"
    with refusal("model", "springs", "CBUSH_1", "11"):
        model_of(bulk(between + "20.,30.\n"))
    ends = [dof_of(model := model_of(bulk(between + "0.,0.,40.\n")), label, 0) for label in (20, 11)]
    assert model.K[ends[0], ends[1]] == pytest.approx(-10.0)


def test_multipoint_constraints_of_the_set_that_is_asked_for(bulk):
    cards = "MPC,1,10,1,2.,20,1,-1.\n,,30,2,-.5\nMPC,2,40,3,1.,50,3,1.\nMPCADD,9,1,2\n"
    (both,) = bulk(CUBE + MAT1 + cards).equations
    assert len(both) == 2 and sorted(both.coefficients.tolist()) == [-1.0, 0.25, 0.5]
    head = "SOL 103\nCEND\n{}BEGIN BULK\n"
    (equation,) = bulk(head.format("MPC = 2\n") + CUBE + MAT1 + cards + "ENDDATA\n").equations
    assert len(equation) == 1 and equation.components.tolist() == [2]
    assert len(bulk(head.format("MPC = 9\n") + CUBE + MAT1 + cards + "ENDDATA\n").equations[0]) == 2
    none = bulk(head.format("") + CUBE + MAT1 + cards + "ENDDATA\n")
    assert not none.equations and "MPC: not applied, the case control asks for none." in none.notes
    assert refusals(lambda: bulk(CUBE + MAT1 + "MPC,1,10,1,0.,20,1,-1.\n")) == [("MPC", 13, ("--skip MPC",))]


def test_cards_are_skipped_and_densities_given_where_asked(tmp_path):
    path = tmp_path / "model.bdf"
    path.write_text(CUBE + "CQUAD4,8,1,10,20,30,40\nRBE2,9,11,123,10\nPSOLID,1,1\nMAT1,1,2.1+11,,.3\nMATT1,1,7\n")
    assert refusals(lambda: read_nastran(path).convert()) == [
        ("CQUAD4", 11, ("--skip CQUAD4",)),
        ("RBE2", 12, ("--skip RBE2",)),
        ("DENSITY", 0, ("--density X",)),
    ]
    imported = read_nastran(path, skip=["CQUAD4", "RBE2"], density=7850.0).convert()
    assert imported.materials[0].density == 7850.0 and len(imported.warnings) == 4


@pytest.mark.parametrize("form", ["GRID    {:8d}        {:8.5f}{:8.5f}{:8.5f}", "GRID,{},,{:.5f},{:.5f},{:.6f}"])
def test_a_last_number_that_is_shorter_than_those_above_is_cut_off(form, bulk):
    """Of cards that are written in one format; without an end of line the last may be whole."""
    text = CUBE + "\n".join(form.format(n, n / 700, n / 800, n / 900) for n in range(901, 905))
    assert any("[last-line-open]" in said for said in bulk(text).mesh.warnings)
    for cut in (1, 2, 3):
        with refusal("file", "", "model.bdf", text[:-cut].splitlines()[-1].split()[-1]):
            bulk(text[:-cut])


@pytest.mark.parametrize(
    ("last", "warned"),
    [
        ("GRID,90,,1.,2.,3.", True),
        ("$ the end", False),
        ("ENDDATA", False),
        ("PSOLID,1,1", True),
        ("PLOTEL,5,10,20", True),
    ],
)
def test_a_last_line_without_an_end_is_read_where_its_card_may_be_whole(last, warned, bulk):
    said = [text for text in bulk(CUBE + last).mesh.warnings if text.endswith("[last-line-open]")]
    assert len(said) == warned and all(repr(last) in text for text in said)


def test_blanks_between_digits_of_components_do_not_count(bulk):
    plain = CUBE + "RBE2,9,10,12346,20\nGRDSET,,,,,,,1246\nGRID,11,,0.,0.,0.,,135\n"
    spaced = CUBE + "RBE2,9,10,12 3 46,20\nGRDSET,,,,,,,12 4 6\nGRID,11,,0.,0.,0.,,1 35\n"
    one, other = bulk(plain), bulk(spaced)
    assert one.rigid[0].components == other.rigid[0].components == (0, 1, 2, 3, 5) and one.notes == other.notes
    with refusal("unsupported", "", "GRID"):
        bulk(CUBE + "GRID,11,,0.,0.,0.,,1 x 5\n")


@pytest.mark.parametrize(
    "text",
    [
        "DEQATN  10      F(A,B,C)=A+B*C,A\n        -SQRT(ABS(A))+MAX(A,B,C,1.,2.,3.,4.,5.,6.,7.,8.,9.)\n",
        "DEQATN  10      F(A)=A*100.0+VERYLONGNAMEOFAVARIABLE*2+ANOTHERONETHATGOESON1\n+       XYZ+1.\n",
        "DEQATN,10,F(A,B)=A+B,,,,,,,,,,,and more\n",
    ],
)
def test_cards_of_free_text_are_passed_over(text, bulk):
    """Commas, marks and lengths of fields mean nothing in them."""
    assert len(bulk(CUBE + text + "GRID,11,,0.,0.,0.\n").mesh.blocks) == len(bulk(CUBE).mesh.blocks)


def test_what_a_deck_holds_is_among_its_tables(tmp_path):
    """SPC, SPC1 and PS of the set that the case control asks for, along the axes of each grid."""
    path = tmp_path / "model.bdf"
    held = (
        "GRID,90,,9.,0.,0.,3,4\nCORD2R,3,,0.,0.,0.,0.,0.,1.\n,0.,1.,0.\n"
        "SPC1,1,12,10,THRU,20\nSPC,2,30,3,0.\nSPC1,1,1,90\nSPCADD,5,1\nENDDATA\n"
    )

    def read(head):
        path.write_text(head + CUBE + MAT1 + held)
        return read_nastran(path)

    deck = read("CEND\nSPC = 5\nBEGIN BULK\n")
    assert deck.supports.nodes.tolist() == [10, 10, 20, 20, 90, 90]
    assert deck.supports.directions[:4].tolist() == np.eye(6)[[0, 1, 0, 1]].tolist()
    # The first axis of the system 3 is y, and PS 4 a rotation about it.
    assert np.allclose(deck.supports.directions[4:], np.eye(6)[[1, 4]], atol=1e-15)
    everything = read("BEGIN BULK\n")
    assert everything.supports.nodes.tolist() == [10, 10, 20, 20, 30, 90, 90]
    assert everything.left_out["SPC1"].count == 2 and "2 SPC1: not applied; the body is free." in everything.notes
    torn = read("CEND\nSUBCASE 1\nSPC = 1\nSUBCASE 2\nSPC = 2\nBEGIN BULK\n")
    assert not len(torn.supports.nodes) and "subcases ask for the SPC sets [1, 2]" in torn.left_out["SPC"].why
    assert torn.to_model().M.sum() > 0
