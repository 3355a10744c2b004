"""DMIG entries in all ways to write fields, and reduced bodies that come back from them."""

import gzip
import itertools

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.exporters import export_body
from morembs.exporters.dmig import sixteen, write_dmig
from morembs.fem.interface import make_interface
from morembs.importers import import_file
from morembs.importers.matrices.dmig import DmigMatrix, read_dmig
from morembs.importers.matrices.op4 import read_op4
from morembs.importers.nastran.text import BulkText
from morembs.importers.to_model import model_of
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Modal
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

LABELS = np.array([[1, 1], [1, 2], [2, 1], [7, 0], [8, 0], [100, 6]])
S = np.array(
    [
        [4, -1, 0, 0, 2, 0],
        [-1, 5e8, 1, 0, 0, 0],
        [0, 1, 6, 0, 0, 3e-7],
        [0, 0, 0, 0, 0, 0],
        [2, 0, 0, 0, 7, 0],
        [0, 0, 3e-7, 0, 0, 1],
    ],
    dtype=float,
)
FREE = "DMIG,K,{a},{b},,{c},{d},{v}"
SMALL = "DMIG    K       {a:<8}{b:<8}        {c:<8}{d:<8}{v:<8}"
LARGE = "DMIG*   K               {a:<16}{b:<16}\n*       {c:<16}{d:<16}{v:<16}"
HEADERS = {
    FREE: "DMIG,K,0,{form},2,0,,,{count}",
    SMALL: "DMIG    K       0       {form:<8}2       0                       {count:<8}",
    LARGE: "DMIG*   K               0               {form:<16}2\n*       0" + " " * 47 + "{count:<16}",
}


def number(value, style):
    return sixteen(value).strip() if style == LARGE else f"{value:.1e}".replace("e+0", "+").replace("e-0", "-")


def text(style, entries, form=6, count=""):
    lines = [HEADERS[style].format(form=form, count=count)]
    for i, j, value in entries:
        (a, b), (c, d) = LABELS[j], LABELS[i]
        lines.append(style.format(a=a, b=b, c=c, d=d, v=number(value, style)))
    return "\n".join(lines) + "\n"


def entries(matrix):
    return [(i, j, matrix[i, j]) for j, i in itertools.product(range(6), repeat=2) if matrix[i, j]]


@pytest.mark.parametrize("style", [FREE, SMALL, LARGE])
def test_every_field_format_gives_the_same_matrix(tmp_path, style):
    kept = np.flatnonzero(S.any(axis=0))
    path = tmp_path / "a.bdf"
    mixed = [(i, j, v) if (i + j) % 2 else (j, i, v) for i, j, v in entries(np.tril(S))]
    for given, form in (
        (entries(np.tril(S)), 6),
        (entries(np.triu(S)), 6),
        (mixed, 6),
        (entries(S), 6),
        (entries(S), 1),
    ):
        path.write_text("$ a comment\nSOL,103\n" + text(style, given, form) + "CBAR,1,1,2,3\n,4.,5.\n")
        back = read_dmig(path)["K"]
        assert np.array_equal(back.rows, LABELS[kept]) and back.form == form
        assert back.matrix.toarray() == pytest.approx(S[np.ix_(kept, kept)], rel=1e-11)


@pytest.mark.parametrize("style", [FREE, SMALL, LARGE])
def test_numbered_columns_of_a_rectangle(tmp_path, style):
    lines = [HEADERS[style].format(form=9, count=4), style.format(a=2, b=0, c=7, d=0, v="1.5+1")]
    (tmp_path / "a.bdf").write_text("\n".join(lines) + "\n")
    back = read_dmig(tmp_path / "a.bdf")["K"]
    assert back.matrix.toarray().tolist() == [[0, 15.0, 0, 0]] and back.columns[:, 0].tolist() == [1, 2, 3, 4]


def test_several_entries_share_a_line_and_scalar_points_have_blanks(tmp_path):
    """As in the example of the Quick Reference Guide."""
    (tmp_path / "a.bdf").write_text(
        "DMIG    STIF    0       1       3       4\n"
        "DMIG    STIF    27      1               2       3       3.+5    3.+3\n"
        "        2       4       2.5+10  0.      50              1.0     0.\n"
    )
    back = read_dmig(tmp_path / "a.bdf")["STIF"]
    assert back.type == 3 and back.rows.tolist() == [[2, 3], [2, 4], [27, 1], [50, 0]]
    assert back.matrix.toarray()[:, 2].tolist() == [3e5 + 3e3j, 2.5e10, 0, 1]


def test_written_matrices_come_back_with_eleven_digits(tmp_path):
    rng = np.random.default_rng(3)
    A = rng.standard_normal((6, 6)) * 10.0 ** rng.integers(-30, 30, (6, 6))
    R, C = A[:, :3], A * (1 + 2j)
    columns = np.array([[1, 0], [2, 0], [3, 0]])
    given = {
        "SYM": DmigMatrix(matrix=sp.csr_array(A + A.T), rows=LABELS, columns=LABELS, form=6),
        "SQ": DmigMatrix(matrix=sp.csr_array(A), rows=LABELS, columns=LABELS, form=1),
        "R": DmigMatrix(matrix=sp.csr_array(R), rows=LABELS, columns=columns, form=9),
        "C": DmigMatrix(matrix=sp.csr_array(C), rows=LABELS, columns=LABELS, form=1),
    }
    write_dmig(tmp_path / "a.bdf", given)
    back = read_dmig(tmp_path / "a.bdf")
    for name, matrix in given.items():
        a, b = back[name].matrix.toarray(), matrix.matrix.toarray()
        assert np.abs(a - b).max() > 0 and np.all(np.abs(a - b) <= 1e-10 * np.abs(b)), name
        assert np.array_equal(back[name].rows, matrix.rows) and np.array_equal(back[name].columns, matrix.columns)


def test_matrices_in_included_and_packed_files_and_what_lies_beyond_their_fields(tmp_path):
    matrix = text(LARGE, entries(np.tril(S)))
    (tmp_path / "k.bdf").write_text(matrix.replace("\n", f"{'7.':>40}\n", 1))
    head, mass = "SOL 103\nBEGIN BULK\nINCLUDE 'k.bdf'\n", matrix.replace("K   ", "MAAX")
    (tmp_path / "m.bdf.gz").write_bytes(gzip.compress((head + mass).encode()))
    whole = BulkText(tmp_path / "m.bdf.gz")
    read = read_dmig(whole)
    assert abs(read["K"].matrix - read["MAAX"].matrix).max() == 0
    cut, beyond = whole.warnings
    assert "no ENDDATA" in cut and "k.bdf, line 1" in beyond
    line = f"DMIG{'K':>5}{1:>15}{1:>8}{1:>16}{1:>8}{'2.':>8}{'3.':>40}\n"
    (tmp_path / "one.bdf").write_text(f"BEGIN BULK\nDMIG,K,0,6,2,0\n{line}")
    assert ["one.bdf, line 3" in words for words in import_file(tmp_path / "one.bdf", "dmig").warnings] == [False, True]
    (tmp_path / "m.bdf.gz").write_bytes(gzip.compress(matrix.encode())[:-9])
    with refusal("file", "m.bdf.gz"):
        read_dmig(tmp_path / "m.bdf.gz")


def test_polar_values(tmp_path):
    (tmp_path / "a.bdf").write_text("DMIG,P,0,1,4,4,1\nDMIG,P,1,1,,1,1,2.,90.\n")
    assert read_dmig(tmp_path / "a.bdf")["P"].matrix.toarray()[0, 0] == pytest.approx(2j)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("GRID,1\n", ("missing", "DMIG")),
        ("DMIG,K,1,1,,1,1,2.\n", ("file", "DMIG")),
        ("DMIG,K,0,6,2,0\n", ("file", "DMIG")),
        ("DMIG,K,0,5,2,0\nDMIG,K,1,1,,1,1,2.\n", ("unsupported", "DMIG", "5")),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,2.,,\n,1,1,3.\n", ("file",)),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,1,,2,1,2.\nDMIG,K,2,1,,1,1,3.\n", ("file", "DMIG")),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,2.,1.\n", ("file", "DMIG")),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,9,,1,1,2.\n", ("file", "DMIG")),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,NaN\n", ("value", "", "DMIG", "NaN", "4")),
        ("DMIG,K,0,9,2,0,,,2\nDMIG,K,3,,,1,1,2.\n", ("file", "DMIG")),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,2.5", ("file",)),
        ("DMIG*   K               0               6\n*       two\n", ("file", "DMIG")),
        ("\0\1\n", ("file", "a.bdf")),
        ("DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,1,2.,,7.,8.\n", ("value",)),
        ("DMIG    K       0       6       2       0                       1       +A\n+B      1\n", ("unsupported",)),
        ("DMIG,K,0,6,2,0\n1 1 2.\n", ("unsupported",)),
        ("DMIG,K,0,6,2,0\nINCLUDE 'b.bdf'\n", ("file", "INCLUDE")),
    ],
)
def test_faults_have_one_message(tmp_path, content, message):
    (tmp_path / "a.bdf").write_text(content)
    with refusal(*message):
        read_dmig(tmp_path / "a.bdf")


def test_what_does_not_fit_is_not_written(tmp_path):
    good = {"matrix": sp.csr_array(np.eye(6)), "rows": LABELS, "columns": LABELS, "form": 6}
    for name, change, message in (
        ("MY_K", {}, ("value", "name", "DMIG")),
        ("K", {"rows": LABELS * 10**8, "columns": LABELS * 10**8}, ("value", "labels")),
        ("K", {"matrix": sp.csr_array(1e120 * np.eye(6))}, ("value", "units", "9.9e99")),
        ("K", {"rows": LABELS[:3]}, ("value", "labels")),
        ("K", {"matrix": sp.csr_array(np.triu(np.ones((6, 6))))}, ("value", "form")),
    ):
        with refusal(*message):
            write_dmig(tmp_path / "a.bdf", {name: DmigMatrix(**(good | change))})
    assert not (tmp_path / "a.bdf").exists()


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """A damped bar with a rigid, an average and a direct interface, by two methods."""
    model = steel(box("hex8", (6, 2, 2), (0.5, 0.05, 0.03)))
    interfaces = [
        make_interface(model, name="left end", nodes=where(model, 0, 0.0), coupling="rigid"),
        make_interface(model, name="right", nodes=where(model, 0, 0.5), coupling="average", components=(0, 1, 2, 4)),
        make_interface(model, name="pin", nodes=where(model, 0, 0.25)[:1], coupling="direct", components=(1, 2)),
    ]
    with Problem(model, interfaces, damping=Damping(beta=1e-5)) as problem:
        reduced = [CraigBampton(modes=3).reduce(problem, "cb"), Modal(modes=30).reduce(problem, "modal")]
        part = make_part(problem, nodes="interfaces")
        bodies = [elastic_body(problem, reduced_model, part) for reduced_model in reduced]
    return write_body(tmp_path_factory.mktemp("dmig") / "bar.h5", bodies)


def transfer(M, K, D, B, s):
    return B.T @ np.linalg.solve(s * s * M + s * D + K, B)


@pytest.mark.parametrize("name", ["cb", "modal"])
def test_a_body_on_grids_has_the_same_response(bodies, tmp_path, name):
    """The coordinates change, what the interfaces feel does not."""
    done = export_body(bodies, "dmig", path=tmp_path / "bar.bdf", body=name)
    back = read_dmig(done.paths[0])
    source = read_body(bodies)
    body = source.bodies[name]
    rows = back["KAAX"].rows
    M, K, D = (back[key].matrix.toarray() for key in ("MAAX", "KAAX", "BAAX"))
    assert np.array_equal(rows, back["MAAX"].rows) and len(M) == len(body.mass_matrix)
    frames = iter(sorted({g for g, c in rows.tolist() if c and g not in source.input_node_id}))
    grid = {i: next(frames) for i in range(3) if source.interfaces[list(source.interfaces)[i]].coupling != "direct"}
    B = np.zeros((len(M), body.input_matrix.shape[1]))
    for column, (i, c, own) in enumerate(
        zip(source.input_interface, source.input_component, source.input_node_id, strict=True)
    ):
        label = own if own >= 0 else grid[i]
        B[np.flatnonzero((rows == [label, c + 1]).all(axis=1)), column] = 1.0
    assert (B.sum(axis=0) == 1).all()
    omega = sl.eigvalsh(body.stiffness_matrix, body.mass_matrix)
    assert sl.eigvalsh(K, M)[6:] == pytest.approx(omega[6:], rel=1e-6)
    for s in (1e3j, 1e4j + 10):
        expected = transfer(body.mass_matrix, body.stiffness_matrix, body.damping_matrix, body.input_matrix, s)
        scale = np.sqrt(np.abs(np.outer(np.diag(expected), np.diag(expected))))
        assert np.abs(transfer(M, K, D, B, s) - expected).max() <= 1e-6 * scale.max()
        assert (np.abs(transfer(M, K, D, B, s) - expected) <= 1e-6 * scale).all()
    lines = done.paths[0].read_text().splitlines()
    assert sum(line.startswith("GRID*") for line in lines) == 3
    assert any("SPOINT" in line for line in lines) and all(len(line) <= 72 for line in lines if line[:1] != "$")


def test_a_body_comes_back_through_dmig_as_a_model_and_is_reduced_again(bodies, tmp_path):
    """Its grids are nodes of the model, its scalar points scalar dofs; all of them kept, nothing is lost."""
    done = export_body(bodies, "dmig", path=tmp_path / "bar.bdf", body="cb")
    first, body = read_dmig(done.paths[0]), read_body(bodies).bodies["cb"]
    model = model_of(import_file(done.paths[0], "dmig"))
    for key, A in (("KAAX", model.K), ("MAAX", model.M), ("BAAX", model.D)):
        assert np.abs(A.toarray() - first[key].matrix.toarray()).max() == 0
    scalar = model.dofs.component == 6
    assert scalar.sum() == len(body.stiffness_matrix) - (~scalar).sum() and (~scalar).any() and scalar.any()
    nodes = np.unique(model.dofs.node[~scalar])
    ends = [make_interface(model, name=f"g{row}", nodes=[row], coupling="direct") for row in nodes.tolist()]
    with Problem(model, ends) as problem:
        body = elastic_body(problem, CraigBampton(modes=int(scalar.sum())).reduce(problem), make_part(problem))
    write_body(tmp_path / "again.h5", [body])
    again = read_body(tmp_path / "again.h5").bodies["craig-bampton"]
    omega = sl.eigvalsh(first["KAAX"].matrix.toarray(), first["MAAX"].matrix.toarray())
    eigenvalues = sl.eigvalsh(again.stiffness_matrix, again.mass_matrix)
    assert np.abs(eigenvalues - omega).max() <= 1e-12 * omega.max()
    assert eigenvalues[6:] == pytest.approx(omega[6:], rel=1e-7)


def test_op4_holds_the_body_bit_by_bit(bodies, tmp_path):
    for options in ({}, {"text": True}, {"storage": "bigmat"}):
        done = export_body(bodies, "op4", path=tmp_path / "bar.op4", body="modal", options=options)
        back, body = read_op4(done.paths[0]), read_body(bodies).bodies["modal"]
        assert list(back) == ["M", "K", "D", "B"]
        for key, matrix in (("M", body.mass_matrix), ("K", body.stiffness_matrix), ("B", body.input_matrix)):
            stored = back[key].matrix
            assert np.array_equal(stored.toarray() if sp.issparse(stored) else stored, matrix)


def test_motions_that_depend_on_each_other_cannot_be_coordinates(tmp_path):
    model = steel(box("hex8", (6, 2, 2), (0.5, 0.05, 0.03)))
    faces = [make_interface(model, name=str(x), nodes=where(model, 0, x)) for x in (0.0, 0.25, 0.5)]
    with Problem(model, faces) as problem:
        body = elastic_body(problem, Modal(modes=4).reduce(problem, "few"), make_part(problem))
    write_body(tmp_path / "a.h5", [body])
    with refusal("model", "modes", "18", "10"):
        export_body(tmp_path / "a.h5", "dmig")
