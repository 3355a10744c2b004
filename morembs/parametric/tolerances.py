"""Tolerances, limits and block sizes of parametric bodies."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ParametricTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Distance over the size of a model that is none: coordinates with nine digits.
    same_place: float = 1e-9
    # Nodes of an average interface whose term is a full block on them: 1000 give 72 MB.
    max_patch_nodes: int = 1000

    # Multiple of the upper frequency up to which modes are deflated at the anchor.
    deflated_up_to: float = 1.75
    # Multiple of the upper frequency up to which modes at other p are taken.
    taken_up_to: float = 1.5
    # Multiple of the softest body's frequencies up to which modes are deflated in wide boxes, as for one body.
    softest_up_to: float = 1.25
    # Multiple of the upper frequency that deflation in wide boxes does not pass: 5 is 25 times in stiffness.
    max_deflated_up_to: float = 5.0
    # Multiple of the upper frequency up to which modes of the softest bodies join the basis.
    corner_modes_up_to: float = 2.0
    # Part of such modes beside the basis that is a direction of its own; energies hold its square, 1e-12.
    new_direction: float = 1e-6
    # Blocks of the Krylov space of the loads that are taken beside the modes, one more when p comes again.
    load_blocks: int = 2
    # Weight of deflated loads, in eigenvalues at the limit of the deflated modes.
    deflation_weight: float = 2.0
    # Residual of modes at other p: they are columns of a basis only.
    mode_residual: float = 1e-5
    # Blocks of the Krylov space of modes at other p.
    mode_steps: int = 30
    # Values of p whose motions are decomposed for the basis.
    snapshots: int = 96
    # Full models that a search may take.
    max_full_points: int = 40
    # Steps in a row that bring too little before a search ends.
    stalled_steps: int = 2
    # Ratio of bounds from step to step that is too little: 5 %.
    least_progress: float = 0.95
    # Part of the anchor's stiffness left on a cell below which springs that hold the body leave the norm.
    least_stiffness_left: float = 0.05
    # Fresh values of p for the bound over the box, per value of training.
    fresh_per_training: int = 4

    # Multiple of the upper frequency up to which Ritz vectors are low modes of the bound.
    low_modes_up_to: float = 1.5
    # Multiples of the upper frequency that are tried one after the other for the other Ritz vectors: powers of 4.
    shift_ladder: tuple[float, ...] = (4.0, 16.0, 64.0)
    # Least eigenvalue of the rest over the squared upper frequency that is enough: 10 % above resonance.
    least_gap: float = 1.1
    # Part of b that the residuals of all other Ritz vectors take together.
    truncation_share: float = 0.05
    # Part of its energy that a column may lose by compression.
    compression_loss: float = 1e-5
    # Energy over the largest below which a column counts as rigid.
    rigid_energy: float = 1e-6
    # Least singular value of rigid motions on springs that low Ritz vectors have to have.
    spring_hold: float = 1e-6
    # Frequency of a body on its springs, over the upper one, below which they are soft.
    soft_spring: float = 0.1

    # Part of the corner value that a proof has to give: splitting further gains at most 1 / 0.9.
    proven_share: float = 0.9
    # Cells of a box: each has bounds and norms of its own.
    max_cells: int = 8
    # Cells of a box on which nothing is proven: splitting twice as deep.
    max_unproven_cells: int = max_cells**2
    # Values of each morph on a cell without a proof: ends, middle and quarters.
    morph_samples: int = 5
    # Part of the least estimate that is taken without a proof: the same 10 % as in a proof.
    sampled_share: float = 0.9

    # Part of a column beside the others that is left out and counts by its norm; energies hold its square, 1e-12.
    dependent_column: float = 1e-6

    # Relative distance of frequencies whose modes are one cluster.
    mode_cluster_gap: float = 1e-6
    # Part of a rigid motion that a basis may miss: the root of eps.
    missed_rigid: float = 1e-8
    # Values of a table that are computed at once.
    table_rows: int = 256

    # Coefficients of det J in each parameter: it is a cubic.
    det_coefficients: int = 4
    # Points of the interpolation of 1 / det J: fewer are constant.
    least_points: int = 2
    # Points of the interpolation of 1 / det J: each is a term of K.
    most_points: int = 16
    # Values of a parameter, per point, at which the interpolation error is looked at.
    samples_per_point: int = 8
    # Morphs of one region: terms of K are products of theirs.
    max_morphs: int = 2
    # Cells of a range on which the coefficients of det J are not positive everywhere.
    det_cells: int = 32
    # Volume over the nominal one that is none.
    flat_volume: float = 1e-10

    # Parameters of a box whose corners join the training set: 2^6 = 64.
    max_corner_parameters: int = 6
    # Frequencies over the band at each p, beside the flanks of its resonances.
    band_samples: int = 16

    # Split of round-off of sums over N rows: up to this part of eps x'Dx, the rest by x'Ax.
    roundoff_split: float = 4.0
    # Energy over that of the largest load below which a load does not move the body.
    still_load: float = 1e-8
    # Part of the stiffness of springs against rigid motion that may be round-off: five digits are left.
    lost_hold: float = 1e-5

    # Standard deviation of a measured frequency without one, as a part of it: usual in modal tests.
    measured_deviation: float = 0.01
    # Singular value over the largest below which data tell nothing of a direction.
    told_direction: float = 1e-3
    # Part of a parameter in an untold direction by which it is untold as well, and named.
    named_part: float = 0.05
    # Distance from the end of a range, as a part of it, that is none.
    at_end: float = 1e-6
    # Modes above the highest measured one that may come down past it.
    modes_beyond: int = 6

    # Part of a body's tolerance that the stiffness of a morph may take; it counts many times at a resonance.
    stiffness_share: float = 0.01
    # Part of a body's tolerance that the stiffness of one morph takes where its terms allow: a point costs one term.
    wanted_share: float = 2e-5

    # Relative error of ratios of volumes: 5000 eps.
    ratio_error: float = 1e-12
    # Values of the morphs at which the extremes of volumes are kept: 256 steps.
    volume_samples: int = 257
    # Points that are sampled at once.
    volumes_at_once: int = 4096

    # Tolerance of bodies where none is given: 0.1 % of the envelope.
    default_tolerance: float = 1e-3
    # Relative residual of the least eigenvalue on a cell, which is an estimate.
    least_ratio_residual: float = 1e-3
    # Distance of a sample from its resonance, as a part of it, at least: that of responses.
    least_flank: float = 1e-3
    # Relative change of parameters, of the sum of squares and of its slope at which a fit ends: ten digits.
    fit_change: float = 1e-10


TOL = ParametricTolerances()
