"""Tolerances, limits and block sizes of bodies in floating frames."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class FloatingTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Rigid motions of a free body: three translations and three rotations.
    rigid_motions: int = 6

    # --- Integrals of the mass
    # Difference of the masses along x, y and z, and mass between them, over the largest, up to which a node has one
    # mass for all directions: 4500 eps.
    same_mass: float = 1e-12
    # Columns that are handled at a time: wider blocks have larger temporaries alone. Not measured.
    integral_columns: int = 32
    # Complex step of derivatives: its square is nothing beside one (Squire and Trapp 1998).
    complex_step: complex = 1e-60j

    # --- Stiffening by loads
    # Load over what it was before the frame's reaction balances it that causes no stress: round-off of sums over all
    # dofs.
    balanced_load: float = 1e-10
    # Singular value over the largest that is left out where reactions depend on each other: 450 eps.
    dependent_reaction: float = 1e-13
    # Loads that are handled at a time: the six of a point.
    loads_at_once: int = 6
    # Columns of the basis that are handled at a time, for each load. Not measured.
    basis_columns: int = 8
    # Part of the budget left that the matrices of one group of loads may take: the quarter of other blocks.
    budget_share: float = 0.25
    # Term over the others that is round-off: 4500 eps.
    negligible_term: float = 1e-12

    # --- Preload
    # Nodes whose rows of K are written at a time: 3 rows of some 80 entries are 40 MB.
    nodes_at_once: int = 20_000
    # Condition (lengths scaled) above which six dofs do not hold the body: more than seven digits are lost.
    loose_condition: float = 1e7
    # Steps of the Lanczos iteration for the critical factor, at most; a step is a solution. Not measured.
    buckling_steps: int = 120
    # Error of the critical factor, over it: four digits, far below the scatter of buckling loads.
    buckling_error: float = 1e-4
    # Critical factor beyond which it is reported as "above" alone: loads change the stiffness by 5 % there.
    far_factor: float = 20.0

    # --- Spin
    # Whirl of a mode, -1 to 1, from which on it is a circle. Not measured: axes of an ellipse as 1 to 0.73 have it.
    circular_whirl: float = 0.95
    # Singular value over the largest of interface motions that hold nothing new: coordinates with nine digits.
    dependent_hold: float = 1e-9
    # Part of a mode's inertia that moves across the axis below which it has no whirl: the square of 1e-3.
    across_axis: float = 1e-6


TOL = FloatingTolerances()
