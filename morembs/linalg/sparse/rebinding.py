"""Has a loaded library call the BLAS of SciPy in place of its own.

The OpenBLAS in the packages of CasADi is built for one processor of 2006 (its core is CORE2), where others choose among
kernels when they are loaded: its products take two to three times as long. On systems with ELF a library calls others
through a table of addresses, which is filled when it is loaded (System V ABI, procedure linkage table). The entries of
the BLAS in it are replaced by the functions that SciPy publishes for other programs (``scipy.linalg.cython_blas``).
Where anything is not as expected the table is left alone, and the library as fast as it was.
"""

from __future__ import annotations

import ctypes
import platform
import sys
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any

# Type of the relocations of that table, by processor.
_JUMP_SLOT = {"x86_64": 7, "aarch64": 1026}
# What ``dlinfo`` is asked for (dlfcn.h).
_REQUESTS = {"RTLD_DI_LINKMAP": 2}
# All that MUMPS spends its time in.
BLAS = ("dgemm", "dtrsm", "dgemv", "daxpy", "dcopy", "dscal", "dswap")


class _Tag(IntEnum):
    """Tags of the dynamic section: bytes of the table of relocations, names, symbols, and that table."""

    SIZE = 2
    NAMES = 5
    SYMBOLS = 6
    RELOCATIONS = 23


class _LinkMap(ctypes.Structure):
    _fields_ = (("base", ctypes.c_uint64), ("name", ctypes.c_char_p), ("dynamic", ctypes.c_uint64))


class _Relocation(ctypes.Structure):
    _fields_ = (("offset", ctypes.c_uint64), ("info", ctypes.c_uint64), ("addend", ctypes.c_int64))


class _Symbol(ctypes.Structure):
    _fields_ = (("name", ctypes.c_uint32), ("rest", ctypes.c_char * 20))


def scipy_blas() -> dict[str, int]:
    """Addresses of functions of SciPy's BLAS by their names in Fortran; empty where they are not published."""
    from scipy.linalg import cython_blas

    python = ctypes.pythonapi
    name_of, address_of = python.PyCapsule_GetName, python.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    address_of.restype, address_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    capsules: Mapping[str, Any] = getattr(cython_blas, "__pyx_capi__", {})
    if not set(BLAS) <= set(capsules):
        return {}
    return {f"{name}_": address_of(capsules[name], name_of(capsules[name])) for name in BLAS}


def find_slots(library: ctypes.CDLL) -> dict[str, int]:
    """Where the table of ``library`` keeps the address of each function of others; empty where that is not known."""
    kind = _JUMP_SLOT.get(platform.machine())
    if not sys.platform.startswith("linux") or kind is None or sys.maxsize < 2**32:
        return {}
    place = ctypes.POINTER(_LinkMap)()
    try:
        failed = ctypes.CDLL(None).dlinfo(
            ctypes.c_void_p(library._handle), _REQUESTS["RTLD_DI_LINKMAP"], ctypes.byref(place)
        )
    except (AttributeError, TypeError):  # a loader of another kind
        return {}
    if failed:
        return {}
    base, tags, at = place.contents.base, dict[int, int](), place.contents.dynamic
    while tag := ctypes.c_int64.from_address(at).value:
        tags[tag] = ctypes.c_uint64.from_address(at + 8).value
        at += 16
    if not set(_Tag) <= set(tags):
        return {}
    # Some loaders leave addresses in the section as they are in the file.
    names, symbols, table = (
        tags[tag] if tags[tag] >= base else base + tags[tag] for tag in (_Tag.NAMES, _Tag.SYMBOLS, _Tag.RELOCATIONS)
    )
    known = {}
    for entry in (_Relocation * (tags[_Tag.SIZE] // ctypes.sizeof(_Relocation))).from_address(table):
        # The lower half of r_info is the type of the relocation (ELF64_R_TYPE).
        if entry.info & 0xFFFFFFFF == kind:
            symbol = _Symbol.from_address(symbols + ctypes.sizeof(_Symbol) * (entry.info >> 32))
            known[ctypes.string_at(names + symbol.name).decode("ascii", "replace")] = base + entry.offset
    return known


def rebind(library: ctypes.CDLL, functions: Mapping[str, int]) -> bool:
    """Have ``library`` call ``functions`` (name -> address) in place of those of these names; whether it does now.

    Nothing is changed where it does not call all of them, or where its table cannot be written any more.
    """
    places = find_slots(library)
    if not functions or not set(functions) <= set(places) or not _writable([places[name] for name in functions]):
        return False
    for name, address in functions.items():
        ctypes.c_uint64.from_address(places[name]).value = address
    return True


def _writable(places: list[int]) -> bool:
    """True if all ``places`` lie in memory that this process may write."""
    try:
        lines = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return False
    spans = [tuple(int(end, 16) for end in line.split()[0].split("-")) for line in lines if line.split()[1][1] == "w"]
    return all(any(low <= place < high for low, high in spans) for place in places)
