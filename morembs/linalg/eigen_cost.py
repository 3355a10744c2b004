"""What modes cost: widths of blocks and slices, and where dense matrices are cheaper.

Costs are counts of operations, from the factor that is there and the number of rows: equal input gives equal modes,
which a clock would not. Solves with blocks, products of columns and factorisations run at about the same rate.
"""

from __future__ import annotations

from math import sqrt

from morembs.linalg.sparse.cost import FactorStats
from morembs.linalg.tolerances import TOL


def columns_for(count: int, block: int) -> float:
    """Columns of a Krylov space in which ``count`` modes converge."""
    return TOL.columns_per_mode * count + TOL.last_blocks * block


def space_cost(stats: FactorStats, count: int, block: int) -> float:
    """Operations for ``count`` modes in one Krylov space of blocks with ``block`` columns."""
    columns = columns_for(count, block)
    solves = 4.0 * stats.factor_entries * (1 + TOL.solve_overhead_columns / block)
    return columns * solves + 4.0 * stats.size * columns**2


def block_width(stats: FactorStats, count: int) -> int:
    """Columns of a Krylov block for ``count`` modes: wide ones are solved for faster, narrow ones converge in fewer."""
    return min(TOL.block_widths, key=lambda block: space_cost(stats, count, block))


def slice_width(stats: FactorStats) -> int:
    """Modes of a slice: few are made orthogonal fast, many share a factorisation."""
    best = sqrt(stats.flops / (TOL.slice_operations * stats.size))
    return int(min(max(best, TOL.least_slice_modes), TOL.most_slice_modes))


def is_dense_cheaper(rows: int, count: int, room: int | None) -> bool:
    """True if LAPACK finds ``count`` modes with fewer operations, in ``room`` bytes (None: no limit)."""
    if room is not None and TOL.dense_matrices * 8 * rows**2 > room:
        return False
    return TOL.dense_operations * rows**3 < TOL.mode_operations * count
