"""HDF5 files of strangers: nothing in them leads out of them, and none of them fills the memory."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest

from morembs.body.file import read_body
from morembs.body.vtkhdf_series import read_arrays, read_grid
from morembs.dynamics.gmp.stored import read_members
from morembs.importers import import_file
from morembs.importers.model_file import read_model, write_model
from tests.support.machine import has_memory
from tests.support.meshes import box, steel
from tests.support.refusals import refusal

SECRET = np.arange(9.0)
ELSEWHERE = {
    "takes its values from the file": lambda file, name: file.create_dataset(
        name, (3, 3), "f8", external=[("secret.bin", 0, 72)]
    ),
    "is a link to another file": lambda file, name: file.__setitem__(name, h5py.ExternalLink("secret.h5", "/K")),
    "takes its values from other datasets": lambda file, name: file.create_virtual_dataset(name, virtual("secret.h5")),
}
READERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "body": ("bodies/x/mass_matrix", read_body),
    "grid": ("VTKHDF/Points", read_grid),
    "trajectory": ("coordinates", read_arrays),
    "members": ("bodies/x/parameterised/U", read_members),
    "model": ("matrices/K/data", read_model),
    "matrices": ("K", lambda path: import_file(path, "hdf5")),
    "matlab": ("K", lambda path: import_file(path, "matlab")),
    "exudyn": ("nodes/Position", lambda path: import_file(path, "exudyn")),
    "mesh": ("ENS_MAA/x", lambda path: import_file(path.rename(path.with_suffix(".med")), "mesh")),
}


def virtual(source: str) -> h5py.VirtualLayout:
    layout = h5py.VirtualLayout((3, 3), "f8")
    layout[:] = h5py.VirtualSource(source, "K", (3, 3))
    return layout


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("words", ELSEWHERE)
def test_no_reader_follows_a_file_out_of_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    SECRET.tofile("secret.bin")
    with h5py.File("secret.h5", "w") as file:
        file["K"] = SECRET.reshape(3, 3)
    name, read = READERS[reader]
    with h5py.File("a.h5", "w") as file:
        ELSEWHERE[words](file, name)
    with h5py.File("a.h5") as file:
        assert (file[name][()] == SECRET.reshape(3, 3)).all()  # what h5py alone gives away
    with refusal("unsupported", "", name):
        read(tmp_path / "a.h5")


def test_a_model_with_a_matrix_from_elsewhere(tmp_path: Path) -> None:
    path = write_model(tmp_path / "a.model.h5", steel(box("hex8", (1, 1, 1), (0.1, 0.1, 0.1))))
    with h5py.File(path, "r+") as file:
        count = file["matrices/K/data"].size
        del file["matrices/K/data"]
        np.ones(count).tofile(tmp_path / "secret.bin")
        file.create_dataset("matrices/K/data", (count,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 8 * count)])
    with refusal("unsupported", "", "/matrices/K/data"):
        read_model(path)


def test_filters_that_are_no_part_of_hdf5(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk((3, 3))
        properties.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
        space = h5py.h5s.create_simple((3, 3))
        h5py.h5d.create(file.id, b"K", h5py.h5t.IEEE_F64LE, space, properties)
    with refusal("unsupported", "filter", "32015"):
        import_file(path, "hdf5")


def test_packed_zeros_do_not_fill_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("K", data=np.zeros((1000, 1000)), compression="gzip", chunks=(1000, 1000))
        file.create_dataset("M", data=np.eye(1000), compression="gzip", chunks=(1000, 1000))
    assert import_file(path, "hdf5").K is not None
    has_memory(monkeypatch, free=15_000_000)
    with refusal("file", "a.h5", "1.6e+07", "1.5e+07"):
        import_file(path, "hdf5")


def test_groups_within_each_other(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["K"] = file["M"] = np.eye(3)
        file["other/more/alias"] = h5py.SoftLink("/other")
        file["D"] = h5py.SoftLink("/K")
    imported = import_file(path, "hdf5")
    assert imported.K is not None and imported.D is not None and imported.D.nnz == 3
    with h5py.File(path, "r+") as file:
        file["other/more/up"] = file["other"]
    with refusal("file", "", "a.h5", "/other/more/up"):
        import_file(path, "hdf5")


@pytest.mark.parametrize("form", ["HDF", "Binary"])
def test_meshes_take_numbers_only_from_beside_them(tmp_path: Path, form: str) -> None:
    """XDMF names the files that hold its numbers: any file could be read in this way."""
    mesh = box("hex8", (1, 1, 1), (0.1, 0.1, 0.1))
    (tmp_path / "in").mkdir()
    path = tmp_path / "in" / "a.xdmf"
    meshio.write(path, meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes)]), data_format=form)
    names = list((tmp_path / "in").glob("a*.*"))
    if form == "HDF":
        assert import_file(path, "mesh").mesh is not None
    beside = next(name for name in names if name != path)
    beside.rename(tmp_path / beside.name)
    text = path.read_text()
    path.write_text(text.replace(str(beside), f"../{beside.name}").replace(f">{beside.name}", f">../{beside.name}"))
    with refusal("unsupported", "a.xdmf"):
        import_file(path, "mesh")
