"""Second-order systems with input and output matrices: from arrays and files to reduced bodies, against dense ones."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import morembs
from morembs.app.jobs.import_job import run_import
from morembs.app.jobs.job import load_job
from morembs.app.jobs.stages.couple import interfaces_of
from morembs.certificate.response import full_response, reduced_response
from morembs.exporters.op4 import write_op4
from morembs.importers import import_file
from morembs.importers.model_file import read_model, write_model
from morembs.importers.options import read_import_options
from tests.support.meshes import box, steel
from tests.support.processes import morembs as cli
from tests.support.refusals import refusal

ROOT = Path(__file__).parents[2]
SIZE = 60
OMEGA = np.linspace(1.0, 60.0, 15)


def chain() -> tuple[sp.csr_array, sp.csr_array, sp.csr_array, np.ndarray, np.ndarray]:
    """Masses between springs, held at both ends, with two inputs and one output that is none of them."""
    K = sp.csr_array(sp.diags_array([[-1e4] * (SIZE - 1), [2e4] * SIZE, [-1e4] * (SIZE - 1)], offsets=[-1, 0, 1]))
    M, B, C = sp.eye_array(SIZE, format="csr"), np.zeros((SIZE, 2)), np.zeros((1, SIZE))
    B[10, 0], B[20:25, 1] = 1.0, 0.3
    C[0, 40:42] = 1.0, -1.0
    return K, M, sp.csr_array(1e-3 * K), B, C


def dense(B: np.ndarray, C: np.ndarray, omega: np.ndarray) -> np.ndarray:
    K, M, D, *_ = (A.toarray() if sp.issparse(A) else A for A in chain())
    return np.array([C @ np.linalg.solve(K + 1j * w * D - w * w * M, B) for w in omega])


def difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(abs(a - b).max() / abs(b).max())


@pytest.fixture
def model() -> morembs.FEModel:
    return morembs.from_matrices(*chain(), names={"B": ["drive", "brake"], "C": ["strain"]})


@pytest.mark.parametrize(
    ("reducer", "most"),
    [
        (morembs.Modal(modes=40), 1e-3),
        (morembs.Krylov(shifts_hz=[0.0, 2.0, 4.0, 6.0, 8.0], moments=2), 1e-9),
        (morembs.CraigBampton(modes=40), 1e-3),
        (morembs.AutoReducer(band_hz=[0.1, 15.0], tolerance=0.01), 1e-3),
    ],
    ids=["modal", "krylov", "craig-bampton", "auto"],
)
def test_reduced_transfer_function_is_that_of_the_dense_system(model, reducer, most):
    *_, B, C = chain()
    ends = [morembs.matrix_interface(model, name=name, matrix=matrix) for name, matrix in (("in", "B"), ("out", "C"))]
    with morembs.Problem(model, ends) as problem:
        both = np.hstack([B, C.T])
        assert difference(full_response(problem, OMEGA), dense(both, both.T, OMEGA)) < 1e-10
        H = reduced_response(reducer.reduce(problem), OMEGA)
    assert difference(H[:, 2:, :2], dense(B, C, OMEGA)) < most


def test_body_file_keeps_the_columns_by_name_and_exports_them(model, tmp_path):
    drive = morembs.matrix_interface(model, name="in", matrix="B:brake")
    out = morembs.matrix_interface(model, name="out", matrix="C:strain")
    with morembs.Problem(model, [drive, out]) as problem:
        reduced = morembs.Krylov(shifts_hz=[0.0, 3.0, 6.0, 9.0], moments=2).reduce(problem)
        [certificate] = morembs.certify(problem, [reduced], [0.1, 10.0])
        body = morembs.elastic_body(problem, reduced, morembs.make_part(problem, nodes="all"))
    assert 0.0 < certificate.error.max() < 1e-3
    file = morembs.write_body(tmp_path / "body.h5", [body])
    stored = morembs.read_body(file, whole=True)
    assert stored.interfaces["in"].forces == ("B:brake",)
    assert stored.interfaces["out"].forces == ("C:strain",)
    assert stored.input_component.tolist() == [6, 6]
    assert np.array_equal(next(iter(stored.bodies.values())).input_matrix, reduced.B)
    morembs.export_body(file, "matrix-market", path=tmp_path / "out.mtx")
    assert "column 1: in generalised force" in (tmp_path / "out_B.mtx").read_text()
    with refusal("unsupported", "interface"):
        morembs.export_body(file, "dmig", path=tmp_path / "out.pch")


def files(folder: Path) -> dict[str, Path]:
    """The chain in every format that holds several matrices."""
    K, M, D, B, C = chain()
    held = {"K": K, "M": M, "D": D, "B": B, "C": C}
    paths = {name: folder / f"chain.{name}" for name in ("mat", "npz", "h5", "op4")}
    scipy.io.savemat(paths["mat"], held)
    np.savez(paths["npz"], **{name: A.toarray() if sp.issparse(A) else A for name, A in held.items()})
    with h5py.File(paths["h5"], "w") as file:
        for name, A in held.items():
            file[f"system/{name}"] = A.toarray() if sp.issparse(A) else A
    write_op4(paths["op4"], {name: sp.csc_array(A) for name, A in held.items()})
    return paths


@pytest.mark.parametrize("kind", ["mat", "npz", "h5", "op4"])
def test_files_give_inputs_and_outputs_by_name(kind, tmp_path, model):
    at = "system/" if kind == "h5" else ""
    named = {role: f"{at}{role}" for role in "KMDBC"} | {"B_names": "drive, brake", "C_names": "strain"}
    result = run_import(tmp_path / "chain.model.h5", read_import_options(file=files(tmp_path)[kind], set=named))
    for read in (result.model, read_model(result.path)):
        for mine, given in ((read.inputs, model.inputs), (read.outputs, model.outputs)):
            assert mine.names == given.names
            assert np.array_equal(mine.matrix.toarray(), given.matrix.toarray())
    assert import_file(files(tmp_path)[kind], options={"K": named["K"], "M": named["M"]}).inputs is None


def test_matrix_market_takes_further_files_and_a_job_their_columns(tmp_path, model):
    K, M, _, B, _ = chain()
    for name, A in (("K", K), ("M", M), ("B", sp.coo_array(B))):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", A)
    options = read_import_options(stiffness=tmp_path / "K.mtx", mass=tmp_path / "M.mtx", set={"B": "B.mtx"})
    read = run_import(tmp_path / "chain.model.h5", options).model
    assert read.inputs.names == ("1", "2")
    assert np.array_equal(read.inputs.matrix.toarray(), B)
    (tmp_path / "job.toml").write_text(
        '[model]\nfile = "chain.model.h5"\n[[interface]]\nname = "in"\nmatrix = "B"\n'
        '[[reduce]]\nname = "m"\nmethod = "modal"\nmodes = 4\n[output]\npath = "out.h5"\n'
    )
    (drive,) = interfaces_of(load_job(tmp_path / "job.toml"), read_model(tmp_path / "chain.model.h5"))
    assert drive.forces == ("B:1", "B:2")


def test_the_commands_of_the_page_run(tmp_path):
    K, M, D, B, C = chain()
    scipy.io.savemat(tmp_path / "MODEL.mat", {"K": K, "M": M, "E": D, "B": B, "C": C})
    for name, A in (("K", K), ("M", M), ("B", sp.coo_array(B))):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", A)
    page = (ROOT / "docs" / "reference" / "formats" / "matrices.md").read_text()
    commands = re.search(r"```\n(.*?)```", page, re.DOTALL).group(1).splitlines()
    read = []
    for command in commands:
        name, *arguments = command.split()
        assert name == "morembs" and cli(*arguments, folder=tmp_path).code == 0
        read.append(read_model(tmp_path / "part.model.h5"))
    assert [each.inputs.names for each in read] == [("drive", "brake"), ("1", "2")]
    assert [each.outputs is None for each in read] == [False, True]


def test_rotations_in_millimetres_give_the_same_work():
    """A moment arm in mm: q in N, and motions in m."""
    values = {"node": [0, 0], "component": [1, 5], "nodes": [[0.0, 0, 0]]}
    short = morembs.from_matrices(np.eye(2), np.eye(2), B=[1.0, 250.0], units="mm-t-s", **values)
    assert np.allclose(short.inputs.matrix.toarray().ravel(), [1.0, 0.25], rtol=1e-15)


def test_older_and_other_models_have_version_1_and_no_columns(tmp_path, model):
    bare = steel(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0)))
    for given, there in ((bare, False), (model, True)):
        with h5py.File(write_model(tmp_path / "a.model.h5", given)) as file:
            assert (int(file["format_version"][()]), "inputs" in file, "outputs" in file) == (1, there, there)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"B": np.ones((3, 1))}, ("value", "B", "60")),
        ({"C": np.ones((1, 3))}, ("value", "C", "60")),
        ({"B": np.full((SIZE, 1), np.nan)}, ("value",)),
        ({"B": np.full((SIZE, 1), 1j)}, ("value",)),
        ({"B": np.ones((SIZE, 2)), "names": {"B": ["a", "a"]}}, ("conflict", "", "a")),
        ({"B": np.ones((SIZE, 2)), "names": {"B": ["a"]}}, ("value",)),
        ({"names": {"B": ["a"]}}, ("unknown", "names")),
    ],
)
def test_matrices_and_names_that_do_not_fit_are_refused(change, words):
    K, M, *_ = chain()
    with refusal(*words):
        morembs.from_matrices(K, M, **change)


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ("A:drive", ("value", "matrix", "B:NAME")),
        ("B:driv", ("unknown", "", "driv")),
        ("B:drive,drive", ("conflict",)),
        ("C:none", ("value",)),
    ],
)
def test_columns_that_are_not_there_are_refused(matrix, words):
    K, M, _, B, C = chain()
    names = {"B": ["drive", "brake"], "C": ["none"]}
    model = morembs.from_matrices(K, M, B=B, C=0 * C, names=names)
    with refusal(*words):
        morembs.matrix_interface(model, name="x", matrix=matrix)
    with refusal("missing", "", "'x'", "B"):
        morembs.matrix_interface(morembs.from_matrices(K, M), name="x", matrix="B")


def test_damaged_columns_of_a_model_file_are_refused(tmp_path, model):
    path = write_model(tmp_path / "a.model.h5", model)
    with h5py.File(path, "a") as file:
        file["inputs/rows"][0] = SIZE
    with refusal("file", "a.model.h5", "/inputs/rows", "60", "59", "/dofs/node"):
        read_model(path)
