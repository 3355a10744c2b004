"""Tolerances and limits of nonlinear components and of mechanisms of members."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NonlinearTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Divisor of quotients that may be 0 / 0: nothing physical is as small.
    tiny: float = 1e-300
    # Part of a way of loads that is left and no step of its own.
    negligible_step: float = 1e-9

    # Last step of Newton's method over the size, where none is given: ten digits.
    newton_step: float = 1e-10
    # Steps of it before a load step counts as failed; chosen.
    newton_iterations: int = 15
    # Load step over the wanted one below which loads are not followed any more: ten halvings.
    least_load_step: float = 1 / 2**10
    # Growth of a load step after one that was taken; chosen: as much as a halving takes.
    load_step_growth: float = 2.0
    # Last step over the size below which a step that does not fall any more is round-off.
    stalled_step: float = 1e-7
    # Ratio of two steps of Newton's method from which they do not fall any more, so close to the end.
    stalled_ratio: float = 0.1

    # Last step of Newton's method with full tangents over the size, or in rad, where none is given: twelve digits.
    static_step: float = 1e-12
    # Steps of it before a load step counts as failed; chosen.
    static_iterations: int = 30
    # Load step over the wanted one below which loads are not followed any more: four divisions by four.
    least_static_load_step: float = 1 / 4**4

    # Step in rad and m of one-sided differences, near the square root of round-off.
    forward_step: float = 1e-6
    # Motion in m or rad at t = 0 that is none.
    motion_at_start: float = 1e-12
    # Its rate in m/s or rad/s that is none, by a difference over 1e-6 s.
    rate_at_start: float = 1e-6
    # Distance of two points from the length of their member, as a part of it, that is none: six digits.
    length_mismatch: float = 1e-6
    # Angle in rad from the direction of a member that is none: six digits.
    angle_mismatch: float = 1e-6
    # Distance of the ends of a component from the x axis, over its length, that is none: coordinates with nine digits.
    off_axis: float = 1e-9

    # Spectral radius at infinite frequency, where none is given; chosen: high modes lose a tenth in a step.
    default_rho: float = 0.9
    # Largest last change of a node in a step, where none is given, in m and rad per unit of size.
    node_change: float = 1e-9
    # Size in m of the shortest member that this is taken of, at least.
    least_size: float = 1e-3
    # Iterations of a step in time before it counts as failed; chosen.
    step_iterations: int = 25
    # Ratio of two changes from which the factor is made anew; chosen.
    slow_ratio: float = 0.1
    # Static answer of the modes left out, per length, from which a result says so: 0.5 %.
    neglected_answer: float = 5e-3
    # In s, half the span of the central difference that gives the rate of a prescribed motion.
    motion_rate_step: float = 1e-6
    # Part of a step: distance of the places whose differences give the accelerations at the start; chosen.
    start_part: float = 0.1
    # Entries of J up to which matrices are dense, where nothing else is given; chosen.
    dense_entries: int = 40_000
    # Part of the tables' range that the division advised for a member aims at.
    wanted_table_part: float = 0.75

    # Square of an angle in rad up to which coefficients of rotation vectors are sums of their series: beyond
    # 2 rad quotients keep their digits.
    series_square: float = 4.0
    # Terms of these sums beside the first: the last one is 4^16 / 34! = 1e-29.
    series_terms: int = 16
    # Half of the turn of an element in rad below which x / sin x and its derivatives are series.
    screw_series_angle: float = 0.05

    # Chord of an element across its direction, over the longest element: 12 degrees.
    max_chord_across: float = 0.2
    # Chord of an element along its direction, over its length: 37 degrees.
    least_chord_along: float = 0.8
    # Distance of the ends of a line over its size that is none: they meet.
    meeting_ends: float = 1e-6
    # Distance of two points of a line over its size that is none: they are one.
    same_point: float = 1e-9
    # Entry of R'R - 1 of the frames of a beam that is none: eight digits.
    frame_error: float = 1e-8


TOL = NonlinearTolerances()
