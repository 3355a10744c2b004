"""Finds a MUMPS library, reads the layout of its structure from its header, and checks that the two agree."""

from __future__ import annotations

import ctypes
import importlib.util
import re
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

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
from morembs.linalg.sparse.mumps_codes import ARITHMETIC, Job, World
from morembs.linalg.sparse.rebinding import rebind, scipy_blas
from morembs.linalg.sparse.tolerances import TOL

SYSTEM_HINT = "sudo apt-get install libmumps-seq-dev libmetis5 libopenblas0-pthread"
EMBEDDED_HINT = "pip install casadi"
RANKS_HINT = "sudo apt-get install libmumps-dev openmpi-bin libmetis5 libopenblas0-pthread"

_TYPES: dict[str, Any] = {"MUMPS_INT": ctypes.c_int32, "MUMPS_INT8": ctypes.c_int64, "char": ctypes.c_char}
_NEEDED = {
    "sym",
    "par",
    "job",
    "comm_fortran",
    "icntl",
    "cntl",
    "n",
    "nnz",
    "irn",
    "jcn",
    "a",
    "perm_in",
    "rhs",
    "nrhs",
    "lrhs",
    "infog",
    "rinfog",
    "version_number",
    "ooc_tmpdir",
    "ooc_prefix",
}
# MUMPS keeps state in global variables, so one job runs at a time. Reentrant, because the garbage
# collector may close a factorisation of the thread that holds it; one for all, because two threads that
# look for the library at the same time both open it.
LOCK = threading.RLock()
# Folders of the headers of the system.
FOLDERS = (Path("/usr/local/include"), Path("/usr/include"))


@dataclass(frozen=True)
class Library:
    """A MUMPS library that passed the version test, and the structure its calls take."""

    path: str
    version: str
    structure: type[ctypes.Structure]
    function: Callable[[Any], None]
    # Debian's build clusters with SCOTCH and crashes at random in low-rank mode; builds with METIS do not.
    low_rank: bool = False
    lock: AbstractContextManager[Any] = LOCK
    # Whether it calls another BLAS than its own.
    other_blas: bool = False

    @property
    def keeps_analysis(self) -> bool:
        """True if JOB = -4 is there, which frees a factor and keeps the analysis (not yet in 5.5)."""
        return tuple(map(int, re.findall(r"\d+", self.version)[:2])) >= (5, 6)

    def call(self, data: Any, job: int) -> None:
        """Run one job; the lock of the interpreter is released meanwhile."""
        with self.lock:
            data.job = job
            self.function(ctypes.byref(data))


def parse_header(text: str, letter: str = "d") -> tuple[str, type[ctypes.Structure]]:
    """Version and ``DMUMPS_STRUC_C`` in the text of ``dmumps_c.h``; pointers become c_void_p.

    ``letter`` is that of the arithmetic: s, d, c or z.

    Raises:
        UnusableError: the text is not understood.
    """
    text = without_comments(text)
    defined = constants(text)
    name = f"{letter.upper()}MUMPS_STRUC_C"
    body = re.search(r"typedef\s+struct\s*\w*\s*\{([^{}]*)\}\s*" + name + r"\s*;", text)
    version = defined.get("MUMPS_VERSION", "").strip('"')
    if body is None or not version:
        raise UnusableError(f"its header defines no {name} or no MUMPS_VERSION")
    real = ctypes.c_float if letter in "sc" else ctypes.c_double
    # Complex values occur behind pointers only.
    types = {**_TYPES, f"{letter.upper()}MUMPS_REAL": real, f"{letter.upper()}MUMPS_COMPLEX": real}
    fields = struct_fields(body[1], types, defined)
    refuse_missing(fields, _NEEDED, "the structure")
    return version, structure(f"{letter.upper()}mumpsStructure", fields)


def refuse_wide_integers(header: Path) -> None:
    """Raise UnusableError where the headers next to ``header`` are those of a build with 64-bit integers."""
    for path in (header.with_name("mumps_int_def.h"), header.with_name("mumps_c_types.h")):
        if path.is_file() and "MUMPS_INTSIZE64" in re.findall(
            r"^\s*#\s*define\s+(\w+)", without_comments(path.read_text(encoding="latin-1")), flags=re.MULTILINE
        ):
            raise UnusableError("it is built with 64-bit integers; a build with 32-bit ones is needed")


def _open(path: str, folder: Path, letter: str, low_rank: bool = False) -> Library:
    """Load a library and make an empty instance with it, to read the version it says it has."""
    header = folder / f"{letter}mumps_c.h"
    refuse_wide_integers(header)
    version, layout = parse_header(header.read_text(encoding="latin-1"), letter)
    try:
        function = getattr(open_deep(path), f"{letter}mumps_c")
    except (OSError, AttributeError) as error:
        raise UnusableError(f"it cannot be loaded: {error}") from None
    function.restype = None
    # Keeps the padding alive as long as the structure.
    holder = pad_structure(layout, TOL.padding_bytes)
    data = holder.data
    data.par, data.sym, data.comm_fortran = 1, 1, World.SEQUENTIAL
    library = Library(path, version, layout, function, low_rank)
    with library.lock:
        library.call(data, Job.NEW)
        loaded = data.version_number.decode("latin-1").strip()
        data.icntl[:4] = [0] * 4
        library.call(data, Job.END)
    if loaded != version:
        raise UnusableError(f"its header {header} has version {version}, the library {loaded or 'another'}")
    return library


def _own_build() -> Path | None:
    """Library with all arithmetics that the optional set-up step built with METIS into this Python environment."""
    path = Path(sys.prefix) / "lib" / "libmumps_metis.so"
    return path if path.is_file() else None


@cache
def system_library(dtype: str = "float64", folders: tuple[Path, ...] = FOLDERS) -> Library | str:
    """The sequential MUMPS of this environment or else of the system, or why there is none.

    ``dtype`` is that of the factor: float64, complex128, float32 or complex64; ``folders`` hold the headers of the
    system.
    """
    letter = ARITHMETIC[dtype]
    own = _own_build()
    path = str(own) if own else find_library(f"{letter}mumps_seq")
    if path is None:
        return f"no sequential MUMPS library (lib{letter}mumps_seq) was found; get it with: {SYSTEM_HINT}"
    name = f"{letter}mumps_c.h"
    places = [Path(sys.prefix) / "include"] if own else folders
    headers = [folder / sub / name for folder in places for sub in ("mumps_seq", "MUMPS", "")]
    return with_header(
        path, headers, lambda header: _open(path, header.parent, letter, low_rank=own is not None), name, SYSTEM_HINT
    )


@cache
def rank_files(dtype: str = "float64", folders: tuple[Path, ...] = FOLDERS) -> tuple[str, Path] | str:
    """Path of the parallel MUMPS of the system and its header, or why there is none; see ``system_library``."""
    letter = ARITHMETIC[dtype]
    # The name without a version is that of the package for programming, which brings the header.
    path = find_library(f"{letter}mumps")
    if path is None:
        return f"no parallel MUMPS library (lib{letter}mumps) was found; get it with: {RANKS_HINT}"
    headers = [folder / f"{letter}mumps_c.h" for folder in folders]
    header = next((each for each in headers if each.is_file()), None)
    if header is None:
        return f"{path} cannot be used: its header {letter}mumps_c.h was not found; get both with: {RANKS_HINT}"
    return path, header


@cache
def rank_library(dtype: str = "float64") -> Library | str:
    """The parallel MUMPS of the system in a process of MPI, or why there is none."""
    files = rank_files(dtype)
    if isinstance(files, str):
        return files
    path, header = files
    letter = ARITHMETIC[dtype]
    try:
        refuse_wide_integers(header)
        version, layout = parse_header(header.read_text(encoding="latin-1"), letter)
        function = getattr(open_deep(path), f"{letter}mumps_c")
    except (UnusableError, OSError, AttributeError) as error:
        return f"{path} cannot be used: {error}; get it with: {RANKS_HINT}"
    function.restype = None
    return Library(path, version, layout, function)


@cache
def casadi_folder() -> Path | None:
    """Folder of the CasADi package, found without the seconds that importing it takes."""
    spec = importlib.util.find_spec("casadi")
    locations = list(spec.submodule_search_locations or []) if spec else []
    return Path(locations[0]) if locations else None


def casadi_file(folder: Path) -> Path | None:
    """The MUMPS library in the folder of the CasADi package, under any name that this system gives it."""
    library = re.compile(r"\.so(\.\d+)?$|\.dylib$|\.dll$")
    paths = [path for path in folder.glob("libcoinmumps*") if library.search(path.name)]
    # The one with the number of its interface is the one that CasADi itself loads: sharing it keeps a
    # second copy out of the process.
    return max(paths, key=lambda path: len(path.name), default=None)


@cache
def embedded_library(dtype: str = "float64") -> Library | str:
    """The MUMPS inside the CasADi wheel, or why it cannot be used."""
    if dtype != "float64":
        return f"the MUMPS of CasADi has no {dtype} arithmetic; get one that has it with: {SYSTEM_HINT}"
    folder = casadi_folder()
    path = casadi_file(folder) if folder else None
    if folder is None or path is None:
        return f"the CasADi package with its MUMPS library is not installed; get it with: {EMBEDDED_HINT}"
    headers = folder / "include" / "coin-or" / "mumps"
    if not (headers / "dmumps_c.h").is_file():
        return f"{path.name} of CasADi has no header dmumps_c.h; get a complete one with: {EMBEDDED_HINT}"
    try:
        # Its own OpenBLAS must not mix with another one whose symbols are global (an older one lacks
        # DGEMMT): the two share internal names, and the factor came out wrong without an error.
        library = _open(str(path), headers, "d", low_rank=True)
        other = hasattr(library.structure, "keep") and rebind(open_deep(str(path)), scipy_blas())
        return replace(library, other_blas=other)
    except UnusableError as error:
        return f"{path.name} of CasADi cannot be used: {error}"
