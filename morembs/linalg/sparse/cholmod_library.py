"""Finds CHOLMOD, reads the layout of its structures from its header, and checks that the two agree.

The structures change between releases, and a wrong layout corrupts memory. So it is taken from the header
that was installed with the library, and refused when the versions of the two differ.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_info

HINT = "sudo apt-get install libsuitesparse-dev"
# Values of the enumerations of CHOLMOD, the same in all its releases.
LONG, REAL, GIVEN, SUPERNODAL, NOT_POSITIVE_DEFINITE = 2, 1, 1, 2, 1

_FOLDERS = ("/usr/local/include/suitesparse", "/usr/include/suitesparse", "/usr/local/include", "/usr/include")
# Releases up to CHOLMOD 3 define the structures in the first, later ones in the second.
_HEADERS = ("cholmod_core.h", "cholmod.h")
_TYPES: dict[str, Any] = {
    "double": ctypes.c_double, "float": ctypes.c_float, "int": ctypes.c_int, "size_t": ctypes.c_size_t,
    "SuiteSparse_long": ctypes.c_int64, "int64_t": ctypes.c_int64,
}  # fmt: skip
_NEEDED = {
    "common": {
        "supernodal", "final_ll", "zrelax", "nrelax", "quick_return_if_not_posdef", "print", "error_handler",
        "nmethods", "method", "postorder", "itype", "status", "fl", "lnz", "memory_usage", "memory_inuse",
    },
    "sparse": {"nrow", "ncol", "nzmax", "p", "i", "x", "stype", "itype", "xtype", "dtype", "sorted", "packed"},
    "dense": {"nrow", "ncol", "nzmax", "d", "x", "xtype", "dtype"},
    "factor": {"n", "minor", "Perm", "nsuper", "xsize", "maxcsize", "is_super", "xtype"},
}  # fmt: skip
_FUNCTIONS: dict[str, Any] = {
    "start": ctypes.c_int, "finish": ctypes.c_int, "analyze_p": ctypes.c_void_p, "factorize": ctypes.c_int,
    "change_factor": ctypes.c_int, "solve2": ctypes.c_int, "free_factor": ctypes.c_int, "free_dense": ctypes.c_int,
}  # fmt: skip
# A library that is newer than the header writes beyond the structure while it is being tested.
_PADDING = 1 << 14
_DEFAULT_NRELAX = [4, 16, 48]


class UnusableError(Exception):
    """A library or header that cannot be used; the message says why."""


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


def parse_header(text: str) -> tuple[str, dict[str, type[ctypes.Structure]]]:
    """Version and structures in the text of a header of CHOLMOD; pointers become c_void_p.

    Raises:
        UnusableError: the text is not understood.
    """
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)
    constants = dict(re.findall(r"^[ \t]*#[ \t]*define[ \t]+(\w+)[ \t]+\(?(\d+)\)?[ \t]*$", text, flags=re.MULTILINE))
    numbers = [constants.get(f"CHOLMOD_{part}_VERSION", "") for part in ("MAIN", "SUB", "SUBSUB")]
    if not all(numbers):
        raise UnusableError("its header does not say its version")
    structures = {}
    for name, needed in _NEEDED.items():
        begin = re.search(rf"typedef\s+struct\s+cholmod_{name}_struct\s*\{{", text)
        end = re.search(rf"\}}\s*cholmod_{name}\s*;", text)
        if begin is None or end is None:
            raise UnusableError(f"its header defines no cholmod_{name}")
        fields = _fields(_preprocessed(text[begin.end() : end.start()]), constants)
        missing = sorted(needed - {field for field, _ in fields})
        if missing:
            raise UnusableError(f"cholmod_{name} of its header lacks {', '.join(missing)}")
        structures[name] = type(f"Cholmod{name.capitalize()}", (ctypes.Structure,), {"_fields_": fields})
    return ".".join(numbers), structures


def _preprocessed(body: str) -> str:
    """Without its conditional parts: those for graphics processors only give names to pointers."""
    conditional = r"^[ \t]*#[ \t]*(?:ifdef|if)\b.*?^[ \t]*#[ \t]*endif[^\n]*$"
    for part in re.findall(conditional, body, flags=re.MULTILINE | re.DOTALL):
        if ";" in part or "CUBLAS" not in part:
            raise UnusableError("its header has a conditional field, which is not understood")
    body = re.sub(conditional, "", body, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"^[ \t]*#[^\n]*$", "", body, flags=re.MULTILINE)


def _fields(body: str, constants: Mapping[str, str]) -> list[tuple[str, Any]]:
    fields: list[tuple[str, Any]] = []
    types = dict(_TYPES)
    inner = re.compile(r"struct\s+\w+\s*\{([^{}]*)\}\s*(\w+\s*\[[^\]]+\])\s*;")
    for number, found in enumerate(inner.finditer(body)):
        part = type(f"Inner{number}", (ctypes.Structure,), {"_fields_": _fields(found[1], constants)})
        types[f"inner{number}"] = part
        body = body.replace(found[0], f"inner{number} {found[2]};")
    body = re.sub(r"void\s*\(\s*\*\s*(\w+)\s*\)\s*\([^()]*\)\s*;", r"void *\1;", body)
    for statement in filter(None, (part.strip() for part in body.split(";"))):
        kind, *rest = statement.split(None, 1)
        if not rest:
            raise UnusableError(f"its header has a field that is not understood: {statement!r}")
        for declarator in rest[0].split(","):
            found_one = re.fullmatch(r"\s*(\*?)\s*(\w+)\s*(?:\[([^\]]+)\])?\s*", declarator)
            # Handles of CUDA are pointers, whatever their names.
            star = found_one is not None and (bool(found_one[1]) or kind.startswith("CHOLMOD_CU"))
            if found_one is None or not (star or kind in types):
                raise UnusableError(f"its header has a field that is not understood: {statement!r}")
            fields.append((found_one[2], _sized(ctypes.c_void_p if star else types[kind], found_one[3], constants)))
    return fields


def _sized(kind: Any, length: str | None, constants: Mapping[str, str]) -> Any:
    if length is None:
        return kind
    try:
        return kind * sum(int(constants.get(term.strip(), term)) for term in length.split("+"))
    except ValueError:
        raise UnusableError(f"its header has an array length that is not understood: {length!r}") from None


def _open(path: str, header: Path) -> Library:
    """Load a library and compare its version, and what it writes into its structure, with the header."""
    version, structures = parse_header(header.read_text(encoding="latin-1"))
    try:
        # Deep: another BLAS that became global, such as MKL's, must not take the place of its own.
        library = ctypes.CDLL(path, mode=ctypes.DEFAULT_MODE | getattr(os, "RTLD_DEEPBIND", 0))
        functions = {name: getattr(library, f"cholmod_l_{name}") for name in _FUNCTIONS}
        numbers = (ctypes.c_int * 3)()
        library.cholmod_version(numbers)
    except (OSError, AttributeError) as error:
        raise UnusableError(f"it cannot be loaded: {error}") from None
    found = ".".join(str(number) for number in numbers)
    if found != version:
        raise UnusableError(f"its header {header} has version {version}, the library {found}")
    for name, result in _FUNCTIONS.items():
        functions[name].restype = result
    fields = [("data", structures["common"]), ("padding", ctypes.c_char * _PADDING)]
    holder: Any = type("Padded", (ctypes.Structure,), {"_fields_": fields})()
    functions["start"](ctypes.byref(holder))
    agrees = list(holder.data.nrelax) == _DEFAULT_NRELAX and holder.data.itype == LONG and not any(holder.padding)
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
def cholmod_library() -> Library | str:
    """The CHOLMOD of the system, or why there is none."""
    path = ctypes.util.find_library("cholmod")
    if path is None:
        return f"no CHOLMOD library (libcholmod) was found; get it with: {HINT}"
    reason = f"its header {_HEADERS[0]} was not found"
    for header in (Path(folder) / name for folder in _FOLDERS for name in _HEADERS):
        if not header.is_file() or "cholmod_common_struct" not in header.read_text(encoding="latin-1"):
            continue
        try:
            return _open(path, header)
        except UnusableError as error:
            reason = str(error)
    return f"{path} cannot be used: {reason}; get both with: {HINT}"
