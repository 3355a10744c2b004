"""The native model file: what ``morembs import`` writes once, and jobs read. HDF5, SI units; see docs/formats.md.

The reader of the file itself is ``morembs.importers.native``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import UNLIMITED, Budget
from morembs.errors import InputError
from morembs.importers.native import FORMAT, FORMAT_VERSION, import_native
from morembs.importers.to_model import model_of
from morembs.model import FEModel, Mesh
from morembs.model.constraints import AverageElement, RigidElement
from morembs.progress import SILENT, Progress
from morembs.storage.checksums import seal
from morembs.storage.hdf5 import reading
from morembs.storage.safefile import SafeFile, replacing
from morembs.storage.storable import storable, text

Ints = NDArray[np.int64]
_BLOCK = 1 << 24


def write_model(
    path: str | Path, model: FEModel, *, files: Sequence[Path] = (), importer: str = "", units: str = "",
    findings: Sequence[str] = (), progress: Progress = SILENT,
) -> Path:  # fmt: skip
    """Write a model (SI); an interrupted or failed run leaves the old file or none.

    Args:
        files: those that the model came from; their names and SHA-256 are kept.
        importer: the name of the format they were read as, ``units`` those that they had.
        findings: sentences of the examination.

    Raises:
        InputError: a source file cannot be read.
        OutputError: the file cannot be written.
    """
    target = Path(path)
    progress.stage(f"writing {target.name}")
    sums = [sha256(file) for file in files]
    # The oldest layout: every reader knows it, and its groups carry no time stamps.
    with replacing(target) as safe, h5py.File(safe, "w", libver=("earliest", "v108")) as file:
        out = _Writer(file, safe)
        out.put("format", FORMAT)
        out.put("format_version", FORMAT_VERSION)
        out.put("unit_system", "SI")
        out.put("source/name", model.source)
        out.put("source/files", text(*(file.name for file in files)), "names of the files, in the order of sha256")
        out.put("source/sha256", text(*sums))
        out.put("source/format", importer or "none")
        out.put("source/units", units or "m-kg-s", "length, mass and time of the files; everything here is SI")
        out.put("source/notes", text(*model.notes))
        out.put("source/warnings", text(*model.warnings), "in what the model differs from its source")
        out.put("source/findings", text(*findings), "what the examination found at the import")
        for name, matrix, unit in (("K", model.K, "N/m"), ("M", model.M, "kg"), ("D", model.D, "N s/m")):
            if matrix is not None:
                out.matrix(f"matrices/{name}", matrix, unit)
        out.put("nodes/ids", model.nodes.ids, "labels of the nodes in the source")
        out.put("nodes/coordinates", model.nodes.xyz, units="m")
        out.sets("node_sets", model.nodes.sets)
        out.put("dofs/node", model.dofs.node, "row of /nodes, from 0, of each row of the matrices")
        out.put("dofs/component", model.dofs.component, "0..2 displacements along x, y, z; 3..5 rotations about them")
        if model.mesh is not None:
            _write_mesh(out, model.mesh)
        if model.materials:
            out.put("materials/sets", text(*(material.set for material in model.materials)))
            stiffness = np.stack([material.stiffness for material in model.materials])
            out.put("materials/stiffness", stiffness, "Voigt order xx, yy, zz, yz, zx, xy, engineering shears", "Pa")
            out.put("materials/density", np.array([material.density for material in model.materials]), units="kg/m3")
        if model.couplings:
            _write_couplings(out, model)
        safe.doing = "the checksums"
        seal(file)
        safe.check()
    return target


def read_model(path: str | Path, *, budget: Budget = UNLIMITED) -> FEModel:
    """The model of a native file, bit by bit as it was written. Peak memory: that of the matrices.

    Raises:
        InputError: no such file, another kind of file, one of a newer version, or one that is damaged.
    """
    if is_body_file(Path(path)):
        raise InputError(
            f"{path} is a body file, the result of a reduction; expected a model file: give what morembs import wrote"
        )
    return model_of(import_native(Path(path), budget=budget))


def is_body_file(path: Path) -> bool:
    """Whether a file says that it holds reduced bodies."""
    try:
        with reading(path, "a model file") as file:
            format = file.get("format")
            return isinstance(format, h5py.Dataset) and format.shape == () and format[()] == b"morembs-body"
    except InputError:
        # Reading it as a model says what is wrong.
        return False


def sha256(path: Path) -> str:
    """Checksum of a file in hexadecimal digits.

    Raises:
        InputError: it cannot be read.
    """
    total = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                total.update(block)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check the path") from error
    return total.hexdigest()


@dataclass(frozen=True)
class _Writer:
    file: Any
    safe: SafeFile

    def put(self, name: str, value: object, about: str = "", units: str = "") -> None:
        """Store one dataset with what it is and its units, then look whether that went well."""
        self.safe.doing = name
        item = self.file.create_dataset(name, data=storable(value))
        for key, words in (("description", about), ("units", units)):
            if words:
                item.attrs[key] = np.bytes_(words)
        self.safe.check()

    def matrix(self, name: str, matrix: sp.csr_array, units: str) -> None:
        """A CSR matrix as scipy keeps it; indices keep their width, imaginary parts have a dataset of their own."""
        if not matrix.has_canonical_format:
            matrix = matrix.copy()
            matrix.sum_duplicates()
        data = matrix.data
        self.put(f"{name}/data", np.ascontiguousarray(data.real), units=units)
        if data.dtype.kind == "c":
            self.put(f"{name}/data_imag", np.ascontiguousarray(data.imag), units=units)
        for part in ("indices", "indptr"):
            self.safe.doing = f"{name}/{part}"
            self.file.create_dataset(f"{name}/{part}", data=getattr(matrix, part))
            self.safe.check()
        self.put(f"{name}/shape", np.array(matrix.shape, dtype=np.int64))
        self.file[name].attrs["format"] = np.bytes_("csr")

    def sets(self, name: str, sets: Mapping[str, Ints]) -> None:
        """Named rows: those of set i are rows[offsets[i]:offsets[i + 1]]."""
        parts = [np.asarray(rows, dtype=np.int64) for rows in sets.values()]
        self.put(f"{name}/names", text(*sets))
        self.put(f"{name}/offsets", np.cumsum([0, *map(len, parts)]))
        self.put(f"{name}/rows", np.concatenate([np.empty(0, dtype=np.int64), *parts]), "from 0")


def _write_mesh(out: _Writer, mesh: Mesh) -> None:
    """Elements in VTK order; element sets count elements through all blocks."""
    out.put("elements/types", text(*(block.type for block in mesh.blocks)), "of block_0, block_1, ...")
    out.put("elements/node_count", len(mesh.nodes), "the first nodes are those of the elements")
    out.put("elements/source", mesh.source)
    for number, block in enumerate(mesh.blocks):
        out.put(f"elements/block_{number}/nodes", block.nodes, "rows of /nodes, from 0, in VTK order")
        out.put(f"elements/block_{number}/ids", block.ids, "labels of the elements in the source")
    starts = np.concatenate([[0], np.cumsum([len(block.ids) for block in mesh.blocks])])
    joined = {
        name: np.concatenate([np.asarray(rows) + starts[b] for b, rows in enumerate(parts)]).astype(np.int64)
        for name, parts in mesh.element_sets.items()
    }
    out.sets("element_sets", joined)


def _write_couplings(out: _Writer, model: FEModel) -> None:
    elements = model.couplings.values()
    out.put("couplings/names", text(*(element.name for element in elements)), "of coupling_0, coupling_1, ...")
    for number, element in enumerate(elements):
        group = f"couplings/coupling_{number}"
        rigid = isinstance(element, RigidElement)
        if isinstance(element, RigidElement):
            reference, nodes = element.master, element.slaves
        else:
            reference, nodes = element.reference, element.nodes
        out.put(f"{group}/kind", "rigid" if rigid else "average")
        out.put(f"{group}/reference", reference, "row of /nodes: the master, or the node of the mean motion")
        out.put(f"{group}/nodes", nodes, "rows of /nodes that follow, or whose mean is taken")
        components = np.array(element.components, dtype=np.int64)
        out.put(f"{group}/components", components, "0..5: those of the nodes that follow, or of the reference")
        out.put(f"{group}/point", model.nodes.xyz[reference].copy(), units="m")
        if isinstance(element, AverageElement):
            out.put(f"{group}/weights", element.weights)
