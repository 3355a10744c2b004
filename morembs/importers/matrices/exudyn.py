"""Exudyn's FEMinterface in HDF5: matrices, node positions and node sets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import DofMap, Nodes
from morembs.importers.imported import Imported
from morembs.importers.matrices.hdf5 import sparse_group
from morembs.importers.matrices.named import square_csr
from morembs.storage.hdf5 import read_dataset, reading


def import_exudyn(path: Path) -> Imported:
    """K and M, nodes and node sets of ``FEMinterface.SaveToFile``; three dofs per node. Labels count from 0.

    Raises:
        InputError: not such a file, damaged, or matrices that do not fit the nodes.
    """
    path = Path(path)
    with reading(path, "a FEMinterface of Exudyn", "save it again") as file:
        kind = file.get("type")
        if kind is None or _text(kind) != "FEMinterface":
            raise InputError(
                f"{path.name} is not a FEMinterface of Exudyn (type is not 'FEMinterface')", kind="unsupported"
            )
        xyz = _numbers(path.name, file["nodes/Position"])
        matrices = {}
        for role, name in (("K", "stiffnessMatrix"), ("M", "massMatrix")):
            matrix = sparse_group(f"{path.name}: {name}", file[name])
            if matrix is None:
                raise InputError(
                    f"{path.name}: {name} is not a CSR matrix; save the FEMinterface again",
                    kind="file",
                    keyword=path.name,
                )
            matrices[role] = square_csr(path.name, name, matrix)
        sets = _node_sets(path.name, file.get("nodeSets"), len(xyz))
        other = [name for name in ("modeBasis", "surface", "elements", "elementSets") if _is_filled(file.get(name))]
    if xyz.ndim != 2 or xyz.shape[1] != 3 or matrices["K"].shape[0] != xyz.size:
        raise InputError(
            f"{path.name} has K of {matrices['K'].shape[0]} rows and positions of the shape {xyz.shape}; expected "
            "three rows for each node"
        )
    notes = (f"left out: {', '.join(other)}",) if other else ()
    nodes = Nodes(ids=np.arange(len(xyz)), xyz=xyz, sets=sets)
    return Imported(source=path.name, nodes=nodes, dofs=DofMap.translations(len(xyz)), notes=notes, **matrices)


def _numbers(source: str, item: Any, *, whole: bool = False) -> NDArray[Any]:
    """Numbers of an array, or of a list, which is a group with a dataset for each."""
    if isinstance(item, h5py.Group):
        values = np.array([read_dataset(item[f"item_{i}"]) for i in range(len(item))])
    else:
        values = read_dataset(item)
    if values.size and values.dtype.kind not in ("iu" if whole else "fiu"):
        raise InputError(
            f"{source}: {item.name} does not hold {'whole ' * whole}numbers; save the FEMinterface again", kind="file"
        )
    return values.astype(np.int64 if whole else np.float64)


def _text(item: Any) -> str:
    value = read_dataset(item)[()]
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _is_filled(item: Any) -> bool:
    return isinstance(item, h5py.Group) and len(item) > 0


def _node_sets(source: str, group: Any, count: int) -> dict[str, Ints]:
    sets: dict[str, Ints] = {}
    for item in group.values() if _is_filled(group) else ():
        name, rows = _text(item["Name"]), np.unique(_numbers(source, item["NodeNumbers"], whole=True))
        if len(rows) and not (rows[0] >= 0 and rows[-1] < count):
            raise InputError(
                f"{source}: node set {name!r} names nodes that do not exist; save the FEMinterface again", kind="file"
            )
        sets[name] = rows
    return sets
