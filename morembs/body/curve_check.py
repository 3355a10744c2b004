"""Does a body have the responses that its certificate shows? This also tells of bodies that are held to the ground."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from morembs.base.types import Floats
from morembs.body.diagnostics.findings import Finding
from morembs.body.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve:
    """Size of the elastic part of H of a body, its Frobenius norm: ``size`` (nf,) in m/N at ``frequencies_hz`` (nf,),
    motions and loads times ``scale`` (m,), with the loss factor ``structural``."""

    frequencies_hz: Floats
    size: Floats
    scale: Floats
    structural: float


def curve_findings(
    curve: Curve | None, M: Floats, D: Floats, K: Floats, B: Floats, C: Floats, E: Floats | None, rigid: int
) -> list[Finding]:
    """Errors where the response of M, D, K (n, n), B (n, m), C (m, n) is not that of the ``curve`` at most of some
    frequencies.

    ``E`` (n, n - rigid) are the elastic modes; None for two bases, where rigid motions are the first coordinates.
    """
    if curve is None or not len(curve.size) or not B.size:
        return []
    if E is None:
        M, D, K = (A[rigid:, rigid:] for A in (M, D, K))
        B, C = B[rigid:], C[:, rigid:]
    else:
        M, D, K = (E.T @ A @ E for A in (M, D, K))
        B, C = E.T @ B, C @ E
    B, C = B * curve.scale, curve.scale[:, None] * C
    picked = np.unique(np.linspace(0, len(curve.size) - 1, TOL.curve_samples).astype(int))

    def size(w: float, factor: float) -> float:
        A = (1 + 1j * curve.structural) * factor * K + 1j * w * D - w**2 * M
        return float(np.linalg.norm(C @ np.linalg.solve(A, B)))

    off = 0
    for w, held in zip(2 * np.pi * curve.frequencies_hz[picked], curve.size[picked], strict=True):
        with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
            found = size(w, 1.0)
            near = abs(found - size(w, 1.0 + TOL.stiffness_step)) / TOL.stiffness_step
            off += abs(found - held) > TOL.curve_difference * held + TOL.stiffness_change * near
    if 2 * off <= len(picked):
        return []
    sentence = "the body does not respond as its certificate shows: M, D, K, B or C are others"
    return [Finding(code="response", severity="error", sentence=sentence, cure="write it again")]
