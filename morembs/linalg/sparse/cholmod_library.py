"""Finds CHOLMOD, reads the layout of its structures from its header, and checks that the two agree."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from morembs.base.types import Values
from morembs.linalg.sparse.foreign import (
    UnusableError,
    constants,
    find_library,
    open_deep,
    pad_structure,
    refuse_missing,
    struct_fields,
    structure,
    with_header,
    without_comments,
)
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

HINT = "sudo apt-get install libsuitesparse-dev"


class Code:
    """Values of the enumerations of CHOLMOD, the same in all its releases."""

    LOWER = -1
    REAL = 1
    LONG = 2
    GIVEN_ORDER = 1
    ALWAYS_SUPERNODAL = 2
    NOT_POSITIVE_DEFINITE = 1
    SOLVE_WHOLE = 0


# Folders of the headers of the system.
FOLDERS = ("/usr/local/include/suitesparse", "/usr/include/suitesparse", "/usr/local/include", "/usr/include")
# Releases up to CHOLMOD 3 define the structures in the first, later ones in the second.
HEADERS = ("cholmod_core.h", "cholmod.h")
_TYPES: dict[str, Any] = {
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "int": ctypes.c_int,
    "size_t": ctypes.c_size_t,
    "SuiteSparse_long": ctypes.c_int64,
    "int64_t": ctypes.c_int64,
}
_NEEDED = {
    "common": {
        "supernodal",
        "final_ll",
        "zrelax",
        "nrelax",
        "quick_return_if_not_posdef",
        "print",
        "error_handler",
        "nmethods",
        "method",
        "postorder",
        "itype",
        "status",
        "fl",
        "lnz",
        "memory_usage",
        "memory_inuse",
    },
    "sparse": {"nrow", "ncol", "nzmax", "p", "i", "x", "stype", "itype", "xtype", "dtype", "sorted", "packed"},
    "dense": {"nrow", "ncol", "nzmax", "d", "x", "xtype", "dtype"},
    "factor": {"n", "minor", "Perm", "nsuper", "xsize", "maxcsize", "is_super", "xtype"},
}
_FUNCTIONS: dict[str, Any] = {
    "start": ctypes.c_int,
    "finish": ctypes.c_int,
    "analyze_p": ctypes.c_void_p,
    "factorize": ctypes.c_int,
    "change_factor": ctypes.c_int,
    "solve2": ctypes.c_int,
    "free_factor": ctypes.c_int,
    "free_dense": ctypes.c_int,
}
# What ``start`` writes into the structure, by which its layout is known to be right.
_DEFAULTS = {"nrelax": [4, 16, 48], "itype": [Code.LONG]}


@dataclass(frozen=True)
class Library:
    """A CHOLMOD library that passed the version test: its structures and its functions (64-bit integers)."""

    path: str
    version: str
    structures: Mapping[str, type[ctypes.Structure]]
    functions: Mapping[str, Any]
    openmp: tuple[Any, Any] | None = None

    @contextmanager
    def serial_loops(self) -> Iterator[None]:
        """Run the small loops of CHOLMOD itself in one thread, for the calls that this thread makes inside.

        They ask for OpenMP threads that spin between the loops and take the processors from the threads of the
        BLAS: with one for each processor of a busy machine, a factorisation took ten times as long.
        """
        if self.openmp is None:
            yield
            return
        get, give = self.openmp
        before = get()
        give(0)
        try:
            yield
        finally:
            give(before)

    def new(self, name: str) -> Any:
        """An empty structure: "common", "sparse", "dense" or "factor"."""
        return self.structures[name]()

    def start_workspace(self) -> Any:
        """A workspace of CHOLMOD, which says nothing on its own; ``finish`` ends it."""
        common = self.new("common")
        self.functions["start"](ctypes.byref(common))
        common.print, common.error_handler = 0, None
        return common

    def sparse(self, A: Lower, values: bool = True) -> Any:
        """``A`` as a structure cholmod_sparse, which keeps its arrays alive; its pattern only without ``values``."""
        matrix = self.new("sparse")
        matrix.held = [array.astype(np.int64) for array in (A.indptr, A.indices)]
        matrix.p, matrix.i = (array.ctypes.data for array in matrix.held)
        if values:
            data = np.ascontiguousarray(A.data, dtype=np.float64)
            matrix.x, matrix.xtype = data.ctypes.data, Code.REAL
            matrix.held.append(data)
        matrix.nrow = matrix.ncol = A.n
        matrix.nzmax = A.nnz
        matrix.stype, matrix.itype, matrix.sorted, matrix.packed = Code.LOWER, Code.LONG, 1, 1
        return matrix

    def dense(self, X: Values) -> Any:
        """The Fortran-ordered ``X`` (n, k) as a structure cholmod_dense."""
        matrix = self.new("dense")
        matrix.nrow, matrix.ncol = X.shape
        matrix.d, matrix.nzmax = X.shape[0], X.size
        matrix.x, matrix.xtype = X.ctypes.data, Code.REAL
        matrix.held = X
        return matrix


def parse_header(text: str) -> tuple[str, dict[str, type[ctypes.Structure]]]:
    """Version and structures in the text of a header of CHOLMOD; pointers become c_void_p.

    Raises:
        UnusableError: the text is not understood.
    """
    text = without_comments(text)
    defined = constants(text)
    numbers = [defined.get(f"CHOLMOD_{part}_VERSION", "") for part in ("MAIN", "SUB", "SUBSUB")]
    if not all(numbers):
        raise UnusableError("its header does not say its version")
    # Handles of CUDA are pointers, regardless of their names.
    types = _TYPES | dict.fromkeys(re.findall(r"\bCHOLMOD_CU\w+", text))
    structures = {}
    for name, needed in _NEEDED.items():
        begin = re.search(rf"typedef\s+struct\s+cholmod_{name}_struct\s*\{{", text)
        end = re.search(rf"\}}\s*cholmod_{name}\s*;", text)
        if begin is None or end is None:
            raise UnusableError(f"its header defines no cholmod_{name}")
        fields = struct_fields(_preprocess(text[begin.end() : end.start()]), types, defined)
        refuse_missing(fields, needed, f"cholmod_{name}")
        structures[name] = structure(f"Cholmod{name.capitalize()}", fields)
    return ".".join(numbers), structures


def _preprocess(body: str) -> str:
    """Without its conditional parts: those for graphics processors only give names to pointers."""
    conditional = r"^[ \t]*#[ \t]*(?:ifdef|if)\b.*?^[ \t]*#[ \t]*endif[^\n]*$"
    for part in re.findall(conditional, body, flags=re.MULTILINE | re.DOTALL):
        if ";" in part or "CUBLAS" not in part:
            raise UnusableError("its header has a conditional field, which is not understood")
    body = re.sub(conditional, "", body, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"^[ \t]*#[^\n]*$", "", body, flags=re.MULTILINE)


def _open(path: str, header: Path) -> Library:
    """Load a library and compare its version, and the values that it writes into its structure, with the header."""
    version, structures = parse_header(header.read_text(encoding="latin-1"))
    try:
        library = open_deep(path)
        functions = {name: getattr(library, f"cholmod_l_{name}") for name in _FUNCTIONS}
        numbers = (ctypes.c_int * 3)()
        library.cholmod_version(numbers)
    except (OSError, AttributeError) as error:
        raise UnusableError(f"it cannot be loaded: {error}") from None
    loaded = ".".join(str(number) for number in numbers)
    if loaded != version:
        raise UnusableError(f"its header {header} has version {version}, the library {loaded}")
    for name, result in _FUNCTIONS.items():
        functions[name].restype = result
    holder = pad_structure(structures["common"], TOL.padding_bytes)
    functions["start"](ctypes.byref(holder))
    written = {"nrelax": list(holder.data.nrelax), "itype": [holder.data.itype]}
    agrees = written == _DEFAULTS and not any(holder.padding)
    functions["finish"](ctypes.byref(holder))
    if not agrees:
        raise UnusableError(f"its structure differs from that of its header {header}")
    return Library(path, version, structures, functions, _openmp(library))


def _openmp(library: ctypes.CDLL) -> tuple[Any, Any] | None:
    """How to read and set, for one thread, the depth of parallel loops; None where they must not be touched."""
    # A BLAS that is threaded by OpenMP would lose its threads as well.
    if any(pool.get("threading_layer") == "openmp" for pool in threadpool_info()):
        return None
    try:
        return library.omp_get_max_active_levels, library.omp_set_max_active_levels
    except AttributeError:
        return None


@cache
def cholmod_library(folders: tuple[str, ...] = FOLDERS) -> Library | str:
    """The CHOLMOD of the system, whose headers are in one of ``folders``, or why there is none."""
    path = find_library("cholmod")
    if path is None:
        return f"no CHOLMOD library (libcholmod) was found; get it with: {HINT}"
    headers = [header for folder in folders for name in HEADERS if (header := Path(folder) / name).is_file()]
    headers = [path for path in headers if "cholmod_common_struct" in path.read_text(encoding="latin-1")]
    return with_header(path, headers, lambda header: _open(path, header), HEADERS[0], HINT)
