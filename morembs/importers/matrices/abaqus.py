"""Abaqus matrices as text: *MATRIX OUTPUT in its three formats, and substructures (*USER ELEMENT, *MATRIX)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.matrices.text import integers, numbers, open_lines, parallel_map, table, text_blocks
from morembs.importers.matrices.triplets import (
    Numbering,
    Place,
    Renumbered,
    Triplets,
    TripletStore,
    assemble,
    asymmetry,
    complete,
    row_and_column,
    unique,
)
from morembs.importers.tolerances import TOL

_STARRED = re.compile(rb"^[ \t]*\*.*\n", re.MULTILINE)


class NodeRow:
    """A row of *MATRIX OUTPUT (Abaqus Keywords Guide) as one integer: label * ``DOFS`` + dof, a dof from 1 on."""

    DOFS = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class AbaqusMatrix:
    """A matrix (N, N) and, but for FORMAT=COORDINATE, the ``node`` label and ``dof`` (N,) of each row.

    Rows ascend by node and dof, internal dofs (negative labels: Lagrange multipliers, connectors, hybrid
    elements) come last; ``internal`` is their number. ``symmetric`` holds to 1e-9; ``half`` says that the file had
    one entry of each pair and the other was filled in.
    """

    matrix: sp.csr_array
    node: Ints | None
    dof: Ints | None
    symmetric: bool
    half: bool
    internal: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Substructure:
    """Condensed matrices (n, n) by their type (STIFFNESS, MASS, ...), ``node`` label and ``dof`` (n,) of each row."""

    matrices: dict[str, Floats]
    node: Ints
    dof: Ints
    symmetric: bool


def read_abaqus_matrix(path: str | Path) -> AbaqusMatrix:
    """Matrix of a file of *MATRIX OUTPUT, FORMAT=MATRIX INPUT, LABELS (5 columns) or COORDINATE (3 columns).

    The text is read once; memory is that of the result (CSR) and blocks. A file with one of each pair of entries,
    but in both triangles, needs twice the result.

    Raises:
        InputError: not such a file, or one that is cut off within a line.
    """
    path = Path(path)
    with TripletStore(path.name) as store:
        columns, keywords = _find_stored(path, store)
        if columns == 3:
            size = 1 + max(max(int(r.max(initial=-1)), int(c.max(initial=-1))) for r, c, _ in store)
            if size > TOL.rows_per_entry * (1 + store.count):
                raise InputError(
                    f"{path.name} names row or column {size} but has only {store.count} entries; it is damaged",
                    kind="file",
                    keyword=path.name,
                )
            half, matrix = _matrix(store, size, path.name, keywords)
            node = dof = None
        else:
            codes = unique(store)
            node, dof = codes // NodeRow.DOFS, codes % NodeRow.DOFS
            order = np.lexsort((dof, np.abs(node), node < 0))
            places = Numbering(codes, order)
            placed = Renumbered(triplets=store, rows=places, columns=places)
            node, dof = node[order], dof[order]
            half, matrix = _matrix(placed, len(codes), path.name, keywords, partial(_place, node, dof))
    symmetric = asymmetry(matrix) <= TOL.asymmetry
    if "TYPE=SYMMETRIC," in keywords and not symmetric:
        raise InputError(
            f"{path.name} says TYPE=SYMMETRIC, but its entries (i, j) and (j, i) differ; write it again",
            kind="file",
            keyword=path.name,
        )
    internal = 0 if node is None else int((node < 0).sum())
    return AbaqusMatrix(matrix=matrix, node=node, dof=dof, symmetric=symmetric, half=half, internal=internal)


def _matrix(
    store: Iterable[Triplets], size: int, name: str, keywords: str, place: Place = row_and_column
) -> tuple[bool, sp.csr_array]:
    if "TYPE=UNSYMMETRIC" in keywords:
        return False, assemble(store, (size, size), mirror=False, name=name, place=place)
    return complete(store, size, name, place)


def _place(node: Ints, dof: Ints, row: int, column: int) -> str:
    return f"the row of node {node[row]}, dof {dof[row]}, the column of node {node[column]}, dof {dof[column]}"


def _find_stored(path: Path, store: TripletStore) -> tuple[int, str]:
    """Fill ``store``; number of columns (3 or 5) and keywords in capitals without blanks."""
    columns, keywords = 0, ""

    def entries() -> Iterator[bytes]:
        nonlocal columns, keywords
        for block in text_blocks(path):
            text = block
            if b"*" in block:
                keywords += _keywords(path.name, _STARRED.findall(block))
                text = _STARRED.sub(b"", block)
            columns = columns or _width(path.name, text)
            if columns:
                yield text

    for triplets in parallel_map(lambda text: _triplets(path.name, table(text, columns, path.name)), entries()):
        store.add(*triplets)
    if not columns:
        raise InputError(
            f"{path.name} has no matrix entries; expected a file of *MATRIX OUTPUT", kind="file", keyword=path.name
        )
    return columns, keywords


def _keywords(file: str, lines: Iterable[bytes]) -> str:
    keywords = ""
    for line in lines:
        text = "".join(line.decode("latin-1").upper().split())
        if text.startswith("**"):
            continue
        if text.startswith("*USERELEMENT"):
            raise InputError(
                f"{file} is a substructure (*USER ELEMENT); read it with read_abaqus_substructure", kind="unsupported"
            )
        if not text.startswith("*MATRIXINPUT"):
            raise InputError(
                f"{file} has the keyword {text[:40]!r}; expected matrix entries or *MATRIX INPUT only",
                kind="unsupported",
            )
        if keywords:
            raise InputError(
                f"{file} holds several matrices (*MATRIX INPUT); write one file for each", kind="unsupported"
            )
        # Options end with a comma, so that SYMMETRIC is not found in UNSYMMETRIC.
        keywords += text + ","
    return keywords


def _width(file: str, text: bytes) -> int:
    first = next((line for line in text.split(b"\n") if line.strip()), b"")
    columns = len(first.replace(b",", b" ").split())
    if first and columns not in (3, 5):
        raise InputError(
            f"{file} starts with {first.decode('latin-1').strip()[:60]!r}; expected 'row column value' or 'node, dof, "
            "node, dof, value' in each line",
            kind="file",
            keyword=file,
        )
    return columns


def _triplets(file: str, rows: Floats) -> Triplets:
    if rows.shape[1] == 3:
        at = integers(rows[:, :2], "a row or column number", file) - 1
        if len(at) and at.min() < 0:
            raise InputError(f"{file} has the row or column number {at.min() + 1}; expected 1 or more", keyword="row")
        return at[:, 0], at[:, 1], rows[:, 2]
    labels = integers(rows[:, :4], "a node label or a dof", file)
    node, dof = labels[:, ::2], labels[:, 1::2]
    if len(labels) and (dof.min() < 0 or dof.max() >= NodeRow.DOFS):
        raise InputError(
            f"{file} has the dof {dof.min() if dof.min() < 0 else dof.max()}; expected 1 to {NodeRow.DOFS - 1}",
            keyword="dof",
        )
    codes = node * NodeRow.DOFS + dof
    return codes[:, 0], codes[:, 1], rows[:, 4]


def align(*matrices: AbaqusMatrix) -> tuple[tuple[sp.csr_array, ...], Ints | None, Ints | None]:
    """The matrices on the union of their rows, and node and dof of each row; missing rows are zero.

    A lumped or massless mass matrix has fewer rows than the stiffness.

    Raises:
        InputError: some have labels and some do not.
    """
    bare = [matrix.node is None for matrix in matrices]
    if any(bare) and not all(bare):
        raise InputError(
            "one matrix has node labels and another has none; write both with FORMAT=MATRIX INPUT", kind="unsupported"
        )
    if all(bare):
        size = max(matrix.matrix.shape[0] for matrix in matrices)
        grown = tuple(_place_matrix(matrix.matrix, np.arange(matrix.matrix.shape[0]), size) for matrix in matrices)
        return grown, None, None
    labels = [(matrix.node, matrix.dof) for matrix in matrices]
    keys = [np.stack([node, dof], axis=1) for node, dof in labels if node is not None and dof is not None]
    every = np.unique(np.concatenate(keys), axis=0)
    every = every[np.lexsort((every[:, 1], np.abs(every[:, 0]), every[:, 0] < 0))]
    row = {key: i for i, key in enumerate(map(tuple, every.tolist()))}
    placed = tuple(
        _place_matrix(matrix.matrix, np.array([row[k] for k in map(tuple, key.tolist())], dtype=np.int64), len(every))
        for matrix, key in zip(matrices, keys, strict=True)
    )
    return placed, every[:, 0], every[:, 1]


def _place_matrix(matrix: sp.csr_array, rows: Ints, size: int) -> sp.csr_array:
    if len(rows) == size and (rows == np.arange(size)).all():
        return matrix
    P = sp.csr_array((np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(size, len(rows)))
    return sp.csr_array(P @ matrix @ P.T)


def read_abaqus_substructure(path: str | Path) -> Substructure:
    """Matrices of *SUBSTRUCTURE MATRIX OUTPUT, as Abaqus and CalculiX write them.

    Node labels stand in comments, dofs in lines "node number, dofs", each valid from its node on; symmetric
    matrices are lower triangles row by row.

    Raises:
        InputError: not such a file, or counts that contradict each other.
    """
    path = Path(path)
    with open_lines(path) as file:
        lines = [line.strip() for line in file.read().decode("latin-1").split("\n")]
    start = next((i for i, line in enumerate(lines) if _keyword(line).startswith("*USERELEMENT")), None)
    if start is None:
        raise InputError(
            f"{path.name} has no *USER ELEMENT; expected a file of *SUBSTRUCTURE MATRIX OUTPUT",
            kind="file",
            keyword=path.name,
        )
    options = _keyword(lines[start]).split(",")
    symmetric = "UNSYM" not in options
    heads = [i for i, line in enumerate(lines) if line.startswith("*") and not line.startswith("**") and i > start]
    first = heads[0] if heads else len(lines)
    node, dof = _labels(path.name, options, lines[start + 1 : first])
    matrices = {}
    for head, end in zip(heads, [*heads, len(lines)][1:], strict=True):
        keyword = _keyword(lines[head])
        kind = re.search(r"TYPE=(\w+)", keyword)
        if not keyword.startswith("*MATRIX,") or kind is None:
            continue
        data = [line for line in lines[head + 1 : end] if line and not line.startswith("**")]
        if kind[1] in matrices:
            raise InputError(f"{path.name} has two matrices of TYPE={kind[1]}; expected one of each")
        values = numbers(("\n".join(data) + "\n").encode("latin-1"), path.name)
        matrices[kind[1]] = _fill(path.name, kind[1], values, len(node), symmetric)
    if not matrices:
        raise InputError(
            f"{path.name} has no *MATRIX, TYPE=...; it is cut off or not a substructure", kind="file", keyword=path.name
        )
    return Substructure(matrices=matrices, node=node, dof=dof, symmetric=symmetric)


def _keyword(line: str) -> str:
    return "".join(line.upper().split()) if not line.startswith("**") else ""


def _labels(file: str, options: list[str], lines: list[str]) -> tuple[Ints, Ints]:
    """Node and dof of each row."""
    comments = [line[2:] for line in lines if line.startswith("**")]
    listed = [c.replace(",", " ").split() for c in comments]
    nodes = [int(x) for row in listed if all(re.fullmatch(r"-?\d+", x) for x in row) for x in row]
    data = [[int(x) for x in line.replace(",", " ").split()] for line in _numeric(file, lines)]
    count = next((o.partition("=")[2] for o in options if o.startswith("NODES=")), "")
    if not count.isdigit() or len(nodes) != int(count) or not data:
        raise InputError(
            f"{file}: *USER ELEMENT says NODES={count or '(none)'} but the comments name {len(nodes)} nodes and "
            f"{len(data)} lines give dofs; expected one label for each node",
            kind="file",
            keyword="USER ELEMENT",
        )
    dofs: list[list[int]] = [data[0]] * len(nodes)
    for position, *active in data[1:]:
        if not 1 <= position <= len(nodes):
            raise InputError(
                f"{file}: dofs are given for node number {position}; expected 1 to {len(nodes)}",
                kind="file",
                keyword="node",
            )
        dofs[position - 1 :] = [active] * (len(nodes) - position + 1)
    # CalculiX lists a node once for each of its dofs, which comes to the same pairs.
    pairs = [(n, d) for n, active in zip(nodes, dofs, strict=True) for d in active]
    if len(set(pairs)) < len(pairs):
        raise InputError(f"{file} names a dof of a node twice; expected each once", kind="conflict")
    both = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _numeric(file: str, lines: list[str]) -> list[str]:
    data = [line for line in lines if line and not line.startswith("**")]
    for line in data:
        if not re.fullmatch(r"[0-9,\s]+", line):
            raise InputError(f"{file}: {line[:60]!r} was found where dofs were expected; check the file", kind="file")
    return data


def _fill(file: str, kind: str, values: Floats, size: int, symmetric: bool) -> Floats:
    triangle = size * (size + 1) // 2
    if not symmetric and len(values) == size * size:
        return values.reshape(size, size)
    # An unsymmetric element may still have a symmetric mass matrix.
    if len(values) != triangle:
        raise InputError(
            f"{file}: the matrix of TYPE={kind} has {len(values)} numbers; expected {triangle} for the lower triangle "
            f"{'' if symmetric else f'or {size * size} for all entries '}of {size} dofs; it is cut off or damaged",
            kind="file",
        )
    matrix = np.zeros((size, size))
    matrix[np.tril_indices(size)] = values
    return matrix + np.tril(matrix, -1).T
