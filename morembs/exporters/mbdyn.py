"""MBDyn: the .fem file of a modal joint.

Record groups as in the MBDyn input manual (appendix "modal element data format"): sizes (1), node labels (2),
initial modal coordinates (3, 4), node positions (5, 6, 7), mode shapes (8), generalised mass (9), stiffness (10),
rigid-body inertia (12), damping (13); MBDyn from 2019 on also reads the inertia couplings (14 to 18), so that only
the nodes at the interfaces are needed and no lumped masses (11). Group 19 is the geometric stiffening, which MBDyn
applies with automatic differentiation only (ModalAd::AssRes in its modalad.cc).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame, InterfaceMarker
from morembs.exporters.base import ExportContext, Exported, Exporter, in_two_digits, names_without_blanks
from morembs.exporters.tolerances import TOL
from morembs.linalg.dense import symmetric
from morembs.storage.safefile import replacing

_REVISION = "REV0"


@dataclass(frozen=True, kw_only=True)
class MBDynExporter(Exporter):
    """Modal joint on the interface frames, in the floating frame; the inertia couplings are in groups 14 to 18.

    Node labels are the names of the interfaces; connect each with a line "NAME, NODE, position, null" in the joint,
    in the order of the file: group 19 counts on it. The frame's origin is the modal node.
    """

    name: ClassVar[str] = "mbdyn"
    suffix: ClassVar[str] = ".fem"
    about: ClassVar[str] = "MBDyn modal joint with inertia couplings"
    holds: ClassVar[frozenset[str]] = frozenset({"damping", "stiffening"})

    def _write(self, context: ExportContext) -> Exported:
        markers = context.markers("MBDyn")
        names_without_blanks(markers, TOL.node_label_characters, "an MBDyn node label")
        groups = list(_groups(context.body.name, context.frame, markers))
        with replacing(context.path) as file:
            for text in groups:
                file.write(text.encode("ascii"))
        notes = [
            "needs an MBDyn that reads record groups 14 to 18 (2019 or later); an older one leaves the couplings out"
        ]
        if _stiffness_of_loads(context.frame, markers):
            notes.append(
                "geometric stiffening is in record group 19: say 'use automatic differentiation;' in the control data, "
                f"and connect the interfaces in this order: {', '.join(markers)}"
            )
        return Exported(paths=(context.path,), notes=tuple(notes))


def _groups(name: str, frame: FloatingFrame, markers: dict[str, InterfaceMarker]) -> Iterator[str]:
    integrals, n = frame.integrals, frame.count
    points = np.array([marker.point for marker in markers.values()])
    motions = np.array([marker.motion for marker in markers.values()])
    yield "** MBDyn modal FEM data of an elastic body, SI units\n"
    title = name.encode("ascii", "replace").decode("ascii").replace("\n", " ")
    yield f"** RECORD GROUP 1, HEADER\n** {title}\n    {_REVISION} {len(points)} {n} 0 0 0\n"
    yield _group(2, "FINITE ELEMENT NODE LIST", ["".join(f"{label}\n" for label in markers)])
    yield _group(3, "INITIAL MODAL DISPLACEMENTS", [_line(np.zeros(n))])
    yield _group(4, "INITIAL MODAL VELOCITIES", [_line(np.zeros(n))])
    for axis in range(3):
        words = f"NODAL {'XYZ'[axis]} COORDINATES"
        yield _group(5 + axis, words, [_line(points[k, axis : axis + 1], words) for k in range(len(points))])
    modes = [f"**    NORMAL MODE SHAPE # {i + 1}\n" + _rows(motions[:, :, i], "mode shapes") for i in range(n)]
    yield _group(8, "MODE SHAPES", modes)
    yield _group(9, "MODAL MASS MATRIX", [_rows(symmetric(integrals.Me), "modal mass")])
    yield _group(10, "MODAL STIFFNESS MATRIX", [_rows(symmetric(frame.Ke), "modal stiffness")])
    yield _group(12, "GLOBAL INERTIA", _inertia(frame))
    if np.any(frame.De):
        yield _group(13, "MODAL DAMPING MATRIX", [_rows(frame.De, "modal damping")])
    for number, words, rows in _invariants(frame):
        yield _group(number, words, [_rows(rows, words.lower())])
    if loads := _stiffness_of_loads(frame, markers):
        parts = [f"{number}\n" + _rows(symmetric(G), "geometric stiffening") for number, G in loads]
        yield _group(19, "MODAL STRESS STIFFENING MATRIX", [f"{len(loads)}\n", *parts])
    yield "** END OF FILE\n"


def _inertia(frame: FloatingFrame) -> list[str]:
    """Mass, centre of mass from the frame's origin, inertia about it."""
    integrals = frame.integrals
    center = integrals.center
    about_center = integrals.about(center).inertia
    return [
        _line(np.array([integrals.mass]), "the mass"),
        _line(center, "the centre of mass"),
        _rows(symmetric(about_center), "the inertia"),
    ]


def _invariants(frame: FloatingFrame) -> Iterator[tuple[int, str, Floats]]:
    """Groups 14 to 18: three rows each; columns run over components, then the first mode, then the second."""
    integrals, n = frame.integrals, frame.count
    yield 14, "INVARIANT 3", np.asarray(integrals.Ct.T)
    yield 15, "INVARIANT 4", np.asarray(integrals.Cr.T)
    # [a, l, b] of -int x~ phi_l~.
    yield 16, "INVARIANT 8", -integrals.C4.transpose(1, 0, 2).reshape(3, 3 * n)
    # [a, j, k] of int phi_j x phi_k, where Cr1[k, j] = int phi_j x phi_k.
    yield 17, "INVARIANT 5", integrals.Cr1.transpose(2, 1, 0).reshape(3, n * n)
    # [a, j, k, b] of int phi_j~ phi_k~.
    yield 18, "INVARIANT 9", integrals.C6.transpose(2, 0, 1, 3).reshape(3, 3 * n * n)


def _stiffness_of_loads(frame: FloatingFrame, markers: dict[str, InterfaceMarker]) -> list[tuple[int, Floats]]:
    """Numbers of loads and geometric stiffness (n, n) of each that has some.

    1 to 6 w_a w_b in the order xx, yy, zz, xy, yz, zx; 7 to 9 angular acceleration; 10 to 12 acceleration less gravity;
    then three forces and three moments on the body at each node, all along the axes of the modal node.
    """
    stiff = frame.stiffening
    if stiff is None:
        return []
    none = np.zeros((6, frame.count, frame.count))
    wrenches = [stiff.wrench.get(name, none) for name in markers]
    loads = np.concatenate((stiff.rotation, stiff.angular_acceleration, stiff.acceleration, *wrenches))
    return [(number, G) for number, G in enumerate(loads, 1) if G.any()]


def _group(number: int, words: str, parts: list[str]) -> str:
    return f"**\n** RECORD GROUP {number}, {words}\n" + "".join(parts)


def _rows(matrix: Floats, what: str = "the body") -> str:
    checked = in_two_digits(what, matrix, "the .fem file")
    return "".join(" ".join(f"{x:.16e}" for x in row) + "\n" for row in checked.tolist())


def _line(values: Floats, what: str = "the body") -> str:
    return _rows(values[None, :], what)
