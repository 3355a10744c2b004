"""How wrong a body is, in its file."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from morembs.certificate.certify import Certificate

# 2: limits hold at every frequency of a band; files without a version have errors at samples.
VERSION = 2


def certificate_datasets(its: Certificate) -> dict[str, tuple[object, str, str]]:
    """Name of each dataset -> its value, what it is, its units."""
    found: dict[str, tuple[object, str, str]] = {
        "version": (VERSION, "2: limits on every frequency of the band", ""),
        "band_hz": (np.array(its.band_hz), "the limits hold from here to there", "Hz"),
        "measure": (its.measure, "the limit that counts", ""),
        "damping_floor": (its.damping_floor, "ratio of critical damping assumed in the full model and the body", ""),
        "block_limit": (its.block_limit, "upper limit of motion of interface i to load on interface j", ""),
        "cells_hz": (its.cells_hz, "cells of the band, with upper limits in cell_limit", "Hz"),
        "cell_limit": (its.cell_limit, "upper limits on the cells: " + ", ".join(its.limits), ""),
        "uncertainty": (its.reference_error, "how far the full response is not known, relative to its size", ""),
        "residue_deviation": (its.residue_deviation, "relative deviation of the body's residues", ""),
        "mode_enclosure_hz": (its.mode_enclosure_hz, "between these a frequency of the full model lies", "Hz"),
        "frequencies_hz": (its.frequencies_hz, "of the curves", "Hz"),
        "full": (its.full, "size of the transfer matrix of the full model", "m/N"),
        "reduced": (its.reduced, "size of that of the body", "m/N"),
        "error": (its.error, "size of the difference, relative to the full model", ""),
        "bound": (its.bound, "upper limit of the error, or an estimate: see bound_kind", ""),
        "bound_kind": (its.bound_kind, "", ""),
        "block_error": (its.block_error, "largest error of motion of interface i to load on interface j", ""),
        "held_error": (its.held_error, "error of what is left when interface i is held still", ""),
        "static_error": (its.static_error, "error at 0 Hz", ""),
        "absolute_error": (its.absolute_error, "largest difference over the largest size, at the samples", ""),
        "reference_error": (its.reference_error, "as uncertainty", ""),
        "mode_frequencies_hz": (its.mode_frequencies_hz, "of the full model in the band", "Hz"),
        "mode_deviation": (its.mode_deviation, "relative deviation of the body's frequencies", ""),
        "mode_mac": (its.mode_mac, "mass-weighted modal assurance criterion", ""),
        "verified_below_hz": (its.verified_below_hz, "a Sturm count found no mode missing", "Hz"),
        "notes": ("; ".join(its.notes) or " ", "", ""),
    }
    for name, one in its.limits.items():
        values = np.array([one.lower, one.upper, one.at_hz])
        found[f"limits/{name}"] = values, "largest error over the band: at least, at most, where the former is, Hz", ""
    return found


def write_certificate(put: Callable[..., None], group: str, its: Certificate) -> None:
    """Store ``its`` figures under ``group``; ``put`` stores one dataset: name, value, what it is, its units."""
    for name, dataset in certificate_datasets(its).items():
        put(f"{group}/{name}", *dataset)
