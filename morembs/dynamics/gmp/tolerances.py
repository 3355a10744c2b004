"""Tolerances and limits of tabulated members."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MemberTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Range of both end angles, in rad, where none is given: 46 degrees; chosen.
    default_reach: float = 0.8
    # Largest error of the tables, each quantity over its largest value, where none is given: 0.2 %.
    table_error: float = 2e-3
    # Largest error of the derivatives of the tables; beyond it the grid misses what the equilibria do.
    max_derivative_error: float = 0.02

    # Velocity out of the plane, over the largest, that is none: nine digits.
    velocity_out_of_plane: float = 1e-9
    # Sine of the angle between two normals of one plane that is none: six digits, as axes are typed.
    normal_mismatch: float = 1e-6
    # Distance of two points from the length of their member, as a part of it, that is none: six digits.
    length_mismatch: float = 1e-6
    # Angle in rad from the direction of a member that is none: six digits.
    angle_mismatch: float = 1e-6
    # Difference of pieces, in lengths of the beam and in rad, below which they are one: nine digits.
    same_piece: float = 1e-9
    # Turn in rad between two elements that is a corner, and turns of all elements together that are a bend.
    least_bend: float = 1e-6
    # Part of the tables' range that a new division aims at: the same angles then leave a quarter.
    wanted_table_part: float = 0.75

    # Part of the end moments that the first step takes.
    first_moment_part: float = 1 / 4
    # Part of them below which steps that fail end the range: six halvings of the first.
    least_moment_part: float = first_moment_part / 2**6
    # Steps of Newton's method to an equilibrium under end moments; chosen.
    moment_iterations: int = 12
    # Change of angles in rad at which that ends; chosen.
    moment_angle_change: float = 1e-5
    # Largest step of it in rad: 23 degrees.
    max_moment_step: float = 0.4
    # Range over the largest angle under the moments: 5 % of room.
    range_margin: float = 1.05
    # Largest range in rad, below half a turn.
    max_range: float = 3.0
    # Angle in rad below which an envelope turns nothing: polynomials of it would be of round-off.
    least_range: float = 1e-6

    # Halvings of a step (to 1/64) before equilibria count as not to be followed.
    step_halvings: int = 6
    # Longest step of both angles, in rad: 20 degrees.
    longest_step: float = 0.35
    # Largest correction of a guess per length of its step; a longer one may lead to another branch of equilibria.
    max_correction: float = 0.5
    # Part of a way that is left and no step of its own.
    negligible_step: float = 1e-9
    # Length of a step, in m or rad, below which corrections are compared with this: they are round-off.
    least_moved: float = 1e-9
    # Distance of the ends over the length below which the chord has no direction: 5 %.
    least_chord: float = 0.05
    # Last step of Newton's method for solids, over their size.
    solid_newton_step: float = 1e-10

    # Steps of Newton's method to the amplitudes between held frames; chosen.
    configuration_iterations: int = 50
    # Largest deflection of the last one, over the length: twelve digits.
    configuration_step: float = 1e-12

    # Difference of masses along the axes, and of what couples them, over the largest that is round-off of an assembly.
    mass_mismatch: float = 1e-9
    # Smallest singular value of functions of a beam that is kept, over the largest of the scaled shapes.
    kept_singular_value: float = 1e-11
    # The same of a solid; chosen above the last step of its equilibria, 1e-10.
    kept_solid_singular_value: float = 1e-9
    # Free dofs up to which all modes are computed by a dense solver; chosen.
    dense_modes_dofs: int = 600
    # Share of the kinetic energy of a mode along the chord from which it is one of stretching: the larger half.
    stretching_share: float = 0.5
    # Kinetic energy across the plane over that along y from which a mode is none of bending in the plane.
    out_of_plane_share: float = 0.5
    # Flexibility of a mode over the largest that is round-off: frequencies a million times the lowest.
    no_flexibility: float = 1e-12
    # Modes tabulated only to see whether they would have answered.
    spare_modes: int = 2
    # Step in rad and m of a central difference that is exact at any length, as what it differentiates is quadratic.
    tangent_step: float = 1e-2
    # Direction in rad of the elements of a beam below which it is straight: nine digits.
    straight_angle: float = 1e-9
    # Distance of the ends of a solid from the x axis, over its length, that is none: coordinates with nine digits.
    off_axis: float = 1e-9
    # Degree of the polynomials along a solid that its sections are fitted by, at most; chosen.
    section_degree: int = 14
    # Singular value of that fit, over the largest, that is none; chosen.
    fit_singular_value: float = 1e-10

    # Part of the range that was reached which is tried next.
    retried_reach: float = 0.9
    # Part of the range that was asked for below which that ends.
    least_reach: float = 0.1
    # Sizes of the two deflections, in lengths, by which components are told apart: chosen, a small and a large one.
    signature_deflections: tuple[float, float] = (1e-3, 2e-2)
    # Time between two checkpoints over the time that one takes: they take a tenth at most.
    checkpoint_interval: float = 10.0
    # Relative difference of the signatures of one component: eight digits.
    same_signature: float = 1e-8

    # Distance of a node from its image, over the length: coordinates with seven digits.
    image_distance: float = 1e-7
    # Difference of inner forces at images, over the largest, that is none: nine digits.
    image_force: float = 1e-9
    # Random deflections at which that is looked at; chosen.
    symmetry_states: int = 3
    # Their size, as a part of the length.
    symmetry_deflection: float = 0.1
    # Rotations of nodes in them, in rad: 17 degrees.
    symmetry_turn: float = 0.3


TOL = MemberTolerances()
