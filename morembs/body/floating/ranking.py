"""Which inertia terms of a body matter: their largest size in use, beside the forces of the same equation.

Each term is bounded by magnitudes: accelerations and speeds of the envelope, elastic coordinates of its static loads,
their rates those of free vibration with that amplitude. So a small share is safe to leave out; a large one may be
smaller in a given motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.body.floating.stiffening import Envelope
from morembs.storage.table import dataset

EQUATIONS = ("force", "moment", "elastic")


@dataclass(frozen=True, kw_only=True)
class RankedTerm:
    """``share`` (0 to 1) of a term in the sum of all magnitudes of its ``equation``, where it is largest."""

    name: str = dataset("text", "terms", "inertia terms, the largest share first", name="terms")
    equation: str = dataset(
        "text",
        "terms",
        "where the term is largest",
        name="equations",
        doc="`force`, `moment` or `elastic`: where the term is largest",
    )
    share: float = dataset(
        "any",
        "terms",
        "in all magnitudes of that equation",
        doc="of the term in the magnitudes of that equation, an upper estimate",
    )


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Bounds (scalars, and (n,) for the elastic coordinates and rates)."""

    a: float
    alpha: float
    w: float
    q: Floats
    v: Floats
    acceleration: Floats


def ranked_terms(frame: FloatingFrame, envelope: Envelope) -> tuple[RankedTerm, ...]:
    """Terms of the equations of motion, the largest share first; what the envelope leaves open counts as zero.

    Names as in ``ShapeIntegrals``; "rigid" are the terms of a rigid body, "Me, Ke" the elastic forces themselves.

    Args:
        frame: floating frame of the body.
        envelope: largest motions and loads.

    >>> terms = ranked_terms(body.floating, Envelope(acceleration=10.0, angular_acceleration=1.0, speed=10.0))
    >>> terms[0].share >= terms[1].share
    True
    """
    import scipy.linalg as sl

    if not frame.count:
        return ()
    values, Y = sl.eigh(frame.Ke, frame.integrals.Me)
    motion = _bounds(frame, envelope, values, Y)
    sizes = _sizes(frame, motion, values, Y)
    best: dict[str, RankedTerm] = {}
    for equation in EQUATIONS:
        terms = {name: size for (where, name), size in sizes.items() if where == equation}
        total = sum(terms.values())
        for name, size in terms.items():
            share = float(size / total) if total > 0 else 0.0
            if name not in best or share > best[name].share:
                best[name] = RankedTerm(name=name, equation=equation, share=share)
    return tuple(sorted(best.values(), key=lambda term: -term.share))


def _bounds(frame: FloatingFrame, envelope: Envelope, values: Floats, Y: Floats) -> _Motion:
    I = frame.integrals  # noqa: E741
    a, alpha, w = envelope.acceleration or 0.0, envelope.angular_acceleration or 0.0, envelope.speed or 0.0
    loads = np.abs(Y.T @ I.Ct).sum(axis=1) * a + np.abs(Y.T @ I.Cr).sum(axis=1) * alpha
    loads = loads + np.abs(Y.T @ I.Oe).sum(axis=1) * w**2
    for marker in frame.markers.values():
        on_modes = np.abs(Y.T @ marker.motion.T)
        loads = loads + on_modes[:, :3].sum(axis=1) * (envelope.force or 0.0)
        loads = loads + on_modes[:, 3:].sum(axis=1) * (envelope.moment or 0.0)
    modal, omega = loads / values, np.sqrt(values)
    q, v, acceleration = (np.abs(Y) @ (omega**order * modal) for order in (0, 1, 2))
    return _Motion(a=a, alpha=alpha, w=w, q=q, v=v, acceleration=acceleration)


def _sizes(frame: FloatingFrame, motion: _Motion, values: Floats, Y: Floats) -> dict[tuple[str, str], float]:
    """Size of each term in each equation."""
    I, q, v = frame.integrals, motion.q, motion.v  # noqa: E741
    a, alpha, w = motion.a, motion.alpha, motion.w
    turning = alpha + w**2

    def elastic(f: Floats) -> float:
        # The static deformation that a load causes, in energy.
        return float(np.sqrt(((np.abs(Y.T) @ f) ** 2 / values).sum()))

    root = np.sqrt(3.0)
    first = float(np.linalg.norm(I.first))
    moved = float(np.linalg.norm(np.abs(I.Ct).T @ q))
    sizes = {
        ("force", "rigid"): I.mass * root * a + first * turning,
        ("force", "Ct"): moved * turning
        + 2 * w * float(np.linalg.norm(np.abs(I.Ct).T @ v))
        + float(np.linalg.norm(np.abs(I.Ct).T @ motion.acceleration)),
        ("moment", "rigid"): first * root * a + float(np.linalg.norm(I.inertia)) * turning,
        ("moment", "Ct"): moved * root * a,
        ("moment", "Cr"): float(np.linalg.norm(np.abs(I.Cr).T @ motion.acceleration)),
        ("elastic", "Me, Ke"): elastic(np.abs(frame.Ke) @ q),
        ("elastic", "Ct"): elastic(np.abs(I.Ct).sum(axis=1) * a),
        ("elastic", "Cr"): elastic(np.abs(I.Cr).sum(axis=1) * alpha),
        ("elastic", "Oe"): elastic(np.abs(I.Oe).sum(axis=1) * w**2),
    }
    sizes |= _second_order(I, motion)
    sizes[("elastic", "Cr1")] = elastic(np.einsum("lka,k->l", np.abs(I.Cr1), q) * alpha)
    sizes[("elastic", "Ge")] = elastic(np.einsum("kla,k->l", np.abs(I.Ge), v) * w)
    sizes[("elastic", "Oe1")] = elastic(np.einsum("iml,l->i", np.abs(I.Oe1), q) * w**2)
    if frame.stiffening is not None:
        stiffening = frame.stiffening
        sizes[("elastic", "stiffening, acceleration")] = elastic(np.abs(stiffening.acceleration).sum(axis=0) @ q * a)
        sizes[("elastic", "stiffening, angular acceleration")] = elastic(
            np.abs(stiffening.angular_acceleration).sum(axis=0) @ q * alpha
        )
        sizes[("elastic", "stiffening, rotation")] = elastic(np.abs(stiffening.rotation).sum(axis=0) @ q * w**2)
    return sizes


def _second_order(I: ShapeIntegrals, motion: _Motion) -> dict[tuple[str, str], float]:  # noqa: E741
    """Moments that the deformation adds to those of the rigid body."""
    q, v, turning, w = motion.q, motion.v, motion.alpha + motion.w**2, motion.w
    C6 = np.abs(I.C6)
    norm = np.linalg.norm
    return {
        ("moment", "J1"): float(norm(np.tensordot(q, np.abs(I.J1), 1))) * turning,
        ("moment", "C6"): float(norm(np.einsum("klab,k,l->ab", C6, q, q, optimize=True))) * turning
        + 2 * float(norm(np.einsum("lkab,k,l->ab", C6, v, q, optimize=True))) * w,
        ("moment", "Cr1"): float(norm(np.einsum("lka,k,l->a", np.abs(I.Cr1), q, motion.acceleration, optimize=True))),
        ("moment", "Gr"): float(norm(np.tensordot(v, np.abs(I.Gr), 1))) * w,
    }
