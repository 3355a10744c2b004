"""Equations between dofs: eliminated like rigid elements, stored in the model file, refused where they contradict."""

from __future__ import annotations

from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.linalg as sl

from morembs import Problem, make_interface
from morembs.base.units import parse_units
from morembs.body.diagnostics.warnings import diagnosis_of
from morembs.fem import Nodes
from morembs.fem.constraints import Equations, RigidElement, solved_for_first
from morembs.fem.material import isotropic
from morembs.importers.imported import Imported, PointMass
from morembs.importers.model_file import read_model, write_model
from morembs.importers.to_model import model_of
from tests.support.diagnoses import finding, grave
from tests.support.meshes import STEEL, box
from tests.support.refusals import refusal

MATERIAL = isotropic(set="all", **STEEL)


def bar() -> Imported:
    """A bar of two elements with a loose node behind its end."""
    mesh = box("hex8", (2, 1, 1), (0.2, 0.1, 0.1))
    nodes = Nodes(ids=np.append(mesh.nodes.ids, 900), xyz=np.vstack([mesh.nodes.xyz, [[0.3, 0.05, 0.05]]]))
    return Imported(source="bar", nodes=nodes, mesh=mesh, materials=(MATERIAL,))


def dense(model, S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    free = np.flatnonzero(model.dependent.owner < 0)
    T = S[:, free]
    return T.T @ model.K.toarray() @ T, T.T @ model.M.toarray() @ T


def test_chains_of_equations_and_a_rigid_element_against_dense_elimination():
    given = bar()
    hub = len(given.mesh.nodes)
    right = np.flatnonzero(np.isclose(given.mesh.nodes.xyz[:, 0], 0.2))
    # u0x = 0.3 u1x - 2 u2y;  u1x = 0.5 u3z;  u4y held;  u3z = u(hub, rz) by the chain's end.
    sums = [
        ("first", [(0, 0, -2.0), (1, 0, 0.6), (2, 1, -1.0), (2, 1, -3.0), (5, 0, 1.0), (5, 0, -1.0)]),
        ("second", [(1, 0, 1.0), (3, 2, -0.5)]),
        ("third", [(4, 1, 7.0)]),
        ("fourth", [(3, 2, 1.0), (hub, 5, -0.04)]),
    ]
    equations = solved_for_first("MPC", sums)
    assert len(equations) == 4 and equations.offsets.tolist() == [0, 2, 3, 3, 4]
    rigid = RigidElement(name="R", master=hub, slaves=right[right > 4])
    model = model_of(replace(given, rigid=(rigid,), equations=(equations,)))
    plain = model_of(replace(given, rigid=(rigid,)))
    S = plain.dependent.S.toarray()
    turn = int(np.flatnonzero((model.dofs.node == hub) & (model.dofs.component == 5))[0])
    S[[3 * 3 + 2, 1 * 3, 0, 4 * 3 + 1]] = 0
    S[3 * 3 + 2, turn] = 0.04
    S[3, turn] = 0.02
    S[0, turn], S[0, 2 * 3 + 1] = 0.3 * 0.02, -2.0
    assert model.dependent.S.toarray() == pytest.approx(S, abs=1e-15)
    K, M = dense(model, S)
    with Problem(model) as problem:
        assert problem.K.toarray() == pytest.approx(K, rel=1e-12, abs=1e-5)
        assert problem.M.toarray() == pytest.approx(M, rel=1e-12, abs=1e-14)


def test_a_node_outside_the_mesh_that_equations_join_carries_its_mass():
    given = bar()
    hub = len(given.mesh.nodes)
    right = np.flatnonzero(np.isclose(given.mesh.nodes.xyz[:, 0], 0.2))
    joined = solved_for_first(
        "*EQUATION",
        [(f"equation of {row} in {c}", [(int(row), c, 1.0), (hub, c, -1.0)]) for row in right for c in range(3)],
    )
    mass = PointMass(name="m", node=hub, mass=3.0)
    model = model_of(replace(given, equations=(joined,), masses=(mass,)))
    with Problem(model) as problem:
        total = 0.2 * 0.1 * 0.1 * STEEL["density"]
        assert problem.mass_properties[0] == pytest.approx(total + 3.0, rel=1e-12)
        plain = sl.eigvalsh(problem.K.toarray(), problem.M.toarray())
    # The face keeps its angle to the axis, so three motions are left; nodes of the face are hidden from interfaces.
    assert (np.abs(plain[:3]) < 1e-6 * plain[6]).all() and plain[3] > 1e-6 * plain[6]
    end = make_interface(model, name="end", nodes=right, coupling="direct")
    with refusal("model", "nodes", "*EQUATION"):
        Problem(model, [end])


def test_equations_come_back_and_older_readers_are_kept_away(tmp_path):
    given = bar()
    hub = len(given.mesh.nodes)
    equations = solved_for_first("*TIE A", [("one", [(0, 0, 1.0), (1, 1, -0.7)]), ("held", [(2, 2, 1.0)])])
    lever, back = ("lever", [(3, 0, 1.0), (hub, 4, -50.0)]), ("back", [(hub, 3, 1.0), (4, 1, 0.5)])
    turned = solved_for_first("MPC", [lever, back])
    model = model_of(replace(given, equations=(equations, turned)), parse_units("mm-t-s"))
    # Displacements in mm over angles: levers are in m now.
    assert model.equations[1].coefficients.tolist() == pytest.approx([0.05, -500.0], rel=1e-15)
    assert model.equations[0].coefficients.tolist() == [0.7]
    path = write_model(tmp_path / "a.model.h5", model)
    again = read_model(path)
    assert [e.name for e in again.equations] == ["*TIE A", "MPC"]
    assert (again.dependent.S != model.dependent.S).nnz == 0
    assert write_model(tmp_path / "b.model.h5", again).read_bytes() == path.read_bytes()
    with h5py.File(path) as file:
        assert file["format_version"][()] == 2
    plain = write_model(tmp_path / "c.model.h5", model_of(given))
    with h5py.File(plain) as file:
        assert file["format_version"][()] == 1


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("nodes", lambda v: v + 99, ("file", "a.model.h5", "/nodes/ids")),
        ("term_components", lambda v: v + 7, ("file", "a.model.h5", "term_components", "6")),
        ("offsets", lambda v: v[::-1].copy(), ("value", "equations")),
        ("coefficients", lambda v: v * np.nan, ("file", "a.model.h5")),
    ],
)
def test_damaged_equations_are_refused(tmp_path, name, change, words):
    equations = solved_for_first("*TIE A", [("one", [(0, 0, 1.0), (1, 1, -0.7)]), ("two", [(2, 0, 1.0), (1, 1, -0.7)])])
    path = write_model(tmp_path / "a.model.h5", model_of(replace(bar(), equations=(equations,))))
    with h5py.File(path, "r+") as file:
        del file["checksums"]
        values = change(file[f"equations/equations_0/{name}"][()])
        del file[f"equations/equations_0/{name}"]
        file[f"equations/equations_0/{name}"] = values
    with refusal(*words):
        read_model(path)


def test_a_dof_may_follow_several_equations_as_far_as_they_say_something_new():
    """Equal ones are one; others hold together, and are solved for further dofs: by rank, not by count."""
    given = bar()
    one, two = ("one", [(0, 0, 1.0), (1, 0, -1.0)]), ("two", [(0, 0, 2.0), (2, 0, -1.0), (1, 0, -1.0)])
    three = ("three", [(1, 0, 1.0), (2, 0, -1.0)])

    def model(*groups):
        equations = tuple(solved_for_first(f"MPC {i}", group) for i, group in enumerate(groups))
        return model_of(replace(given, equations=equations))

    plain = model([one])
    for again in (model([one, one]), model([one], [one])):
        assert abs(again.dependent.S - plain.dependent.S).max() == 0.0 and not again.warnings
    # The second of node 1 leaves u_2 = u_3; a third equation that says so is nothing new.
    pair, same = model([one], [two]), model([one], [two], [three])
    (text,) = pair.warnings
    assert "component 0 of node 1 follows both 'MPC 0' and 'MPC 1'" in text and text.endswith("[over-constraint]")
    S = pair.dependent.S.toarray()
    motions = S @ np.random.default_rng(1).normal(size=(len(S), 5))
    table = pair.dofs.table(len(pair.nodes))
    for _, terms in (one, two, three):
        assert np.abs(sum(value * motions[table[node, c]] for node, c, value in terms)).max() < 1e-12
    assert np.linalg.matrix_rank(S) == np.linalg.matrix_rank(same.dependent.S.toarray()) == len(S) - 2


def test_what_contradicts_itself_is_named():
    given = bar()
    equation = ("the equation in line 7", [(0, 0, 1.0), (1, 0, -1.0)])
    with refusal("value", "equation", "9"):
        solved_for_first("MPC", [equation, ("the equation in line 9", [(0, 1, 2.0), (1, 0, 1.0), (0, 1, -2.0)])])
    with refusal("value", "equation", "9"):
        solved_for_first("MPC", [("the equation in line 9", [(0, 1, 2.0), (1, 0, np.inf)])])
    back = ("", [(1, 0, 1.0), (2, 0, -1.0)])
    closed = ("", [(2, 0, 1.0), (0, 0, -1.0)])
    outside = ("", [(3, 0, 1.0), (0, 0, 1.0)])
    with refusal("conflict", "equation", "MPC"):
        model_of(replace(given, equations=(solved_for_first("MPC", [outside, equation, back, closed]),)))
    with refusal("value", "equations"):
        Equations(
            name="x", nodes=[0], components=[0], offsets=[0, 2], term_nodes=[1], term_components=[0], coefficients=[1.0]
        )


def test_equations_between_nodes_that_lie_apart_are_blamed_and_not_the_coordinates():
    """The ends of a bar move alike along x: it cannot turn. Coordinates that do not fit K are an error still."""
    given = bar()
    mesh = given.mesh
    left, right = (np.flatnonzero(np.isclose(mesh.nodes.xyz[:, 0], x)) for x in (0.0, 0.2))
    pairs = [(f"pair {i}", [(a, 2, 1.0), (b, 2, -1.0)]) for i, (a, b) in enumerate(zip(left, right, strict=True))]
    model = model_of(replace(given, nodes=mesh.nodes, equations=(solved_for_first("*EQUATION", pairs),)))
    told = finding(diagnosis_of(model), "equations-strain")
    assert grave(diagnosis_of(model)) == {"equations-strain"}
    assert "rotation of the whole body (*EQUATION)" in told.sentence
    assert set(told.where) == {str(label) for label in mesh.nodes.ids[left]}
    skewed = mesh.nodes.xyz * (1 + 0.3 * np.random.default_rng(7).random(mesh.nodes.xyz.shape))
    moved = replace(model, nodes=Nodes(ids=mesh.nodes.ids, xyz=skewed))
    assert "equations-strain" not in grave(diagnosis_of(moved)) and diagnosis_of(moved).errors
