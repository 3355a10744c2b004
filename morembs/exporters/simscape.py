"""MATLAB .mat file for the block Reduced Order Flexible Solid of Simscape Multibody.

The block wants a free body: degrees of freedom of the interface frames first, six each (translations x, y, z,
rotations x, y, z), then the coordinates of modes that leave the frames at rest, all in one reference frame, that of the
model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.io as sio
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.body.body import Body
from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.ports import COMPONENTS
from morembs.exporters.read_back import ReadBack
from morembs.exporters.reduced import body_transfer, held_and_free, interface_transfer
from morembs.exporters.tolerances import TOL
from morembs.linalg.dense import symmetric
from morembs.storage.safefile import replacing

BLOCK = "the Simscape block"


class MatHeader:
    """Start of a .mat file (MathWorks, MAT-File Format, level 5): descriptive text, here always the same."""

    TEXT = b"MATLAB 5.0 MAT-file, written by morembs"
    TEXT_BYTES = 116


@dataclass(frozen=True, kw_only=True)
class Simscape(Exporter):
    """Variables K, M, D, interface_origins (k, 3), interface_quaternions (k, 4), interface_names and some more."""

    name: ClassVar[str] = "simscape"
    suffix: ClassVar[str] = ".mat"
    about: ClassVar[str] = "MATLAB file for the Simscape block Reduced Order Flexible Solid"
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping"})

    def _write(self, context: ExportContext) -> Exported:
        source, body = context.source, context.body
        refuse_not_symmetric(body, BLOCK)
        if body.rigid_count != len(COMPONENTS):
            raise InputError(
                f"body {body.name!r} has {body.rigid_count} rigid-body motions; {BLOCK} needs a free body with six, "
                "leave supports to the simulator",
                kind="unsupported",
                keyword="supports",
            )
        framed_at = framed_rows(context, BLOCK)
        names, rows = list(framed_at), np.concatenate(list(framed_at.values()))
        K, M, D = interfaces_first(body, rows)
        framed = [source.interfaces[name] for name in names]
        inside = slice(len(rows), None)
        modes = sl.eigh(K[inside, inside], M[inside, inside], eigvals_only=True) if len(K) > len(rows) else np.zeros(0)
        values = {
            "K": K,
            "M": M,
            "D": D,
            "interface_names": np.array(names, dtype=object)[:, None],
            "interface_origins": np.array([interface.point for interface in framed]),
            "interface_quaternions": np.array([quaternion(interface.axes.T) for interface in framed]),
            "fixed_interface_frequencies_hz": eigenvalue_in_hz(modes),
            "mass": source.mass,
            "center_of_mass": source.center_of_mass,
            "inertia_about_center_of_mass": source.inertia,
            "dof_order": "Tx Ty Tz Rx Ry Rz of each interface in the order of interface_names, then modes",
            "unit_system": "SI (m, kg, s, N, rad)",
        }
        write_mat(context.path, values)
        return Exported(paths=(context.path,), notes=_notes(context, names))

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        rows = np.concatenate(list(framed_rows(context, BLOCK).values()))
        read = sio.loadmat(files[context.path], variable_names=("K", "M", "D"))
        return ReadBack(
            found=interface_transfer(read, len(rows)),
            expected=body_transfer(context.body, rows),
            digits=TOL.double_digits,
            changed=True,
        )


def write_mat(path: Path, values: Mapping[str, object]) -> None:
    """A .mat file of version 5 with the variables ``values``; the same bytes at any time.

    Raises:
        OutputError: the file cannot be written.
    """
    stream = BytesIO()
    sio.savemat(stream, dict(values), do_compression=True, oned_as="row")
    with replacing(path) as file:
        # scipy puts the time of day there.
        file.write(MatHeader.TEXT.ljust(MatHeader.TEXT_BYTES))
        file.write(stream.getvalue()[MatHeader.TEXT_BYTES :])
        file.check()


def refuse_not_symmetric(body: Body, target: str) -> None:
    """Refuse a body that is none to a ``target`` with symmetric matrices and a mass for each coordinate.

    Raises:
        InputError: in these cases.
    """
    matrices = (body.stiffness_matrix, body.mass_matrix, body.damping_matrix)
    if any(np.abs(A - A.T).max() > TOL.asymmetry * np.abs(A).max() for A in matrices):
        raise InputError(
            f"body {body.name!r} has matrices that are not symmetric; {target} needs symmetric ones, take a one-sided "
            "reduction of a model without gyroscopic and circulatory terms",
            kind="unsupported",
        )
    if (np.diag(body.mass_matrix) <= 0).any():
        raise InputError(f"mass_matrix of body {body.name!r} is not positive on its diagonal; reduce it again")


def framed_rows(context: ExportContext, target: str) -> dict[str, list[int]]:
    """Rows of the output matrix for each interface with a frame, in the order of its six degrees of freedom.

    Raises:
        InputError: there is none, or one that does not expose all six.
    """
    source = context.source
    rows: dict[str, list[int]] = {}
    for number, (name, interface) in enumerate(source.interfaces.items()):
        if not interface.kind.framed:
            continue
        if tuple(interface.components) != tuple(range(6)):
            given = ", ".join(str(c) for c in interface.components)
            raise InputError(
                f"interface {name!r} exposes the degrees of freedom {given}; {target} needs all six, leave components "
                "out in the job",
                keyword="components",
            )
        at = np.flatnonzero(source.input_interface == number)
        rows[name] = at[np.argsort(source.input_component[at], kind="stable")].tolist()
    if not rows:
        raise InputError(
            f"{target} needs at least one interface with a frame; the file has none "
            '(direct interfaces have no frame), take coupling = "rigid" or "average"',
            kind="unsupported",
            keyword="coupling",
        )
    return rows


def interfaces_first(body: Body, rows: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
    """K, M, D of the coordinates [interface degrees of freedom; modes with the interfaces at rest], of the same body.

    Both are K-orthogonal, so that rigid motion is that of the interfaces, without any mode.

    Raises:
        InputError: the interface degrees of freedom depend on each other.
    """
    K, M, D = body.stiffness_matrix, body.mass_matrix, body.damping_matrix
    C = body.output_matrix[rows]
    count, n = C.shape
    if np.array_equal(C, np.eye(count, n)) and not K[:count, count:].any():
        return symmetric(K), symmetric(M), symmetric(D)
    # In coordinates of unit modal mass.
    scale = 1 / np.sqrt(np.diag(M))
    X, N, _ = held_and_free(C * scale, body.name)
    X, N = scale[:, None] * X, scale[:, None] * N
    if N.shape[1]:
        X = X - N @ sl.solve(N.T @ K @ N, N.T @ (K @ X), assume_a="pos")
        N = N @ sl.eigh(symmetric(N.T @ K @ N), symmetric(N.T @ M @ N))[1]
        N = N * np.where(N[np.argmax(np.abs(N), axis=0), np.arange(N.shape[1])] < 0, -1.0, 1.0)
    T = np.hstack([X, N])
    K, M, D = (symmetric(T.T @ A @ T) for A in (K, M, D))
    K[:count, count:] = K[count:, :count] = 0.0
    return K, M, D


def quaternion(R: Floats) -> Floats:
    """(w, x, y, z) of a rotation matrix, w not negative (Shepperd 1978)."""
    trace = float(np.trace(R))
    squares = np.array([trace, *np.diag(R)])
    largest = int(np.argmax(squares))
    w = np.array([1 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if largest:
        a, b, c = largest - 1, largest % 3, (largest + 1) % 3
        w = np.empty(4)
        w[0] = R[c, b] - R[b, c]
        w[1 + a] = 1 + R[a, a] - R[b, b] - R[c, c]
        w[1 + b], w[1 + c] = R[a, b] + R[b, a], R[a, c] + R[c, a]
    q = w / np.linalg.norm(w)
    return np.asarray(-q if q[0] < 0 else q)


def _notes(context: ExportContext, names: list[str]) -> tuple[str, ...]:
    notes = ["interfaces in this order: " + ", ".join(names)]
    direct = [name for name in context.source.interfaces if name not in names]
    if direct:
        notes.append(f"direct interfaces have no frame and were left out: {', '.join(direct)}")
    if np.any(context.body.damping_matrix):
        notes.append("the damping matrix is in the variable D; use it only where the block takes a matrix")
    return tuple(notes)


__all__ = ["Simscape", "write_mat"]
