"""OP4 files against pyYeti, an independent reader and writer, and against themselves bit by bit."""

import itertools
import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.exporters.op4 import write_op4
from morembs.importers.matrices.op4 import read_op4
from tests.support.refusals import refusal

STORAGES = ("dense", "bigmat", "nonbigmat")
BINARY = list(itertools.product(STORAGES, ("little", "big"), (32, 64)))


def samples():
    """Matrices of every kind: sparse, with empty columns, symmetric, complex, single precision, zero."""
    rng = np.random.default_rng(1)
    A = sp.random_array((40, 30), density=0.2, rng=rng).toarray()
    A[:, 3] = 0.0
    S = sp.random_array((50, 50), density=0.1, rng=rng)
    F = rng.standard_normal((7, 5)).astype(np.float32)
    return {
        "A": A,
        "SYM": sp.csr_array(S + S.T),
        "CPLX": A * (1 + 0.3j) ** 7,
        "F": F,
        "G": (F + 2j * F).astype(np.complex64),
        "ZERO": np.zeros((3, 4)),
        "TINY": np.array([[1e-300, -np.pi], [-np.pi, 1e300]]),
    }


def full(matrix):
    return matrix.toarray() if sp.issparse(matrix) else np.asarray(matrix)


@pytest.mark.parametrize(("storage", "order", "bits"), BINARY)
def test_binary_files_return_every_bit(tmp_path, storage, order, bits):
    given = samples()
    write_op4(tmp_path / "a.op4", given, sparse=storage, byteorder=order, bits=bits)
    back = read_op4(tmp_path / "a.op4")
    assert list(back) == list(given)
    for name, matrix in given.items():
        assert np.array_equal(full(back[name].matrix), full(matrix)), name
    assert [matrix.type for matrix in back.values()] == [2, 2, 4, 1, 3, 2, 2]
    assert [matrix.form for matrix in back.values()] == [2, 6, 2, 2, 2, 2, 6]
    assert back["A"].storage == storage and type(back["ZERO"].matrix) is sp.csr_array


@pytest.mark.parametrize("storage", STORAGES)
def test_text_files_return_every_bit(tmp_path, storage):
    given = {name: matrix for name, matrix in samples().items() if name != "TINY"}
    write_op4(tmp_path / "a.op4", given, binary=False, sparse=storage)
    back = read_op4(tmp_path / "a.op4")
    for name, matrix in given.items():
        assert np.array_equal(full(back[name].matrix), full(matrix)), name


@pytest.mark.parametrize("variant", [(b, *v) for b in (True, False) for v in BINARY if b or v[1:] == ("little", 32)])
def test_pyyeti_reads_what_is_written(tmp_path, variant):
    op4 = pytest.importorskip("pyyeti.nastran.op4")
    binary, storage, order, bits = variant
    given = {name: matrix for name, matrix in samples().items() if name != "TINY"}
    write_op4(tmp_path / "a.op4", given, binary=binary, sparse=storage, byteorder=order, bits=bits)
    back = op4.load(str(tmp_path / "a.op4"))
    for name, matrix in given.items():
        assert np.array_equal(full(back[name.lower()][0]), full(matrix)), name


@pytest.mark.parametrize(("storage", "binary", "order"), list(itertools.product(STORAGES, (True, False), "<>")))
def test_what_pyyeti_writes_is_read(tmp_path, storage, binary, order):
    op4 = pytest.importorskip("pyyeti.nastran.op4")
    given = {name: full(matrix) for name, matrix in samples().items() if name in ("A", "SYM", "CPLX")}
    op4.OP4().write(str(tmp_path / "a.op4"), given, binary=binary, endian=order, sparse=storage)
    back = read_op4(tmp_path / "a.op4")
    for name, matrix in given.items():
        assert np.array_equal(full(back[name].matrix), matrix), name


def nastran_files():
    pyyeti = pytest.importorskip("pyyeti")
    return sorted((Path(pyyeti.__file__).parent / "tests" / "nastran_op4_data").glob("*.op4"))


def test_files_written_by_nastran():
    """Files of several versions of Nastran that come with pyYeti, in all variants, agree with its own reader."""
    op4 = pytest.importorskip("pyyeti.nastran.op4")
    files = [p for p in nastran_files() if "large_dim" not in p.name and p.stat().st_size < 3e6 and "bad" not in p.name]
    if not files:
        pytest.skip("pyYeti came without its test data")
    seen = set()
    for path in files:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            expected = op4.load(str(path))
        back = read_op4(path)
        assert sorted(back) == sorted(name.upper() for name in expected)
        for name, (matrix, form, kind) in expected.items():
            ours = back[name.upper()]
            seen.add((ours.storage, ours.type))
            assert (ours.form, ours.type) == (form, kind), (path.name, name)
            assert np.array_equal(full(ours.matrix), full(matrix)), (path.name, name)
    assert len(seen) == 12  # each storage in each type


def test_one_triangle_of_a_symmetric_matrix_is_completed(tmp_path):
    S = full(samples()["SYM"])
    write_op4(tmp_path / "a.op4", {"S": sp.csr_array(np.tril(S))}, byteorder="little")
    data = bytearray((tmp_path / "a.op4").read_bytes())
    data[12:16] = (6).to_bytes(4, "little")
    (tmp_path / "a.op4").write_bytes(data)
    back = read_op4(tmp_path / "a.op4")["S"]
    assert back.mirrored and np.array_equal(full(back.matrix), S)


def test_only_the_named_matrices_are_kept(tmp_path):
    write_op4(tmp_path / "a.op4", samples())
    assert list(read_op4(tmp_path / "a.op4", names=["sym"])) == ["SYM"]
    with refusal("unknown", "", "CPLY", "CPLX"):
        read_op4(tmp_path / "a.op4", names=["CPLY"])
    joined = tmp_path / "twice.op4"
    joined.write_bytes((tmp_path / "a.op4").read_bytes() * 2)
    with refusal("conflict", "", "twice.op4", "'A'"):
        read_op4(joined)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("storage", STORAGES)
def test_every_cut_is_noticed(tmp_path, binary, storage):
    """A file cut anywhere is refused, or lacks whole matrices (where it was cut just behind one)."""
    given = {name: matrix for name, matrix in samples().items() if name in ("A", "CPLX")}
    write_op4(tmp_path / "a.op4", given, binary=binary, sparse=storage)
    data = (tmp_path / "a.op4").read_bytes()
    accepted = 0
    for length in np.linspace(1, len(data) - 1, 60).astype(int):
        (tmp_path / "cut.op4").write_bytes(data[:length])
        try:
            back = read_op4(tmp_path / "cut.op4")
        except InputError:
            continue
        accepted += 1
        for name, matrix in back.items():
            assert np.array_equal(full(matrix.matrix), full(given[name]))
    assert accepted <= 1


def test_damage_is_an_input_error_or_another_number(tmp_path):
    """Random damage never ends in another exception."""
    rng = np.random.default_rng(0)
    for binary, storage in itertools.product((True, False), STORAGES):
        write_op4(tmp_path / "a.op4", {"A": samples()["A"]}, binary=binary, sparse=storage)
        data = (tmp_path / "a.op4").read_bytes()
        for _ in range(40):
            broken = bytearray(data)
            for at in rng.integers(0, len(data), 3):
                broken[at] = rng.integers(0, 256)
            (tmp_path / "b.op4").write_bytes(broken)
            try:
                back = read_op4(tmp_path / "b.op4")
            except InputError:
                continue
            assert all(np.isfinite(full(matrix.matrix)).all() for matrix in back.values())


def test_faults_have_one_message(tmp_path):
    path = tmp_path / "x.op4"
    for content, message in (
        (b"", ("file", "x.op4")),
        (b"\x01\x02" * 100, ("file", "x.op4")),
        (b"hello world\n", ("file", "", "OP4")),
        (b"       2       2       6       2K       1P,3E23.16\n", ("file",)),
    ):
        path.write_bytes(content)
        with refusal(*message):
            read_op4(path)
    with refusal("file", "none.op4"):
        read_op4(tmp_path / "none.op4")
    for given, message in (
        ({"TOO_LONG_A": np.eye(2)}, ("value", "name", "TOO_LONG_A")),
        ({"two words": np.eye(2)}, ("value", "name")),
        ({"A": np.array([[np.nan]])}, ("value", "A", "NaN")),
        ({"A": np.eye(2), "a": np.eye(2)}, ("value", "names")),
        ({"A": np.zeros((0, 3))}, ("value", "A")),
    ):
        with refusal(*message):
            write_op4(path, given)
    with refusal("unsupported", "layout", "65535"):
        write_op4(path, {"A": sp.csr_array((70000, 2))}, sparse="nonbigmat")
    with refusal("value", "units", "9.9e99"):
        write_op4(path, {"A": np.array([[1e200]])}, binary=False)


def test_a_matrix_that_is_not_symmetric_is_not_called_so(tmp_path):
    A = np.array([[1.0, 2.0], [3.0, 4.0]])
    write_op4(tmp_path / "a.op4", {"A": A}, sparse="bigmat")
    data = bytearray((tmp_path / "a.op4").read_bytes())
    data[12:16] = (6).to_bytes(4, "little")
    (tmp_path / "a.op4").write_bytes(data)
    with refusal("file", "a.op4"):
        read_op4(tmp_path / "a.op4")


@pytest.mark.parametrize("storage", STORAGES)
def test_counts_in_text_must_fit_the_numbers(tmp_path, storage):
    write_op4(tmp_path / "a.op4", {"A": samples()["A"]}, binary=False, sparse=storage)
    lines = (tmp_path / "a.op4").read_text().split("\n")
    column, row, words = (int(lines[1][i : i + 8]) for i in (0, 8, 16))
    lines[1] = f"{column:8}{row:8}{words + 3:8}"
    (tmp_path / "a.op4").write_text("\n".join(lines))
    with refusal("file", "", "a.op4", "'A'"):
        read_op4(tmp_path / "a.op4")
