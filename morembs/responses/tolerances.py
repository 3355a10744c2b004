"""Tolerances, limits and block sizes of responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ResponseTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Frequencies of a response, unless a number is given.
    band_points: int = 200
    # Upper end of a band in Hz: the square of a lower one is lost beside eigenvalues of elastic modes.
    least_upper_hz: float = 1e-9
    # Multiple of the upper frequency up to which the modes of the full model are computed; bounds cover the others.
    modes_beyond: float = 1.25
    # Distance of a sample from its resonance, as a part of it: half of a half-power width at 0.1 % damping.
    least_flank: float = 1e-3
    # Distances of the samples of a resonance from it, in half-power widths: the peak and both flanks.
    flank_widths: tuple[float, ...] = (-1.0, 0.0, 1.0)
    # Relative distance from an undamped resonance that counts as none: the accuracy of computed frequencies.
    on_resonance: float = 1e-9
    # Damping over frequency, and over the largest damping, that is round-off of none.
    no_damping: float = 1e-12

    # Cells of a band before any is halved: limits hold with any number.
    first_cells: int = 32
    # Cells of a band: limits hold with any number, and sharper with more of them.
    max_cells: int = 30_000
    # Width of a cell over the upper end of the band: 45 eps, below which a midpoint is an end.
    least_cell_width: float = 1e-14
    # Numbers that a search handles in all: fewer cells where each takes more.
    max_cell_entries: int = 5_000_000_000
    # Cells that are allowed however many numbers each of them takes.
    least_max_cells: int = 300
    # Numbers that are handled at once: 16 MB.
    entries_at_once: int = 2_000_000

    # Error of the reference, as a part of the envelope of the response: far below any certificate.
    reference_error: float = 1e-9
    # Ratio of critical damping that is given to the stiffness of models without any: 1 %, a usual value of structures.
    damping_floor: float = 0.01
    # Part of the tolerance to which the reference grows: the bound is larger than the guess that ends the growth.
    growth_part: float = 0.1
    # Part of the tolerance to which the reference grows with modal damping: jumps of tables take the rest.
    modal_growth_part: float = 1e-3
    # Frequencies at which a growing space is looked at: twice as many as for its first look.
    growth_samples: int = 24
    # Error of the reference of a model with a damping matrix of its own: ten times that of others.
    damped_error: float = 1e-8
    # Degree of the Taylor series of a damped response on a cell: with the ratio below the rest is 1/4^17, 6e-11.
    taylor_degree: int = 16
    # Ratio of the terms of that series.
    taylor_ratio: float = 0.25
    # Cells on which the residual of a damped reference is bounded: each takes the inverse of a matrix of its order.
    max_damped_cells: int = 6000
    # Negative part of a damping matrix, over its largest eigenvalue, that is round-off: 4500 eps.
    negative_damping: float = 1e-12
    # Backward error of a small eigenproblem in eps of its highest value (3 to 4), over 1 - 1 / 1.25^2 = 0.36.
    small_eigen_eps: float = 10.0

    # Relative distance of equal frequencies: an eigensolver mixes modes by its error, 1e-8, over their distance.
    equal_modes: float = 1e-6

    # Eigenvalue of the scaled stiffness of an active set of static modes, over the largest, that is zero.
    active_set_rank: float = 1e-10
    # Intervals of a path of loads, and windows for each, that are kept for reuse.
    kept_intervals: int = 64

    # Columns of a reference model: dense problems of that size take seconds.
    max_order: int = 2000
    # Blocks of the second-order Krylov space before its first look: two moments of displacement and velocity.
    damped_first_blocks: int = 4
    # Rows of a damping matrix that is a set of dampers: a full factor of them is small.
    damper_rows: int = 200
    # Frequencies at which changes of the damped reference are looked for.
    change_samples: int = 100
    # Error of the damped reference that is put down to round-off where its space cannot grow.
    exhausted_error: float = 1e-8
    # Distance of shifts over the highest frequency: two nearer ones give nearly the same columns.
    shift_gap: float = 5e-3
    # Frequencies solved for before the response is looked at again: two workers share them.
    shifts_at_once: int = 2

    # Dofs up to which a model with a damping matrix is taken whole: a dense solution is faster than a space.
    dense_order: int = 400

    # Part of a mode that the Krylov space may miss: the response is quadratic in it, 1e-12.
    missed_mode: float = 1e-6

    # Elastic part of an inertia load over what a rigid motion weighs that is round-off: the root of eps.
    rigid_load: float = 1e-8

    # Rows that M couples and that are searched for motions without mass: the dofs of some nodes or a frame.
    massless_group: int = 100
    # Rows of a stiffness that is factorised within about a second, so that a check may do it.
    quickly_factorised: int = 20_000
    # Mass of a motion per stiffness, over the largest, that is none: frequencies beyond 1e6 times those that count.
    no_mass: float = 1e-12
    # Flexibility under a load, over the largest, that is round-off of a sum over all dofs.
    no_flexibility: float = 1e-10
    # Motion of an interface dof, over the largest of a massless motion, that a message names.
    named_motion: float = 0.1

    # Limit of an error over a value that is reached: 5 % is below what anybody reads from an error.
    sharpness: float = 1.05
    # Limit of a cell over a value that is reached in it: the curve of limits is right within a factor of 2.
    local_sharpness: float = 2.0
    # Part of the room between value and limit that interpolation takes where a cell is not halved any more.
    interpolation_share: float = 0.4

    # Degree of the interpolant of modal residuals: Bernstein ellipses of 1.5 give 1.5^-48 = 4e-9.
    modal_degree: int = 48
    # Steps of the grid on which the interpolant is looked at: four a degree lose 1 / cos(pi / 8), 8 %.
    modal_steps: int = 4 * modal_degree

    # Coupling of modes by damping, over their own damping, that is round-off: the error of computed modes.
    uncoupled_damping: float = 1e-8

    # Degree of the interpolant of a response on a cell: with an ellipse of 4 the error is 4^-10 = 1e-6.
    degree: int = 10
    # Steps of the grid on which an interpolant is looked at: six a degree.
    segments: int = 6 * degree
    # Part of max_grid |p - p_mid| by which p leaves its chords at most (Bernstein; Ehlich and Zeller 1964).
    bulge: float = float((degree * np.pi / segments) ** 2 / 8 / np.cos(degree * np.pi / segments / 2))
    # Frequencies at which a space is looked at first.
    first_samples: int = 12
    # Force of a damper over that of the stiffness of its dof, at the upper frequency, beyond which it
    # holds the dof: to a tenth.
    rigid_damper: float = 10.0
    # Columns of memory for the space to begin with; it doubles when they are full.
    first_order: int = 250
    # Error that jumps of a modal table may leave where the tolerance is below it; ``error`` includes it.
    jump_error: float = 1e-6
    # Part of a block that takes nothing out of it: some eps, with the root of the number of columns.
    no_change: float = 1e-14
    # Part of a block that is left and above which no round-off of its own counts: 13 digits of 16.
    large_change: float = 1e-3
    # Blocks that do not halve an error before it counts as stagnated, at least; half of all blocks otherwise.
    stagnation_blocks: int = 12
    # Error above which no stagnation is seen, as modes may still be missing.
    stagnated_error: float = 1e-2
    # Distance of a frequency beside a jump, as a part of it: the same as on a resonance.
    beside_jump: float = 1e-9

    # Distance of a frequency from a mode that a bound divides by, at least: round-off of squares.
    closest_mode: float = 1e-12
    # Part of the tolerance that modes may take that count one by one.
    single_modes_part: float = 0.1

    # Round-off of evaluating a response, as a multiple of eps times the envelope.
    evaluation_eps: float = 10.0

    # Random loads of the check of a factor: P(|v'g| < least_random_part) = 0.032 each, 1e-12 for all.
    random_loads: int = 8
    # Part of v that one of the random loads finds: 2 / sqrt(2 pi) * 0.04 = 0.032.
    least_random_part: float = 0.04
    # Residual over the round-off of its evaluation that is not refined.
    residual_over_roundoff: float = 100.0
    # Steps of refinement: what they have not reached then is round-off.
    refinement_steps: int = 6
    # Blocks that exist at once while residuals are computed, those in extended precision twice.
    block_copies: int = 12
    # Columns of a block of residuals, at most.
    block_columns: int = 16

    # Error of a reference model where none is asked for: far below any certificate.
    default_reference_error: float = 1e-8
    # Lowest sample of a band from 0 Hz, over its upper end: three decades.
    least_band_part: float = 1e-3
    # Half of a cell over the distance of its middle from the nearest pole, up to which it is worth a look; chosen.
    resolved_cell: float = 0.7
    # The same, from which on a cell of residuals is fine enough to be the last; chosen.
    final_cell: float = 0.1
    # Part of least_random_part that has to be left beside round-off for a proof; chosen.
    proven_random_part: float = 0.1


TOL = ResponseTolerances()
