"""Finds MKL, Intel's mathematics library, and sets it up for its sparse solver PARDISO, whose codes stand here.

It is proprietary, so it is loaded where the user has installed it, never shipped.
"""

from __future__ import annotations

import ctypes
import re
import sys
from enum import IntEnum
from functools import cache
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_info

from morembs.linalg.sparse.foreign import find_library

HINT = "pip install 'morembs[pardiso]'"


class Layer(IntEnum):
    """Interface and threads of MKL: the values of its functions MKL_Set_Interface_Layer and MKL_Set_Threading_Layer."""

    LP64 = 0
    INTEL_THREADS = 0
    GNU_THREADS = 3


class Phase(IntEnum):
    """What a call of PARDISO does."""

    ANALYSE = 11
    FACTORIZE = 22
    SOLVE = 33
    FREE_FACTOR = 0
    FREE = -1


class Unit(IntEnum):
    """Of memory in IPARM."""

    KIBIBYTE = 1 << 10


class Place(IntEnum):
    """Places in the array ``iparm``, from zero as in the C manual."""

    NOT_DEFAULT = 0
    ORDERING = 1
    GIVEN_ORDER = 4
    ZERO_PIVOT = 9
    SCALING = 10
    MATCHING = 12
    REPLACED_PIVOTS = 13
    PEAK_OF_ANALYSIS = 14
    KEPT_BY_ANALYSIS = 15
    KEPT_BY_FACTOR = 16
    ENTRIES = 17
    MEGAFLOPS = 18
    TWO_BY_TWO_PIVOTS = 20
    NEGATIVE_PIVOTS = 22
    TWO_LEVELS = 23
    FROM_ZERO = 34
    LENGTH = 64


# What the matrix is called there, by its structure.
KINDS = {"spd": 2, "symmetric": -2, "complex-symmetric": 6}
# Codes of failure: of a factor without pivots, and the words for others.
SINGULAR = {-4, -7}
WORDS = {
    -1: "it found its input invalid",
    -2: "memory could not be allocated",
    -3: "the ordering failed",
    -8: "the matrix is too large for its integers",
}


def mkl_file() -> str | None:
    """The library with MKL's single entry point, of this environment or else of the system."""
    name = re.compile(r"(lib)?mkl_rt(\.\d+)*\.(so(\.\d+)*|dll|dylib)$")
    paths = [path for path in (Path(sys.prefix) / "lib").glob("libmkl_rt*") if name.match(path.name)]
    if not paths:
        try:
            files = metadata.files("mkl") or []
        except metadata.PackageNotFoundError:
            files = []
        paths = [path for path in (Path(str(file.locate())) for file in files) if name.match(path.name)]
    libraries = [str(path) for path in paths if path.is_file()]
    return libraries[0] if libraries else find_library("mkl_rt")


@cache
def mkl_library() -> ctypes.CDLL | str:
    """MKL, set to 32-bit integers in its plain interface, or why there is none."""
    path = mkl_file()
    if path is None:
        return f"the library MKL (mkl_rt) was not found; get it with: {HINT}"
    try:
        # At its first call it loads the rest of itself with global symbols. A library that brings a BLAS of its
        # own has to be loaded so that it prefers that one (RTLD_DEEPBIND).
        library = ctypes.CDLL(path)
        library.MKL_Set_Interface_Layer(Layer.LP64)
        # A second runtime of OpenMP in one process has threads of its own, which wait for work on the same cores.
        gnu = any("libgomp" in str(pool.get("filepath")) for pool in threadpool_info())
        library.MKL_Set_Threading_Layer(Layer.GNU_THREADS if gnu else Layer.INTEL_THREADS)
        for function in (library.pardiso, library.pardiso_64):
            function.restype = None
    except (OSError, AttributeError) as error:
        return f"{path} cannot be used: {error}; get another with: {HINT}"
    return library
