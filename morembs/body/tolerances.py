"""Tolerances, limits and block sizes of reduced bodies: their checks, their files and their pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class BodyTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # --- Matrices
    # Difference of an entry from its mirror image, over the largest one or its diagonal, that is round-off.
    asymmetry: float = 1e-9
    # Negative eigenvalue of a matrix of unit diagonal that is round-off: the root of eps.
    negative_eigenvalue: float = 1e-8
    # Eigenvalue over the largest, in units of the mass, that is round-off: 4500 eps.
    roundoff_eigenvalue: float = 1e-12
    # Difference of nominal matrices that are computed in two ways, over the largest entry: nine digits.
    nominal_difference: float = 1e-9
    # Difference of a floating frame from the matrices, over what cancels in a product: six digits.
    frame_difference: float = 1e-6

    # --- Frequencies, damping and responses
    # Difference of the frequencies of a body from those that come with it, over them: printed ones have six digits.
    frequency_error: float = 1e-6
    # Sum of effective masses below which a note says so: 80 % is less than the 90 % that codes of practice ask for.
    effective_mass: float = 0.8
    # Singular value of the interface motions over the largest of those that depend on others: 4500 eps.
    dependent_motion: float = 1e-12
    # Negative damping ratio that is round-off: 4500 eps.
    negative_damping: float = 1e-12
    # Damping of rigid motion, over the first elastic frequency, that is round-off: it decays over 1e8 vibrations.
    rigid_damping: float = 1e-9
    # Frequencies of a curve that are computed again: both ends and the middle.
    curve_samples: int = 3
    # Difference of the size of H, over it, where K is the same: five digits.
    curve_difference: float = 1e-5
    # Change of K, of itself, that round-off and solvers leave: near a resonance it is most of the difference.
    stiffness_change: float = 1e-6
    # Step that measures the effect of a change of K: the root of eps.
    stiffness_step: float = 1e-8

    # --- Rigid motion
    # Frequency of rigid motion by its energy, over the first elastic one, that is worth a warning: 1e-4 of stiffness.
    soft_ground: float = 1e-2
    # The same of an error: 1 % of the stiffness.
    hard_ground: float = 0.1
    # Difference of mass, center (per radius of gyration) and inertia from those of the model: six digits.
    mass_error: float = 1e-6
    # The same of an error instead of a warning. Not measured: rounded numbers differ by less.
    wrong_mass: float = 1e-3
    # Energy of a rigid motion, over the largest, by which a finding names it. Not measured.
    named_energy: float = 1e-3
    # Singular value over the largest that least squares leave out: 5 eps.
    least_squares_cutoff: float = 1e-15
    # Condition of the six interface motions beyond which their eigenvectors tell no rigid motion: four digits are left.
    unclear_condition: float = 1e12
    # Part of an interface motion beside the others, over the first, that is none: the root of eps.
    dependent_support: float = 1e-8
    # Difference of an interface motion from that of its frame, over its size: six digits.
    interface_motion: float = 1e-6

    # --- Rotations and trajectories
    # Error of the axes of a stored frame as a rotation: six digits.
    axes_error: float = 1e-6
    # Error of the rotations of a trajectory, as printed ones have it: four digits.
    rotation_error: float = 1e-4
    # Largest stress: von Mises stresses, up to three times their components, have to stay within single precision.
    largest_stress: float = float(np.finfo(np.float32).max) / 4
    # Jump of stress between elements, over the largest stress, by which the mesh is called coarse. Not
    # measured.
    large_jump: float = 0.05
    # Displacement within the frame, over the size of the body, that no linear body should have. Not measured: it
    # turns parts by some 17 degrees.
    large_displacement: float = 0.3
    # Columns of the model's length that one block of stress shapes costs, beside the gradients at the points.
    gradient_copies: int = 6

    # --- Pictures
    # Largest displacement that is drawn, over the longest side of the body: shapes are seen, and stay apart.
    drawn_displacement: float = 0.07
    # Slant of the view against the flat side of the body, degrees upwards: by eye, so that all three sides are seen.
    view_tilt: float = 28.0
    # The same sideways.
    view_turn: float = -18.0
    # Entries of a transfer matrix that are drawn by default: the motions of one interface.
    drawn_receptances: int = 6
    # Frequencies of such a chart beside the resonances: one for each of 800 points of a picture.
    drawn_frequencies: int = 800
    # Speeds of a Campbell diagram where none are given.
    drawn_speeds: int = 41
    # Elastic modes of a picture: two rows of two.
    drawn_modes: int = 4
    # Elastic modes that the viewer shows of a body: each takes some 4 bytes a node of its page.
    viewed_modes: int = 12
    # The same of all bodies of one page beyond the first.
    viewed_modes_of_all: int = 24
    # Steps that it shows of a motion: between them it is drawn along straight lines.
    viewed_steps: int = 120
    # Coordinates of all steps: 3 MB of a page, of the 5 MB that it may have.
    viewed_numbers: int = 2_500_000
    # Distance of nodes of two meshes that are compared, over the size of the part: shapes change by little there.
    compared_distance: float = 0.02
    # Elastic modes of a VTKHDF file: each takes 12 bytes a node.
    vtk_modes: int = 20
    # Bytes of a basis that are in memory at a time while that is written.
    vtk_block_bytes: int = 8 * 2**20
    # Relative difference of two coordinates that are equal, of which the first has the sign: far above their error.
    equal_coordinate: float = 1e-6


TOL = BodyTolerances()
