"""Forecast and measured cost of a factorisation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """What a factorisation will need, from its symbolic analysis. Bytes and operations.

    ``memory`` is the peak of the factorisation itself, without the matrix that the caller holds;
    ``disk`` the size of its scratch files, 0 in core; ``kept`` what stays in memory for the solves. Where there are
    several ``ranks`` on this machine, all of it is theirs, and ``memory`` and ``kept`` are those of all together.
    """

    backend: str
    size: int
    factor_entries: int
    flops: float
    memory: int
    kept: int
    disk: int = 0
    precision: str = "double"
    ranks: int = 1

    @property
    def out_of_core(self) -> bool:
        """True if the factor lies on disk."""
        return self.disk > 0


@dataclass(frozen=True, kw_only=True)
class FactorStats:
    """Cost of one factorisation: stored factor entries, operations, bytes of factors held in memory and
    on disk, arithmetic, threads of the BLAS (0: not known), seconds.

    ``columns`` have been solved for with it so far, in ``passes`` over the whole factor: each reads a factor on disk
    twice, there and back."""

    backend: str
    size: int
    nnz: int
    factor_entries: int
    memory_bytes: int
    out_of_core: bool
    seconds: float
    flops: float = 0.0
    disk_bytes: int = 0
    precision: str = "double"
    threads: int = 0
    columns: int = 0
    passes: int = 0
