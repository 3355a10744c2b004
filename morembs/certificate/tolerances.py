"""Tolerances and limits of certificates."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CertificateTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # MAC of a reproduced mode: at 1/2 the nearest subspace holds less of the mode than it misses.
    least_mac: float = 0.5
    # Frequency over the upper one below which errors with a held interface drown in rigid motion (1 / omega^2).
    least_held: float = 0.02

    # Relative difference of the limits of neighbouring cells that are stored as one: 5 % is the sharpness of limits.
    cell_merge_ratio: float = 0.05
    # Cells in a file: 5000 of five numbers are 200 kB.
    max_stored_cells: int = 5000
    # Ratio of merged limits: a limit a million times too large says nothing.
    max_merge_ratio: float = 1e6
    # Frequencies in a cell at which the cause of its limit is looked for: eight equal steps.
    cause_samples: int = 9
    # Distance of a pole from the axis of frequencies, over its size, that is round-off of no damping: 4500 eps.
    undamped_pole: float = 1e-12
    # Error of the full response over its largest entry, unless another is asked for: eight digits.
    full_response_error: float = 1e-8
    # Response over its envelope that counts as a zero: a relative error of 1 there is 1 % of the envelope.
    zero_response: float = 1e-2

    # --- Pictures
    # Error that a picture draws at least: below eps.
    least_drawn_error: float = 1e-16
    # Cells of a limit that are drawn: two points of a picture 800 points wide.
    drawn_cells: int = 400

    # --- Modes
    # Relative distance of frequencies whose modes are compared as one subspace: below 0.1 % they mix freely.
    mode_cluster_gap: float = 1e-3
    # Share of a mode in the static energy of unit loads that is round-off: the square of 1e-6.
    unexcited_energy: float = 1e-12

    # Block before a witness with the digest of the rest: the least that HDF5 allows.
    user_block_bytes: int = 512
    # Bytes that are summed at once: 4 MB.
    digest_bytes: int = 1 << 22
    # Shift of a count over the upper end of the band, at least: the bound of the residual grows by 1 / (1 - 1 / 1.1^2).
    least_shift: float = 1.1


TOL = CertificateTolerances()
