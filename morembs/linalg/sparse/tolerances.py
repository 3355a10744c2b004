"""Tolerances, limits and sizes of the sparse solvers. Each line says where its number comes from.

It is read before NumPy is imported (see ``threads``), so it imports nothing but the machine's numbers.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SolverTolerances:
    """Quantities by which factors and solutions are judged, and sizes that were measured to serve best.

    Errors are relative; a backward error is ||b - A x|| / (||A|| ||x|| + ||b||).
    """

    # Unit round-off of double precision, eps.
    roundoff: float = sys.float_info.epsilon

    # --- Factors
    # Backward error of a trial solution above which a factor is refused: stable factors reach 1e-15, and ten digits
    # leave four to a result whose condition is 1e6. SuperLU chooses pivots where it is worse without a choice.
    backward_error: float = 1e-10
    # Backward error above which UMFPACK and PARDISO correct a column: one step of refinement makes a stable factor
    # accurate to a small multiple of eps (Skeel 1980).
    refined_error: float = 1e-14
    # Condition of D A D above which a matrix is singular: a solution of that refined error has no digit left. Inverse
    # iteration from a random start sees 1/eps for a singular matrix; the finest slender meshes stay below 1e12.
    singular_condition: float = 1.0 / refined_error
    # Starting vectors of the one step that checks a factor on disk, as every step reads it all.
    check_vectors_on_disk: int = 4
    # Difference of the two triangles that is still round-off of an assembly: some 1e6 sums of eps each.
    asymmetry: float = 1e-9
    # PARDISO: pivots below 10^-20 of the largest value count as zero. Small ones stay, as the check of the factor
    # judges them by the scale of their rows.
    zero_pivot_digits: int = 20
    # PARDISO: steps of refinement. Beside an eigenvalue each gains a factor of twenty.
    refinement_steps: int = 5
    # MUMPS: room for delayed pivots in per cent, the default of its manual.
    delayed_pivots_percent: int = 20
    # The same for a definite matrix, which delays none.
    delayed_pivots_percent_spd: int = 5
    # MUMPS: numerical phases, with twice the room each time it was too small.
    factorisation_attempts: int = 4

    # --- Right-hand sides that are solved at once
    # Wider blocks gain nothing more for factors in memory, and have twice the temporaries.
    block_columns: int = 64
    # Supernodal factors (CHOLMOD, PARDISO): 16 columns cost twice the time of each, 64 are close to 128.
    supernodal_columns: int = 2 * block_columns
    # CHOLMOD: fewer columns are not worth a thread, which reads the whole factor for them.
    columns_per_thread: int = 8

    # --- Forecasts
    # SuperLU: entries of L and U are this times n^(4/3) (George 1973), as measured for compact bodies with METIS.
    superlu_fill: float = 48.0
    # UMFPACK: bytes kept, and bytes at the peak, for each byte of the entries of L and U; measured on solid bodies.
    umfpack_kept: float = 1.04
    # Bytes at the peak for each of them, measured likewise.
    umfpack_peak: float = 1.85
    # Automatic choice: the factor of the chosen solver against the forecast of MUMPS, and a Sturm count against a
    # factor on disk.
    factor_margin: float = 1.25
    # The cost of a Sturm count against that of a factor on disk, likewise.
    count_margin: float = 1.1
    # Automatic choice: columns of length n beside a factor in memory while it solves, and bytes for library buffers.
    columns_beside_factor: int = 60
    # Bytes of the buffers of a library beside its factor.
    bytes_beside_factor: int = 60_000_000

    # --- Conjugate gradients
    # Error that a column is solved to, and the backward error that multigrid promises.
    iteration_accuracy: float = 1e-12
    # Residual that is round-off of its own computation: two units.
    iteration_roundoff: float = 2 * roundoff
    # Backward error up to which a stalled column is a solution: a tenth of the promised one.
    stalled_error: float = iteration_accuracy / 10
    # Steps without halving the residual after which a column is stalled: residuals rise and rest for a while where the
    # iteration works on the lowest modes.
    stalled_steps: int = 50
    # The true residual may lie this far above that of the recurrence.
    residual_drift: float = 2.0
    # Eigenvalue of a Gram matrix of normed columns below which a direction depends on others: its round-off is eps for
    # each column of a block, with a margin of eight.
    dependent_direction: float = 8 * block_columns * roundoff
    # Steps before the iteration is given up.
    iteration_steps: int = 200
    # The same with a rough factor, where more steps cost more than a double factor.
    iteration_steps_rough: int = 30

    # --- Multigrid: measured with ten-node tetrahedra, 6e3 to 1e5 rows
    # Share of their diagonal blocks above which two nodes couple strongly; 0.05 to 0.1 take the fewest steps, 0.15
    # twice as many.
    strong_coupling: float = 0.06
    # Steps that minimise the energy of the prolongations (Olson, Schroder and Tuminaro 2011).
    prolongation_steps: int = 4
    # Rows of the coarsest level, a dense matrix.
    coarsest_rows: int = 900
    # Rows of a coarsest level that says that the setup has failed: four times what was aimed at.
    failed_coarsest_rows: int = 4 * coarsest_rows
    # Levels: each has a tenth of the rows of the one before at most, so twelve are never reached.
    levels: int = 12
    # Rows of a node: its translations.
    node_rows: int = 3
    # Motions of an aggregate: the rigid-body modes.
    aggregate_motions: int = 6
    # Degree of the Chebyshev smoother.
    smoother_degree: int = 3
    # Part of the spectrum that the smoother damps: from its top / 20 upwards.
    smoothed_part: float = 20.0
    # Steps of power iteration for the top of the spectrum.
    power_steps: int = 15
    # Margin on what the power iteration finds (Adams et al. 2003).
    spectrum_margin: float = 1.15
    # Bytes for each entry of the matrix, for each row, and beside: at the peak of the setup, and kept.
    multigrid_peak: tuple[float, float, float] = (48.0, 200.0, 5e6)
    # The same bytes, kept after the setup.
    multigrid_kept: tuple[float, float, float] = (20.0, 300.0, 0.0)
    # Entries of the hierarchy for each entry of the matrix.
    multigrid_entries: float = 1.7
    # Operations of the setup for each entry of the matrix.
    multigrid_flops: float = 300.0
    # Bytes for each row and column while a block is solved: five arrays of double precision, and their temporaries.
    multigrid_solve_bytes: int = 80

    # --- Pieces: temporaries stay small beside the matrix
    matrix_rows: int = 1 << 15
    # Rows of a product with a block of columns at once.
    product_rows: int = 1 << 13
    # Entries of a graph that are handled at once.
    graph_entries: int = 1 << 20
    # METIS is not meant for graphs of fewer vertices, and any order is good there.
    smallest_graph: int = 50
    # Difference of two sums of random keys that is round-off: 1e6 sums of eps.
    same_key_sum: float = 1e-10

    # --- Libraries and processes, in bytes and seconds
    # A library that is newer than its header writes beyond the structure while it is tested, by less than this.
    padding_bytes: int = 1 << 16
    # Between news of a long call, and between looks whether mpirun still runs.
    news_seconds: float = 0.5
    # mpirun and its ranks may take so long to leave.
    leaving_seconds: float = 10.0
    # Ranks ask for commands so often, at first and later: MPI itself would wait with a whole processor.
    shortest_poll_seconds: float = 2e-4
    # The longest pause of a rank between two looks for commands.
    longest_poll_seconds: float = 5e-3
    # Speed of the machine: order of the dense product, bytes of the long arrays (beyond every cache), time for each.
    speed_order: int = 1000
    # Bytes of the long arrays whose speed is measured: beyond every cache.
    speed_bytes: int = 1 << 26
    # Rounds of a loop of Python whose speed is measured: 10 ms.
    speed_rounds: int = 100_000
    # Keys of the dictionary in that loop: it stays in the cache of a core.
    speed_keys: int = 1024
    # Speed of that loop on the machines where the times of stages were measured, in 10^6 rounds per second.
    usual_python_mhz: float = 11.0
    # Seconds that each of these measurements takes.
    speed_seconds: float = 0.2


TOL = SolverTolerances()
