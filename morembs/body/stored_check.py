"""Is a body file what docs/reference/schema.md says? Its tables, and values, before anything is made of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.body import BODY
from morembs.body.stored import FILE, INTERFACE
from morembs.body.tolerances import TOL
from morembs.fem.elements import FACES, TYPES
from morembs.fem.fe_model import Component
from morembs.fem.interface import COUPLINGS
from morembs.storage.kinds import KINDS, refuse_not_finite
from morembs.storage.table_check import TableCheck


def check_file(path: Path, file: Any) -> None:
    """Everything of an open body file, except bases and stress shapes, which are large: see ``refuse_not_finite``.

    Raises:
        InputError: a dataset is missing, or has another kind, shape or value; its name is in the message.
    """
    check, sizes = TableCheck(path, file, "body file"), dict[str, tuple[int, str]]()
    check.table("", FILE, sizes)
    bodies, interfaces = (KINDS["text"].decode(file[name][()]) for name in ("body_names", "interface_names"))
    for name in interfaces:
        _interface(check, f"interfaces/{name}/")
    generalised = np.array([f"interfaces/{name}/forces" in file for name in interfaces], dtype=bool)
    forces = generalised[np.asarray(file["inputs/interface_index"][()], dtype=np.int64)]
    check.at_most("inputs/component", Component.SCALAR - 1, where=~forces)
    check.at_most("inputs/component", Component.SCALAR, ", of generalised forces", forces, Component.SCALAR)
    for name in bodies:
        check.table(f"bodies/{name}/", BODY, dict(sizes))


def _interface(check: TableCheck, at: str) -> None:
    check.table(at, INTERFACE, {})
    coupling = check.file[f"{at}coupling"][()].decode()
    if coupling not in COUPLINGS:
        raise InputError(
            f"{check.path}: interface {at.split('/')[1]} has the coupling {coupling!r}, which this installation "
            f"does not know; expected {', '.join(COUPLINGS)}, or a package that is installed with morembs and "
            "defines it (an entry point morembs.couplings)"
        )
    least, largest = (Component.SCALAR,) * 2 if f"{at}forces" in check.file else (0, Component.SCALAR - 1)
    check.at_most(f"{at}components", largest, least=least)
    axes = np.asarray(check.file[f"{at}axes"][()], dtype=float)
    with np.errstate(all="ignore"):
        off = float(np.abs(axes @ axes.T - np.eye(3)).max())
    if not off < TOL.axes_error or np.linalg.det(axes) < 0:
        raise check.refuse(f"{at}axes", f"is no rotation (A A' - I = {off:.1e})", "orthonormal rows, right-handed")


def check_grid(path: Path, nodes: int, points: Floats, connectivity: Ints, offsets: Ints, types: NDArray[Any]) -> None:
    """The mesh of a body file: ``points`` (nodes, 3), ``connectivity``, ``offsets`` (nc + 1,), VTK ``types`` (nc,).

    Raises:
        InputError: cells that are not on the points, or have another number of nodes than their type.
    """

    def refuse(name: str, what: str) -> InputError:
        return InputError(
            f"{path}: /VTKHDF/{name} {what}; the file is damaged, write it again", kind="file", keyword=path.name
        )

    if points.shape != (nodes, 3) or points.dtype.kind != "f":
        raise refuse("Points", f"holds {points.dtype} of the shape {points.shape}; expected numbers ({nodes}, 3)")
    refuse_not_finite(path, "VTKHDF/Points", points)
    for name, values in (("Connectivity", connectivity), ("Offsets", offsets), ("Types", types)):
        if values.ndim != 1 or values.dtype.kind not in "iu":
            raise refuse(name, f"holds {values.dtype} of the shape {values.shape}; expected one row of integers")
    if len(offsets) != len(types) + 1:
        raise refuse("Offsets", f"has {len(offsets)} numbers; expected {len(types) + 1}, one more than cells")
    size = np.diff(offsets)
    if offsets[0] != 0 or offsets[-1] != len(connectivity) or (size < 0).any():
        raise refuse("Offsets", f"does not ascend from 0 to {len(connectivity)}, the length of Connectivity")
    bad = np.flatnonzero((connectivity < 0) | (connectivity >= nodes))
    if len(bad):
        raise refuse("Connectivity", f"holds {connectivity[bad[0]]} at [{bad[0]}]; expected 0 to {nodes - 1}")
    for vtk, count in {cell.vtk: len(cell.reference) for cell in (*TYPES.values(), *FACES.values())}.items():
        bad = np.flatnonzero((types == vtk) & (size != count))
        if len(bad):
            raise refuse("Offsets", f"gives cell {bad[0]} of type {vtk} {size[bad[0]]} nodes; expected {count}")
