"""ANSYS files: .full and text matrices with their mapping, and archives (.cdb)."""

import random
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.fem import rigid_motion
from morembs.fem.assembly import assemble
from morembs.fem.material import isotropic
from morembs.importers import import_file
from morembs.importers.ansys.cdb import read_ansys
from morembs.importers.matrices.abaqus import read_abaqus_matrix
from morembs.importers.matrices.ansys_full import import_ansys_full, read_ansys_full
from morembs.importers.matrices.ansys_text import import_ansys_matrices, read_ansys_matrix
from morembs.importers.to_model import model_of
from morembs.problem import Problem
from tests.support.decks import refusals
from tests.support.mesh_decks import ARCHIVE_FORMS, ansys_archive, ansys_elements, e21
from tests.support.meshes import STEEL, box, fully_integrated, steel
from tests.support.refusals import refusal

FULL_HZ = [1283.20037, 1283.20037, 5781.97486, 6919.39888, 6919.39888, 10172.61498]
FREE_HZ = [7366.49503969, 7366.49503969, 11504.89523664, 17285.70459456, 17285.70459, 20137.193]
ROTOR_ANSYS_HZ, ROTOR_ABAQUS_HZ = 104.63701055079783, 104.6370132606291
ROTOR_HZ = [104.637011, 104.637011, 187.824087, 212.329701]


def import_ansys_cdb(path, **options):
    return read_ansys(path, **options).convert()


def hertz(K, M):
    values = scipy.linalg.eigh(K.toarray(), M.toarray(), eigvals_only=True)
    return np.sqrt(np.abs(values)) / (2 * np.pi)


# ---- .full


def record(values, flags):
    words = np.asarray(values, dtype="<i4" if flags else "<f8").tobytes()
    count = np.array([len(words) // 4], dtype="<i4").tobytes()
    return count + np.array([flags], dtype="<i4").tobytes() + words + count


INTEGER = -(2**31)


def write_full(path, matrices, labels, dof, per_node, *, changes=None, lumped=False, complex_values=False):
    """A .full file as the Programmer's Reference describes it: upper rows, the diagonal last; dof < 0 is held."""
    size = len(dof)
    header = np.zeros(160, dtype=np.int64)
    header[[0, 1, 2, 3, 4, 6, 7, 32]] = (
        -4,
        size,
        (np.array(dof) > 0).sum(),
        2,
        2,
        len(labels),
        max(per_node),
        len(labels),
    )
    standard = np.zeros(100, dtype=np.int64)
    standard[0] = 4
    used = range(1, int(max(per_node)) + 1)
    front = record(standard, INTEGER), record(header, INTEGER), record(list(used), INTEGER), record(labels, INTEGER)
    body, at = b"", sum(map(len, front))
    places = {"K": ((8, 9), 18), "M": ((33, 21), 26), "D": ((34, 39), 28)}
    for name, matrix in matrices.items():
        terms, place = places[name]
        header[place] = (at + len(body)) // 4
        if lumped and name == "M":
            header[terms[0]], header[10] = size, 1
            body += record(matrix.diagonal(), 0)
            continue
        upper = sp.csr_array(sp.triu(matrix, 1))
        header[terms[0]] = upper.nnz + size
        for i in range(size):
            row = slice(upper.indptr[i], upper.indptr[i + 1])
            values = np.append(upper.data[row], matrix[i, i])
            body += record(np.append(upper.indices[row], i) + 1, INTEGER)
            body += record(np.repeat(values, 2) if complex_values else values, 0)
    header[35] = (at + len(body)) // 4
    body += record(per_node, INTEGER) + record(dof, INTEGER)
    for place, value in (changes or {}).items():
        header[place] = value
    front = (*front[:1], record(header, INTEGER), *front[2:])
    path.write_bytes(b"".join(front) + body)
    return path


def write_nodes(path, ids, xyz):
    path.write_text("".join(f"{i} {x!r} {y!r} {z!r}\n" for i, (x, y, z) in zip(ids, xyz.tolist(), strict=True)))
    return path


@pytest.fixture(scope="module")
def model():
    return steel(box("hex8", (3, 2, 2), (0.3, 0.2, 0.1)))


def shuffled(model, seed=1):
    """The model with its nodes in another order: matrices, labels, and K, M by ascending label."""
    n = len(model.nodes)
    order = np.random.default_rng(seed).permutation(n)
    labels = 10 * (order + 1)
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    return {"K": model.K[rows][:, rows], "M": model.M[rows][:, rows]}, labels


def test_full_file_of_ansys(shared_data):
    folder = shared_data / "mapdl_reader"
    full = read_ansys_full(folder / "file.full")
    assert hertz(full.K, full.M)[:6] == pytest.approx(FULL_HZ, abs=6e-6)
    assert full.K.shape == (900, 900) and len(full.constrained) == 63 and full.D is None and not full.lumped
    with refusal("unsupported", "supports", "63"):
        import_ansys_full(folder / "file.full", nodes=folder / "HexBeam.cdb")
    grounded = import_ansys_full(folder / "file.full", nodes=folder / "HexBeam.cdb", drop_constrained=True)
    assert "grounded" in grounded.notes[0] and "63" in grounded.notes[0]
    for word in ("True", "true"):
        options = {"nodes": str(folder / "HexBeam.cdb"), "drop_constrained": word}
        assert import_file(folder / "file.full", options=options).notes == grounded.notes
    with refusal("value", "drop_constrained"):
        import_file(folder / "file.full", options={**options, "drop_constrained": "yes"})
    clamped = grounded.nodes.sets.get("NCOMP2")
    assert clamped is not None and len(grounded.nodes) == 300 and len(grounded.dofs) == 900


def test_full_file_against_the_library(shared_data):
    reader = pytest.importorskip("ansys.mapdl.reader")
    path = shared_data / "mapdl_reader" / "file.full"
    library = reader.read_binary(str(path))
    dofs, K, M = library.load_km(sort=True)
    free = np.flatnonzero(M.diagonal() > 0)
    own = read_ansys_full(path)
    assert np.array_equal(np.column_stack([own.node, own.component]), dofs[free])
    assert np.array_equal(np.unique(own.constrained, axis=0), np.unique(library.const, axis=0))
    for ours, theirs in ((own.K, K), (own.M, M)):
        upper = sp.csr_array(sp.csr_array(theirs)[free][:, free])
        assert abs(ours - (upper + sp.triu(upper, 1).T)).max() == 0


def test_full_file_of_a_free_model(model, tmp_path):
    matrices, labels = shuffled(model)
    matrices["D"] = 1e-6 * matrices["K"] + 2.0 * matrices["M"]
    n = len(labels)
    path = write_full(tmp_path / "free.full", matrices, labels, np.tile([1, 2, 3], n), [3] * n)
    nodes = write_nodes(tmp_path / "n.lis", 10 * np.arange(1, n + 1), model.nodes.xyz)
    imported = import_ansys_full(path, nodes=nodes)
    assert abs(imported.K - model.K).max() == 0 and abs(imported.M - model.M).max() == 0
    assert abs(imported.D - (1e-6 * model.K + 2.0 * model.M)).max() <= 1e-15 * abs(model.K).max()
    assert imported.nodes.ids.tolist() == (10 * np.arange(1, n + 1)).tolist() and imported.dofs.is_solid
    assert imported.notes == ()
    R = rigid_motion(imported.nodes.xyz[imported.dofs.node], imported.dofs.component)
    assert np.diag(R.T @ imported.M @ R)[:3] == pytest.approx([STEEL["density"] * 0.3 * 0.2 * 0.1] * 3)
    with refusal("missing", "nodes"):
        import_ansys_full(path)


def test_full_file_with_lumped_mass_or_without_mass(model, tmp_path):
    matrices, labels = shuffled(model)
    n = len(labels)
    dof = np.tile([1, 2, 3], n)
    lumped = sp.csr_array(sp.diags_array(np.arange(1.0, 3 * n + 1)))
    read = read_ansys_full(
        write_full(tmp_path / "l.full", {"K": matrices["K"], "M": lumped}, labels, dof, [3] * n, lumped=True)
    )
    by_label = np.argsort(np.repeat(labels, 3), kind="stable")
    assert read.lumped and read.M.diagonal().tolist() == (by_label + 1.0).tolist() and read.M.nnz == 3 * n
    static = write_full(tmp_path / "s.full", {"K": matrices["K"]}, labels, dof, [3] * n)
    nodes = write_nodes(tmp_path / "n.lis", 10 * np.arange(1, n + 1), model.nodes.xyz)
    assert "no mass matrix" in import_ansys_full(static, nodes=nodes).notes[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({0: 4}, ("unsupported",)),
        ({13: 1}, ("unsupported",)),
        ({62: 1}, ("unsupported",)),
        ({4: 1}, ("unsupported",)),
        ({20: 6}, ("unsupported", "", "6")),
        ({1: 10**9}, ("file", "", "1000000000")),
        ({8: 2**31 - 1}, ("file", "", "2147483647")),
        ({8: 5}, ("file", "", "5")),
        ({18: 7}, ("file",)),
    ],
)
def test_full_files_that_are_refused(model, tmp_path, changes, message):
    matrices, labels = shuffled(model)
    n = len(labels)
    path = write_full(tmp_path / "x.full", matrices, labels, np.tile([1, 2, 3], n), [3] * n, changes=changes)
    with refusal(*message):
        read_ansys_full(path)


def test_entries_given_twice_in_a_full_file_are_refused(model, tmp_path):
    matrices, labels = shuffled(model)
    n = len(labels)
    path = write_full(tmp_path / "x.full", matrices, labels, np.tile([1, 2, 3], n), [3] * n)
    row = sp.csr_array(sp.triu(matrices["K"], 1)).indices[: np.diff(sp.csr_array(sp.triu(matrices["K"], 1)).indptr)[0]]
    given = record(np.append(row, 0) + 1, INTEGER)
    repeated = record(np.append(np.where(row == row[1], row[0], row), 0) + 1, INTEGER)
    assert path.read_bytes().count(given) >= 1
    path.write_bytes(path.read_bytes().replace(given, repeated, 1))
    with refusal("file", "", "x.full", "19", "20"):
        read_ansys_full(path)


def test_complex_and_thermal_full_files_are_refused(model, tmp_path):
    matrices, labels = shuffled(model)
    n = len(labels)
    dof = np.tile([1, 2, 3], n)
    with refusal("unsupported", "", "c.full", "K"):
        read_ansys_full(write_full(tmp_path / "c.full", matrices, labels, dof, [3] * n, complex_values=True))
    with refusal("unsupported", "dofs", "4"):
        read_ansys_full(write_full(tmp_path / "t.full", matrices, labels, dof, [4] + [3] * (n - 1)))


# ---- text matrices


def test_rotor_of_ansys_and_abaqus(shared_data):
    folder = shared_data / "ansys_rotor"
    imported = import_ansys_matrices(
        folder / "rotorAnsysStiffnessMatrixSparse.txt",
        mass=folder / "rotorAnsysMassMatrixSparse.txt",
        mapping=folder / "rotorAnsysMatrixDofMappingVector.txt",
        nodes=folder / "rotorAnsysNodalCoordinates.txt",
    )
    frequencies = hertz(imported.K, imported.M)
    assert frequencies[6] == pytest.approx(ROTOR_ANSYS_HZ, rel=1e-9)
    assert frequencies[6:10] == pytest.approx(ROTOR_HZ, abs=1e-6) and imported.notes == ()
    K, M = (read_abaqus_matrix(folder / f"rotorDiscTest{kind}1.mtx").matrix for kind in ("STIF", "MASS"))
    assert hertz(0.01 * K, M)[6] == pytest.approx(ROTOR_ABAQUS_HZ, rel=1e-9)


def test_rotor_in_a_wrong_order_or_without_mapping(shared_data, tmp_path):
    folder = shared_data / "ansys_rotor"
    K, M = (folder / f"rotorAnsys{name}MatrixSparse.txt" for name in ("Stiffness", "Mass"))
    with refusal("missing", "mapping", "HBMAT"):
        import_ansys_matrices(K, mass=M)
    table = (folder / "rotorAnsysMatrixDofMappingVector.txt").read_bytes()
    (tmp_path / "m").write_bytes(table.replace(b"\n3\n31\n", b"\n31\n3\n"))
    with refusal("model", "nodes"):
        import_ansys_matrices(K, mass=M, mapping=tmp_path / "m", nodes=folder / "rotorAnsysNodalCoordinates.txt")


def market(path, matrix, symmetric=True):
    part = sp.coo_array(sp.tril(matrix) if symmetric else matrix)
    lines = [f"{i + 1} {j + 1} {v:.15E}\n" for i, j, v in zip(*part.coords, part.data, strict=True)]
    kind = "symmetric" if symmetric else "general"
    size = f"{matrix.shape[0]} {matrix.shape[1]} {part.nnz}\n"
    path.write_text(f"%%MatrixMarket matrix coordinate real {kind}\n% Creator: ANSYS Inc\n{size}" + "".join(lines))
    return path


def boeing(path, matrix, per_line=1, symmetric=True):
    part = sp.csc_array(sp.tril(matrix) if symmetric else matrix)
    part.sort_indices()

    def lines(values, width, text, count):
        rows = [values[i : i + count] for i in range(0, len(values), count)]
        return ["".join(format(v, text).rjust(width) for v in row).replace("E", "D") + "\n" for row in rows]

    sections = [
        lines(part.indptr + 1, 14, "d", 1),
        lines(part.indices + 1, 14, "d", 1),
        lines(part.data, 23, ".16E", per_line),
    ]
    counts = [len(section) for section in sections]
    head = "Stiffness matrix".ljust(72) + "KEY\n" + "".join(f"{c:14d}" for c in (sum(counts), *counts, 0)) + "\n"
    head += f"{'RSA' if symmetric else 'RUA'}{'':11}{matrix.shape[0]:14d}{matrix.shape[1]:14d}{part.nnz:14d}{0:14d}\n"
    head += "(1I14)          (1I14)          " + f"({per_line}D23.16)\n"
    path.write_text(head + "".join(line for section in sections for line in section))
    return path


@pytest.mark.parametrize(("per_line", "symmetric"), [(1, True), (3, True), (1, False)])
def test_harwell_boeing_with_its_mapping(model, tmp_path, per_line, symmetric):
    matrices, labels = shuffled(model)
    K, M = (boeing(tmp_path / name, matrices[name], per_line, symmetric) for name in "KM")
    rows = [(label, dof) for label in labels for dof in ("UX", "UY", "UZ")]
    text = "  Matrix Eqn     Node     DOF\n" + "".join(
        f"{i:10d}{n:10d}   {d}\n" for i, (n, d) in enumerate(rows, start=1)
    )
    (tmp_path / "K.mapping").write_text(text)
    nodes = write_nodes(tmp_path / "n.lis", 10 * np.arange(1, len(labels) + 1), model.nodes.xyz)
    imported = import_ansys_matrices(K, mass=M, mapping=tmp_path / "K.mapping", nodes=nodes)
    # 17 digits are printed.
    assert abs(imported.K - model.K).max() <= 1e-15 * abs(model.K).max() and imported.dofs.is_solid
    assert abs(imported.M - model.M).max() <= 1e-15 * abs(model.M).max() and imported.notes == ()
    (tmp_path / "K.mapping").write_text(text.replace("       2  ", "       1  "))
    with refusal("file", "mapping"):
        import_ansys_matrices(K, mass=M, mapping=tmp_path / "K.mapping", nodes=nodes)


def test_solver_order_by_nod2solv(model, tmp_path):
    """Solver order differs from the internal order; with supports, dofs are missing and the body is held."""
    matrices, labels = shuffled(model)
    n = 3 * len(labels)
    nodes = write_nodes(tmp_path / "n.lis", 10 * np.arange(1, len(labels) + 1), model.nodes.xyz)
    (tmp_path / "back").write_text(
        f"%%MatrixMarket matrix array integer general\n{len(labels)} 1\n" + "".join(f"{label}\n" for label in labels)
    )
    solver = np.random.default_rng(2).permutation(n)
    for kept, words in (
        (solver, ("model", "nodes", "HBMAT", "NOD2SOLV")),
        (solver[5:], ("file", "mapping", "back", n - 5, "NOD2SOLV")),
    ):
        choice = sp.csr_array((np.ones(len(kept)), (np.arange(len(kept)), kept)), shape=(len(kept), n))
        K, M = (market(tmp_path / name, matrices[name][kept][:, kept]) for name in "KM")
        files = {"mass": M, "mapping": tmp_path / "back", "nodes": nodes}
        to_solver = market(tmp_path / "map", choice, symmetric=False)
        imported = import_ansys_matrices(K, nod2solv=to_solver, **files)
        rows = 3 * imported.dofs.node + imported.dofs.component
        assert len(rows) == len(kept)
        assert abs(imported.K - model.K[rows][:, rows]).max() <= 1e-15 * abs(model.K).max()
        assert (len(imported.notes) == 1 and "held to the ground" in imported.notes[0]) == (len(kept) < n)
        vector = np.zeros(n, dtype=int)
        vector[kept] = np.arange(1, len(kept) + 1)
        (tmp_path / "v").write_text(
            f"%%MatrixMarket matrix array integer general\n{n} 1\n" + "\n".join(map(str, vector)) + "\n"
        )
        assert abs(import_ansys_matrices(K, nod2solv=tmp_path / "v", **files).K - imported.K).max() == 0
        with refusal(*words):
            import_ansys_matrices(K, **files)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("symmetric", "hermitian", ("unsupported",)),
        ("coordinate", "pattern", ("file", "K.mtx")),
        ("real", "complex", ("unsupported",)),
        ("\n36 36 ", "\n99999999 99999999 ", ("file", "", "99999999")),
        ("\n2 1 ", "\n1 2 ", ("file",)),
        ("\n3 1 ", "\n37 1 ", ("file", "K.mtx", "37", "36")),
    ],
)
def test_damaged_market_files(tmp_path, old, new, message):
    path = market(tmp_path / "K.mtx", steel(box("hex8", (2, 1, 1), (2.0, 1.0, 1.0))).K)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with refusal(*message):
        read_ansys_matrix(path)


# ---- archives


def write(tmp_path, text):
    path = tmp_path / "model.cdb"
    path.write_text(text)
    return path


def hex_deck(**options):
    return ansys_archive(box("hex8", (2, 1, 1), (2.0, 1.0, 1.0)), **options)


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("form", ARCHIVE_FORMS)
@pytest.mark.parametrize(
    ("kind", "tets"),
    [("hex8", 0), ("hex20", 0), ("wedge6", 0), ("wedge15", 0), ("tet4", 0), ("tet10", 187), ("tet10", 95)],
)
def test_every_solid_and_its_degenerate_forms(tmp_path, kind, tets, form, plain):
    """K of the archive is K of the mesh that it was written from."""
    mesh = box(kind, (2, 1, 1), (0.2, 0.1, 0.1), lambda x: x - [0.1, 0.3, 0.2])
    imported = import_ansys_cdb(write(tmp_path, ansys_archive(mesh, form=form, plain=plain, tets=tets)))
    assert imported.nodes.ids.tolist() == (101 + np.arange(len(mesh.nodes))).tolist()
    assert imported.nodes.xyz == pytest.approx(mesh.nodes.xyz, abs=1e-13)
    assert [block.type for block in imported.mesh.blocks] == [kind]
    ours, theirs = steel(fully_integrated(imported.mesh)), steel(mesh)
    assert abs(ours.K - theirs.K).max() <= 1e-11 * abs(theirs.K).max()


def test_archives_of_ansys_against_the_library(shared_data):
    library = pytest.importorskip("mapdl_archive")
    for name in ("HexBeam", "TetBeam", "sector"):
        path = shared_data / "mapdl_reader" / f"{name}.cdb"
        theirs, ours = library.Archive(str(path), parse_vtk=False), import_ansys_cdb(path)
        by_label = dict(zip(theirs.nnum.tolist(), theirs.nodes.tolist(), strict=True))
        assert ours.nodes.xyz == pytest.approx(np.array([by_label[i] for i in ours.nodes.ids.tolist()]), abs=1e-13)
        elements = {int(row[8]): set(row[10:].tolist()) for row in theirs.elem}
        for block in ours.mesh.blocks:
            for label, nodes in zip(block.ids.tolist(), ours.nodes.ids[block.nodes].tolist(), strict=True):
                assert set(nodes) == elements.pop(label) - {-1}
        assert not elements
        for key, labels in theirs.node_components.items():
            assert set(ours.nodes.ids[ours.nodes.sets[key]]) == set(labels) & set(ours.nodes.ids)
        for key, labels in theirs.element_components.items():
            members = [b.ids[rows] for b, rows in zip(ours.mesh.blocks, ours.mesh.element_sets[key], strict=True)]
            assert set(np.concatenate(members)) == set(labels)


def test_beam_against_frequencies_of_ansys(shared_data):
    """SOLID186 with 8 points for the stiffness and 14 for the mass, by the modes of ANSYS itself."""
    mesh = import_ansys_cdb(shared_data / "mapdl_reader" / "HexBeam.cdb")
    assert len(mesh.nodes) == 321 and mesh.materials[0].density == 2700 and mesh.notes == ()
    stiffness = isotropic(set="all", young=7e10, poisson=0.35, density=2700.0).stiffness
    assert mesh.materials[0].stiffness == pytest.approx(stiffness)
    material = isotropic(set="material 1", young=16.9e6, poisson=0.31, density=4.1408e-4)
    with Problem(assemble(mesh.mesh, [material])) as problem:
        frequencies = problem.elastic_modes(count=6).frequencies_hz
    assert frequencies == pytest.approx(FREE_HZ, rel=1e-8)


def components(*given):
    """CMBLOCK commands of (name, kind, numbers)."""
    return "".join(
        f"CMBLOCK,{name:8s},{kind},{len(numbers):8d}  ! users component definition\n(8i10)\n"
        + "".join("".join(f"{v:10d}" for v in numbers[i : i + 8]) + "\n" for i in range(0, len(numbers), 8))
        for name, kind, numbers in given
    )


def test_components_with_ranges_and_what_is_left_out(tmp_path):
    blocks = components(
        ("ENDS", "NODE", [101, 103, -106, 108]),
        ("MANY", "NODE", [*range(101, 111), 112]),
        ("BOTH", "ELEM", [1, -2]),
        ("LAST", "ELEMENT", [2]),
        ("FACES", "AREA", [1]),
    )
    after = blocks + "D,101,UX,0.0\nD,101,UY,0.0\nF,102,FX,1.0,0.0\n/UNITS,MPA\nCM,PICKED,NODE\n"
    imported = import_ansys_cdb(write(tmp_path, hex_deck(after=after)))
    sets = {name: imported.nodes.ids[rows].tolist() for name, rows in imported.nodes.sets.items()}
    assert sets == {"ENDS": [101, 103, 104, 105, 106, 108], "MANY": [*range(101, 111), 112]}
    assert [rows.tolist() for rows in imported.mesh.element_sets["BOTH"]] == [[0, 1]]
    assert [rows.tolist() for rows in imported.mesh.element_sets["LAST"]] == [[1]]
    for words in ("2 supports (D) were not applied", "nodal forces", "MPA", "CM,PICKED", "FACES", "no EX and no DENS"):
        lacking = [lack.sentence for lack in imported.incomplete.values()]
        assert sum(words in note for note in (*imported.notes, *lacking)) == 1, words


def test_materials_isotropic_and_orthotropic(tmp_path):
    """Strains under stress along one axis, by the definitions of PRXY (major) and NUXY (minor)."""
    e, major, g = (1.2e11, 9e9, 8e9), (0.3, 0.25, 0.2), (5e9, 4e9, 3e9)
    minor = major[0] * e[1] / e[0], major[1] * e[2] / e[0], major[2] * e[2] / e[1]
    common = "".join(f"MP,E{a},1,{v}\n" for a, v in zip("XYZ", e, strict=True)) + "".join(
        f"MPDATA,R5.0, 1,G{p}  ,       1, 1, {v:.9E},\n" for p, v in zip(("XY", "XZ", "YZ"), g, strict=True)
    )
    common += "MPTEMP,R5.0, 1, 1,  0.0,\nMPDATA,DENS,1,1,1500.0\nMP,ALPX,1,1e-5\n"
    compliance = []
    for prefix, nu in (("PR", major), ("NU", minor)):
        text = common + "".join(f"MP,{prefix}{p},1,{v!r}\n" for p, v in zip(("XY", "XZ", "YZ"), nu, strict=True))
        (material,) = import_ansys_cdb(write(tmp_path, hex_deck(after=text))).materials
        assert material.set == "material 1" and material.density == 1500
        compliance.append(np.linalg.inv(material.stiffness))
    # Tension along x shortens y by PRXY / EX; shear in the order yz, zx, xy.
    for S in compliance:
        assert S[:3, 0] == pytest.approx([1 / e[0], -major[0] / e[0], -major[1] / e[0]])
        assert S[:3, 1] == pytest.approx([-major[0] / e[0], 1 / e[1], -major[2] / e[1]])
        assert np.diag(S)[3:] == pytest.approx([1 / g[2], 1 / g[1], 1 / g[0]])
    constants = "MP,EX,1,2.1e11\nMP,NUXY,1,0.3\nMP,DENS,1,7850\n"
    (material,) = import_ansys_cdb(write(tmp_path, hex_deck(after=constants))).materials
    assert material.stiffness == pytest.approx(isotropic(set="s", **STEEL).stiffness)


def test_two_materials_own_their_elements(tmp_path):
    extra = [(3, 1, 2, 1, [101 + i for i in box("hex8", (2, 1, 1), (2.0, 1.0, 1.0)).blocks[0].nodes[0]])]
    imported = import_ansys_cdb(
        write(tmp_path, hex_deck(extra=extra, after="MP,EX,2,1e9\nMP,DENS,2,1e3\nMP,BETD,2,1e-6\n"))
    )
    sets = imported.mesh.element_sets
    assert [s[0].tolist() for s in (sets["material 1"], sets["material 2"], sets["type 1"])] == [[0, 1], [2], [0, 1, 2]]
    assert [m.set for m in imported.materials] == ["material 2"]
    assert any("0.3 was taken" in n for n in imported.notes) and any("BETD" in n for n in imported.notes)


REALS = {
    "RLBLOCK,1,7,6,7\n(2i8,6g16.9)\n(7g16.9)\n"
    + f"{7:8d}{6:8d}"
    + "".join(f"{v:16.9g}" for v in (2, 2, 2, 3, 4, 5)): 5,
    "R,7,2.0,2.0,2.0,3.0,4.0,5.0": 5,
    "R,7,2.0,2.0,2.0\n": 0,
}


@pytest.mark.parametrize(("text", "izz"), REALS.items())
def test_point_masses(tmp_path, text, izz):
    imported = import_ansys_cdb(write(tmp_path, hex_deck(before=f"ET,2,21\n{text}\n", extra=[(9, 2, 1, 7, [103])])))
    (mass,) = imported.masses
    assert mass.mass == 2 and imported.nodes.ids[mass.node] == 103
    assert mass.inertia.tolist() == (np.diag([3.0, 4.0, 5.0]) if izz else np.zeros((3, 3))).tolist()
    assert [len(block.ids) for block in imported.mesh.blocks] == [2]
    apart = import_ansys_cdb(write(tmp_path, hex_deck(before="ET,2,21\nR,7,2.0,0,3\n", extra=[(9, 2, 1, 7, [103])])))
    (by_direction,) = apart.discrete
    assert not apart.masses and by_direction.matrix == "M" and by_direction.components.tolist() == [0, 2]
    assert np.array_equal(by_direction.values, np.diag([2.0, 3.0]))
    for before, constants in (("ET,2,21\nR,7,2.0,-1,2\n", 7), (f"ET,2,21\n{text}\n", 8)):
        path = write(tmp_path, hex_deck(before=before, extra=[(9, 2, 1, constants, [103])]))
        assert refusals(partial(import_ansys_cdb, path))[0] == ("MASS21", 0, ("--skip MASS21",))


PYRAMID = [(7, 1, 1, 1, [101, 102, 103, 104, 105, 105, 105, 105])]
TWISTED = [(7, 1, 1, 1, [101, 102, 103, 104, 105, 105, 106, 107])]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"extra": PYRAMID}, ("unsupported", "", "SOLID185", "7")),
        ({"extra": TWISTED}, ("unsupported", "", "7", "SOLID185")),
        ({"extra": [(7, 1, 1, 1, [101, 102, 103, 104, 105, 106, 107, 999])]}, ("unknown", "node", "999")),
        ({"extra": [(2, 1, 1, 1, [101, 102, 103, 104, 105, 106, 107, 108])]}, ("conflict", "element")),
        ({"extra": [(7, 3, 1, 1, [101])]}, ("unsupported",)),
        ({"before": "ET,3,174\n", "extra": [(7, 3, 1, 1, [101] * 4)]}, ("unsupported", "CONTA174", "--contact")),
        ({"before": "ET,3,188\n", "extra": [(7, 3, 1, 1, [101, 102])]}, ("unsupported", "BEAM188")),
        (
            {"before": "ET,3,181\n", "extra": [(7, 3, 1, 1, [101, 102, 103, 104])]},
            ("unsupported", "SHELL181", "7", "ANSYS", "--skip"),
        ),
        ({"after": "EBLOCK,10,COMPACT\n(10i9)\n-1\n"}, ("file", "model.cdb")),
        ({"after": "CP,1,TEMP,101,102\n"}, ("missing", "CP")),
        ({"after": "CE,1,0,101,TEMP,1.0\n"}, ("value", "CE", "TEMP")),
        ({"after": "CE,1,0,101,UX,0.0,102,UX,1.0\n"}, ("value", "CE")),
        ({"after": "CERIG,101,102\n"}, ("unsupported", "CERIG")),
        ({"after": "RBE3,101,ALL,102\n"}, ("unsupported", "RBE3")),
        ({"after": "CDREAD,DB,other,cdb\n"}, ("unsupported",)),
        ({"after": "N,R5.3,LOC,       7, 1.0, 2.0, 0.0\n"}, ("unsupported", "", "UNBLOCKED")),
        ({"after": "E,101,102,103\n"}, ("unsupported", "", "UNBLOCKED")),
        ({"after": "CSYS,1\nN,7,1.0,2.0\n"}, ("unsupported", "", "UNBLOCKED")),
        ({"after": "MP,EX,1,modulus\n"}, ("file", "model.cdb")),
        ({"after": "MP,EX,1,nan\n"}, ("file", "model.cdb")),
        ({"after": "CERIG,101,102\nTB,ANEL,1\n"}, ("unsupported", "CERIG", "ANEL")),
        ({"after": "MP,EX,1,2e11\nMP,NUXY,1,0.6\nMP,DENS,1,7850\n"}, ("value", "poisson", "0.6")),
        ({"after": components(("C", "NODE", [101, 999]))}, ("file", "", "999")),
        ({"after": components(("C", "ELEM", [1, 999]))}, ("file",)),
        ({"after": components(("C", "NODE", [-105]))}, ("unsupported",)),
        ({"after": components(("C", "NODE", [105, -102]))}, ("unsupported",)),
        ({"after": components(("C", "NODE", [105, -99999999]))}, ("file", "", "99999887", "113")),
    ],
)
def test_archives_that_are_refused_by_name(tmp_path, options, message):
    with refusal(*message):
        import_ansys_cdb(write(tmp_path, hex_deck(**options)))


def test_damaged_archives(tmp_path):
    text = hex_deck()
    for old, new, message in (
        ("N,R5.3", "      101        0        0\nN,R5.3", ("file", "model.cdb", "13", "12")),
        ("(3i9,6e21.13e3)", "(3z9)", ("value",)),
        ("      102 ", "      101 ", ("conflict", "node", "101")),
        ("1.0000000000000E+000", "1.0000000000000E+00x", ("unsupported",)),
        ("1.0000000000000E+000", "                 nan", ("value",)),
        ("1.0000000000000E+000", "                 1_5", ("unsupported",)),
        ("      101 ", "      1_1 ", ("unsupported",)),
        ("(19i10)", "(2i10)", ("unsupported",)),
        ("        -1\nEN", "EN", ("file", "", "EBLOCK")),
        ("SOLID,2,2", "SOLID,2,3", ("file", "", "EBLOCK")),
        ("FINISH", "\0", ("file", "model.cdb")),
    ):
        assert old in text
        with refusal(*message):
            import_ansys_cdb(write(tmp_path, text.replace(old, new, 1)))
    with refusal("file", "", "EBLOCK"):
        import_ansys_cdb(write(tmp_path, text[: text.index("        -1\nEN")]))
    with refusal("unsupported", "", "no.cdb"):
        import_ansys_cdb(tmp_path / "no.cdb")


def test_exponents_of_coordinates_need_no_letter(tmp_path):
    """As Fortran writes those of three digits, and reads all."""
    text = hex_deck()
    path = write(tmp_path, text.replace("1.0000000000000E+000", "   1000000000000.-12"))
    assert np.array_equal(import_ansys_cdb(path).nodes.xyz, import_ansys_cdb(write(tmp_path, text)).nodes.xyz)


def test_edges_without_middle_nodes_are_linear(tmp_path):
    """One is left out: a node at its place follows the corners; without any, the element has eight nodes."""
    mesh = box("hex20", (1, 1, 1), (1.0, 1.0, 1.0))
    text = ansys_archive(mesh)
    middle = [f"{101 + n:10d}" for n in mesh.blocks[0].nodes[0][8:]]
    at = text.index("EBLOCK")
    models = []
    for count in (1, 12):
        lines = text[at:]
        for word in middle[:count]:
            lines = lines.replace(word, f"{0:10d}", 1)
        imported = import_ansys_cdb(write(tmp_path, text[:at] + MP_STEEL + lines))
        models.append((imported, model_of(imported)))
    (imported, model), (linear, _) = models
    assert linear.mesh.blocks[0].type == "hex8" and "12 nodes belong to no element" in linear.notes[0]
    assert imported.mesh.blocks[0].type == "hex20" and imported.nodes.ids[-1] == 121 and not imported.incomplete
    S, R = model.dependent.S, rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    gone = mesh.nodes.xyz[mesh.blocks[0].nodes[0][8]]
    assert np.allclose(imported.nodes.xyz[-1], gone) and abs(S @ R - R).max() < 1e-14
    assert abs(S.T @ model.K @ (S @ R)).max() < 1e-10 * abs(model.K).max()
    assert R[:, 0] @ model.M @ R[:, 0] == pytest.approx(7850.0)


MP_STEEL = "MPDATA,UNBL,1,EX,1,1,2.1e11\nMPDATA,UNBL,1,PRXY,1,1,0.3\nMPDATA,UNBL,1,DENS,1,1,7850\n"
LOOSE = "NBLOCK,3,,1,1\n(1i9,3e20.13)\n      201 3.0000000000000E+00 0.5000000000000E+00 0.5000000000000E+00\n-1\n"


BEAMS = hex_deck(
    before=f"{MP_STEEL}ET,2,184\nKEYOPT,2,1,1\n{LOOSE}",
    extra=[(10 + k, 2, 1, 1, [201, node]) for k, node in enumerate((103, 106, 109, 112))],
)
BOTH = f"{MP_STEEL}ET,2,14\nET,3,14\nKEYOPT,3,2,2\nR,5,100.0,2.0\n{LOOSE}"
ENDS = [(10, 2, 1, 5, [103, 201]), (11, 3, 1, 5, [201, 103])]
SPRINGS = hex_deck(before=BOTH, extra=ENDS)


def test_rigid_beams_and_springs(tmp_path):
    """Four rigid beams from a node in front of the body, which leads, and springs along and across their ends."""
    imported = import_ansys_cdb(write(tmp_path, BEAMS))
    (body,) = imported.rigid
    assert imported.nodes.ids[body.master] == 201 and imported.nodes.ids[body.slaves].tolist() == [103, 106, 109, 112]
    model = model_of(imported)
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    assert abs(model.dependent.S @ R - R).max() < 1e-12 and len(model.nodes) == 13
    # Commands may be cut to four letters.
    short = BEAMS.replace("KEYOPT", "keyo").replace("MPDATA", "mpda").replace("EBLOCK", "eblo")
    assert len(import_ansys_cdb(write(tmp_path, short)).rigid) == 1
    links = write(tmp_path, BEAMS.replace("KEYOPT,2,1,1\n", ""))
    assert refusals(lambda: import_ansys_cdb(links)) == [("MPC184", 0, ("--skip MPC184",))]
    springs = import_ansys_cdb(write(tmp_path, SPRINGS)).discrete
    along, across = ([each for each in springs if label in each.name] for label in ("14 10", "14 11"))
    a = np.array([3.0, 0.5, 0.5]) - box("hex8", (2, 1, 1), (2.0, 1.0, 1.0)).nodes.xyz[2]
    a /= np.linalg.norm(a)
    assert np.allclose(along[0].values, 100 * np.kron([[1, -1], [-1, 1]], np.outer(a, a)))
    assert [(each.matrix, each.values[0, 0]) for each in across] == [("K", 100.0), ("D", 2.0)]
    assert across[0].components.tolist() == [1, 1]
    for change, words in (
        ({"before": BOTH.replace("R,5,100.0,2.0", "R,6,1.0")}, ("unsupported", "COMBIN14", "5")),
        ({"before": BOTH.replace("R,5,100.0,2.0", "R,5,1.0,1.0,1.0")}, ("unsupported", "COMBIN14")),
        ({"before": BOTH.replace("KEYOPT,3,2,2", "KEYOPT,3,3,2")}, ("unsupported", "COMBIN14")),
    ):
        with refusal(*words):
            import_ansys_cdb(write(tmp_path, hex_deck(extra=ENDS, **change)))


def test_tetrahedra_with_pressure_are_plain_and_warned_of(tmp_path):
    mesh = box("tet4", (1, 1, 1), (1.0, 1.0, 1.0))
    text = ansys_archive(mesh, after=MP_STEEL)
    head, _, tail = text.partition("(19i10)\n")
    four = ansys_elements([(i, 1, 1, 1, 101 + rows) for i, rows in enumerate(mesh.blocks[0].nodes, start=1)])
    plain = head.replace("ET,1,45", "ET,1,285") + "(19i10)\n" + four + tail[tail.index("        -1\n") :]
    archives = [import_ansys_cdb(write(tmp_path, each)) for each in (text, plain)]
    assert np.array_equal(archives[0].mesh.blocks[0].nodes, archives[1].mesh.blocks[0].nodes)
    assert not archives[0].mesh.warnings and "SOLID285" in archives[1].mesh.warnings[0]


def test_elements_left_out_on_request(tmp_path):
    options = {"before": "ET,3,CONTA174\nET,4,200\n", "extra": [(7, 3, 1, 1, [101] * 4), (8, 4, 1, 1, [102] * 4)]}
    imported = import_ansys_cdb(write(tmp_path, hex_deck(**options)), skip=("conta174",))
    assert "1 elements CONTA174 left out as asked" in imported.warnings[0]
    assert any("MESH200" in note for note in imported.notes) and len(imported.mesh.blocks[0].ids) == 2


def test_rotated_nodes_are_noted_in_a_mesh_and_refused_for_matrices(model, tmp_path):
    matrices, labels = shuffled(model)
    text = ansys_archive(model.mesh)
    first = next(line for line in text.splitlines() if line.startswith("      102"))
    full = first.ljust(27 + 63)[:90] + e21(45.0)
    path = write(tmp_path, text.replace(first, full))
    assert any("1 nodes have rotated axes" in note for note in import_ansys_cdb(path).notes)
    n = len(labels)
    named = write_full(tmp_path / "a.full", matrices, labels // 10 + 100, np.tile([1, 2, 3], n), [3] * n)
    with refusal("file", "model.cdb", "102"):
        import_ansys_full(named, nodes=path)
    imported = import_ansys_full(named, nodes=write(tmp_path, text))
    assert abs(imported.K - model.K).max() == 0 and imported.notes == ()


# ---- damaged files


def mutated(data, rng):
    """Cut short, bytes changed, moved or taken out, or words that stand for absurd sizes."""
    data = bytearray(data)
    how = rng.randrange(5)
    if how == 0:
        return bytes(data[: rng.randrange(len(data))])
    for _ in range(rng.choice((1, 1, 5))):
        at = rng.randrange(min(len(data), rng.choice((800, 10**9))))
        if how == 1:
            data[at] = rng.randrange(256)
        elif how == 2:
            data[at] = rng.choice(b"0123456789-+.E ,\n")
        elif how == 3:
            del data[at : at + rng.randrange(1, 60)]
        else:
            data[at // 4 * 4 : at // 4 * 4 + 4] = rng.choice((b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff" * 4, b"9999"))
    return bytes(data)


def test_damaged_files_raise_nothing_but_input_errors(model, tmp_path):
    matrices, labels = shuffled(model)
    n = len(labels)
    nodes = write_nodes(tmp_path / "n.lis", 10 * np.arange(1, n + 1), model.nodes.xyz)
    dof = np.tile([1, 2, 3], n)
    rows = [(label, name) for label in labels for name in ("UX", "UY", "UZ")]
    mapping = tmp_path / "K.mapping"
    mapping.write_text("".join(f"{i:10d}{node:10d}   {d}\n" for i, (node, d) in enumerate(rows, start=1)))
    small = {name: sp.csr_array(matrix[:9, :9]) for name, matrix in matrices.items()}
    M = market(tmp_path / "M.mtx", small["M"])
    after = components(("C", "NODE", [101, -105])) + "MP,EX,1,2e11\nMP,DENS,1,7850\n"
    sources = {
        "full": (write_full(tmp_path / "a.full", matrices, labels, dof, [3] * n), import_ansys_full, {"nodes": nodes}),
        "market": (M, read_ansys_matrix, {}),
        "boeing": (boeing(tmp_path / "K.hb", small["K"], 3), read_ansys_matrix, {}),
        "archive": (write(tmp_path, hex_deck(after=after)), import_ansys_cdb, {}),
        "mass": (
            boeing(tmp_path / "M.hb", matrices["M"]),
            lambda p, **o: import_ansys_matrices(p, mass=p, **o),
            {"mapping": mapping, "nodes": nodes},
        ),
    }
    rng = random.Random(7)
    refused = 0
    for name, (source, reader, options) in sources.items():
        data = source.read_bytes()
        path = tmp_path / f"damaged{Path(source).suffix}"
        for _ in range(120):
            path.write_bytes(mutated(data, rng))
            try:
                reader(path, **options)
            except InputError as error:
                assert "\n" not in str(error), name
                refused += 1
    assert refused > 300


def test_equations_and_coupled_dofs(tmp_path):
    """As CDWRITE writes them, and as commands."""
    material = "MP,EX,1,2.1e11\nMP,PRXY,1,0.3\nMP,DENS,1,7850\n"
    after = (
        material + "CE,R5.0,DEFI,       3,       1,  0.0\nCE,R5.0,NODE,     101,UX  ,  2.0    ,     102,UX  , -1.0\n"
        "CE,R5.0,NODE,     103,UY  , -0.5\nCE,7,0,104,UZ,1,105,UZ,1\nCE,7,0,106,UZ,3\nCP,4,UY,107,108,109\n"
    )
    imported = import_ansys_cdb(write(tmp_path, hex_deck(after=after)))
    (given,) = imported.equations
    ids = imported.nodes.ids
    first = [(int(ids[n]), int(c)) for n, c in zip(given.nodes, given.components, strict=True)]
    assert first == [(101, 0), (104, 2), (108, 1), (109, 1)]
    assert given.coefficients.tolist() == [0.5, 0.25, -1.0, -3.0, 1.0, 1.0]
    assert ids[given.term_nodes].tolist() == [102, 103, 105, 106, 107, 107]
    skipped = import_ansys_cdb(write(tmp_path, hex_deck(after=after)), skip="CE,CP")
    assert not skipped.equations and len(skipped.warnings) == 2


def test_materials_of_tables_and_of_temperature(tmp_path):
    table = "TB,ELAS,1,1,2,ISOT\nTBDATA,1,2.1e11,0.3\n"
    imported = import_ansys_cdb(write(tmp_path, hex_deck(after=table)), density={"material 1": 7850.0})
    like = isotropic(set="", young=2.1e11, poisson=0.3, density=7850.0)
    assert imported.materials[0].stiffness == pytest.approx(like.stiffness) and imported.materials[0].density == 7850.0
    warm = "MPDATA,R5.0,2,EX,1,1,2e11,1e11\nMP,PRXY,1,0.3\nMP,DENS,1,7850\n"
    imported = import_ansys_cdb(write(tmp_path, hex_deck(after=warm)))
    assert imported.materials[0].stiffness[3, 3] == pytest.approx(2e11 / 2.6)
    assert "EX of material 1 depends on temperature; its first value was taken" in imported.warnings[0]


def test_nodes_and_elements_one_by_one_with_several_commands_in_a_line(tmp_path):
    """As HyperMesh writes them; the same model as in blocks."""
    mesh = box("hex20", (2, 1, 1), (2.0, 1.0, 1.0))
    (tmp_path / "blocks.cdb").write_text(ansys_archive(mesh, after=MP_STEEL))
    blocks = import_ansys_cdb(tmp_path / "blocks.cdb")
    label, xyz = blocks.mesh.nodes.ids, blocks.mesh.nodes.xyz.tolist()
    lines = ["/TITLE, costs 3 $ a kilo", "ET,1,186 $ MAT,1", *MP_STEEL.splitlines()]
    lines += [f"N, {n}, {x!r}, {y!r}, {z!r}" for n, (x, y, z) in zip(label, xyz, strict=True)]
    # Nodes of VTK are those of SOLID186 but for middles of upright edges, which are last in both.
    for i, row in zip(blocks.mesh.blocks[0].ids, label[blocks.mesh.blocks[0].nodes], strict=True):
        lines += ["TYPE, 1 $ MAT, 1 $ REAL, 1", "ESYS, 0 ! axes", f"EN, {i}, {', '.join(map(str, row[:8]))}"]
        lines += [f"EMORE, {', '.join(map(str, row[8:16]))}", f"EMORE, {', '.join(map(str, row[16:]))}"]
    (tmp_path / "singles.cdb").write_text("\n".join([*lines, "FINISH\n"]))
    singles = import_ansys_cdb(tmp_path / "singles.cdb")
    assert np.array_equal(singles.mesh.nodes.xyz, blocks.mesh.nodes.xyz)
    assert np.array_equal(singles.mesh.blocks[0].nodes, blocks.mesh.blocks[0].nodes)
    assert np.array_equal(singles.mesh.blocks[0].ids, blocks.mesh.blocks[0].ids)
    assert np.array_equal(singles.materials[0].stiffness, blocks.materials[0].stiffness)


@pytest.mark.parametrize(
    "form", ["(7i9,6e21.13e3)", "(1i9,2i4,3e21.13,3e16.9)", "(i9,2x,3e20.13)", "(1p,3i8,3e21.13)", "(3I10, 3F12.6)"]
)
def test_node_blocks_have_integers_and_reals_of_any_groups(form, tmp_path):
    """Seven integers, two kinds of reals, blanks: the first integer is the label, the first three reals the place."""
    text = hex_deck()
    begin, end = text.index("NBLOCK"), text.index("N,R5.3")
    rows = [line.split() for line in text[begin:end].splitlines()[2:]]
    whole = {"(7": "{:9d}" + "        0" * 6, "(1i": "{:9d}   0   0", "(i9": "{:9d}  ", "(1p": "{:8d}" + "       0" * 2}
    head = next((value for key, value in whole.items() if form.startswith(key)), "{:10d}" + "         0" * 2)
    real = "{:12.6f}" if "F" in form else "{:20.13E}" if "20" in form else "{:21.13E}"
    lines = [head.format(int(row[0])) + "".join(real.format(float(x)) for x in row[3:6]) for row in rows]
    path = tmp_path / "model.cdb"
    path.write_text(text)
    wanted = import_ansys_cdb(path).mesh
    path.write_text("\n".join([f"{text[:begin]}NBLOCK,6,SOLID", form, *lines, text[end:]]))
    read = import_ansys_cdb(path).mesh
    assert np.array_equal(read.nodes.ids, wanted.nodes.ids)
    assert np.allclose(read.nodes.xyz, wanted.nodes.xyz, atol=1e-6, rtol=0)


def test_shells_are_to_be_left_out_only_where_solids_remain(tmp_path):
    """The type of solids alone is no solid."""
    shell = {"before": "ET,3,181\n", "extra": [(7, 3, 1, 1, [101, 102, 103, 104])]}
    for text, flags in (
        (hex_deck(**shell), ("--skip SHELL181",)),
        (hex_deck().replace("ET,1,185", "ET,1,181\nET,2,185"), ()),
    ):
        with pytest.raises(InputError) as told:
            import_ansys_cdb(write(tmp_path, text))
        assert told.value.problems[0].flags == flags and ("--skip" in str(told.value)) is bool(flags)
