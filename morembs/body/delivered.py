"""What a delivery check looks at, from a body in memory or in a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.body import Body
from morembs.body.curve_check import Curve
from morembs.body.diagnostics.findings import MOTIONS
from morembs.body.floating.frame import FloatingFrame
from morembs.body.stored import FormatVersion, StoredBodies
from morembs.fem import rigid_motion
from morembs.fem.fe_model import STRUCTURAL, WITHOUT_MASS, Component

if TYPE_CHECKING:
    from morembs.body.part import Part
    from morembs.certificate.record import Certificate
    from morembs.reducers.base import ReducedModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Delivered:
    """What is checked: M, K, D (n, n); interface degrees of freedom C q (m, n) with their rigid motion ``frame``
    (m, 6) about the origin of the model, names of them; ``rigid`` (n, 6) from geometry, if known; what the model says
    of its mass; the ``floating`` frame, and ``markers`` interface -> rows of C that are all six of its frame; the
    ``curve`` of its certificate, and what its recipe says of interfaces that deform the body ``without_mass``."""

    M: Floats
    K: Floats
    D: Floats
    B: Floats
    C: Floats
    frame: Floats | None
    motions: tuple[str, ...]
    rigid: Floats | None
    rigid_count: int
    symmetric: bool
    hz: Floats
    full_hz: Floats | None
    mass: float
    center: Floats
    inertia: Floats
    floating: FloatingFrame | None = None
    markers: Mapping[str, Ints] = field(default_factory=dict)
    curve: Curve | None = None
    without_mass: str = ""


def collect_delivered(body: ReducedModel | Body, part: Part | StoredBodies | None) -> Delivered:
    """What is checked of ``body``.

    Raises:
        InputError: a stored body without its file, or a reduced model without its part.
    """
    if isinstance(body, Body):
        if body.part is not None:
            return _of_body(body, body.part)
        if not isinstance(part, StoredBodies):
            raise InputError(
                "a stored body was given without its file; expected check_delivery(body, bodies of the file)",
                kind="missing",
                keyword="bodies",
            )
        return _of_stored(body, part)
    # Not at the top: files are examined without what reduces.
    from morembs.body.build import body_of
    from morembs.body.part import Part

    if not isinstance(part, Part):
        raise InputError(
            "a reduced model was given without its part; expected check_delivery(reduced, make_part(...))",
            kind="missing",
            keyword="part",
        )
    return _of_body(body_of(body, part), part)


def _of_body(body: Body, part: Part) -> Delivered:
    r = body.reduced
    frame, motion = np.full((r.B.shape[1], 6), np.nan), np.full(r.B.shape[1], Component.SCALAR)
    names = [""] * r.B.shape[1]
    place = {int(label): row for row, label in enumerate(part.nodes.ids.tolist())}
    for interface in part.interfaces:
        columns = np.arange(r.B.shape[1])[part.columns[interface.name]]
        motions, rows = interface.kind.columns(interface)
        points = np.tile(interface.point, (len(motions), 1))
        points[rows >= 0] = _points(part.node_ids[rows[rows >= 0]], place, part.nodes.xyz)
        # Generalised forces do work on motions that the points do not tell: their rows stay unknown.
        is_motion = motions < Component.SCALAR
        motion[columns] = motions
        frame[columns[is_motion]] = rigid_motion(points[is_motion], motions[is_motion])
        for column, which in zip(columns.tolist(), motions.tolist(), strict=True):
            names[column] = f"{interface.name} {MOTIONS[which]}"
    return Delivered(
        M=r.M,
        K=r.K,
        D=r.D,
        B=r.B,
        C=r.C,
        frame=None if np.isnan(frame).any() else frame,
        motions=tuple(names),
        rigid=_about_model(body.floating),
        rigid_count=r.rigid_count,
        symmetric=r.symmetric,
        hz=body.frequencies_hz,
        full_hz=body.full_frequencies_hz,
        mass=part.mass,
        center=part.center_of_mass,
        inertia=part.inertia,
        floating=body.floating,
        without_mass=str(r.recipe.get(WITHOUT_MASS, "")),
        curve=_curve(body.certificate, motion, r.structural, part.mass, part.inertia),
        markers={
            interface.name: np.arange(r.B.shape[1])[part.columns[interface.name]]
            for interface in part.interfaces
            if interface.kind.framed and tuple(interface.components) == tuple(range(6))
        },
    )


def _of_stored(body: Body, file: StoredBodies) -> Delivered:
    place = {int(label): row for row, label in enumerate(file.node_ids.tolist())}
    kept = list(file.interfaces.items())
    points, names = [], []
    for which, motion, label in zip(
        file.input_interface.tolist(), file.input_component.tolist(), file.input_node_id.tolist(), strict=True
    ):
        name, interface = kept[which]
        at = interface.point if label < 0 else _points(np.array([label]), place, file.coordinates)[0]
        points.append(at)
        names.append(f"{name} {MOTIONS[motion]}")
    frame = rigid_motion(np.array(points).reshape(-1, 3), file.input_component)
    frame[file.input_component == Component.SCALAR] = np.nan
    M, K, B, C = body.mass_matrix, body.stiffness_matrix, body.input_matrix, body.output_matrix
    return Delivered(
        M=M,
        K=K,
        D=body.damping_matrix,
        B=B,
        C=C,
        frame=None if np.isnan(frame).any() else frame,
        motions=tuple(names),
        rigid=_about_model(body.floating),
        rigid_count=body.rigid_count,
        symmetric=_meant_symmetric(body, file),
        hz=body.frequencies_hz,
        full_hz=body.full_frequencies_hz,
        mass=file.mass,
        center=file.center_of_mass,
        inertia=file.inertia,
        floating=body.floating,
        without_mass=str(body.recipe.get(WITHOUT_MASS, "")),
        curve=_curve(
            body.certificate, file.input_component, float(body.recipe.get(STRUCTURAL, 0.0)), file.mass, file.inertia
        ),
        markers={
            name: np.flatnonzero(file.input_interface == which)
            for which, (name, interface) in enumerate(kept)
            if interface.kind.framed and tuple(interface.components) == tuple(range(6))
        },
    )


def _meant_symmetric(body: Body, file: StoredBodies) -> bool:
    """True if matrices have to be symmetric: skew parts are in files of version 3 only, elsewhere they are damage."""
    return bool(np.array_equal(body.input_matrix.T, body.output_matrix)) and (
        file.format_version < FormatVersion.SKEW_PARTS or body.symmetric
    )


def _curve(
    certificate: Certificate | None, motion: Ints, structural: float, mass: float, inertia: Floats
) -> Curve | None:
    """The curve of a certificate; None where there is none, or it is not known what lengths rotations have."""
    if certificate is None or certificate.reduced is None or certificate.damping_floor is None:
        return None
    turning, square = (motion > 2) & (motion < Component.SCALAR), float(np.trace(inertia)) / (2 * mass)
    if turning.any() and not square > 0:
        return None
    scale = np.where(turning, np.sqrt(max(square, 0.0)), 1.0)
    return Curve(
        frequencies_hz=certificate.frequencies_hz,
        size=certificate.reduced,
        scale=scale,
        structural=structural + 2 * certificate.damping_floor,
    )


def _points(labels: Ints, place: Mapping[int, int], xyz: Floats) -> Floats:
    """Positions (k, 3) of nodes by label, not a number where a node was not kept."""
    rows = np.array([place.get(label, -1) for label in labels.tolist()], dtype=np.int64)
    result = np.full((len(rows), 3), np.nan)
    result[rows >= 0] = xyz[rows[rows >= 0]]
    return result


def _about_model(floating: Any) -> Floats | None:
    """Rigid-body coordinates (n, 6) about the origin of the model."""
    return None if floating is None else np.asarray(floating.about((0.0, 0.0, 0.0)).rigid)
