"""Certificates for people: the same sections for those just made and those read from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from morembs.app.report.sections import Section
from morembs.app.report.tolerances import TOL
from morembs.base.summary import upwards

MEASURES = ("envelope", "peak", "pointwise")
KINDS = {"bound": "proven", "estimate": "estimate", "none": "sampled"}
LEGEND = (
    "error of the frequency response relative to the sum of its modes (envelope), to its largest value (peak), to "
    "itself (pointwise); block: of the worst pair of interfaces, by the envelope; static: at 0 Hz; modes, residues, "
    "MAC: the worst mode in the band that loads excite"
)
# Two tables, each of which fits a terminal of 100 columns.
LIMITS = ("body", "order", *(f"{name} <=" for name in MEASURES), "worst at Hz", "block <=", "kind")
DEVIATIONS = ("body", "static", "modes off by", "residues off by", "MAC")


@dataclass(frozen=True, kw_only=True)
class Certified:
    """A body with its order, the ``values`` of its certificate by the names of a body file, and further ``notes``."""

    name: str
    order: int
    values: Mapping[str, Any]
    notes: Sequence[str] = ()

    def text(self, key: str) -> str:
        """A text of the certificate; sentences of one that was just made are joined as a body file joins them."""
        value = self.values.get(key, "")
        if isinstance(value, tuple | list):
            return "; ".join(value)
        return str(value.item() if isinstance(value, np.ndarray) else value).strip()


def certificate_sections(known: Sequence[Certified], interfaces: Sequence[str]) -> list[Section]:
    """Tables of the certificates: one for each band and damping floor."""
    groups: dict[tuple[float, float, float], list[Certified]] = {}
    lines: list[str] = []
    for certified in known:
        if "version" in certified.values:
            band, floor = certified.values["band_hz"], float(certified.values["damping_floor"])
            groups.setdefault((float(band[0]), float(band[1]), floor), []).append(certified)
        else:
            lines.append(_at_samples(certified))
    sections = [Section(lines=lines)] if lines else []
    return sections + [one for band, group in groups.items() for one in _sections(*band, group, interfaces)]


def _sections(
    low: float, high: float, floor: float, known: Sequence[Certified], interfaces: Sequence[str]
) -> list[Section]:
    holds = any(KINDS[certified.text("bound_kind")] != "sampled" for certified in known)
    what = "holds at every frequency" if holds else "errors at samples"
    lines = [f"  {LEGEND}"]
    if floor:
        lines.append(
            f"  damping of {100 * floor:.3g} % of critical assumed in both beside their own; poles are compared "
            "without it"
        )
    lines += [
        f"  {certified.name}: {note}"
        for certified in known
        for note in (*_does_not_serve(certified, interfaces), *_notes(certified))
    ]
    return [
        Section(
            title=f"certificate: {what} from {low:,.6g} to {high:,.6g} Hz",
            columns=LIMITS,
            rows=[_limits(certified) for certified in known],
        ),
        Section(
            title="deviations of the static response and of the modes in that band",
            columns=DEVIATIONS,
            rows=[_deviations(certified) for certified in known],
            lines=lines,
        ),
    ]


def _limits(certified: Certified) -> tuple[str, ...]:
    values = certified.values
    kind = KINDS[certified.text("bound_kind")]
    limits = [np.asarray(values["limits"][name], dtype=float) for name in MEASURES]
    worst = limits[MEASURES.index(certified.text("measure"))]
    return (
        certified.name,
        str(certified.order),
        *("-" if kind == "sampled" else upwards(limit[1]) for limit in limits),
        "-" if kind == "sampled" else f"{worst[2]:,.6g}",
        "-" if kind == "sampled" else upwards(np.max(values["block_limit"], initial=0.0)),
        kind,
    )


def _deviations(certified: Certified) -> tuple[str, ...]:
    values = certified.values
    residue = np.asarray(values["residue_deviation"], dtype=float)
    # Modes that no load excites have no residue; what resembles them in a body says nothing.
    mac, moved = (
        np.asarray(values[name], dtype=float)[np.isfinite(residue)] for name in ("mode_mac", "mode_deviation")
    )
    return (
        certified.name,
        f"{float(values['static_error']):.1e}",
        _largest(moved),
        _largest(residue),
        f"{mac.min():.4f}" if len(mac) else "-",
    )


def _largest(deviations: Any) -> str:
    """Of the modes in the band; a dash where there is none to compare."""
    known = np.asarray(deviations, dtype=float)
    known = known[np.isfinite(known)]
    return f"{known.max():.1e}" if len(known) else "-"


def _does_not_serve(certified: Certified, interfaces: Sequence[str]) -> list[str]:
    """That a body is wrong by more than all of its response, and what is most wrong."""
    values = certified.values
    least, _, at_hz = np.asarray(values["limits"]["envelope"], dtype=float)
    if not least > 1:
        return []
    reached = np.isfinite(np.asarray(values["residue_deviation"], dtype=float))
    missing = (np.asarray(values["mode_mac"]) < TOL.missing_mac) & reached
    lost = np.asarray(values["mode_frequencies_hz"])[missing]
    if len(lost):
        listed = ", ".join(f"{f:,.6g}" for f in lost[:5]) + ("" if len(lost) <= 5 else ", ...")
        why = f"modes not in this body: {listed} Hz"
    else:
        blocks = np.asarray(values["block_limit"], dtype=float)
        i, j = divmod(int(np.argmax(blocks)), len(blocks))
        why = f"worst are motions of {interfaces[i]} under loads on {interfaces[j]}"
    return [f"the error exceeds 1, at {at_hz:,.6g} Hz; it does not serve in this band; {why}"]


def _notes(certified: Certified) -> list[str]:
    infinite = [name for name in MEASURES if not np.isfinite(certified.values["limits"][name][1])]
    notes = []
    if KINDS[certified.text("bound_kind")] == "sampled":
        hz, error = (np.asarray(certified.values[key], dtype=float) for key in ("frequencies_hz", "error"))
        at = int(np.argmax(error))
        notes.append(f"error at most {error[at]:.1e} (pointwise) at {len(hz)} frequencies, worst at {hz[at]:,.6g} Hz")
    # Files of earlier versions do not name the cause.
    if infinite == ["pointwise"] and certified.text("bound_kind") != "none" and not certified.text("notes"):
        at_hz = float(certified.values["limits"]["pointwise"][2])
        notes.append(f"pointwise: unbounded (zero of H at {at_hz:,.6g} Hz)")
    return [*notes, *([certified.text("notes")] if certified.text("notes") else []), *certified.notes]


def _at_samples(certified: Certified) -> str:
    hz, error, bound = (np.asarray(certified.values[key]) for key in ("frequencies_hz", "error", "bound"))
    known = f", {certified.text('bound_kind')} {bound.max():.1e}" if np.isfinite(bound).all() else ""
    return (
        f"  {certified.name}: certificate at samples: error at most {error.max():.1e}{known} at {len(hz)} frequencies "
        f"from {hz[0]:,.6g} to {hz[-1]:,.6g} Hz"
    )
