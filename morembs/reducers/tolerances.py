"""Tolerances, limits and block sizes of reducers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReducerTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Error of the reference over the tolerance: a thousandth decides no limit.
    reference_part: float = 1e-3
    # Tolerance over the round-off of the model, at least: below, round-off is most of the error.
    roundoff_share: float = 3.0
    # Upper end of a band over the highest mode above which digits are lost by that: inertia is 4 times stiffness.
    far_band: float = 2.0
    # Tolerance that a message advises: an error of one half is no approximation.
    max_advised_tolerance: float = 0.5
    # Tolerance that a message advises over the least one that is kept: two printed digits round by 5 % at most.
    advised_margin: float = 1.05

    # Error of reference models: the root of eps, as Gramians hold squares.
    reference_error: float = 1e-8
    # Frequencies at which a reference is held to its error.
    reference_samples: int = 60
    # Change of the position Gramian's singular values, over the largest, when its range doubles, that is none.
    settled_gramian: float = 1e-6
    # Doublings of the range of a reference: 2^8 = 256 times the band.
    range_doublings: int = 8
    # Distance of the path of integration from undamped resonances, over the upper limit.
    axis_offset: float = 0.01
    # Cosine of the angle between test and trial spaces: below, their projection loses three digits.
    least_cosine: float = 1e-3

    # Error of a reduced stiffness between coordinates of unit stiffness: 1 % is 0.5 % of a frequency.
    stiffness_error: float = 1e-2
    # Part of the lowest elastic frequency down to which rigid motion is to be free of round-off.
    rigid_frequency: float = 0.03
    # Elastic frequencies of a plot begin at this part of the highest one: below, the root of eps, motion is rigid.
    shown_frequency: float = 1e-7
    # Frequencies of a plot: a line of a screen, about 1,000 pixels wide.
    shown_points: int = 1000
    # Order up to which a summary shows frequencies, which a dense eigensolver has to find for it.
    shown_order: int = 400

    # Component over the length of a direction that has no sign.
    no_component: float = 1e-6
    # Step along a path over the usual one that is none: coordinates with nine digits.
    same_place: float = 1e-9
    # Step along a path over its neighbours that is a gap, not an uneven mesh.
    path_gap: float = 3.5
    # Distance in steps within which points are neighbors: less than the diagonal, 2^(1/2).
    neighbor_steps: float = 1.2

    # Columns of a Lanczos space for each mode, as seen for 100 to 800 modes of solid bodies.
    columns_per_mode: float = 2.4
    # Blocks of a Lanczos space on top of these.
    extra_blocks: int = 10
    # Operations of the small eigenproblem of each step over k^3, by rates seen on solid bodies.
    small_flops: float = 2.5
    # Operations over n^3 where LAPACK finds all modes, as measured.
    dense_flops: float = 15.0
    # Speed of LAPACK's eigensolver over that of a product, as measured.
    dense_efficiency: float = 0.4
    # Speed of triangular solves over that of a product, as measured.
    solve_efficiency: float = 0.2
    # Columns of the reference model for each input, as measured.
    columns_per_input: int = 5
    # Operations of the reference model over p^3, as measured.
    reference_flops: float = 1e5
    # Reference models that a comparison costs in all.
    compared_references: float = 2.0
    # Blocks of a certified reference over the squared digits of its error times n^(1/3): 22, 33 and 53 blocks ended the
    # growth to 1e-13 of a rod, a cube and a crankshaft of 6,000, 20,000 and 60,000 dofs.
    reference_blocks: float = 1 / 139
    # Times that the bound of a certified reference is looked at, as seen for these.
    bounded_references: int = 4
    # Seconds of Python in the search of "auto" on a machine of the usual speed, beside these operations, of that rod.
    auto_seconds: float = 1.2
    # Seconds of one bound of a parametric body on such a machine: 5.2 s for 2,858 of a bracket of 2,800 dofs.
    bound_seconds: float = 1.6e-3

    # Rows up to which a dense Lyapunov equation takes seconds, where modes are so lightly damped that ADI takes a shift
    # for each.
    dense_gramian_rows: int = 600
    # Direction over the leading one that is round-off: 450 eps.
    direction_noise: float = 1e-13
    # Columns that a greedy search adds.
    greedy_steps: int = 40
    # Worst frequencies that join the samples before columns are added one by one.
    exchanges: int = 5
    # Columns of no basis: larger than any.
    no_order: int = 1_000_000
    # Response over its envelope that is a zero.
    zero_response: float = 1e-3
    # Distance of a shift from a resonance, as a part of it, that hits it.
    on_resonance: float = 1e-6
    # Powers of |H| that weigh responses: relative errors ask for -1, resonances lose by it.
    response_weights: tuple[float, ...] = (-0.5, 0.0, -1.0)
    # Distance of a pole from the band, over its upper end, that counts as inside.
    inside_band: float = 1e-3
    # Response over its static part that holds no dynamics.
    static_response: float = 1e-6
    # Gauss points over the whole band where each is a full factorization.
    direct_points: int = 12
    # Error of the states of a Gramian; the response is quadratic in it.
    state_error: float = 1e-11
    # Frequencies at which states are held to that error.
    state_samples: int = 40

    # Interface dofs up to which all constraint modes are computed.
    dense_interface: int = 400
    # Interface dofs over wanted modes up to which all constraint modes are computed: a quarter.
    dense_part: int = 4
    # Interface dofs up to which the body is held by solving for each, not by leaving rows out.
    solved_rows: int = 100
    # Scaled condition of the rigid motions on rows that do not hold the body: six digits are lost.
    loose_condition: float = 1e6
    # Columns of a Krylov block.
    block_columns: int = 12
    # Frequencies of the error measure, beside those at poles.
    measured_samples: int = 300
    # Damping ratio below which a mode has no H2 norm to speak of.
    light_damping: float = 1e-6
    # Shift of s to the right for such modes, over the upper frequency: half a percent of damping.
    light_offset: float = 5e-3
    # Damping ratio of the shifts to begin with: the usual one of structures.
    first_shift_ratio: float = 0.02
    # Steps of the inner iteration on the reference model.
    inner_steps: int = 30
    # Change of the shifts that ends the inner iteration: the H2 error is quadratic in it.
    inner_tolerance: float = 1e-7

    # Multiple of the upper frequency up to which damping of modes is looked at.
    modes_beyond: float = 1.2
    # Columns of a Krylov basis: more are a mistake in shifts or moments.
    max_columns: int = 500
    # Part of a load beside the columns so far that needs no direction; energies hold its square, 1e-14.
    carried_load: float = 1e-7
    # Cosine between spaces of inputs and outputs that cannot be paired: six digits are lost.
    paired_cosine: float = 1e-6

    # Real part over the size of a pole that is unstable: the root of eps.
    unstable_growth: float = 1e-8

    # Difference of a symmetric matrix from its transpose, over the largest entry, that is round-off.
    asymmetry: float = 1e-12

    # Singular value over the largest that is round-off: 45 eps.
    singular_noise: float = 1e-14
    # Nodes of the quadrature that are handled at once.
    nodes_at_once: int = 256

    # Distance of lambda from omega^2, over omega^2, at which all but its mode drowns.
    on_eigenvalue: float = 1e-6
    # Part of a load that deforms the body that is round-off of a sum over all dofs.
    rigid_load: float = 1e-10
    # Ratio by which a shift on an eigenvalue moves: 0.5 %, far beyond ``on_eigenvalue``.
    shift_move: float = 1.005
    # Times that a shift moves before it is refused.
    shift_moves: int = 3

    # Static mode over the largest static answer that is round-off.
    empty_mode: float = 1e-12
    # Columns that are solved for at a time.
    columns_at_once: int = 128

    # Tolerance of a Gramian, at least: the square, 1e-20, is what singular values below have in it.
    finest_tolerance: float = 1e-10


TOL = ReducerTolerances()
