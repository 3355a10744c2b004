"""A deck by labels, and the one way from there to a mesh with its sets, couplings and materials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morembs import read_deck
from morembs.fem.constraints import RigidElement
from morembs.fem.material import isotropic
from morembs.importers.decks.labels import Labels, distinct, in_ranges, ranges_by_number, ranges_of
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import DeckOptions
from morembs.importers.decks.problems import DeckError, Problem
from morembs.importers.decks.tables import Elements, Section, Surface
from morembs.importers.imported import PointMass
from tests.support.decks import refusals
from tests.support.mesh_decks import abaqus_mesh, ansys_archive, nastran_mesh
from tests.support.meshes import box
from tests.support.refusals import Refusal, refusal

STEEL = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)


def deck_of(kind: str = "hex8") -> Deck:
    """Two elements whose nodes stand in the file from the last to the first, with a node of no element and one that a
    rigid element and a mass hold; labels of elements have a gap."""
    mesh = box(kind, (2, 1, 1), (2.0, 1.0, 1.0))
    ids = np.concatenate([[900], mesh.nodes.ids[::-1] + 100, [50]])
    xyz = np.concatenate([[[9.0, 9.0, 9.0]], mesh.nodes.xyz[::-1], [[3.0, 0.5, 0.5]]])
    nodes = mesh.nodes.ids[mesh.blocks[0].nodes] + 100
    return Deck(
        name="bar.cdb",
        program="ANSYS",
        ids=ids,
        xyz=xyz,
        elements=(
            Elements(code="C3D8", kind="solid", shape=kind, ids=np.array([7, 9]), nodes=nodes),
            Elements(code="MASS", kind="point", shape="", ids=np.array([30]), nodes=np.array([[50]])),
            Elements(code="S4", kind="none", shape="quad4", ids=np.array([31]), nodes=nodes[:1, :4]),
        ),
        node_sets={"END": np.array([[101, 103], [900, 900]]), "FAR": np.array([[900, 900]])},
        element_sets={"ALL": np.array([[7, 7], [9, 9]]), "MASS": np.array([[30, 30]]), "SKIN": np.array([[31, 31]])},
        surfaces={"TIP": Surface(nodes=np.array([101, 900]), weights=np.ones(2))},
        sections=(Section(set="ALL", material="STEEL", stiffness=STEEL.stiffness, density=STEEL.density),),
        rigid=(RigidElement(name="head", master=50, slaves=np.array([103, 101])),),
        masses=(PointMass(name="tip", node=50, mass=2.0),),
    )


def test_labels_become_rows_of_a_mesh() -> None:
    deck = deck_of()
    imported = deck.convert()
    mesh, nodes = imported.mesh, imported.nodes
    assert mesh is not None and nodes is not None
    # Nodes of solids by label, the one that hangs on them behind.
    assert nodes.ids.tolist() == [*range(101, 113), 50] and len(mesh.nodes) == 12
    assert np.array_equal(mesh.nodes.xyz, box("hex8", (2, 1, 1), (2.0, 1.0, 1.0)).nodes.xyz)
    assert nodes.sets["END"].tolist() == [0, 1, 2] and "FAR" not in nodes.sets
    assert [rows.tolist() for rows in mesh.element_sets["ALL"]] == [[0, 1]] and "MASS" not in mesh.element_sets
    assert imported.surfaces["TIP"].tolist() == [0]
    assert imported.rigid[0].master == 12 and imported.rigid[0].slaves.tolist() == [2, 0]
    assert imported.masses[0].node == 12 and imported.materials[0].set == "ALL"
    assert imported.notes == (
        "1 nodes belong to no element and were left out (first: 900).",
        "1 of 4 nodes of the set END belong to no element.",
        "The node set FAR holds no node of the model and was left out.",
        "1 of 1 elements of the set SKIN are no solids and were left out.",
    )
    # Decks of Abaqus have sets for loads and output too.
    assert len(replace(deck, program="Abaqus").convert().notes) == 2
    model = deck.to_model("m-kg-s")
    assert model.M.sum() == pytest.approx(3 * (2.0 * STEEL.density + 2.0))
    assert repr(deck).startswith("Deck: file bar.cdb; program ANSYS; nodes 14; elements 2 C3D8 + 1 MASS + 1 S4;")


def test_middle_nodes_that_are_not_there_follow_their_corners() -> None:
    deck = replace(deck_of("hex20"), rigid=(), masses=())
    solids = deck.elements[0]
    nodes = solids.nodes.copy()
    nodes[:, 12] = 0
    imported = replace(deck, elements=(replace(solids, nodes=nodes), *deck.elements[1:])).convert()
    assert imported.mesh is not None and imported.mesh.nodes.ids[-2:].tolist() == [901, 902]
    (equations,) = imported.equations
    assert equations.nodes.tolist() == np.repeat(len(imported.mesh.nodes) - np.array([2, 1]), 3).tolist()
    corners = imported.mesh.nodes.xyz[equations.term_nodes.reshape(2, 3, 2)].mean(axis=2)
    assert np.array_equal(corners[:, 0], imported.mesh.nodes.xyz[-2:])


def test_what_keeps_a_deck_from_a_model_is_told_at_once() -> None:
    deck = deck_of()
    shells = replace(deck.elements[2], kind="shell", problem=Problem(what="shells", flags=("--skip S4",)))
    bare = replace(deck.sections[0], density=None, lacks="STEEL has no *DENSITY")
    bad = replace(deck, elements=(*deck.elements[:2], shells), sections=(bare,))
    assert refusals(bad.convert) == [("", 0, ("--skip S4",)), ("DENSITY", 0, ("--density X",))]
    given = replace(bad, elements=deck.elements, options=DeckOptions(density={"all": 3.0}), mass_scale=2.0).convert()
    assert given.materials[0].density == 6.0
    with refusal("missing", "", "SOLID185", by=DeckError):
        replace(deck, elements=deck.elements[1:]).convert()
    with refusal("unsupported", "", "bar.cdb", "head", "tip"):
        deck.mesh()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ids": np.array([900, *range(112, 100, -1), 101])}, ("conflict", "node", "101")),
        ({"ids": np.array([0, *range(112, 100, -1), 50])}, ("conflict", "node")),
        ({"node_sets": {"A": np.array([[101, 115]])}}, ("file", "", "113")),
        ({"element_sets": {"A": np.array([[7, 9]])}}, ("file", "", "8")),
        ({"masses": (PointMass(name="tip", node=51, mass=2.0),)}, ("unknown", "node", "51")),
    ],
)
def test_labels_that_do_not_fit_are_refused(change: dict[str, object], message: Refusal) -> None:
    with refusal(*message):
        replace(deck_of(), **change).convert()  # type: ignore[arg-type]


def test_ranges_hold_labels() -> None:
    labels = np.array([7, 3, 4, 12, 5, 4])
    assert ranges_of(labels).tolist() == [[3, 5], [7, 7], [12, 12]] and ranges_of(labels[:0]).shape == (0, 2)
    assert distinct(labels).tolist() == [3, 4, 5, 7, 12] and distinct(labels[:0]).shape == (0,)
    overlapping = np.array([[4, 6], [1, 4], [3, 8], [3, 3]])
    assert in_ranges(np.arange(10), overlapping).nonzero()[0].tolist() == list(range(1, 9))
    assert Labels(np.arange(12, 0, -1), "a.cdb").members(overlapping, "sets name").tolist() == list(range(11, 3, -1))
    pairs = [(np.array([5, 6]), np.array([2, 1])), (np.array([7]), np.array([1]))]
    by_number = {number: ranges.tolist() for number, ranges in ranges_by_number(pairs).items()}
    assert by_number == {1: [[6, 7]], 2: [[5, 5]]} and ranges_by_number([]) == {}
    shuffled = Labels(np.array([30, 10, 20]), "a.cdb")
    assert shuffled.rows(np.array([[10, 30]]), "sets name").tolist() == [[1, 0]]
    assert shuffled.members(np.array([[10, 10], [30, 30]]), "a set names").tolist() == [1, 0]
    assert shuffled.has(np.array([10, 11, 0])).tolist() == [True, False, False]
    gapless = Labels(np.array([4, 5, 6]), "a.cdb")
    assert gapless.has(np.array([3, 4, 7])).tolist() == [False, True, False]
    with refusal("unknown", "node", "7", "8"):
        gapless.rows(np.array([8, 7, 4]), "sets name")


def test_decks_are_read_from_files_of_every_program(tmp_path: Path) -> None:
    mesh = box("hex8", (2, 1, 1), (2.0, 1.0, 1.0))
    (tmp_path / "bar.inp").write_text(abaqus_mesh(mesh))
    (tmp_path / "bar.bdf").write_text(nastran_mesh(mesh, "free") + "ENDDATA\n")
    (tmp_path / "bar.cdb").write_text(ansys_archive(mesh))
    heavy = isotropic(set="all", young=2.1e5, poisson=0.3, density=7.85e-9)
    for name, program in (("bar.inp", "CalculiX"), ("bar.bdf", "Nastran"), ("bar.cdb", "ANSYS")):
        deck = read_deck(tmp_path / name)
        assert deck.program == program and not deck.problems and deck.mesh().blocks[0].type == "hex8"
        model = deck.to_model("mm-t-s", materials=[heavy])
        assert model.M.sum() == pytest.approx(3 * 2e-9 * 7850.0)
        with refusal("missing", "", name, "isotropic(set="):
            deck.to_model()
    assert read_deck(tmp_path / "bar.inp", dialect="abaqus").program == "Abaqus"
    with refusal("unknown", "dialect"):
        read_deck(tmp_path / "bar.bdf", dialect="abaqus")
    np.savez(tmp_path / "K.npz", K=np.eye(3), M=np.eye(3))
    with refusal("value", "", "npz"):
        read_deck(tmp_path / "K.npz")
