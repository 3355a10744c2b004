"""Rough times of reductions, from rates measured on solid bodies: good to a factor of about three.

Modes by block Lanczos (``count`` of them, S columns of length n in the Krylov space, blocks of b): 4 n S^2 operations
keep the space orthogonal; the small eigenvalue problem of k columns takes about 5 k^3, each time that the space has
grown by a twentieth, so 35 S^3 all together. S = 2.4 count + 10 b was seen for 100 to 800 modes. More are found slice
by slice, in proportion.

Responses to p inputs: the space of the reference model has about 5 p columns, and its error is looked at
at some two hundred frequencies.

The certified reference of ``auto`` is grown block by block until its error is 10^-d: d^2 n^(1/3) / 139 blocks of p
columns, as errors of responses to loads on small faces fall with the root of the number of blocks, and slower on fine
meshes. Of n dofs, S columns and m blocks the operations are 9 n S^2 for two passes of orthogonalisation, two against
rigid motion and the projection of K; 15 S^3 m / 4 for an eigenproblem after each block; and for each time that the
bound is looked at 4 n S^2 + 15 S^3. The search decomposes the real and imaginary parts of responses at f frequencies,
2 f p columns of length S, six times: two families with three weights.

A parametric basis is bounded at each of t values of p: once to begin with, after each step of the search, in order
and for each halving of the order, and at the fresh ones. Python takes most of the time of a bound.
"""

from __future__ import annotations

import math

from morembs.linalg.eigen_cost import is_dense_cheaper
from morembs.linalg.sparse.threads import Speed, machine_slowness, measured_speed
from morembs.linalg.tolerances import TOL as LINALG
from morembs.parametric.tolerances import TOL as PARAMETRIC
from morembs.reducers.tolerances import TOL
from morembs.responses.tolerances import TOL as RESPONSES


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


def reference_columns(size: int, inputs: int, error: float) -> int:
    """Columns of the certified reference of ``size`` dofs whose growth ends at ``error``."""
    blocks = math.ceil(TOL.reference_blocks * math.log10(error) ** 2 * size ** (1 / 3))
    return int(min(inputs * blocks, size, RESPONSES.max_order))


def search_seconds(size: int, inputs: int, factor_entries: int, error: float) -> float:
    """Time of the certified reference whose growth ends at ``error``, and of the search for the smallest body."""
    columns = reference_columns(size, inputs, error)
    dense = TOL.dense_flops * columns**3 / TOL.dense_efficiency
    space = 9 * size * columns**2 + 4 * factor_entries * columns / TOL.solve_efficiency
    looks = dense * columns / (4 * max(inputs, 1))
    bounds = TOL.bounded_references * (4 * size * columns**2 + dense)
    snapshots = 2 * RESPONSES.band_points * inputs
    families = 6 * 2 * snapshots * columns**2 / TOL.dense_efficiency
    flops = space + looks + bounds + families
    return mode_seconds(size, 1, factor_entries) + flops / (1e9 * measured_speed().gemm_gflops)


def box_seconds(size: int, inputs: int, factor_entries: int, training: int, order_limit: int) -> float:
    """Time of a parametric basis bounded at ``training`` values of p, of at most ``order_limit`` columns."""
    columns = min(PARAMETRIC.load_blocks * inputs, size)
    space = 4 * size * columns**2 + 4 * factor_entries * columns / TOL.solve_efficiency
    # Each halving that fails ends at the first value above the tolerance.
    looks = 3 + 0.5 * math.log2(max(order_limit, 1)) + 1 + PARAMETRIC.fresh_per_training
    bound = TOL.bound_seconds * machine_slowness()
    linear = (space + looks * training * TOL.dense_flops * columns**3) / (1e9 * measured_speed().gemm_gflops)
    return mode_seconds(size, 1, factor_entries) + linear + looks * training * bound
