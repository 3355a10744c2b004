"""Shells and beams of decks of CalculiX, assembled here, against ccx and against beams of Timoshenko."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.deck_programs import difference, of_ccx, spectrum_of
from morembs import import_model, isotropic
from morembs.fem import FEModel, rigid_motion
from morembs.fem.interface import make_interface
from morembs.fem.selection import select_nodes
from morembs.importers import import_file
from morembs.importers.to_model import model_of
from morembs.parametric.parameter import Parameter
from morembs.parametric.terms import varied_model
from morembs.problem import Problem
from tests.support.calculix import STORED, needs_ccx
from tests.support.refusals import refusal
from tests.support.structures import LINE, PORTAL, STRUCTURES, fold, frame, plate

# The first ten frequencies of each in Hz, by ccx 2.20.
FREQUENCIES = json.loads((STORED / "structures.json").read_text())


def imported(folder: Path, text: str, **options: object) -> FEModel:
    (folder / "deck.inp").write_text(text)
    return model_of(import_file(folder / "deck.inp", options={"dialect": "calculix", **options}))


@pytest.mark.parametrize("name", STRUCTURES)
def test_frequencies_are_those_that_ccx_found(tmp_path, name):
    found = spectrum_of(imported(tmp_path, STRUCTURES[name])).frequencies
    assert len(found) == len(FREQUENCIES[name]) >= 6
    assert found == pytest.approx(FREQUENCIES[name], rel=1e-6)


@needs_ccx
@pytest.mark.parametrize("name", STRUCTURES)
def test_frequencies_are_those_of_ccx(tmp_path, name):
    model = imported(tmp_path, STRUCTURES[name])
    assert difference(spectrum_of(model), of_ccx(tmp_path / "deck.inp")) <= 1e-6


@pytest.mark.parametrize("name", STRUCTURES)
def test_rigid_motion_has_no_force_and_all_mass(tmp_path, name):
    model = imported(tmp_path, STRUCTURES[name])
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    assert np.abs(model.K @ R).max() <= 1e-12 * (abs(model.K) @ np.abs(R)).max()
    own = model.dofs.node < len(model.mesh.nodes)
    R[~own] = 0.0
    moved = R[:, :3].T @ model.M @ R[:, :3]
    assert moved == pytest.approx(moved[0, 0] * np.eye(3), rel=1e-12)
    if name == "flat S8R":
        assert moved[0, 0] == pytest.approx(10 * 6 * 0.2 * 7850, rel=1e-12)


@pytest.mark.parametrize("code", ["B32", "B32R"])
def test_a_cantilever_bends_as_timoshenko_has_it(tmp_path, code):
    """A tip load; the held section may contract, and its first axis is the thinner one."""
    model = imported(tmp_path, frame(code, ((0, 0, 0), (0, 0, 10)), 8, data="0.4, 0.6", direction="0, 1, 0"))
    T = model.dependent.S[:, np.flatnonzero(model.dependent.owner < 0)]
    free = np.flatnonzero(model.dependent.owner < 0)
    K = (T.T @ model.K @ T).toarray()
    x, component = model.nodes.xyz[model.dofs.node[free]], model.dofs.component[free]
    on_axis = (np.abs(x[np.arange(len(x)), component % 3]) < 1e-9) & (model.nodes.ids[model.dofs.node[free]] > 17)
    held = (x[:, 2] < 1e-9) & ((component == 2) | on_axis)
    tip = np.flatnonzero((model.nodes.ids[model.dofs.node] == 17) & (model.dofs.component == 0))
    row = T[tip].toarray().ravel()
    kept = np.flatnonzero(~held & (np.abs(K).sum(axis=1) > 0))
    deflection = row[kept] @ np.linalg.solve(K[np.ix_(kept, kept)], row[kept])
    E, G, inertia, area = 2.1e11, 2.1e11 / 2.6, 0.4 * 0.6**3 / 12, 0.4 * 0.6
    assert deflection == pytest.approx(10**3 / (3 * E * inertia) + 10 / (5 / 6 * G * area), rel=5e-3)


def test_nodes_of_the_deck_are_in_the_middle_and_sets_hold_fibres(tmp_path):
    model = imported(tmp_path, plate("S8R"))
    node = int(np.flatnonzero(model.nodes.ids == 1)[0])
    own = np.flatnonzero(model.dofs.node == node)
    assert model.dofs.component[own].tolist() == [0, 1, 2] and (model.dependent.owner[own] < 0).all()
    fibres = model.nodes.sets["END"]
    # Of a corner its node, the middle and the top, of a middle its node and the top: what follows is in no set.
    assert len(fibres) == 3 * 3 + 2 * 2 and node in fibres
    assert np.unique(model.nodes.xyz[fibres, 2]) == pytest.approx([0.0, 0.1])
    low, high = (
        np.flatnonzero(np.abs(model.nodes.xyz - model.nodes.xyz[node] - [0, 0, z]).max(axis=1) < 1e-12)[0]
        for z in (-0.1, 0.1)
    )
    S = model.dependent.S[np.flatnonzero(model.dofs.node == low)].toarray()
    for row, component in zip(S, range(3), strict=True):
        terms = {(int(model.dofs.node[i]), int(model.dofs.component[i])): row[i] for i in np.flatnonzero(row)}
        assert terms == {(node, component): 2.0, (int(high), component): -1.0}
    assert not any("SHELL SECTION" in note for note in model.notes)


def test_single_nodes_and_edges_are_interfaces(tmp_path):
    model = imported(tmp_path, plate("S4", (4, 2), move=fold(1.0)))
    edge, single, knot = (
        make_interface(model, name=text, nodes=select_nodes(model, text), coupling=coupling)
        for text, coupling in (("set:END", "rigid"), ("ids:5", "direct"), ("ids:3", "rigid"))
    )
    assert single.components == (0, 1, 2) and len(edge.nodes) == 6 and len(knot.nodes) == 1
    with Problem(model, [edge, single, knot]) as problem:
        values, modes = problem.K @ problem.rigid, problem.rigid
    assert modes.shape[1] == 6 and np.abs(values).max() <= 1e-10 * np.abs(problem.K.data).max()


def test_a_knot_has_rotations_and_stretches(tmp_path):
    model = imported(tmp_path, plate("S8R", (4, 2), move=fold(1.0)))
    knots = np.unique(model.dofs.node[model.dofs.component == 3])
    assert model.nodes.xyz[knots, 0] == pytest.approx(5.0) and len(knots) == 5
    stretches = np.unique(model.dofs.node[model.dofs.component == 6])
    assert np.sort(model.nodes.xyz[stretches], axis=0) == pytest.approx(np.sort(model.nodes.xyz[knots], axis=0))
    for knot, stretch in zip(knots, stretches, strict=True):
        assert model.dofs.component[model.dofs.node == knot].tolist() == [0, 1, 2, 3, 4, 5]
        assert model.dofs.component[model.dofs.node == stretch].tolist() == [6]


def test_what_is_not_assembled_here_names_who_does(tmp_path):
    layers = plate("S8R", section=", COMPOSITE", data=".1,,STEEL\n.1,,STEEL")
    round_b31 = frame("B31R", LINE, section="CIRC", data="0.4")
    normal = frame("B32", LINE) + "*NORMAL\n1, 1, 0, 0, 1\n"
    general = frame("B32", LINE, section="GENERAL", data="1, 1, 0, 1, 1")
    mesh = plate("S8R").split("*SHELL")[0]
    for text, why in (
        (layers, "6 of the type 'S8R' (layers)"),
        (round_b31, "2 of the type 'B31R' (SECTION=CIRC of a linear beam)"),
        (normal, "2 of the type 'B32' (*NORMAL of a beam)"),
        (general, "2 of the type 'B32' (SECTION=GENERAL)"),
        (mesh, "6 of the type 'S8R' (elements without a section)"),
    ):
        with refusal("unsupported", "ELEMENT") as told:
            imported(tmp_path, text)
        assert why in str(told.value) and "--engine calculix may assemble them" in str(told.value)


def test_shells_of_abaqus_are_told_to_be_those_of_calculix(tmp_path):
    text = plate("S8R").replace("TYPE=S8R", "TYPE=S8R5")
    model = imported(tmp_path, text, dialect="abaqus")
    told = [sentence for sentence in model.warnings if "[formulation-differs]" in sentence]
    assert len(told) == 1 and told[0].startswith("6 elements S8R are expanded to solids as CalculiX does")
    assert any("6 elements S8R5 are assembled as S8R [hybrid-as-plain]" in sentence for sentence in model.warnings)
    assert imported(tmp_path, plate("S8R")).warnings == ()


def test_masses_and_springs_act_on_the_mean(tmp_path):
    text = plate("S8R") + "*ELEMENT, TYPE=MASS, ELSET=M\n900, 1\n*MASS, ELSET=M\n3.\n"
    text += "*ELEMENT, TYPE=SPRING1, ELSET=K\n901, 7\n*SPRING, ELSET=K\n3\n5.e6\n"
    model, bare = imported(tmp_path, text), imported(tmp_path, plate("S8R"))
    move = (model.dofs.component == 2).astype(float)
    S, T = model.dependent.S, bare.dependent.S
    assert move @ model.M @ move == pytest.approx(move @ bare.M @ move + 3.0, rel=1e-12)
    assert move @ (S.T @ model.K @ S) @ move == pytest.approx(5e6, rel=1e-7)
    assert abs(S - T).max() == 0


def test_rotations_that_a_node_does_not_have_are_told(tmp_path):
    text = plate("S8R") + "*EQUATION\n2\n1, 5, 1., 7, 5, -1.\n"
    with refusal("unsupported", "", "*EQUATION"):
        imported(tmp_path, text)


def test_sections_without_a_density_ask_for_one(tmp_path):
    text = frame("B32", PORTAL).replace("*DENSITY\n7850.\n", "")
    with refusal("missing", "", "STEEL", "BEAMS", "*DENSITY"):
        imported(tmp_path, text)
    model = imported(tmp_path, text, density=7850.0)
    assert spectrum_of(model).frequencies == pytest.approx(FREQUENCIES["portal B32"], rel=1e-6)


@pytest.mark.parametrize("name", ["REST", "all"])
def test_a_material_for_shells_in_no_section_asks_for_one(tmp_path, name):
    text = plate("S4").replace("ELSET=PLATE, MATERIAL", "ELSET=SOME, MATERIAL")
    (tmp_path / "deck.inp").write_text(
        text.replace("*MATERIAL", "*ELSET, ELSET=SOME\n1, 2\n*ELSET, ELSET=REST\n3, 4\n*MATERIAL", 1)
    )
    steel = isotropic(set=name, young=2.1e11, poisson=0.3, density=7850.0)
    with refusal("value", "", name) as told:
        import_model(tmp_path / "deck.inp", dialect="calculix", materials=[steel])
    assert "have no section; give them a *SHELL SECTION in deck.inp" in str(told.value)


def test_shells_may_be_left_out(tmp_path):
    text = STRUCTURES["S8 on solids"]
    model = imported(tmp_path, text, skip="S8")
    assert any("6 elements S8 left out as asked" in sentence for sentence in model.warnings)
    assert model.size == 3 * 12


def test_rigid_bodies_of_abaqus_turn_the_fibres(tmp_path):
    text = plate("S8R") + "*NODE\n900, 0, 3, 0\n*RIGID BODY, NSET=END, REF NODE=900\n"
    model = imported(tmp_path, text, dialect="abaqus")
    turn = np.flatnonzero((model.nodes.ids[model.dofs.node] == 900) & (model.dofs.component == 4))
    S = model.dependent.S[:, turn].toarray().ravel()
    ends = np.flatnonzero(np.isin(model.dofs.node, model.nodes.sets["END"]) & (model.dofs.component == 0))
    assert S[ends] == pytest.approx(model.nodes.xyz[model.dofs.node[ends], 2]) and np.abs(S[ends]).max() == 0.1


@pytest.mark.parametrize("master", [3, 1], ids=["knot", "single"])
def test_rigid_bodies_of_calculix_with_a_node_of_a_shell_as_reference_are_refused(tmp_path, master):
    """There they turn without the knot; those of Abaqus turn with it."""
    text = plate("S4", (4, 2), move=fold(1.0)) + f"*NSET, NSET=SIDE\n6, 11\n*RIGID BODY, NSET=SIDE, REF NODE={master}\n"
    with refusal("unsupported", "", "SIDE", master):
        imported(tmp_path, text)
    if master == 3:
        model = imported(tmp_path, text, dialect="abaqus")
        turns = (model.dofs.component == 4) & (model.dependent.owner < 0)
        assert model.nodes.ids[model.dofs.node[turns]].tolist() == [3, 8, 13]


def test_modes_inside_of_elements_are_refused_with_parameters(tmp_path):
    (tmp_path / "deck.inp").write_text(plate("S4"))
    given = import_file(tmp_path / "deck.inp", options={"dialect": "calculix"})
    young = Parameter(name="E", kind="young", low=1.6e11, high=2.4e11, nominal=2.1e11)
    with refusal("unsupported", "elements"):
        varied_model(given.mesh, given.materials, [young])


@needs_ccx
def test_a_circle_of_abaqus_has_its_radius_whoever_assembles(tmp_path):
    path = tmp_path / "rod.inp"
    path.write_text(
        "*NODE\n1,0,0,0\n2,.25,0,0\n3,.5,0,0\n*ELEMENT,TYPE=B32R,ELSET=B\n1,1,2,3\n"
        "*BEAM SECTION,ELSET=B,MATERIAL=M,SECTION=CIRC\n.02\n0,0,1\n*MATERIAL,NAME=M\n"
        "*ELASTIC\n2.1E11,.3\n*DENSITY\n7850.\n"
    )
    models = [import_model(path, dialect="abaqus", engine=engine) for engine in (None, "calculix")]
    own, theirs = (model.M[model.dofs.component == 0][:, model.dofs.component == 0].sum() for model in models)
    assert theirs == pytest.approx(own, rel=1e-9)
    # Four points of the section miss the area of the circle by 1.2 %.
    assert own == pytest.approx(np.pi * 0.02**2 * 0.5 * 7850.0, rel=0.02)
