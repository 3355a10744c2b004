"""Decks that are written: read again they are the same model, and the programs have its frequencies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.deck_programs import difference, of_ccx, of_held_ccx, spectrum_of
from morembs import read_deck
from morembs.base.errors import OverwriteError
from morembs.fem import FEModel
from morembs.fem.material import isotropic
from morembs.importers import IMPORTERS, import_file
from morembs.importers.decks.labels import in_ranges
from morembs.importers.decks.model import Deck
from morembs.importers.decks.problems import DeckError
from morembs.importers.decks.tables import ElasticMaterial, Elements, Section, Supports
from morembs.importers.decks.writers.calculix_mesh import numeral
from morembs.importers.to_model import model_of
from tests.importers.test_engines import BEAM, PLATE, SHELL
from tests.importers.test_mystran import DECKS as BULK
from tests.importers.test_mystran import FRAME, MIXED, PROPERTIES, SHEET, ansys_elements
from tests.importers.test_nastran_deck import FULL
from tests.importers.test_unv import universal
from tests.support.calculix import (
    STEEL,
    elements_text,
    needs_ccx,
    nodes_text,
    on_plane,
    own_frequencies,
    solids,
    stored_matrices,
)
from tests.support.mesh_decks import ansys_archive, nastran_mesh
from tests.support.meshes import box
from tests.support.mystran import grids, needs_mystran
from tests.support.refusals import refusal
from tests.support.structures import STRUCTURES

KINDS = {"C3D4": "tet4", "C3D10": "tet10", "C3D6": "wedge6", "C3D15": "wedge15", "C3D8": "hex8", "C3D20": "hex20"}
SOLIDS = (*KINDS, "C3D8R", "C3D8I", "C3D20R")
ENDINGS = {"abaqus": "inp", "nastran": "bdf", "ansys": "cdb", "unv": "unv"}
MAT1 = "PSOLID,1,1\nMAT1,1,2.1+11,,.3,7850.\n"
# Two blocks of two materials, of which one has axes, in instances that are turned and shifted; all that hangs on them.
WHOLE = (
    "*PART, NAME=P\n"
    + nodes_text(box("hex8", (2, 1, 1), (1.0, 0.4, 0.3)).nodes.xyz)
    + elements_text("C3D8", box("hex8", (2, 1, 1), (1.0, 0.4, 0.3)).blocks[0].nodes, "BODY")
    + "*ORIENTATION, NAME=O\n.6, .8, 0., -.8, .6, 0.\n*SOLID SECTION, ELSET=BODY, MATERIAL=PLY, ORIENTATION=O\n"
    "*SURFACE, NAME=LOW\nBODY\n*NSET, NSET=SIX\n1, 2, 3, 4, 5, 6\n*END PART\n"
    "*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=P\n*END INSTANCE\n*INSTANCE, NAME=J, PART=P\n0., 0., .3\n"
    "0., 0., 0., 0., 0., 1., 30.\n*END INSTANCE\n*NODE\n900, 2., 0., 0.\n901, -1., 0., .1\n902, .3, .2, 2.\n"
    "*ELEMENT, TYPE=MASS, ELSET=POINT\n990, 900\n*MASS, ELSET=POINT\n7.\n"
    "*ELEMENT, TYPE=SPRINGA, ELSET=AXIAL\n991, 902, I.1\n*SPRING, ELSET=AXIAL\n\n3.1e6\n"
    "*ELEMENT, TYPE=SPRING2, ELSET=PAIR\n992, 901, I.2\n*SPRING, ELSET=PAIR\n2, 2\n1.7e6\n"
    "*ELEMENT, TYPE=SPRING1, ELSET=GROUND\n993, I.3\n*SPRING, ELSET=GROUND\n3\n\n2.e5\n"
    "*ELEMENT, TYPE=DASHPOTA, ELSET=DAMPER\n994, 901, I.2\n*DASHPOT, ELSET=DAMPER\n\n40.\n"
    "*NSET, NSET=TOP, INSTANCE=J\nSIX\n*SURFACE, NAME=TOP, TYPE=NODE\nTOP, 2.\n"
    "*SURFACE, NAME=FOOT, TYPE=NODE\nI.SIX, 1.\n*COUPLING, REF NODE=900, SURFACE=FOOT, CONSTRAINT NAME=FOOT\n"
    "*KINEMATIC\n1, 3\n"
    "*COUPLING, REF NODE=902, SURFACE=TOP, CONSTRAINT NAME=HEAD\n*DISTRIBUTING\n"
    "*EQUATION\n3\nJ.12, 1, 2., J.11, 1, -1., J.10, 2, .5\n*END ASSEMBLY\n"
    "*MATERIAL, NAME=PLY\n*ELASTIC, TYPE=ENGINEERING CONSTANTS\n140.e9, 10.e9, 8.e9, .3, .25, .4, 5.e9, 4.e9\n3.5e9\n"
    "*DENSITY\n1600.\n"
)
GLUED = (
    "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,1,0,1\n7,1,1,1\n8,0,1,1\n11,.1,.1,1.01\n12,.6,.1,1\n"
    "13,.6,.6,1\n14,.1,.6,1\n15,.1,.1,2\n16,.6,.1,2\n17,.6,.6,2\n18,.1,.6,2\n"
    "*ELEMENT,TYPE=C3D8,ELSET=A\n1,1,2,3,4,5,6,7,8\n*ELEMENT,TYPE=C3D8,ELSET=B\n2,11,12,13,14,15,16,17,18\n"
    "*SURFACE,NAME=SA\nA,S2\n*SURFACE,NAME=SB\nB,S1\n*TIE,NAME=T,POSITION TOLERANCE=0.1\nSB,SA\n"
    f"{STEEL}*SOLID SECTION,ELSET=A,MATERIAL=STEEL\n*SOLID SECTION,ELSET=B,MATERIAL=STEEL\n"
)


def deck_text(code: str) -> str:
    mesh = box(KINDS[code.rstrip("RI")], (2, 1, 1), (1.0, 0.4, 0.3))
    section = "*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL\n"
    return nodes_text(mesh.nodes.xyz) + elements_text(code, mesh.blocks[0].nodes, "BODY") + STEEL + section


def read(path: Path, **options: object) -> Deck:
    (format,) = (name for name, ending in ENDINGS.items() if path.name.endswith(ending))
    deck = IMPORTERS[format].read(path, **options)
    assert isinstance(deck, Deck)
    return deck


@pytest.fixture
def again(tmp_path):
    """Writes a text as a deck, reads it, writes that as another format and reads this: both decks, what was said."""

    def written(text: str, source: str, format: str, **options: object) -> tuple[Deck, Deck, tuple[str, ...]]:
        (tmp_path / f"first.{ENDINGS[source]}").write_text(text)
        first = read(tmp_path / f"first.{ENDINGS[source]}", **options)
        target = tmp_path / f"second.{'bdf' if format == 'nastran' else 'inp'}"
        said = first.write(target, format)
        return first, read(target, **({} if format == "nastran" else {"dialect": format})), said

    return written


def assert_same(first: FEModel, second: FEModel, tolerance: float) -> None:
    """The same K, M, D and dependent dofs on the same nodes."""
    assert np.array_equal(first.nodes.ids, second.nodes.ids)
    assert np.array_equal(first.dofs.node, second.dofs.node)
    assert np.array_equal(first.dofs.component, second.dofs.component)
    for name in ("K", "M", "D"):
        own, other = getattr(first, name), getattr(second, name)
        assert (own is None) == (other is None), name
        if own is not None:
            assert abs(own - other).max() <= tolerance * abs(own).max(), name
    assert (first.dependent is None) == (second.dependent is None)
    if first.dependent is not None and second.dependent is not None:
        assert abs(first.dependent.S - second.dependent.S).max() <= tolerance * abs(first.dependent.S).max()


@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
@pytest.mark.parametrize("code", SOLIDS)
def test_solids_of_input_decks_come_back_with_their_sets(code, dialect, again):
    text = deck_text(code) + "*NSET, NSET=END FACE\n1, 2, 3\n*ELSET, ELSET=ONE\n1\n"
    first, second, said = again(text, "abaqus", dialect, dialect=dialect)
    assert said == ("names of first.inp are written otherwise: NSET 'END FACE' as 'END_FACE' [not-written]",)
    assert_same(first.to_model(), second.to_model(), 1e-13)
    assert set(second.element_sets) == {"BODY", "ONE"} and np.array_equal(second.node_sets["END_FACE"], [[1, 3]])
    assert [section.set for section in second.sections] == ["BODY"]


@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
def test_parts_couplings_springs_and_materials_with_axes_come_back(dialect, again):
    first, second, said = again(WHOLE, "abaqus", dialect, dialect=dialect)
    lost = "the sets POINT, AXIAL, PAIR, GROUND, DAMPER of first.inp lack what is empty or stands for masses"
    assert len(said) == 1 and said[0].startswith(lost)
    assert set(first.surfaces) <= set(second.surfaces)
    for name, surface in first.surfaces.items():
        assert np.array_equal(second.surfaces[name].nodes, surface.nodes)
        assert np.allclose(second.surfaces[name].weights, surface.weights, rtol=1e-12)
    assert len(first.rigid) == len(first.average) == 1 and len(first.discrete) == 4
    assert_same(first.to_model(), second.to_model(), 1e-12)
    assert [element.name for element in second.rigid + second.average] == ["FOOT", "HEAD"]


@pytest.mark.parametrize("program", ["Abaqus", "CalculiX"])
def test_a_written_deck_tells_its_program(program, tmp_path):
    (tmp_path / "first.inp").write_text(deck_text("C3D8"))
    first = read(tmp_path / "first.inp", dialect="abaqus")
    said = first.write(tmp_path / "second.inp", program.lower())
    second = read(tmp_path / "second.inp")
    assert second.program == program and not second.mesh_warnings
    if program == "Abaqus":
        assert said == ()
        assert_same(first.to_model(), second.to_model(), 1e-13)
    else:
        assert len(said) == 1 and "2 elements C3D8 of Abaqus are written as C3D8 of CalculiX, which" in said[0]


@pytest.mark.parametrize(
    ("text", "source", "what"),
    [
        (deck_text("C3D8") + "*BOUNDARY\nNOPE, 1, 3\n", "abaqus", "*BOUNDARY (1)"),
        (deck_text("C3D8") + 2 * "*STEP\n*STATIC\n*BOUNDARY\n1, 1, 3\n*END STEP\n", "abaqus", "*BOUNDARY (1)"),
        (
            ansys_archive(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0))).replace("FINISH\n", "D,1,UX,0.\nFINISH\n"),
            "ansys",
            "D (1)",
        ),
    ],
    ids=["model", "step", "ansys"],
)
@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
def test_supports_that_were_not_read_are_named_where_a_deck_is_written(format, text, source, what, again):
    _, _, said = again(text, source, format)
    (sentence,) = (line for line in said if "has more that is not written" in line)
    assert f"has more that is not written: {what}" in sentence


HELD = (
    "*NSET,NSET=AX\n2\n*TRANSFORM,NSET=AX,TYPE=R\n0.,1.,0.,-1.,0.,0.\n*BOUNDARY\n1,PINNED\n3,2\n"
    "*NSET,NSET=SLANT\n4\n*TRANSFORM,NSET=SLANT,TYPE=R\n.6,.8,0.,-.8,.6,0.\n"
    "*STEP\n*STATIC\n*BOUNDARY\nAX,1\n1,1,2\nSLANT,1\n5,3,3,.01\n*END STEP\n"
)


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
def test_supports_of_a_deck_and_of_its_first_step_are_written(format, again):
    first, second, said = again(deck_text("C3D8") + HELD, "abaqus", format)
    assert "BOUNDARY" not in " ".join(said) and "*BOUNDARY" not in first.left_out
    held = [(1, (1,)), (1, (0, 1)), (1, (0, 0, 1)), (3, (0, 1)), (2, (0, 1)), (4, (0.6, 0.8)), (5, (0, 0, 1))]
    assert first.supports.nodes.tolist() == [node for node, _ in held]
    for direction, (_, wanted) in zip(first.supports.directions, held, strict=True):
        assert direction == pytest.approx([*wanted, *[0.0] * (6 - len(wanted))], abs=1e-15)
    # What is held along no axis is an equation.
    axes = [i for i, direction in enumerate(first.supports.directions) if (direction != 0).sum() == 1]
    keys = [
        {(int(n), int(np.flatnonzero(d)[0])) for n, d in zip(own.nodes, own.directions, strict=True)}
        for own in (
            replace(first.supports, nodes=first.supports.nodes[axes], directions=first.supports.directions[axes]),
            second.supports,
        )
    ]
    assert keys[0] == keys[1] and len(keys[0]) == 6
    assert sum(len(own) for own in second.equations) == 1


@pytest.mark.parametrize(
    ("options", "later", "held"),
    [("", "", [1, 4]), (", OP=MOD", "", [1, 4]), (", OP = new", "", [4]), ("", ", OP=NEW", [1, 4])],
    ids=["none", "mod", "new", "new in the second"],
)
def test_a_first_step_with_new_supports_drops_those_of_the_model(options, later, held, again):
    text = deck_text("C3D8") + f"*BOUNDARY\n1, 1\n*STEP\n*STATIC\n*BOUNDARY{options}\n4, 1\n*END STEP\n"
    text += f"*STEP\n*STATIC\n*BOUNDARY{later}\n4, 1\n*END STEP\n" if later else ""
    first, second, _ = again(text, "abaqus", "calculix")
    assert first.supports.nodes.tolist() == second.supports.nodes.tolist() == held


@needs_ccx
def test_new_supports_hold_as_in_ccx(tmp_path):
    xyz = solids("C3D20", (4, 1, 1), (4.0, 0.3, 0.2))
    ends = ["".join(f"{node}, 1, 3\n" for node in on_plane(xyz, 0, x)) for x in (0.0, 4.0)]
    text = f"{xyz}*BOUNDARY\n{ends[0]}*STEP\n*FREQUENCY\n10\n*BOUNDARY, OP=NEW\n{ends[1]}"
    path = tmp_path / "deck.inp"
    path.write_text(f"{text}{on_plane(xyz, 0, 0.0)[0]}, 2\n*END STEP\n")
    theirs = of_held_ccx(path)
    read(path, dialect="calculix").write(tmp_path / "flat.inp", "calculix")
    kept = model_of(import_file(path, engine="calculix", options={"boundary": "keep"}))
    assert difference(of_held_ccx(tmp_path / "flat.inp"), theirs) <= 1e-6
    assert difference(spectrum_of(kept), theirs) <= 1e-6


@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
def test_sets_of_nodes_and_elements_may_share_names_with_those_of_the_writer(dialect, again):
    text = deck_text("C3D8") + "".join(
        f"*NSET, NSET={name}\n1, 2\n*ELSET, ELSET={name}\n1\n" for name in ("SET-1", "NS", "ES", "STEEL")
    )
    first, second, said = again(text, "abaqus", dialect, dialect=dialect)
    assert said == () and len(first.node_sets) == 4
    for name, ranges in first.node_sets.items():
        assert np.array_equal(second.node_sets[name], ranges)
    for name, ranges in first.element_sets.items():
        assert np.array_equal(second.element_sets[name], ranges)


def test_sets_of_elements_and_surfaces_that_bulk_data_lack_are_named(again):
    text = deck_text("C3D8").replace("C3D8", "C3D8I") + "*ELSET, ELSET=ONE\n1\n*SURFACE, NAME=LOW\nBODY, S1\n"
    _, _, said = again(text, "abaqus", "nastran")
    assert "Nastran has no sets of elements: ONE are not written [not-written]" in said
    assert "Nastran has no surfaces: LOW are not written [not-written]" in said


@pytest.mark.parametrize("option", ["", "ADJUST=NO,"])
@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
def test_surfaces_are_glued_again(dialect, option, again):
    first, second, _ = again(GLUED.replace("*TIE,", f"*TIE,{option}"), "abaqus", dialect, dialect=dialect)
    assert len(first.ties) == len(second.ties) == 1 and np.array_equal(first.xyz, second.xyz)
    assert_same(first.to_model(), second.to_model(), 1e-13)


@pytest.mark.parametrize("kind", ["tet4", "tet10", "hex8", "hex20", "wedge6", "wedge15"])
@pytest.mark.parametrize("full", [False, True])
def test_solids_of_bulk_data_come_back(kind, full, again):
    property_ = "PSOLID,1,1,,TWO,,FULL\n" if full else "PSOLID,1,1\n"
    mesh = box(kind, (2, 1, 1), (0.5, 0.25, 0.125))
    text = (
        "BEGIN BULK\n" + property_ + MAT1.split("\n", 1)[1] + nastran_mesh(mesh, "free") + "SET1,4,1,THRU,3\nENDDATA\n"
    )
    first, second, said = again(text, "nastran", "nastran")
    assert said == ()
    assert_same(first.to_model(), second.to_model(), 1e-13)
    assert np.array_equal(second.node_sets["SET1_1"], [[1, 3]])


def test_rigid_average_and_mass_cards_come_back(again):
    text = FULL.replace("SPC = 1\n", "SPC = 1\nMPC = 1\n").replace("PARAM,WTMASS,.5\n", "")
    text = text.replace("RBAR,3,500,600,123456,,,\n", "").replace(
        "ENDDATA", "MPC,1,30,1,2.,40,1,-1.\n,,40,2,.5\nCELAS2,77,3.+4,20,2,80,2\nENDDATA", 1
    )
    first, second, _ = again(text, "nastran", "nastran")
    assert first.rigid and first.average and first.masses and first.equations and first.discrete
    assert_same(first.to_model(), second.to_model(), 1e-10)


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
@pytest.mark.parametrize("kind", ["tet10", "hex8", "hex20", "wedge6"])
def test_archives_and_universal_files_become_decks_of_each_program(kind, format, again):
    """K and M are the same where the format has the formulation, and else it is said what differs."""
    mesh = box(kind, (2, 1, 1), (0.3, 0.2, 0.1))
    materials = "MP,EX,1,2.1e11\nMP,NUXY,1,.3\nMP,DENS,1,7850.\nFINISH\n"
    archive, text, said = again(ansys_archive(mesh).replace("FINISH\n", materials), "ansys", format)
    own, other = (deck.elements[0].meaning for deck in (archive, text))
    said = tuple(sentence for sentence in said if "[not-written]" not in sentence)
    same = own.formulation == other.formulation, own.mass == other.mass
    assert all(same) == (said == ()) and len(said) == len([line for line in said if "[formulation-differs]" in line])
    for matrix, is_same in zip("KM", same, strict=True):
        first, second = (getattr(deck.to_model(), matrix) for deck in (archive, text))
        assert (abs(first - second).max() < 1e-10 * abs(first).max()) or not is_same
    first, second, _ = again(universal(mesh), "unv", format)
    assert np.array_equal(first.convert().mesh.blocks[0].nodes, second.convert().mesh.blocks[0].nodes)
    assert np.allclose(second.xyz, first.xyz, rtol=1e-10)


@pytest.mark.parametrize("format", ["calculix", "abaqus"])
def test_normals_of_elements_at_their_nodes_are_written(format, tmp_path):
    (tmp_path / "own.inp").write_text(STRUCTURES["S8R with normals"])
    own = read_deck(tmp_path / "own.inp", dialect="calculix")
    assert own.write(tmp_path / "flat.inp", format) == ()
    flat = read_deck(tmp_path / "flat.inp", dialect="calculix")
    normals = [deck.elements[0].values["normal"] for deck in (own, flat)]
    assert np.isfinite(normals[0]).all(axis=2).sum() == 2
    assert np.allclose(normals[0], normals[1], rtol=1e-14, equal_nan=True)
    K, written = (deck.to_model().K for deck in (own, flat))
    assert abs(written - K).max() < 1e-12 * abs(K).max()
    with refusal("unsupported", "", "S8R", "nastran"):
        own.write(tmp_path / "flat.bdf", "nastran")


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
def test_values_of_single_elements_that_are_not_written_are_refused(format, tmp_path):
    deck = frame()
    nodes = replace(deck.elements[0], values={"colour": np.ones((12, 4))})
    with refusal("unsupported", "", "CQUAD4"):
        replace(deck, elements=(nodes, deck.elements[1])).write(tmp_path / "flat", format)
    if format != "nastran":
        thick = replace(deck.elements[0], values={"thickness": np.arange(1.0, 49).reshape(12, 4)})
        with refusal("unsupported", "", "CQUAD4"):
            replace(deck, elements=(thick, deck.elements[1])).write(tmp_path / "flat", format)
        pins = replace(deck.elements[1], values={"released": np.ones((2, 2, 6))})
        with refusal("unsupported", "", "CBAR", "13"):
            replace(deck, elements=(deck.elements[0], pins)).write(tmp_path / "flat", format)
    nodal = replace(deck.sections[0], code="*SHELL SECTION, NODAL THICKNESS")
    with refusal("unsupported", "thickness"):
        replace(deck, sections=(nodal, deck.sections[1])).write(tmp_path / "flat", format)
    assert not (tmp_path / "flat").exists()


@needs_ccx
@pytest.mark.parametrize(("code", "word"), [("SPRINGA", "SPRING"), ("DASHPOTA", "DASHPOT")])
def test_springs_and_dashpots_along_a_line_are_read_by_ccx(code, word, tmp_path):
    text = deck_text("C3D8") + f"*NODE\n99, 0., 0., -1.\n*ELEMENT, TYPE={code}, ELSET=A\n99, 99, 1\n"
    (tmp_path / "deck.inp").write_text(f"{text}*{word}, ELSET=A\n2.e6\n")
    read(tmp_path / "deck.inp", dialect="calculix").write(tmp_path / "flat.inp", "calculix")
    assert stored_matrices((tmp_path / "flat.inp").read_text(), tmp_path)[0] is not None


@needs_ccx
@pytest.mark.parametrize("code", SOLIDS)
def test_the_written_deck_has_the_frequencies_of_its_model_in_ccx(code, tmp_path):
    path = tmp_path / "deck.inp"
    path.write_text(deck_text(code))
    read(path, dialect="calculix").write(tmp_path / "flat.inp", "calculix")
    text = (tmp_path / "flat.inp").read_text()
    held = "*BOUNDARY\n" + "".join(f"{node}, 1, 3\n" for node in on_plane(deck_text(code), 0, 0.0))
    theirs = own_frequencies(text + held, tmp_path)
    assert theirs == pytest.approx(own_frequencies(deck_text(code) + held, tmp_path), rel=1e-6)


def frame() -> Deck:
    """A plate of shells and two bars beside it, of steel, held at one edge and at one end."""
    flat = box("hex8", (4, 3, 1), (1.0, 0.8, 1.0)).nodes
    low = np.flatnonzero(flat.xyz[:, 2] == 0)
    xyz = np.concatenate([flat.xyz[low], [[2.0, 0.0, 0.0], [2.0, 0.0, 0.4], [2.0, 0.0, 0.8]]])
    corner = np.arange(20).reshape(5, 4)
    quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1).reshape(-1, 4)
    bars, first = np.array([[21, 22], [22, 23]]), np.array([1.0, 0.0, 0.0])
    steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    return Deck(
        name="frame",
        program="Nastran",
        ids=np.arange(1, 24),
        xyz=xyz,
        elements=(
            Elements(code="CQUAD4", kind="shell", shape="quad4", ids=np.arange(1, 13), nodes=quads + 1),
            Elements(code="CBAR", kind="beam", shape="line2", ids=np.arange(13, 15), nodes=bars),
        ),
        element_sets={"plate": np.array([[1, 12]]), "bars": np.array([[13, 14]])},
        node_sets={"root": np.array([[5, 8]])},
        materials={"steel": ElasticMaterial(name="steel", stiffness=steel.stiffness, density=7850.0)},
        sections=(
            Section(set="plate", kind="shell", material="steel", thickness=0.02),
            Section(
                set="bars", kind="beam", material="steel", profile="RECT", dimensions=(0.05, 0.03), direction=first
            ),
        ),
        supports=Supports(nodes=np.repeat(np.arange(17, 22), 6), directions=np.tile(np.eye(6), (5, 1))),
    )


@needs_ccx
def test_shells_and_beams_are_those_of_a_deck_by_hand_in_ccx(tmp_path):
    deck = frame()
    deck.write(tmp_path / "flat.inp", "calculix")
    quads, bars = (deck.elements[i].nodes for i in (0, 1))
    text = nodes_text(deck.xyz) + elements_text("S4", quads - 1, "P") + elements_text("B31", bars - 1, "B", label=13)
    text += f"{STEEL}*SHELL SECTION, ELSET=P, MATERIAL=STEEL\n.02\n"
    text += "*BEAM SECTION, ELSET=B, MATERIAL=STEEL, SECTION=RECT\n.05, .03\n1., 0., 0.\n"
    text += "*BOUNDARY\n" + "".join(f"{node}, 1, 6\n" for node in range(17, 22))
    theirs = own_frequencies((tmp_path / "flat.inp").read_text(), tmp_path)
    assert theirs == pytest.approx(own_frequencies(text, tmp_path), rel=1e-9)
    assert 0 < theirs[0] < theirs[-1]


@needs_ccx
def test_shells_and_bars_of_bulk_data_are_those_of_a_deck_by_hand_in_ccx(tmp_path):
    """Thickness, offset and direction of single elements are in sections of their own."""
    deck = frame()
    deck.write(tmp_path / "hand.inp", "calculix")
    deck.write(tmp_path / "frame.bdf", "nastran")
    said = read(tmp_path / "frame.bdf").write(tmp_path / "flat.inp", "calculix")
    assert sum("are written as" in sentence and "[formulation-differs]" in sentence for sentence in said) == 2
    wanted = own_frequencies((tmp_path / "hand.inp").read_text(), tmp_path)
    assert own_frequencies((tmp_path / "flat.inp").read_text(), tmp_path) == pytest.approx(wanted, rel=1e-6)
    thick = np.repeat([[0.02] * 4, [0.03] * 4], 6, axis=0)
    values = {"thickness": thick, "offset": np.repeat([0.0, 0.004], 6), "angle": np.full(12, 30.0)}
    single = replace(deck, elements=(replace(deck.elements[0], values=values), deck.elements[1]))
    two = replace(deck.sections[0], set="thick", thickness=0.03, offset=0.004)
    whole = replace(
        deck, element_sets={**deck.element_sets, "thick": np.array([[7, 12]])}, sections=(*deck.sections, two)
    )
    found = []
    for own in (single, whole):
        own.write(tmp_path / "flat.inp", "calculix")
        found.append(own_frequencies((tmp_path / "flat.inp").read_text(), tmp_path))
    assert found[0] == pytest.approx(found[1], rel=1e-6) and found[0] != pytest.approx(wanted, rel=1e-2)


@pytest.mark.parametrize(
    ("card", "property_", "lines"),
    [
        (
            "CQUAD8,1,1,1,2,3,4,5,6\n,7,8\n",
            "PSHELL,1,1,.01,1,,1\n",
            ["*ELEMENT, TYPE=S8R", "1, 1, 2, 3, 4, 5, 6, 7, 8"],
        ),
        ("CBAR,1,1,1,2,0.,0.,1.\n", "PBARL,1,1,,BAR\n,.1,.2\n", ["SECTION=RECT", "0.2, 0.1", "0.0, 0.0, 1.0"]),
        ("CROD,1,1,1,2\n", "PROD,1,1,.002\n", ["*ELEMENT, TYPE=T3D2", "*SOLID SECTION", "0.002"]),
    ],
)
def test_shells_and_bars_of_bulk_data_in_words_of_calculix(card, property_, lines, again, tmp_path):
    at = [(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5)]
    grids = "".join(f"GRID,{i},,{x},{y},0.\n" for i, (x, y) in enumerate(((float(x), float(y)) for x, y in at), 1))
    first, second, _ = again(f"BEGIN BULK\n{grids}{card}{property_}MAT1,1,2.1+11,,.3,7850.\n", "nastran", "calculix")
    text = (tmp_path / "second.inp").read_text()
    assert all(line in text for line in lines)
    assert np.array_equal(second.elements[0].nodes, first.elements[0].nodes)


@needs_ccx
@pytest.mark.parametrize(
    "text",
    [
        PLATE.replace("*SHELL SECTION,", "*SHELL SECTION,OFFSET=.4,")
        + "*ELEMENT,TYPE=MASS,ELSET=M\n99,10\n*MASS,ELSET=M\n300.\n*BOUNDARY\n1,1,6\n4,1,6\n7,1,6\n",
        SHELL.replace("S4R", "M3D4R").replace("SHELL", "MEMBRANE") + "*BOUNDARY\n1,1,3\n2,1,3\n3,3,3\n4,3,3\n",
        "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,.5,0,0\n6,1,.5,0\n7,.5,1,0\n8,0,.5,0\n"
        "*ELEMENT,TYPE=S8R,ELSET=E\n1,1,2,3,4,5,6,7,8\n*ORIENTATION,NAME=O\n0.,1.,0.,-1.,0.,0.\n"
        "*ORIENTATION,NAME=P\n.8,.6,0.,-.6,.8,0.\n*MATERIAL,NAME=PLY\n*ELASTIC,TYPE=ENGINEERING CONSTANTS\n"
        "140.e9,10.e9,10.e9,.3,.3,.4,5.e9,5.e9\n3.5e9\n*DENSITY\n1600.\n*SHELL SECTION,ELSET=E,OFFSET=.5,COMPOSITE\n"
        ".004,,PLY,O\n.003,,PLY,P\n*BOUNDARY\n1,1,6\n5,1,6\n2,1,6\n8,3,3\n",
        BEAM.format(",OFFSET1=.5,OFFSET2=-.2")
        .replace("4,1.5,0,0\n5,2,0,0", "4,1.4,.3,.1\n5,1.8,.6,.2")
        .replace("0,0,1\n", ".3,.2,1\n")
        + "*BOUNDARY\n1,1,6\n",
        BEAM.format("").replace("RECT\n.1,.2", "PIPE\n.1,.02").replace("B32", "B32R") + "*BOUNDARY\n1,1,6\n",
        "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=T3D2,ELSET=E\n1,1,4\n2,2,4\n3,3,4\n"
        f"{STEEL}*SOLID SECTION,ELSET=E,MATERIAL=STEEL\n.01\n*BOUNDARY\n1,1,3\n2,1,3\n3,1,3\n",
    ],
    ids=["S4 and a rigid body", "membrane", "layers", "B32 with offsets", "pipe", "trusses"],
)
def test_shells_and_beams_of_input_decks_keep_their_frequencies_in_ccx(text, tmp_path):
    (tmp_path / "deck.inp").write_text(text)
    deck = read(tmp_path / "deck.inp", dialect="calculix")
    said = deck.write(tmp_path / "flat.inp", "calculix")
    assert not said or (deck.masses and len(said) == 1 and said[0].startswith("the sets M of deck.inp lack"))
    theirs = own_frequencies((tmp_path / "flat.inp").read_text(), tmp_path, 3)
    # A reference turns about its mass for nothing.
    assert theirs == pytest.approx(own_frequencies(text, tmp_path, 3), rel=1e-6, abs=1e-4)
    assert np.abs(theirs).max() > 1
    (own,), (other,) = deck.sections, read(tmp_path / "flat.inp", dialect="calculix").sections
    assert (other.kind, other.profile, other.dimensions) == (own.kind, own.profile, own.dimensions)
    assert (other.thickness, other.offset) == pytest.approx((own.thickness, own.offset), rel=1e-14)
    assert own.offset == pytest.approx(
        -0.4 * 0.05 if "OFFSET=.4" in text else -0.5 * 0.007 if "COMPOSITE" in text else 0.0
    )
    if "OFFSET1" in text or "TYPE=S4," in text:
        assert difference(spectrum_of(deck.to_model()), of_ccx(tmp_path / "flat.inp")) <= 1e-6
        return
    with refusal("unsupported", "ELEMENT"):
        deck.convert()


@needs_mystran
def test_shells_and_bars_that_are_written_bend_as_they_should_in_mystran(tmp_path):
    """A cantilever of bars whose profile stands along its first axis (Timoshenko 1921), and the mass of all."""
    deck = frame()
    deck.write(tmp_path / "deck.bdf", "nastran")
    model = model_of(import_file(tmp_path / "deck.bdf", engine="mystran", options={"boundary": "keep"}))
    along = (model.dofs.component == 0).astype(float)
    assert along @ model.M @ along == pytest.approx(7850 * (0.02 * 0.8 + 0.05 * 0.03 * 0.8), rel=1e-9)
    S = model.dependent.S.toarray()[:, model.dependent.owner < 0]
    tip = np.flatnonzero((model.nodes.ids[model.dofs.node] == 23) & (model.dofs.component == 0))
    compliance = S[tip] @ np.linalg.pinv(S.T @ model.K.toarray() @ S, hermitian=True) @ S[tip].T
    E, G, A = 2.1e11, 2.1e11 / 2.6, 0.05 * 0.03
    bent, sheared = 0.8**3 / (3 * E * 0.03 * 0.05**3 / 12), 0.8 / (5 / 6 * G * A)
    assert compliance[0, 0] == pytest.approx(bent + sheared, rel=1e-9)


@needs_mystran
@pytest.mark.parametrize("kind", ["tet10", "hex8", "hex20"])
def test_bulk_data_that_are_written_have_the_matrices_of_mystran(kind, tmp_path):
    mesh = box(kind, (2, 1, 1), (0.5, 0.25, 0.125))
    (tmp_path / "first.bdf").write_text("BEGIN BULK\n" + MAT1 + nastran_mesh(mesh, "large") + "ENDDATA\n")
    read(tmp_path / "first.bdf").write(tmp_path / "second.bdf", "nastran")
    first, second = (model_of(import_file(tmp_path / f"{name}.bdf", engine="mystran")) for name in ("first", "second"))
    assert_same(first, second, 1e-9)


@pytest.mark.parametrize("bulk", [bulk for bulk, _ in (*BULK.values(), *PROPERTIES) if "CBUSH" not in bulk])
def test_shells_and_bars_of_bulk_data_come_back(bulk, again):
    options = {} if "7850." in bulk else {"density": 7850.0}
    first, second, _ = again(f"BEGIN BULK\n{bulk}ENDDATA\n", "nastran", "nastran", **options)
    for own, other in zip(first.elements, second.elements, strict=True):
        assert (own.kind, own.shape) == (other.kind, other.shape) and np.array_equal(own.nodes, other.nodes)
        assert set(own.values) == set(other.values)
        for name, value in own.values.items():
            assert np.allclose(value, other.values[name], rtol=1e-10, atol=1e-12, equal_nan=True), name
        assert np.array_equal(own.ids, other.ids)
        for label in own.ids.tolist():
            before, after = (_section_of(deck, label, own.kind) for deck in (first, second))
            numbers = [[x.thickness, x.offset, x.nonstructural, *x.dimensions] for x in (before, after)]
            assert np.allclose(*numbers, rtol=1e-10), before.code
            assert (before.profile, before.shear_factors) == (after.profile, after.shear_factors)
            for x in ("thickness", "angle"):
                assert [getattr(ply, x) for ply in before.plies] == [getattr(ply, x) for ply in after.plies]
            constants = [_constants(deck, section) for deck, section in ((first, before), (second, after))]
            assert constants[0] == constants[1]
    assert not any(section.lacks for section in second.sections)


def _section_of(deck: Deck, label: int, kind: str) -> Section:
    """The section of an element."""
    at = np.array([label])
    return next(own for own in deck.sections if own.kind == kind and in_ranges(at, deck.element_sets[own.set])[0])


def _constants(deck: Deck, section: Section) -> list[object]:
    """Constants and densities of all materials of a section, and the ratios of a plate."""
    plate = section.plate
    names = [plate.membrane, plate.bending, plate.shear] if plate else [section.material]
    names = [ply.material for ply in section.plies] or names
    ratios = [plate.inertia_ratio, plate.shear_ratio] if plate else []
    densities = [deck.materials[name].density or 7850.0 for name in names[:1]]
    return [[dict(deck.materials[name].constants) if name else None for name in names], densities, ratios]


@pytest.mark.parametrize(
    ("text", "source", "format", "message"),
    [
        (deck_text("C3D8"), "abaqus", "ansys", ("unknown", "format", "ansys")),
        (
            "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n*ELEMENT,TYPE=S4,ELSET=A\n1,1,2,3,4\n",
            "abaqus",
            "nastran",
            ("unsupported", "", "S4"),
        ),
        (WHOLE, "abaqus", "nastran", ("unsupported", "", "AXIAL", "2991")),
        (FULL, "nastran", "calculix", ("unsupported", "", "CONM2_9")),
        (
            FULL.replace(".1     0.2     0.3", ".0     0.0     0.0"),
            "nastran",
            "calculix",
            ("unsupported", "", "CONM2_9"),
        ),
    ],
)
def test_what_a_format_cannot_say_is_refused_and_the_old_file_stays(text, source, format, message, tmp_path):
    (tmp_path / f"first.{ENDINGS[source]}").write_text(text)
    target = tmp_path / "second.inp"
    target.write_text("old")
    with refusal(*message):
        read(tmp_path / f"first.{ENDINGS[source]}").write(target, format)
    assert target.read_text() == "old"


SPRING = "CELAS2,901,5.+4,1,4,35,4\n"
ROUND = grids(FRAME) + "".join(f"CBAR,{i},1,{i},{i + 1},0.,1.,.2\n" for i in range(1, 6)) + MAT1.split("\n", 1)[1]


@pytest.mark.parametrize(
    ("bulk", "message", "line"),
    [
        (MIXED.split("CBAR")[0].replace(",.1,,.2,,,.3\n", ""), ("unsupported",), "*RIGID BODY, TIE NSET="),
        (SHEET + SPRING, ("unsupported",), "*SPRING"),
        (f"{ROUND}PBARL,1,1,,ROD\n,.03\n", ("unsupported", "", "CIRC"), "SECTION=CIRC"),
        (f"{ROUND}PBARL,1,1,,TUBE\n,.03,.02\n", ("unsupported", "", "PIPE"), "SECTION=PIPE"),
    ],
    ids=["rotations that are tied", "springs on rotations", "rods", "tubes"],
)
def test_what_calculix_would_lose_of_bulk_data_is_refused_and_written_for_abaqus(bulk, message, line, tmp_path):
    (tmp_path / "first.bdf").write_text(f"BEGIN BULK\n{bulk}ENDDATA\n")
    deck = read_deck(tmp_path / "first.bdf")
    with refusal(*message):
        deck.write(tmp_path / "flat.inp", "calculix")
    assert not (tmp_path / "flat.inp").exists()
    deck.write(tmp_path / "flat.inp", "abaqus")
    assert line in (tmp_path / "flat.inp").read_text()


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
def test_materials_along_axes_of_elements_are_refused_by_every_writer(format, tmp_path):
    constants = "".join(f"MP,{name},1,{value}\n" for name, value in (("EY", 1e11), ("EZ", 1e11), ("GXY", 4e10)))
    (tmp_path / "a.cdb").write_text(f"{ansys_elements(SHEET, 181, 'CQUAD4')}{constants}R,1,.01\nFINISH\n")
    with refusal("unsupported", "orientation"):
        read_deck(tmp_path / "a.cdb").write(tmp_path / "flat", format)


@pytest.mark.parametrize(("routine", "value"), [(63, 1), (181, 1), (181, 2), (281, 1)])
def test_shells_that_are_membranes_by_a_key_option_are_refused(routine, value, tmp_path):
    text = ansys_elements(SHEET, routine, "CQUAD4").replace("TYPE,1\n", f"KEYOPT,1,1,{value}\nTYPE,1\n")
    (tmp_path / "a.cdb").write_text(text + "R,1,.01\nFINISH\n")
    with refusal("unsupported", f"SHELL{routine}", "a.cdb", "KEYOPT(1)", f"{value},"):
        read_deck(tmp_path / "a.cdb").write(tmp_path / "flat.bdf", "nastran")


@pytest.mark.parametrize("format", ["calculix", "abaqus"])
@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (",,.3,", ",4.+10,.3,", "whose G = 4e+10 does not fit E and NU; {} takes G = 8.07692e+10"),
        ("1,,1\n", "1,,1,.5\n", "has a transverse shear stiffness of its own (of bulk data MID3 and TS/T), which {}"),
        ("1,,1\n", "1\n", "has a transverse shear stiffness of its own (of bulk data MID3 and TS/T), which {}"),
    ],
    ids=["G", "TS/T", "MID3"],
)
def test_what_shells_of_bulk_data_have_beyond_a_plate_is_told(old, new, sentence, format, again):
    said = " ".join(again(f"BEGIN BULK\n{SHEET.replace(old, new)}ENDDATA\n", "nastran", format)[2])
    assert sentence.format({"calculix": "CalculiX", "abaqus": "Abaqus"}[format]) in said
    plain = " ".join(again(f"BEGIN BULK\n{SHEET}ENDDATA\n", "nastran", format)[2])
    assert "does not fit" not in plain and "transverse shear" not in plain


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
@pytest.mark.parametrize(
    ("card", "keyword"),
    [
        ("*CONTACT PAIR, INTERACTION=I\nSB, SA\n", "CONTACT PAIR"),
        ("*PRE-TENSION SECTION, SURFACE=SA, NODE=18\n", "PRE-TENSION SECTION"),
        ("*ELEMENT, TYPE=CONN3D2\n9, 1, 11\n*ELEMENT, TYPE=S4\n8, 1, 2, 3, 4\n", "ELEMENT"),
    ],
)
def test_what_keeps_a_deck_from_becoming_a_model_keeps_it_from_being_written(card, keyword, format, tmp_path):
    (tmp_path / "first.inp").write_text(GLUED.replace("*TIE", f"{card}*TIE"))
    with pytest.raises(DeckError) as caught:
        read_deck(tmp_path / "first.inp").write(tmp_path / "second", format)
    assert keyword in [problem.keyword for problem in caught.value.problems]
    assert not (tmp_path / "second").exists()


def test_a_deck_is_not_written_over_the_files_that_it_came_from(tmp_path):
    text = deck_text("C3D8")
    nodes, rest = text[: text.index("*ELEMENT")], text[text.index("*ELEMENT") :]
    (tmp_path / "nodes.inc").write_text(nodes)
    (tmp_path / "first.inp").write_text(f"*INCLUDE, INPUT=nodes.inc\n{rest}")
    (tmp_path / "link.inp").symlink_to(tmp_path / "first.inp")
    (tmp_path / "other.inp").write_text("old")
    deck = read_deck(tmp_path / "first.inp")
    for name in ("first.inp", "nodes.inc", "link.inp"):
        with refusal("output", "out", by=OverwriteError):
            deck.write(tmp_path / name, "nastran")
    assert (tmp_path / "nodes.inc").read_text() == nodes and (tmp_path / "first.inp").read_text().endswith(rest)
    deck.write(tmp_path / "other.inp", "calculix")
    assert read_deck(tmp_path / "other.inp").to_model().size == deck.to_model().size


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
@pytest.mark.parametrize("given", [7850.0, {"body": 7850.0}])
def test_the_density_that_was_given_with_a_deck_is_written(given, format, again):
    bare = deck_text("C3D8I").replace("*DENSITY\n7850.\n", "")
    assert bare != deck_text("C3D8I")
    first, second, said = again(bare, "abaqus", format, density=given)
    assert "the material STEEL of the set BODY has no *DENSITY; 7850 was given and taken [density-given]" in said
    masses = []
    for model in (first.to_model(), second.to_model()):
        along = (model.dofs.component == 0).astype(float)
        masses.append(along @ model.M @ along)
    assert masses[1] == pytest.approx(masses[0], rel=1e-10)


@pytest.mark.parametrize(("given", "expected"), [(3.0, [3.0, 3.0]), ({"A": 5.0, "all": 3.0}, [5.0, 3.0])])
def test_the_density_that_was_given_is_that_of_shells_too(given, expected, tmp_path):
    (tmp_path / "first.inp").write_text(
        "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,2,0,0\n6,2,1,0\n*ELEMENT,TYPE=S4,ELSET=A\n1,1,2,3,4\n"
        "*ELEMENT,TYPE=S4,ELSET=B\n2,2,5,6,3\n*MATERIAL,NAME=STEEL\n*ELASTIC\n2.1e11,.3\n"
        "*SHELL SECTION,ELSET=A,MATERIAL=STEEL\n.1\n*SHELL SECTION,ELSET=B,MATERIAL=STEEL\n.2\n"
    )
    read_deck(tmp_path / "first.inp", density=given).write(tmp_path / "second.inp", "calculix")
    second = read_deck(tmp_path / "second.inp")
    assert [second.materials[section.material].density for section in second.sections] == expected


def test_a_density_of_a_set_that_is_not_lacking_is_refused_by_the_writer(tmp_path):
    (tmp_path / "first.inp").write_text(deck_text("C3D8"))
    with refusal("unknown", "density", "BODY"):
        read_deck(tmp_path / "first.inp", density={"BODY": 1.0}).write(tmp_path / "second.inp", "calculix")


@pytest.mark.parametrize("format", ["calculix", "abaqus", "nastran"])
def test_elements_in_no_section_are_told(format, again):
    text = deck_text("C3D8I")
    said = again(text[: text.index("*MATERIAL")], "abaqus", format)[2]
    assert "2 elements are in no section, so have no material" in said
    assert not [sentence for sentence in said if "no material:" in sentence]
    assert "2 elements are in no section, so have no material" not in again(text, "abaqus", format)[2]


@pytest.mark.parametrize("value", [-1.2345678901234567e-5, 1.2345678901234567e-120, -9.876543210987654e17, 0.1, -1 / 3])
def test_numbers_have_the_digits_that_calculix_reads(value: float) -> None:
    text = numeral(value)
    assert len(text) == 20 or (len(text) < 20 and text == repr(value))
    assert float(text) == pytest.approx(value, rel=1e-13, abs=0.0)
