"""Tables of node and dof for each row of a matrix (CSV), for formats that carry none."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints

_COMPONENTS = {
    **{name: i for i, name in enumerate(("x", "y", "z", "rx", "ry", "rz"))},
    **{name: i for i, name in enumerate(("ux", "uy", "uz", "rotx", "roty", "rotz"))},
    **{str(i + 1): i for i in range(6)},
}


def read_dof_map(path: Path) -> tuple[Ints, Ints]:
    """Label of the node and component 0..5 (N,) of each row, of a table with the columns node and dof.

    Dofs are 1 to 6, or x, y, z, rx, ry, rz. Columns are found by the names in the first line; without one the first
    two are taken. Commas, semicolons, tabs and blanks separate; lines that begin with # are left out.

    Raises:
        InputError: the file cannot be read, or a line that is no label and dof, or one that comes twice.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(
            f"dof table {path.name} cannot be read ({reason}); expected lines 'node,dof'", kind="file"
        ) from error
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"dof table {path.name} is empty; expected lines 'node,dof', one for each row of the matrices")
    mark = next((mark for mark in ",;\t" if mark in lines[0][1]), None)
    rows = [(i, _fields(line, mark)) for i, line in lines]
    head = [field.lower() for field in rows[0][1]]
    at_node, at_dof = 0, 1
    if "node" in head and ("dof" in head or "component" in head):
        at_node, at_dof = head.index("node"), head.index("dof" if "dof" in head else "component")
        rows = rows[1:]
    node, component = np.empty(len(rows), dtype=np.int64), np.empty(len(rows), dtype=np.int64)
    for k, (line, fields) in enumerate(rows):
        try:
            node[k], component[k] = int(fields[at_node]), _COMPONENTS[fields[at_dof].lower()]
        except (ValueError, KeyError, IndexError, OverflowError) as error:
            raise InputError(
                f"dof table {path.name}, line {line}: {','.join(fields)!r} was given; expected a label and one of "
                "1 to 6 or x, y, z, rx, ry, rz"
            ) from error
    pairs, count = np.unique(np.stack([node, component], axis=1), axis=0, return_counts=True)
    if (count > 1).any():
        twice = pairs[np.argmax(count > 1)]
        raise InputError(
            f"dof table {path.name} names node {twice[0]}, dof {twice[1] + 1} twice; expected each once",
            kind="conflict",
        )
    return node, component


def _fields(line: str, mark: str | None) -> list[str]:
    try:
        return [field.strip() for field in (next(csv.reader([line], delimiter=mark)) if mark else line.split())]
    except csv.Error as error:
        raise InputError(
            f"the line {line[:60]!r} of the dof table cannot be read ({error}); check the file", kind="file"
        ) from error
