"""The body file: whole or not there, the same bytes for the same input, and readable by others."""

import builtins
import dataclasses
import errno
import io
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import OutputError
from morembs.base.progress import Stage
from morembs.body import CellBlock, elastic_body, make_part
from morembs.body.build import body_of
from morembs.body.file import check_names, read_body, write_body
from morembs.body.vtkhdf import shown_modes
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, Modal, ReducedModel
from morembs.storage.checksums import seal
from morembs.storage.safefile import check_writable
from scripts.schema import stale
from tests.support.meshes import box, steel, where
from tests.support.processes import apart, python
from tests.support.refusals import refusal
from tests.support.stored import everything

ROOT = Path(__file__).parents[2]
SCHEMA = ROOT / "docs" / "reference" / "schema.md"
READERS = (ROOT / "docs" / "howto" / "read_bodies.md", SCHEMA.with_suffix("") / "conventions.md")
PROVENANCE = {
    "created": "2024-05-06T07:08:09+00:00",
    "solver": "superlu",
    "threads": 2,
    "checked": True,
    "nothing": None,
    "host": {"system": "Linux", "cores": [1, 2]},
    "mixed": [1, "a"],
    "stages": [Stage(name=n, seconds=s, peak_memory_bytes=9) for n, s in (("read", 0.5), ("modes", 1.5))],
}
EXPOSED = {"left": (0, 1, 2, 4), "right": (0, 1, 2), "mid point": (1, 2)}
needs_octave = pytest.mark.skipif(shutil.which("octave") is None, reason="octave is not installed")


@pytest.fixture(scope="module")
def bar():
    """A bar with one interface of each coupling, reduced in two ways."""
    model = steel(box("hex20", (4, 1, 1), (0.5, 0.05, 0.03)))
    chosen = (("left", 0.0, "rigid"), ("right", 0.5, "average"), ("mid point", 0.25, "direct"))
    interfaces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling=c, components=EXPOSED[n]) for n, x, c in chosen
    ]
    with Problem(model, interfaces) as problem:
        part = make_part(problem)
        modal = Modal(modes=6).reduce(problem, "modal")
        others = CraigBampton(modes=3).reduce(problem, "craig-bampton")
        full = elastic_body(problem, modal, part)
        plain = dataclasses.replace(elastic_body(problem, others, part), full_frequencies_hz=None)
    return SimpleNamespace(model=model, part=part, bodies=[full, plain])


@pytest.fixture(scope="module")
def stored(bar, tmp_path_factory):
    return write_body(tmp_path_factory.mktemp("stored") / "body.h5", bar.bodies, provenance=PROVENANCE)


def reduced_model(M, K, rigid_count=0, **matrices):
    """A reduced model of nothing."""
    n = len(K)
    parts = {"D": np.zeros((n, n)), "B": np.zeros((n, 0)), "C": np.zeros((0, n)), "V": np.zeros((0, n)), **matrices}
    return ReducedModel(name="made", M=M, K=K, mode_kind=("elastic",) * n, rigid_count=rigid_count, **parts)


class Waves:
    """A basis that is made on the fly. Column j, row i: sin(i + 1) + j."""

    def __init__(self, rows, order, fail_at, error):
        self.rows, self.order, self.fail_at, self.error, self.asked = rows, order, fail_at, error, 0

    def __call__(self, columns=slice(None)):
        self.asked += 1
        wanted = range(self.order)[columns]
        if self.fail_at is not None and self.fail_at in wanted:
            raise self.error
        return np.sin(np.arange(1.0, self.rows + 1))[:, None] + np.arange(wanted.start, wanted.stop)


def made(n_nodes, order, fail_at=None, error=None, name="made"):
    """A body without a model."""
    x = np.arange(3.0 * n_nodes).reshape(-1, 3)
    zero, rows = np.zeros((order, order)), np.arange(n_nodes)
    part = SimpleNamespace(
        mass=1.0,
        center_of_mass=np.zeros(3),
        inertia=np.eye(3),
        nodes=Rows(ids=rows + 1, xyz=x),
        cells=(CellBlock(vtk=1, connectivity=rows[:, None]),),
        transformation=sp.csr_array((3 * n_nodes, 0)),
        interfaces=(),
        columns={},
        node_ids=rows + 1,
        source="",
        warnings=(),
    )
    reduced = reduced_model(np.eye(order), np.diag(np.arange(1.0, order + 1)), D=zero)
    frequencies = np.sqrt(np.arange(1.0, order + 1)) / (2 * np.pi)
    body = body_of(reduced, part, frequencies_hz=frequencies, basis=Waves(3 * n_nodes, order, fail_at, error))
    return dataclasses.replace(body, name=name)


class Rows(SimpleNamespace):
    def __len__(self):
        return len(self.ids)


def child(code, folder, **environment):
    """Run Python code in another process, where it may ruin limits and memory."""
    head = f"import sys; sys.path[:0] = [{str(ROOT)!r}]\nfrom tests.body.test_storage import *\n"
    return subprocess.run(
        [sys.executable, "-c", head + code],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, **environment},
    )


def test_everything_comes_back_to_the_last_bit(bar, stored):
    back = read_body(stored)
    assert list(back.bodies) == ["modal", "craig-bampton"]
    assert list(back.interfaces) == ["left", "right", "mid point"]
    part = bar.part
    assert back.mass == part.mass
    for read, written in (
        (back.center_of_mass, part.center_of_mass),
        (back.inertia, part.inertia),
        (back.node_ids, part.nodes.ids),
        (back.coordinates, part.nodes.xyz),
    ):
        np.testing.assert_array_equal(read, written)
    for body in bar.bodies:
        body_read, reduced = back.bodies[body.name], body.reduced
        for name, value in (
            ("mass_matrix", reduced.M),
            ("stiffness_matrix", reduced.K),
            ("damping_matrix", reduced.D),
            ("input_matrix", reduced.B),
            ("frequencies_hz", body.frequencies_hz),
        ):
            np.testing.assert_array_equal(getattr(body_read, name), value, err_msg=name)
        assert body_read.mode_kind == reduced.mode_kind and body_read.rigid_count == reduced.rigid_count == 6
        assert body_read.recipe == body.recipe and body_read.reduced.structural == 0
        np.testing.assert_array_equal(body_read.basis(), body.basis())
        for columns in (slice(2, 5), slice(None, None, 3), slice(None, None, -2), slice(3, 3)):
            np.testing.assert_array_equal(body_read.basis(columns), body.basis()[:, columns])
    np.testing.assert_array_equal(back.bodies["modal"].full_frequencies_hz, bar.bodies[0].full_frequencies_hz)
    assert back.bodies["craig-bampton"].full_frequencies_hz is None
    assert back.recipe["bodies"]["modal"] == bar.bodies[0].recipe


def test_interfaces_and_the_meaning_of_the_inputs(bar, stored):
    back = read_body(stored)
    for interface in bar.part.interfaces:
        stored_interface = back.interfaces[interface.name]
        assert (stored_interface.coupling, stored_interface.components) == (interface.coupling, EXPOSED[interface.name])
        np.testing.assert_array_equal(stored_interface.node_ids, bar.model.nodes.ids[interface.nodes])
        for name in ("point", "axes", "weights"):
            np.testing.assert_array_equal(getattr(stored_interface, name), getattr(interface, name))
    # Motion of a node of the direct interface along z, once through B, once through the basis.
    body = back.bodies["craig-bampton"]
    for column in np.flatnonzero(back.input_node_id >= 0):
        node = int(np.flatnonzero(back.node_ids == back.input_node_id[column])[0])
        assert back.input_interface[column] == 2
        through_basis = body.basis()[3 * node + back.input_component[column]]
        np.testing.assert_allclose(body.input_matrix[:, column], through_basis, rtol=0, atol=1e-9)
    assert back.input_component[:7].tolist() == [0, 1, 2, 4, 0, 1, 2]
    assert back.input_interface[:7].tolist() == [0, 0, 0, 0, 1, 1, 1] and (back.input_node_id[:7] == -1).all()


def test_damping_ratios_of_modes_are_kept(tmp_path):
    model = steel(box("hex8", (4, 1, 1), (0.5, 0.05, 0.03)))
    left = make_interface(model, name="left", nodes=where(model, 0, 0.0))
    with Problem(model, [left], damping=Damping(modal=0.03)) as problem:
        body = elastic_body(problem, CraigBampton(modes=3).reduce(problem), make_part(problem))
    with h5py.File(write_body(tmp_path / "body.h5", [body])) as file:
        assert file["bodies/craig-bampton/damping_ratios"].attrs["description"].startswith(b"ratio of critical damping")
    path = tmp_path / "body.h5"
    kept = read_body(path).bodies["craig-bampton"].damping_ratios
    assert kept[:6].tolist() == [0.0] * 6 and kept[6:] == pytest.approx(0.03, rel=1e-6)
    with h5py.File(path, "r+") as file:
        del file["bodies/craig-bampton/damping_ratios"]
        file["bodies/craig-bampton/damping_ratios"] = np.zeros(4)
        seal(file, excluded=["provenance"])
    with refusal("file", "body.h5", "damping_ratios", "4"):
        read_body(path)


def test_switching_of_other_bodies_is_refused(stored):
    body = read_body(stored).bodies["modal"]
    with refusal("missing", "", "'modal'", "static-modes-switching"):
        body.switching()


def test_names_that_are_not_there_are_told(stored):
    content = read_body(stored)
    with refusal("unknown", "", "modul", "modal"):
        content.bodies["modul"]
    with refusal("unknown", "", "leftt", "left"):
        content.interfaces["leftt"]
    assert content.bodies.get("modul") is None and "modul" not in content.bodies


def test_provenance_takes_any_nested_values(stored):
    with h5py.File(stored) as file:
        group = file["provenance"]
        assert group["host/system"][()] == b"Linux" and group["host/cores"][()].tolist() == [1, 2]
        assert group["checked"].dtype == np.uint8 and group["checked"][()] == 1
        assert group["stages/name"][()].tolist() == [b"read", b"modes"]
        assert group["stages/seconds"][()].tolist() == [0.5, 1.5]
        assert group["mixed"][()] == b'[1, "a"]' and "nothing" not in group
        assert group["created"][()] == PROVENANCE["created"].encode() and group["morembs_version"][()]


def test_only_types_that_every_reader_knows(stored):
    def check(name, item):
        values = [item.dtype] if isinstance(item, h5py.Dataset) else []
        for dtype in values + [item.attrs.get_id(key).dtype for key in item.attrs]:
            fixed = h5py.check_string_dtype(dtype) == ("ascii", dtype.itemsize)
            assert fixed or dtype.str[1:] in ("i8", "f8", "f4", "u1"), name

    with h5py.File(stored) as file:
        file.visititems(check)
        assert file["VTKHDF/Points"] == file["nodes/coordinates"]
        assert file["bodies/modal/basis"].chunks == (3 * len(file["nodes/ids"]), 1)


def test_same_input_same_bytes(bar, stored, tmp_path):
    other = write_body(tmp_path / "other.h5", bar.bodies, provenance={"host": "elsewhere", "long": "x" * 5000})
    with h5py.File(stored) as file_a, h5py.File(other) as file_b:
        first, second = everything(file_a), everything(file_b)
        assert first.keys() == second.keys()
        assert [name for name in first if first[name] != second[name]] == []
        assert "VTKHDF/PointData/modal_mode_001" in first and "bodies/modal/basis" in first
        # Time stamps count seconds, so that two files of one second agree by chance.
        assert [name for name in first if name and h5py.h5g.get_objinfo(file_a[name].id).mtime] == []
    again = write_body(tmp_path / "again.h5", bar.bodies, provenance=PROVENANCE)
    assert again.read_bytes() == stored.read_bytes()


def test_same_bytes_in_another_process(tmp_path):
    write_body(tmp_path / "here.h5", [made(50, 4)], provenance=PROVENANCE)
    done = child("write_body('there.h5', [made(50, 4)], provenance=PROVENANCE)", tmp_path, PYTHONHASHSEED="77")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "here.h5").read_bytes() == (tmp_path / "there.h5").read_bytes()


@pytest.mark.parametrize("error", [RuntimeError("halt"), OSError("not of the file"), KeyboardInterrupt()], ids=repr)
@pytest.mark.parametrize("old", [b"the old file", None])
def test_interruption_leaves_the_old_file_or_none(tmp_path, error, old):
    path = tmp_path / "body.h5"
    if old:
        path.write_bytes(old)
    with pytest.raises(type(error)) as caught:
        write_body(path, [made(10, 6, fail_at=3, error=error)], block_bytes=8 * 30)
    assert caught.value is error
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == ([("body.h5", old)] if old else [])
    write_body(path, [made(10, 6)])
    assert read_body(path).bodies["made"].basis(slice(2, 3))[0] == np.sin(1.0) + 2


def open_in_hdf5():
    """Files, groups and datasets that HDF5 holds open; after a close that failed it may crash on them."""
    kinds = h5py.h5f.OBJ_FILE | h5py.h5f.OBJ_GROUP | h5py.h5f.OBJ_DATASET
    return h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, kinds)


def replaced_open(monkeypatch, new):
    """Let ``new(path)`` open the files that a program writes and that must not be there; the paths of those."""
    real, paths = builtins.open, []

    def opened(path, mode="r", *arguments, **options):
        if mode != "x+b":
            return real(path, mode, *arguments, **options)
        paths.append(path)
        return new(path)

    monkeypatch.setattr(builtins, "open", opened)
    return paths


def test_short_writes_are_continued(tmp_path, monkeypatch):
    whole = write_body(tmp_path / "whole.h5", [made(20, 3)], provenance=PROVENANCE).read_bytes()

    class Slow(io.FileIO):
        def write(self, data):
            return super().write(data[: len(data) // 2 + 1])

    slow = replaced_open(monkeypatch, lambda path: Slow(path, "x+b"))
    assert write_body(tmp_path / "slow.h5", [made(20, 3)], provenance=PROVENANCE).read_bytes() == whole
    assert slow


@pytest.mark.parametrize("reason", [KeyboardInterrupt(), OSError(errno.EIO, "Input/output error")], ids=repr)
@pytest.mark.parametrize("number", [0, 1, 7, 30, 10**9])
def test_failure_inside_hdf5_leaves_the_old_file(tmp_path, monkeypatch, reason, number):
    """The n-th write fails (the last case: only the truncation at the end)."""
    calls = []

    class Failing:
        def __init__(self, file):
            self.file = file

        def __getattr__(self, name):
            return getattr(self.file, name)

        def write(self, data):
            calls.append(len(data))
            if len(calls) > number:
                raise reason
            return self.file.write(data)

        def truncate(self, size):
            raise reason

    path = tmp_path / "body.h5"
    path.write_bytes(b"the old file")
    replaced_open(monkeypatch, lambda path: Failing(io.FileIO(path, "x+b")))
    body = made(2000, 6)
    with pytest.raises(OutputError if isinstance(reason, OSError) else KeyboardInterrupt):
        write_body(path, [body])
    assert number > 1 or not body.basis.asked  # no work for a file that is lost
    assert open_in_hdf5() == 0
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("body.h5", b"the old file")]


def test_full_disk_at_any_place(tmp_path):
    """Under file-size limits from nothing to one byte less than needed; then once more without."""

    def work():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        size = write_body("size.h5", [made(500, 30)], provenance=PROVENANCE).stat().st_size
        Path("size.h5").unlink()
        Path("body.h5").write_bytes(b"old")
        free, before = resource.getrlimit(resource.RLIMIT_FSIZE), open_in_hdf5()
        for limit in [*range(0, size, size // 40), size - 1]:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, free[1]))
            try:
                with pytest.raises(OutputError) as refused:
                    write_body("body.h5", [made(500, 30)], provenance=PROVENANCE)
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, free)
            assert open_in_hdf5() == before and os.listdir() == ["body.h5"], limit
            assert Path("body.h5").read_bytes() == b"old"
            if "basis" in str(refused.value):
                sys.stdout.write(f"{refused.value}\n")
        write_body("body.h5", [made(500, 30)])
        assert read_body("body.h5").bodies["made"].basis().shape == (1500, 30)

    done = apart(work, tmp_path)
    assert done.code == 0 and not done.errors, done.errors
    assert "body.h5 could not be written (at: bodies/made/basis): File too large" in done.output
    assert "is unchanged; free space there" in done.output


def test_basis_is_streamed(tmp_path):
    """A basis of 200 MB is written, its shapes are made and some columns read back, in little memory."""
    if not Path("/proc/self/status").exists():
        pytest.skip("the system does not tell the peak memory of a program alone")
    code = """
def peak():
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024
body = made(100_000, 84)
write_body("small.h5", [made(10, 84)])
body.basis(slice(0, 1))
before = peak()
write_body("body.h5", [body])
column = read_body("body.h5").bodies["made"].basis(slice(40, 41))
print(peak() - before, Path("body.h5").stat().st_size / 2**20, float(column[0, 0] - np.sin(1.0)))
"""
    done = child(code, tmp_path, OPENBLAS_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    rise, size, value = map(float, done.stdout.split())
    assert size > 200 and value == pytest.approx(40)
    assert rise < 80


def test_where_no_file_can_be_written(tmp_path, monkeypatch):
    body = [made(2, 1)]
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for path, words in (
        (tmp_path / "no" / "body.h5", f"{tmp_path / 'no'} does not exist"),
        (tmp_path / "file" / "body.h5", f"{tmp_path / 'file'} is not a folder"),
        (tmp_path / "folder", "it is a folder"),
        (tmp_path / ("x" * 300), "give a shorter name"),
        (Path(os.devnull), "not a regular file"),
    ):
        for call in (lambda p: write_body(p, body), check_writable):
            with pytest.raises(OutputError, match=re.escape(words)):
                call(path)
    check_writable(tmp_path / "body.h5")
    check_writable(tmp_path / "file")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]

    def read_only(*args, **kwargs):
        raise OSError(errno.EROFS, "Read-only file system", str(args[0]))

    monkeypatch.setattr(Path, "touch", read_only)
    monkeypatch.setattr(builtins, "open", read_only)
    for call in (lambda p: write_body(p, body), check_writable):
        with refusal("output", "", "body.h5", "Read-only", by=OutputError):
            call(tmp_path / "body.h5")


def test_a_link_keeps_pointing(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "body.h5").symlink_to(tmp_path / "far" / "real.h5")
    write_body(tmp_path / "body.h5", [made(2, 1)])
    assert (tmp_path / "body.h5").is_symlink() and read_body(tmp_path / "far" / "real.h5").bodies


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "a\nb"])
def test_names_that_cannot_be_stored(tmp_path, name):
    body = made(2, 1, name=name)
    with refusal("value", "name"):
        write_body(tmp_path / "body.h5", [body])
    with refusal("value", "name"):
        check_names([name], "interface")
    assert not list(tmp_path.iterdir())


def test_bodies_that_do_not_go_together(tmp_path):
    first, second = made(2, 1), made(2, 1)
    for bodies, words in (
        ([], ("missing", "bodies")),
        ([first, second], ("conflict", "bodies")),
        ([first, first], ("conflict", "name")),
    ):
        with refusal(*words):
            write_body(tmp_path / "body.h5", bodies)


def test_files_that_are_no_body_files(stored, tmp_path):
    path = tmp_path / "bad.h5"
    with refusal("file", "bad.h5"):
        read_body(path)
    path.write_text("hello")
    with refusal("file", "bad.h5", "HDF5"):
        read_body(path)
    with h5py.File(path, "w") as file:
        file["x"] = 1
    with refusal("file", "bad.h5"):
        read_body(path)
    path.write_bytes(stored.read_bytes()[:-5000])
    with refusal("file", "bad.h5"):
        read_body(path)


def test_incomplete_and_newer_files(stored, tmp_path):
    path = tmp_path / "bad.h5"
    gone = ("bodies/modal/basis", "interfaces/mid point/axes", "nodes/ids")
    for names in ([gone[0]], [gone[1]], [gone[2]]):
        shutil.copy(stored, path)
        with h5py.File(path, "a") as file:
            for name in names:
                del file[name]
        with refusal("file", "bad.h5"):
            read_body(path)
    shutil.copy(stored, path)
    back = read_body(path)
    with h5py.File(path, "a") as file:
        file["format_version"][()] = 4
    with refusal("file", "bad.h5", "4"):
        read_body(path)
    path.unlink()
    with refusal("file", "bad.h5"):
        back.bodies["modal"].basis()


def test_vtk_reads_mesh_and_mode_shapes(bar, stored):
    vtk = pytest.importorskip("vtk")
    from vtk.util.numpy_support import vtk_to_numpy

    reader = vtk.vtkHDFReader()
    assert reader.CanReadFile(str(stored))
    reader.SetFileName(str(stored))
    reader.Update()
    grid = reader.GetOutput()
    np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), bar.part.nodes.xyz)
    connectivity = bar.part.cells[0].connectivity
    assert grid.GetNumberOfCells() == len(connectivity)
    for number, nodes in enumerate(connectivity):
        cell = grid.GetCell(number)
        assert cell.GetCellType() == bar.part.cells[0].vtk
        assert [cell.GetPointId(k) for k in range(cell.GetNumberOfPoints())] == nodes.tolist()
    data = grid.GetPointData()
    names = [data.GetArrayName(k) for k in range(data.GetNumberOfArrays())]
    elastic = {body.name: body.reduced.order - 6 for body in bar.bodies}
    assert names == sorted(f"{n}_mode_{k:03d}" for n, count in elastic.items() for k in range(1, min(count, 20) + 1))
    frequencies = vtk_to_numpy(grid.GetFieldData().GetArray("modal_frequencies_hz"))
    np.testing.assert_array_equal(frequencies, bar.bodies[0].frequencies_hz[6:])
    # The rigid interface is stiff, so shapes of all nodes are judged by the mass of the mesh.
    shapes = np.stack([vtk_to_numpy(data.GetArray(f"modal_mode_{k:03d}")).ravel() for k in range(1, 7)], axis=1)
    np.testing.assert_allclose(shapes.T @ (bar.model.M @ shapes), np.eye(6), atol=1e-5)
    omega2 = (2 * np.pi * frequencies) ** 2
    np.testing.assert_allclose(np.diag(shapes.T @ (bar.model.K @ shapes)), omega2, rtol=1e-3)


def test_shapes_are_eigenvectors_with_a_fixed_sign():
    rng = np.random.default_rng(1)
    factors = rng.standard_normal((2, 30, 30))
    K, M = (F @ F.T + np.eye(30) for F in factors)
    X = shown_modes(reduced_model(M, K, 4))
    values = np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)[4:24]
    np.testing.assert_allclose(K @ X, M @ X * values, atol=1e-8 * np.abs(K).max())
    np.testing.assert_allclose(X.T @ M @ X, np.eye(20), atol=1e-10)
    assert (X[np.argmax(np.abs(X), axis=0), range(20)] > 0).all()


@pytest.mark.parametrize("more", [1e-8, -1e-8])
def test_equal_coordinates_leave_the_sign_to_the_first(more):
    X = shown_modes(reduced_model(np.eye(2), np.array([[2.0, 1], [1, 2 + more]])))
    np.testing.assert_allclose(X, np.sqrt(0.5) * np.array([[1, 1], [-1, 1]]), atol=1e-7)


def test_cells_of_several_types(tmp_path):
    body = made(7, 1)
    body.part.cells = (
        CellBlock(vtk=10, connectivity=np.array([[0, 1, 2, 3], [3, 4, 5, 6]])),
        CellBlock(vtk=12, connectivity=np.empty((0, 8), dtype=np.int64)),
        CellBlock(vtk=5, connectivity=np.array([[4, 5, 6]])),
    )
    with h5py.File(write_body(tmp_path / "body.h5", [body])) as file:
        grid = file["VTKHDF"]
        assert grid["Types"][()].tolist() == [10, 10, 5] and grid["Offsets"][()].tolist() == [0, 4, 8, 11]
        assert grid["Connectivity"][()].tolist() == [0, 1, 2, 3, 3, 4, 5, 6, 4, 5, 6]
        assert [grid[f"NumberOf{n}"][0] for n in ("Points", "Cells", "ConnectivityIds")] == [7, 3, 11]


def octave(code, folder):
    command = ["octave", "--no-gui", "--quiet", "--norc", "--eval", code]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0 and "HDF5" not in done.stderr and "warning" not in done.stderr, done.stderr
    return done.stdout


@needs_octave
def test_octave_loads_every_group(bar, stored):
    """Everything arrives, arrays transposed, numbers to the last digit."""
    out = octave(
        """s = load("body.h5"); b = s.bodies.craig_bampton;
        printf("%s ", fieldnames(s){:}); printf("\\n");
        printf("%s ", fieldnames(b){:}); printf("\\n");
        printf("%s ", fieldnames(s.bodies){:}, fieldnames(s.interfaces){:}, fieldnames(s.provenance){:}); printf("\\n");
        printf("%d ", size(b.basis), size(b.input_matrix), size(s.nodes.coordinates)); printf("\\n");
        printf("%.17g ", b.basis); printf("\\n"); printf("%.17g ", b.mass_matrix); printf("\\n");
        printf("%.17g ", s.nodes.coordinates); printf("\\n"); printf("%d ", b.mode_kind); printf("\\n");
        printf("%s|", cellstr(s.interface_names){:}); printf("\\n");""",
        stored.parent,
    ).splitlines()
    body, n_nodes = bar.bodies[1], len(bar.part.nodes)
    with h5py.File(stored) as file:
        assert out[0].split() == sorted(file)
        assert out[1].split() == sorted(file["bodies/craig-bampton"])
        assert out[2].split() == [
            *("craig_bampton", "modal", "left", "mid_point", "right"),
            *("checked", "created", "host", "mixed", "morembs_version", "solver", "stages", "threads"),
        ]
    order, width = body.reduced.B.shape
    assert out[3].split() == [str(k) for k in (order, 3 * n_nodes, width, order, 3, n_nodes)]
    for line, expected in ((4, body.basis()), (5, body.reduced.M), (6, bar.part.nodes.xyz)):
        np.testing.assert_array_equal(np.array(out[line].split(), dtype=float), np.asarray(expected).ravel())
    assert len(out[7].split()) == order and set(out[7].split()) <= {"0", "1", "2", "3", "4"}
    assert out[8] == "left|right|mid point|"


@needs_octave
def test_octave_loads_a_body_without_interfaces(tmp_path):
    write_body(tmp_path / "body.h5", [made(3, 2)])
    out = octave('s = load("body.h5"); printf("%s ", fieldnames(s){:}, size(s.bodies.made.input_matrix))', tmp_path)
    with h5py.File(tmp_path / "body.h5") as file:
        assert out.split()[: len(file)] == sorted(file)


def snippets(language):
    pages = "".join(page.read_text(encoding="utf-8") for page in READERS)
    return re.findall(rf"```{language}\n(.*?)```", pages, re.DOTALL)


def test_the_schema_page_lists_what_is_in_the_file(bar, stored):
    assert not stale(), "run scripts/schema.py"
    text = SCHEMA.read_text(encoding="utf-8")
    names = set()
    with h5py.File(stored) as file:
        file.visititems(lambda name, item: names.add(name) if isinstance(item, h5py.Dataset) else None)
    for name in names:
        name = re.sub("^bodies/[^/]+", "bodies/NAME", re.sub("^interfaces/[^/]+", "interfaces/NAME", name))
        name = re.sub("/markers/[^/]+", "/markers/NAME", name)
        name = re.sub(r"/[^/]+_(mode_001|frequencies_hz)$", r"/NAME_\1", name) if "VTKHDF" in name else name
        if not name.startswith("provenance/") and not re.search("_mode_(?!001)", name):
            assert f"`/{name}`" in text, name


def test_python_that_reads_bodies_runs(stored, tmp_path):
    shutil.copy(stored, tmp_path / "body.h5")
    codes = snippets("python")
    assert len(codes) == 4
    for code in codes:
        if "vtk" in code:
            pytest.importorskip("vtk")
        done = python(code, tmp_path)
        assert done.code == 0 and done.output, done.errors


@needs_octave
def test_octave_that_reads_bodies_runs(bar, stored):
    (code,) = snippets("octave")
    frequencies = np.array(octave(code, stored.parent).split(), dtype=float)
    np.testing.assert_allclose(frequencies, bar.bodies[0].frequencies_hz[6:], rtol=1e-5)
