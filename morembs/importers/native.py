"""The native model file: HDF5, SI units; written by ``morembs.importers.model_file``, described in docs/formats.md."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import UNLIMITED, Budget
from morembs.errors import InputError
from morembs.importers.hdf5_sparse import checked_csr
from morembs.importers.imported import Imported
from morembs.model import DofMap, ElementBlock, Mesh, Nodes
from morembs.model.constraints import AverageElement, RigidElement
from morembs.model.elements import TYPES
from morembs.model.material import Material
from morembs.storage.checksums import Checksums
from morembs.storage.hdf5 import reading, refuse_newer, stored

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
FORMAT = "morembs-model"
FORMAT_VERSION = 1


def import_native(path: Path, *, budget: Budget = UNLIMITED) -> Imported:
    """All that a native model file holds, in SI units. Peak memory: that of the matrices.

    Raises:
        InputError: no such file, another kind of file, one of a newer version, or one that is damaged.
    """
    path = Path(path)
    with opened(path) as file:
        size = int(file["dofs/node"].shape[0])
        K, M, D = (_matrix(path, file, name, size, budget) for name in ("K", "M", "D"))
        nodes = Nodes(
            ids=_whole(path, file["nodes/ids"]),
            xyz=_numbers(path, file["nodes/coordinates"], (None, 3)),
            sets=_sets(path, file, "node_sets"),
        )
        for name, rows in nodes.sets.items():
            _refuse_outside(path, rows, len(nodes), f"node set {name!r}")
        dofs = DofMap(node=_whole(path, file["dofs/node"]), component=_whole(path, file["dofs/component"]))
        rigid, average = _couplings(path, file, len(nodes))
        imported = Imported(
            source=_words(file["source/name"])[0], K=K, M=M, D=D, nodes=nodes, dofs=dofs,
            mesh=_mesh(path, file, nodes), materials=_materials(path, file), rigid=rigid, average=average,
            notes=tuple(_words(file["source/notes"])),
            warnings=tuple(_words(file["source/warnings"])) if "source/warnings" in file else (),
        )  # fmt: skip
        Checksums(path, file).verify()
        return imported


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The HDF5 file, open for reading, once it is known to be a model file of a known version."""
    with reading(path, "a model file", "import the model again") as file:
        format = file.get("format")
        if not isinstance(format, h5py.Dataset) or format.shape != () or format[()] != FORMAT.encode():
            raise InputError(f"{path} is not a model file of morembs (no /format {FORMAT!r}); see morembs import")
        cure = "install a newer one, or import the model again"
        refuse_newer(path, int(file["format_version"][()]), FORMAT_VERSION, cure)
        yield file


def _matrix(path: Path, file: Any, name: str, size: int, budget: Budget) -> sp.csr_array | None:
    if f"matrices/{name}" not in file:
        return None
    group = file[f"matrices/{name}"]
    parts = []
    for part in ("data", "indices", "indptr"):
        if group[part].dtype.kind not in ("f" if part == "data" else "iu"):
            raise InputError(f"{path}: {group[part].name} does not hold numbers of its kind; import the model again")
        array = budget.empty(group[part].shape, group[part].dtype)
        if len(array):
            group[part].read_direct(array)
        parts.append(array)
    data, indices, indptr = parts
    if "data_imag" in group:
        data = data + 1j * _numbers(path, group["data_imag"], data.shape)
    shape = tuple(_whole(path, group["shape"]).tolist())
    if shape != (size, size):
        raise InputError(f"{path}: {name} has the shape {shape}, the dofs are {size}; import the model again")
    return checked_csr(f"{path}: {name}", data, indices, indptr, (size, size))


def _whole(path: Path, item: Any, *, sides: int = 1) -> Ints:
    """Integers of an array with so many ``sides``."""
    values = stored(item)
    if values.dtype.kind not in "iu" or values.ndim != sides:
        raise InputError(f"{path}: {item.name} does not hold integers in its shape; import the model again")
    return values.astype(np.int64, copy=False)


def _numbers(path: Path, item: Any, shape: tuple[int | None, ...]) -> Floats:
    """Numbers of an array of this ``shape``, None where it may be anything."""
    values = stored(item)
    fits = len(shape) == values.ndim and all(a in (None, b) for a, b in zip(shape, values.shape, strict=True))
    if values.dtype.kind not in "fiu" or not fits:
        raise InputError(f"{path}: {item.name} does not hold numbers in its shape; import the model again")
    return values.astype(np.float64, copy=False)


def _words(item: Any) -> list[str]:
    """Text of a dataset."""
    return [bytes(line).decode("utf-8", "surrogateescape").rstrip(" ") for line in np.atleast_1d(stored(item))]


def _sets(path: Path, file: Any, group: str) -> dict[str, Ints]:
    offsets, rows = _whole(path, file[f"{group}/offsets"]), _whole(path, file[f"{group}/rows"])
    names = _words(file[f"{group}/names"])
    if (
        offsets.ndim != 1
        or rows.ndim != 1
        or len(offsets) != len(names) + 1
        or offsets[0] != 0
        or (offsets[-1] != len(rows) or (np.diff(offsets) < 0).any())
    ):
        raise InputError(f"{path}: the sets of {group} do not fit their names; import the model again")
    return {name: rows[offsets[i] : offsets[i + 1]] for i, name in enumerate(names)}


def _refuse_outside(path: Path, rows: Ints, count: int, what: str) -> None:
    if len(rows) and not (rows.min() >= 0 and rows.max() < count):
        raise InputError(f"{path}: {what} names rows that do not exist; import the model again")


def _mesh(path: Path, file: Any, nodes: Nodes) -> Mesh | None:
    if "elements" not in file:
        return None
    group = file["elements"]
    count = int(_whole(path, group["node_count"], sides=0))
    if not 0 <= count <= len(nodes):
        raise InputError(f"{path}: elements take {count} nodes of {len(nodes)}; import the model again")
    blocks = []
    for number, kind in enumerate(_words(group["types"])):
        connectivity = _whole(path, group[f"block_{number}/nodes"], sides=2)
        if kind not in TYPES or connectivity.shape[1] != TYPES[kind].n_nodes:
            raise InputError(f"{path}: elements of type {kind!r} are damaged; import the model again")
        _refuse_outside(path, connectivity.ravel(), count, f"an element of type {kind}")
        ids = _whole(path, group[f"block_{number}/ids"])
        if ids.shape != (len(connectivity),):
            raise InputError(f"{path}: elements of type {kind!r} do not fit their labels; import the model again")
        blocks.append(ElementBlock(type=kind, nodes=connectivity, ids=ids))
    starts = np.concatenate([[0], np.cumsum([len(block.ids) for block in blocks])])
    sets = {}
    for name, rows in _sets(path, file, "element_sets").items():
        _refuse_outside(path, rows, int(starts[-1]), f"element set {name!r}")
        block = np.searchsorted(starts, rows, side="right") - 1
        sets[name] = tuple(rows[block == b] - starts[b] for b in range(len(blocks)))
    own = nodes
    if count < len(nodes):
        kept = {name: rows[rows < count] for name, rows in nodes.sets.items()}
        own = Nodes(
            ids=nodes.ids[:count], xyz=nodes.xyz[:count], sets={name: rows for name, rows in kept.items() if len(rows)}
        )
    return Mesh(nodes=own, blocks=tuple(blocks), element_sets=sets, source=_words(group["source"])[0])


def _materials(path: Path, file: Any) -> tuple[Material, ...]:
    if "materials" not in file:
        return ()
    names = _words(file["materials/sets"])
    stiffness = _numbers(path, file["materials/stiffness"], (len(names), 6, 6))
    density = _numbers(path, file["materials/density"], (len(names),))
    return tuple(
        Material(set=n, stiffness=C, density=float(d)) for n, C, d in zip(names, stiffness, density, strict=True)
    )


def _couplings(path: Path, file: Any, count: int) -> tuple[tuple[RigidElement, ...], tuple[AverageElement, ...]]:
    rigid, average = [], []
    for number, name in enumerate(_words(file["couplings/names"]) if "couplings" in file else []):
        group = file[f"couplings/coupling_{number}"]
        reference, nodes = int(_whole(path, group["reference"], sides=0)), _whole(path, group["nodes"])
        components = tuple(_whole(path, group["components"]).tolist())
        _refuse_outside(path, np.append(nodes, reference), count, f"coupling {name!r}")
        if not set(components) <= set(range(6)):
            raise InputError(f"{path}: coupling {name!r} has components {components}; expected some of 0 to 5")
        if _words(group["kind"])[0] == "rigid":
            rigid.append(RigidElement(name=name, master=reference, slaves=nodes, components=components))
        else:
            average.append(
                AverageElement(
                    name=name,
                    reference=reference,
                    nodes=nodes,
                    weights=_numbers(path, group["weights"], nodes.shape),
                    components=components,
                )
            )
    return tuple(rigid), tuple(average)
