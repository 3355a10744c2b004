"""Abaqus matrices: every format of *MATRIX OUTPUT, substructures, and files of Abaqus itself."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.exporters import export_body
from morembs.exporters.abaqus_matrices import write_abaqus_matrix
from morembs.fem.interface import make_interface
from morembs.importers.matrices.abaqus import align, read_abaqus_matrix, read_abaqus_substructure
from morembs.importers.matrices.text import numbers, text_blocks
from morembs.problem import Problem
from morembs.reducers import CraigBampton, Modal
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

BLOCK_HZ = {
    "C3D4": [489.296266, 489.854771, 697.543460],
    "C3D8": [438.775166, 438.775166, 555.888157, 967.040273],
    "C3D10": [451.333341, 452.009851, 607.870197, 1026.459420],
}


def labelled(size=30, density=0.2):
    """A symmetric matrix with labels as Abaqus has them: gaps, all six dofs, internal nodes."""
    rng = np.random.default_rng(5)
    A = sp.random_array((size, size), density=density, rng=rng)
    A = sp.csr_array(A + A.T + sp.eye_array(size))
    node = np.concatenate([np.repeat([3, 12, 400], 6), np.repeat([1000001, 1000002], 3), -np.arange(1, size - 23)])
    dof = np.concatenate([np.tile(np.arange(1, 7), 3), np.tile([1, 2, 3], 2), np.ones(size - 24, dtype=int)])
    return A, node, dof


@pytest.mark.parametrize("element", BLOCK_HZ)
def test_free_block_of_abaqus(shared_data, element):
    folder = shared_data / "abaqus_block"
    K, M = (read_abaqus_matrix(folder / f"block{element}_{kind}1.mtx") for kind in ("STIF", "MASS"))
    assert K.symmetric and not K.half and K.node is None
    (K, M), _, _ = align(K, M)
    assert M.sum() / 3 == pytest.approx(11600, rel=1e-6)
    f = np.sqrt(sl.eigvalsh(K.toarray(), M.toarray(), subset_by_index=[6, 9])) / (2 * np.pi)
    assert f[: len(BLOCK_HZ[element])] == pytest.approx(BLOCK_HZ[element], rel=3e-9)


@pytest.mark.parametrize("layout", ["matrix input", "labels"])
def test_labels_of_every_row(tmp_path, layout):
    A, node, dof = labelled()
    order = np.random.default_rng(1).permutation(len(node))
    write_abaqus_matrix(tmp_path / "a.mtx", A[order][:, order], node[order], dof[order], layout)
    back = read_abaqus_matrix(tmp_path / "a.mtx")
    assert np.array_equal(back.node, node) and np.array_equal(back.dof, dof) and back.internal == 6
    # The order of the file is not that of the labels: its half lies in both triangles then.
    assert back.symmetric and back.half == (layout == "matrix input")
    assert np.abs(back.matrix - A).max() <= 1e-15 * np.abs(A).max()


def test_coordinates_and_halves(tmp_path):
    A, _, _ = labelled()
    write_abaqus_matrix(tmp_path / "a.mtx", A, layout="coordinate")
    back = read_abaqus_matrix(tmp_path / "a.mtx")
    assert back.node is None and not back.half and np.abs(back.matrix - A).max() <= 1e-15
    for keep in (np.tril, np.triu):
        half = sp.coo_array(keep(A.toarray()))
        triplets = zip(*half.coords, half.data.tolist(), strict=True)
        lines = [f"{r + 1} {c + 1}  {v!r}".replace("e", "D") for r, c, v in triplets]
        (tmp_path / "b.mtx").write_text("\n".join(lines) + "\n")
        back = read_abaqus_matrix(tmp_path / "b.mtx")
        assert back.half and (back.matrix != A).nnz == 0


def test_unsymmetric_matrices_stay_so(tmp_path):
    A, node, dof = labelled()
    for given in (A + sp.diags_array(np.ones(29), offsets=1, shape=(30, 30)), sp.csr_array(sp.triu(A))):
        write_abaqus_matrix(tmp_path / "a.mtx", given, node, dof)
        back = read_abaqus_matrix(tmp_path / "a.mtx")
        assert not back.symmetric and not back.half and np.abs(back.matrix - given).max() <= 1e-15


def test_many_blocks_of_text(tmp_path):
    """Blocks are whole lines, and hold all of the text; a matrix of several blocks is that which was written."""
    A, node, dof = labelled()
    write_abaqus_matrix(tmp_path / "a.mtx", A, node, dof)
    blocks = list(text_blocks(tmp_path / "a.mtx", 97))
    assert len(blocks) > 10 and all(block.endswith(b"\n") for block in blocks)
    assert b"".join(blocks) == (tmp_path / "a.mtx").read_bytes()
    node, dof = np.repeat(np.arange(1, 30_001), 3), np.tile([1, 2, 3], 30_000)
    large = sp.diags_array(np.linspace(1.0, 2.0, len(node)), format="csr")
    write_abaqus_matrix(tmp_path / "b.mtx", large, node, dof)
    assert len(list(text_blocks(tmp_path / "b.mtx"))) > 1
    assert abs(read_abaqus_matrix(tmp_path / "b.mtx").matrix - large).max() <= 1e-15


def test_matrices_of_fewer_rows_are_placed(tmp_path):
    A, node, dof = labelled()
    write_abaqus_matrix(tmp_path / "k.mtx", A, node, dof)
    few = np.array([0, 7, 20])
    write_abaqus_matrix(tmp_path / "m.mtx", np.diag([1.0, 2.0, 3.0]), node[few], dof[few])
    (K, M), nodes, dofs = align(read_abaqus_matrix(tmp_path / "k.mtx"), read_abaqus_matrix(tmp_path / "m.mtx"))
    assert np.array_equal(nodes, node) and np.array_equal(dofs, dof) and K.shape == M.shape
    assert M.diagonal()[few].tolist() == [1, 2, 3] and M.nnz == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ("file", "a.mtx")),
        ("** nothing\n", ("file", "a.mtx")),
        ("1 2\n", ("file", "a.mtx")),
        ("1 1 2.0\n1 2 3.0 4.0\n1 2\n", ("file", "a.mtx", "4")),
        ("1 1 2.0\n1 2 3.0e\n", ("file", "a.mtx")),
        ("1 1 2.0\n1 2 1.2.3\n", ("file", "a.mtx")),
        ("1 1 2.0\n1 2 NaN\n", ("file", "a.mtx")),
        ("1 1 2.0\n1 2 1e999\n", ("file", "a.mtx")),
        ("1 1 2.0\n0 2 1.0\n", ("value", "row")),
        ("1 1 2.0\n1.5 2 1.0\n", ("file", "a.mtx")),
        ("1 1 2.0\n1 999999999999999 1.0\n", ("file", "a.mtx")),
        ("1 1 2.0\n1 2 1.0", ("file", "a.mtx")),
        ("1, 1, 1, 77, 2.0\n", ("value", "dof", "77")),
        (
            "*MATRIX INPUT, NAME=A, TYPE=SYMMETRIC\n1,1,1,2,2.\n1,2,1,1,3.\n1,1,1,1,1.\n",
            ("file", "a.mtx", "TYPE", "SYMMETRIC"),
        ),
        ("*NODE\n1, 0, 0, 0\n", ("unsupported", "", "*NODE")),
        ("*USER ELEMENT, NODES=1\n", ("unsupported", "", "read_abaqus_substructure")),
        ("\0\0\0\n", ("file", "a.mtx")),
    ],
)
def test_faults_have_one_message(tmp_path, content, message):
    (tmp_path / "a.mtx").write_text(content)
    with refusal(*message):
        read_abaqus_matrix(tmp_path / "a.mtx")


def test_numbers_as_fortran_writes_them():
    words = {"1.5": 1.5, "-.2E-10": -0.2e-10, "+3.": 3.0, "1D3": 1e3, "-1.25d-2": -0.0125, "2.5+10": 2.5e10}
    words["7-3"] = 7e-3
    text = ", ".join(words).encode() + b"\n"
    assert numbers(text, "x").tolist() == list(words.values())
    assert numbers("\n".join(words).encode(), "x").tolist() == list(words.values())
    for bad in (b"1..2", b"1e", b"--1", b"1e5.5", b"1e5e5", b"+", b".", b"1+", b"0x10", b"inf"):
        with pytest.raises(InputError):
            numbers(b"1.0 " + bad + b" 2.0\n", "x")


def substructures():
    parser = pytest.importorskip("abaqus_mtx_parser")
    return parser, sorted((Path(parser.__file__).parent / "mtx").glob("*/*.mtx"))


def test_substructures_of_abaqus():
    """Real files, symmetric and not, against the parser that they come with."""
    parser, files = substructures()
    assert len(files) >= 5
    for path in files:
        back, expected = read_abaqus_substructure(path), parser.parse_mtx(path)
        assert np.array_equal(back.matrices["STIFFNESS"], expected.stiffness)
        assert np.array_equal(back.matrices["MASS"], expected.mass)
        assert back.symmetric == (path.parent.name != "unsymmetric")
    # Node 46 of 48 has rotations too, and node 47; node 48 has displacements only.
    beam = read_abaqus_substructure(next(p for p in files if p.parent.name == "recovery"))
    assert beam.dof[beam.node == 46].tolist() == [1, 2, 3, 4, 5, 6] and beam.dof[beam.node == 48].tolist() == [1, 2, 3]


def test_substructure_by_hand_and_its_faults(tmp_path):
    path = tmp_path / "z.mtx"
    head = "*USER ELEMENT, NODES=2, LINEAR\n** ELEMENT NODES\n** 5, 9\n 1, 3\n 2, 2\n"
    path.write_text(head + "*MATRIX, TYPE=STIFFNESS\n 4., \n -.1E1, 5.\n 6., 7., .8E1\n")
    back = read_abaqus_substructure(path)
    assert back.matrices["STIFFNESS"].tolist() == [[4, -1, 6], [-1, 5, 7], [6, 7, 8]]
    assert list(zip(back.node.tolist(), back.dof.tolist(), strict=True)) == [(5, 1), (5, 3), (9, 2)]
    for content, message in (
        ("1 1 2.\n", ("file", "z.mtx", "*USER", "ELEMENT")),
        (head, ("file", "z.mtx", "*MATRIX")),
        (head + "*MATRIX, TYPE=MASS\n1., 2.\n", ("file", "", "6")),
        (head.replace("NODES=2", "NODES=3") + "*MATRIX, TYPE=MASS\n1.\n", ("file", "USER ELEMENT", "NODES")),
        (head.replace(" 2, 2", " 7, 2") + "*MATRIX, TYPE=MASS\n1.\n", ("file", "node", "7")),
    ):
        path.write_text(content)
        with refusal(*message):
            read_abaqus_substructure(path)


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    model = steel(box("hex8", (6, 2, 2), (0.5, 0.05, 0.03)))
    faces = [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("left", 0.0), ("right", 0.5))]
    with Problem(model, faces) as problem:
        part = make_part(problem)
        bodies = [
            elastic_body(problem, reduced_model, part)
            for reduced_model in (CraigBampton(modes=4).reduce(problem, "cb"), Modal(modes=20).reduce(problem, "modal"))
        ]
    return write_body(tmp_path_factory.mktemp("abaqus") / "bar.h5", bodies)


def test_reduced_body_as_abaqus_deck(bar, tmp_path):
    """The matrices of Craig-Bampton come back to 1e-15; those of free modes with the same frequencies."""
    for name, steps in (("cb", 1e-15), ("modal", None)):
        done = export_body(bar, "abaqus", path=tmp_path / f"{name}.inp", body=name)
        body = read_body(bar).bodies[name]
        back = [read_abaqus_matrix(p) for p in done.paths[1:3]]
        (M, K), node, dof = align(*back)
        assert [p.name for p in done.paths[1:]] == [f"{name}_abaqus_M.mtx", f"{name}_abaqus_K.mtx"]
        assert len(set(node.tolist())) == 2 + len(body.mass_matrix) - 12 and dof[:12].tolist() == [1, 2, 3, 4, 5, 6] * 2
        if steps:
            assert np.abs(M - body.mass_matrix).max() <= steps * np.abs(body.mass_matrix).max()
            assert np.abs(K - body.stiffness_matrix).max() <= steps * np.abs(body.stiffness_matrix).max()
        omega = sl.eigvalsh(body.stiffness_matrix, body.mass_matrix)[6:]
        assert sl.eigvalsh(K.toarray(), M.toarray())[6:] == pytest.approx(omega, rel=1e-7)
        deck = done.paths[0].read_text()
        assert f"*MATRIX INPUT, NAME=K, INPUT={name}_abaqus_K.mtx" in deck
        assert "*MATRIX ASSEMBLE, STIFFNESS=K, MASS=M" in deck


def test_reduced_body_in_matrix_market_files(bar, tmp_path):
    done = export_body(bar, "matrix-market", path=tmp_path / "bar.mtx", body="cb")
    body = read_body(bar).bodies["cb"]
    wanted = {"M": body.mass_matrix, "K": body.stiffness_matrix, "B": body.input_matrix}
    assert [p.name for p in done.paths] == [f"bar_{key}.mtx" for key in wanted]
    for path, matrix in zip(done.paths, wanted.values(), strict=True):
        back = scipy.io.mmread(path)
        assert np.array_equal(back.toarray() if sp.issparse(back) else back, matrix)
    assert "column 7: right component 1" in done.paths[2].read_text()


def test_what_does_not_fit_is_not_written(tmp_path):
    for matrix, node, dof, message in (
        (np.ones((2, 3)), None, None, ("value",)),
        (np.eye(2), None, None, ("missing", "labels")),
        (np.eye(2), np.array([1, 1]), np.array([1, 1]), ("value", "labels")),
        (np.diag([1, np.inf]), np.array([1, 2]), np.array([1, 1]), ("value", "units", "9.9e99")),
    ):
        with refusal(*message):
            write_abaqus_matrix(tmp_path / "a.mtx", matrix, node, dof)
