"""What decks hold beside a mesh: equations, ties, contact, springs, rigid bodies; and all problems at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.fem import rigid_motion
from morembs.fem.elements import FACES, TYPES
from morembs.fem.handedness import mirror_of
from morembs.fem.interface.average import average_matrix
from morembs.importers.abaqus.importer import read_abaqus_deck
from morembs.importers.decks.problems import DeckError
from morembs.importers.decks.projection import project
from morembs.importers.dependent_dofs import interface_of_coupling
from morembs.importers.model_file import read_model
from morembs.importers.to_model import model_of
from tests.support.decks import refusals
from tests.support.meshes import box, fully_integrated, steel
from tests.support.refusals import refusal

STEEL_LINES = "*MATERIAL, NAME=M\n*ELASTIC\n2.1E11, .3\n*DENSITY\n7850.\n"
SECTION = "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n" + STEEL_LINES
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def cube(first: int, low=(0.0, 0.0, 0.0), size=1.0, element: int = 1) -> str:
    """A cube of one element; its nodes are ``first`` to ``first + 7``, as in the manual."""
    rows = [
        f"{first + i}, " + ", ".join(str(a + size * b) for a, b in zip(low, c, strict=True))
        for i, c in enumerate(CORNERS)
    ]
    nodes = ", ".join(str(first + i) for i in range(8))
    return "*NODE\n" + "\n".join(rows) + f"\n*ELEMENT, TYPE=C3D8, ELSET=ALL\n{element}, {nodes}\n"


@pytest.fixture
def read(tmp_path):
    """Writes a deck and imports it."""

    def write(text, **options):
        path = tmp_path / "deck.inp"
        path.write_text(text)
        return read_abaqus_deck(path, **options).convert()

    return write


def reduced(model):
    """K and M without dependent dofs, and the six rigid motions of what is left."""
    free = np.flatnonzero(model.dependent.owner < 0)
    T = model.dependent.S[:, free]
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)[free]
    return (T.T @ model.K @ T).toarray(), (T.T @ model.M @ T).toarray(), R


def terms(equations, index):
    """Terms of an equation as (node, component) -> coefficient."""
    at = slice(*equations.offsets[index : index + 2])
    keys = zip(equations.term_nodes[at].tolist(), equations.term_components[at].tolist(), strict=True)
    return dict(zip(keys, equations.coefficients[at].tolist(), strict=True))


PAIR = (
    cube(1)
    + cube(11, (0.1, 0.2, 1.0), 0.6, element=2)
    + "*ELSET, ELSET=LOW\n1\n*ELSET, ELSET=HIGH\n2\n*SURFACE, NAME=BELOW\nLOW, S2\n*SURFACE, NAME=ABOVE\nHIGH, S1\n"
)


def test_tied_nodes_have_the_weights_that_calculix_gives_them(read):
    imported = read(PAIR + "*TIE, NAME=GLUE\nABOVE, BELOW\n" + SECTION)
    (tie,) = imported.equations
    labels = imported.nodes.ids
    assert tie.name == "*TIE GLUE" and labels[tie.nodes].tolist() == [11, 11, 11, 12, 12, 12, 13, 13, 13, 14, 14, 14]
    # As the spring probe reads them off ccx at (0.1, 0.2) of the face.
    first = {(int(labels[node]), c): value for (node, c), value in terms(tie, 0).items()}
    assert first == pytest.approx({(5, 0): 0.72, (6, 0): 0.08, (7, 0): 0.02, (8, 0): 0.18}, abs=1e-14)
    K, M, R = reduced(model_of(imported))
    assert np.abs(K @ R).max() < 1e-12 * np.abs(K).max()
    assert R[:, 0] @ M @ R[:, 0] == pytest.approx(7850 * (1 + 0.6**3), rel=1e-12)
    assert np.linalg.matrix_rank(K, tol=1e-9 * np.abs(K).max()) == len(K) - 6


def test_nodes_near_the_master_are_moved_to_it_and_far_ones_are_told(read):
    text = PAIR.replace("11, 0.1, 0.2, 1.0", "11, 0.1, 0.2, 1.01").replace("13, 0.7, 0.8, 1.0", "13, 0.7, 0.8, 1.3")
    imported = read(text + "*TIE, NAME=GLUE\nABOVE, BELOW\n" + SECTION, dialect="abaqus")
    place = dict(zip(imported.nodes.ids.tolist(), imported.nodes.xyz.tolist(), strict=True))
    assert place[11] == pytest.approx([0.1, 0.2, 1.0], abs=1e-12) and place[13][2] == 1.3
    assert any("3 nodes were moved to the faces they follow, by up to 0.01" in note for note in imported.notes)
    away = "1 nodes are further than 0.05 from the other surface and are not tied (13)"
    assert any(away in warning for warning in imported.warnings)
    kept = read(text + "*TIE, NAME=GLUE, ADJUST=NO, POSITION TOLERANCE=0.4\nABOVE, BELOW\n" + SECTION)
    assert kept.nodes.xyz[kept.nodes.ids == 11][0, 2] == 1.01 and len(kept.equations[0]) == 12
    assert not any("were moved" in note for note in kept.notes)
    assert any("4 nodes follow faces up to 0.3 away" in said and "[tie-gap]" in said for said in kept.warnings)
    apart = PAIR.replace(cube(11, (0.1, 0.2, 1.0), 0.6, element=2), cube(11, (0.1, 0.2, 2.0), 0.6, element=2))
    far = apart + "*TIE, NAME=G\nABOVE, BELOW\n" + SECTION
    assert refusals(lambda: read(far, dialect="abaqus")) == [("TIE", 31, ("--skip TIE",))]


# The mean distance of the centres of the two triangles of a unit square from their first edges, and its fortieth.
LIMIT = float((1 / 3 + np.sqrt(2) / 6) / 2 / 40)


@pytest.mark.parametrize(
    ("beyond", "high", "option", "dialect", "tied"),
    [
        (0.99 * LIMIT, 0.0, "", "calculix", True),
        (1.01 * LIMIT, 0.0, "", "calculix", False),
        (1.01 * LIMIT, 0.0, ", POSITION TOLERANCE=0.2", "calculix", False),
        (0.99 * LIMIT, 0.19, ", POSITION TOLERANCE=0.2", "calculix", True),
        (-0.1, 0.99 * LIMIT, "", "calculix", True),
        (-0.1, 1.01 * LIMIT, "", "calculix", False),
        (0.04, 0.0, "", "abaqus", True),
        (0.06, 0.0, "", "abaqus", False),
    ],
)
def test_nodes_beyond_the_border_of_a_master_stay_free_as_in_the_program(beyond, high, option, dialect, tied, read):
    """Limits as bisection of CalculiX 2.20 gives them: 0.0071129 beyond the border, whatever the tolerance is."""
    text = PAIR.replace("12, 0.7, 0.2, 1.0", f"12, {1 + beyond!r}, 0.2, {1 + high!r}")
    imported = read(text + f"*TIE, NAME=GLUE{option}\nABOVE, BELOW\n" + SECTION, dialect=dialect)
    assert (12 in imported.nodes.ids[imported.equations[0].nodes]) == tied
    assert tied != any("1 nodes are further than" in said and "not tied (12)" in said for said in imported.warnings)


@pytest.mark.parametrize("kind", FACES)
def test_feet_on_plane_and_curved_faces(kind):
    """Points put off a curved face along its normal come back to it."""
    face, rng = FACES[kind], np.random.default_rng(3)
    flat = np.column_stack([face.reference, np.zeros(len(face.reference))])
    bent = flat + 0.05 * np.column_stack([flat[:, 1] ** 2, flat[:, 0] * flat[:, 1], np.sin(2 * flat[:, 0])])
    s = rng.uniform(0.1, 0.4, (20, 2))
    N, dN = face.shape(s)
    legs = np.einsum("nki,kx->nix", dN, bent)
    normal = np.cross(legs[:, 0], legs[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    away = rng.uniform(-0.02, 0.02, (20, 1))
    projection = project(N @ bent + away * normal, bent, [(kind, np.arange(len(bent))[None])])
    assert projection.foot == pytest.approx(N @ bent, abs=1e-12)
    assert projection.distance == pytest.approx(np.abs(away[:, 0]), abs=1e-12)
    assert projection.weights == pytest.approx(N, abs=1e-10)
    assert projection.weights.sum(axis=1) == pytest.approx(np.ones(20))


def test_contact_is_refused_skipped_or_glued(read):
    text = PAIR + "*SURFACE INTERACTION, NAME=I\n*CONTACT PAIR, INTERACTION=I\nABOVE, BELOW\n" + SECTION
    assert refusals(lambda: read(text)) == [("CONTACT PAIR", 32, ("--contact skip",))]
    skipped = read(text, contact="skip")
    assert not skipped.equations and "*CONTACT PAIR left out as asked" in skipped.warnings[0]
    glued = read(text, contact="tie")
    assert len(glued.equations[0]) == 12 and any("contact-tied" in warning for warning in glued.warnings)
    with refusal("value", "contact", "glue"):
        read(text, contact="glue")


def test_equations_between_sets_and_along_turned_axes(read):
    text = cube(1) + "*NODE\n90, 2., 2., 2.\n*NSET, NSET=TOP\n5, 6\n*NSET, NSET=LOW\n1, 2\n" + SECTION
    three = "3\n3, 1, 1., 4, 1, -.5,\n90, 1, -.5\n"
    imported = read(text + "*EQUATION\n2\nTOP, 3, 2., LOW, 3, -1.\n" + three + "2\n1, 11, 1., 2, 11, 1.\n")
    (equations,) = imported.equations
    ids = imported.nodes.ids
    assert [(int(ids[n]), int(c)) for n, c in zip(equations.nodes, equations.components, strict=True)] == [
        (5, 2),
        (6, 2),
        (3, 0),
    ]
    assert terms(equations, 1) == {(1, 2): 0.5} and terms(equations, 2) == {(3, 0): 0.5, (8, 0): 0.5}
    # Away from the z axis at (1, 1): u_x + u_y of node 3 is sqrt(2) u_x of node 1; around it: equal motions.
    turned = read(
        text + "*NSET, NSET=C\n3\n*TRANSFORM, NSET=C, TYPE=C\n0,0,0, 0,0,1\n"
        "*EQUATION\n2\n3, 1, 1., 1, 1, -1.\n2\n3, 2, 1., 1, 2, -1.\n"
    )
    (equations,) = turned.equations
    s = np.sqrt(0.5)
    u = {0: s * 1.0 - s * 2.0, 1: s * 1.0 + s * 2.0}  # u_r = 1, u_phi = 2 of node 1's x and y
    for i, component in enumerate(equations.components.tolist()):
        given = terms(equations, i)
        assert given[0, 0] * 1.0 + given[0, 1] * 2.0 == pytest.approx(u[component])


def test_multipoint_constraints_of_two_and_three_nodes(read):
    text = cube(1) + "*NODE\n90, .25, 0., 0.\n91, 5., 5., 5.\n" + SECTION
    imported = read(text + "*MPC\nLINEAR, 90, 1, 2\nLINK, 91, 7\nPIN, 5, 8\n")
    (equations,) = imported.equations
    assert len(equations) == 3 + 1 + 3
    assert terms(equations, 0) == {(0, 0): 0.75, (1, 0): 0.25}
    link = terms(equations, 3)
    row = imported.nodes.ids.tolist().index(91)
    motion = sum(value * 0.3 for (node, _), value in link.items() if node == 6)
    assert equations.nodes[3] == row and motion == pytest.approx(3 * 0.3)
    assert refusals(lambda: read(text + "*MPC\nSTRAIGHT, 1, 2, 3\n")) == [("MPC", 21, ("--skip MPC",))]
    assert not read(text + "*MPC\nSTRAIGHT, 1, 2, 3\n", skip="MPC").equations


def test_nodes_of_sets_are_paired_by_their_labels_not_by_the_order_of_lines(read):
    loose = "*NODE\n92, 5., 0., 0.\n91, 5., 1., 0.\n*NSET, NSET=A\n91, 92\n*NSET, NSET=B\n1, 2\n"
    imported = read(cube(1) + loose + "*EQUATION\n2\nA, 1, 1., B, 1, -1.\n" + SECTION)
    (equations,) = imported.equations
    labels = imported.nodes.ids
    pairs = {int(labels[a]): int(labels[next(iter(terms(equations, i)))[0]]) for i, a in enumerate(equations.nodes)}
    assert pairs == {91: 1, 92: 2}


@pytest.mark.parametrize(
    ("lines", "pairs"),
    [
        ("*NSET, NSET=A, UNSORTED\n92, 91\n", {92: 1, 91: 2}),
        ("*NSET, NSET=A\n92, 91\n", {91: 1, 92: 2}),
        ("*NSET, NSET=C, UNSORTED\n92,\n*NSET, NSET=A, UNSORTED\nC, 91, C\n", {92: 1, 91: 2}),
        ("*NSET, NSET=A, UNSORTED, GENERATE\n91, 92\n", {91: 1, 92: 2}),
    ],
)
def test_unsorted_sets_are_paired_as_they_are_listed(lines, pairs, read):
    loose = "*NODE\n91, 5., 0., 0.\n92, 5., 1., 0.\n*NSET, NSET=B\n2, 1\n"
    for keyword in ("*EQUATION\n2\nA, 1, 1., B, 1, -1.\n", "*MPC\nPIN, A, B\n"):
        (equations,) = read(cube(1) + loose + lines + keyword + SECTION, dialect="abaqus").equations
        labels = np.array([1, 2, 3, 4, 5, 6, 7, 8, 91, 92])
        told = {int(labels[a]): int(labels[next(iter(terms(equations, i)))[0]]) for i, a in enumerate(equations.nodes)}
        assert told == pairs


@pytest.mark.parametrize(("dialect", "axis"), [("calculix", 1), ("abaqus", 0)])
def test_springs_of_calculix_act_along_global_directions(dialect, axis, read):
    """Whatever axes their nodes have, as ccx 2.20 does: frequencies within 4e-7 of its own."""
    turned = "*NSET, NSET=T\n1\n*TRANSFORM, NSET=T, TYPE=R\n0., 1., 0., -1., 0., 0.\n"
    spring = "*ELEMENT, TYPE=SPRING1, ELSET=G\n51, 1\n*SPRING, ELSET=G\n2\n70.\n"
    imported = read(cube(1) + turned + spring + SECTION, dialect=dialect)
    model, plain = model_of(imported), model_of(replace(imported, discrete=()))
    assert (model.K - plain.K).toarray().diagonal()[:3] == pytest.approx(np.eye(3)[axis] * 70.0, abs=1e-4)


def test_a_shifted_instance_takes_the_axis_of_its_coordinates_along(read):
    part = "*PART, NAME=P\n" + cube(1) + SECTION.partition("*MATERIAL")[0]
    axes = "*NSET, NSET=T\n3\n*TRANSFORM, NSET=T, TYPE=C\n0., 0., 0., 0., 0., 1.\n"
    equation = "*EQUATION\n2\n3, 1, 1., 1, 1, -1.\n"
    coefficients = []
    for shift in ("", "100., 0., 0.\n"):
        deck = part + axes + equation + "*END PART\n*ASSEMBLY, NAME=A\n*INSTANCE, NAME=I, PART=P\n" + shift
        imported = read(deck + "*END INSTANCE\n*END ASSEMBLY\n" + STEEL_LINES, dialect="abaqus")
        coefficients.append(sorted(terms(imported.equations[0], 0).values()))
    assert coefficients[0] == pytest.approx(coefficients[1], rel=1e-12)


SPRINGS = (
    cube(1) + "*NODE\n90, 1., 1., 4.\n*ELEMENT, TYPE=SPRINGA, ELSET=AX\n50, 7, 90\n*SPRING, ELSET=AX\n\n500.\n"
    "*ELEMENT, TYPE=SPRING1, ELSET=G\n51, 1,\n52, 2,\n*SPRING, ELSET=G\n2\n70.\n"
    "*ELEMENT, TYPE=SPRING2, ELSET=B\n53, 3, 90\n*SPRING, ELSET=B, NONLINEAR\n1, 3\n-8., -2.\n0., 0.\n5., 1.\n"
    "*ELEMENT, TYPE=DASHPOTA, ELSET=D\n54, 8, 90\n*DASHPOT, ELSET=D\n\n3.\n"
    "*ELEMENT, TYPE=MASS, ELSET=W\n55, 90\n*MASS, ELSET=W\n9.\n"
)


def test_springs_and_dashpots_are_entries_of_k_and_d(read):
    imported = read(SPRINGS + SECTION)
    model, plain = model_of(imported), model_of(read(cube(1) + SECTION))
    n, last = plain.size, imported.nodes.ids.tolist().index(90)
    expected = np.zeros((n + 3, n + 3))
    expected[:n, :n] = plain.K.toarray()
    at = {(int(node), int(c)): i for i, (node, c) in enumerate(zip(model.dofs.node, model.dofs.component, strict=True))}
    for a, b, value in (
        ((6, 2), (last, 2), 500.0),
        ((0, 1), None, 70.0),
        ((1, 1), None, 70.0),
        ((2, 0), (last, 2), 5.0),
    ):
        part = np.zeros(n + 3)
        part[at[a]] = 1.0
        if b is not None:
            part[at[b]] = -1.0
        expected += value * np.outer(part, part)
    assert model.K.toarray() == pytest.approx(expected, rel=1e-12, abs=1e-4)
    line = np.array([1.0, 0, 3.0]) / np.sqrt(10)
    part = np.zeros(n + 3)
    part[[at[7, c] for c in range(3)]], part[[at[last, c] for c in range(3)]] = -line, line
    assert model.D.toarray() == pytest.approx(3.0 * np.outer(part, part), abs=1e-12)
    assert model.M.toarray()[-3:, -3:] == pytest.approx(9.0 * np.eye(3))
    assert any("its slope at zero was taken" in warning for warning in imported.warnings)


@pytest.mark.parametrize(
    ("table", "slope", "force"),
    [
        ("3., -1.\n5., 0.\n9., 1.\n", 4.0, 5.0),
        ("-8., -2.\n0., 0.\n", 0.0, 0.0),
        ("1., 1.\n5., 2.\n", 0.0, 1.0),
        ("1., -3.\n5., -2.\n", 0.0, 5.0),
    ],
)
def test_a_force_at_zero_elongation_stiffens_across_its_line(table, slope, force, read):
    """k n n' + F / L (1 - n n'), as ccx has it, which holds forces beyond their tables (tests of engines compare)."""
    text = cube(1) + "*NODE\n90, 1., 1., 4.\n*ELEMENT, TYPE=SPRINGA, ELSET=AX\n50, 6, 90\n" + SECTION
    text += f"*SPRING, ELSET=AX, NONLINEAR\n\n{table}*ELEMENT, TYPE=MASS, ELSET=W\n55, 90\n*MASS, ELSET=W\n9.\n"
    line = np.array([0.0, 1.0, 3.0]) / np.sqrt(10)
    along = slope * np.outer(line, line)
    across = force / np.sqrt(10) * (np.eye(3) - np.outer(line, line))
    K = model_of(read(text, dialect="calculix")).K.toarray()[-3:, -3:]
    assert pytest.approx(along + across, rel=1e-12, abs=1e-12) == K
    imported = read(text, dialect="abaqus")
    assert model_of(imported).K.toarray()[-3:, -3:] == pytest.approx(along, rel=1e-12, abs=1e-12)
    assert any(f"a force of {force:g} at zero elongation" in said for said in imported.warnings) == bool(force)


def test_rigid_bodies_without_reference_and_distributing_elements(read):
    text = cube(1) + "*NSET, NSET=TOP\n5, 6, 7, 8\n*NODE\n90, .5, .5, 2.\n" + SECTION
    imported = read(text + "*RIGID BODY, NSET=TOP\n")
    (rigid,) = imported.rigid
    assert imported.nodes.xyz[rigid.master] == pytest.approx([0.5, 0.5, 1.0]) and imported.nodes.ids[rigid.master] == 91
    imported = read(text + "*ELEMENT, TYPE=DCOUP3D, ELSET=E\n7, 90\n*DISTRIBUTING COUPLING, ELSET=E\nTOP, 1.\n5, 3.\n")
    (mean,) = imported.average
    assert imported.nodes.ids[mean.reference] == 90 and mean.weights.tolist() == [3, 1, 1, 1]
    model = model_of(imported)
    T = average_matrix(interface_of_coupling(model, "coupling:E", name="x"), model.nodes.xyz[mean.nodes])
    dofs = np.flatnonzero(model.dofs.node == mean.reference)
    assert model.dependent.S[dofs].toarray()[:, model.dofs.of_nodes(mean.nodes).ravel()] == pytest.approx(T)


FIVE = (
    "*NODE\n" + cube(1).split("*NODE\n")[1] + "*ELEMENT, TYPE=M3D4\n8, 1, 2, 3, 4\n9, 1, 2, 3, 4\n*FANCY THING\n1.\n"
    "*SURFACE, NAME=A\nALL, S1\n*CONTACT PAIR\nA, A\n*CONTACT PAIR\nA, A\n*MPC\nMEANROT, 1, 2\n"
    "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*MATERIAL, NAME=M\n*ELASTIC\n2.E11, .3\n"
)


def test_five_problems_are_five_in_one_message_with_the_line_that_answers_them(read):
    with pytest.raises(DeckError) as told:
        read(FIVE)
    message, problems = str(told.value), told.value.problems
    assert [p.keyword for p in problems] == ["FANCY THING", "CONTACT PAIR", "CONTACT PAIR", "ELEMENT", "MPC", "DENSITY"]
    assert problems[0].line == 15 and problems[1].line == 19
    assert message.startswith("deck.inp has 6 problems: (1) deck.inp, line 15: *FANCY THING cannot be read: ")
    assert "(2) 2 times (lines 19, 21), first: deck.inp, line 19: *CONTACT PAIR" in message
    assert "--skip 'FANCY THING,M3D4,MPC' --contact skip --density X" in message
    # What the line says does it.
    imported = read(FIVE, skip="FANCY THING,M3D4,MPC", contact="skip", density=7850.0)
    assert model_of(imported).M.sum() / 3 == pytest.approx(7850.0)
    codes = [warning.rsplit("[", 1)[1].rstrip("]") for warning in imported.warnings]
    assert codes == ["keywords-skipped", "contact-skipped", *["keywords-skipped"] * 2, "density-given"]


def test_what_ends_the_reading_is_told_beside_what_was_found_before(read):
    told = refusals(lambda: read("*FANCY THING\n" + cube(1) + "*ELEMENT, TYPE=C3D4\n5, 1, 91, 92, 93\n"))
    assert told == [("FANCY THING", 1, ("--skip FANCY THING",)), ("node", 0, ())]


def test_density_is_asked_for_only_where_only_it_is_missing(read):
    text = cube(1) + "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n*MATERIAL, NAME=M\n*ELASTIC\n2.1E11, .3\n*PLASTIC\n1.,0.\n"
    bare = read(text)
    with refusal("missing", "", "*DENSITY", "--density"):
        model_of(bare)
    for density in (7850.0, {"all": 7850.0}, {"all": 1.0, "all ": 2.0, "ALL": 7850.0}):
        if isinstance(density, dict) and "all " in density:
            with refusal("unknown", "density"):
                read(text, density=density)
            continue
        imported = read(text, density=density)
        assert imported.materials[0].density == 7850.0 and "7850 was given and taken" in imported.warnings[0]
    assert read(text + "*DENSITY\n10.\n", density=7850.0).materials[0].density == 10.0
    section = "*SOLID SECTION, ELSET=ALL, MATERIAL=R\n*MATERIAL, NAME=R\n"
    rubber = read(cube(1) + section + "*HYPERELASTIC\n1.\n*DENSITY\n1.\n")
    with refusal("missing", "", "*HYPERELASTIC", "--material"):
        model_of(rubber)


def test_tables_of_temperature_give_their_first_row(read):
    text = SECTION.replace("2.1E11, .3\n", "2.1E11, .3, 20.\n1.E11, .3, 500.\n")
    imported = read(cube(1) + text)
    assert imported.materials[0].stiffness[3, 3] == pytest.approx(2.1e11 / 2.6)
    (said,) = imported.warnings
    assert said == "*ELASTIC of the material M is a table; its first line was taken [temperature-first-row]"


def test_quirks_of_text(read):
    text = (cube(1) + SECTION).replace("*SOLID SECTION", "*solidsection").replace("*ELASTIC", "*Elastic,type=ISO")
    imported = read("\ufeff" + text.replace("\n", "\r\n") + "*timepoints,name=t\r\n1.,\r\n*END\r\n*STEP\r\n*STATIC\r\n")
    assert imported.materials[0].density == 7850.0
    assert "The last step is not ended (*END STEP is missing)." in imported.notes


def test_types_of_elements_in_another_order_in_each_part_keep_their_labels(read):
    tet = "*ELEMENT, TYPE=C3D4, ELSET=TET\n7, 1, 2, 4, 5\n"
    hexa = "*ELEMENT, TYPE=C3D8, ELSET=HEX\n3, 1, 2, 3, 4, 5, 6, 7, 8\n"
    nodes = cube(1).split("*ELEMENT")[0]
    text = f"*PART, NAME=A\n{nodes}{tet}{hexa}*END PART\n*PART, NAME=B\n{nodes}{hexa}{tet}*END PART\n"
    text += "*ASSEMBLY, NAME=X\n"
    for name, move in (("A", ""), ("B", "3., 0., 0.\n")):
        text += f"*INSTANCE, NAME={name}1, PART={name}\n{move}*END INSTANCE\n"
    sets = read(text + "*END ASSEMBLY\n").mesh.element_sets
    mesh = read(text + "*END ASSEMBLY\n").mesh
    for name in ("A1.TET", "A1.HEX", "B1.TET", "B1.HEX"):
        of_type = [block.type for block, rows in zip(mesh.blocks, sets[name], strict=True) if len(rows)]
        assert of_type == ["tet4" if name.endswith("TET") else "hex8"], name


@pytest.mark.parametrize("kind", TYPES)
def test_left_handed_elements_are_reversed(kind, read):
    mesh = box(kind, (2, 1, 1), (0.3, 0.2, 0.1))
    codes = {
        "tet4": "C3D4",
        "tet10": "C3D10",
        "hex8": "C3D8",
        "hex20": "C3D20",
        "hex27": "C3D27",
        "wedge6": "C3D6",
        "wedge15": "C3D15",
    }
    nodes = mesh.nodes.ids[mesh.blocks[0].nodes]
    nodes[0] = nodes[0][mirror_of(kind)]
    places = zip(mesh.nodes.ids.tolist(), mesh.nodes.xyz.tolist(), strict=True)
    text = "*NODE\n" + "".join(f"{i}, {', '.join(map(repr, x))}\n" for i, x in places)
    text += f"*ELEMENT, TYPE={codes[kind]}, ELSET=ALL\n"
    for i, row in enumerate(nodes.tolist(), start=1):
        lines = [f"{i}, " + ", ".join(map(str, row[:10])), *[", ".join(map(str, row[10:]))] * (len(row) > 10)]
        text += ",\n".join(lines) + "\n"
    imported = read(text + SECTION)
    model = model_of(replace(imported, mesh=fully_integrated(imported.mesh)))
    assert any("1 elements are left-handed and were reversed" in warning for warning in model.warnings)
    order = np.argsort(imported.nodes.ids)
    assert (order == np.arange(len(order))).all()
    assert abs(model.K - steel(mesh).K).max() < 1e-12 * abs(steel(mesh).K).max()


GENERATED = (
    "*NODE\n1, 1., 0., 0.\n5, 0., 1., 0.\n21, 2., 0., 0.\n25, 0., 2., 0.\n*NODE\n99, 0., 0., 0.\n"
    "*NGEN, LINE=C, NSET=INNER\n1, 5, 1, 99\n*NGEN, LINE=C, NSET=OUTER\n21, 25, 1, , 0., 0., 0., 0., 0., 1.\n"
    "*NFILL, NSET=LOW\nINNER, OUTER, 2, 10\n*NCOPY, OLD SET=LOW, CHANGE NUMBER=100, SHIFT, NEW SET=UP, MULTIPLE=3\n"
    "0., 0., .5\n\n*ELEMENT, TYPE=C3D8, ELSET=ALL\n1, 1, 11, 12, 2, 101, 111, 112, 102\n"
    "*ELGEN, ELSET=ALL\n1, 4, 1, 1, 2, 10, 10, 2, 100, 100\n"
    "*ELCOPY, OLD SET=ALL, ELEMENT SHIFT=500, SHIFT NODES=100, NEW SET=MORE\n"
)


def test_generated_nodes_and_elements_are_those_of_the_rule(read):
    """A quarter of a ring, whose layers 1 and 2 are generated and whose copy is layers 2 and 3."""
    imported = read(GENERATED + SECTION)
    nodes, (block,) = imported.mesh.nodes, imported.mesh.blocks
    assert sorted(block.ids) == sorted(
        base + 100 * k + 10 * j + i + 1 for base in (0, 500) for k in (0, 1) for j in (0, 1) for i in range(4)
    )
    place = dict(zip(nodes.ids.tolist(), nodes.xyz.tolist(), strict=True))
    for k in range(4):
        for j, radius in enumerate((1.0, 1.5, 2.0)):
            for i in range(5):
                angle = i * np.pi / 8
                expected = [radius * np.cos(angle), radius * np.sin(angle), 0.5 * k]
                assert place[100 * k + 10 * j + i + 1] == pytest.approx(expected, abs=1e-12)
    last = dict(zip(block.ids.tolist(), block.nodes.tolist(), strict=True))[614]
    assert nodes.ids[last].tolist() == [214, 224, 225, 215, 314, 324, 325, 315]
    assert set(nodes.sets) == {"INNER", "OUTER", "LOW", "UP"} and len(nodes.sets["LOW"]) == 15
    assert len(nodes.sets["UP"]) == 45


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("*NGEN\n1, 3, 2, 7\n*NGEN\n1, 4, 2\n", ("unsupported", "NGEN")),
        ("*NGEN\n1, 999\n", ("unknown", "NGEN", "999")),
        ("*NGEN, LINE=P\n1, 3\n", ("conflict", "NGEN", "LINE")),
        ("*NFILL, BIAS=.5\nA, B, 2\n", ("conflict", "NFILL", "BIAS")),
        ("*NFILL\nA, 1, 2\n", ("unsupported", "NFILL", "A")),
        ("*NCOPY, OLD SET=TOP, CHANGE NUMBER=50, REFLECT=MIRROR\n0, 0, 0\n", ("conflict", "NCOPY", "REFLECT")),
        ("*NCOPY, OLD SET=TOP, CHANGE NUMBER=50\n", ("conflict", "NCOPY", "SHIFT")),
        ("*ELGEN\n7, 2, 1\n", ("unsupported", "ELGEN", "7")),
        ("*ELGEN\n1, 0, 1\n", ("value", "ELGEN")),
    ],
)
def test_what_cannot_be_generated_is_refused(lines, message, read):
    with refusal(*message, by=DeckError):
        read(cube(1) + "*NSET, NSET=TOP\n5, 6\n" + lines + SECTION)


@pytest.mark.parametrize("overlap", ["1, 2", "2,"])
def test_of_two_sections_calculix_takes_the_later_one(overlap, read):
    text = cube(1) + cube(11, (2.0, 0.0, 0.0), element=2) + f"*ELSET, ELSET=PART\n{overlap}\n" + SECTION
    text += "*SOLID SECTION, ELSET=PART, MATERIAL=N\n" + STEEL_LINES.replace("NAME=M", "NAME=N").replace("7850", "1000")
    imported = read(text, dialect="calculix")
    share = len([label for label in overlap.split(",") if label.strip()])
    along = model_of(imported).M.sum() / 3
    assert along == pytest.approx(1000 * share + 7850 * (2 - share), rel=1e-12)
    assert any("later *SOLID SECTION" in said for said in imported.warnings)
    with refusal("conflict", "", "'ALL'", "'PART'"):
        model_of(read(text, dialect="abaqus"))


def test_equations_name_rotations_by_rotation_nodes(read):
    """An equation whose first term is a rotation node makes the rotation of its reference follow."""
    text = cube(1) + "*NSET, NSET=TOP\n5, 6, 7, 8\n*NODE\n90, .5, .5, 2.\n91, .5, .5, 2.\n" + SECTION
    model = model_of(read(text + "*EQUATION\n2\n91, 3, 1., 1, 1, -4.\n*RIGID BODY, NSET=TOP, REFNODE=90, ROTNODE=91\n"))
    labels = model.nodes.ids[model.dofs.node]
    of = {(int(n), int(c)): i for i, (n, c) in enumerate(zip(labels, model.dofs.component, strict=True))}
    S = model.dependent.S
    for dof in ((91, 2), (90, 5)):
        assert S[[of[dof]]].toarray().ravel()[of[1, 0]] == 4.0 and S[[of[dof]]].nnz == 1
    # The corner 5 is 0.5 from the axis in x and in y.
    assert S[[of[5, 0]]].toarray().ravel()[of[1, 0]] == pytest.approx(2.0)


def test_a_lone_part_without_an_assembly_is_the_model(read):
    part = cube(1) + "*SOLID SECTION, ELSET=ALL, MATERIAL=M\n"
    imported = read(f"*PART, NAME=P\n{part}*END PART\n{STEEL_LINES}")
    assert len(imported.mesh.nodes) == 8 and imported.materials[0].set == "ALL"


THREE = (
    cube(1, size=2.0)
    + cube(11, (5.0, 0.0, 0.0), element=2)
    + cube(21, (5.2, 0.2, 1.0), 0.6, element=3)
    + "*ELSET, ELSET=SMALL\n3\n*ELSET, ELSET=MIDDLE\n2\n*NSET, NSET=ENDS\n1, 11\n"
    + "*SURFACE, NAME=BELOW\nMIDDLE, S2\n*SURFACE, NAME=ABOVE\nSMALL, S1\n*TIE, NAME=T\nABOVE, BELOW\n"
)


def test_parts_that_nothing_joins_become_files_of_their_own(tmp_path):
    """A block alone, and two blocks that a tie joins; split they are what each is alone."""
    (tmp_path / "deck.inp").write_text(THREE + SECTION)
    names = [str(tmp_path / "deck.inp"), "-o", str(tmp_path / "a.model.h5")]
    run = CliRunner().invoke(app, ["import", *names, "--split", "--dialect", "calculix"])
    assert run.exit_code == 0, run.output
    files = sorted(path.name for path in tmp_path.glob("*.h5"))
    assert files == ["a-1.model.h5", "a-2.model.h5"] and all(name in run.stdout for name in files)
    pair, alone = (read_model(tmp_path / name) for name in files)
    assert alone.nodes.ids.tolist() == list(range(1, 9)) and alone.source == "deck.inp (part 2 of 2)"
    assert set(alone.nodes.sets) == {"ENDS"} and alone.nodes.ids[alone.nodes.sets["ENDS"]].tolist() == [1]
    assert set(pair.mesh.element_sets) == {"ALL", "SMALL", "MIDDLE"} and pair.mesh.blocks[0].ids.tolist() == [2, 3]
    (tmp_path / "alone.inp").write_text(THREE[: THREE.index("*NODE", 5)] + SECTION)
    expected = model_of(read_abaqus_deck(tmp_path / "alone.inp", dialect="calculix").convert())
    for ours, theirs in ((alone.K, expected.K), (alone.M, expected.M)):
        assert abs(ours - theirs).max() < 1e-14 * abs(theirs).max()
    K, M, R = reduced(pair)
    assert R[:, 0] @ M @ R[:, 0] == pytest.approx(7850 * (1 + 0.6**3), rel=1e-12)
    assert np.linalg.matrix_rank(K, tol=1e-9 * np.abs(K).max()) == len(K) - 6
    assert len(pair.equations[0]) == 12


def test_a_model_in_one_part_is_not_split(tmp_path):
    (tmp_path / "deck.inp").write_text(cube(1) + SECTION)
    names = [str(tmp_path / "deck.inp"), "-o", str(tmp_path / "a.model.h5")]
    run = CliRunner().invoke(app, ["import", *names, "--split", "--dialect", "calculix"])
    assert run.exit_code == 0 and [path.name for path in tmp_path.glob("*.h5")] == ["a.model.h5"]


def test_general_contact_is_glued_between_bodies_that_touch(read):
    """Of three blocks two touch, within a twentieth of a face; the finer one follows, and the third stays apart."""
    text = cube(1, size=2.0) + cube(11, (0.3, 0.2, 2.05), 1.0, element=2) + cube(21, (0.0, 0.0, 9.0), element=3)
    text += SECTION + "*SURFACE INTERACTION, NAME=I\n*CONTACT\n*CONTACT INCLUSIONS, ALL EXTERIOR\n"
    assert refusals(lambda: read(text)) == [("CONTACT", 41, ("--contact skip",))]
    imported = read(text, contact="tie")
    (glue,) = imported.equations
    assert imported.nodes.ids[glue.nodes].tolist() == [11] * 3 + [12] * 3 + [13] * 3 + [14] * 3
    assert imported.nodes.xyz[imported.nodes.ids == 11][0] == pytest.approx([0.3, 0.2, 2.0], abs=1e-12)
    first = {int(imported.nodes.ids[node]): value for (node, _), value in terms(glue, 0).items()}
    assert first == pytest.approx({5: 0.85 * 0.9, 6: 0.15 * 0.9, 7: 0.15 * 0.1, 8: 0.85 * 0.1}, abs=1e-12)
    assert any("general contact was glued" in said and "(4 nodes)" in said for said in imported.warnings)
    apart = read(text.replace("2.05", "2.2"), contact="tie")
    assert not apart.equations and any("(0 nodes)" in said for said in apart.warnings)
