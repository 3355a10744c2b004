"""Tolerances and limits of multibody systems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from morembs.base.limits import number


@dataclass(frozen=True)
class MultibodyTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Divisor of quotients that may be 0 / 0: nothing physical is as small.
    tiny: float = 1e-300
    # Size of a system in m, at least, where tolerances are parts of it: a millimetre.
    least_size: float = 1e-3

    # --- What is given
    # Difference of the two triangles of an inertia, over its largest entry, that is none: nine digits.
    inertia_asymmetry: float = 1e-9
    # The same of the stiffness and the damping of a body: eight digits.
    stiffness_asymmetry: float = 1e-8
    # Least eigenvalue of a mass matrix with a diagonal of ones that is no round-off: 450 eps.
    least_mass_eigenvalue: float = 1e-13
    # Entry of R'R - 1 of a rotation that is given: six digits.
    rotation_error: float = 1e-6
    # The same where no other is asked for: eight digits.
    default_rotation_error: float = 1e-8
    # Distance of two pieces of a divided body over their size that is none: coordinates with six digits.
    gap_of_pieces: float = 1e-6
    # Difference of pieces, per size and per largest entry, up to which they are equal: eight digits.
    same_piece: float = 1e-8
    # Points of the line for each piece, to which elements are counted; chosen: to 1/200 of its length.
    points_of_piece: int = 200
    # Gap of a joint in m or rad, over the distance from the origin where that is beyond 1 m, that is none.
    open_joint: float = 1e-8
    # Velocity over that of the coordinates at which a joint opens.
    opening_joint: float = 1e-6
    # The same in m/s or rad/s where nearly nothing moves.
    least_opening: float = 1e-9
    # Singular value of equilibrated joint equations over the largest below which they depend on each other.
    dependent_joints: float = 1e-9
    # Entry of what dependent equations have in common from which a message names the joint.
    named_joint: float = 1e-6

    # --- Rotations
    # Angle in rad below which coefficients of rotations are series of three terms: the next one is below 1e-21.
    series_angle: float = 1e-3
    # The same of their derivatives: the next term is below 2e-14.
    derivative_series_angle: float = 0.05
    # Cosine of the angle above which the logarithm divides by its sine: up to 154 degrees.
    least_cosine: float = -0.9

    # --- Differences
    # Step in rad and m of one-sided differences, near the square root of round-off.
    forward_step: float = 1e-6
    # Step of central ones, near the cube root of round-off.
    central_step: float = 1e-5
    # Turn in rad of a step of a five-point difference: its error of fourth order, and round-off, are about 1e-12.
    five_point_turn: float = 3e-3
    # Relative change of a body, and change of an angle, in differences of fourth order: these leave, and lose by
    # round-off, about a part of 1e-12.
    varied_part: float = 1e-3
    # Part of that change for what a run starts with: its first accelerations, over a step that is long for the highest
    # modes, bend much more with a parameter than the body does.
    varied_start_part: float = 0.03
    # Singular value over the largest below which a solution of least norm takes none: 450 eps.
    least_norm_cut: float = 1e-13

    # --- Runs
    # Spectral radius at infinite frequency, where none is given; chosen: high modes lose a tenth in a step.
    default_rho: float = 0.9
    # Error of Newton's method over the largest velocity, in the norm of kinetic energy, where none is given.
    newton_error: float = 1e-9
    # The largest error that may be asked for, here and of equilibria: 1 %.
    max_newton_error: float = 1e-2
    # Ratio of two changes of Newton's method from which its matrix is made anew; chosen.
    slow_ratio: float = 0.15
    # The part of a step that is too short to be a step; an event that near to the end of a step is at its end.
    negligible_step: float = 1e-6
    # Part of the number of steps in a span that is round-off of its division: 4500 eps.
    step_count_error: float = 1e-12
    # Events within one step after which a run is given up.
    max_events_per_step: int = 400

    # --- Equilibria
    # Forces that are left over all forces, where nothing else is given: nine digits.
    left_force: float = 1e-9
    # Singular values of the equilibrated matrix below this part of the largest are motions without stiffness, and joint
    # equations that depend on each other.
    no_stiffness: float = 1e-11
    # Iterations before the search is given up; chosen: turns of half a rad add up to 30 rad.
    equilibrium_iterations: int = 60
    # Largest turn in rad in one iteration.
    max_turn: float = 0.5
    # Largest displacement in one, as a part of the size of the system.
    max_move: float = 0.5
    # Stiffness that stands for none where coordinates are equilibrated, as a part of the largest (rad/s)^2.
    soft_part: float = 1e-9
    # The same as a part of that of a pendulum as long as the system under its own acceleration.
    soft_pendulum: float = 1e-3
    # The same in (rad/s)^2 where there is neither, so that nothing is divided by zero.
    soft_square: float = 1e-12
    # Joint equations (m or rad, per size of the system) that are closed.
    closed_joint: float = 1e-10
    # Their round-off per distance to the origin: 45 eps.
    closed_joint_roundoff: float = 1e-14
    # Motion of an iteration, per size of the system, that is none: 450 eps.
    still_motion: float = 1e-13
    # Part of the forces left that may have stiffness where all of them count as without any.
    balanced_part: float = 1e-6
    # Force over the largest from which a message names the body.
    named_force: float = 1e-3
    # Velocities of joints, and changes of forces as a system turns, below this part of what they are made of are none.
    steady_part: float = 1e-8

    # --- Linear systems
    # Stiffness along a motion, over the largest, that is round-off of the differences; also of damping.
    difference_roundoff: float = 1e-9
    # Part of a matrix that is not symmetric, likewise.
    difference_asymmetry: float = 1e-6
    # Part of the largest square of a frequency that is none: 5 eps.
    no_square: float = 1e-15
    # Growth, as part of the fastest motion, that is round-off of eigenvalues.
    steady_growth: float = 1e-10
    # The same of a double root, such as that of a spin which nothing drives: the root of the round-off of differences.
    steady_double_growth: float = 1e-4

    # --- Sliding
    # Active sets that are kept for reuse; chosen.
    kept_active_sets: int = 64
    # Distance of the frame of a floating body from its centre of mass, in radii of gyration.
    farthest_frame: float = 10.0
    # Nodes of the path that one place of it depends on: those of a cubic interpolation.
    path_support: int = 4
    # Damping ratio of motions between switches, where none is given; chosen.
    default_damping_ratio: float = 0.1
    # Distance from the end of a path over its length that is none: nine digits.
    path_end: float = 1e-9
    # Change of the parameter of the nearest point of a path, over its length, at which the search ends: 45 eps.
    path_change: float = 1e-14
    # Cosine between a direction across a path and the path from which it is along it: 2.6 degrees.
    along_path: float = 0.999
    # Compliance along a support, over the largest entry of the tables of the path, that is none: an active set has lost
    # its rank.
    rigid_place: float = 1e-10
    # Amplitudes below this part of the largest drop out without a trace.
    quiet_amplitude: float = 1e-6


TOL = MultibodyTolerances()

NewtonTolerance = Annotated[
    float, number(f"a number between 0 and {TOL.max_newton_error:g}, such as 1e-9", gt=0, lt=TOL.max_newton_error)
]
