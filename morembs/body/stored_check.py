"""Is a body file what docs/schema.md says? Its tables, and values, before anything is made of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.body import BODY
from morembs.body.floating.frame import FRAMES
from morembs.body.stored import INTERFACE
from morembs.body.tables import FILE
from morembs.body.tolerances import TOL
from morembs.fem.elements import FACES, TYPES
from morembs.fem.fe_model import Component
from morembs.fem.interface import COUPLINGS
from morembs.storage.table import KINDS
from morembs.storage.table_check import TableCheck, refuse_not_finite


def check_file(path: Path, file: Any) -> None:
    """Everything of an open body file, except bases and stress shapes, which are large: see ``refuse_not_finite``.

    Raises:
        InputError: a dataset is missing, or is not what it should be; its name is in the message.
    """
    check, sizes = _Check(path, file, "body file"), dict[str, tuple[int, str]]()
    check.table("", FILE, sizes)
    check.one_of("unit_system", ("SI",))
    bodies, interfaces = (KINDS["text"].decode(file[name][()]) for name in ("body_names", "interface_names"))
    for name in interfaces:
        check.interface(f"interfaces/{name}/")
    check.within("inputs/interface_index", 0, len(interfaces) - 1, ", places in /interface_names")
    generalised = np.array([f"interfaces/{name}/forces" in file for name in interfaces], dtype=bool)
    forces = generalised[np.asarray(file["inputs/interface_index"][()], dtype=np.int64)]
    check.within("inputs/component", 0, Component.SCALAR - 1, where=~forces)
    check.within("inputs/component", Component.SCALAR, Component.SCALAR, ", of generalised forces", where=forces)
    check.positive("mass_properties/mass")
    for name in bodies:
        at = f"bodies/{name}/"
        check.table(at, BODY, dict(sizes))
        check.within(f"{at}mode_kind", 0, len(file["mode_kinds"]) - 1, ", places in /mode_kinds")
        check.within(f"{at}rigid_count", 0, len(file[f"{at}mode_kind"]))
        if "floating_frame" in file[at]:
            check.frame(f"{at}floating_frame/", interfaces)


class _Check(TableCheck):
    def within(self, name: str, least: int, most: int, why: str = "", where: Any = slice(None)) -> None:
        """Integers from ``least`` to ``most``, those that ``where`` picks."""
        values = np.ravel(self.file[name][()])[where]
        bad = np.flatnonzero((values < least) | (values > most))
        if len(bad):
            raise self.refuse(name, f"holds {values[bad[0]]}", f"{least} to {most}{why}")

    def positive(self, name: str) -> None:
        value = float(self.file[name][()])
        if not value > 0:
            raise self.refuse(name, f"is {value:g}", "more than zero")

    def one_of(self, name: str, known: Sequence[str]) -> None:
        """Text, one line or several, that stands in ``known``."""
        for line in np.ravel(self.file[name][()]).tolist():
            if line.decode() not in known:
                raise self.refuse(name, f"is {line.decode()!r}", f"one of {', '.join(known) or 'none'}")

    def interface(self, at: str) -> None:
        self.table(at, INTERFACE, {})
        coupling = self.file[f"{at}coupling"][()].decode()
        if coupling not in COUPLINGS:
            raise InputError(
                f"{self.path}: interface {at.split('/')[1]} has the coupling {coupling!r}, which this installation "
                f"does not know; expected {', '.join(COUPLINGS)}, or a package that is installed with morembs and "
                "defines it (an entry point morembs.couplings)"
            )
        forces = f"{at}forces" in self.file
        self.within(
            f"{at}components", Component.SCALAR if forces else 0, Component.SCALAR if forces else Component.SCALAR - 1
        )
        axes = np.asarray(self.file[f"{at}axes"][()], dtype=float)
        with np.errstate(all="ignore"):
            off = float(np.abs(axes @ axes.T - np.eye(3)).max())
        if not off < TOL.axes_error or np.linalg.det(axes) < 0:
            raise self.refuse(f"{at}axes", f"is no rotation (A A' - I = {off:.1e})", "orthonormal rows, right-handed")

    def frame(self, at: str, interfaces: Sequence[str]) -> None:
        """A floating frame and what belongs to it."""
        self.one_of(f"{at}kind", list(FRAMES))
        self.positive(f"{at}integrals/mass")
        if "interfaces" in self.file[at]:
            self.one_of(f"{at}interfaces", interfaces)
        for group in ("markers", "stiffening/wrench"):
            for name in self.file[at].get(group, ()):
                if name not in interfaces:
                    raise self.refuse(f"{at}{group}", f"has {name!r}", f"interfaces of /interface_names: {interfaces}")


def check_grid(path: Path, nodes: int, points: Floats, connectivity: Ints, offsets: Ints, types: NDArray[Any]) -> None:
    """The mesh of a body file: ``points`` (nodes, 3), ``connectivity``, ``offsets`` (nc + 1,), VTK ``types`` (nc,).

    Raises:
        InputError: cells that are not on the points, or have another number of nodes than their type.
    """

    def refuse(name: str, what: str) -> InputError:
        return InputError(f"{path}: /VTKHDF/{name} {what}; the file is damaged, write it again")

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
