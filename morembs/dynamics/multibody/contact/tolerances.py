"""Tolerances and limits of contacts."""

from __future__ import annotations

from dataclasses import dataclass

from morembs.dynamics.multibody.tolerances import TOL as SYSTEM


@dataclass(frozen=True)
class ContactTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Divisor of quotients that may be 0 / 0, as of all systems.
    tiny: float = SYSTEM.tiny
    # Size of a system in m, at least, where tolerances are parts of it, as of all systems.
    least_size: float = SYSTEM.least_size

    # --- Runs
    # Spectral radius at infinite frequency, where none is given; chosen: high modes lose a fifth in a step.
    default_rho: float = 0.8
    # Error of Newton's method, where none is given, as of all runs.
    newton_error: float = SYSTEM.newton_error
    # Part of a step that is too short to be one, as of all runs.
    negligible_step: float = SYSTEM.negligible_step
    # Gap over the size of the system from which a point touches.
    touching_gap: float = 1e-11
    # Penetration over that size that is none at the start: coordinates with nine digits.
    start_penetration: float = 1e-9
    # Penetration over that size in a run of a point that came in over an edge.
    edge_penetration: float = 1e-6
    # Newton steps to the time at which a point touches; chosen.
    touch_iterations: int = 8
    # Part of the largest force of a direction without solution from which a message names the point.
    named_force: float = 1e-6

    # --- Coulomb's cone
    # Newton steps for one weight; chosen.
    cone_iterations: int = 40
    # Sweeps point by point after them; chosen.
    cone_sweeps: int = 300
    # Rounds of both; chosen.
    cone_rounds: int = 4
    # Weights of u against p where W has a diagonal of ones: large ones are for points that share their load.
    cone_weights: tuple[float, float, float] = (100.0, 1.0, 10.0)
    # Residuals below this part of the largest entry of q, in units where W has a diagonal of ones, are round-off.
    cone_roundoff: float = 1e-12
    # Residuals that are accepted, in the same units.
    cone_residual: float = 1e-10
    # Singular value of a tangent over the largest below which points are redundant.
    redundant_point: float = 1e-12
    # Part of a step of Newton's method down to which it is halved: ten times.
    least_step_part: float = 1e-3
    # Decrease of a residual that is enough, over what a linear one would do (Armijo; Nocedal and Wright 2006, 3.1).
    sufficient_decrease: float = 1e-4

    # --- Linear complementarity
    # Compliance about given forces, over that of the system: of redundant points it tells a solution near to them.
    near_compliance: float = 1e-4
    # Slip below this part of the largest entry of the problem is none.
    no_slip: float = 1e-11
    # Response of a point to the force of another, below this part of that to own forces, that is none.
    no_response: float = 1e-10
    # Diagonal entry over the largest entry that is none: 45 eps.
    no_diagonal: float = 1e-14
    # Entries of a scaled pivot column below this part of its largest are round-off.
    least_pivot: float = 1e-11
    # Ratios that differ by less than this, relative to the largest, are ties.
    tied_ratio: float = 1e-12
    # What complementary variables may be below zero after the last solve, relative to the scaled q.
    negative_variable: float = 1e-8
    # Part of the scaled q that is added to what an equation is made of: what is small against the problem is round-off.
    equation_scale: float = 1e-2
    # Pivots for each row before it is given up; chosen.
    pivots_per_row: int = 60
    # Pivots beside them, for problems of few rows; chosen.
    pivots_at_least: int = 200

    # --- Impacts
    # A crossing this near to the start of a step, as part of it, is the one that the step starts from.
    crossing_at_start: float = 1e-9
    # Imaginary part of a root, in steps, that is none: two crossings at once.
    real_root: float = 1e-9
    # Part of a step down to which it is cut where sliding ends: the point sticks at its end,
    # so it may not be of no length.
    shortest_step: float = 1e-4
    # Work of impulses above this part of twice the kinetic energy is no round-off.
    no_gain: float = 1e-12
    # Halvings of the part of restitution that adds no energy: to 1e-9.
    restitution_halvings: int = 30
    # Velocities of points that are none in an impact, over the least velocity; chosen.
    impact_noise: float = 1e-2
    # Velocities at rest over what they are made of: eight digits.
    at_rest: float = 1e-8
    # Velocity in m/s whose part at_rest counts as none where sliding ends, at least.
    least_sliding: float = 1e-12

    # --- Reactions
    # Accelerations of points below this part of what they are made of are round-off.
    acceleration_roundoff: float = 1e-13
    # A point that touches opens where its gap is above this part of the size of the system.
    opening_gap: float = 1e-12
    # Gaps and velocities below this part of the size and of the velocities of the system are round-off.
    gap_roundoff: float = 1e-15

    # --- Kinematics
    # Difference of the two triangles of a compliance, over its largest entry, that is none: eight digits.
    compliance_asymmetry: float = 1e-8
    # Negative eigenvalue of it, over the largest entry, that is round-off.
    negative_compliance: float = 1e-9
    # Turn in rad of a step of a five-point difference, as of all systems.
    five_point_turn: float = SYSTEM.five_point_turn
    # Step in rad and m of one-sided differences of forces, as of all systems.
    forward_step: float = SYSTEM.forward_step
    # Part of a direction at right angles to a normal from which it gives a tangent.
    least_tangent: float = 1e-3

    # --- Surfaces
    # Distance of two points of a curve over the longest one that is none: coordinates with nine digits.
    same_point: float = 1e-9
    # Steps to the nearest point of a curve or a patch; chosen.
    foot_iterations: int = 60
    # Change of parameters at which the search for it ends: 45 eps.
    foot_change: float = 1e-14
    # Part of its trace that is added to the matrix of that search, so that it is never singular: 45 eps.
    foot_regularisation: float = 1e-14
    # Growth of a square of a distance that is round-off: 4500 eps.
    distance_growth: float = 1e-12
    # Growth of a distance on a patch at which the search ends; chosen.
    patch_distance_growth: float = 1e-9
    # Patches that a search goes over; chosen.
    patches_visited: int = 60
    # Barycentric coordinate of a point on an edge.
    on_edge: float = 1e-9
    # Sum of two of them at a corner: 45 eps.
    at_corner: float = 1e-14
    # Twice the area of a triangle over the square of its longest side that is none: its corners are in a line.
    flat_triangle: float = 1e-6
    # Product of the unit normals of a vertex and of its triangle from which both point to one side: 87 degrees.
    same_side: float = 0.05
    # Area of a cell of a grid over the squares of its diagonals that is none.
    flat_cell: float = 1e-9
    # Distance beside the normal of a foot, over the distance, from which the foot is on an edge.
    beside_normal: float = 1e-7
    # The same in m that is round-off.
    least_beside_normal: float = 1e-12

    # --- Tables of force over penetration
    # Exponent of the force of smooth bodies by penetration (Hertz 1882).
    hertz_exponent: float = 1.5
    # Right-hand sides at a time.
    table_columns: int = 32
    # Elements across the contact radius below which its force is uncertain.
    elements_across: float = 4.0
    # Faces that the undeformed body would reach at this multiple of the largest penetration may come into contact.
    reached_penetration: float = 1.5
    # Cosine between the push and an axis that is none: six digits.
    push_along_axis: float = 1e-6


TOL = ContactTolerances()
