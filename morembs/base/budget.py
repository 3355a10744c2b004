"""The resident memory that a process may use, and the disk for what does not fit.

Large arrays can live in scratch files that are mapped into memory. ``release_pages`` gives their pages back:
the values stay in the file (and in the cache of the operating system), the resident memory of the process falls.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import weakref
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import DTypeLike

from morembs.base.closing import Closing
from morembs.base.errors import OutputError
from morembs.base.memory import resident_bytes, trim
from morembs.base.scratch import ScratchFolder
from morembs.base.tolerances import TOL
from morembs.base.types import Values


@dataclass(frozen=True)
class _Mapped:
    """A scratch file of ``size`` bytes at ``path``, and what was resident when it was made; its array may be gone."""

    map: weakref.ref[mmap.mmap]
    path: Path
    size: int
    beside: int


def is_in_file(array: Values) -> bool:
    """True if ``array`` is mapped from a scratch file.

    Whole columns of such an array are read, not rows across all columns: one page that is read makes up to 2 MB around
    it resident where the system keeps files in large folios (Linux 6.18, ext4).
    """
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base, mmap.mmap)


def memory_that_leaves(room: int, used: int) -> int:
    """Memory under which ``room`` bytes are left of a process that has ``used`` ones beside arrays, whatever arrays of
    ``TOL.tight_array_bytes`` bytes or more it has: the last that stays in memory takes what is left from
    ``TOL.tight_share`` of it."""
    return max(room + used, math.ceil((room + TOL.array_bytes) / TOL.tight_share))


_CURRENT: ContextVar[tuple[Budget, ...]] = ContextVar("budgets", default=())


def current_budget() -> Budget:
    """The budget of the innermost ``with Budget(...)`` around this; without one there are no limits.

    What needs one takes it where it is made, and keeps it after the block and in other threads.
    """
    stack = _CURRENT.get()
    return stack[-1] if stack else UNLIMITED


@dataclass(eq=False)
class Budget(Closing):
    """What a process may use. A context manager: what is made inside keeps to it.

    >>> with Budget(memory=4_000_000_000):
    ...     problem = Problem(model, interfaces)

    ``memory`` in bytes for the whole process (None: no limit), ``scratch`` for its files (None: the temporary folder of
    the system). ``in_memory``: bytes of the largest array that stays in memory (None: chosen by ``memory``; 0 puts all
    arrays on disk). ``widest``: most columns of a block, however much memory there is.
    """

    memory: int | None = None
    scratch: Path | None = None
    in_memory: int | None = None
    widest: int = TOL.most_columns
    _folder: ScratchFolder | None = field(default=None, repr=False)
    _mapped: list[_Mapped] = field(default_factory=list, repr=False)
    _count: int = field(default=0, repr=False)

    def __enter__(self) -> Self:
        _CURRENT.set((*_CURRENT.get(), self))
        return self

    def __exit__(self, *_: object) -> None:
        _CURRENT.set(_CURRENT.get()[:-1])
        self.close()

    @contextlib.contextmanager
    def in_use(self) -> Iterator[None]:
        """Have what is made inside keep to this budget, which stays open."""
        _CURRENT.set((*_CURRENT.get(), self))
        try:
            yield
        finally:
            _CURRENT.set(_CURRENT.get()[:-1])

    def bytes_left(self) -> int | None:
        """Bytes that may still be allocated; None without a limit."""
        return None if self.memory is None else self.memory - resident_bytes()

    @property
    def files(self) -> int:
        """How many arrays live in scratch files."""
        return len(self._used())

    def columns(self, n: int, copies: int = 4, widest: int | None = None, *, wide: bool = False) -> int:
        """How many columns of length ``n`` to handle at once when ``copies`` of them exist; a power of two.

        ``wide``: as many as there is room for, once the pages of arrays in files have been given back.
        """
        if wide:
            self.release_pages()
        left, widest = self.bytes_left(), min(self.widest, self.widest if widest is None else widest)
        if left is None:
            return widest
        width = int((TOL.wide_block_share if wide else TOL.block_share) * max(left, 0) / (8 * n * copies))
        return max(4, min(widest, width if wide else 1 << max(width, 1).bit_length() - 1))

    def read_at_once(self, n: int) -> int:
        """How many columns of length ``n`` a product reads at once, whatever is in memory by then."""
        if self.memory is None:
            return TOL.most_read_columns
        return max(4, min(TOL.most_read_columns, int(TOL.read_share * self.memory / (8 * n))))

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike = np.float64, order: str = "C") -> Values:
        """An array of zeros or of nothing in particular, in memory or in a scratch file.

        Raises:
            OutputError: the scratch folder is full.
        """
        kind = np.dtype(dtype)
        size = int(np.prod(shape)) * kind.itemsize
        if size <= self._largest():
            return np.zeros(shape, dtype=kind, order="F" if order == "F" else "C")
        return np.ndarray(shape, dtype=kind, buffer=self._map(size), order="F" if order == "F" else "C")

    @property
    def _unlimited(self) -> bool:
        return self.memory is None and self.in_memory is None

    def raise_for(self, more: int) -> int:
        """Bytes by which to raise the memory for ``more`` to be left now: under a larger budget some of the arrays that
        are in files stay in memory, and take their part of it."""
        staying = -1
        while (larger := self._bytes_in_memory(more + max(staying, 0))) > staying:
            staying = larger
        return more + staying

    def _bytes_in_memory(self, more: int) -> int:
        """Bytes of the arrays in files that would have stayed in memory with ``more`` bytes of it, at most."""
        # Pages of earlier arrays in files were resident too, so these need not be added.
        return sum(array.size for array in self._used() if array.size <= self._largest(more, array.beside))

    def _largest(self, more: int = 0, resident: int | None = None) -> float:
        """Bytes of the largest array that stays in memory: many small ones are a large one.

        With ``more`` bytes of it, and ``resident`` ones in use (None: now).
        """
        if self.in_memory is not None:
            return self.in_memory
        if self.memory is None:
            return math.inf
        memory, used = self.memory + more, resident_bytes() if resident is None else resident
        if memory - used < TOL.tight_share * memory:
            return TOL.tight_array_bytes
        return max(TOL.array_bytes, TOL.array_share * memory)

    def store(self, array: Values) -> Values:
        """``array``, or a copy of it in a scratch file where the budget wants that."""
        if self._unlimited:
            return array
        copy = self.empty(array.shape, array.dtype, "F" if array.flags.f_contiguous else "C")
        copy[...] = array
        return copy

    def release_pages(self) -> None:
        """Give back the pages of all arrays in files, and memory that was freed but still counts as resident."""
        if self._unlimited:
            return
        for array in self._used():
            mapped = array.map()
            if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
                mapped.madvise(mmap.MADV_DONTNEED)
        trim()

    def room_for_factor(self) -> int | None:
        """Bytes that a factorisation may take once all pages that can be released are; None without a limit."""
        self.release_pages()
        left = self.bytes_left()
        return None if left is None else max(0, left)

    def release_if_tight(self) -> None:
        """``release_pages`` where the budget is nearly used up: for loops over large arrays."""
        left = self.bytes_left()
        if left is not None and self._mapped and left < TOL.tight_share * (self.memory or 0):
            self.release_pages()

    def __getstate__(self) -> dict[str, Any]:
        # Another process gets the limits; files it makes are its own.
        return {**self.__dict__, "_folder": None, "_mapped": [], "_count": 0}

    def close(self) -> None:
        """Remove the files; arrays in them stay readable as long as somebody holds them."""
        self._mapped.clear()
        if self._folder is not None:
            self._folder.close()
            self._folder = None

    def _used(self) -> list[_Mapped]:
        """The files whose arrays somebody holds; others go, where they could not lose their names before."""
        for array in self._mapped:
            if array.map() is None:
                _unlink(array.path)
        self._mapped = [array for array in self._mapped if array.map() is not None]
        return self._mapped

    def _map(self, size: int) -> mmap.mmap:
        if self._folder is None:
            self._folder = ScratchFolder(self.scratch)
        self._used()
        self._count += 1
        path = self._folder.path / f"array-{self._count}"
        with open(path, "w+b") as file:
            try:
                _reserve(file, size)
            except OSError as error:
                raise OutputError(
                    f"the scratch folder {self._folder.path.parent} has no room for {size / 1e9:.2f} GB more "
                    f"({error.strerror}); make room, or give another scratch folder or more memory",
                    keyword="scratch",
                ) from error
            mapped = mmap.mmap(file.fileno(), size)
        # Nothing needs the name any more: the file is gone as soon as nobody maps it.
        _unlink(path)
        self._mapped.append(_Mapped(weakref.ref(mapped), path, size, resident_bytes()))
        return mapped


def _reserve(file: BinaryIO, size: int) -> None:
    """Take the space now: a full disk would otherwise end the process when a page is written."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    zeros = bytes(min(size, TOL.zeros_at_once))
    for first in range(0, size, len(zeros)):
        file.write(zeros[: size - first])
    file.flush()


def _unlink(path: Path) -> None:
    """Take away the name of a file; Windows refuses that while the file is mapped, and its folder keeps it then."""
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


UNLIMITED = Budget()
