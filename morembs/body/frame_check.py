"""Does the floating frame of a body agree with its matrices? Both say the same, computed in two ways."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats
from morembs.body.delivered import Delivered
from morembs.body.diagnostics.findings import Finding
from morembs.body.tolerances import TOL


def frame_findings(given: Delivered) -> list[Finding]:
    """Errors where stiffness, damping, mass or interface degrees of freedom of the frame are not those of the body.

    With E the elastic and R the rigid coordinates of the frame: Ke = E'KE, De = E'DE, Me = E'ME, [Ct, Cr] = E'MR, and
    R'MR is the mass of a rigid body; the markers move as C says.
    """
    frame = given.floating
    if frame is None:
        return []
    E, R, integrals = frame.elastic, frame.rigid, frame.integrals
    pairs: list[tuple[str, Floats, Floats, Floats, Floats]] = [
        ("Ke", frame.Ke, E, given.K, E),
        ("De", frame.De, E, given.D, E),
        ("integrals/Me", integrals.Me, E, given.M, E),
        ("integrals/Ct and Cr", np.hstack([integrals.Ct, integrals.Cr]), E, given.M, R),
        ("integrals/mass, first and inertia", integrals.rigid, R, given.M, R),
    ]
    wrong = [
        name
        for name, held, left, A, right in pairs
        if not _agree(held, left.T @ A @ right, np.outer(_size(left, A), _size(right, A)))
    ]
    # A frame that follows an interface holds it still: motions are measured by those of the whole body.
    usual = _size(E, given.M) / np.sqrt(given.mass)
    radius = float(np.sqrt(np.trace(given.inertia) / (2 * given.mass)))
    for name, rows in given.markers.items():
        if name in frame.markers:
            moved, size = given.C[rows] @ E, np.abs(given.C[rows]) @ np.abs(E)
            scale = np.repeat([usual + size[:3].max(axis=0), usual / radius + size[3:].max(axis=0)], 3, axis=0)
            if not _agree(frame.markers[name].motion, moved, scale):
                wrong.append(f"markers/{name}")
    if not wrong:
        return []
    sentence = f"the floating frame does not belong to the matrices: {', '.join(wrong)} are not what follows from them"
    return [Finding(code="frame", severity="error", sentence=sentence, cure="write it again", where=tuple(wrong))]


def _size(X: Floats, A: Floats) -> Floats:
    """(k,): the root of what cancels in x'Ax for each column x."""
    return np.asarray(np.sqrt(np.einsum("nk,nm,mk->k", np.abs(X), np.abs(A), np.abs(X), optimize=True)))


def _agree(held: Floats, follows: Floats, scale: Floats) -> bool:
    return held.shape == follows.shape and bool((np.abs(held - follows) <= TOL.frame_difference * scale).all())
