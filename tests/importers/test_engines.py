"""Decks that CalculiX assembles: its matrices on the right nodes, and its own frequencies."""

from __future__ import annotations

import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import morembs
from morembs import InputError
from morembs.app.cli import app
from morembs.fem import FEModel, rigid_motion
from morembs.fem.elements import TYPES
from morembs.fem.material import isotropic, orthotropic
from morembs.importers import import_file
from morembs.importers.abaqus.cards.read import contents_for_calculix
from morembs.importers.decks.flat import Choices
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import deck_options
from morembs.importers.decks.problems import DeckError
from morembs.importers.decks.tables import ElasticMaterial, Elements, Section
from morembs.importers.decks.writers.calculix_mesh import FACES
from morembs.importers.engines.calculix.importer import assemble_with_calculix, readable_by_calculix
from morembs.importers.engines.calculix.other_decks import flat_deck
from morembs.importers.engines.calculix.program import find_ccx
from morembs.importers.for_calculix import read_for_calculix
from morembs.importers.model_file import read_model
from morembs.importers.to_model import model_of
from morembs.problem import Problem
from tests.importers.test_unv import universal
from tests.support import calculix
from tests.support.calculix import (
    STEEL,
    eigenvalues,
    independent,
    needs_ccx,
    on_plane,
    own_frequencies,
    program,
    solids,
)
from tests.support.decks import refusals
from tests.support.mesh_decks import ansys_archive, nastran_mesh
from tests.support.meshes import box
from tests.support.refusals import refusal

PLATE = (
    "*NODE\n1,0,0,0\n2,1,0,0\n3,2,0,0\n4,0,1,0\n5,1,1,0\n6,2,1,0\n7,0,2,0\n8,1,2,0\n9,2,2,0\n10,2.5,1,0.5\n"
    "*ELEMENT,TYPE=S4,ELSET=E\n1,1,2,5,4\n2,2,3,6,5\n3,4,5,8,7\n4,5,6,9,8\n*NSET,NSET=EDGE\n3,6,9\n"
    f"{STEEL}*SHELL SECTION,ELSET=E,MATERIAL=STEEL\n0.05\n*RIGID BODY,NSET=EDGE,REF NODE=10\n"
)
TIED = (
    "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,0,0,1\n6,1,0,1\n7,1,1,1\n8,0,1,1\n11,.1,.1,1\n12,.6,.1,1\n"
    "13,.6,.6,1\n14,.1,.6,1\n15,.1,.1,2\n16,.6,.1,2\n17,.6,.6,2\n18,.1,.6,2\n30,0,0,-1\n"
    "*ELEMENT,TYPE=C3D8,ELSET=A\n1,1,2,3,4,5,6,7,8\n*ELEMENT,TYPE=C3D8,ELSET=B\n2,11,12,13,14,15,16,17,18\n"
    "*SURFACE,NAME=SA\nA\n*SURFACE,NAME=SB\nB,S1\n*NSET,NSET=BOT\n1,2,3,4\n"
    f"{STEEL}*SOLID SECTION,ELSET=A,MATERIAL=STEEL\n*SOLID SECTION,ELSET=B,MATERIAL=STEEL\n"
    "*TIE,NAME=T,POSITION TOLERANCE=0.1\nSB,SA\n*RIGID BODY,NSET=BOT,REF NODE=30\n"
)
SHELL = (
    "*NODE\n1,0,0,1\n2,1,0,1\n3,1,1,1\n4,0,1,1\n*ELEMENT,TYPE=S4R,ELSET=E\n1,1,2,3,4\n"
    f"{STEEL}*SHELL SECTION,ELSET=E,MATERIAL=STEEL\n.01\n"
)
LINE = "*NODE\n1,0,0,0\n2,.5,0,0\n3,1,0,0\n4,1.5,0,0\n5,2,0,0\n"
BEAM = (
    f"{LINE}*ELEMENT,TYPE=B32,ELSET=E\n1,1,2,3\n2,3,4,5\n{STEEL}"
    "*BEAM SECTION,ELSET=E,MATERIAL=STEEL,SECTION=RECT{}\n.1,.2\n0,0,1\n"
)


def imported(tmp_path: Path, deck: str, **options: object) -> FEModel:
    path = tmp_path / "deck.inp"
    path.write_text(deck)
    executable = options.pop("executable", "")
    return model_of(import_file(path, options=options, engine=f"calculix:{executable}"))


def of_rigid_motion(model: FEModel) -> np.ndarray:
    return rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)


def mass(model: FEModel) -> np.ndarray:
    R = of_rigid_motion(model)[:, :3]
    return R.T @ (model.M @ R)


def assert_free(model: FEModel, kg: float, strain: float = 1e-12) -> None:
    """Rigid motion is followed and strains nothing, and the mass is ``kg``."""
    R = of_rigid_motion(model)
    assert np.abs(model.K @ R).max() < strain * np.abs(model.K.data).max() * np.abs(R).max()
    if model.dependent is not None:
        assert np.abs(model.dependent.S @ R - R).max() < 1e-12 * np.abs(R).max()
    assert mass(model) == pytest.approx(kg * np.eye(3), rel=1e-10, abs=1e-10 * kg)


@pytest.fixture(params=["stored", pytest.param("ccx", marks=needs_ccx)])
def run(request, tmp_path):
    """Imports a deck by what ccx wrote for it once, and by ccx itself."""
    stored = request.param == "stored"
    return lambda name, deck: imported(tmp_path, deck, executable=calculix.replay(tmp_path, name) if stored else "")


def test_expanded_shells_and_a_rigid_body_are_on_their_places(run):
    model = run("plate", PLATE)
    assert_free(model, 0.05 * 4 * 7850)
    # Two nodes for each of those that follow nothing, one for those of the edge, three modes for each element.
    assert model.size == 2 * 3 * 6 + 3 * 3 + 9 * 4 + 6
    assert not any("left out" in note for note in model.notes)
    edge = model.nodes.xyz[model.nodes.sets["EDGE"]]
    assert np.abs(edge[:, 2]) == pytest.approx(0.025, abs=1e-15) and sorted(edge[:, 1]) == [0, 1, 2]
    turns = model.dofs.node[model.dofs.turning]
    assert model.nodes.ids[turns].tolist() == [10, 10, 10]


def test_ties_and_rigid_bodies_are_read_off_by_springs(run):
    model = run("tied", TIED)
    assert_free(model, 1.25 * 7850)
    (follows,) = model.equations
    at = np.flatnonzero((model.nodes.ids[follows.nodes] == 11) & (follows.components == 0))[0]
    terms = slice(follows.offsets[at], follows.offsets[at + 1])
    weights = dict(zip(model.nodes.ids[follows.term_nodes[terms]].tolist(), follows.coefficients[terms], strict=True))
    assert weights == pytest.approx({5: 0.81, 6: 0.09, 7: 0.01, 8: 0.09}, abs=1e-14)


@needs_ccx
@pytest.mark.parametrize(
    ("deck", "kg"),
    [
        (BEAM.format(""), 314.0),
        (BEAM.format(",OFFSET1=.5"), 314.0),
        (
            f"{LINE}*ELEMENT,TYPE=B31,ELSET=E\n1,1,3\n2,3,5\n{STEEL}*BEAM SECTION,ELSET=E,MATERIAL=STEEL,SECTION=RECT\n"
            ".1,.2\n0,0,1\n",
            314.0,
        ),
        (
            "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=T3D2,ELSET=E\n1,1,2\n2,1,3\n3,1,4\n4,2,3\n5,3,4\n6,2,4\n"
            f"{STEEL}*SOLID SECTION,ELSET=E,MATERIAL=STEEL\n.01\n",
            7850 * 0.01 * (3 + 3 * 2**0.5),
        ),
        # Shells at a right angle have knots on the edge that they share.
        (
            "*NODE\n1,0,0,0\n2,1,0,0\n3,1,1,0\n4,0,1,0\n5,1,0,1\n6,1,1,1\n*ELEMENT,TYPE=S4,ELSET=E\n1,1,2,3,4\n2,2,5,6,3\n"
            f"{STEEL}*SHELL SECTION,ELSET=E,MATERIAL=STEEL\n.02\n",
            2 * 0.02 * 7850,
        ),
        # A mass on a distributing coupling, and springs to it.
        (
            solids("C3D8R", (3, 1, 1), (3.0, 1.0, 1.0)) + "*NODE\n99,3.5,.5,.5\n*ELEMENT,TYPE=MASS,ELSET=P\n99,99\n"
            "*MASS,ELSET=P\n70.\n*SURFACE,NAME=END\nBODY\n*COUPLING,REF NODE=99,SURFACE=END,CONSTRAINT NAME=C\n"
            "*DISTRIBUTING\n1,6\n",
            3 * 7850 + 70.0,
        ),
        (
            solids("C3D20R", (2, 1, 1), (2.0, 1.0, 1.0)) + "*NODE\n99,3,.5,.5\n*SURFACE,NAME=S,TYPE=NODE\n2\n3\n5\n"
            "*COUPLING,REF NODE=99,SURFACE=S,CONSTRAINT NAME=C\n*KINEMATIC\n1,3\n",
            2 * 7850,
        ),
        # Nodes 1 to 4 of the block are its end at x = 0.
        (
            solids("C3D8", (3, 1, 1), (3.0, 1.0, 1.0))
            + "*NODE\n99,-1,.5,.5\n*MPC\n"
            + "".join(f"BEAM,{node},99\n" for node in (1, 2, 3, 4)),
            3 * 7850,
        ),
        (
            solids("C3D8", (3, 1, 1), (3.0, 1.0, 1.0))
            + "*NODE\n99,0,0,0\n*ELEMENT,TYPE=MASS,ELSET=P\n99,99\n*MASS,ELSET=P\n"
            "70.\n*MPC\nPIN,99,1\n",
            3 * 7850 + 70.0,
        ),
        (SHELL.replace("S4R", "M3D4R").replace("SHELL", "MEMBRANE"), 0.01 * 7850),
        (
            SHELL + "*NODE\n99,.5,.5,2\n*SURFACE,NAME=S\nE,SPOS\n*COUPLING,REF NODE=99,SURFACE=S,CONSTRAINT NAME=C\n"
            "*KINEMATIC\n",
            0.01 * 7850,
        ),
        (
            SHELL + "*NODE\n99,.5,.5,2\n*SURFACE,NAME=S,TYPE=NODE\n1\n2\n3\n4\n*COUPLING,REF NODE=99,SURFACE=S,"
            "CONSTRAINT NAME=C\n*DISTRIBUTING\n1,6\n",
            0.01 * 7850,
        ),
        (TIED.replace("2,11,12,13,14,15,16,17,18", "2,15,16,17,18,11,12,13,14").replace("B,S1", "B,S2"), 1.25 * 7850),
    ],
    ids=[
        "B32",
        "B32 with knots",
        "B31",
        "trusses",
        "S4 with knots",
        "distributing",
        "kinematic",
        "MPC BEAM",
        "MPC PIN",
        "membrane",
        "kinematic shell",
        "distributing shell",
        "left-handed",
    ],
)
def test_kinds_of_decks_have_free_rigid_motion_and_their_mass(tmp_path, deck, kg):
    assert_free(imported(tmp_path, deck), kg)


@needs_ccx
@pytest.mark.parametrize("section", ["PIPE\n.1,.02", "BOX\n.1,.2,.01,.01,.01,.01"])
def test_hollow_beams_are_of_the_type_that_has_their_profile(section, tmp_path):
    """ccx stops at B32 with these profiles, which B32R has; its pipe has eight corners in the middle of its wall."""
    read = imported(tmp_path, BEAM.format("").replace("RECT\n.1,.2", section))
    area = np.pi * (0.1**2 - 0.08**2) if "PIPE" in section else 0.1 * 0.2 - 0.08 * 0.18
    assert mass(read)[0, 0] == pytest.approx(7850 * 2 * area, rel=0.03)
    assert "2 elements B32 are assembled as B32R [hybrid-as-plain]" in read.warnings


@needs_ccx
def test_instances_are_placed_and_matrices_are_those_of_own_assembly(tmp_path):
    text = solids("C3D20", (2, 1, 1), (2.0, 1.0, 1.0))
    mesh, rest = text.split("*MATERIAL")
    material, section = rest.split("*SOLID")
    deck = (
        f"*PART,NAME=P\n{mesh}*SOLID{section}*END PART\n*ASSEMBLY,NAME=A\n*INSTANCE,NAME=I,PART=P\n*END INSTANCE\n"
        "*INSTANCE,NAME=J,PART=P\n0,0,3\n0,0,0,1,0,0,30\n*END INSTANCE\n*NSET,NSET=ALL\nI.5,J.5\n*END ASSEMBLY\n"
        f"*MATERIAL{material}"
    )
    model = imported(tmp_path, deck)
    own = model_of(import_file(tmp_path / "deck.inp", options={"dialect": "calculix"}))
    assert np.array_equal(model.nodes.ids, own.nodes.ids) and np.array_equal(model.dofs.node, own.dofs.node)
    for ours, theirs in ((own.K, model.K), (own.M, model.M)):
        assert np.abs((ours - theirs).data).max() < 2e-13 * np.abs(theirs.data).max()
    assert {name: rows.tolist() for name, rows in model.nodes.sets.items()} == {
        name: rows.tolist() for name, rows in own.nodes.sets.items()
    }


def wavy_pair(kind: str, ties: int, tolerance: str) -> str:
    """A wavy plate with tetrahedra on and beyond it, which one or two ties give to its top."""
    rng, mesh = np.random.default_rng(5), box(kind, (3, 2, 1), (1.0, 0.8, 0.3))
    xyz, flat = mesh.nodes.xyz.copy(), mesh.nodes.xyz[:, 2] > 0.2999

    def height(x: np.ndarray) -> np.ndarray:
        return 0.05 * np.sin(3 * x[:, 0]) * np.cos(4 * x[:, 1])

    xyz[:, 2] += height(xyz)
    feet = np.column_stack([rng.uniform(-0.08, 1.08, 40), rng.uniform(-0.08, 0.88, 40), np.full(40, 0.3)])
    feet[:, 2] += height(feet) + rng.choice([0.0, 0.01], 40)
    tets = feet[:, None] + np.array([[0.0, 0, 0], [0.1, 0, 0.3], [0, 0.1, 0.3], [0, 0, 0.4]])
    first, count, rows = len(xyz) + 1, len(mesh.blocks[0].nodes), mesh.blocks[0].nodes
    top = [
        f"{i + 1}, S{side + 1}"
        for i, nodes in enumerate(rows)
        for side, corners in enumerate(FACES[kind[0]])
        if flat[nodes[list(corners)]].all()
    ]
    sets = "".join(
        f"*NSET, NSET=N{k}\n"
        + "".join(f"{first + 4 * i}\n" for i in range(k, 40, ties))
        + f"*SURFACE, NAME=S{k}, TYPE=NODE\nN{k}\n*TIE, NAME=T{k}{tolerance}\nS{k}, TOP\n"
        for k in range(ties)
    )
    return (
        calculix.nodes_text(np.concatenate([xyz, tets.reshape(-1, 3)]))
        + calculix.elements_text(CODES[kind], rows, "A")
        + calculix.elements_text("C3D4", np.arange(160).reshape(40, 4), "B", first=first, label=count + 1)
        + "*SURFACE, NAME=TOP\n"
        + "\n".join(top)
        + f"\n{sets}{STEEL}*SOLID SECTION, ELSET=A, MATERIAL=STEEL\n"
        "*SOLID SECTION, ELSET=B, MATERIAL=STEEL\n"
    )


CODES = {"hex8": "C3D8", "hex20": "C3D20", "tet4": "C3D4", "tet10": "C3D10", "wedge6": "C3D6", "wedge15": "C3D15"}


@needs_ccx
@pytest.mark.parametrize(
    ("kind", "ties", "tolerance"),
    [*((kind, 2, 0.05) for kind in CODES), *itertools.product(("hex20", "tet4"), (1,), ("", 0.05))],
)
def test_the_nodes_that_ccx_ties_are_tied_with_its_weights(kind, ties, tolerance, tmp_path):
    """Where two ties name one master, ccx ties what is beyond its border too."""
    option = f", POSITION TOLERANCE={tolerance}" if tolerance else ""
    theirs = imported(tmp_path, wavy_pair(kind, ties, option)).dependent
    own = model_of(import_file(tmp_path / "deck.inp", options={"dialect": "calculix"})).dependent
    assert np.array_equal(np.flatnonzero(own.owner >= 0), np.flatnonzero(theirs.owner >= 0))
    assert 10 < (own.owner >= 0).sum() < (110 if ties == 1 else 121)
    assert abs(own.S - theirs.S).max() < 1e-6


@needs_ccx
@pytest.mark.parametrize(
    "table", ["3.,-1.\n5.,0.\n9.,1.\n", "-8.,-2.\n0.,0.\n5.,1.\n", "1.,-3.\n5.,-2.\n", "7.,1.\n8.,2.\n"]
)
def test_springs_with_a_force_at_zero_elongation_are_those_of_ccx(table, tmp_path):
    soft = "*MATERIAL, NAME=STEEL\n*ELASTIC\n100., 0.3\n*DENSITY\n1.\n"
    text = TIED.split("*TIE")[0].replace(STEEL, soft)
    text += f"*ELEMENT,TYPE=SPRINGA,ELSET=AX\n5,7,15\n*SPRING,ELSET=AX,NONLINEAR\n\n{table}"
    theirs = imported(tmp_path, text)
    own = model_of(import_file(tmp_path / "deck.inp", options={"dialect": "calculix"}))
    assert np.array_equal(own.nodes.ids, theirs.nodes.ids)
    assert abs(own.K - theirs.K).max() < 1e-11


@needs_ccx
def test_incompatible_modes_keep_their_mass_and_the_frequencies_of_ccx(tmp_path):
    deck = solids("C3D8I", (10, 1, 1), (10.0, 1.0, 1.0))
    held = deck + "*BOUNDARY\n" + "".join(f"{node},1,3\n" for node in on_plane(deck, 0, 0.0))
    assert eigenvalues(imported(tmp_path, held, boundary="keep")) == pytest.approx(
        own_frequencies(held, tmp_path), rel=1e-6
    )
    free = imported(tmp_path, held)
    assert_free(free, 10 * 7850)
    assert (free.dofs.component == 6).sum() == 90


@needs_ccx
@pytest.mark.parametrize("n", [(4, 2, 2), (6, 3, 2)])
def test_fourteen_digits_of_ccx_are_no_support(n, tmp_path):
    """In regular meshes most rows of rigid motion cancel exactly, so that the others are no few digits of all."""
    free = imported(tmp_path, solids("C3D8I", n, tuple(map(float, n))))
    with Problem(free, []) as problem:
        assert problem.rigid.shape[1] == 6


@needs_ccx
def test_a_preload_stiffens_as_ccx_says(tmp_path):
    deck = solids("C3D20", (6, 1, 1), (6.0, 0.2, 0.1))
    deck += "*BOUNDARY\n" + "".join(f"{node},1,3\n" for node in on_plane(deck, 0, 0.0))
    load = "".join(f"{node},1,2e5\n" for node in on_plane(deck, 0, 6.0))
    step = f"*STEP\n*STATIC\n*CLOAD\n{load}*END STEP\n"
    plain = eigenvalues(imported(tmp_path, deck + step, boundary="keep"))
    pulled = eigenvalues(imported(tmp_path, deck + step, boundary="keep", preload=1))
    assert pulled == pytest.approx(own_frequencies(deck, tmp_path, before=step), rel=1e-6)
    assert pulled[0] > 1.05 * plain[0]


def flat_text(tmp_path: Path, deck: str, *materials: object, skip: str = "") -> str:
    """What CalculiX reads of a deck with the materials that were given."""
    (tmp_path / "deck.inp").write_text(deck)
    read = read_for_calculix(tmp_path / "deck.inp", "abaqus", deck_options(None, "refuse", skip))
    assert read.cards is not None
    return read.cards(Choices(materials=materials)).text("", "")


@needs_ccx
@pytest.mark.parametrize(
    ("change", "sets"),
    [
        (("*SOLID SECTION,ELSET=A,MATERIAL=STEEL\n", ""), ("A",)),
        (("*SOLID SECTION,ELSET=A,MATERIAL=STEEL\n", ""), ("all",)),
        (("*SOLID SECTION,ELSET=A,MATERIAL=STEEL", "*SOLID SECTION,ELSET=A,MATERIAL=GONE"), ("a",)),
        ((STEEL, "*MATERIAL,NAME=STEEL\n*PLASTIC\n1.,0.\n"), ("B", "all")),
        (("*NODE\n", "*NODE\n"), ()),
    ],
    ids=["no section", "of all", "no material", "not elastic", "none"],
)
def test_materials_that_are_given_take_the_place_of_those_that_lack(tmp_path, change, sets):
    given = [isotropic(set=name, young=2.1e11, poisson=0.3, density=7850.0) for name in sets]
    wanted, _ = calculix.stored_matrices(flat_text(tmp_path, TIED), tmp_path)
    read, said = calculix.stored_matrices(flat_text(tmp_path, TIED.replace(*change), *given), tmp_path)
    assert read is not None, said[-500:]
    for theirs, own in ((wanted.K, read.K), (wanted.M, read.M)):
        assert abs(theirs - own).max() < 1e-14 * abs(theirs).max()


@needs_ccx
def test_a_material_of_any_kind_is_written_for_ccx(tmp_path):
    """Engineering constants of the deck and the stiffness that own assembly makes of them."""
    axes = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    young, poisson, shear = (140e9, 10e9, 8e9), (0.3, 0.25, 0.4), (5e9, 4e9, 3.5e9)
    body = solids("C3D8", (1, 1, 1), (1.0, 0.8, 0.5)).split("*MATERIAL")[0]
    constants = f"{','.join(map(str, (*young, *poisson, *shear[:2])))}\n{shear[2]}\n"
    deck = f"{body}*ORIENTATION,NAME=O\n.6,.8,0,-.8,.6,0\n*MATERIAL,NAME=P\n*ELASTIC,TYPE=ENGINEERING CONSTANTS\n"
    deck += f"{constants}*DENSITY\n1600.\n*SOLID SECTION,ELSET=BODY,MATERIAL=P,ORIENTATION=O\n"
    wanted, _ = calculix.stored_matrices(flat_text(tmp_path, deck), tmp_path)
    ply = orthotropic(set="BODY", young=young, poisson=poisson, shear=shear, density=1600.0, axes=axes)
    read, _ = calculix.stored_matrices(flat_text(tmp_path, body, ply), tmp_path)
    assert abs(wanted.K - read.K).max() < 1e-11 * abs(wanted.K).max()


@pytest.mark.parametrize(
    ("lines", "sets", "message"),
    [
        ("", ("all",), ("value", "", "--material", "all")),
        ("", ("A",), ("value", "", "--material", "A")),
        ("", ("AB",), ("unknown", "", "--material", "AB", "deck.inp")),
        ("*NODE\n41,0,0,9\n*ELEMENT,TYPE=C3D4,ELSET=N\n9,1,2,3,41\n", (), ("missing", "MATERIAL", "9", "--material")),
        ("*SOLID SECTION,ELSET=A,MATERIAL=IRON\n", (), ("missing", "MATERIAL", "IRON", "--material")),
    ],
)
def test_what_lacks_a_material_is_told_before_a_run(tmp_path, lines, sets, message):
    given = [isotropic(set=name, young=1.0, poisson=0.3, density=1.0) for name in sets]
    with refusal(*message):
        flat_text(tmp_path, TIED + lines, *given)


def test_a_material_takes_the_place_of_one_without_density(tmp_path):
    """As own assembly has it: the stiffness of the deck goes, too."""
    bare = TIED.replace("*DENSITY\n7850.\n", "")
    with pytest.raises(DeckError) as told:
        flat_text(tmp_path, bare)
    assert [problem.flags for problem in told.value.problems] == [("--density X",)] * 2
    for names in (("all",), ("A", "B")):
        given = [isotropic(set=name, young=7e10, poisson=0.3, density=2700.0) for name in names]
        text = flat_text(tmp_path, bare, *given)
        assert text.count("2700") == len(names) and "2.1e11" not in text


def test_the_cure_gives_no_element_two_materials(tmp_path):
    """Sets of the other elements, not all."""
    bare = TIED.replace("*SOLID SECTION,ELSET=A,MATERIAL=STEEL\n", "").replace(
        "*SOLID SECTION,ELSET=B,MATERIAL=STEEL\n", ""
    )
    steel = isotropic(set="A", young=2.1e11, poisson=0.3, density=7850.0)
    for given, sets in (((), "all"), ((steel,), "B")):
        with pytest.raises(DeckError) as told:
            flat_text(tmp_path, bare, *given)
        assert told.value.problems[0].flags == (f"--material young=..,poisson=..,density=..,set={sets}",)


def test_sections_of_elements_that_are_left_out_are_left_out(tmp_path):
    plane = "*ELEMENT,TYPE=CPS4,ELSET=Q\n9,1,2,3,4\n*SOLID SECTION,ELSET=Q,MATERIAL=GONE\n"
    mixed = "*ELSET,ELSET=M\nA,Q\n*BOUNDARY\n1,1\n*SOLID SECTION,ELSET=M,MATERIAL=STEEL\n"
    text = flat_text(tmp_path, TIED + plane + mixed, skip="CPS4")
    assert "GONE" not in text and "CPS4" not in text and text.count("*SOLID SECTION") == 3
    assert "\n1, 3," not in text.split("*ELEMENT")[-1]


@pytest.mark.parametrize(
    "end", ["*NODE\n99,9.,9.,9.\n", "*ELEMENT,TYPE=SPRING1,ELSET=S\n99,1\n*SPRING,ELSET=S\n1\n5.\n"]
)
def test_nothing_is_assembled_of_a_deck_without_elements(tmp_path, end):
    """No program is advised for it either."""
    path = tmp_path / "deck.inp"
    path.write_text(f"*NODE\n1,0.,0.,0.\n{end}")
    assert refusals(lambda: flat_text(tmp_path, path.read_text())) == [("ELEMENT", 0, ())]
    with pytest.raises(InputError) as told:
        morembs.import_model(path)
    assert "CalculiX" not in str(told.value)
    (tmp_path / "deck.bdf").write_text("BEGIN BULK\nGRID,1,,0.,0.,0.\nCONM2,2,1,,1.\nENDDATA\n")
    assert refusals(lambda: readable_by_calculix(tmp_path / "deck.bdf", format="nastran")) == [("ELEMENT", 0, ())]


def test_elements_that_are_left_out_are_cured_only_where_others_stay(tmp_path):
    plane = "*ELEMENT,TYPE=CPS4,ELSET=Q\n9,1,2,3,4\n"
    for text, flags in ((TIED + plane, ("--skip CPS4",)), (f"*NODE\n1,0,0\n2,1,0\n3,1,1\n4,0,1\n{plane}", ())):
        with pytest.raises(DeckError) as told:
            flat_text(tmp_path, text)
        assert told.value.problems[0].flags == flags and ("--skip" in str(told.value)) is bool(flags)


def test_elements_of_27_nodes_are_none_of_calculix(tmp_path):
    nodes = "".join(f"{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(TYPES["hex27"].reference.tolist(), start=1))
    order = list(range(1, 28))
    rows = f"1,{','.join(map(str, order[:15]))},\n{','.join(map(str, order[15:]))}\n"
    section = "*SOLID SECTION,ELSET=E,MATERIAL=STEEL\n"
    with refusal("unsupported", "ELEMENT", "C3D27", "27", by=DeckError) as told:
        flat_text(tmp_path, f"*NODE\n{nodes}*ELEMENT,TYPE=C3D27,ELSET=E\n{rows}{STEEL}{section}")
    assert len(told.value.problems) == 1 and not told.value.answer


def test_sets_that_name_what_is_not_there_are_told_before_calculix_runs(tmp_path):
    (tmp_path / "deck.inp").write_text(f"{TIED}*NSET,NSET=LOST\n29\n*HEAT FLOW\n")
    with refusal("unsupported", "HEAT FLOW", "*HEAT", "FLOW", by=DeckError) as told:
        readable_by_calculix(tmp_path / "deck.inp")
    assert "the set 'LOST' names the node 29, which is not defined" in told.value.problems[1].what


def test_steps_end_as_in_calculix(tmp_path):
    """The first load of the second step is not one of the first."""
    steps = "*END STEP\n*STEP\n*STATIC\n*CLOAD\n1,1,5.\n*STEP\n*STATIC\n*CLOAD\n2,1,5.\n"
    (tmp_path / "deck.inp").write_text(TIED + steps)
    deck = contents_for_calculix(tmp_path / "deck.inp", deck_options(None, "refuse", ""))
    assert [[card.keyword for card, _ in step] for step in deck.steps] == [["STEP", "STATIC", "CLOAD"]] * 2
    assert [step[-1][1].strip() for step in deck.steps] == [b"1,1,5.", b"2,1,5."]


@needs_ccx
def test_words_to_skip_that_are_nowhere_are_told_whoever_assembles(tmp_path):
    (tmp_path / "deck.inp").write_text(solids("C3D8", (1, 1, 1), (1.0, 1.0, 1.0)))
    mesh = nastran_mesh(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0)), "free")
    (tmp_path / "deck.bdf").write_text(f"BEGIN BULK\nPSOLID,1,1\nMAT1,1,2.1+11,,.3,7850.\n{mesh}ENDDATA\n")
    for name in ("deck.inp", "deck.bdf"):
        told = import_file(tmp_path / name, engine="calculix", options={"skip": "FOO"}).warnings
        assert "--skip 'FOO' leaves nothing out [skip-unused]" in told


@needs_ccx
def test_a_given_material_does_not_turn_with_the_orientation_of_its_section(tmp_path):
    """Its stiffness is along the global axes, as in own assembly."""
    axes = "*ORIENTATION,NAME=O\n0.,1.,0.,0.,0.,1.\n"
    deck = solids("C3D8", (1, 1, 1), (1.0, 0.8, 0.5)).replace("*DENSITY\n7850.\n", "")
    deck = deck.replace("MATERIAL=STEEL\n", "MATERIAL=STEEL,ORIENTATION=O\n").replace("*SOLID", f"{axes}*SOLID")
    (tmp_path / "deck.inp").write_text(deck)
    young, poisson, shear = (140e9, 10e9, 8e9), (0.3, 0.25, 0.4), (5e9, 4e9, 3.5e9)
    ply = orthotropic(set="BODY", young=young, poisson=poisson, shear=shear, density=1600.0, axes=np.eye(3))
    own, theirs = (import_file(tmp_path / "deck.inp", engine=name, materials=[ply]) for name in (None, "calculix"))
    K, read = model_of(own).K, model_of(theirs).K
    assert abs(read - K).max() < 1e-11 * abs(K).max()


OF_NASTRAN = (
    "BEGIN BULK\nPSOLID,1,1\nMAT1,1,2.1+11,,.3,7850.\n{}GRID,900,,1.5,.2,.1\nGRID,901,,-1.,.2,.1\n"
    "RBE2,70,900,123456,{},{},{},{}\nRBE3,71,,901,123456,1.,123,{},{}\n,{},{}\nCONM2,72,900,,12.,.1,,.2\n,1.,,2.,,,3.\n"
    "CELAS2,73,4.+5,901,1,900,1\nENDDATA\n"
)


@needs_ccx
@pytest.mark.parametrize("kind", ["tet10", "hex20", "hex8"])
def test_bulk_data_with_all_that_hangs_on_them_are_assembled_by_ccx(kind, tmp_path):
    """K, M of the same formulation as own assembly has them; masses, springs and averages of the own reader."""
    mesh = box(kind, (2, 1, 1), (1.0, 0.4, 0.2))
    ends = [mesh.nodes.ids[np.isclose(mesh.nodes.xyz[:, 0], x)][:4].tolist() for x in (1.0, 0.0)]
    (tmp_path / "deck.bdf").write_text(OF_NASTRAN.format(nastran_mesh(mesh, "free"), *ends[0], *ends[1]))
    theirs, own = (model_of(import_file(tmp_path / "deck.bdf", engine=engine)) for engine in ("calculix", None))
    R = of_rigid_motion(theirs)
    assert np.abs(theirs.K @ R).max() < 1e-11 * np.abs(theirs.K.data).max()
    assert mass(theirs) == pytest.approx((7850 * 0.08 + 12.0) * np.eye(3), rel=1e-9, abs=1e-6)
    assert {element.name for element in theirs.average} == {"RBE3_71"}
    if kind != "hex8":
        (K, M), (K_own, M_own) = (independent(model) for model in (theirs, own))
        assert np.array_equal(theirs.nodes.ids, own.nodes.ids)
        assert abs(K - K_own).max() < 1e-10 * abs(K_own).max()
        # The mass of C3D10 is integrated at four points.
        assert (abs(M - M_own).max() < 1e-10 * abs(M_own).max()) == (kind == "hex20")


@needs_ccx
@pytest.mark.parametrize("ends", [".bdf", ".inp"])
def test_ccx_takes_decks_by_their_tables_whoever_read_them(ends, tmp_path):
    """The matrices of the deck's own cards, on nodes and sets under the names of the deck."""
    mesh = box("hex20", (2, 1, 1), (1.0, 0.4, 0.2))
    corners = [mesh.nodes.ids[np.isclose(mesh.nodes.xyz[:, 0], x)][:4].tolist() for x in (1.0, 0.0)]
    (tmp_path / "deck.bdf").write_text(OF_NASTRAN.format(nastran_mesh(mesh, "free"), *corners[0], *corners[1]))
    (tmp_path / "deck.inp").write_text(TIED)
    path = tmp_path / f"deck{ends}"
    deck = morembs.read_deck(path)
    assert deck.cards is None
    own, read = assemble_with_calculix(deck, Choices(), program=find_ccx()), import_file(path, engine="calculix")
    assert own.source == path.name and set(deck.node_sets) <= set(own.nodes.sets)
    (K, M), (wanted_K, wanted_M) = (independent(model_of(given)) for given in (own, read))
    assert abs(K - wanted_K).max() < 1e-10 * abs(wanted_K).max()
    assert abs(M - wanted_M).max() < 1e-10 * abs(wanted_M).max()


def test_beams_of_three_nodes_and_thin_walls_are_b32r_for_ccx():
    """As CalculiX has pipes in these alone; others keep their type."""
    ids, line = np.arange(1, 6), np.array([[1, 3, 2], [3, 5, 4]])
    beams = Elements(code="BEAM189", kind="beam", shape="line3", ids=np.array([7, 8]), nodes=line)
    steel = ElasticMaterial(name="S", stiffness=isotropic(set="all", young=1.0, poisson=0.3, density=1.0).stiffness)
    common = {"kind": "beam", "material": "S", "direction": np.array([0.0, 1.0, 0.0])}
    sections = (
        Section(set="P", profile="PIPE", dimensions=(0.1, 0.01), **common),
        Section(set="R", profile="RECT", dimensions=(0.1, 0.2), **common),
    )
    deck = Deck(
        name="deck.cdb",
        program="ANSYS",
        ids=ids,
        xyz=np.outer(ids, [1.0, 0.0, 0.0]),
        elements=(beams,),
        element_sets={"P": np.array([[8, 8]]), "R": np.array([[7, 7]])},
        materials={"S": steel},
        sections=sections,
    )
    _, flat = flat_deck(deck)
    assert "TYPE=B32\n1, 1, 2, 3\n*ELEMENT, TYPE=B32R\n2, 3, 4, 5\n" in flat.cards
    assert "1 elements B32 are assembled as B32R [hybrid-as-plain]" in flat.warnings and flat.expands


@needs_ccx
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"boundary": "keep", "preload": 1}, ("unsupported", "preload", "--preload", "deck.bdf")),
        ({"boundary": "keep"}, ("unsupported", "boundary", "--boundary", "deck.bdf")),
    ],
)
def test_supports_and_steps_that_are_not_read_are_refused(options, message, tmp_path):
    mesh = nastran_mesh(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0)), "free")
    (tmp_path / "deck.bdf").write_text(f"BEGIN BULK\nPSOLID,1,1\nMAT1,1,1.,,.3,1.\n{mesh}ENDDATA\n")
    with refusal(*message):
        import_file(tmp_path / "deck.bdf", engine="calculix", options=options)


@needs_ccx
def test_archives_and_universal_files_are_given_materials_for_ccx(tmp_path):
    mesh = box("hex20", (2, 1, 1), (1.0, 0.4, 0.2))
    (tmp_path / "deck.cdb").write_text(ansys_archive(mesh))
    (tmp_path / "deck.unv").write_text(universal(mesh))
    steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    for name in ("deck.cdb", "deck.unv"):
        theirs, own = (
            model_of(import_file(tmp_path / name, engine=engine, materials=(steel,))) for engine in ("calculix", None)
        )
        assert np.array_equal(theirs.nodes.ids, own.nodes.ids)
        assert abs(theirs.K - own.K).max() < 1e-12 * abs(own.K).max()
        assert mass(theirs) == pytest.approx(7850 * 0.08 * np.eye(3), rel=1e-9, abs=1e-6)
        with refusal("missing", "MATERIAL", "--material"):
            import_file(tmp_path / name, engine="calculix")


@needs_ccx
def test_a_deck_of_a_stranger_becomes_a_body_on_the_command_line(tmp_path):
    text = TIED.replace("*DENSITY\n7850.\n", "*PLASTIC\n1e8,0.\n").replace("C3D8", "C3D8H")
    (tmp_path / "deck.inp").write_text(text + "*CONTACT PAIR,INTERACTION=I\nSB,SA\n")
    model, kept = tmp_path / "part.model.h5", tmp_path / "kept"
    line = ["import", str(tmp_path / "deck.inp"), "--engine", "calculix", "-o", str(model)]
    refused = CliRunner().invoke(app, line)
    assert refused.exit_code == 2 and "--density X" in refused.stderr and "Traceback" not in refused.stderr
    shells = tmp_path / "shells.inp"
    shells.write_text(SHELL.replace("S4R", "M3D4R").replace("SHELL", "MEMBRANE"))
    other = CliRunner().invoke(app, ["import", str(shells), "--dry-run"])
    assert other.exit_code == 2 and "CalculiX would read this deck: --engine calculix" in other.stdout
    line += ["--density", "7850", "--contact", "skip", "--check", "--keep-files", str(kept)]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 0, done.stderr
    assert "read as abaqus (calculix)" in done.stdout and "[density-given]" in done.stdout
    assert "1 *CONTACT PAIR left out as asked" in done.stdout and "[hybrid-as-plain]" in done.stdout
    assert {"model.sti", "probe.inp", "model.output.txt"} <= {path.name for path in kept.iterdir()}
    (tmp_path / "job.toml").write_text(
        f'[model]\nfile = "{model}"\n[[interface]]\nname = "top"\nnodes = "ids:15,16,17,18"\ncoupling = "rigid"\n'
        '[[interface]]\nname = "foot"\nnodes = "ids:30"\ncoupling = "direct"\n'
        '[[reduce]]\nmethod = "craig-bampton"\nmodes = 5\n[output]\npath = "out.h5"\n'
    )
    reduced = CliRunner().invoke(app, ["reduce", str(tmp_path / "job.toml")])
    assert reduced.exit_code == 0 and "9812.5 kg" in reduced.stdout, reduced.stderr
    assert mass(read_model(model)) == pytest.approx(1.25 * 7850 * np.eye(3), rel=1e-10, abs=1e-6)


@needs_ccx
def test_errors_of_ccx_name_the_labels_of_the_deck(tmp_path):
    flat = TIED.replace("2,11,12,13,14,15,16,17,18", "1017,11,12,13,14,11,12,13,14")
    with refusal("unsupported", "", "*ERROR", "1017"):
        imported(tmp_path, flat)


WRITES = (
    "from pathlib import Path\nfor end, text in {files!r}.items():\n    Path(job + end).write_text(text)\n"
    "print({said!r})"
)
CRASH = (
    "import os, signal\nprint('Using up to 1 cpu\\n\\nProgram received signal SIGSEGV\\n#0  0x7f in ???', flush=True)\n"
    "os.kill(os.getpid(), signal.SIGSEGV)"
)
ONE = {".dof": "1.1\n1.2\n1.3\n", ".sti": "1 1 1.\n2 2 1.\n3 3 1.\n", ".mas": "1 1 1.\n2 2 1.\n3 3 1.\n"}


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("time.sleep(60)", ("result", "engine_timeout", "0.5", "17", "--engine-timeout")),
        ("print(' *ERROR reading *ELEMENT: element 2\\n   has no volume')", ("unsupported", "", "*ERROR")),
        ("print('half')\nsys.exit(3)", ("unsupported", "", "half")),
        (CRASH, ("unsupported", "", "SIGSEGV")),
        ("print('Job finished')", ("program",)),
        (WRITES.format(files={**ONE, ".mas": ""}, said="Job finished"), ("program",)),
        (
            WRITES.format(files={**ONE, ".sti": "1 1 1.\n2 2 NaN\n3 3 1.\n"}, said="Job finished"),
            ("program", "", "1.2"),
        ),
        (WRITES.format(files={**ONE, ".sti": "1 1 1.\n2 2 1.\n3 3 1"}, said="Job finished"), ("file", "model.sti")),
        (WRITES.format(files={**ONE, ".sti": "1 1 1.\n2 2 1.\n"}, said="Job finished"), ("file", "model.sti")),
        (
            WRITES.format(files={**ONE, ".sti": "1 1 1.\n2 9 1.\n3 3 1.\n"}, said="Job finished"),
            ("file", "model.sti", "9"),
        ),
        (WRITES.format(files={**ONE, ".dof": "\x00\x01"}, said="Job finished"), ("file", "model.dof")),
        (WRITES.format(files=ONE, said="Job finished"), ("value",)),
    ],
    ids=["hangs", "error", "status", "crash", "none", "lost", "nan", "half", "short", "size", "garbage", "other"],
)
def test_what_an_engine_may_do_wrong_is_one_message(tmp_path, body, message):
    with refusal(*message):
        imported(tmp_path, TIED, executable=program(tmp_path, body), timeout=0.5 if "sleep" in body else 30.0)


def test_hard_limits_of_a_queue_are_kept(tmp_path):
    """More memory or larger files than a hard limit has cannot be asked for (ulimit -v on a cluster)."""
    code = (
        "import resource, sys; from pathlib import Path; from morembs.importers.engines.run import run\n"
        "resource.setrlimit(resource.RLIMIT_AS, (8 << 30,) * 2)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20,) * 2)\n"
        "said = run(['sh', '-c', 'ulimit -v; ulimit -f; ulimit -c'], Path(), seconds=60, memory=1 << 40, late='late')\n"
        "print(said.output)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split()[0] == str(8 << 20) and done.stdout.split()[2] == "0"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (["--engine", "calculx"], "did you mean 'calculix'?"),
        (["--engine", "nobody"], "known: auto, calculix, mystran"),
        (["--engine", "calculix:/nowhere/ccx"], "no file that can be run"),
        (["--engine", "calculix", "--preload", "1"], "supports carry the load"),
        (["--engine", "calculix", "--boundary", "hold"], 'expected "drop" or "keep"'),
        (["--engine", "calculix", "--dialect", "ansys"], 'expected "auto", "abaqus" or "calculix"'),
        (["--boundary", "keep"], "--boundary was given without --engine"),
        (["--engine", "calculix", "--format", "npz"], "reads decks of Abaqus or CalculiX"),
    ],
)
def test_options_of_engines_that_cannot_be_are_refused(tmp_path, line, message):
    (tmp_path / "deck.inp").write_text(TIED)
    out = ["-o", str(tmp_path / "a.model.h5")]
    replayed = [word if word != "calculix" else f"calculix:{calculix.replay(tmp_path, 'tied')}" for word in line]
    done = CliRunner().invoke(app, ["import", str(tmp_path / "deck.inp"), *out, *replayed])
    assert done.exit_code == 2 and message in " ".join(done.stderr.split()), done.stderr


def test_a_missing_program_is_told_with_its_cure(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("MOREMBS_CCX", raising=False)
    with refusal("program", "engine"):
        imported(tmp_path, TIED)
    monkeypatch.setenv("MOREMBS_CCX", str(calculix.replay(tmp_path, "tied")))
    assert imported(tmp_path, TIED).size == 54
    lines = CliRunner().invoke(app, ["import", "--list"]).stdout.splitlines()
    (told,) = [line for line in lines if "calculix:" in line]
    assert told.startswith("--engine calculix:") and "not found" not in told


@pytest.mark.parametrize(
    ("lines", "keyword", "line", "flag"),
    [
        ("*ELEMENT,TYPE=CPS4,ELSET=Q\n9,1,2,3,4\n", "ELEMENT", 0, "--skip CPS4"),
        ("*ELEMENT,TYPE=U1,ELSET=Q\n9,1,2\n", "ELEMENT", 0, "--skip U1"),
        ("*EMBEDDED ELEMENT\nA\n", "EMBEDDED ELEMENT", 39, "--skip EMBEDDED ELEMENT"),
        (
            "*MATERIAL,NAME=R\n*HYPERELASTIC\n1,0\n*SOLID SECTION,ELSET=B,MATERIAL=R\n",
            *("MATERIAL", 0, "--material young=..,poisson=..,density=..,set=B"),
        ),
        ("*CONTACT PAIR,INTERACTION=I\nSB,SA\n", "CONTACT PAIR", 39, "--contact skip"),
        ("*TIE,NAME=U\nSB,SX\n", "TIE", 39, "--skip TIE"),
        (
            "*TIE,NAME=C,CYCLIC SYMMETRY\nSB,SA\n*CYCLIC SYMMETRY MODEL,N=4\n0,0,0,0,0,1\n",
            *("CYCLIC SYMMETRY MODEL", 41, "--skip CYCLIC SYMMETRY MODEL"),
        ),
    ],
)
def test_decks_that_are_no_linear_model_are_refused_before_a_run(tmp_path, lines, keyword, line, flag):
    executable = calculix.replay(tmp_path, "tied")
    told = refusals(lambda: imported(tmp_path, TIED + lines, executable=executable))
    assert told[0] == (keyword, line, (flag,)) and {flags for *_, flags in told} == {(flag,)}
