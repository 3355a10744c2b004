"""Rough times of reductions, from rates measured on solid bodies: good to a factor of about three.

Modes by block Lanczos (``count`` of them, S columns of length n in the Krylov space, blocks of b): 4 n S^2 operations
keep the space orthogonal; the small eigenvalue problem of k columns takes about 5 k^3, each time that the space has
grown by a twentieth, so 35 S^3 all together. S = 2.4 count + 10 b was seen for 100 to 800 modes. More are found slice
by slice, in proportion.

Responses to p inputs: the space of the reference model has about 5 p columns, and its error is looked at
at some two hundred frequencies; what ``auto`` makes of it takes a dozen times as long.
"""

from __future__ import annotations

from morembs.linalg.eigen_cost import is_dense_cheaper
from morembs.linalg.sparse.threads import Speed, measured_speed
from morembs.linalg.tolerances import TOL as LINALG
from morembs.reducers.tolerances import TOL


def mode_seconds(size: int, count: int, factor_entries: int, speed: Speed | None = None) -> float:
    """Time of the lowest ``count`` modes of ``size`` dofs, the factorisation not included, at ``speed``, None: as
    measured."""
    rate = 1e9 * (speed or measured_speed()).gemm_gflops
    if size <= LINALG.dense_rows or is_dense_cheaper(size, count, None):
        return TOL.dense_flops * size**3 / (TOL.dense_efficiency * rate)
    at_once = min(count, LINALG.most_slice_modes)
    block = min(max(at_once // 2, 8), 16)
    columns = min(TOL.columns_per_mode * at_once + TOL.extra_blocks * block, 3 * at_once + 8 * block, size)
    flops = (
        4 * size * columns**2
        + TOL.small_flops * columns**3 / (3 * (LINALG.ritz_growth - 1))
        + 4 * factor_entries * columns / TOL.solve_efficiency
    )
    return flops / rate * count / max(at_once, 1)


def response_seconds(
    size: int, inputs: int, factor_entries: int = 0, of_reference: float = TOL.compared_references
) -> float:
    """Time of a reduction that follows the responses of ``size`` dofs to ``inputs``, or of a comparison.

    ``of_reference`` is how often the work on the reference model is done.
    """
    rate, columns = 1e9 * measured_speed().gemm_gflops, min(TOL.columns_per_input * inputs, size)
    space = 4 * size * columns**2 + 4 * factor_entries * columns / TOL.solve_efficiency
    return (space + of_reference * TOL.reference_flops * inputs**3) / rate
