"""Damage that random changes of real files found: one message each, no crash, no full memory, no wrong model."""

from __future__ import annotations

import gzip
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.base.errors import InputError
from morembs.exporters.op4 import write_op4
from morembs.fem import FEModel
from morembs.importers import import_file
from morembs.importers.matrices.matlab_v5 import read_matlab_v5
from morembs.importers.matrices.op4 import read_op4
from morembs.importers.model_file import write_model
from tests.support.machine import has_memory
from tests.support.meshes import box, steel
from tests.support.refusals import refusal

STEEL = "young=2.1e11,poisson=0.3,density=7850"
BANNER = "%%MatrixMarket matrix coordinate real "


@pytest.fixture(scope="module")
def model() -> FEModel:
    return steel(box("hex8", (2, 1, 1), (0.2, 0.1, 0.08)))


def refused(path: Path, *arguments: object) -> str:
    """The one message of an import that must fail and leaves no file."""
    out = path.parent / "out.model.h5"
    result = CliRunner().invoke(app, ["import", *map(str, [path, *arguments]), "-o", str(out)])
    assert result.exit_code == 2 and isinstance(result.exception, SystemExit), (result.stdout, result.exception)
    assert result.stderr.startswith("error: ") and len(result.stderr.strip().splitlines()) == 1 and not out.exists()
    return result.stderr


# Matrix Market: the reader of SciPy passes over what follows a number, and ends the process on some damage.


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{BANNER}general\n2 2 2\n1 1 1.0junk\n2 2 1.0\n", "cannot be read as numbers"),
        (f"{BANNER}general\n2 2 2\n1 1 3.81 5621e+08\n2 2 1.0\n", "has 4 numbers; expected 3"),
        (f"{BANNER}general\n2 2 2000000000\n1 1 1.0\n2 2 1.0\n", "announces 2000000000 entries and holds 2"),
        (f"{BANNER}general\n900000000 900000000 2\n1 1 1.0\n2 2 1.0\n", "announces 900000000 rows but only 2 entries"),
        (f"{BANNER}symmetric\n2 2 3\n1 1 1.0\n1 2 1.0\n2 1 1.0\n", "entries in both triangles"),
        (f"{BANNER}symmetric\n2 2 3\n1 1 1.0\n2 1 1.", "ends within a line"),
        (f"{BANNER}skew-symmetric\n2 2 2\n1 1 1.0\n2 1 1.0\n", "skew-symmetric, which its diagonal is not"),
        (f"{BANNER}hermitian\n2 2 1\n1 1 1.0\n", "is real hermitian, which is not read"),
        (f"{BANNER}general\n", "no line with its size"),
        (f"{BANNER}general\n2 2 1\n1 3 0.0\n", "row or column 3; expected 1 to 2"),
        (f"{BANNER}symmetric\n2 3 1\n1 1 1.0\n", "symmetric matrix of the shape (2, 3)"),
        (f"{BANNER}general\n2 3 1\n1 1 1.0\n", "has the shape (2, 3); expected a square matrix"),
        ("%%MatrixMarket matrix array real general\n2 2\n1\n2\n3\n", "announces 4 numbers and holds 3"),
    ],
)
def test_damaged_matrix_market(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "k.mtx").write_text(text)
    assert words in refused(tmp_path / "k.mtx")


def test_damaged_gzip(tmp_path: Path) -> None:
    packed = gzip.compress((BANNER + "general\n3 3 3\n1 1 1.0\n2 2 2.0\n3 3 3.0\n").encode())
    for damage in (packed[:-9], packed[:20] + b"\xff\xff\xff" + packed[23:], packed[:-6] + bytes(6)):
        (tmp_path / "k.mtx.gz").write_bytes(damage)
        assert "cut off or not a gzip file" in refused(tmp_path / "k.mtx.gz")


@pytest.mark.parametrize("symmetry", ["symmetric", "skew-symmetric", "hermitian", "general"])
@pytest.mark.parametrize("dense", [False, True])
def test_every_symmetry_of_matrix_market(tmp_path: Path, symmetry: str, dense: bool) -> None:
    A = np.random.default_rng(2).standard_normal((5, 5, 2)) @ [1, 1j]
    A = {"symmetric": A + A.T, "skew-symmetric": A - A.T, "hermitian": A + A.conj().T, "general": A}[symmetry]
    A[3, 1] = A[1, 3] = 0.0
    scipy.io.mmwrite(tmp_path / "k.mtx", A if dense else sp.coo_array(A), symmetry=symmetry, precision=17)
    K = import_file(tmp_path / "k.mtx").K
    assert K is not None and np.array_equal(K.toarray(), A)


# HDF5: datasets that announce terabytes of which nothing is stored.


def hdf5_part(path: Path, name: str, change: Callable[[h5py.File, str], None]) -> Path:
    with h5py.File(path, "r+") as file:
        file.pop("checksums", None)  # which other writers may leave out
        change(file, name)
    return path


def hollow(file: h5py.File, name: str) -> None:
    kind = file[name].dtype
    del file[name]
    file.create_dataset(name, shape=(10**12,), dtype=kind, chunks=(1024,))


def put(value: Any) -> Callable[[h5py.File, str], None]:
    def change(file: h5py.File, name: str) -> None:
        del file[name]
        file[name] = value

    return change


def exudyn(path: Path, model: FEModel) -> Path:
    with h5py.File(path, "w") as file:
        file["type"], file["fileVersion"], file["nodes/Position"] = "FEMinterface", 4, model.nodes.xyz
        for name, A in (("stiffnessMatrix", model.K), ("massMatrix", model.M)):
            for part in ("data", "indices", "indptr"):
                file[f"{name}/{part}"] = getattr(A, part)
            file[f"{name}/shape"] = A.shape
    return path


@pytest.mark.parametrize("name", ["nodes/Position", "stiffnessMatrix/data", "massMatrix/indptr"])
def test_nothing_stored_in_hdf5(tmp_path: Path, model: FEModel, name: str) -> None:
    path = exudyn(tmp_path / "fem.h5", model)
    assert "announces" in refused(hdf5_part(path, name, hollow))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("stiffnessMatrix/shape", np.zeros(0), "expected numbers of rows and columns"),
        ("stiffnessMatrix/indptr", np.zeros(0, dtype=int), "row pointers do not fit"),
        ("nodes/Position", np.array([b"x"]), "does not hold numbers"),
    ],
)
def test_damaged_exudyn_files(tmp_path: Path, model: FEModel, name: str, value: Any, words: str) -> None:
    assert words in refused(hdf5_part(exudyn(tmp_path / "fem.h5", model), name, put(value)))


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("matrices/K/data", hollow, "announces"),
        ("nodes/coordinates", hollow, "announces"),
        ("node_sets/offsets", put(np.array([0, 9])), "do not fit their names"),
        ("dofs/node", put(np.array([0.5] * 36)), "expected integers"),
        ("matrices/M/data", put(np.array([1 + 1j] * 9)), "M/data holds values of type complex128"),
        ("elements/block_0/nodes", put(np.zeros((0, 8), dtype=int)), "expected (0) by /elements/block_0/nodes"),
        ("elements/node_count", put(5), "expected 0 to 4, places in /elements/node_count"),
        ("elements/node_count", put(50), "/elements/node_count holds 50; expected 0 to 12"),
        ("elements/block_0/nodes", put(np.full((2, 8), 1.5)), "expected integers"),
        ("dofs/component", put(1), "/dofs/component has the shape (); expected"),
        ("nodes/coordinates", put(np.ones((12, 2))), "/nodes/coordinates has the shape (12, 2)"),
        ("materials/density", put(np.ones((3, 1))), "/materials/density has the shape (3, 1)"),
    ],
)
def test_damaged_model_files(
    tmp_path: Path, model: FEModel, name: str, change: Callable[[h5py.File, str], None], words: str
) -> None:
    path = write_model(tmp_path / "a.model.h5", model)
    assert words in refused(hdf5_part(path, name, change))


# NumPy and MATLAB: indices outside the matrix, which SciPy would follow out of the memory.


@pytest.mark.parametrize("part", ["indices", "indptr", "data", "shape", "format"])
def test_damaged_npz(tmp_path: Path, model: FEModel, part: str) -> None:
    path = tmp_path / "k.npz"
    sp.save_npz(path, sp.csc_array(model.K))
    held = dict(np.load(path))
    damaged: dict[str, Any] = {
        "indices": held["indices"] + 10**6,
        "indptr": held["indptr"][::-1],
        "data": held["data"][:-3],
        "shape": np.array([3, -1]),
        "format": np.array(b"xyz"),
    }
    np.savez(path, **{**held, part: damaged[part]})
    assert "k.npz" in refused(path)


def test_damaged_zip(tmp_path: Path, model: FEModel) -> None:
    path = tmp_path / "k.npz"
    sp.save_npz(path, model.K)
    whole = path.read_bytes()
    at = whole.index(b".npy") + 60
    for damage in (whole[: len(whole) // 2], whole[:at] + b"\xff" * 40 + whole[at + 40 :], b"PK\x03\x04" + b"\0" * 30):
        path.write_bytes(damage)
        assert "cannot be read as a NumPy archive" in refused(path)


def test_packed_zeros_do_not_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "k.npz", K=np.zeros((1000, 1000)))
    scipy.io.savemat(tmp_path / "k.mat", {"K": np.zeros((1000, 1000))}, do_compression=True)
    has_memory(monkeypatch, free=7_000_000)
    for name in ("k.npz", "k.mat"):
        assert "holds arrays of 8e+06 bytes; 7e+06 bytes of memory are free" in refused(tmp_path / name)


@pytest.mark.parametrize("kind", ["coo", "dia", "bsr", "csc", "csr"])
def test_every_format_of_save_npz(tmp_path: Path, model: FEModel, kind: str) -> None:
    sp.save_npz(tmp_path / "k.npz", model.K.asformat(kind))
    K = import_file(tmp_path / "k.npz").K
    assert K is not None and (K != model.K).nnz == 0


def element(kind: int, body: bytes) -> bytes:
    return struct.pack("<II", kind, len(body)) + body + bytes(-len(body) % 8)


def mat_v5(path: Path, rows: list[int], values_kind: int = 9, packed: bool = False) -> Path:
    """A file with a sparse K of 2 x 2 with the given rows of its two entries."""
    parts = [
        element(6, struct.pack("<II", 5, 2)),
        element(5, struct.pack("<ii", 2, 2)),
        element(1, b"K"),
        element(5, struct.pack("<ii", *rows)),
        element(5, struct.pack("<iii", 0, 1, 2)),
        element(values_kind, struct.pack("<dd", 3.0, 4.0)),
    ]
    body = element(14, b"".join(parts))
    if packed:
        packed_body = zlib.compress(body)
        body = struct.pack("<II", 15, len(packed_body)) + packed_body
    path.write_bytes(b"MATLAB 5.0".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + body)
    return path


def test_damaged_matlab_files(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    for packed in (False, True):
        A = read_matlab_v5(mat_v5(path, [0, 1], packed=packed)).matrices["K"]
        assert A.toarray().tolist() == [[3, 0], [0, 4]]
    for rows in ([0, 2], [-1, 0], [10**9, 0]):
        assert "indices lie outside" in refused(mat_v5(path, rows))
    # The type of the numbers is none; SciPy looks it up behind the end of a table.
    assert "values of a variable are damaged" in refused(mat_v5(path, [0, 1], values_kind=399))
    whole = mat_v5(path, [0, 1]).read_bytes()
    for cut in range(129, len(whole)):
        path.write_bytes(whole[:cut])
        with refusal("file", "", "MATLAB"):
            import_file(path)


# Meshes: cells on points that are not there, coordinates beyond all measure.


def vtk(path: Path, change: Callable[[np.ndarray, np.ndarray], None]) -> Path:
    mesh = box("hex8", (2, 1, 1), (0.2, 0.1, 0.08))
    points, cells = mesh.nodes.xyz.copy(), mesh.blocks[0].nodes.copy()
    change(points, cells)
    meshio.write(path, meshio.Mesh(points, [("hexahedron", cells)]))
    return path


def far(value: float) -> Callable[[np.ndarray, np.ndarray], None]:
    def change(points: np.ndarray, cells: np.ndarray) -> None:
        points[0, 0] = value

    return change


def missing(points: np.ndarray, cells: np.ndarray) -> None:
    cells[0, 0] = 904


def flat(points: np.ndarray, cells: np.ndarray) -> None:
    points[:, 2] *= 1e-307


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (missing, "on a point that is not there"),
        (far(1e80), "is damaged, or the units are wrong"),
        (far(np.nan), "not finite"),
        (flat, "degenerate"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_damaged_meshes(tmp_path: Path, change: Callable[[np.ndarray, np.ndarray], None], words: str) -> None:
    assert words in refused(vtk(tmp_path / "a.vtu", change), "--material", STEEL)


@pytest.mark.parametrize("ending", ["med", "xdmf"])
def test_nothing_stored_in_meshes_of_hdf5(tmp_path: Path, ending: str) -> None:
    path = vtk(tmp_path / f"a.{ending}", lambda points, cells: None)
    store = path if ending == "med" else path.with_suffix(".h5")
    with h5py.File(store) as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    hdf5_part(store, names[0], hollow)
    assert "announces" in refused(path, "--material", STEEL)


def test_entries_beyond_all_measure(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", K=np.diag([1.0, 1e80]), M=np.eye(2))
    assert "has an entry of 1e+80" in refused(tmp_path / "a.npz")
    deck = tmp_path / "a.inp"
    corners = "1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT,TYPE=C3D4,ELSET=A\n1,1,2,3,4\n"
    material = "*MATERIAL,NAME=S\n*ELASTIC\n1e80,.3\n*DENSITY\n1.\n"
    deck.write_text(f"*NODE\n{corners}*SOLID SECTION,ELSET=A,MATERIAL=S\n{material}")
    assert "K has an entry of" in refused(deck)


def test_a_string_of_an_op4_text_without_its_number(tmp_path: Path) -> None:
    path = tmp_path / "a.op4"
    write_op4(path, {"K": sp.csr_array(np.diag([1.0, 2.0, 3.0]))}, binary=False, sparse="nonbigmat")
    lines = path.read_text().splitlines(keepends=True)
    lines[2] = "        \n"
    path.write_text("".join(lines))
    with pytest.raises(InputError):
        read_op4(path)


# gmsh: meshio makes a table as long as the largest tag of a node.


@pytest.mark.parametrize(
    ("version", "binary", "old", "new"),
    [
        ("gmsh22", False, b"\n8 ", b"\n300000000 "),
        ("gmsh", False, b"\n8\n", b"\n300000000\n"),
        ("gmsh", True, struct.pack("=QQ", 7, 8), struct.pack("=QQ", 7, 300_000_000)),
    ],
    ids=["2.2", "4.1", "4.1 binary"],
)
def test_tags_of_nodes_far_beyond_their_number(tmp_path, version, binary, old, new):
    path = tmp_path / "part.msh"
    mesh = box("hex8", (1, 1, 1), (0.1, 0.1, 0.1))
    meshio.write(path, meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes)]), version, binary=binary)
    before, nodes, after = path.read_bytes().partition(b"$Nodes")
    path.write_bytes(before + nodes + after.replace(old, new, 1))
    assert "renumber them in gmsh" in refused(path, "--material", STEEL)


def test_a_header_of_an_npz_array_that_does_not_end(tmp_path, model):
    path = tmp_path / "part.npz"
    np.savez(path, K=model.K.toarray(), M=model.M.toarray())
    # The header is a dictionary of Python; NumPy's reader gives it to Python's tokenizer.
    path.write_bytes(path.read_bytes().replace(b"'shape': (", b"'shape':((", 1))
    assert "cannot be read as a NumPy archive" in refused(path)


def test_two_arrays_of_one_name_are_refused(tmp_path):
    """NumPy reads the last of them, in silence."""
    np.savez(tmp_path / "k.npz", K=np.diag([1.0, 2.0]), M=np.eye(2))
    with zipfile.ZipFile(tmp_path / "k.npz", "a") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        archive.writestr("K.npy", archive.read("M.npy"))
    with refusal("file", "K"):
        import_file(tmp_path / "k.npz")
