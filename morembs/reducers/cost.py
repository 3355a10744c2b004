"""Rough times of reductions, from rates measured on solid bodies: good to a factor of about three.

Modes by block Lanczos (``count`` of them, S columns of length n in the Krylov space, blocks of b): 4 n S^2 operations
keep the space orthogonal, the small eigenvalue problem of each step takes about 5 k^3, so S^4 / b all together, and
it is what makes thousands of modes of one count hopeless. S = 2.4 count + 10 b was seen for 100 to 800 modes.

Responses to p inputs: the space of the reference model has about 5 p columns, and its error is looked at
at some two hundred frequencies; what ``auto`` makes of it takes a dozen times as long.
"""

from __future__ import annotations

from morembs.linalg.eigen import DENSE, DENSE_PART
from morembs.linalg.sparse.threads import Speed, measured_speed

# Columns of the space for each mode, and blocks on top; operations of the small problem over k^3.
_PER_MODE, _EXTRA_BLOCKS, _SMALL = 2.4, 10, 2.5
# Operations over n^3 where all modes are found at once, and part of the speed of a product that it reaches.
_DENSE, _DENSE_EFFICIENCY = 15.0, 0.4
# Part of that speed that triangular solves reach.
_SOLVES = 0.2
# Columns for each input and operations over p^3 of the reference model; what a comparison takes of these in all.
_PER_INPUT, _REFERENCE = 5, 1e5
COMPARED = 2.0


def mode_seconds(size: int, count: int, factor_entries: int, speed: Speed | None = None) -> float:
    """Time of the lowest ``count`` modes of ``size`` dofs, the factorisation not included, at ``speed``, None: as
    measured."""
    rate = 1e9 * (speed or measured_speed()).gemm_gflops
    if size <= DENSE or (size <= DENSE_PART and 4 * count > size):
        return _DENSE * size**3 / (_DENSE_EFFICIENCY * rate)
    block = min(max(count // 2, 8), 16)
    columns = min(_PER_MODE * count + _EXTRA_BLOCKS * block, 3 * count + 8 * block, size)
    flops = 4 * size * columns**2 + _SMALL * columns**4 / (4 * block) + 4 * factor_entries * columns / _SOLVES
    return flops / rate


def response_seconds(size: int, inputs: int, factor_entries: int = 0, of_reference: float = COMPARED) -> float:
    """Time of a reduction that follows the responses of ``size`` dofs to ``inputs``, or of a comparison.

    ``of_reference`` is how often the work on the reference model is done.
    """
    rate, columns = 1e9 * measured_speed().gemm_gflops, min(_PER_INPUT * inputs, size)
    space = 4 * size * columns**2 + 4 * factor_entries * columns / _SOLVES
    return (space + of_reference * _REFERENCE * inputs**3) / rate
