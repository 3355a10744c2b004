"""Numbers in text, read fast: the parts that readers of matrices in text files share.

Numbers are turned from text by SciPy's Matrix Market reader (Lugowski's fast_matrix_market), which is about ten
times as fast as ``numpy.loadtxt`` but skips text that it does not recognise ("1.0+3" is 1.0 to it). So every block is
checked first: no letters but exponents, exponents as C writes them, the same count of numbers in each line.
"""

from __future__ import annotations

import gzip
import io
import os
import re
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.tolerances import TOL

_ALLOWED = b"0123456789+-.eEdD \t\r\n,"
_ONE_PER_LINE = bytes.maketrans(b" ,\t\rDde", b"\n\n\n\nEEE")
_BLANKS = bytes.maketrans(b",\t\rDd", b"   EE")
_INT32 = np.iinfo(np.int32).max
_NEWLINE = ord("\n")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_IMPLIED = re.compile(rb"([0-9.])([+-])")
_NUMBER = re.compile(rb"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(E[+-]?[0-9]+)?")
# Which character may follow which in a number: digit, dot, sign, exponent, end.
_CLASS = bytes.maketrans(b"0123456789.+-E\n", b"\0" * 10 + b"\1\2\2\3\4")
_FOLLOWS = {0: (0, 1, 2, 3, 4), 1: (0, 2, 3, 4), 2: (0, 1), 3: (0, 2), 4: (0, 1, 2, 4)}
_PAIRS = bytes(8 * left + right for left, rights in _FOLLOWS.items() for right in rights)
# A sign behind a digit or a dot.
_SIGN_BEHIND_DIGIT = tuple(8 * left + 2 for left in (0, 1))
Given = TypeVar("Given")
Made = TypeVar("Made")


def text_blocks(path: Path, size: int = TOL.text_block_bytes) -> Iterator[bytes]:
    """Blocks of whole lines, about ``size`` bytes each, of a text that may be packed (gzip).

    Raises:
        InputError: the file is missing, empty, binary, or ends within a line.
    """
    for block in _line_blocks(path, size):
        if b"\0" in block:
            raise InputError(
                f"{path.name} holds binary data where text was expected; check the file and its format",
                kind="file",
                keyword=path.name,
            )
        yield block


def _line_blocks(path: Path, size: int) -> Iterator[bytes]:
    rest = b""
    with open_lines(path) as file:
        for chunk in _chunks(file, size, path.name):
            cut = chunk.rfind(b"\n") + 1
            if cut:
                yield rest + chunk[:cut]
                rest = chunk[cut:]
            else:
                rest += chunk
                if len(rest) > 4 * size or b"\0" in rest:
                    raise InputError(
                        f"{path.name} is not a text of lines; check the file and its format",
                        kind="file",
                        keyword=path.name,
                    )
    if rest.strip():
        if _CONTROL.search(rest):
            raise InputError(
                f"{path.name} is not a text of lines; check the file and its format", kind="file", keyword=path.name
            )
        raise InputError(
            f"{path.name} ends within a line ({rest[-40:].decode('latin-1')!r}), so its last number may be cut off; "
            "write it again, or end the last line if the file is complete",
            kind="file",
            keyword=path.name,
        )


def _chunks(file: io.BufferedReader, size: int, name: str) -> Iterator[bytes]:
    """The bytes of a file, unpacked where it is a gzip file."""
    if file.peek(2)[:2] != b"\x1f\x8b":
        while chunk := file.read(size):
            yield chunk
        return
    try:
        with gzip.GzipFile(fileobj=file) as unpacked:
            while chunk := unpacked.read(size):
                yield chunk
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            f"{name} cannot be read: it is cut off or not a gzip file ({error}); pack it again", kind="file"
        ) from error


def parallel_map(work: Callable[[Given], Made], blocks: Iterable[Given]) -> Iterator[Made]:
    """``work(block)`` for each block in order, done by threads before it is asked for.

    What reads numbers from text lets other threads run meanwhile. As many blocks as there are cores are in memory.
    """
    count = min(os.cpu_count() or 1, TOL.reading_threads)
    with ThreadPoolExecutor(count) as pool:
        waiting: deque[Future[Made]] = deque()
        try:
            for block in blocks:
                waiting.append(pool.submit(work, block))
                if len(waiting) > count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def open_lines(path: Path) -> io.BufferedReader:
    """The file, open for reading bytes.

    Raises:
        InputError: it is missing, not a file, or empty.
    """
    if not path.is_file():
        what = "is not a file" if path.exists() else "does not exist"
        raise InputError(f"matrix file {str(path)!r} {what}; check the path", kind="file", keyword=path.name)
    if path.stat().st_size == 0:
        raise InputError(f"matrix file {str(path)!r} is empty; write it again", kind="file", keyword=path.name)
    try:
        return open(path, "rb")
    except OSError as error:
        raise InputError(f"matrix file {str(path)!r} cannot be opened: {error.strerror}", kind="file") from error


def numbers(block: bytes, name: str) -> Floats:
    """All numbers (k,) of a block of text, separated by blanks, commas or ends of lines.

    Exponents may be written 1E3, 1D3 or 1+3.

    Raises:
        InputError: something is not a finite number; ``name`` is that of the file.
    """
    return _parse(_separate(block, name), name)


def table(block: bytes, columns: int, name: str) -> Floats:
    """Numbers (lines, ``columns``) of a block of whole lines; empty lines are left out.

    Raises:
        InputError: a line has more or fewer numbers, or something is not a finite number.
    """
    text = _separate(block, name)
    codes = np.frombuffer(text, dtype=np.uint8)
    blank = codes == _NEWLINE
    starts = np.flatnonzero(~blank & np.concatenate([[True], blank[:-1]]))
    ends = np.flatnonzero(np.frombuffer(block, dtype=np.uint8) == _NEWLINE)
    if len(text) != len(block):  # signs were put in or taken out, so places differ
        return _irregular(block, columns, name)
    if len(starts) % columns == 0:
        rows = starts.reshape(-1, columns)
        if len(rows) == len(ends) and (rows[:, -1] < ends).all() and (ends[:-1] < rows[1:, 0]).all():
            pairs = _triplets(block, len(rows)) if columns == 3 else None
            return _parse(text, name, len(starts)).reshape(-1, columns) if pairs is None else pairs
    return _irregular(block, columns, name)


def _triplets(block: bytes, count: int) -> Floats | None:
    """Checked lines "row column value" at once, about twice as fast; None if rows or columns are not above 0."""
    # Not at the top, where it would cost every command its memory.
    from scipy.io import mmread

    header = b"%%%%MatrixMarket matrix coordinate real general\n%d %d %d\n" % (_INT32, _INT32, count)
    try:
        triplets = mmread(io.BytesIO(header + block.translate(_BLANKS)), spmatrix=False)
    except (ValueError, OverflowError):
        return None
    if not np.isfinite(triplets.data).all():
        return None
    return np.column_stack([triplets.row + 1.0, triplets.col + 1.0, triplets.data])


def _irregular(block: bytes, columns: int, name: str) -> Floats:
    """What ``table`` gives, line by line: for blocks with empty lines or faults."""
    lines = [line for line in block.split(b"\n") if line.strip(b" ,\t\r")]
    for line in lines:
        count = len(line.replace(b",", b" ").split())
        if count != columns:
            raise InputError(
                f"{name}: the line {line.decode('latin-1').strip()[:60]!r} has {count} numbers; expected {columns}",
                kind="file",
                keyword=name,
            )
    return _parse(_separate(b"\n".join(lines) + b"\n", name), name).reshape(-1, columns)


def _separate(block: bytes, name: str) -> bytes:
    """The text with one number per line and exponents as 1E3."""
    strange = block.translate(None, _ALLOWED)
    if strange:
        line = next((x for x in block.split(b"\n") if strange[:1] in x), strange[:40])
        raise InputError(
            f"{name}: {line.decode('latin-1').strip()[:60]!r} cannot be read as numbers; expected finite numbers only",
            kind="file",
            keyword=name,
        )
    text = block.translate(_ONE_PER_LINE)
    if not text.endswith(b"\n"):
        text += b"\n"
    pairs = _neighbours(text)
    # A sign stands behind a blank or an E; behind a digit it starts an exponent, as Nastran writes it.
    if any(pair in pairs for pair in _SIGN_BEHIND_DIGIT):
        text = _IMPLIED.sub(rb"\1E\2", text)
        pairs = _neighbours(text)
    marks = text.translate(None, b"0123456789+-")
    if pairs.translate(None, _PAIRS) or b".." in marks or b"E." in marks or b"EE" in marks:
        raise InputError(
            f"{name}: {_first_fault(text)!r} cannot be read as a number; check the file", kind="file", keyword=name
        )
    if b"+" in text and (b"\n+" in text or text.startswith(b"+")):
        text = text.replace(b"\n+", b"\n").removeprefix(b"+")
    return text


def _neighbours(text: bytes) -> bytes:
    """For each character and the next the pair of their classes."""
    classes = np.frombuffer(text.translate(_CLASS), dtype=np.uint8)
    return ((classes[:-1] << 3) | classes[1:]).tobytes()


def _parse(text: bytes, name: str, count: int | None = None) -> Floats:
    if count is None:
        blank = np.frombuffer(text, dtype=np.uint8) == _NEWLINE
        count = int((~blank & np.concatenate([np.ones(min(1, len(blank)), dtype=bool), blank[:-1]])).sum())
    if not count:
        return np.empty(0)
    from scipy.io import mmread

    header = b"%%%%MatrixMarket matrix array real general\n%d 1\n" % count
    try:
        values = np.asarray(mmread(io.BytesIO(header + text))).ravel()
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"{name}: {_first_fault(text)!r} cannot be read as a number; check the file", kind="file"
        ) from error
    if not np.isfinite(values).all():
        raise InputError(
            f"{name} holds a number that is too large for double precision; expected finite numbers",
            kind="file",
            keyword=name,
        )
    return values


def _first_fault(text: bytes) -> str:
    words = (word for word in text.split(b"\n") if word)
    return next((word for word in words if not _NUMBER.fullmatch(word)), text[:40]).decode("latin-1")


def integers(values: Floats, what: str, name: str) -> Ints:
    """``values`` as integers.

    Raises:
        InputError: a value is no integer; ``what`` names the values.
    """
    result = values.astype(np.int64, casting="unsafe") if (np.abs(values) < TOL.largest_label).all() else None
    if result is None or not np.array_equal(result, values):
        bad = values[(np.abs(values) >= TOL.largest_label) | (values != np.round(values))][0]
        raise InputError(f"{name}: {bad:.6g} was given as {what}; expected an integer", kind="file", keyword=name)
    return result
