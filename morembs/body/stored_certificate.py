"""How wrong a body is, in its file."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from morembs.certificate.certify import Certificate


def write_certificate(put: Callable[..., None], group: str, its: Certificate) -> None:
    """Store ``its`` figures under ``group``; ``put`` stores one dataset: name, value, what it is, its units."""
    put(f"{group}/frequencies_hz", its.frequencies_hz, "where the errors were taken", "Hz")
    put(f"{group}/full", its.full, "size of the transfer matrix of the full model", "m/N")
    put(f"{group}/reduced", its.reduced, "size of that of the body", "m/N")
    put(f"{group}/error", its.error, "size of the difference, relative to the full model")
    put(f"{group}/bound", its.bound, "upper bound of the error, or an estimate: see bound_kind")
    put(f"{group}/bound_kind", its.bound_kind)
    put(f"{group}/block_error", its.block_error, "largest error of motion of interface i to load on interface j")
    put(f"{group}/held_error", its.held_error, "error of what is left when interface i is held still")
    put(f"{group}/static_error", its.static_error, "error at 0 Hz")
    put(f"{group}/absolute_error", its.absolute_error, "largest difference over the largest size in the band")
    put(f"{group}/reference_error", its.reference_error, "estimated error of the full response itself")
    put(f"{group}/mode_frequencies_hz", its.mode_frequencies_hz, "of the full model in the band", "Hz")
    put(f"{group}/mode_deviation", its.mode_deviation, "relative deviation of the body's frequencies")
    put(f"{group}/mode_mac", its.mode_mac, "mass-weighted modal assurance criterion")
    put(f"{group}/verified_below_hz", its.verified_below_hz, "a Sturm count found no mode missing", "Hz")
    put(f"{group}/notes", "; ".join(its.notes) or " ")
