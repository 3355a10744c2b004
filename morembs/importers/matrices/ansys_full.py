"""ANSYS .full files: assembled K, M and D in binary form (Programmer's Reference, "Full Stiffness-Mass File").

A record is two 4-byte words (length in words, flags), the data, and the length again. Matrices are stored by rows of
the upper triangle, each as a record of columns and one of values; every equation has its node and dof number, which
is negative where a support (D) holds it. Rows that are held keep a unit diagonal and nothing else of meaning.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.importers.imported import Imported
from morembs.importers.matrices.ansys_nodes import join
from morembs.importers.matrices.text import open_lines
from morembs.importers.matrices.triplets import Triplets, assemble
from morembs.importers.tolerances import TOL

Words = NDArray[np.int32]


class Place(IntEnum):
    """Places in the header of a .full file, words from 0 (Programmer's Reference of Mechanical APDL, fdfull).

    Numbers of 64 bits are a low and a high word.
    """

    EQUATIONS = 1
    ANALYSIS = 4
    DOFS_PER_NODE = 7
    LUMPED = 10
    UNSYMMETRIC = 13
    CONSTRAINTS = 20
    NODES = 32
    DOFS_LOW = 35
    DOFS_HIGH = 36
    DISTRIBUTED = 62
    LENGTH = 160


class Code:
    """Values in headers and in front of records of ANSYS binary files (the same reference)."""

    STANDARD_HEADER_WORDS = 100
    FULL_FILE = 4
    BUCKLING = 1
    # Flags of a record: kinds and compression are bits, the sign says integers.
    INTEGERS = -(1 << 31)
    DOUBLES = 0
    FLAGS = (1 << 31) - 1
    LOW_WORD = (1 << 32) - 1


# Low and high word of the number of entries, and of the place.

_TERMS = {"K": (8, 9), "M": (33, 21), "D": (34, 39)}
_PLACE = {"K": (18, 19), "M": (26, 27), "D": (28, 29)}
_OTHER = "write the matrices as text instead (HBMAT with Mapping = YES) and import those"


@dataclass(frozen=True, kw_only=True, eq=False)
class AnsysFull:
    """Matrices (N, N) and the ``node`` label and ``component`` 0..5 (N,) of each row, ascending.

    ``M`` and ``D`` are None where the file has none. ``constrained`` (k, 2) are the (node, component) that supports
    hold; they are not rows. ``lumped`` says that the mass is a diagonal.
    """

    K: sp.csr_array
    M: sp.csr_array | None
    D: sp.csr_array | None
    node: Ints
    component: Ints
    constrained: Ints
    lumped: bool


def import_ansys_full(path: str | Path, *, nodes: str | Path | None = None, drop_constrained: bool = False) -> Imported:
    """Matrices of a .full file with the coordinates of the archive or node list ``nodes`` (.cdb, NWRITE, NLIST).

    With ``drop_constrained`` the dofs that supports hold are left out, and the model is one held to the ground.

    Raises:
        InputError: as ``read_ansys_full``; supports without ``drop_constrained``; no ``nodes``, or nodes missing there.
    """
    path = Path(path)
    full = read_ansys_full(path)
    held = len(full.constrained)
    notes = []
    if held:
        first = f"node {full.constrained[0, 0]}, {['UX', 'UY', 'UZ', 'ROTX', 'ROTY', 'ROTZ'][full.constrained[0, 1]]}"
        if not drop_constrained:
            raise InputError(
                f"{path.name}: {held} dofs are constrained (D; first: {first}) and their rows are empty; a free body "
                "needs a model without constraints: delete them (DDELE,ALL), write the .full file again, or give "
                "drop_constrained=true (--set at the import) for a body that is held to the ground there",
                kind="unsupported",
                keyword="supports",
            )
        notes.append(
            f"grounded: {held} constrained dofs (first: {first}) were dropped, so the body is held to the ground there "
            "and cannot move freely"
        )
    if full.lumped:
        notes.append("the mass matrix is lumped (LUMPM,ON)")
    if full.M is None:
        notes.append(f"{path.name} has no mass matrix (a static analysis); run a modal analysis (ANTYPE,MODAL) for one")
    matrices = {"K": full.K, "M": full.M, "D": full.D}
    return join(path.name, matrices, full.node, full.component, nodes, notes, free=not held)


def read_ansys_full(path: str | Path) -> AnsysFull:
    """Matrices of a .full file, rows sorted by node and component.

    Memory is that of the matrices (CSR, both triangles) and blocks; the file is mapped, not loaded.

    Raises:
        InputError: not a .full file, cut off or damaged; unsymmetric, complex, compressed, distributed or frontal
            files, a buckling analysis, constraint equations, or dofs that are not structural.
    """
    path = Path(path)
    with open_lines(path):
        pass
    if path.stat().st_size < 4 * Code.STANDARD_HEADER_WORDS:
        raise InputError(
            f"{path.name} is too short for an ANSYS binary file; write it again", kind="file", keyword=path.name
        )
    words = np.memmap(path, dtype=np.int32, mode="r", shape=(path.stat().st_size // 4,))
    return _File(path.name, words).full()


class _File:
    """The words of a file and what its header says."""

    def __init__(self, name: str, array: Words) -> None:
        # Single words come several times faster from a view without numpy's scalars.
        self.name, self.array, self.words, self.size = name, array, memoryview(array), len(array)  # type: ignore[arg-type]
        expected = "expected the .full file of a Mechanical APDL analysis"
        if array[0] != Code.STANDARD_HEADER_WORDS:
            raise InputError(
                f"{name} does not start as an ANSYS binary file does (little-endian); {expected}", kind="file"
            )
        standard, after = self.integers(0)
        if len(standard) != Code.STANDARD_HEADER_WORDS or standard[0] != Code.FULL_FILE:
            raise InputError(f"{name} is an ANSYS binary file of the kind {standard[0]}, not a .full file; {expected}")
        header, self.after_header = self.integers(after)
        self.header = np.zeros(Place.LENGTH, dtype=np.int64)
        self.header[: len(header)] = header[: Place.LENGTH]
        self._refuse()
        self.rows = int(self.header[Place.EQUATIONS])

    def describe_damage(self, what: str) -> InputError:
        return InputError(f"{self.name} is cut off or damaged: {what}; write it again", kind="file")

    def _refuse(self) -> None:
        h = self.header
        if h[0] != -Code.FULL_FILE:
            raise InputError(
                f"{self.name} was written by the frontal solver, which is not read; {_OTHER}", kind="unsupported"
            )
        reasons = {
            "unsymmetric matrices": h[Place.UNSYMMETRIC] != 0,
            "the part of one process of a distributed run": h[Place.DISTRIBUTED] != 0,
            "a buckling analysis, whose second matrix is not the mass": h[Place.ANALYSIS] == Code.BUCKLING,
        }
        for what, present in reasons.items():
            if present:
                raise InputError(
                    f"{self.name} holds {what}, which is not read; write a symmetric modal analysis", kind="unsupported"
                )
        if h[Place.CONSTRAINTS]:
            raise InputError(
                f"{self.name} holds {h[Place.CONSTRAINTS]} constraint equations or couplings (CE, CP, CERIG, RBE3, MPC "
                f"contact), which are not read from there; {_OTHER}, where they are eliminated",
                kind="unsupported",
            )
        if (
            not 0 < h[Place.EQUATIONS] < self.size
            or not 0 < h[Place.NODES] < self.size
            or not 0 < h[Place.DOFS_PER_NODE] < 64
        ):
            raise self.describe_damage(f"its header says {h[Place.EQUATIONS]} equations and {h[Place.NODES]} nodes")

    def long(self, places: tuple[int, int]) -> int:
        low, high = (int(self.header[p]) & Code.LOW_WORD for p in places)
        return (high << 32) | low

    def record(self, at: int, flags: int) -> tuple[int, int, int]:
        """Where the data of the record ``at`` starts, its words, and where the next record starts."""
        words = self.words
        if not 0 <= at < self.size - 2:
            raise self.describe_damage(f"a record should be at the word {at} of {self.size}")
        length = words[at]
        if length < 0 or at + 2 + length >= self.size or words[at + 2 + length] != length:
            raise self.describe_damage(f"the record at the word {at} does not end where it should")
        if words[at + 1] != flags:
            if words[at + 1] & Code.FLAGS:
                raise InputError(
                    f"{self.name} has compressed or single-precision records, not read; {_OTHER}", kind="unsupported"
                )
            raise self.describe_damage(f"the record at the word {at} is not of the expected type")
        return at + 2, length, at + 3 + length

    def integers(self, at: int) -> tuple[Ints, int]:
        """Record of integers, and where the next record starts."""
        start, length, after = self.record(at, Code.INTEGERS)
        return self.array[start : start + length].astype(np.int64), after

    def full(self) -> AnsysFull:
        used, at = self.integers(self.after_header)
        if not (np.array_equal(used, [1, 2, 3]) or np.array_equal(used, [1, 2, 3, 4, 5, 6])):
            raise InputError(
                f"{self.name} has the dofs {used[:12].tolist()} (numbers of ANSYS); expected UX UY UZ, or these and "
                "ROTX ROTY ROTZ (1 to 6): a structural model in space",
                kind="unsupported",
                keyword="dofs",
            )
        label, _ = self.integers(at)
        per_node, at = self.integers(self.long((Place.DOFS_LOW, Place.DOFS_HIGH)))
        dof, _ = self.integers(at)
        if (per_node < 0).any() or per_node.sum() != self.rows or len(dof) != self.rows or len(label) < len(per_node):
            raise self.describe_damage(f"its table of dofs does not fit {self.rows} equations")
        node, component = np.repeat(label[: len(per_node)], per_node), np.abs(dof) - 1
        if (node < 1).any() or (component < 0).any() or (component >= len(used)).any():
            raise self.describe_damage("its table of dofs names others than it has")
        order = np.lexsort((component, node))
        if (np.diff(node[order]) + (np.diff(component[order]) != 0) == 0).any():
            raise self.describe_damage("its table of dofs names one twice")
        order_free, held = order[dof[order] > 0], order[dof[order] < 0]
        place = np.full(self.rows, -1, dtype=np.int64)
        place[order_free] = np.arange(len(order_free))
        if not len(order_free):
            raise InputError(f"{self.name}: supports (D) hold every dof; nothing is left to reduce", kind="unsupported")
        K, M, D = (self.matrix(name, place, len(order_free)) for name in "KMD")
        if K is None:
            raise InputError(
                f"{self.name} has no stiffness matrix; write the .full file of a modal analysis", kind="missing"
            )
        return AnsysFull(
            K=K,
            M=M,
            D=D,
            node=node[order_free],
            component=component[order_free],
            constrained=np.column_stack([node[held], component[held]]),
            lumped=bool(self.header[Place.LUMPED]),
        )

    def matrix(self, which: str, place: Ints, size: int) -> sp.csr_array | None:
        terms, at = self.long(_TERMS[which]), self.long(_PLACE[which])
        if not terms or not at:
            return None
        if terms > self.size:
            raise self.describe_damage(f"its header says {terms} entries of {which}")
        length, flags, _ = self.words[at : at + 3] if at < self.size - 2 else (0, 0, 0)
        if which == "M" and self.header[Place.LUMPED] and (length, flags) == (2 * self.rows, Code.DOUBLES):
            start, _, _ = self.record(at, Code.DOUBLES)
            diagonal = np.frombuffer(self.array[start : start + length].tobytes(), dtype=np.float64)
            kept = np.zeros(size)
            kept[place[place >= 0]] = diagonal[place >= 0]
            if not np.isfinite(kept).all():
                raise self.describe_damage("a number is not finite")
            return sp.csr_array(sp.diags_array(kept))
        rows = _Rows(self, which, at, terms, place)
        return assemble(rows, (size, size), mirror=True, name=f"{self.name}: {which}")


class _Rows:
    """Entries of one matrix as triplets, rows and columns at their ``place``, those without one left out."""

    def __init__(self, file: _File, which: str, at: int, terms: int, place: Ints) -> None:
        self.file, self.which, self.place = file, which, place
        # Where the columns and values of each row start, and how many there are.
        self.columns, self.values, self.counts = (np.empty(file.rows, dtype=np.int64) for _ in range(3))
        for row in range(file.rows):
            start, count, at = file.record(at, Code.INTEGERS)
            first, length, at = file.record(at, Code.DOUBLES)
            if length != 2 * count:
                complex_ = length == 4 * count and count
                what = f"row {row + 1} of {which} has {count} columns and {length // 2} values"
                raise (
                    InputError(
                        f"{file.name}: {which} is complex, which is not read; write a model without damping",
                        kind="unsupported",
                    )
                    if complex_
                    else file.describe_damage(what)
                )
            self.columns[row], self.values[row], self.counts[row] = start, first, count
        if int(self.counts.sum()) != terms:
            raise file.describe_damage(f"{which} has {self.counts.sum()} entries where its header says {terms}")

    def __iter__(self) -> Iterator[Triplets]:
        words = np.asarray(self.file.array)
        for begin in range(0, self.file.rows, TOL.full_rows_at_once):
            part = slice(begin, begin + TOL.full_rows_at_once)
            counts = self.counts[part]
            within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
            row = np.repeat(np.arange(begin, begin + len(counts)), counts)
            column = words[np.repeat(self.columns[part], counts) + within].astype(np.int64) - 1
            if len(column) and (column.min() < 0 or column.max() >= self.file.rows or (column < row).any()):
                raise self.file.describe_damage(f"{self.which} has an entry outside its upper triangle")
            low = np.repeat(self.values[part], counts) + 2 * within
            value = np.stack([words[low], words[low + 1]], axis=1).view(np.float64).ravel()
            kept = (self.place[row] >= 0) & (self.place[column] >= 0)
            row, column, value = self.place[row[kept]], self.place[column[kept]], value[kept]
            if not np.isfinite(value).all():
                raise self.file.describe_damage("a number is not finite")
            yield row, column, value
