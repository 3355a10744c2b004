"""Finds MKL, Intel's mathematics library, and sets it up for its sparse solver.

It is proprietary, so it is loaded where the user has installed it, never shipped.
"""

from __future__ import annotations

import ctypes
import re
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

from threadpoolctl import threadpool_info

from morembs.linalg.sparse.foreign import find_library

HINT = "pip install 'morembs[pardiso]'"
_LP64, _INTEL_THREADS, _GNU_THREADS = 0, 0, 3


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
    held = [str(path) for path in paths if path.is_file()]
    return held[0] if held else find_library("mkl_rt")


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
        library.MKL_Set_Interface_Layer(_LP64)
        # A second runtime of OpenMP in one process has threads of its own, which wait for work on the same cores.
        gnu = any("libgomp" in str(pool.get("filepath")) for pool in threadpool_info())
        library.MKL_Set_Threading_Layer(_GNU_THREADS if gnu else _INTEL_THREADS)
        for function in (library.pardiso, library.pardiso_64):
            function.restype = None
    except (OSError, AttributeError) as error:
        return f"{path} cannot be used: {error}; get another with: {HINT}"
    return library
