"""MATLAB files of version 5 (v6, v7): matrices of numbers, full or sparse (MAT-File Format, The MathWorks, 2023).

The reader of SciPy trusts the file and ends the process where a type or an index is damaged, so it is not used here.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import BinaryIO

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.memory import refuse_too_large
from morembs.base.types import Values
from morembs.importers.matrices.hdf5 import checked_csc


class Header:
    """First bytes of a file (MathWorks, MAT-File Format, level 5): places of the version and of the byte order."""

    VERSION = slice(124, 126)
    BYTE_ORDER = slice(126, 128)
    BYTES = 128


class Element(IntEnum):
    """Types of data elements that hold variables (the same manual); ``_STORED`` are those of numbers."""

    MATRIX = 14
    COMPRESSED = 15


class Class(IntEnum):
    """Classes of arrays (the same manual) beside those of ``_FULL`` and ``_KINDS``."""

    SPARSE = 5
    OPAQUE = 17


class Bits:
    """Bits of the flags of an array, and of a tag whose numbers stand in it (the same manual)."""

    CLASS = 0xFF
    LOGICAL = 0x200
    COMPLEX = 0x800
    SMALL_TYPE = 0xFFFF
    SMALL_COUNT = 16


# Types of stored numbers, and of the arrays that they stand for.
_STORED = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    16: "u1",
    17: "u2",
    18: "u4",
}
_FULL = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_KINDS = {1: "cell", 2: "struct", 3: "object", 4: "text", 16: "function", 17: "object"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """Matrices of a file by name, and what else it holds (name -> kind)."""

    matrices: dict[str, Values | sp.csr_array]
    other: dict[str, str]


def read_matlab_v5(path: Path) -> Held:
    """All full and sparse matrices of a file, real or complex. Memory is that of the matrices and of one variable.

    Raises:
        InputError: not such a file, cut off or damaged, or two variables of one name.
    """
    held = Held(matrices={}, other={})
    with path.open("rb") as file:
        head = file.read(Header.BYTES)
        order = {b"IM": "<", b"MI": ">"}.get(head[Header.BYTE_ORDER])
        if len(head) < Header.BYTES or order is None or struct.unpack(order + "H", head[Header.VERSION])[0] >> 8 != 1:
            raise _unreadable(path.name, "its first 128 bytes are not those of such a file")
        for body in _variables(file, order, path.name):
            name, value = _variable(_Reader(body, order, path.name))
            if not name or name.startswith("__"):
                continue
            if name in held.matrices or name in held.other:
                raise _unreadable(path.name, f"two variables are named {name!r}")
            if isinstance(value, str):
                held.other[name] = value
            else:
                held.matrices[name] = value
    return held


def _unreadable(name: str, why: str) -> InputError:
    return InputError(f"{name} cannot be read as a MATLAB file ({why}); save it again", kind="file")


def _variables(file: BinaryIO, order: str, name: str) -> Iterator[bytes]:
    """The elements of each variable, unpacked."""
    while tag := file.read(8):
        if len(tag) < 8:
            raise _unreadable(name, "it ends within a variable")
        kind, count = struct.unpack(order + "II", tag)
        if kind not in (Element.MATRIX, Element.COMPRESSED):
            raise _unreadable(name, f"an element is of the type {kind}, where a variable was expected")
        body = file.read(count)
        if len(body) < count:
            raise _unreadable(name, "it ends within a variable")
        if kind == Element.COMPRESSED:
            body = _unpack(body, order, name)
        yield body


def _unpack(body: bytes, order: str, name: str) -> bytes:
    try:
        packed = zlib.decompressobj()
        tag = packed.decompress(body, 8)
        count = struct.unpack(order + "II", tag)[1] if len(tag) == 8 else 0
        refuse_too_large(name, count)
        whole = tag + packed.decompress(packed.unconsumed_tail, count + 1)
    except zlib.error as error:
        raise _unreadable(name, f"a packed variable is damaged: {error}") from error
    if len(whole) < 8 or struct.unpack(order + "II", whole[:8]) != (Element.MATRIX, len(whole) - 8):
        raise _unreadable(name, "a packed variable is damaged")
    return whole[8:]


class _Reader:
    """Elements of a variable, one behind the other."""

    def __init__(self, body: bytes, order: str, name: str) -> None:
        self.body, self.order, self.name, self.at = body, order, name, 0

    def numbers(self, what: str, stored_as: str | None = None) -> Values:
        """The numbers of the next element as they are stored, or as ``stored_as`` whatever the element says."""
        tag = self.body[self.at : self.at + 8]
        if len(tag) < 8:
            raise _unreadable(self.name, f"a variable ends before its {what}")
        first, count = struct.unpack(self.order + "II", tag)
        start, step = self.at + 8, 8 + -(-count // 8) * 8
        if first >> Bits.SMALL_COUNT:  # up to four bytes stand in the tag itself
            first, count, start, step = first & Bits.SMALL_TYPE, first >> Bits.SMALL_COUNT, self.at + 4, 8
        stored = _STORED.get(first)
        if stored is None or (step == 8 and count > 4) or start + count > len(self.body):
            raise _unreadable(self.name, f"the {what} of a variable are damaged")
        kind = np.dtype(self.order + (stored_as or stored))
        if count % kind.itemsize:
            raise _unreadable(self.name, f"the {what} of a variable are damaged")
        self.at += step
        return np.frombuffer(self.body, dtype=kind, count=count // kind.itemsize, offset=start)


def _variable(reader: _Reader) -> tuple[str, Values | sp.csr_array | str]:
    """Name and matrix of a variable, or its kind in words."""
    if not reader.body:
        return "", "nothing"
    flags = reader.numbers("flags")
    if len(flags) != 2:
        raise _unreadable(reader.name, "the flags of a variable are damaged")
    bits = int(flags[0])
    kind, complex_, logical = bits & Bits.CLASS, bool(bits & Bits.COMPLEX), bool(bits & Bits.LOGICAL)
    if kind == Class.OPAQUE:  # an object of a class has its name here and no size
        return _text(reader.numbers("name")), _KINDS[kind]
    size = tuple(int(n) for n in reader.numbers("size"))
    name = _text(reader.numbers("name"))
    if kind not in _FULL and kind != Class.SPARSE:
        if kind not in _KINDS:
            raise _unreadable(reader.name, f"{name[:40]!r} is of the unknown kind {kind}")
        return name, _KINDS[kind]
    if len(size) != 2 or min(size) < 0:
        return name, f"array of the size {size}"
    shape = (size[0], size[1])
    if kind == Class.SPARSE:
        # Sparse matrices of yes and no are bytes that are called doubles.
        return name, _sparse(reader, name, shape, complex_, "u1" if logical else None)
    return name, _full(reader, name, shape, kind, complex_)


def _text(codes: Values) -> str:
    return bytes(codes.astype(np.uint8)).decode("utf-8", "replace")


def _values(reader: _Reader, complex_: bool, stored_as: str | None = None) -> Values:
    real = reader.numbers("values", stored_as)
    if not complex_:
        return real
    imaginary = reader.numbers("imaginary values")
    if len(imaginary) != len(real):
        raise _unreadable(reader.name, "a variable has other counts of real and imaginary values")
    return np.asarray(real + 1j * imaginary)


def _full(reader: _Reader, name: str, shape: tuple[int, int], kind: int, complex_: bool) -> Values:
    values = _values(reader, complex_)
    if len(values) != shape[0] * shape[1]:
        raise _unreadable(reader.name, f"{name!r} has {len(values)} values for the size {shape}")
    return values.astype(np.complex128 if complex_ else _FULL[kind]).reshape(shape, order="F")


def _sparse(reader: _Reader, name: str, shape: tuple[int, int], complex_: bool, stored_as: str | None) -> sp.csr_array:
    rows, start = reader.numbers("rows"), reader.numbers("columns")
    values = _values(reader, complex_, stored_as)
    if rows.dtype.kind not in "iu" or start.dtype.kind not in "iu" or not len(start):
        raise _unreadable(reader.name, f"the rows of {name!r} are damaged")
    # There may be room for more entries than there are.
    used = max(0, min(int(start[-1]), len(values)))
    rows, values = rows[:used].astype(np.int64), values[:used].astype(np.complex128 if complex_ else np.float64)
    return checked_csc(f"{reader.name}: {name}", values, rows, start.astype(np.int64), shape)
