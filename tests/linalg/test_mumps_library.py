"""The MUMPS libraries: structures read from headers, and what is refused before it can corrupt memory."""

from __future__ import annotations

import ctypes
import math
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from morembs.linalg.sparse import foreign, mumps_library
from morembs.linalg.sparse.foreign import open_deep
from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps
from morembs.linalg.sparse.mumps_codes import ARITHMETIC
from morembs.linalg.sparse.rebinding import BLAS, find_slots, rebind, scipy_blas
from morembs.linalg.sparse.symmetric import Lower
from tests.support.matrices import brick, random
from tests.support.refusals import refusal

HEADER = """
#define MUMPS_VERSION "5.9.9" /* a comment */
#define MUMPS_VERSION_MAX_LEN 30
typedef struct {
    MUMPS_INT sym, par, job; /* a; b */
    MUMPS_INT comm_fortran, icntl[60];  // not; this
    DMUMPS_REAL cntl[15], rinfog[40];
    MUMPS_INT n, nrhs, lrhs, nz_rhs, infog[80];
    MUMPS_INT8 nnz;
    MUMPS_INT *irn, *jcn, *perm_in, *irhs_sparse, *irhs_ptr, *pivnul_list, *listvar_schur;
    DMUMPS_COMPLEX *a, * rhs, *rhs_sparse, *schur;
    char version_number[MUMPS_VERSION_MAX_LEN + 1 + 1];
    char ooc_tmpdir[256], ooc_prefix[64];
} DMUMPS_STRUC_C;
"""
LOADERS = {"mumps": mumps_library.system_library, "mumps-embedded": mumps_library.embedded_library}


@pytest.mark.parametrize(
    ("letter", "real"), [("s", ctypes.c_float), ("d", ctypes.c_double), ("c", ctypes.c_float), ("z", ctypes.c_double)]
)
def test_structure_is_read_from_the_header(letter: str, real: type) -> None:
    version, layout = mumps_library.parse_header(HEADER.replace("DMUMPS", f"{letter.upper()}MUMPS"), letter)
    kinds = dict(layout._fields_)
    assert version == "5.9.9"
    assert [name for name, _ in layout._fields_][:4] == ["sym", "par", "job", "comm_fortran"]
    assert kinds["cntl"]._type_ is real and kinds["cntl"]._length_ == 15
    assert kinds["icntl"]._type_ is ctypes.c_int32 and kinds["icntl"]._length_ == 60
    assert kinds["nnz"] is ctypes.c_int64 and kinds["n"] is ctypes.c_int32
    assert kinds["version_number"]._type_ is ctypes.c_char and kinds["version_number"]._length_ == 32
    assert kinds["rhs"] is kinds["irn"] is kinds["pivnul_list"] is ctypes.c_void_p


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("MUMPS_INT8 nnz", "quad nnz", "quad nnz"),
        ("MUMPS_INT *irn", "MUMPS_INT **irn", "not understood"),
        ("ooc_prefix[64]", "ooc_prefix[SIZE]", "SIZE"),
        ("char ooc_tmpdir[256], ", "char ", "lacks ooc_tmpdir"),
        ("DMUMPS_STRUC_C", "OTHER", "no DMUMPS_STRUC_C"),
        ('#define MUMPS_VERSION "5.9.9"', "", "no MUMPS_VERSION"),
        ("nnz;", "nnz;\n#ifdef NEW\n MUMPS_INT more;\n#endif", "not understood"),
    ],
)
def test_unknown_headers_are_refused(old: str, new: str, reason: str) -> None:
    assert old in HEADER
    with pytest.raises(mumps_library.UnusableError, match=reason):
        mumps_library.parse_header(HEADER.replace(old, new))


def test_header_of_other_arithmetic_is_refused() -> None:
    with pytest.raises(mumps_library.UnusableError, match="no ZMUMPS_STRUC_C"):
        mumps_library.parse_header(HEADER, "z")


@pytest.mark.parametrize("name", list(LOADERS))
def test_header_of_another_version_is_refused(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if isinstance(library := LOADERS[name]("float64"), str):
        pytest.skip(library)
    parse = mumps_library.parse_header
    monkeypatch.setattr(mumps_library, "parse_header", lambda *given: ("5.0.0", parse(*given)[1]))
    reason = LOADERS[name].__wrapped__()
    assert isinstance(reason, str) and f"version 5.0.0, the library {library.version}" in reason


@pytest.mark.parametrize("file", ["mumps_int_def.h", "mumps_c_types.h"])
def test_64_bit_integers_are_refused(tmp_path: Path, file: str) -> None:
    (tmp_path / "dmumps_c.h").write_text(HEADER)
    header = tmp_path / "dmumps_c.h"
    (tmp_path / file).write_text("/*\n#define MUMPS_INTSIZE64\n*/\n#define MUMPS_INTSIZE32\n")
    mumps_library.refuse_wide_integers(header)
    (tmp_path / file).write_text("  # define MUMPS_INTSIZE64\n")
    with pytest.raises(mumps_library.UnusableError, match="64-bit"):
        mumps_library.refuse_wide_integers(header)


def test_missing_libraries_say_how_to_get_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    # No build of this environment.
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(mumps_library, "find_library", lambda name: None)
    reason = mumps_library.system_library.__wrapped__("complex64")
    assert "libcmumps_seq) was found" in reason and "apt-get install libmumps-seq-dev" in reason
    monkeypatch.setattr(mumps_library, "find_library", lambda name: "libc.so.6")
    assert "dmumps_c.h was not found" in mumps_library.system_library.__wrapped__(folders=(tmp_path,))
    (tmp_path / "dmumps_c.h").write_text(HEADER)
    assert "cannot be loaded" in mumps_library.system_library.__wrapped__(folders=(tmp_path,))
    monkeypatch.setattr(mumps_library, "casadi_folder", lambda: None)
    assert "pip install casadi" in mumps_library.embedded_library.__wrapped__()
    monkeypatch.setattr(mumps_library, "casadi_folder", lambda: tmp_path)
    (tmp_path / "libcoinmumps.so.3").write_text("")
    assert "no header dmumps_c.h" in mumps_library.embedded_library.__wrapped__()


def test_the_library_that_casadi_loads_itself_is_taken(tmp_path: Path) -> None:
    for name in ("libcoinmumps.so", "libcoinmumps.so.3", "libcoinmumps.a", "libcoinmumps.so.3.txt"):
        (tmp_path / name).write_text("")
    path = mumps_library.casadi_file(tmp_path)
    assert path is not None and path.name == "libcoinmumps.so.3"


def test_the_embedded_library_calls_the_blas_of_scipy() -> None:
    """By the table in memory; a factor that comes of it is checked with those of all solvers."""
    library = mumps_library.embedded_library("float64")
    if isinstance(library, str):
        pytest.skip(library)
    if not (sys.platform == "linux" and platform.machine() == "x86_64"):
        pytest.skip("only there the library is known to have a table that can be written")
    assert library.other_blas
    loaded, wanted = open_deep(library.path), scipy_blas()
    places = find_slots(loaded)

    def found() -> dict[str, int]:
        return {name: ctypes.c_uint64.from_address(places[name]).value for name in wanted}

    assert {f"{name}_" for name in BLAS} == set(wanted) and found() == wanted
    # What it does not call, and what cannot be written, leaves the table as it is.
    assert not rebind(loaded, {"dgemm_": 1, "not_there_": 1}) and not rebind(loaded, {})
    assert found() == wanted


def test_a_table_that_cannot_be_written_is_left_alone(tmp_path: Path) -> None:
    """Libraries linked for safety have a table that is read-only once they are loaded."""
    if not (sys.platform == "linux" and shutil.which("cc")):
        pytest.skip("no compiler (cc) for a library that is linked like that")
    source, library = tmp_path / "caller.c", tmp_path / "libcaller.so"
    source.write_text("double cos(double); double twice(double x) { return 2.0 * cos(x); }\n")
    for options, written in (["-Wl,-z,relro,-z,now"], False), (["-Wl,-z,lazy,-z,norelro"], True):
        subprocess.run(["cc", "-shared", "-fPIC", "-fno-builtin", *options, source, "-o", library, "-lm"], check=True)
        loaded = ctypes.CDLL(str(library))
        loaded.twice.restype, loaded.twice.argtypes = ctypes.c_double, [ctypes.c_double]
        sine = ctypes.cast(ctypes.CDLL("libm.so.6").sin, ctypes.c_void_p).value
        assert "cos" in find_slots(loaded) and sine is not None
        assert rebind(loaded, {"cos": sine}) == written
        assert loaded.twice(0.5) == pytest.approx(2 * (math.sin(0.5) if written else math.cos(0.5)), rel=1e-15)
        library = tmp_path / "libother.so"


def test_arithmetic_that_a_library_lacks_is_refused() -> None:
    assert "no float32 arithmetic" in mumps_library.embedded_library("float32")
    if EmbeddedMumps.unavailable():
        pytest.skip(EmbeddedMumps.unavailable())
    with refusal("value", "solver", "complex128"):
        EmbeddedMumps().analyse((1 + 1j) * brick(2), "complex-symmetric")


def test_a_solver_without_its_library_cannot_run() -> None:
    class Gone(Mumps):
        library = staticmethod(lambda dtype: "gone")

    with refusal("program", "solver"):
        Gone().factorize(brick(2))


def test_one_call_runs_at_a_time() -> None:
    """MUMPS keeps state in global variables; a call made inside another one, by the garbage collector, goes on."""
    running: list[int] = []
    most: list[int] = []
    # A second thread has come: to the lock, or past it.
    met = threading.Event()

    class Queue:
        """A lock as the libraries have it, which tells when somebody has to wait for it."""

        def __init__(self) -> None:
            self.lock = type(mumps_library.LOCK)()

        def __enter__(self) -> None:
            if not self.lock.acquire(blocking=False):
                met.set()
                self.lock.acquire()

        def __exit__(self, *_: object) -> None:
            self.lock.release()

    class Data(ctypes.Structure):
        _fields_ = (("job", ctypes.c_int32),)

    def work(reference: object) -> None:
        running.append(1)
        most.append(len(running))
        if len(running) > 1:
            met.set()
        assert met.wait(600.0)
        running.pop()
        if len(most) == 3:
            library.call(Data(), 1)

    library = mumps_library.Library("", "", Data, work, lock=Queue())
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda job: library.call(Data(), job), range(20)))
    assert len(most) == 21 and max(most) == 1


@pytest.mark.parametrize("dtype", list(ARITHMETIC))
def test_every_arithmetic_solves_to_its_own_accuracy(dtype: str) -> None:
    structure = "complex-symmetric" if dtype.startswith("complex") else "symmetric"
    precision = "single" if dtype in ("float32", "complex64") else "double"
    if reason := Mumps.lacks(precision, structure):
        pytest.skip(reason)
    A = brick(4) * ((1 + 0.5j) if structure == "complex-symmetric" else 1.0)
    b = random(192) * ((1 - 2j) if structure == "complex-symmetric" else 1.0)
    with Mumps(precision=precision).analyse(A, structure) as analysis:
        assert analysis.session.arithmetic == dtype
        x = analysis.factorize_unchecked(Lower.of(A)).solve(b)
    error = np.linalg.norm(A @ x - b) / np.linalg.norm(b)
    assert x.dtype == b.dtype and (error < 1e-13 if precision == "double" else 1e-9 < error < 1e-4)


def test_libraries_are_found_without_running_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which takes its time, and leaves a file where the run is killed."""
    started: list[object] = []
    monkeypatch.setattr(tempfile, "NamedTemporaryFile", lambda *_, **__: started.append(1))
    assert foreign.find_library("there_is_none") is None and not started
    assert (foreign.find_library("c") or "").startswith("libc.so")
    (tmp_path / "libown.so").write_bytes(b"")
    monkeypatch.setenv("LD_LIBRARY_PATH", f":{tmp_path}")
    assert foreign.find_library("own") == str(tmp_path / "libown.so")
