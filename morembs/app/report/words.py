"""Words and numbers of reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from morembs.app.report.sections import Section
from morembs.app.report.style import STYLE
from morembs.app.report.tolerances import TOL
from morembs.base.types import Floats
from morembs.body.floating.frame import FloatingFrame


def coordinate_words(kinds: Sequence[str]) -> str:
    """``12 constraint + 30 fixed-interface = 42 coordinates``."""
    counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
    return " + ".join(f"{count} {kind}" for kind, count in counts.items()) + f" = {len(kinds)} coordinates"


def percent(ratio: float) -> str:
    return "0" if abs(ratio) < TOL.zero_ratio else f"{100 * ratio:.2g}"


def mass_section(document: Mapping[str, Any]) -> Section:
    """Mass, center of mass and inertia of a document; those of coordinates at one point mean nothing."""
    if not np.any(document["inertia"]):
        place = "all coordinates lie at one point, as those of matrices without nodes do"
        return Section(lines=["", f"mass properties: none; {place} (morembs import --nodes MESH gives them places)"])
    center = clean_center(document["center_of_mass"], document["mass"], document["inertia"])
    inertia = _clean(document["inertia"])
    labels = ("inertia about it", "", "")
    rows = [
        ("mass", f"{document['mass']:.6g} kg"),
        ("centre of mass", ", ".join(f"{v:.6g}" for v in center) + " m"),
        *((label, "  ".join(f"{v:12.5e}" for v in row) + " kg m2") for label, row in zip(labels, inertia, strict=True)),
    ]
    return Section(title="mass properties", columns=("", ""), rows=rows)


def clean_center(center: ArrayLike, mass: float, inertia: Floats) -> Floats:
    """Centre of mass (3,) in m with 0 for what is round-off against its distance and the radius of gyration, from
    ``mass`` in kg and ``inertia`` (3, 3) in kg m2."""
    gyration = np.sqrt(max(np.trace(inertia), 0.0) / 2 / mass) if mass > 0 else 0.0
    return _clean(center, float(gyration))


def _clean(given: ArrayLike, least: float = 0.0) -> Floats:
    """What lies below the digits shown, against the largest entry or ``least``, becomes zero."""
    values = np.asarray(given)
    return np.where(np.abs(values) < TOL.zero_entry * np.abs(values).max(initial=least), 0.0, values)


def bytes_words(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"


def frame_words(frame: FloatingFrame) -> str:
    """``tangent frame at big_end, 36 elastic coordinates, geometric stiffening (6 of 24 terms kept)``."""
    at = f" at {' and '.join(frame.interfaces)}" if frame.interfaces else ""
    words = f"{frame.kind} frame{at}, {frame.count} elastic coordinates"
    if frame.stiffening is not None:
        stiffening = frame.stiffening
        kept = sum(share > 0 and name not in stiffening.dropped for name, share in stiffening.share.items())
        words += f", geometric stiffening ({kept} of {len(stiffening.share)} terms matter)"
    return words


def _percent(share: float) -> str:
    return f"{100 * share:.0f}" if share >= TOL.whole_percent_share else f"{100 * share:.2g}"


def ranking_words(terms: Sequence[tuple[str, str, float]]) -> str:
    """``Oe 45 % (elastic), ...``: name, share and equation of the inertia terms that matter most."""
    shown = [f"{name} {_percent(share)} % ({equation})" for name, equation, share in terms[: STYLE.ranked_terms]]
    return ", ".join(shown) + (", ..." if len(terms) > STYLE.ranked_terms else "")
