"""Native model files, and models with rigid elements, average elements, point masses and rotations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from morembs import (
    CraigBampton,
    InputError,
    Problem,
    elastic_body,
    isotropic,
    make_interface,
    make_part,
    read_deck,
    write_body,
)
from morembs.base.errors import OverwriteError
from morembs.base.units import parse_units
from morembs.body.diagnostics.warnings import list_warnings
from morembs.certificate.response import full_response
from morembs.fem import DofMap, ElementBlock, FEModel, Mesh, Nodes, skew
from morembs.fem.constraints import AverageElement, RigidElement
from morembs.fem.formulations import FORMULATIONS, MASSES
from morembs.fem.mass import mass_properties
from morembs.importers.dependent_dofs import interface_of_coupling
from morembs.importers.imported import Imported, PointMass
from morembs.importers.model_file import read_model, write_model
from morembs.importers.to_model import model_of
from morembs.storage.table import table_of
from tests.support.meshes import STEEL, box, steel, where
from tests.support.refusals import refusal

# Along x alone, bending in one plane would not touch the other.
OBLIQUE = Rotation.from_rotvec([0.3, 0.8, -0.5]).as_matrix()
UNIT = sp.eye_array(12, format="csr")
MATERIAL = isotropic(set="all", **STEEL)


def skew_inertia() -> np.ndarray:
    return np.array([[3.0, 0.2, 0.1], [0.2, 2.0, -0.3], [0.1, -0.3, 4.0]]) * 1e-2


def with_hub(extra: int = 1) -> tuple[Imported, np.ndarray, np.ndarray]:
    """A steel bar, ``extra`` loose nodes beside it, and the rows of its two ends."""
    mesh = box("hex8", (4, 1, 1), (0.4, 0.1, 0.1))
    ids = np.concatenate([mesh.nodes.ids, 900 + np.arange(extra)])
    xyz = np.vstack([mesh.nodes.xyz, [[0.5 + 0.1 * i, 0.05, 0.02] for i in range(extra)]])
    nodes = Nodes(ids=ids, xyz=xyz, sets={"END": np.flatnonzero(np.isclose(xyz[:, 0], 0.4))})
    ends = [np.flatnonzero(np.isclose(mesh.nodes.xyz[:, 0], x)) for x in (0.0, 0.4)]
    return Imported(source="bar", nodes=nodes, mesh=mesh, materials=(MATERIAL,)), ends[0], ends[1]


def assert_same(a: FEModel, b: FEModel) -> None:
    """Every array bit by bit."""
    for name in ("K", "M", "D"):
        A, B = getattr(a, name), getattr(b, name)
        assert (A is None) == (B is None)
        if A is not None:
            for part in ("data", "indices", "indptr"):
                x, y = getattr(A, part), getattr(B, part)
                assert x.dtype == y.dtype and np.array_equal(x, y), (name, part)
    assert np.array_equal(a.nodes.xyz, b.nodes.xyz) and np.array_equal(a.nodes.ids, b.nodes.ids)
    assert list(a.nodes.sets) == list(b.nodes.sets)
    assert all(np.array_equal(a.nodes.sets[n], b.nodes.sets[n]) for n in a.nodes.sets)
    assert np.array_equal(a.dofs.node, b.dofs.node) and np.array_equal(a.dofs.component, b.dofs.component)
    assert (a.mesh is None) == (b.mesh is None)
    if a.mesh is not None and b.mesh is not None:
        assert len(a.mesh.nodes) == len(b.mesh.nodes)
        for x, y in zip(a.mesh.blocks, b.mesh.blocks, strict=True):
            assert x.type == y.type and np.array_equal(x.nodes, y.nodes) and np.array_equal(x.ids, y.ids)
        assert a.mesh.element_sets.keys() == b.mesh.element_sets.keys()
        for name, rows in a.mesh.element_sets.items():
            assert all(np.array_equal(x, y) for x, y in zip(rows, b.mesh.element_sets[name], strict=True))
    for x, y in zip(a.materials, b.materials, strict=True):
        assert x.set == y.set and np.array_equal(x.stiffness, y.stiffness) and x.density == y.density
    assert (a.source, a.notes, list(a.couplings)) == (b.source, b.notes, list(b.couplings))
    if a.dependent is not None and b.dependent is not None:
        assert (a.dependent.S != b.dependent.S).nnz == 0 and a.dependent.names == b.dependent.names


def full_model() -> FEModel:
    """Everything that a file can hold."""
    bar, left, right = with_hub(2)
    mesh, none = bar.mesh, np.empty(0, dtype=np.int64)
    block = mesh.blocks[0]
    halves = tuple(replace(block, nodes=block.nodes[part], ids=block.ids[part]) for part in (slice(0, 2), slice(2, 4)))
    sets = {"HALF": (np.array([0, 1]), none), "odd/name: ä": (np.array([1]), np.array([1, 0])), "last": (none, [1])}
    return model_of(
        replace(
            bar,
            mesh=replace(mesh, blocks=halves, element_sets=sets),
            notes=("one sentence", "another"),
            rigid=(RigidElement(name="RBE2_1", master=len(mesh.nodes), slaves=right),),
            average=(
                AverageElement(name="RBE3 2", reference=len(mesh.nodes) + 1, nodes=left, weights=np.arange(1.0, 5)),
            ),
            masses=(PointMass(name="CONM2_3", node=len(mesh.nodes), mass=2.0, inertia=skew_inertia()),),
            D=None,
            surfaces={"END": right},
        )
    )


def test_everything_comes_back_bit_by_bit(tmp_path):
    model = full_model()
    path = write_model(tmp_path / "a.model.h5", model, importer="test")
    again = read_model(path)
    assert_same(model, again)
    assert write_model(tmp_path / "b.model.h5", again, importer="test").read_bytes() == path.read_bytes()
    assert "surface:END" in again.nodes.sets


def test_complex_and_unsymmetric_matrices_are_kept_but_not_reduced(tmp_path):
    rng = np.random.default_rng(3)
    K = sp.random_array((6, 6), density=0.6, rng=rng, format="csr") + 1j * sp.eye_array(6, format="csr")
    M, D = sp.eye_array(6, format="csr"), sp.random_array((6, 6), density=0.5, rng=rng, format="csr")
    nodes = Nodes(ids=[5, 7], xyz=np.array([[0.0, 0, 0], [1, 0, 0]]))
    model = model_of(Imported(source="odd.mat", K=sp.csr_array(K), M=M, D=sp.csr_array(D), nodes=nodes))
    again = read_model(write_model(tmp_path / "odd.model.h5", model))
    assert again.K.dtype == complex
    assert_same(model, again)
    for use in (list_warnings, Problem):
        with refusal("unsupported", "K", "odd.mat"):
            use(again)
    with refusal("unsupported", "K"):
        Problem(replace(again, K=sp.csr_array(K.real), D=None))
    with refusal("model", "", "K", "5", "7"):
        list_warnings(replace(again, K=sp.csr_array(K.real)))


def test_the_page_names_all_formulations_and_rules_of_the_mass():
    rows = {row.name: row.doc for row in table_of(ElementBlock)}
    assert rows["formulation"].endswith(f"one of {', '.join(FORMULATIONS)}")
    assert rows["mass"].endswith(f"one of {', '.join(MASSES)}")


def test_the_material_of_each_element_is_in_the_file(tmp_path):
    bar, _, _ = with_hub(1)
    mesh = bar.mesh
    block, none = mesh.blocks[0], np.empty(0, dtype=np.int64)
    halves = tuple(replace(block, nodes=block.nodes[part], ids=block.ids[part]) for part in (slice(0, 1), slice(1, 4)))
    sets = {"SOFT": (none, np.array([0, 2])), "HARD": (np.array([0]), np.array([1]))}
    soft, hard = (isotropic(**{**STEEL, "set": name, "young": E}) for name, E in (("SOFT", 1e9), ("HARD", 2e11)))
    imported = Imported(source="bar", mesh=replace(mesh, blocks=halves, element_sets=sets), materials=(soft, hard))
    with h5py.File(write_model(tmp_path / "two.model.h5", model_of(imported))) as file:
        names = [file["materials/sets"].asstr()[i] for i in file["elements/material"][()]]
    assert names == ["HARD", "SOFT", "HARD", "SOFT"]
    # Matrices may come with elements that have none.
    given = model_of(imported)
    bare = model_of(replace(imported, K=given.K, M=given.M, nodes=mesh.nodes, materials=(soft,)))
    with h5py.File(write_model(tmp_path / "bare.model.h5", bare)) as file:
        assert "elements/material" not in file and "elements/types" in file


def test_a_user_reads_it_with_h5py_alone(tmp_path):
    model = full_model()
    with h5py.File(write_model(tmp_path / "a.model.h5", model), "r") as file:
        group = file["matrices/K"]
        K = sp.csr_array((group["data"][:], group["indices"][:], group["indptr"][:]), shape=tuple(group["shape"][:]))
        assert group.attrs["format"] == b"csr" and (K != model.K).nnz == 0
        names = [name.decode() for name in file["node_sets/names"][:]]
        at, offsets = names.index("END"), file["node_sets/offsets"][:]
        rows = file["node_sets/rows"][offsets[at] : offsets[at + 1]]
        assert np.allclose(file["nodes/coordinates"][:][rows][:, 0], 0.4)
        assert file["format"][()] == b"morembs-model" and file["unit_system"][()] == b"SI"


def damage(path: Path, name: str, change) -> None:
    with h5py.File(path, "r+") as file:
        del file["checksums"]  # as other writers may
        values = change(file[name][()])
        del file[name]
        file[name] = values


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("matrices/K/indices", lambda v: v + 10**6, ("file",)),
        ("matrices/K/indptr", lambda v: v[::-1].copy(), ("file",)),
        ("matrices/M/data", lambda v: v * np.nan, ("file", "M")),
        ("matrices/M/data", lambda v: v[:-1], ("file",)),
        ("dofs/component", lambda v: v + 7, ("file", "a.model.h5", "6")),
        ("dofs/node", lambda v: v * 0, ("conflict", "component")),
        ("dofs/node", lambda v: v[:-1], ("file", "a.model.h5", "71", "/dofs/node")),
        ("node_sets/rows", lambda v: v + 1000, ("file", "a.model.h5", "21", "/nodes/ids")),
        ("elements/block_0/nodes", lambda v: v - 5, ("file", "a.model.h5", "-5", "19", "/elements/node_count")),
        ("element_sets/rows", lambda v: v + 99, ("value",)),
        ("couplings/coupling_0/nodes", lambda v: v + 99, ("file", "a.model.h5", "21", "/nodes/ids")),
        ("format_version", lambda v: np.int64(9), ("file", "a.model.h5")),
        ("format", lambda v: np.bytes_("another-kind"), ("file", "a.model.h5")),
    ],
)
def test_damaged_files_are_refused(tmp_path, name, change, words):
    path = write_model(tmp_path / "a.model.h5", full_model())
    damage(path, name, change)
    with refusal(*words):
        read_model(path)


def test_truncated_and_other_files_are_refused(tmp_path):
    path = write_model(tmp_path / "a.model.h5", full_model())
    data = path.read_bytes()
    for length in (0, 100, len(data) // 2, len(data) - 10):
        path.write_bytes(data[:length])
        with pytest.raises(InputError):
            read_model(path)
    with refusal("file", "missing.h5"):
        read_model(tmp_path / "missing.h5")


def test_a_body_file_in_place_of_a_model_file_is_called_so(tmp_path):
    model = steel(box("hex8", (2, 1, 1), (0.2, 0.1, 0.1)))
    with Problem(model, [make_interface(model, name="end", nodes=where(model, 0, 0.2))]) as problem:
        body = elastic_body(problem, CraigBampton(modes=2).reduce(problem), make_part(problem))
    with refusal("unsupported", "bar.h5"):
        read_model(write_body(tmp_path / "bar.h5", [body]))


def dense_rigid(xyz: np.ndarray, master: np.ndarray) -> np.ndarray:
    """[I, -x~] of each point, written down anew."""
    return np.vstack([np.hstack([np.eye(3), -skew(x - master)]) for x in xyz])


def test_rigid_element_with_mass_against_hand_built_matrices():
    bar, left, right = with_hub()
    hub = len(bar.mesh.nodes)
    masses = (
        PointMass(name="CONM2_1", node=hub, mass=3.0, inertia=skew_inertia(), offset=np.array([0.02, 0.0, -0.01])),
        PointMass(name="CONM2_2", node=int(left[0]), mass=0.5),
    )
    model = model_of(replace(bar, rigid=(RigidElement(name="R", master=hub, slaves=right),), masses=masses))
    plain = steel(bar.mesh)
    n = plain.size
    follow = (3 * right[:, None] + np.arange(3)).ravel()
    kept = np.setdiff1d(np.arange(n), follow)
    T = np.zeros((n + 6, len(kept) + 6))
    T[kept, np.arange(len(kept))] = 1
    T[n:, len(kept) :] = np.eye(6)
    T[follow, len(kept) :] = dense_rigid(bar.mesh.nodes.xyz[right], np.array([0.5, 0.05, 0.02]))
    K, M = np.zeros((n + 6, n + 6)), np.zeros((n + 6, n + 6))
    K[:n, :n], M[:n, :n] = plain.K.toarray(), plain.M.toarray()
    M[3 * left[0] + np.arange(3), 3 * left[0] + np.arange(3)] += 0.5
    S = np.hstack([np.eye(3), -skew(np.array([0.02, 0.0, -0.01]))])
    M[n:, n:] += 3.0 * S.T @ S
    M[n + 3 :, n + 3 :] += skew_inertia()
    with Problem(model) as problem:
        assert problem.K.toarray() == pytest.approx(T.T @ K @ T, rel=1e-12, abs=1e-6)
        assert problem.M.toarray() == pytest.approx(T.T @ M @ T, rel=1e-12, abs=1e-12)
        assert problem.rigid.shape[1] == 6
        # The followers move with their master in what is written for every node.
        assert problem.coupling.T.toarray() == pytest.approx(T, abs=1e-14)
        mass, center, inertia = problem.mass_properties
    total = 0.1 * 0.1 * 0.4 * STEEL["density"]
    assert mass == pytest.approx(total + 3.5, rel=1e-12)
    arms = [(total, [0.2, 0.05, 0.05]), (3.0, [0.52, 0.05, 0.01]), (0.5, bar.mesh.nodes.xyz[left[0]])]
    assert center == pytest.approx(sum(m * np.asarray(x) for m, x in arms) / (total + 3.5), rel=1e-12)
    solid = total / 12 * np.diag([0.02, 0.17, 0.17])
    tilde = [(m, skew(np.asarray(x) - center)) for m, x in arms]
    expected = solid + skew_inertia() - sum(m * a @ a for m, a in tilde)
    # Rigid motion of a consistent mass is exact.
    assert inertia == pytest.approx(expected, rel=1e-10)


def test_components_chains_and_circles():
    bar, _, right = with_hub(2)
    n = len(bar.mesh.nodes)
    # Only x and z follow: the nodes still slide along y.
    sliding = model_of(replace(bar, rigid=(RigidElement(name="R", master=n, slaves=right, components=(0, 2)),)))
    assert sliding.dependent is not None
    free = sliding.dofs.component[(sliding.dependent.owner < 0) & np.isin(sliding.dofs.node, right)]
    assert (free == 1).all() and len(free) == len(right)
    # A master that follows another: all is one rigid body about the last master.
    chain = (RigidElement(name="A", master=n, slaves=right), RigidElement(name="B", master=n + 1, slaves=np.array([n])))
    model = model_of(replace(bar, rigid=chain))
    direct = model_of(replace(bar, rigid=(RigidElement(name="B", master=n + 1, slaves=right),)))
    with Problem(model) as a, Problem(direct) as b:
        assert a.K.shape == b.K.shape
        assert sl.eigvalsh(a.K.toarray()) == pytest.approx(sl.eigvalsh(b.K.toarray()), rel=1e-9, abs=1e-3)
    with refusal("conflict", "equation"):
        model_of(replace(bar, rigid=(*chain, RigidElement(name="C", master=int(right[0]), slaves=np.array([n + 1])))))
    # Two rigid bodies that share two nodes turn about the line between them: seven motions, by rank.
    hinged = model_of(replace(bar, rigid=(chain[0], RigidElement(name="C", master=n + 1, slaves=right[:2]))))
    assert any("follows both 'A' and 'C'" in text for text in hinged.warnings)
    bodies = [node for node in range(len(hinged.nodes)) if node in {n, n + 1, *right.tolist()}]
    S = hinged.dependent.S.toarray()[np.isin(hinged.dofs.node, bodies)]
    assert np.linalg.matrix_rank(S) == 7
    with refusal("conflict", "name", "A"):
        model_of(replace(bar, rigid=(chain[0], chain[0])))


def test_average_element_adds_no_stiffness_and_spreads_mass():
    bar, _, right = with_hub()
    hub = len(bar.mesh.nodes)
    weights = np.array([1.0, 2.0, 3.0, 4.0])
    mean = AverageElement(name="RBE3_7", reference=hub, nodes=right, weights=weights)
    plain = steel(bar.mesh)
    model = model_of(replace(bar, average=(mean,)))
    with Problem(model) as problem:
        assert (problem.K != plain.K).nnz == 0 and (problem.M != plain.M).nnz == 0
    # z = (R' W R)^-1 R' W u about the reference, by normal equations.
    R, W = dense_rigid(bar.mesh.nodes.xyz[right], np.array([0.5, 0.05, 0.02])), np.diag(np.repeat(weights, 3))
    T = np.linalg.solve(R.T @ W @ R, R.T @ W)
    ready = interface_of_coupling(model, "coupling:RBE3_7", name="end")
    with Problem(model, [ready]) as problem:
        dofs = (3 * right[:, None] + np.arange(3)).ravel()
        assert pytest.approx(T, rel=1e-9, abs=1e-9) == problem.B.toarray()[dofs].T
        # The reference itself is shown where the mean is.
        assert problem.coupling.T.toarray()[-6:, dofs] == pytest.approx(T, rel=1e-9, abs=1e-9)
    loaded = model_of(
        replace(bar, average=(mean,), masses=(PointMass(name="m", node=hub, mass=3.0, inertia=skew_inertia()),))
    )
    G = np.zeros((6, 6))
    G[:3, :3], G[3:, 3:] = 3.0 * np.eye(3), skew_inertia()
    with Problem(loaded) as problem:
        expected = plain.M.toarray()
        expected[np.ix_(dofs, dofs)] += T.T @ G @ T
        assert problem.M.toarray() == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert (problem.K != plain.K).nnz == 0


def test_ready_made_interface_of_a_rigid_element_is_the_rigid_interface_there():
    bar, left, right = with_hub()
    hub = len(bar.mesh.nodes)
    model = model_of(replace(bar, rigid=(RigidElement(name="RBE2_17", master=hub, slaves=right),)))
    plain = steel(bar.mesh)
    frequencies = np.array([0.0, 100.0, 2000.0])
    ready = [
        interface_of_coupling(model, "coupling:RBE2_17", name="right"),
        make_interface(model, name="left", nodes=left),
    ]
    same = [
        make_interface(plain, name="right", nodes=right, point=[0.5, 0.05, 0.02]),
        make_interface(plain, name="left", nodes=left),
    ]
    with Problem(model, ready) as a, Problem(plain, same) as b:
        assert a.K.shape == b.K.shape
        A, B = (CraigBampton(modes=6).reduce(p) for p in (a, b))
        assert pytest.approx(B.K, rel=1e-8, abs=1e-8 * np.abs(B.K).max()) == A.K
        x, y = (full_response(p, 2 * np.pi * frequencies[1:]) for p in (a, b))
        assert x == pytest.approx(y, rel=1e-7, abs=1e-9 * np.abs(y).max())
    # The element stays rigid where no interface takes it over, and its nodes cannot be taken again.
    with Problem(model, ready[1:]) as a:
        assert a.K.shape[0] == plain.size - 3 * len(left) + 6 - 3 * len(right) + 6
        assert a.rigid.shape[1] == 6
    for coupling in ("rigid", "direct"):
        with refusal("model", "nodes", "RBE2_17"):
            Problem(model, [make_interface(model, name="x", nodes=right, coupling=coupling)])
    with refusal("unknown", "nodes", "RBE2_17"):
        interface_of_coupling(model, "coupling:RBE2_71", name="x")
    with refusal("value", "coupling"):
        interface_of_coupling(model, "coupling:RBE2_17", name="x", coupling="average")


def beam(n: int, length: float, units: str = "m-kg-s") -> Imported:
    """Oblique Bernoulli beam in space with six dofs per node, in given units."""
    E, G, rho, A, Iy, Iz, J = 2.1e11, 8.1e10, 7850.0, 4e-4, 2e-8, 1e-8, 1.5e-8
    u = parse_units(units)
    E, G, rho = E / u.stress, G / u.stress, rho / u.density
    A, Iy, Iz, J, L = A / u.length**2, Iy / u.length**4, Iz / u.length**4, J / u.length**4, length / n / u.length
    size = 6 * (n + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    bend = np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, 4 * L**2, -6 * L, 2 * L**2],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, 2 * L**2, -6 * L, 4 * L**2],
        ]
    )
    inertia = np.array(
        [
            [156, 22 * L, 54, -13 * L],
            [22 * L, 4 * L**2, 13 * L, -3 * L**2],
            [54, 13 * L, 156, -22 * L],
            [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
        ]
    )
    turn = np.diag([1.0, -1.0, 1.0, -1.0])
    for e in range(n):
        at = 6 * e + np.arange(12)
        for dofs, k, m in (
            ([0, 6], E * A / L * np.array([[1, -1], [-1, 1]]), rho * A * L / 6 * np.array([[2, 1], [1, 2]])),
            ([3, 9], G * J / L * np.array([[1, -1], [-1, 1]]), rho * (Iy + Iz) * L / 6 * np.array([[2, 1], [1, 2]])),
            ([1, 5, 7, 11], E * Iz / L**3 * bend, rho * A * L / 420 * inertia),
            ([2, 4, 8, 10], E * Iy / L**3 * turn @ bend @ turn, rho * A * L / 420 * turn @ inertia @ turn),
        ):
            K[np.ix_(at[dofs], at[dofs])] += k
            M[np.ix_(at[dofs], at[dofs])] += m
    dofs = DofMap(node=np.repeat(np.arange(n + 1), 6), component=np.tile(np.arange(6), n + 1))
    turned = np.kron(np.eye(2 * (n + 1)), OBLIQUE)
    K, M = turned @ K @ turned.T, turned @ M @ turned.T
    xyz = np.column_stack([L * np.arange(n + 1), np.zeros((n + 1, 2))]) @ OBLIQUE.T
    nodes = Nodes(ids=10 * np.arange(1, n + 2), xyz=xyz)
    K, M = sp.csr_array(K), sp.csr_array(M)
    return Imported(source="beam", K=K, M=M, D=1e-5 * K, nodes=nodes, dofs=dofs)


def test_beam_reduced_through_interfaces_with_rotations():
    model = model_of(beam(12, 1.0))
    ends = [
        make_interface(model, name="a", nodes=[0], coupling="direct"),
        make_interface(model, name="b", nodes=[12], coupling="direct", components=[1, 2, 4, 5]),
    ]
    assert ends[0].components == (0, 1, 2, 3, 4, 5)
    assert list_warnings(model) is not None
    K, M, D = (A.toarray() for A in (model.K, model.M, model.D))
    columns = [*range(6), *(6 * 12 + np.array([1, 2, 4, 5]))]
    B = np.eye(len(K))[:, columns]
    omega = 2 * np.pi * np.array([20.0, 300.0, 900.0])
    dense = np.array([B.T @ np.linalg.solve(K + 1j * w * D - w**2 * M, B) for w in omega])
    with Problem(model, ends) as problem:
        assert problem.rigid.shape[1] == 6
        assert np.array_equal(problem.B.toarray(), B)
        exact = CraigBampton(modes=len(K) - len(columns)).reduce(problem)
        V = exact.C if not exact.symmetric else exact.B.T
        computed = np.array([V @ np.linalg.solve(exact.K + 1j * w * exact.D - w**2 * exact.M, exact.B) for w in omega])
        assert computed == pytest.approx(dense, rel=1e-6, abs=1e-9 * np.abs(dense).max())
        mass, center, _ = problem.mass_properties
    assert mass == pytest.approx(7850 * 4e-4, rel=1e-12) and center == pytest.approx(OBLIQUE @ [0.5, 0, 0], abs=1e-9)
    # Free-free Bernoulli beam: beta L = 4.73004.
    f = np.sqrt(np.abs(sl.eigh(K, M, eigvals_only=True)[6])) / 2 / np.pi
    assert f == pytest.approx(4.730041**2 / 2 / np.pi * np.sqrt(2.1e11 * 1e-8 / (7850 * 4e-4)), rel=1e-4)


def test_rigid_and_average_interfaces_on_nodes_that_turn():
    model = model_of(beam(6, 1.0))
    K, M = model.K.toarray(), model.M.toarray()
    # One node that turns determines a frame; a frame beside it moves with it.
    frame = make_interface(model, name="a", nodes=[0], coupling="rigid", point=[-0.2, 0.1, 0.0])
    # The node as seen from the frame: u = R z.
    R = np.eye(6)
    R[:3, 3:] = -skew(np.array([0.2, -0.1, 0.0]))
    T = sl.block_diag(R, np.eye(36))
    A = 4e6 * M + K
    with Problem(model, [frame]) as problem:
        B = problem.B.toarray()
        response = B.T @ np.linalg.solve((4e6 * problem.M + problem.K).toarray(), B)
        assert response == pytest.approx(np.linalg.inv(T.T @ A @ T)[:6, :6], rel=1e-8)
        assert problem.rigid.shape[1] == 6
    # Two nodes that turn, rigid together: all of both follows the frame.
    pair = make_interface(model, name="a", nodes=[0, 1], coupling="rigid", point=[0.0, 0.0, 0.0])
    R = np.tile(np.eye(6), (2, 1))
    R[6:9, 3:] = -skew(model.nodes.xyz[1])
    T = np.zeros((42, 36))
    T[12:, :30], T[:12, 30:] = np.eye(30), R
    with Problem(model, [pair]) as problem:
        assert problem.K.toarray() == pytest.approx(T.T @ K @ T, rel=1e-12, abs=1e-5)
        assert problem.M.toarray() == pytest.approx(T.T @ M @ T, rel=1e-12, abs=1e-12)
    with refusal("model", "nodes"):
        make_interface(model, name="a", nodes=[0, 1, 2], coupling="average")
    solid = steel(box("hex8", (1, 1, 1), (1, 1, 1)))
    with refusal("value", "components"):
        make_interface(solid, name="a", nodes=[0], coupling="direct", components=[3])


def test_units_of_matrices_with_rotations():
    si, other = model_of(beam(5, 1.0)), model_of(beam(5, 1.0, "mm-t-s"), parse_units("mm-t-s"))
    third = model_of(beam(5, 1.0, "in-slinch-ms"), parse_units("in-slinch-ms"))
    for again in (other, third):
        for name in ("K", "M"):
            a, b = getattr(si, name).toarray(), getattr(again, name).toarray()
            assert np.abs(a - b).max(where=a != 0, initial=0) <= 1e-12 * np.abs(a).max()
            assert b[a != 0] == pytest.approx(a[a != 0], rel=1e-11)
        assert again.nodes.xyz == pytest.approx(si.nodes.xyz, rel=1e-14)
    # D = 1e-5 K in units of time: the same number is another damping in ms.
    assert other.D.toarray() == pytest.approx(si.D.toarray(), rel=1e-11)
    assert third.D.toarray() == pytest.approx(1e-3 * si.D.toarray(), rel=1e-11)


def test_units_of_meshes_materials_and_masses():
    bar, _, right = with_hub()
    u = parse_units("mm-t-s")
    hub = len(bar.mesh.nodes)
    inertia = skew_inertia() / u.mass / u.length**2
    big = PointMass(name="m", node=hub, mass=3.0, inertia=skew_inertia(), offset=np.array([0.01, 0.02, 0.03]))
    coupled = replace(bar, rigid=(RigidElement(name="R", master=hub, slaves=right),), masses=(big,))
    small = replace(
        coupled,
        nodes=replace(bar.nodes, xyz=bar.nodes.xyz / u.length),
        mesh=replace(bar.mesh, nodes=replace(bar.mesh.nodes, xyz=bar.mesh.nodes.xyz / u.length)),
        materials=(isotropic(set="all", young=2.1e11 / u.stress, poisson=0.3, density=7850 / u.density),),
        masses=(replace(big, mass=3.0 / u.mass, inertia=inertia, offset=big.offset / u.length),),
    )
    a, b = model_of(coupled), model_of(small, u)
    assert b.K.toarray() == pytest.approx(a.K.toarray(), rel=1e-9, abs=1e-4)
    assert b.M.toarray() == pytest.approx(a.M.toarray(), rel=1e-11, abs=1e-13)
    assert b.dependent.S.toarray() == pytest.approx(a.dependent.S.toarray(), abs=1e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b, n: replace(b, materials=()), ("missing",)),
        (lambda b, n: replace(b, mesh=None), ("missing", "K")),
        (lambda b, n: replace(b, masses=(PointMass(name="m", node=n, mass=1.0),)), ("model", "mass")),
        (
            lambda b, n: replace(b, masses=(PointMass(name="m", node=0, mass=1.0, inertia=np.eye(3)),)),
            ("unsupported", "mass"),
        ),
        (lambda b, n: replace(b, masses=(PointMass(name="m", node=0, mass=-1.0),)), ("value", "mass")),
        (lambda b, n: replace(b, masses=(PointMass(name="m", node=999, mass=1.0),)), ("file", "elements")),
        (lambda b, n: replace(b, rigid=(RigidElement(name="R", master=0, slaves=[0, 1]),)), ("conflict", "element")),
        (lambda b, n: replace(b, rigid=(RigidElement(name="R", master=-4, slaves=[1]),)), ("file", "elements")),
        (
            lambda b, n: replace(b, average=(AverageElement(name="A", reference=n, nodes=[0, 1, 2], weights=[1.0]),)),
            ("missing", "weights"),
        ),
        (
            lambda b, n: replace(b, average=(AverageElement(name="A", reference=n, nodes=[0, 1], weights=[1.0, 1]),)),
            ("model", "nodes"),
        ),
        (lambda b, n: replace(b, K=UNIT), ("missing", "M")),
        (lambda b, n: replace(b, M=UNIT), ("missing", "K")),
        (lambda b, n: replace(b, K=UNIT, M=UNIT), ("conflict", "nodes", "63")),
        (lambda b, n: replace(b, K=UNIT, M=UNIT[:9, :9]), ("conflict", "M")),
    ],
)
def test_contradictions_are_refused(change, words):
    bar, _, _ = with_hub()
    with refusal(*words):
        model_of(change(bar, len(bar.mesh.nodes)))


def test_matrices_without_a_map_are_taken_node_by_node_and_noted():
    plain = steel(box("hex8", (2, 1, 1), (0.2, 0.1, 0.1)))
    model = model_of(Imported(source="k.mtx", K=plain.K, M=plain.M, nodes=plain.nodes))
    assert any("node" in note for note in model.notes) and list_warnings(model) == ()
    mixed = np.arange(plain.size).reshape(-1, 3).T.ravel()
    K, M = (sp.csr_array(A[mixed][:, mixed]) for A in (plain.K, plain.M))
    with refusal("model", "", "(x", "y,", "z)"):
        list_warnings(model_of(Imported(source="k.mtx", K=K, M=M, nodes=plain.nodes)))


def test_mass_of_a_native_file(tmp_path):
    model = full_model()
    with Problem(read_model(write_model(tmp_path / "a.model.h5", model))) as problem:
        mass, _, _ = mass_properties(problem.M, problem.coupling.R, problem.coupling.pole)
    assert mass == pytest.approx(0.004 * 7850 + 2.0, rel=1e-12)
    assert where(model, 0, 0.4).size == 4 and isinstance(model.mesh, Mesh)


def test_a_model_replaces_a_model_file_and_no_file_of_another_kind(tmp_path):
    model, deck = steel(box("hex8", (1, 1, 1), (0.1, 0.1, 0.1))), tmp_path / "part.inp"
    deck.write_text("*NODE\n1, 0., 0., 0.\n")
    with h5py.File(tmp_path / "matrices.h5", "w") as file:
        file["K"] = np.eye(3)
    for name in ("part.inp", "matrices.h5"):
        before = (tmp_path / name).read_bytes()
        with refusal("output", "", name, by=OverwriteError):
            write_model(tmp_path / name, model)
        assert (tmp_path / name).read_bytes() == before
    path = write_model(tmp_path / "a.model.h5", model)
    assert_same(read_model(write_model(path, read_model(path))), model)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path, model: write_model(path, model.mesh), ("value", "model")),
        (lambda path, model: write_model(model, path), ("value", "path", "write_model")),
        (lambda path, model: write_model(path, path), ("value", "model")),
        (lambda path, model: read_model(5), ("value", "path", "read_model", "5")),
        (lambda path, model: read_deck(5), ("value", "path", "read_deck", "5")),
    ],
)
def test_arguments_of_another_kind_are_refused(call, message, tmp_path):
    with refusal(*message):
        call(tmp_path / "z.model.h5", steel(box("hex8", (1, 1, 1), (0.1, 0.1, 0.1))))
    assert not list(tmp_path.iterdir())


def test_a_deck_in_place_of_a_model_is_told_how_to_become_one(tmp_path):
    (tmp_path / "part.bdf").write_text("GRID,1,,0.,0.,0.\n")
    with refusal("value", "model", "to_model"):
        write_model(tmp_path / "z.model.h5", read_deck(tmp_path / "part.bdf"))
