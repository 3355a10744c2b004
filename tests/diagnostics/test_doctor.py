"""The doctor finds planted defects, names them, and is silent on sound models."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.units import parse_units
from morembs.body.diagnostics import complete_half_stored, examine, examine_model
from morembs.body.diagnostics.units import model_outlook
from morembs.body.diagnostics.warnings import examined_mesh
from morembs.fem import DofMap, Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.importers import read_mesh
from morembs.problem import Problem
from tests.support.diagnoses import finding, grave
from tests.support.meshes import STEEL, box, merged, points_and_cells, steel, where
from tests.support.refusals import refusal

SIZE = (0.5, 0.06, 0.04)


def bar(kind="hex8", n=(6, 2, 2), size=SIZE, **change):
    return steel(box(kind, n, size), **change)


def known(model):
    return {"nodes": model.nodes, "dofs": model.dofs}


def changed(A, entries):
    """``A`` with values added at (row, column), and at their mirror images."""
    A = A.tolil(copy=True)
    for row, column, value in entries:
        A[row, column] += value
        if row != column:
            A[column, row] += value
    return sp.csr_array(A)


def permuted(model, order):
    return sp.csr_array(model.K[order, :][:, order]), sp.csr_array(model.M[order, :][:, order])


def beam(count=8, length=1.2, radius=0.01, direction=(1.0, 0.0, 0.0)):
    """Straight beam of Euler-Bernoulli elements with six dofs per node and rotational inertia of the section."""
    E, nu, rho = 2.1e11, 0.3, 7850.0
    A, Iy, J = np.pi * radius**2, np.pi * radius**4 / 4, np.pi * radius**4 / 2
    h = length / count
    EI = (
        E
        * Iy
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
    )
    mass = [
        [156, 22 * h, 54, -13 * h],
        [22 * h, 4 * h * h, 13 * h, -3 * h * h],
        [54, 13 * h, 156, -22 * h],
        [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
    ]
    mass = rho * A * h / 420 * np.array(mass)
    k, m = np.zeros((12, 12)), np.zeros((12, 12))
    for rows, stiff, heavy in (([0, 6], E * A / h, rho * A * h), ([3, 9], E / (2 + 2 * nu) * J / h, rho * J * h)):
        k[np.ix_(rows, rows)] += stiff * np.array([[1, -1], [-1, 1]])
        m[np.ix_(rows, rows)] += heavy / 6 * np.array([[2, 1], [1, 2]])
    for rows, sign in (([1, 5, 7, 11], 1.0), ([2, 4, 8, 10], -1.0)):
        s = np.diag([1, sign, 1, sign])
        k[np.ix_(rows, rows)] += s @ EI @ s
        m[np.ix_(rows, rows)] += s @ mass @ s
    x = np.asarray(direction) / np.linalg.norm(direction)
    frame = np.linalg.qr(np.column_stack([x, np.roll(np.eye(3), 1, axis=0)[np.argmax(np.abs(x))], np.ones(3)]))[0]
    frame *= np.sign(np.linalg.det(frame)) * np.sign(frame[:, 0] @ x) ** np.array([1, 1, 0])
    frame[:, 0], frame[:, 2] = x, np.cross(x, frame[:, 1])
    T = np.kron(np.eye(4), frame)
    k, m = T @ k @ T.T, T @ m @ T.T
    K, M = np.zeros((6 * count + 6,) * 2), np.zeros((6 * count + 6,) * 2)
    for element in range(count):
        at = slice(6 * element, 6 * element + 12)
        K[at, at] += k
        M[at, at] += m
    xyz = np.linspace(0, length, count + 1)[:, None] * x
    nodes = Nodes(ids=np.arange(1, count + 2), xyz=xyz)
    dofs = DofMap(node=np.repeat(np.arange(count + 1), 6), component=np.tile(np.arange(6), count + 1))
    return sp.csr_array(K), sp.csr_array(M), nodes, dofs


def joined_boxes(shared):
    """Two boxes of steel that touch in a node (1), an edge (2) or a face (4), in the sense of x, y, z."""
    offset = {1: (2, 2, 2), 2: (2, 2, 0), 4: (2, 0, 0)}[shared]
    cells = [(i, j, k) for i in range(2) for j in range(2) for k in range(2)]
    both = cells + [tuple(np.add(cell, offset)) for cell in cells]
    return steel(merged("hex8", 0.02 * points_and_cells("hex8", both)))


# Defects


def test_half_stored_matrices_are_found_and_completed():
    model = bar()
    for which, make in (("lower", sp.tril), ("upper", sp.triu)):
        half = sp.csr_array(make(model.K)), sp.csr_array(make(model.M))
        for K, M in ((half[0], model.M), (model.K, half[1]), half):
            seen = examine(K, M, **known(model))
            assert grave(seen) == {"half-stored"} and which in finding(seen, "half-stored").sentence
        whole = complete_half_stored(*half)
        assert abs(whole[0] - model.K).max() == 0 and abs(whole[1] - model.M).max() == 0
        assert [note.code for note in whole[3]] == ["completed", "completed"] and which in whole[3][0].sentence
    assert complete_half_stored(model.K, model.M)[3] == ()
    seen = examine(half[0], half[1], **known(model), deep=True)
    assert seen.facts["mass"] == pytest.approx(7850 * np.prod(SIZE)) and seen.facts["zero_modes"] == 6
    with refusal("model", "", "K", "M", "repaired()"):
        seen.refuse_errors()


def test_a_half_in_mixed_order_is_completed():
    """One entry of each pair, above or below the diagonal: as files come whose labels are not in order."""
    model = bar()
    lower = sp.coo_array(sp.tril(model.K))
    flip = np.random.default_rng(1).random(lower.nnz) < 0.5
    row, column = lower.coords
    mixed = sp.csr_array((lower.data, (np.where(flip, column, row), np.where(flip, row, column))), shape=lower.shape)
    assert "some" in finding(examine(mixed, model.M), "half-stored").sentence
    assert abs(complete_half_stored(mixed, model.M)[0] - model.K).max() == 0


def test_a_doubled_diagonal():
    model = bar()
    K = sp.csr_array(model.K + sp.diags_array(model.K.diagonal()))
    assert grave(examine(K, model.M, **known(model))) == {"doubled-diagonal"}


@pytest.mark.parametrize("stiffness", [1e3, 1e9])
def test_grounded_nodes_are_named(stiffness):
    model = bar()
    held = [3, 17]
    K = changed(model.K, [(3 * row + a, 3 * row + a, stiffness) for row in held for a in range(3)])
    seen = examine(K, model.M, **known(model))
    grounded = finding(seen, "grounded")
    assert grave(seen) == {"grounded"} and set(grounded.where) == {str(model.nodes.ids[row]) for row in held}
    assert f"{2 * stiffness:.3g}, {2 * stiffness:.3g}, {2 * stiffness:.3g} N/m" in grounded.sentence
    # Two nodes leave the rotation about their line free.
    assert seen.facts["free_motions"] == 1


def test_constraints_that_were_eliminated_count_as_ground():
    model = bar()
    left = where(model, 0, 0.0)
    keep = np.flatnonzero(~np.isin(model.dofs.node, left))
    dofs = DofMap(node=model.dofs.node[keep], component=model.dofs.component[keep])
    K, M = permuted(model, keep)
    seen = examine(K, M, nodes=model.nodes, dofs=dofs)
    next_row = where(model, 0, SIZE[0] / 6)
    assert grave(seen) == {"grounded"}
    assert set(finding(seen, "grounded").where) == set(map(str, model.nodes.ids[next_row]))
    assert "have no dofs" in finding(seen, "grounded").cure and seen.facts["free_motions"] == 0


@pytest.mark.parametrize("order", ["component by component", "reverse", "labels"])
def test_wrong_dof_order_is_found_and_named(order):
    model = bar()
    N, n = model.size, len(model.nodes)
    rows = np.arange(N)
    nodes = model.nodes
    if order == "component by component":
        rows = rows.reshape(n, 3).T.ravel()
    elif order == "reverse":
        rows = rows[::-1]
    else:
        ids = np.random.default_rng(5).permutation(n) + 10
        nodes = Nodes(ids=ids, xyz=nodes.xyz)
        rows = model.dofs.of_nodes(np.argsort(ids)).ravel()
    K, M = permuted(model, rows)
    seen = examine(K, M, nodes=nodes, dofs=model.dofs)
    assert grave(seen) == {"dof-order"} and order in finding(seen, "dof-order").sentence
    assert seen.facts["mass"] == pytest.approx(7850 * np.prod(SIZE)) and seen.facts["free_motions"] == 6
    guessed = examine(K, M, nodes=nodes)
    assert grave(guessed) == set() and order in guessed.facts["dof_order"]


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e7, 1e10])
@pytest.mark.parametrize("mount", ["corners", "one end", "everywhere", "mean of one end"])
def test_mounts_of_a_symmetric_mesh_are_no_other_order(mount, stiffness):
    """The box is its own mirror image, so the reverse of its order fits K as well, and better where mounts count."""
    model = bar()
    xyz = model.nodes.xyz - model.nodes.xyz.mean(axis=0)
    rows = {
        "corners": np.flatnonzero((np.abs(xyz) > 0.499 * np.array(SIZE)).all(axis=1)),
        "everywhere": np.arange(len(xyz)),
    }.get(mount, np.flatnonzero(xyz[:, 0] < -0.499 * SIZE[0]))
    springs = np.full((len(rows),) * 2, 1 / len(rows)) if mount == "mean of one end" else np.eye(len(rows))
    place = sp.csr_array((np.ones(len(rows)), (rows, np.arange(len(rows)))), (len(xyz), len(rows)))
    held = sp.csr_array(sp.kron(place @ sp.csr_array(stiffness * springs) @ place.T, sp.eye_array(3)))
    for mapped in (known(model), {"nodes": model.nodes}):
        diagnosis = examine(sp.csr_array(model.K + held), model.M, **mapped)
        assert grave(diagnosis) <= {"grounded"} and not diagnosis.errors, diagnosis.text()
        assert diagnosis.facts.get("dof_order", "node by node (x").startswith("node by node (x")
        if mount != "everywhere" or stiffness > 1e3:  # else it might be numbers with few digits
            assert "grounded" in diagnosis.codes and diagnosis.facts["free_motions"] < 6


def test_a_mass_matrix_in_another_order_than_the_stiffness():
    model = bar()
    _, M = permuted(model, np.arange(model.size).reshape(-1, 3).T.ravel())
    seen = examine(model.K, M, **known(model))
    assert grave(seen) == {"mass-dof-order"} and "component by component" in finding(seen, "mass-dof-order").sentence


def test_swapped_nodes_are_named():
    model = bar(n=(8, 2, 2))
    a, b = 5, 30
    swap = np.arange(len(model.nodes))
    swap[[a, b]] = [b, a]
    rows = model.dofs.of_nodes(swap).ravel()
    K, M = permuted(model, rows)
    seen = examine(K, M, **known(model))
    mapping = finding(seen, "node-mapping")
    assert "swapped" in mapping.sentence and set(mapping.where) == {str(model.nodes.ids[a]), str(model.nodes.ids[b])}


def test_a_node_with_wrong_coordinates_is_put_right():
    model = bar(n=(8, 2, 2))
    xyz = model.nodes.xyz.copy()
    xyz[20] += [0.03, -0.01, 0.02]
    seen = examine(model.K, model.M, nodes=Nodes(ids=model.nodes.ids, xyz=xyz), dofs=model.dofs)
    mapping = finding(seen, "node-mapping")
    assert mapping.where == (str(model.nodes.ids[20]),)
    numbers = [float(word) for word in mapping.cure.split("(")[1].split(")")[0].split(",")]
    assert numbers == pytest.approx(model.nodes.xyz[20], abs=1e-5)


def test_local_axes_at_two_nodes():
    model = bar(n=(8, 2, 2))
    turn = np.eye(model.size)
    for row, angle in ((20, 0.4), (40, 1.3)):
        c, s = np.cos(angle), np.sin(angle)
        turn[3 * row : 3 * row + 3, 3 * row : 3 * row + 3] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    T = sp.csr_array(turn)
    seen = examine(sp.csr_array(T @ model.K @ T.T), sp.csr_array(T @ model.M @ T.T), **known(model))
    assert "local-axes" in grave(seen)
    assert set(finding(seen, "local-axes").where) == {str(model.nodes.ids[row]) for row in (20, 40)}


def test_empty_rows_and_dofs_that_nothing_holds():
    model = bar()
    N = model.size
    for mass, code in ((0.0, "empty-dofs"), (1.0, "no-stiffness")):
        K = sp.csr_array(sp.block_diag([model.K, sp.csr_array((3, 3))]))
        M = sp.csr_array(sp.block_diag([model.M, mass * sp.eye_array(3)]))
        nodes = Nodes(ids=np.append(model.nodes.ids, 999), xyz=np.vstack([model.nodes.xyz, [0.25, 0.03, 0.02]]))
        node, component = np.append(model.dofs.node, [len(nodes) - 1] * 3), np.append(model.dofs.component, range(3))
        dofs = DofMap(node=node, component=component)
        seen = examine(K, M, nodes=nodes, dofs=dofs)
        assert grave(seen) == {code} and finding(seen, code).where == ("999",) and K.shape[0] == N + 3


def test_unmerged_nodes():
    mesh = box("hex8", (4, 2, 2), SIZE)
    n = len(mesh.nodes)
    xyz = np.vstack([mesh.nodes.xyz, mesh.nodes.xyz + np.array([SIZE[0], 0, 0])])
    block = mesh.blocks[0]
    both = type(block)(type="hex8", nodes=np.vstack([block.nodes, block.nodes + n]), ids=np.arange(2 * len(block.ids)))
    model = steel(Mesh(nodes=Nodes(ids=np.arange(1, 2 * n + 1), xyz=xyz), blocks=(both,)))
    seen = examine_model(model)
    parts = finding(seen, "parts")
    assert grave(seen) == {"parts"} and seen.facts["parts"] == 2 and "9 pairs" in parts.sentence
    pairs = np.array(parts.where, dtype=int).reshape(-1, 2) - 1
    assert len(pairs) == 9 and np.abs(xyz[pairs[:, 0]] - xyz[pairs[:, 1]]).max() < 1e-12


def split(mesh, rows, label=777):
    """The mesh with a copy of each node of ``rows`` for the elements beyond it along x."""
    elements, xyz = mesh.blocks[0], mesh.nodes.xyz
    table = elements.nodes.copy()
    beyond = xyz[table, 0].mean(axis=1) > xyz[rows[0], 0]
    for k, row in enumerate(rows):
        table[beyond] = np.where(table[beyond] == row, len(xyz) + k, table[beyond])
    nodes = Nodes(ids=np.append(mesh.nodes.ids, label + np.arange(len(rows))), xyz=np.vstack([xyz, xyz[rows]]))
    return Mesh(nodes=nodes, blocks=(type(elements)(type=elements.type, nodes=table, ids=elements.ids),))


@pytest.mark.parametrize("count", [1, 5, 8])
def test_an_open_seam_is_named(count):
    """Up to all but one of the nodes of a section are double, which opens a crack and makes the bar softer."""
    mesh = box("hex8", (4, 2, 2), SIZE)
    rows = np.flatnonzero(np.abs(mesh.nodes.xyz[:, 0] - SIZE[0] / 2) < 1e-9)[:count]
    model = steel(split(mesh, rows))
    pairs = np.stack([mesh.nodes.ids[rows], 777 + np.arange(count)], axis=1)
    for seen in (examine_model(model, deep=True), examine(model.K, model.M, **known(model))):
        coincident = finding(seen, "coincident-nodes")
        assert coincident.severity == "warning" and grave(seen) <= {"coincident-nodes", "mechanism"}, seen.text()
        assert {frozenset(pair) for pair in np.array(coincident.where, dtype=int).reshape(-1, 2).tolist()} == {
            frozenset(pair) for pair in pairs.tolist()
        }
    (sentence,) = examined_mesh(model)
    assert f"{count} pair" in sentence and f"{pairs[0, 0]} and 777" in sentence and "merge" in sentence
    assert not examined_mesh(steel(mesh))


def test_bodies_that_touch_are_no_seam():
    """Two boxes face to face, joined by springs at their far ends only: the nodes between them may be a contact."""
    mesh = box("hex8", (2, 1, 1), SIZE)
    n, block = len(mesh.nodes), mesh.blocks[0]
    xyz = np.vstack([mesh.nodes.xyz, mesh.nodes.xyz + np.array([SIZE[0], 0, 0])])
    both = type(block)(type="hex8", nodes=np.vstack([block.nodes, block.nodes + n]), ids=np.arange(2 * len(block.ids)))
    model = steel(Mesh(nodes=Nodes(ids=np.arange(1, 2 * n + 1), xyz=xyz), blocks=(both,)))
    low, high = (np.flatnonzero(xyz[:, 0] == x) for x in (0.0, 2 * SIZE[0]))
    joined = changed(
        model.K,
        [(3 * a + c, 3 * b + c, -1e6) for a in low for b in high for c in range(3)]
        + [(3 * a + c, 3 * a + c, 4e6) for a in (*low, *high) for c in range(3)],
    )
    seen = examine(joined, model.M, **known(model), mesh=model.mesh)
    assert "coincident-nodes" not in seen.codes and finding(seen, "touching-bodies").severity == "note"
    assert not any("at one place" in sentence for sentence in examined_mesh(model))


@pytest.mark.parametrize("kind", ["hex8", "hex20", "tet10", "wedge6"])
@pytest.mark.parametrize("merged_", [True, False])
def test_elements_that_are_there_twice_are_named(kind, merged_):
    """Copies with other labels, on the same nodes in another order or on copies of these, doubled mass in silence."""
    mesh = box(kind, (3, 1, 1), SIZE)
    block, n = mesh.blocks[0], len(mesh.nodes)
    used, again = np.unique(block.nodes[1:3], return_inverse=True)
    again = block.nodes[1:3] if merged_ else n + again.reshape(2, -1)
    if kind == "hex8":
        again = again[:, [1, 2, 3, 0, 5, 6, 7, 4]]
    xyz = mesh.nodes.xyz if merged_ else np.vstack([mesh.nodes.xyz, mesh.nodes.xyz[used]])
    twice = Mesh(
        nodes=Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz),
        blocks=(block, type(block)(type=kind, nodes=again, ids=np.array([1001, 1002]))),
    )
    model = steel(twice)
    doubled = finding(examine_model(model), "double-elements")
    assert doubled.severity == "warning" and doubled.where == ("2", "1001", "3", "1002")
    assert "2 solid elements" in doubled.sentence and ("on the same nodes" if merged_ else "copies") in doubled.sentence
    assert any("2 and 1001" in sentence for sentence in examined_mesh(model))
    assert "double-elements" not in examine_model(steel(mesh)).codes


def test_many_parts_are_all_counted():
    model = bar(n=(2, 1, 1))
    K, M = (sp.csr_array(sp.block_diag([A] * 12)) for A in (model.K, model.M))
    xyz = np.vstack([model.nodes.xyz + np.array([0, part, 0]) for part in range(12)])
    nodes = Nodes(ids=np.arange(len(xyz)), xyz=xyz)
    seen = examine(K, M, nodes=nodes, dofs=DofMap.translations(len(xyz)), deep=True)
    assert grave(seen) == {"parts"} and seen.facts["parts"] == 12 and seen.facts["zero_modes"] == 72
    assert "merge" not in finding(seen, "parts").cure


def test_equal_rows_of_dofs_with_masses_of_their_own_are_a_motion():
    K = np.diag([3.0, 3.0, 5.0, 8.0]) - np.diag([-3.0, 1.0, 0.0], 1) - np.diag([-3.0, 1.0, 0.0], -1)
    K[0, 2] = K[2, 0] = -1.0
    assert not examine(sp.csr_array(K), sp.diags_array([1.0, 2.0, 3.0, 4.0]).tocsr()).errors
    assert "duplicate-dofs" in grave(examine(sp.csr_array(K), sp.csr_array(K)))


def test_a_dof_written_twice():
    model = bar()
    rows = np.append(np.arange(model.size), 40)
    K, M = permuted(model, rows)
    dofs = DofMap(node=model.dofs.node[rows], component=model.dofs.component[rows])
    assert "duplicate-dofs" in grave(examine(K, M))
    seen = examine(K, M, nodes=model.nodes, dofs=dofs)
    assert grave(seen) == {"dof-map"} and finding(seen, "dof-map").where == (str(model.nodes.ids[40 // 3]),)


def test_massless_dofs_and_a_part_without_mass():
    model = bar()
    lumped = np.asarray(model.M.sum(axis=1)).ravel()
    right = model.nodes.xyz[model.dofs.node, 0] > 0.3
    lumped[right] = 0.0
    seen = examine(model.K, sp.csr_array(sp.diags_array(lumped)), **known(model))
    expected = set(map(str, model.nodes.ids[model.nodes.xyz[:, 0] > 0.3]))
    assert grave(seen) == {"massless"} and set(finding(seen, "massless").where) == expected
    seen = examine_model(model)
    assert seen.facts["volume"] == pytest.approx(np.prod(SIZE))
    light = examine(model.K, model.M * 0.5, model.D, mesh=model.mesh, materials=model.materials, **known(model))
    assert grave(light) == {"mass-of-mesh"}


@pytest.mark.parametrize(("shared", "extra"), [(1, 3), (2, 1)])
def test_a_hinge_is_found_with_its_nodes(shared, extra):
    model = joined_boxes(shared)
    assert grave(examine_model(model)) == set()
    seen = examine_model(model, deep=True)
    hinge = np.flatnonzero((np.abs(model.nodes.xyz[:, :2] - 0.04) < 1e-9).all(axis=1) & (model.nodes.xyz[:, 2] < 0.041))
    if shared == 1:
        hinge = hinge[np.abs(model.nodes.xyz[hinge, 2] - 0.04) < 1e-9]
    assert grave(seen) == {"mechanism"} and seen.facts["zero_modes"] == 6 + extra
    assert set(finding(seen, "mechanism").where) == set(map(str, model.nodes.ids[hinge]))


def test_a_shaft_cut_in_torsion():
    """Nodes stay in place, so the rotations are named."""
    K, M, nodes, dofs = beam(count=8)
    about_x = np.flatnonzero(dofs.component == 3)
    a, b = about_x[2], about_x[3]
    k = -K[a, b]
    cut = changed(K, [(a, a, -k), (b, b, -k), (a, b, k)])
    seen = examine(cut, M, nodes=nodes, dofs=dofs, deep=True)
    mechanism = finding(seen, "mechanism")
    assert seen.facts["zero_modes"] == 7 and {label.split(" ", 2)[2] for label in mechanism.where} == {"rotation x"}


def test_units_that_do_not_fit():
    mm = (500.0, 60.0, 40.0)
    proper = bar(size=mm, young=2.1e5, density=7.85e-9)
    mixed = bar(size=mm, young=2.1e5, density=7850.0)
    assert grave(examine_model(proper)) == {"units"} and "mm-t-s" in finding(examine_model(proper), "units").cure
    assert grave(examine_model(mixed)) == {"units"} and "7.85e-9" in finding(examine_model(mixed), "units").cure
    for model in (proper, mixed):
        assert grave(examine(model.K, model.M, **known(model))) == {"units"}
    seen = examine_model(proper)
    assert grave(examine(proper.K, proper.M, **known(proper), units=parse_units("mm-t-s"))) == set()
    assert seen.facts["speed_of_sound"] == pytest.approx(5.2e6, rel=2)


@pytest.mark.parametrize(
    ("units", "young", "density", "wrong"),
    [
        ("mm-t-s", 210.0, 7.85e-9, "modulus that is a thousand times too small"),
        ("mm-t-s", 2.1e8, 7.85e-9, "modulus that is a thousand times too large"),
        ("mm-t-s", 2.1e5, 7.85e-6, "density that is a thousand times too large"),
        ("m-kg-s", 7e10, 2.7, "density that is a thousand times too small"),
        ("m-kg-s", 7e7, 2700.0, "modulus that is a thousand times too small"),
    ],
)
def test_one_number_of_a_material_in_another_unit_is_named(units, young, density, wrong):
    given = parse_units(units)
    model = bar(size=(0.5, 0.06, 0.04), young=young * given.stress, density=density * given.density)
    (found,) = [each for each in examine_model(model).findings if each.code == "units"]
    assert wrong in found.sentence
    steel_lead_rubber = {7850.0: 2.1e11, 11340.0: 1.6e10, 1200.0: 5e6}
    for density, young in steel_lead_rubber.items():
        sound = examine_model(bar(size=(0.5, 0.06, 0.04), young=young, density=density))
        assert "units" not in sound.codes


STEEL_IN = {
    "mm-t-s": (2.1e5, 7.85e-9, 500.0),
    "mm-kg-ms": (210.0, 7.85e-6, 500.0),
    "cm-g-s": (2.1e12, 7.85, 50.0),
    "in-slinch-s": (3.05e7, 7.35e-4, 20.0),
    "mm-g-ms": (2.1e5, 7.85e-3, 500.0),
}


@pytest.mark.parametrize("name", STEEL_IN)
def test_likely_units_are_named(name):
    young, density, length = STEEL_IN[name]
    model = bar(size=(length, 0.1 * length, 0.1 * length), young=young, density=density)
    for given in (known(model), {**known(model), "mesh": model.mesh, "materials": model.materials}):
        assert f'"{name}"' in finding(examine(model.K, model.M, **given), "units").cure
        assert grave(examine(model.K, model.M, **given, units=parse_units(name))) == set()


@pytest.mark.parametrize("true", ["m-kg-s", *STEEL_IN])
@pytest.mark.parametrize("wrong", ["m-kg-s", "mm-t-s"])
def test_units_declared_wrongly_are_named_with_the_right_ones(wrong, true):
    """Numbers of one system that were converted to SI as if they were of another, as an import does."""
    if wrong == true:
        return
    young, density, length = {"m-kg-s": (2.1e11, 7850.0, 0.5), **STEEL_IN}[true]
    units = parse_units(wrong)
    length *= units.length
    size = (length, 0.1 * length, 0.1 * length)
    model = bar(size=size, young=young * units.stress, density=density * units.density)
    for given in (known(model), {**known(model), "mesh": model.mesh, "materials": model.materials}):
        seen = finding(examine(model.K, model.M, **given, declared=units), "units")
        assert f"taken in {wrong} as declared" in seen.sentence and f"look like {true}" in seen.sentence
        assert f'"{true}"' in seen.cure and f"--units {true}" in seen.cure
    if (wrong, true) == ("mm-t-s", "m-kg-s"):
        unknown = finding(examine_model(model), "units")
        assert "as declared" not in unknown.sentence and f"{true} that was read as {wrong}" in unknown.sentence
        assert "again with --units m-kg-s" in unknown.cure


def test_steel_of_tonnes_read_as_kilograms_is_named():
    """Modulus and density of mm-t-s in mm-kg-s: 7.85 kg/m3 at the speed of sound of steel, which no foam reaches."""
    units = parse_units("mm-kg-s")
    model = bar(size=(0.5, 0.05, 0.05), young=2.1e5 * units.stress, density=7.85e-9 * units.density)
    given = {**known(model), "mesh": model.mesh, "materials": model.materials}
    seen = finding(examine(model.K, model.M, **given, declared=units), "units")
    assert "7.8 kg/m3" in seen.sentence and "look like mm-t-s" in seen.sentence and "--units mm-t-s" in seen.cure
    (warning,) = examined_mesh(model, units)
    assert "--units mm-t-s" in warning


@pytest.mark.parametrize(
    ("young", "density"),
    [(4e9, 100.0), (6.9e7, 16.0), (1e6, 8.0), (5e4, 3.0)],
    ids=["balsa", "honeycomb", "foam", "aerogel"],
)
def test_light_materials_are_no_fault_of_units(young, density):
    assert "units" not in examine_model(bar(size=(0.5, 0.05, 0.05), young=young, density=density)).codes


@pytest.mark.parametrize("materials", [True, False])
def test_metres_taken_for_millimetres_beside_a_proper_material(materials):
    """Speed of sound and density are right, so that nothing but the size tells: half a millimetre of steel."""
    model = bar(size=tuple(1e-3 * np.array(SIZE)))
    given = {**known(model), "declared": parse_units("mm-t-s")}
    if materials:
        given |= {"mesh": model.mesh, "materials": model.materials}
    size_finding = finding(examine(model.K, model.M, **given), "size")
    assert size_finding.severity == "warning" and "0.0005 x 6e-05 x 4e-05 m, 9.42e-09 kg" in size_finding.sentence
    assert "if its longest side is 0.5 m" in size_finding.cure and "m-kg-s" in size_finding.cure
    (sentence,) = examined_mesh(model, parse_units("mm-t-s"))
    assert "the body is tiny: 0.0005 x" in sentence and "Hz" in sentence
    assert not examined_mesh(model) and not examined_mesh(model, parse_units("um-kg-s"))
    assert not examined_mesh(bar(), parse_units("mm-t-s"))


@pytest.mark.parametrize("scale", [1e-3, 1.0])
def test_the_first_frequency_to_expect_is_about_right(scale):
    model = bar("hex20", (10, 1, 1), tuple(scale * np.array(SIZE)))
    seen = model_outlook(model.K, model.M, model.nodes, model.dofs, model.materials)
    with Problem(model, []) as problem:
        first = problem.elastic_modes(count=1).frequencies_hz[0]
    assert seen.mass == pytest.approx(7850 * np.prod(scale * np.array(SIZE)))
    assert 0.7 < seen.first_hz / first < 1.4
    plain = model_outlook(model.K, model.M, model.nodes, model.dofs, ())
    assert 0.5 < plain.first_hz / first < 2.0 and " kg; a solid bar of this size vibrates from about " in plain.words


def test_a_material_in_si_beside_millimetres():
    """Two metres or two millimetres: metres. Of 50 both cures are named, as either may be meant; 500 m are too long."""
    mm = parse_units("mm-t-s")
    for length, meters, material in ((2.0, True, False), (50.0, True, True), (500.0, False, True)):
        size = tuple(length * mm.length * np.array([1.0, 0.1, 0.1]))
        model = bar(size=size, young=2.1e11 * mm.stress, density=7850.0 * mm.density)
        seen = finding(examine(model.K, model.M, **known(model), materials=model.materials, declared=mm), "units")
        assert ("modulus 2.1e+05, density 7.85e-09" in seen.cure) == material and ('"m-kg-s"' in seen.cure) == meters


def test_any_sparse_format_and_entries_in_pieces():
    """Entries that add up, as in a file that lists elements; complex stiffness with structural damping."""
    model = bar()
    pieces = sp.vstack([model.K, model.K]).tocoo()
    row, column = pieces.coords
    K = sp.coo_array((0.5 * pieces.data, (row % model.size, column)), shape=model.K.shape)
    for A in (K, sp.csr_array(model.K).tocsc()):
        assert grave(examine(A, model.M.tocoo(), **known(model))) == set()
    raw = sp.csr_array((np.repeat(0.5 * model.K.data, 2), np.repeat(model.K.indices, 2), 2 * model.K.indptr))
    before = raw.nnz
    assert grave(examine(raw, model.M, **known(model))) == set() and raw.nnz == before
    seen = examine(model.K * (1 + 0.02j), model.M, **known(model))
    assert seen.facts["speed_of_sound"] == examine(model.K, model.M, **known(model)).facts["speed_of_sound"]
    assert seen.codes == ("complex",) and complete_half_stored(model.K * 1j, model.M)[0].dtype == complex


def test_indefinite_matrices():
    model = bar()
    N = model.size
    R = np.zeros(N)
    R[30:60] = np.random.default_rng(2).standard_normal(30)
    R *= np.sqrt(model.K.diagonal().mean()) / np.linalg.norm(R)
    inside = sp.csr_array(np.outer(R, R) * 0.6)
    plain = changed(model.K, [(40, 40, -2 * model.K[40, 40])])
    minor = changed(model.K, [(40, 41, 3 * model.K[40, 40])])
    assert "diagonal is negative" in finding(examine(plain, model.M, **known(model)), "indefinite").sentence
    assert "too large" in finding(examine(minor, model.M, **known(model)), "indefinite").sentence
    hidden = sp.csr_array(model.K - inside)
    assert sl.eigvalsh(hidden.toarray())[0] < -1e-3 * model.K.diagonal().mean() and hidden.diagonal().min() > 0
    seen = finding(examine(hidden, model.M, **known(model)), "indefinite")
    assert set(seen.where[:4]) <= set(map(str, model.nodes.ids[10:20]))
    heavy = changed(model.M, [(30, 30, -1.0)])
    seen = examine(model.K, heavy, **known(model))
    assert "M is indefinite" in finding(seen, "indefinite").sentence and finding(seen, "indefinite").where == ("11",)


@pytest.mark.parametrize("factor", [180 / np.pi, 1e3])
def test_rotations_in_degrees_or_scaled(factor):
    K, M, nodes, dofs = beam(direction=(1, 2, 2))
    T = sp.diags_array(np.where(dofs.component > 2, 1 / factor, 1.0))
    seen = examine(T @ K @ T, T @ M @ T, nodes=nodes, dofs=dofs)
    rotation_scale = finding(seen, "rotation-scale")
    assert f"{factor:.4g}" in rotation_scale.sentence and ("degrees" in rotation_scale.sentence) == (factor < 100)


def test_one_entry_without_its_mirror_image():
    model = bar()
    K = model.K.tolil()
    K[20, 22] *= 1.001
    seen = examine(sp.csr_array(K), model.M, **known(model))
    ids = model.nodes.ids
    sentence = finding(seen, "not-symmetric").sentence
    assert seen.errors
    K[20, 22] = model.K[20, 22] * (1 + 1e-7)
    rounded = examine(sp.csr_array(K), model.M, **known(model))
    assert not rounded.errors and "mean" in finding(rounded, "not-symmetric").cure
    assert "1 pairs" in sentence and f"node {ids[6]} z" in sentence and f"node {ids[7]} y" in sentence


def test_a_mass_matrix_that_belongs_to_other_coordinates():
    """A heavy offset mass puts the centre outside; a rotational inertia about one axis alone is impossible."""
    K, M, nodes, dofs = beam()
    far = M.tolil()
    rows = np.flatnonzero(dofs.node == 4)
    skewed = 50 * np.array([[0, 0, 0], [0, 0, 9.0], [0, -9.0, 0]])
    far[np.ix_(rows[:3], rows[:3])] += 50 * np.eye(3)
    far[np.ix_(rows[:3], rows[3:])] += skewed
    far[np.ix_(rows[3:], rows[:3])] += skewed.T
    far[np.ix_(rows[3:], rows[3:])] += 50 * 81.0 * np.diag([0, 1, 1]) + np.eye(3)
    seen = examine(K, sp.csr_array(far), nodes=nodes, dofs=dofs)
    assert grave(seen) == {"center-outside"}
    assert abs(seen.facts["center_of_mass"][0] - 0.6) == pytest.approx(9 * 50 / seen.facts["mass"], rel=1e-9)
    turning = changed(M, [(rows[3], rows[3], 40.0)])
    assert grave(examine(K, turning, nodes=nodes, dofs=dofs)) == {"impossible-inertia"}


def test_dampers_to_the_ground_are_noted():
    model = bar()
    D = changed(sp.csr_array(1e-6 * model.K), [(3 * 5, 3 * 5, 4.0)])
    seen = examine(model.K, model.M, D, **known(model))
    assert grave(seen) == set() and finding(seen, "grounded-damping").where == (str(model.nodes.ids[5]),)
    seen = examine(model.K, model.M, sp.csr_array(-1e-6 * model.K), **known(model))
    assert grave(seen) == {"indefinite"} and not seen.errors


@pytest.mark.parametrize("factor", [1e-200, 1e200])
def test_numbers_far_from_one_are_not_indefinite(factor):
    """Products of two diagonal entries left the range of numbers, and sound matrices were called indefinite."""
    model = bar()
    for K, M in ((model.K * factor, model.M), (model.K, model.M * factor)):
        assert "indefinite" not in examine(sp.csr_array(K), sp.csr_array(M), **known(model)).codes


def test_values_that_are_not_numbers():
    model = bar()
    K = model.K.copy()
    K.data[K.indptr[33]] = np.nan
    seen = examine(K, model.M, **known(model))
    assert grave(seen) == {"not-finite"} and finding(seen, "not-finite").where == (str(model.nodes.ids[11]),)


def test_shapes_and_maps_that_do_not_fit():
    model = bar()
    assert grave(examine(model.K, model.M[:-3, :-3], **known(model))) == {"shapes"}
    for other in (model.K[:-1], None, model.K.toarray()):
        with refusal("conflict", "K"):
            examine(other, model.M)
    elements = model.mesh.blocks[0]
    inverted = type(elements)(type="hex8", nodes=elements.nodes[:, [4, 5, 6, 7, 0, 1, 2, 3]], ids=elements.ids)
    mesh = Mesh(nodes=model.nodes, blocks=(inverted,))
    seen = examine(model.K, model.M, dofs=model.dofs, mesh=mesh, materials=model.materials)
    assert "inverted" in finding(seen, "mesh").sentence
    bad = DofMap(node=model.dofs.node, component=model.dofs.component + 5)
    assert grave(examine(model.K, model.M, nodes=model.nodes, dofs=bad)) == {"dof-map"}
    twice = Nodes(ids=np.where(model.nodes.ids == 2, 1, model.nodes.ids), xyz=model.nodes.xyz)
    assert grave(examine(model.K, model.M, nodes=twice, dofs=model.dofs)) == {"labels"}


def test_another_geometry_and_numbers_with_few_digits():
    model = bar()
    xyz = model.nodes.xyz * (1 + 0.3 * np.random.default_rng(7).random(model.nodes.xyz.shape))
    nodes = Nodes(ids=model.nodes.ids, xyz=xyz)
    assert "node-mapping" in grave(examine(model.K, model.M, nodes=nodes, dofs=model.dofs))
    rounded = sp.csr_array((np.array([float(f"{x:.4e}") for x in model.K.data]), model.K.indices, model.K.indptr))
    seen = examine(rounded, model.M, **known(model), deep=True)
    assert "few-digits" in seen.codes and grave(seen) <= {"few-digits", "not-symmetric"} and not seen.errors


# Sound models


def small():
    return bar(size=(5e-6, 2e-6, 1e-6), n=(5, 2, 2))


def ship():
    return bar("hex20", (8, 2, 2), (90.0, 10.0, 6.0))


def slender():
    return bar("hex20", (100, 1, 1), (10.0, 0.02, 0.02))


def plate():
    return bar("hex20", (10, 10, 1), (1.0, 1.0, 0.002))


def rubber_on_steel():
    mesh = box("tet10", (4, 2, 2), SIZE)
    count = len(mesh.blocks[0].ids)
    sets = {"steel": (np.arange(count // 2),), "rubber": (np.arange(count // 2, count),)}
    mesh = Mesh(nodes=mesh.nodes, blocks=mesh.blocks, element_sets=sets)
    soft = isotropic(set="rubber", young=5e6, poisson=0.48, density=1100.0)
    return assemble(mesh, [isotropic(set="steel", **STEEL), soft])


def as_input(model):
    return {
        "K": model.K,
        "M": model.M,
        "nodes": model.nodes,
        "dofs": model.dofs,
        "mesh": model.mesh,
        "materials": model.materials,
    }


def with_point_mass():
    model = bar()
    given = as_input(model)
    given["M"] = changed(model.M, [(3 * 7 + a, 3 * 7 + a, 3.0) for a in range(3)])
    return given


def with_rbe2_master():
    """Slave dofs eliminated, the master a node of its own with six dofs."""
    model = bar()
    face = where(model, 0, SIZE[0])
    frame = make_interface(model, name="end", nodes=face, point=(0.55, 0.03, 0.02))
    with Problem(model, [frame]) as problem:
        K, M, T = problem.K, problem.M, sp.csr_array(problem.coupling.T)
    n, master = len(model.nodes), problem.coupling.columns["end"]
    nodes = Nodes(ids=np.append(model.nodes.ids, 1000), xyz=np.vstack([model.nodes.xyz, frame.point]))
    node, component = np.full(K.shape[0], n), np.full(K.shape[0], -1)
    inside = np.flatnonzero(~np.isin(model.dofs.node, face))
    for row in inside:
        column = T.indices[T.indptr[row]]
        node[column], component[column] = model.dofs.node[row], model.dofs.component[row]
    frames = np.flatnonzero(component < 0)
    component[frames] = np.arange(6)
    assert len(frames) == 6 and master is not None
    return {"K": K, "M": M, "nodes": nodes, "dofs": DofMap(node=node, component=component)}


def damped():
    model = bar()
    return {**as_input(model), "D": sp.csr_array(1e-5 * model.K + 3.0 * model.M)}


def of_beams(direction):
    K, M, nodes, dofs = beam(direction=direction)
    return {"K": K, "M": M, "nodes": nodes, "dofs": dofs}


def in_single_precision():
    model = bar()
    return {**as_input(model), "K": sp.csr_array(model.K.astype(np.float32))}


def in_millimetres():
    model = bar(size=(500.0, 60.0, 40.0), young=2.1e5, density=7.85e-9)
    return {**as_input(model), "units": parse_units("mm-t-s")}


SOUND = {
    **{kind: lambda kind=kind: as_input(bar(kind)) for kind in ("hex8", "hex20", "tet4", "tet10", "wedge6", "wedge15")},
    **{make.__name__: lambda make=make: as_input(make()) for make in (small, ship, slender, plate, rubber_on_steel)},
    **{make.__name__: make for make in (with_point_mass, with_rbe2_master, damped)},
    **{make.__name__: make for make in (in_single_precision, in_millimetres)},
    "beams along x": lambda: of_beams((1.0, 0.0, 0.0)),
    "beams across": lambda: of_beams((1.0, 2.0, 2.0)),
    "joined": lambda: as_input(joined_boxes(4)),
}


@pytest.mark.parametrize("name", SOUND)
def test_silence_on_sound_models(name):
    given = SOUND[name]()
    seen = examine(**given, deep=True)
    assert seen.errors == () and seen.warnings == (), seen.text()
    assert seen.facts["zero_modes"] == 6 and seen.facts["free_motions"] == 6 and seen.facts["parts"] == 1
    seen.refuse_errors()
    # Matrices alone, without elements.
    for name in ("mesh", "materials"):
        given.pop(name, None)
    seen = examine(**given)
    assert seen.errors == () and seen.warnings == (), seen.text()


def triplets(path):
    row, column, value = np.loadtxt(path).T
    size = int(max(row.max(), column.max()))
    return sp.csr_array((value, (row.astype(int) - 1, column.astype(int) - 1)), shape=(size, size))


def test_matrices_of_calculix_and_abaqus(shared_data):
    """Connecting rod: upper triangles, no map of the dofs; frequencies as published. Block: lumped masses of Abaqus."""
    folder = shared_data / "conrod_abaqus"
    nodes = read_mesh(folder / "job_matrix_generate_conrod.inp").nodes
    K, M = triplets(folder / "conrod_ccx.sti.gz"), triplets(folder / "conrod_ccx.mas.gz")
    assert [error.code for error in examine(K, M, nodes=nodes).errors] == ["half-stored", "half-stored"]
    seen = examine(*complete_half_stored(K, M)[:2], nodes=nodes, deep=True)
    assert grave(seen) == set() and seen.facts["mass"] == pytest.approx(0.1379211513593743, rel=1e-9)
    assert seen.facts["frequencies_hz"][:3] == pytest.approx([5931.72907, 10572.56166, 13006.48953], rel=1e-6)
    folder = shared_data / "abaqus_block"
    nodes = read_mesh(folder / "blockC3D4.inp").nodes
    seen = examine(*(triplets(folder / f"blockC3D4_{name}1.mtx") for name in ("STIF", "MASS")), nodes=nodes, deep=True)
    assert grave(seen) == set() and seen.facts["mass"] == pytest.approx(11600)
    assert seen.facts["frequencies_hz"][:2] == pytest.approx([489.296266, 489.854771], rel=1e-6)


def test_facts_of_a_beam_are_those_of_the_book():
    K, M, nodes, dofs = beam(count=12, length=1.2, radius=0.01)
    seen = examine(K, M, nodes=nodes, dofs=dofs, deep=True, up_to_hz=500.0)
    A, Iy = np.pi * 1e-4, np.pi * 1e-8 / 4
    assert seen.facts["mass"] == pytest.approx(7850 * A * 1.2)
    assert seen.facts["center_of_mass"] == pytest.approx([0.6, 0, 0], abs=1e-12)
    assert seen.facts["inertia"][2, 2] == pytest.approx(7850 * A * 1.2**3 / 12, rel=1e-9)
    first = 4.730041**2 / (2 * np.pi) * np.sqrt(2.1e11 * Iy / (7850 * A * 1.2**4))
    assert seen.facts["frequencies_hz"][:2] == pytest.approx([first, first], rel=1e-4)
    values = np.sqrt(np.maximum(sl.eigh(K.toarray(), M.toarray(), eigvals_only=True), 0)) / (2 * np.pi)
    assert seen.facts["modes_below"] == int((values < 500).sum()) - 6
    # Six dofs per node are guessed too.
    assert examine(K, M, nodes=nodes).facts["free_motions"] == 6
