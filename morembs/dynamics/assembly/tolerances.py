"""Tolerances and limits of assemblies."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AssemblyTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Difference of mass, places and inertia of a part and its body, as a part of them, that is none: eight digits.
    same_part: float = 1e-8
    # Difference of products of reduced matrices, over the largest, that is none: five digits.
    same_product: float = 1e-5

    # Distance of two interfaces that are coupled, over the size of the assembly: coordinates with six digits.
    coupled_distance: float = 1e-6
    # The same distance that is round-off: 450 eps.
    coincident_distance: float = 1e-13
    # Relative motion of two sides, as a part of the motion of the parts, above which couplings leave it free: ten times
    # the distance that coupled interfaces may have.
    free_motion: float = 10 * coupled_distance

    # Force of rigid motion over what cancels in it that is round-off of a reduction: six digits.
    rigid_strain: float = 1e-6
    # The same over the largest entry of K.
    rigid_force: float = 1e-10
    # Entry of R'R - 1 of a rotation that is given: six digits.
    rotation_error: float = 1e-6
    # Dofs of one frame, which moves a part as a whole.
    frame_dofs: int = 6

    # Dofs of a part up to which its damping may be a full matrix: 2000 give 32 MB.
    max_full_damping_dofs: int = 2000
    # Matrices of a part that exist at once.
    matrix_copies: int = 4
    # Bytes of a sparse entry: a double and an index of four bytes.
    entry_bytes: int = 8 + 4
    # Ratio of pivots below which the motions of an interface depend on each other: coordinates with nine digits.
    dependent_motion: float = 1e-9


TOL = AssemblyTolerances()
