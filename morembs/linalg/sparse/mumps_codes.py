"""Codes of MUMPS, as its manual numbers them: jobs, controls, results, failures."""

from __future__ import annotations

from enum import IntEnum


class Job(IntEnum):
    """What a call does; ``FREE_FACTOR`` is not there before version 5.6."""

    NEW = -1
    END = -2
    ANALYSE = 1
    FACTORIZE = 2
    SOLVE = 3
    FREE_FACTOR = -4


class Control(IntEnum):
    """ICNTL(k)."""

    ERROR_STREAM = 1
    DIAGNOSTIC_STREAM = 2
    GLOBAL_STREAM = 3
    PRINT_LEVEL = 4
    PERMUTE_LARGE_TO_DIAGONAL = 6
    ORDERING = 7
    NOT_TRANSPOSED = 9
    SYMMETRIC_ORDERING = 12
    WHOLE_ROOT = 13
    DELAYED_PIVOTS_PERCENT = 14
    ON_DISK = 22
    COLUMNS_AT_ONCE = 27
    DISCARD_FACTOR = 31
    LOW_RANK = 35


class Ordering(IntEnum):
    """Values of ``Control.ORDERING``."""

    GIVEN = 1
    METIS = 5


class Setting(IntEnum):
    """Values of other controls."""

    NO = 0
    YES = 1
    USUAL_SYMMETRIC_ORDERING = 1
    TRANSPOSED = 2
    LOW_RANK_FACTOR_AND_SOLUTION = 2


class RealControl(IntEnum):
    """CNTL(k)."""

    DROPPED_BY_LOW_RANK = 7


class Info(IntEnum):
    """INFOG(k). Memory is that of the largest process, in millions of bytes; the next number is that of all."""

    CODE = 1
    DETAIL = 2
    ENTRIES_ESTIMATE = 3
    NEGATIVE_PIVOTS = 12
    MEMORY = 16
    MEMORY_ON_DISK = 26
    ENTRIES = 29


class RealInfo(IntEnum):
    """RINFOG(k)."""

    FLOPS_ESTIMATE = 1
    FLOPS = 3


class Unit(IntEnum):
    """Of memory in INFOG, and of its counts that are too large for 32 bits: these are given in negative millions."""

    MILLION = 1_000_000


# SYM, by structure.
KINDS = {"spd": 1, "symmetric": 2, "complex-symmetric": 2, "unsymmetric": 0, "complex-unsymmetric": 0}
# The letter that MUMPS puts before its names, by type of the values.
ARITHMETIC = {"float64": "d", "complex128": "z", "float32": "s", "complex64": "c"}


class World(IntEnum):
    """Values of the communicator: "no MPI" is what the dummy of MPI in the sequential build expects."""

    SEQUENTIAL = -987654


class Keep(IntEnum):
    """KEEP(k + 1), internal: ``NONE`` where updates of symmetric fronts go through DGEMMT."""

    SYMMETRIC_PRODUCT = 420
    DGEMMT = -1
    DGEMM = 0


SINGULAR = {-10, -40}
# Workspace or buffers found too small in the numerical phase: more of them cures it.
TOO_SMALL = {-8, -9, -14, -15, -17, -18, -20}
WORDS = {
    -5: "memory could not be allocated",
    -7: "memory could not be allocated",
    -13: "memory could not be allocated",
    -8: "integer workspace too small",
    -9: "workspace too small",
    -11: "workspace too small for the solution",
    -14: "integer workspace too small for the solution",
    -19: "the memory budget is too small",
    -20: "buffer too small",
    -51: "the graph is too large for 32-bit integers",
    -52: "the graph is too large for 32-bit integers",
    -90: "the scratch folder cannot be written or is full; make room there, or give another one",
}
