"""Small tables of numbers that users write as CSV: a header of names, rows below."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from morembs.base.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def read_table(
    path: Path, needed: Sequence[str] = (), optional: Sequence[str] | None = (), *, what: str = "the table"
) -> dict[str, NDArray[np.float64]]:
    """Columns (k,) by their names: those ``needed`` in that order, then the ``optional`` ones that are there.

    ``optional`` None takes any name. Empty rows and comments, which begin with #, are left out.

    Raises:
        InputError: no such file or rows, other columns, or a row that is not of as many finite numbers.
    """
    # Not at the top: the command line reads no table for its help.
    import numpy as np

    where = f"{what} {path}"
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            # Before they are split: a quotation mark in a comment would take the rows below it along.
            lines = [line for line in file if not line.lstrip().startswith("#")]
        rows = [row for row in csv.reader(lines, skipinitialspace=True, strict=True) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{where} cannot be read ({error}); check the path", kind="file", keyword="table") from error
    header = [name.strip() for name in rows.pop(0)] if rows else []
    known = header if optional is None else [*needed, *optional]
    if not rows or set(needed) - set(header) or set(header) - set(known) or len(set(header)) < len(header):
        more = f" ({','.join(optional)} if known)" if optional else ""
        raise InputError(
            f"{where} has the columns {','.join(header) or 'none'} above {len(rows)} rows; expected "
            f"{','.join(needed) or 'NAME,NAME'}{more}, each name once, and rows of numbers below",
            keyword="columns",
        )
    numbers = np.array([_numbers(row, header, f"{where}, row {k} below its header") for k, row in enumerate(rows, 1)])
    order = [*needed, *(name for name in header if name not in needed)]
    return {name: numbers[:, header.index(name)] for name in order}


def _numbers(row: list[str], header: list[str], where: str) -> list[float]:
    expected = f"expected {len(header)} finite numbers with points for decimals: {','.join(header)}"
    if len(row) != len(header):
        raise InputError(f"{where} has {len(row)} values; {expected}", keyword="columns")
    try:
        numbers = [float(cell) for cell in row]
    except ValueError as error:
        raise InputError(f"{where}: {error}; {expected}") from error
    if not all(map(math.isfinite, numbers)):
        raise InputError(f"{where} is {','.join(row)}; {expected}", keyword="values")
    return numbers
