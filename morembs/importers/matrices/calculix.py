"""CalculiX matrices: job.sti, job.mas and job.dof of *FREQUENCY, SOLVER=MATRIXSTORAGE."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.matrices.text import integers, parallel_map, table, text_blocks
from morembs.importers.matrices.triplets import TripletStore, assemble


@dataclass(frozen=True, kw_only=True, eq=False)
class CalculixMatrices:
    """``K``, ``M`` (N, N) symmetric, and the ``node`` label and direction ``dof`` 1..3 (N,) of each row.

    Dofs that the deck holds (*BOUNDARY, equations) are not there.
    """

    K: sp.csr_array
    M: sp.csr_array
    node: Ints
    dof: Ints


def read_calculix_matrices(path: str | Path, *, several: bool = False) -> CalculixMatrices:
    """Matrices of a job; ``path`` is any of its three files or the path without an ending, ``several`` as below.

    Memory is that of the two matrices (CSR) and blocks of text.

    Raises:
        InputError: a file is missing, cut off, or does not fit the others.
    """
    path = Path(path)
    stem = path.with_suffix("") if path.suffix in (".sti", ".mas", ".dof") else path
    node, dof = read_dofs(stem.with_name(stem.name + ".dof"), several=several)
    K, M = (_triangle(stem.with_name(stem.name + end), len(node)) for end in (".sti", ".mas"))
    return CalculixMatrices(K=K, M=M, node=node, dof=dof)


def read_dofs(path: Path, *, several: bool = False) -> tuple[Ints, Ints]:
    """Node and direction (N,) of each row, of lines "node.direction".

    Args:
        several: dofs may be there several times, as nodes of expanded shells and beams carry the label of their parent.

    Raises:
        InputError: not such a file, or a dof twice.
    """
    parts = []
    for block in text_blocks(path):
        # Split as text: read as a number, 1.10 and 1.1 would be the same.
        try:
            parts.append(table(block.replace(b".", b" "), 2, path.name))
        except InputError as error:
            raise error.restate(f"{error}; expected lines 'node.direction' such as 12.3") from error
    labels = integers(np.concatenate([np.empty((0, 2)), *parts]), "a node or direction", path.name)
    node, dof = labels[:, 0], labels[:, 1]
    if not len(node) or node.min() < 1 or dof.min() < 1 or dof.max() > 9:
        raise InputError(f"{path.name} holds no nodes from 1 and directions 1 to 9; expected lines such as 12.3")
    if not several and len(np.unique(node * 10 + dof)) < len(node):
        raise InputError(
            f"{path.name} names a dof twice; it belongs to another version of CalculiX or is damaged",
            kind="file",
            keyword=path.name,
        )
    return node, dof


def _triangle(path: Path, size: int) -> sp.csr_array:
    """Symmetric matrix of a file with one triangle, every diagonal entry in it."""
    diagonal = np.zeros(size, dtype=bool)
    above = below = False
    with TripletStore(path.name) as store:
        for rows in parallel_map(lambda block: table(block, 3, path.name), text_blocks(path)):
            at = integers(rows[:, :2], "a row or column number", path.name) - 1
            if len(at) and (at.min() < 0 or at.max() >= size):
                bad = at[(at < 0) | (at >= size)][0] + 1
                raise InputError(
                    f"{path.name} has an entry in row or column {bad}; expected 1 to {size}, as many as the .dof file "
                    "has lines; take the three files of one job",
                    kind="file",
                    keyword=path.name,
                )
            store.add(at[:, 0], at[:, 1], rows[:, 2])
            above, below = above or bool((at[:, 0] < at[:, 1]).any()), below or bool((at[:, 0] > at[:, 1]).any())
            diagonal[at[at[:, 0] == at[:, 1], 0]] = True
        if above and below:
            raise InputError(
                f"{path.name} has entries in both triangles; expected the upper one only",
                kind="file",
                keyword=path.name,
            )
        if not diagonal.all():
            raise InputError(
                f"{path.name} has no diagonal entry for row {np.flatnonzero(~diagonal)[0] + 1} of {size}; it is cut "
                "off or does not belong to the .dof file",
                kind="file",
                keyword=path.name,
            )
        return assemble(store, (size, size), mirror=True, name=path.name)
