"""SID_FEM text files: standard input data of a flexible body after Wallrapp (1993, 1994).

Read by Simpack (through FEMBS) and EMBSlib (Modelica). Numbers have twelve digits. Known readers want the exponent
letter D, at most 19 characters before it, integers of up to five digits, and sections by exact words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import scipy.linalg as sl

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.body.floating.frame import FloatingFrame, InterfaceMarker
from morembs.exporters.base import ExportContext, Exported, Exporter, in_two_digits, names_without_blanks
from morembs.exporters.read_back import ReadBack, SecondOrder
from morembs.exporters.sid_reader import INERTIA, NODE_TERMS, Sid, SidNode, Taylor, read_sid
from morembs.exporters.tolerances import TOL
from morembs.fem import skew
from morembs.storage.safefile import replacing

# Readers look for these words in any line.
RESERVED = ("frame", "refmod")


class SidText:
    """Text of standard input data (Wallrapp 1994), as FEMBS writes it: fields of nodes, numbers and names."""

    MOST_NODES = 99999
    DIGITS = 12
    LONGEST_NAME = 60


@dataclass(frozen=True, kw_only=True)
class SidFem(Exporter):
    """``nodes`` are frames of the file: those of rigid and average interfaces, or "all": also the stored nodes.

    ``dialect`` is the order of the columns of Gr and Ge: axis by axis ("fembs") or mode by mode ("mode-major").
    """

    name: ClassVar[str] = "sid"
    suffix: ClassVar[str] = ".SID_FEM"
    about: ClassVar[str] = "standard input data for Simpack (FEMBS) and EMBSlib, text"
    holds: ClassVar[frozenset[str]] = frozenset({"damping", "stiffening"})

    dialect: Literal["fembs", "mode-major"] = "fembs"
    nodes: Literal["interfaces", "all"] = "interfaces"

    def _write(self, context: ExportContext) -> Exported:
        names_without_blanks([context.body.name], SidText.LONGEST_NAME, "a SID file")
        for word in RESERVED:
            if word in context.body.name:
                raise InputError(
                    f"the body name {context.body.name!r} contains {word!r}, which readers of SID files take for a "
                    "keyword; rename it in the job",
                    keyword="name",
                )
        frame, changed = normal_coordinates(context.frame)
        context = replace(context, body=replace(context.body, floating=frame))
        markers = context.markers("a SID file") if self.nodes == "interfaces" else dict(frame.markers)
        count = len(markers) + (len(context.source.coordinates) if self.nodes == "all" else 0)
        if not 0 < count <= SidText.MOST_NODES:
            raise InputError(
                f"{count} nodes would be written; a SID file holds 1 to {SidText.MOST_NODES}, choose others"
            )
        sid = _sid(frame)
        with replacing(context.path) as file:
            for piece in self._pieces(context, sid, markers, count):
                file.write(piece.encode("ascii"))
                file.check()
        return Exported(paths=(context.path,), notes=self._notes(context, markers, changed))

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        """The elastic part of H, between the frames of the interfaces."""
        read = read_sid(files[context.path])
        frame, markers = context.frame, context.frame.markers
        if self.nodes == "interfaces":
            markers = context.markers("a SID file")
        rows = np.vstack([np.zeros((0, frame.count)), *(marker.motion for marker in markers.values())])
        nodes = [read.nodes[number] for number in sorted(read.nodes)[: len(markers)]]
        held = np.vstack([np.zeros((0, frame.count)), *(part.M0 for node in nodes for part in (node.phi, node.psi))])
        found = SecondOrder(M=read.Me.M0, K=read.Ke.M0, D=read.De.M0, B=held.T, C=held)
        expected = SecondOrder(M=frame.integrals.Me, K=frame.Ke, D=frame.De, B=rows.T, C=rows)
        return ReadBack(found=found, expected=expected, digits=SidText.DIGITS, changed=True)

    def _pieces(
        self, context: ExportContext, sid: Sid, markers: dict[str, InterfaceMarker], count: int
    ) -> Iterator[str]:
        """The file, section by section."""
        name = context.body.name
        yield f"{count:5d}{sid.count:5d}    :No. nodes, No. modes: written by morembs from {name}\n"
        yield f" part\n      new modal                                 = {name}\n"
        yield _line(11, "refmod") + _line(
            16, "mass", _number(float(in_two_digits("mass", np.array(sid.mass), "a SID file")))
        )
        yield _line(16, "nelastq", f" {sid.count:3d}")
        for number, hertz in enumerate(sid.frequencies_hz, start=1):
            yield _line(16, f"ielastq ({number:4d})", f" Eigen Mode {number:4d} : {hertz:12.6g} Hz")
        yield _line(11, "end refmod") + _line(11, "frame")
        for number, node in enumerate(self._frames(context, markers), start=1):
            yield _line(16, "new node", f" {number:8d}") + _line(21, "rframe", " body ref")
            for part in NODE_TERMS:
                yield _section(21, part, getattr(node, part), sid.count)
            yield _line(16, "end node")
        yield _line(11, "end frame")
        flat = self.dialect == "mode-major"
        columns = {
            "Gr": (sid.Gr.transpose(1, 0, 2) if flat else sid.Gr.transpose(1, 2, 0)).reshape(3, -1),
            "Ge": (sid.Ge.transpose(1, 0, 2) if flat else sid.Ge.transpose(1, 2, 0)).reshape(sid.count, -1),
        }
        for term in ("mdCM", "J", "Ct", "Cr", "Me", "Gr", "Ge", "Oe", "ksigma", "Ke", "De"):
            yield _section(11, term, Taylor(M0=columns[term]) if term in columns else getattr(sid, term), sid.count)
        yield _line(6, "end modal") + _line(1, "end part")

    def _frames(self, context: ExportContext, markers: dict[str, InterfaceMarker]) -> Iterator[SidNode]:
        frame = context.frame
        for name, marker in markers.items():
            wrench = None if frame.stiffening is None else frame.stiffening.wrench.get(name)
            yield _node(marker.point, marker.motion, context.source.interfaces[name].axes, wrench)
        if self.nodes == "all":
            shapes = context.shapes().reshape(-1, 3, frame.count)
            for point, phi in zip(context.coordinates, shapes, strict=True):
                yield SidNode(
                    origin=Taylor(M0=point[:, None], M1=phi[:, :, None]),
                    phi=Taylor(M0=phi),
                    psi=Taylor(M0=np.zeros_like(phi)),
                    AP=Taylor(M0=np.eye(3)),
                )

    def _notes(self, context: ExportContext, markers: dict[str, InterfaceMarker], changed: bool) -> tuple[str, ...]:
        notes = ["numbers have twelve digits"]
        if changed:
            notes.append("the elastic coordinates of the file are the normal modes of (Ke, Me), so that Me is one")
        place = ", ".join(f"{value:.9g}" for value in context.frame.origin)
        notes.append(f"positions count from the origin of the floating frame, ({place}) m in the model")
        if markers:
            notes.append("nodes: " + ", ".join(f"{at} {name}" for at, name in enumerate(markers, start=1)))
        if self.nodes == "all":
            notes += large_file_notes(context.path.stat().st_size)
            notes.append(
                f"nodes from {len(markers) + 1} on are the stored nodes in their order; they have no rotations"
            )
        direct = [name for name in context.source.interfaces if name not in markers]
        if direct and self.nodes == "interfaces":
            notes.append(
                f'direct interfaces have no frame and were left out: {", ".join(direct)}; nodes = "all" has them'
            )
        return (*notes, *context.frame.notes)


def large_file_notes(size: float) -> list[str]:
    """What is said of a file of ``size`` bytes: nothing unless it is large."""
    if size <= TOL.large_file_bytes:
        return []
    return [f'the file has {size / 1e6:,.0f} MB of text; nodes = "interfaces" keeps what joints and loads need']


def normal_coordinates(frame: FloatingFrame) -> tuple[FloatingFrame, bool]:
    """The frame with coordinates in which Me is one and Ke diagonal, and whether they had to be changed."""
    Me, Ke = frame.integrals.Me, frame.Ke
    diagonal = np.diag(np.diag(Ke))
    if (
        np.abs(Me - np.eye(len(Me))).max() <= TOL.normal_coordinates * len(Me)
        and np.abs(Ke - diagonal).max() <= TOL.normal_coordinates * len(Me) * diagonal.max()
    ):
        return frame, False
    _, T = sl.eigh(Ke, Me)
    return in_shapes(frame, T * np.where(T[np.argmax(np.abs(T), axis=0), np.arange(len(T))] < 0, -1.0, 1.0)), True


def in_shapes(frame: FloatingFrame, T: Floats) -> FloatingFrame:
    """The frame with elastic coordinates (k,) of which those of before are T (n, k) times them."""
    integrals = replace(
        frame.integrals,
        Ct=T.T @ frame.integrals.Ct,
        Cr=T.T @ frame.integrals.Cr,
        Me=_both(T, frame.integrals.Me),
        x_phi=frame.integrals.x_phi @ T,
        phi_phi=_both(T, frame.integrals.phi_phi),
    )
    stiff = frame.stiffening
    if stiff is not None:
        stiff = replace(
            stiff,
            acceleration=_both(T, stiff.acceleration),
            rotation=_both(T, stiff.rotation),
            angular_acceleration=_both(T, stiff.angular_acceleration),
            wrench={name: _both(T, G) for name, G in stiff.wrench.items()},
        )
    markers = {name: replace(marker, motion=marker.motion @ T) for name, marker in frame.markers.items()}
    return replace(
        frame,
        elastic=frame.elastic @ T,
        integrals=integrals,
        Ke=_both(T, frame.Ke),
        De=_both(T, frame.De),
        markers=markers,
        stiffening=stiff,
    )


def _both(T: Floats, A: Floats) -> Floats:
    return np.asarray(T.T @ A @ T)


def _sid(frame: FloatingFrame) -> Sid:
    """All terms of the body; geometric stiffening joins those of first order."""
    integrals, n, stiff = frame.integrals, frame.count, frame.stiffening
    Cr1, Oe1, Ct1 = integrals.Cr1, integrals.Oe1.transpose(0, 2, 1), None
    if stiff is not None:
        Ct1 = _by_coordinate(stiff.acceleration)
        Cr1 = Cr1 + _by_coordinate(stiff.angular_acceleration)
        Oe1 = Oe1 + _by_coordinate(stiff.rotation)
    omega = np.sqrt(np.maximum(np.diag(frame.Ke) / np.diag(integrals.Me), 0.0))
    J1 = np.array([integrals.J1[:, a, b] for a, b in INERTIA])
    return Sid(
        mass=integrals.mass,
        frequencies_hz=in_hz(omega),
        nodes={},
        mdCM=Taylor(M0=integrals.first[:, None], M1=integrals.Ct.T[:, :, None]),
        J=Taylor(M0=np.array([[integrals.inertia[a, b]] for a, b in INERTIA]), M1=J1[:, :, None]),
        Ct=Taylor(M0=integrals.Ct, M1=Ct1),
        Cr=Taylor(M0=integrals.Cr, M1=Cr1),
        Me=Taylor(M0=integrals.Me),
        Gr=integrals.Gr,
        Ge=integrals.Ge,
        Oe=Taylor(M0=integrals.Oe, M1=Oe1),
        ksigma=Taylor(M0=np.zeros((n, 1))),
        Ke=Taylor(M0=frame.Ke),
        De=Taylor(M0=frame.De),
    )


def _by_coordinate(G: Floats) -> Floats:
    """(n, n, loads) [i, l, load] of (loads, n, n)."""
    return np.asarray(G.transpose(1, 2, 0))


def _node(point: Floats, motion: Floats, axes: Floats, wrench: Floats | None) -> SidNode:
    """Frame of an interface; forces on it stiffen the body (``wrench`` (6, n, n), on the side of internal forces)."""
    phi, psi = motion[:3], motion[3:]
    # Rows of phi' f and psi' t: the load of a row comes first, its equation last.
    on = None if wrench is None else -wrench.transpose(0, 2, 1)
    AP = axes.T
    return SidNode(
        origin=Taylor(M0=point[:, None], M1=phi[:, :, None]),
        phi=Taylor(M0=phi, M1=None if on is None else on[:3]),
        psi=Taylor(M0=psi, M1=None if on is None else on[3:]),
        AP=Taylor(M0=AP, M1=(skew(psi.T) @ AP).transpose(1, 0, 2)),
    )


def _line(indent: int, word: str, value: str | None = None) -> str:
    left = " " * indent + word
    if value is None:
        return f"{left:<{max(49, len(left) + 1)}}\n"
    return f"{left:<{max(48, len(left) + 1)}}={value}\n"


def _number(value: float) -> str:
    return f"{value: .11E}".replace("E", "D")


def _section(indent: int, name: str, term: Taylor, nq: int) -> str:
    """A Taylor expansion; entries that are zero are left out."""
    M0 = in_two_digits(name, term.M0, "a SID file")
    M1 = None if term.M1 is None else in_two_digits(name, term.M1, "a SID file")
    rows, columns = M0.shape
    structure = 3
    if not M0.any() and (M1 is None or not M1.any()):
        structure = 0
    elif M1 is None and rows == columns == nq and np.array_equal(M0, M0.T):
        structure = 2
    sizes = {"order": int(M1 is not None), "nrow": rows, "ncol": columns, "nq": nq, "nqn": 0, "structure": structure}
    lines = [f"{' ' * indent}{name:<8s}\n", *(_line(26, key, f" {value:4d}") for key, value in sizes.items())]
    for label, M in (("m0", M0), ("m1", M1)):
        if M is None:
            continue
        for at, value in zip(np.argwhere(M) + 1, M[M != 0].tolist(), strict=True):
            lines.append(_line(26, f"{label}({','.join(f'{i:2d}' for i in at.tolist())})", _number(value)))
    lines.append(f"{' ' * indent}end {name:<8s}\n")
    return "".join(lines)


__all__ = ["Sid", "SidFem", "SidNode", "Taylor", "normal_coordinates", "read_sid"]
