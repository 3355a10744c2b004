"""Matrices out of a model file into each matrix format, and back into a model file by ``morembs import``.

Binary files in double precision and text of 17 digits return every bit; what fewer digits keep is measured.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs import CraigBampton, Problem, make_interface
from morembs.app.cli import app
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.exporters import export_body
from morembs.exporters.abaqus_matrices import write_abaqus_matrix
from morembs.exporters.dmig import write_dmig
from morembs.exporters.op4 import write_op4
from morembs.fem import FEModel
from morembs.importers.matrices.dmig import DmigMatrix
from morembs.importers.model_file import read_model, write_model
from tests.support.meshes import box, steel
from tests.support.refusals import refusal

KINDS = ("symmetric", "general", "complex")
OP4 = [(True, *variant) for variant in itertools.product(("dense", "bigmat", "nonbigmat"), ("little", "big"), (32, 64))]
OP4 += [(False, storage, "little", 32) for storage in ("dense", "bigmat", "nonbigmat")]
# Each kind meets every storage, order and number of bits.
OF_OP4 = [(KINDS[(number // 4 + number % 4) % 3], *variant) for number, variant in enumerate(OP4[:12])]
OF_OP4 += [(kind, *variant) for kind, variant in itertools.product(KINDS, OP4[12:])]


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Model file of a bent bar of wedges: no entry is a round number."""
    mesh = box("wedge15", (2, 1, 1), (0.3, 0.1, 0.08), lambda x: x + 0.1 * np.sin(3 * x[..., ::-1]))
    return write_model(tmp_path_factory.mktemp("model") / "bar.model.h5", steel(mesh))


@pytest.fixture(scope="module")
def model(native: Path) -> FEModel:
    return read_model(native)


def matrices(model: FEModel, kind: str) -> dict[str, sp.csr_array]:
    """K and M of a kind: unsymmetric by a gyroscopic part, complex by material damping."""
    K, M = model.K, model.M
    if kind == "general":
        upper = sp.triu(K, 1)
        return {"K": sp.csr_array(K + 0.1 * (upper - upper.T)), "M": M}
    return {"K": sp.csr_array(K * (1 + 0.02j)) if kind == "complex" else K, "M": M}


def imported(folder: Path, *arguments: object) -> FEModel:
    out = folder / "back.model.h5"
    result = CliRunner().invoke(app, ["import", *map(str, [*arguments, "-o", out])])
    assert result.exit_code == 0, result.stderr
    return read_model(out)


def assert_same(back: FEModel, given: dict[str, sp.csr_array], rel: float = 0.0) -> None:
    """Every entry, each to ``rel`` of itself; 0 stands for every bit."""
    for name, A in given.items():
        B = getattr(back, name)
        assert B.shape == A.shape and B.dtype == A.dtype
        if not rel:
            assert (A != B).nnz == 0, name
        for a, b in ((A.real, B.real), (A.imag, B.imag)) if A.dtype == complex else ((A, B),):
            assert (abs(a - b) > rel * abs(a)).nnz == 0, (name, abs(a - b).max())


@pytest.mark.parametrize(("kind", "binary", "storage", "order", "bits"), OF_OP4)
def test_op4_returns_every_bit(
    tmp_path: Path, native: Path, model: FEModel, kind: str, binary: bool, storage: Any, order: Any, bits: Any
) -> None:
    given = matrices(model, kind)
    write_op4(tmp_path / "a.op4", given, binary=binary, sparse=storage, byteorder=order, bits=bits)
    assert_same(imported(tmp_path, tmp_path / "a.op4", "--nodes", native), given)


@pytest.mark.parametrize("storage", ["dense", "bigmat", "nonbigmat"])
@pytest.mark.parametrize("kind", ["symmetric", "complex"])
def test_op4_in_single_precision_returns_its_bits(
    tmp_path: Path, native: Path, model: FEModel, kind: str, storage: Any
) -> None:
    given = {
        name: A.astype(np.complex64 if A.dtype == complex else np.float32) for name, A in matrices(model, kind).items()
    }
    write_op4(tmp_path / "a.op4", given, sparse=storage)
    doubles = {name: A.astype(np.complex128 if A.dtype.kind == "c" else float) for name, A in given.items()}
    assert_same(imported(tmp_path, tmp_path / "a.op4", "--nodes", native), doubles)


def dmig(model: FEModel, given: dict[str, sp.csr_array], kind: str) -> dict[str, DmigMatrix]:
    labels = np.stack([model.nodes.ids[model.dofs.node], model.dofs.component + 1], axis=1)
    forms = {"K": 1 if kind == "general" else 6, "M": 6}
    names = {"K": "KAAX", "M": "MAAX"}
    return {names[key]: DmigMatrix(matrix=A, rows=labels, columns=labels, form=forms[key]) for key, A in given.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_dmig_keeps_what_sixteen_characters_hold(tmp_path: Path, native: Path, model: FEModel, kind: str) -> None:
    """15 digits (14 below zero) from 0.1 to 1e15, where most of K is in N/m; 12 and 11 for the smallest of M."""
    given = matrices(model, kind)
    write_dmig(tmp_path / "a.pch", dmig(model, given, kind))
    back = imported(tmp_path, tmp_path / "a.pch", "--nodes", native)
    assert_same(back, given, rel=6e-11)
    a, b = (A.toarray().real for A in (given["K"], back.K))
    for sign, digits in ((a > 0, 6e-15), (a < 0, 6e-14)):
        large = sign & (np.abs(a) >= 0.1) & (np.abs(a) < 1e14)
        assert large.sum() > 1000 and (np.abs(a - b)[large] <= digits * np.abs(a)[large]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_pyyeti_reads_the_same_dmig(tmp_path: Path, native: Path, model: FEModel, kind: str) -> None:
    nastran = pytest.importorskip("pyyeti.nastran")
    given = matrices(model, kind)
    write_dmig(tmp_path / "a.pch", dmig(model, given, kind))
    back = imported(tmp_path, tmp_path / "a.pch", "--nodes", native)
    theirs = nastran.rddmig(str(tmp_path / "a.pch"))
    for name, A in (("kaax", back.K), ("maax", back.M)):
        assert np.array_equal(theirs[name].to_numpy(), A.toarray()), name


@pytest.mark.parametrize("layout", ["matrix input", "labels", "coordinate"])
@pytest.mark.parametrize("kind", ["symmetric", "general"])
def test_abaqus_matrices_keep_sixteen_digits(
    tmp_path: Path, native: Path, model: FEModel, kind: str, layout: Any
) -> None:
    """16 digits, as Abaqus writes itself, are wrong by 5e-16 at most."""
    given = matrices(model, kind)
    for name, A in given.items():
        labels = model.nodes.ids[model.dofs.node], model.dofs.component + 1
        write_abaqus_matrix(tmp_path / f"{name}.mtx", A, *labels, layout=layout)
    files = ["--stiffness", tmp_path / "K.mtx", "--mass", tmp_path / "M.mtx"]
    assert_same(imported(tmp_path, *files, "--nodes", native), given, rel=7e-16)


SYMMETRIES = {"symmetric": "symmetric", "general": "general", "complex": "symmetric"}


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_matrix_market_returns_every_bit(tmp_path: Path, native: Path, model: FEModel, kind: str, dense: bool) -> None:
    given = matrices(model, kind)
    for name, A in given.items():
        symmetry = SYMMETRIES[kind] if name == "K" else "symmetric"
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", A.toarray() if dense else A, precision=17, symmetry=symmetry)
    files = ["--stiffness", tmp_path / "K.mtx", "--mass", tmp_path / "M.mtx"]
    assert_same(imported(tmp_path, *files, "--nodes", native), given)


def mat_v73(path: Path, given: dict[str, sp.csr_array]) -> None:
    """As MATLAB keeps sparse matrices in version 7.3; complex numbers are pairs (real, imag)."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, A in given.items():
            C, group = sp.csc_array(A), file.create_group(name)
            group.attrs["MATLAB_sparse"] = np.uint64(C.shape[0])
            group["ir"], group["jc"] = C.indices.astype(np.uint64), C.indptr.astype(np.uint64)
            data = C.data
            if data.dtype == complex:
                data = np.rec.fromarrays([data.real, data.imag], names="real,imag")
            group["data"] = data


FILES: dict[str, Callable[[Path, dict[str, sp.csr_array]], None]] = {
    "v4.mat": lambda path, given: scipy.io.savemat(path, given, format="4"),
    "v6.mat": lambda path, given: scipy.io.savemat(path, given),
    "v7.mat": lambda path, given: scipy.io.savemat(path, given, do_compression=True),
    "dense.mat": lambda path, given: scipy.io.savemat(path, {name: A.toarray() for name, A in given.items()}),
    "v73.mat": mat_v73,
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", ["general", "complex"])
def test_matlab_files_return_every_bit(tmp_path: Path, native: Path, model: FEModel, kind: str, name: str) -> None:
    given = matrices(model, kind)
    FILES[name](tmp_path / name, given)
    assert_same(imported(tmp_path, tmp_path / name, "--nodes", native), given)


@pytest.mark.parametrize(
    ("to", "out", "files"),
    [
        ("op4", "bar.op4", ["bar.op4"]),
        ("matrix-market", "bar.mtx", ["--stiffness", "bar_K.mtx", "--mass", "bar_M.mtx"]),
    ],
)
def test_a_reduced_body_is_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model: FEModel, to: str, out: str, files: list[str]
) -> None:
    ends = [np.argsort(sign * model.nodes.xyz[:, 0])[:8] for sign in (1, -1)]
    interfaces = [make_interface(model, name=f"end {i}", nodes=rows) for i, rows in enumerate(ends)]
    with Problem(model, interfaces) as problem:
        body = elastic_body(problem, CraigBampton(modes=3).reduce(problem, "cb"), make_part(problem))
    source = write_body(tmp_path / "bar.h5", [body])
    body = read_body(source).bodies["cb"]
    export_body(source, to, path=tmp_path / out)
    monkeypatch.chdir(tmp_path)
    given = {"K": sp.csr_array(body.stiffness_matrix), "M": sp.csr_array(body.mass_matrix)}
    assert_same(imported(tmp_path, *files), given)


@pytest.mark.parametrize("as_list", [False, True])
def test_what_exudyn_saves_is_read(tmp_path: Path, model: FEModel, as_list: bool) -> None:
    """Exudyn keeps a list as a group with a dataset for each number."""
    fem_module = pytest.importorskip("exudyn.FEM")
    numbers = [5, 1, 3]
    fem = fem_module.FEMinterface()
    fem.nodes = {"Position": model.nodes.xyz.copy()}
    fem.stiffnessMatrix, fem.massMatrix = sp.csr_matrix(model.K), sp.csr_matrix(model.M)
    fem.nodeSets = [{"Name": "TIP", "NodeNumbers": numbers if as_list else np.array(numbers)}]
    fem.SaveToFile(str(tmp_path / "fem.hdf5"))
    back = imported(tmp_path, tmp_path / "fem.hdf5")
    assert_same(back, {"K": model.K, "M": model.M})
    assert np.array_equal(back.nodes.xyz, model.nodes.xyz) and back.nodes.sets["TIP"].tolist() == [1, 3, 5]


def test_a_complex_matrix_is_not_written_as_a_real_one(tmp_path: Path, model: FEModel) -> None:
    with refusal("unsupported", "matrix"):
        write_abaqus_matrix(tmp_path / "a.mtx", matrices(model, "complex")["K"], layout="coordinate")
    assert not list(tmp_path.iterdir())
