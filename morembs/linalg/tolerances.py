"""Tolerances, limits and block sizes of the linear algebra; those of sparse solvers are in ``linalg.sparse``."""

from __future__ import annotations

from dataclasses import dataclass

from morembs.linalg.sparse.tolerances import TOL as SPARSE


@dataclass(frozen=True, kw_only=True)
class LinalgTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Unit round-off of double precision, eps.
    roundoff: float = SPARSE.roundoff

    # --- Columns
    # Norm that a column keeps after orthogonalisation, as a part of it, below which it depends on others: five
    # digits are left of its direction.
    dependent_column: float = 1e-10
    # Eigenvalue of a Gram matrix of unit columns over the largest that is round-off: 45 eps.
    gram_noise: float = 1e-14
    # Error of orthonormal columns in their Gram matrix, for each column, that is round-off: 45 eps.
    orthonormality: float = 1e-14
    # Entry of a vector over its largest one that is as large: entries that symmetry makes equal differ by their error.
    large_entry: float = 0.99
    # Rows of an array in memory that are read at once across all columns: 64 kB of each column.
    product_rows: int = 1 << 13
    # Entries of a sparse matrix that are handled at once: each array of temporaries takes 8 MB.
    entries_at_once: int = 1 << 20

    # --- Real modes
    # Rows up to which LAPACK finds all modes faster than block Lanczos finds some; a dense matrix of 18 MB. The
    # same decides for groups of rows where motions without energy are looked for.
    dense_rows: int = 1500
    # Operations of LAPACK for all modes, over the cube of the rows, at the rate of products: 0.4 ns, measured with
    # 3,000 and 6,591 rows.
    dense_operations: float = 11.0
    # Operations of a sparse mode where matrices are small, at the same rate: 4 ms, measured with 3,000 rows.
    mode_operations: float = 1.1e8
    # Dense matrices that exist at once: measured.
    dense_matrices: int = 9
    # Rows of a small model, of which any number of modes may be wanted: not more than a body may have.
    small_rows: int = 6000
    # Eigenvalue over the highest one below which LAPACK loses digits: its error is eps of the highest, which leaves
    # ten digits here.
    soft_eigenvalue: float = 1e-6
    # Negative eigenvalue of a mass matrix of unit diagonal that is round-off: the root of eps.
    negative_mass: float = 1e-8
    # Frequency that motions without mass are given over the others: with its square 1e-8 their inertia, digits of the
    # slow ones are left.
    far_above: float = 1e4
    # Eigenvalue of the stiffness of motions without mass, of unit diagonal, that is none: 4500 eps.
    loose_motion: float = 1e-12
    # Residual of Ritz values over their size at which they are taken: vectors have nine digits, values more.
    ritz_residual: float = 1e-9
    # Distance of neighbouring eigenvalues over their size below which they are one cluster, in which a Sturm count has
    # no shift: a thousand times their error.
    eigenvalue_gap: float = 1e-6
    # Modes of a large model above which the limit is a mistake, no reduction: a dense body of 32 MB a matrix.
    most_modes: int = 2000
    # Times that modes which the count finds missing are looked for. Not measured: each adds those that are missing.
    count_attempts: int = 4
    # Modes of a slice by default where nothing is known of the factor.
    slice_modes: int = 120
    # Operations for each row and squared number of modes of a slice, in which its factorisation is worth as much:
    # orthogonalisation of its space and of the modes that it locks.
    slice_operations: float = 30.0
    # Modes of a slice at least: with fewer, the analysis of its matrix and small matrices weigh more than what is
    # modelled.
    least_slice_modes: int = 80
    # Modes of a slice at most: with more, its space takes more memory than the modes of most jobs.
    most_slice_modes: int = 240
    # Part of the modes at shift zero that are kept: the last few have residuals a hundred times those of others.
    known_part: float = 0.9
    # Columns of the Krylov space of a slice over its modes.
    space_of_slice: int = 2
    # Known modes that are locked out of the space of a slice, over its modes: those as near as what is looked for.
    locked_slices: float = 1.0
    # Part of the modes of a slice that are to lie below its shift. Not measured: a little more than half, as those
    # above it are taken only where they converge.
    slice_part_below: float = 0.55
    # Slice parts below the shift that one last slice takes at once rather than two of them.
    last_slice: float = 1.5
    # Modes that its shift aims at, over those that are missing: the estimate is off by some percent.
    beyond_last: float = 1.1
    # The same beside them: few modes have no mean distance.
    beyond_columns: int = 3
    # Part of a Krylov space that modes below a shift may need before it is enlarged. Not measured: 30 % is left for
    # its growth.
    needed_part: float = 0.7
    # Slices that are worth their factors: one space of x slices costs 21 x^2 where slices cost 60 x less 30.
    least_slices: float = 2.5
    # Columns of a Krylov space in which a mode converges: measured with blocks of 8 to 48 columns, 50 and 300 modes of
    # a cube.
    columns_per_mode: float = 2.5
    # Blocks beyond these: from the same.
    last_blocks: float = 9.0
    # Columns of a block that are solved for in the time that a pass over the factor takes beside them.
    solve_overhead_columns: float = 10.0
    # Columns of a block to choose from.
    block_widths: tuple[int, ...] = (4, 8, 12, 16, 24, 32)
    # Modes up to which shift zero is enough: a factor that is kept and checked for a second shift would not pay.
    one_factor_modes: int = 20
    # Rows up to which one thread of the BLAS finds modes. 6,591 rows and 400 modes take 3.9 processor seconds on one
    # thread, 12.5 to 17 on two beside other work, and five times as long; above, two threads save a quarter.
    one_thread_rows: int = 20_000
    # Columns of a Krylov block with a factor on disk, where a pass takes as long as their arithmetic.
    wide_block: int = 32
    # Columns of such a block where there are as many modes: no wider.
    widest_block: int = 64
    # Blocks that exist at once while one is solved for: loads, displacements, and one of the solver.
    single_copies: int = 3
    # Columns of such a block at least.
    least_wide_block: int = 8
    # Blocks that exist at once while a block is solved for and made orthonormal: the residual, its columns before and
    # after they are made orthonormal, M times these, and two of the solver. The peak of a crankshaft of 104,000 dofs in
    # 450 MB is the same with 8, and 34 MB more with 5.
    block_copies: int = 6

    # --- Block Lanczos
    # Steps before the iteration is given up. Not measured: 3200 columns and more, as blocks have eight at least.
    lanczos_steps: int = 400
    # Growth of the space between two looks at its Ritz values, whose small eigenproblem costs more than the growth.
    ritz_growth: float = 1.05
    # Part along the space over the norm of a column that one more pass would not make smaller: the root of eps.
    repeated_part: float = 1e-8
    # Passes of orthogonalisation at most: two are enough (Parlett 1980) unless the
    # first leaves next to nothing.
    lanczos_passes: int = 3
    # Residual of Ritz values between which the second shift is put: their error is about its square, 0.1 %.
    rough_residual: float = 0.03
    # Residual of Ritz values that gain nothing more at the second shift: 450 eps.
    settled_residual: float = 1e-13
    # Part of the residual that is allowed at the second shift, where an error weighs more than at zero. Not measured.
    shifted_residual_part: float = 0.1
    # Multiple of a factor that the machine has memory for where two are kept: another one, its workspace, all else.
    factor_room: int = 6
    # Times that the space is doubled before a mode that the count finds is given up. Not measured: four times as wide.
    space_doublings: int = 2

    # --- Complex modes
    # |K^-1 r| over |x| in M at which a mode is taken; its eigenvalue is off by the square of that without damping.
    complex_residual: float = 1e-8
    # The same where round-off of stiff parts allows no more; its square is 1e-10.
    stalled_complex_residual: float = 1e-5
    # Steps without halving the residual after which it is stalled. Not measured.
    stalled_complex_steps: int = 3
    # Modes that are followed beyond those that are wanted, so that a gap behind these is seen.
    complex_modes_beyond: int = 4
    # Columns of the space for each mode at which it is begun anew: five complex vectors of each.
    complex_columns_per_mode: int = 10
    # Steps before the iteration is given up. Not measured: it is stalled long before where it does not converge.
    complex_steps: int = 60
    # Imaginary part of an eigenvalue over its size that is zero: the mode does not oscillate. Not measured:
    # 5e6 eps, far above the error of LAPACK.
    real_eigenvalue: float = 1e-9
    # Relative distance of frequencies that are one cluster, which no count divides: as that of eigenvalues.
    frequency_gap: float = eigenvalue_gap
    # Times that modes which the count finds missing are looked for. Not measured: each adds twice as many
    # columns as are missing.
    complex_attempts: int = 3

    # --- Krylov spaces and Gramians
    # Passes of orthonormalisation: blocks may have directions far below their others, and each pass sees seven
    # digits, the root of ``gram_noise``.
    krylov_passes: int = 3
    # Singular value of snapshots over the largest that is round-off; a Gramian has its square, 1e-24.
    dropped_snapshot: float = 1e-12
    # Passes in which the columns that an earlier pass took for dependent are scaled up and tried again. Not measured:
    # one sees seven digits, and twelve are kept.
    snapshot_passes: int = 4
    # Direction of a factor Z over the largest that is dropped: its square, 1e-20, is nothing in the Gramian Z Z'.
    dropped_direction: float = 1e-10
    # Residual of a Lyapunov equation over its loads, in static compliance: ten digits of a Gramian are five of a state.
    adi_residual: float = 1e-10
    # Shifts before the iteration is given up: lightly damped modes take about one each.
    adi_steps: int = 300
    # Shifts that are used before the residual is projected again. Not measured.
    adi_shifts_at_once: int = 3
    # Columns of the latest solutions that it is projected on: a lightly damped mode is hit only once its Ritz value is
    # accurate to the width of its resonance.
    adi_recent_columns: int = 96
    # Squared part of the residual that a further shift is to act on, over the tolerance: less gains nothing.
    adi_share: float = 0.1
    # Imaginary part of a shift over its size that is none: the root of eps.
    real_shift: float = 1e-8
    # Real part of a pole over its size of a mode that is not damped. Not measured: 5e6 eps.
    undamped_mode: float = 1e-9
    # Columns of Z that there is room for at first; it doubles where it is full.
    adi_first_columns: int = 256
    # Rows of Z that are handled at once: 67 MB of 256 columns.
    adi_rows: int = 1 << 15

    # --- Integrals
    # Gauss points for each unit of asinh.
    points_per_asinh: int = 4
    # Gauss points to begin with: with those above, the error beside a pole is 1e-10.
    first_points: int = 8
    # Half width of a pole outside the band over its distance, at least: a smaller one changes the map by its square.
    least_pole_width: float = 1e-3

    # --- Motions without energy
    # Eigenvalue of a matrix of unit diagonal over its rows that is round-off of zero: LAPACK's error is a small
    # multiple of eps for each row.
    zero_eigenvalue: float = 8 * roundoff
    # Shift of groups beyond LAPACK: far above round-off, far below eigenvalues of motions that have energy.
    null_space_shift: float = 1e-9
    # Steps of subspace iteration, each of which damps these by shift / eigenvalue: 1e-12 for a thousand shifts.
    null_space_steps: int = 4
    # Columns that it begins with: six rigid motions and two more.
    null_space_columns: int = 8

    # --- Rigid motions that a stiffness leaves free
    # Force over what cancels in its row that is round-off: assembled bodies reach 3 eps.
    strain_roundoff: float = 16 * roundoff
    # Force over the level of round-off from which it is a support.
    clear_support: float = 4.0
    # Entry over its own terms that is round-off of zero, which assembled bodies reach.
    cancelled_force: float = 3 * roundoff
    # Force over what cancels that numbers of few digits, and coordinates of few digits, leave at most: six digits.
    few_digits: float = 1e-6
    # Nodes at which a soft ground does positive work less those of negative work, over all, at least.
    coherent_nodes: float = 0.5
    # Force over the usual residual of few digits up to which all forces are such residuals.
    usual_residual: float = 30.0
    # The same where they do work of either sign.
    largest_residual: float = 10 * usual_residual
    # Digits that decimal numbers are looked for with: in more than 14 most numbers are decimal by chance.
    decimal_digits: tuple[int, ...] = (12, 13, 14)
    # Part of the entries that have no more digits, at least: one of a hundred may be computed.
    decimal_share: float = 0.99
    # Part of the entries that have no fewer, at least: nine of ten random numbers do not end in zero.
    full_decimal_share: float = 0.5
    # Entries that are looked at: a sample of them, 32 kB.
    decimal_samples: int = 4096
    # Different entries that there must be. Not measured: fewer may be round by chance.
    least_decimals: int = 4
    # Part of a held motion that round-off may mix into a free one: five digits are left.
    mixed_motion: float = 1e-5

    # --- Statics
    # Error of unit interface displacements that is refused: six digits are left.
    imposed_error: float = 1e-6
    # The same before any refinement, beyond which the condensed stiffness has lost too much.
    first_imposed_error: float = 1e-5
    # The same that is not refined any more.
    exact_imposed_error: float = 1e-9
    # Steps of refinement. Not measured: the count of the first look and three corrections.
    refinement_steps: int = 4
    # Part of the energy of a soft motion that the condensed stiffness may miss: half of that in a frequency.
    lost_energy: float = 1e-5
    # Part of it that is not refined even once.
    sure_energy: float = 1e-8
    # Energy of an interface motion, over the usual one for its flexibility, that is round-off of a rigid motion.
    rigid_energy: float = 1e-12
    # Part of a rigid motion that is round-off at the interfaces: 450 eps.
    unseen_motion: float = 1e-13
    # Eigenvalue of the scaled constraints over the largest of constraints that depend on each other: 450 eps.
    dependent_constraint: float = 1e-13
    # Size of an interface motion by its flexibility, over that by its rigid part, below which it is a support. Not
    # measured: the square of it in energy, 1e-8, is the root of eps.
    support_flexibility: float = 1e-4
    # Columns of the model's length beside a Sturm count: the blocks of the eigensolver that wait.
    count_columns: int = 50
    # Bytes for buffers of the libraries beside a Sturm count: those beside a factor.
    count_bytes: int = SPARSE.bytes_beside_factor
    # Parts by which a shift is moved off an eigenvalue, one after the other: far above round-off, up to the
    # width of a cluster.
    shift_nudges: tuple[float, ...] = (0.0, 1e-8, 1e-7, 1e-6)


TOL = LinalgTolerances()
