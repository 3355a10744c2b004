"""Matrices that CalculiX stores, against those of Abaqus for the same rod."""

import gzip
import shutil

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from morembs.importers.matrices.abaqus import read_abaqus_matrix
from morembs.importers.matrices.calculix import read_calculix_matrices
from tests.support.refusals import refusal

CONROD_HZ = [5931.72907, 10572.56166, 13006.48953, 14286.39617, 22263.38637, 24315.61338, 24728.82045, 28365.58687]


def small(folder, **change):
    """Two nodes: 1 with x, y, z and 10 with x and y."""
    files = {
        "dof": "1.1\n1.2\n1.3\n10.1\n10.2\n",
        "sti": "".join(f"{i} {j}  {1.0 / (i + j):.13e}\n" for j in range(1, 6) for i in range(1, j + 1)),
        "mas": "".join(f"{i} {i}  {float(i):.13e}\n" for i in range(1, 6)),
    }
    for end, text in (files | change).items():
        (folder / f"job.{end}").write_text(text)
    return folder / "job.sti"


def test_conrod_of_calculix(shared_data, tmp_path):
    folder = shared_data / "conrod_abaqus"
    for end in ("sti", "mas"):
        with gzip.open(folder / f"conrod_ccx.{end}.gz") as packed, open(tmp_path / f"conrod_ccx.{end}", "wb") as file:
            shutil.copyfileobj(packed, file)
    shutil.copy(folder / "conrod_ccx.dof", tmp_path)
    imported = read_calculix_matrices(tmp_path / "conrod_ccx")
    of_abaqus = read_abaqus_matrix(folder / "job_matrix_generate_conrod_MASS1.mtx").matrix
    assert np.abs(imported.M - of_abaqus).max() <= 3e-14 * np.abs(of_abaqus).max()
    x = sp.csr_array((imported.dof == 1).astype(float)[None, :])
    assert (x @ imported.M @ x.T).sum() == pytest.approx(0.1379211513593743, rel=1e-12)
    assert len(imported.node) == 2805 and np.unique(imported.node).size == 935
    values = spl.eigsh(imported.K, 14, imported.M, sigma=-1e8, return_eigenvectors=False)
    assert np.sqrt(np.sort(values)[6:]) / (2 * np.pi) == pytest.approx(CONROD_HZ, rel=1e-8)


def test_small_files(tmp_path):
    for name in ("job.sti", "job.mas", "job.dof", "job"):
        small(tmp_path)
        imported = read_calculix_matrices(tmp_path / name)
        assert imported.node.tolist() == [1, 1, 1, 10, 10] and imported.dof.tolist() == [1, 2, 3, 1, 2]
        i = np.arange(1, 6)
        assert imported.K.toarray() == pytest.approx(1 / (i[:, None] + i), rel=1e-13)
        assert imported.M.diagonal().tolist() == [1, 2, 3, 4, 5] and imported.M.nnz == 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dof": "1.1\n1.2\n1.3\n10.1\n"}, ("file", "job.sti", "5", "4")),
        ({"dof": "1.1\n1.2\n1.3\n10.1\n10.2\n10.3\n"}, ("file", "job.sti", "6")),
        ({"dof": "1.1\n1.2\n1.3\n10.1\n10.1\n"}, ("file", "job.dof")),
        ({"dof": "1\n2\n"}, ("file", "job.dof", "node.direction")),
        ({"mas": "1 1 1.0\n2 2 1.0\n"}, ("file", "job.mas")),
        ({"mas": "1 2 1.0\n2 1 1.0\n"}, ("file", "job.mas")),
        ({"mas": "1 1 1.0\n2 2 1."}, ("file", "job.mas")),
        ({"mas": ""}, ("file", "job.mas")),
        ({"mas": "\0\0\n"}, ("file", "job.mas")),
        ({"mas": "1 1 nan\n"}, ("file", "job.mas")),
    ],
)
def test_faults_have_one_message(tmp_path, change, message):
    with refusal(*message):
        read_calculix_matrices(small(tmp_path, **change))


def test_a_missing_file_is_named(tmp_path):
    path = small(tmp_path)
    (tmp_path / "job.mas").unlink()
    with refusal("file", "job.mas"):
        read_calculix_matrices(path)
