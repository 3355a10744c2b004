"""Tolerances and block sizes of problems."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProblemTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Relative difference of limits of modes that are one limit: 45 eps.
    same_limit: float = 1e-14
    # Shift in the Sturm count of motions without energy, over the round-off in that of rigid motion.
    mechanism_shift: float = 1e3

    # Terms up to which round-off of their sum is that of a row of an assembled matrix: about 30 nodes.
    row_terms: int = 100
    # Inertia of a motion beside the others, over its own, that is none: the square of 1e-6.
    dependent_motion: float = 1e-12
    # Motion of a group over the largest one that is none: coordinates with nine digits.
    still_motion: float = 1e-9
    # Entry of a rigid motion over its largest that is round-off of making it orthonormal: 45 eps.
    still_row: float = 1e-14

    # Radius of the places of nodes, over the radius of gyration, below which they say nothing of the size of a model.
    compact_radius: float = 1e-3

    # Part of the bound of round-off that is seen as a rule: round-off adds up at random.
    usual_roundoff: float = 0.1
    # Part of a static motion, or of the stiffness of a mode, that round-off may take: three digits are left.
    lost_digits: float = 1e-3

    # Backward error that a solution at a shift may have: the root of eps.
    backward_error: float = 1e-8
    # Resident memory of a process that has read nothing yet: Python and the libraries.
    process_bytes: int = 96_000_000
    # Blocks of loads that exist at once while they are solved for, beside those of the result.
    load_blocks: int = 4


TOL = ProblemTolerances()
