"""The floating-frame data of a body in its file, both ways."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from morembs.floating.frame import FloatingFrame, Marker
from morembs.floating.integrals import ShapeIntegrals
from morembs.floating.ranking import RankedTerm
from morembs.floating.stiffening import Stiffening

# Stores one dataset: name, value, what it is, its units.
Put = Callable[..., None]
_INTEGRALS: Mapping[str, tuple[str, str]] = {
    "mass": ("", "kg"),
    "first": ("int x dm; x from the origin, phi the shapes", "kg m"),
    "inertia": ("about the origin", "kg m2"),
    "second": ("int x x' dm", "kg m2"),
    "Ct": ("int phi dm", ""),
    "Cr": ("int x cross phi dm", ""),
    "Me": ("int phi . phi dm", ""),
    "x_phi": ("[a, b, l]: int x_a phi_b,l dm", ""),
    "phi_phi": ("[a, b, k, l]: int phi_a,k phi_b,l dm", ""),
}
_TABLES = {
    "C4": "int x~ phi~ dm", "C6": "int phi_k~ phi_l~ dm", "Cr1": "[l, k, a]: Cr per coordinate k",
    "J1": "inertia per coordinate", "Gr": "gyroscopic moments", "Ge": "gyroscopic forces",
    "Oe": "centrifugal forces, w_a w_b in the order xx, yy, zz, xy, yz, zx",
    "Oe1": "[i, ab, l]: Oe per coordinate l",
}  # fmt: skip


def write_frame(put: Put, group: str, frame: FloatingFrame) -> None:
    """Store ``frame`` under ``group`` with its integrals and the tables that follow from them."""
    put(f"{group}/kind", frame.kind, "conditions that the frame follows")
    if frame.interfaces:
        put(f"{group}/interfaces", list(frame.interfaces), "that it follows")
    put(f"{group}/origin", frame.origin, "of the frame, in coordinates of the model", "m")
    put(f"{group}/elastic", frame.elastic, "reduced coordinates of the elastic ones")
    put(f"{group}/rigid", frame.rigid, "reduced coordinates of unit translations and rotations about the origin")
    put(f"{group}/Ke", frame.Ke, "stiffness of the elastic coordinates")
    put(f"{group}/De", frame.De, "damping of the elastic coordinates")
    for name, (about, units) in _INTEGRALS.items():
        put(f"{group}/integrals/{name}", getattr(frame.integrals, name), about, units)
    for name, about in _TABLES.items():
        put(f"{group}/integrals/{name}", getattr(frame.integrals, name), about)
    for name, marker in frame.markers.items():
        put(f"{group}/markers/{name}/point", marker.point, "undeformed, from the origin", "m")
        put(f"{group}/markers/{name}/motion", marker.motion, "displacement and small rotation per coordinate")
    put(f"{group}/notes", "; ".join(frame.notes) or " ")
    if frame.stiffening is not None:
        _write_stiffening(put, f"{group}/stiffening", frame.stiffening)


def write_ranking(put: Put, group: str, terms: Sequence[RankedTerm]) -> None:
    """Store which ``terms`` of the equations of motion matter, if that is known."""
    if terms:
        put(f"{group}/terms", [term.name for term in terms], "inertia terms, those that matter most first")
        put(f"{group}/equations", [term.equation for term in terms], "where the term is largest")
        put(f"{group}/share", np.array([term.share for term in terms]), "in all magnitudes of that equation")


def read_ranking(group: Any) -> tuple[RankedTerm, ...]:
    """What ``write_ranking`` wrote."""
    rows = zip(_lines(group, "terms"), _lines(group, "equations"), group["share"][()].tolist(), strict=True)
    return tuple(RankedTerm(name=name, equation=equation, share=share) for name, equation, share in rows)


def _write_stiffening(put: Put, group: str, its: Stiffening) -> None:
    put(f"{group}/acceleration", its.acceleration, "geometric stiffness per acceleration of the frame", "s2/m")
    put(f"{group}/angular_acceleration", its.angular_acceleration, "the same per angular acceleration", "s2")
    put(f"{group}/rotation", its.rotation, "per w_a w_b in the order xx, yy, zz, xy, yz, zx", "s2")
    for name, terms in its.wrench.items():
        put(f"{group}/wrench/{name}", terms, "per force (3) and moment (3) of the interface, axes of the body")
    put(f"{group}/least_share", its.least_share, "terms below this part of Ke were left out")
    if its.share:
        put(f"{group}/terms", list(its.share), "names of the terms")
        put(f"{group}/share", np.array(list(its.share.values())), "of each term beside Ke, at its load")
        load = np.array([its.load.get(name, 1.0) for name in its.share])
        put(f"{group}/load", load, "of each term: its largest value in use, or one")
    if its.dropped:
        put(f"{group}/dropped", list(its.dropped), "terms that were left out")


def read_frame(group: Any) -> FloatingFrame:
    """Floating-frame data of an open HDF5 ``group``."""
    inner = group["integrals"]
    values = {one.name: inner[one.name][()] for one in fields(ShapeIntegrals)}
    values["mass"] = float(values["mass"])
    markers = {
        name: Marker(point=one["point"][()], motion=one["motion"][()])
        for name, one in (group["markers"].items() if "markers" in group else ())
    }
    notes = group["notes"][()].decode().strip()
    return FloatingFrame(
        kind=group["kind"][()].decode(), interfaces=tuple(_lines(group, "interfaces")),
        integrals=ShapeIntegrals(**values), markers=markers, notes=(notes,) if notes else (),
        stiffening=_read_stiffening(group["stiffening"]) if "stiffening" in group else None,
        **{name: group[name][()] for name in ("origin", "elastic", "rigid", "Ke", "De")},
    )  # fmt: skip


def _read_stiffening(group: Any) -> Stiffening:
    wrench = {name: terms[()] for name, terms in (group["wrench"].items() if "wrench" in group else ())}
    terms = _lines(group, "terms")
    share, load = (
        dict(zip(terms, group[name][()].tolist(), strict=True)) if terms else {} for name in ("share", "load")
    )
    return Stiffening(
        wrench=wrench, share=share, load=load,
        dropped=tuple(_lines(group, "dropped")), least_share=float(group["least_share"][()]),
        **{name: group[name][()] for name in ("acceleration", "angular_acceleration", "rotation")},
    )  # fmt: skip


def _lines(group: Any, name: str) -> list[str]:
    return [line.decode() for line in group[name][()].tolist()] if name in group else []
