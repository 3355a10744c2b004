"""CalculiX (ccx) as the program that assembles a deck: its runs, and what may go wrong with them.

ccx is run as a process of its own and never linked. Three runs at most: one exports K and M (*FREQUENCY,
SOLVER=MATRIXSTORAGE), one tells what became of shells and beams, and one finds how dependent dofs follow others: ccx
eliminates these and does not write how. In that one a spring of stiffness 1 joins each dependent dof to a free node, so
that the row of this node reads minus the coefficients.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import InputError
from morembs.base.scratch import ScratchFolder
from morembs.base.types import Ints
from morembs.importers.decks.flat import FlatDeck
from morembs.importers.engines.calculix.expansion import read_expansion
from morembs.importers.engines.calculix.rows import Expanded
from morembs.importers.engines.run import Program, find_executable, run
from morembs.importers.matrices.calculix import CalculixMatrices, read_calculix_matrices
from morembs.importers.tolerances import TOL
from morembs.storage.safefile import copy_into

CURE = "no program ccx was found; install calculix-ccx (Debian, conda-forge) or give calculix:PATH"
_ENDINGS = (".sti", ".mas", ".dof")
_DONE = "Job finished"
_EXPORT = "*STEP{}\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n*END STEP"
_SHAPE = "*STEP\n*NO ANALYSIS\n*NODE OUTPUT, OUTPUT=3D\nU\n*END STEP"
_NUMBER = re.compile(r"\b(element|node)\s+(\d+)", re.IGNORECASE)


def find_ccx(given: str = "") -> Program:
    """The executable of ccx: ``given``, the variable MOREMBS_CCX, or one in PATH.

    Raises:
        InputError: there is none.
    """
    executables = ("ccx", "ccx_2.22", "ccx_2.21", "ccx_2.20", "CalculiX")
    path = find_executable("calculix", given, "MOREMBS_CCX", executables, CURE)
    return Program(name="ccx", path=path)


@dataclass(eq=False)
class Ccx(Closing):
    """Runs of ccx on one deck in a private folder, each under a name of its own.

    ``seconds`` for each run. One thread, as others add up in another order on another machine; no more memory than the
    machine has. ``keep`` is the folder that gets the files (None: they are removed).
    """

    program: Program
    flat: FlatDeck
    seconds: float = 600.0
    keep: Path | None = None
    folder: ScratchFolder = field(default_factory=lambda: ScratchFolder(None))

    def close(self) -> None:
        """Remove the files."""
        self.folder.close()

    def export(
        self, name: str = "model", extra: str = "", nodes: str = "", *, preloaded: bool = True
    ) -> CalculixMatrices:
        """K and M of the deck with ``extra`` cards, after the steps of its preload if ``preloaded``.

        Raises:
            InputError: ccx refuses the deck, does not finish, or writes what is no matrix.
        """
        step = _EXPORT.format(", PERTURBATION" if self.flat.steps and preloaded else "")
        self._run(name, self.flat.text(extra, step, nodes, preloaded=preloaded))
        stem = self.folder.path / name
        files = [stem.with_suffix(end) for end in _ENDINGS]
        lost = [file.suffix for file in files if not file.is_file() or not file.stat().st_size]
        if lost == list(_ENDINGS):
            raise InputError(
                f"ccx wrote no matrices of {self.flat.name}; its boundary or equations hold it all", kind="program"
            )
        if lost:
            raise InputError(
                f"ccx finished without writing {', '.join(name + end for end in lost)}; is it complete?", kind="program"
            )
        try:
            return read_calculix_matrices(stem, several=True)
        except InputError as error:
            raise self._not_finite(stem) or error from error

    def _not_finite(self, stem: Path) -> InputError | None:
        """What to say where ccx wrote a number that is none."""
        for end, what in ((".sti", "stiffness"), (".mas", "mass")):
            with stem.with_suffix(end).open("rb") as file:
                line = next((line for line in file if b"nan" in line.lower() or b"inf" in line.lower()), b"")
            if line:
                dof = stem.with_suffix(".dof").read_text().split()
                node, _, direction = dof[int(line.split()[0]) - 1].partition(".")
                return InputError(
                    f"ccx wrote a {what} that is not a number in row {self._label(int(node))}.{direction}; an element "
                    "there is degenerate, or a constraint there is not linear",
                    kind="program",
                )
        return None

    def expansion(self) -> Expanded | None:
        """What became of shells, membranes, beams and trusses, None without any."""
        if not self.flat.expands:
            return None
        self._run("shape", self.flat.text("", _SHAPE, preloaded=False), done="")
        return read_expansion(self.folder.path / "shape.12d", self.folder.path / "shape.frd")

    def probe(self, plain: CalculixMatrices, node: Ints, direction: Ints) -> sp.csr_array:
        """S (k, N): how the dofs ``direction`` 1..3 of the deck's nodes ``node`` (k,) follow the rows of ``plain``.

        Raises:
            InputError: springs change other rows of the model, so that S is not determined.
        """
        count, first = len(node), len(self.flat.ids) + 1
        far = 2.0 * np.ptp(self.flat.xyz, axis=0).max() + 1.0
        nodes = "\n".join(["*NODE", *(f"{first + i}, {far:.6g}, {far:.6g}, {far:.6g}" for i in range(count))])
        lines, element = [], 1 + len(self.flat.elements)
        for axis in (1, 2, 3):
            own = np.flatnonzero(direction == axis)
            if not len(own):
                continue
            lines.append(f"*ELEMENT, TYPE=SPRING2, ELSET=PROBE{axis}")
            lines += [f"{element + i}, {node[i]}, {first + i}" for i in own.tolist()]
            lines.append(f"*SPRING, ELSET=PROBE{axis}\n{axis}, {axis}\n1.")
        # Springs to nothing make some solvers of static steps stop, and these do not change who follows whom.
        with_springs = self.export("probe", "\n".join(lines), nodes, preloaded=False)
        free = (with_springs.node >= first) & (with_springs.node < first + count)
        label = np.where(with_springs.node >= first + count, with_springs.node - count, with_springs.node)
        rest = np.flatnonzero(~free)
        same = len(rest) == len(plain.node) and np.array_equal(label[rest], plain.node)
        if not same or not np.array_equal(with_springs.dof[rest], plain.dof):
            raise InputError(_UNTOLD)
        at = np.flatnonzero(free)
        spring = with_springs.node[at] - first
        right = with_springs.dof[at] == direction[spring]
        at, spring = at[right], spring[right]
        order = np.argsort(spring)
        if not np.array_equal(spring[order], np.arange(count)):
            raise InputError(_UNTOLD)
        S = -sp.csr_array(with_springs.K[at[order]][:, rest])
        S.eliminate_zeros()
        change = with_springs.K[rest][:, rest] - S.T @ S - plain.K
        if not self.flat.steps and abs(change).max() > TOL.same_stiffness * abs(plain.K).max():
            raise InputError(_UNTOLD)
        return S

    def _run(self, name: str, text: str, done: str = _DONE) -> None:
        path = self.folder.path / f"{name}.inp"
        path.write_text(text, encoding="utf-8")
        count = len(self.flat.ids)
        late = f"ccx did not finish in {self.seconds:g} s ({count:,} nodes); --engine-timeout, or own assembly"
        try:
            ended = run(
                [self.program.path, name],
                self.folder.path,
                seconds=self.seconds,
                memory=psutil.virtual_memory().total,
                environment={"OMP_NUM_THREADS": "1"},
                late=late,
            )
        finally:
            if self.keep is not None:
                for file in self.folder.path.glob(f"{name}.*"):
                    copy_into(self.keep, file)
                copy_into(self.keep, self.folder.path / "output.txt", f"{name}.output.txt")
        errors = _errors(ended.output)
        if errors or done not in ended.output or (not done and ended.status < 0):
            reason = self._translate("; ".join(errors[:3])) if errors else ended.last_words
            raise InputError(
                f"ccx: {reason}{'' if self.keep else '; --keep-files DIR keeps its files'}", kind="unsupported"
            )

    def _translate(self, output: str) -> str:
        """The words of ccx with labels of the deck behind those of the flat deck."""

        def own(match: re.Match[str]) -> str:
            number = int(match[2])
            if match[1].lower() == "node":
                return f"{match[0]} (label {self._label(number)} of the deck)"
            labels = self.flat.elements
            known = 0 < number <= len(labels)
            return f"{match[0]} (label {labels[number - 1]} of the deck)" if known else match[0]

        return _NUMBER.sub(own, output)

    def _label(self, number: int) -> int:
        ids = self.flat.ids
        return int(ids[number - 1]) if 0 < number <= len(ids) else number


_UNTOLD = (
    "how dependent dofs follow others could not be read from ccx: springs to them change other rows of its model; "
    "please report it with the files that --keep-files DIR leaves"
)


def _errors(output: str) -> list[str]:
    """Each *ERROR with the lines that go on with it, once."""
    errors, lines = [], output.splitlines()
    for i, line in enumerate(lines):
        if "*ERROR" in line.upper():
            rest = []
            for following in lines[i + 1 : i + 4]:
                if not following.strip() or "*" in following[:3]:
                    break
                rest.append(following.strip())
            errors.append(" ".join([line.strip(), *rest]))
    return list(dict.fromkeys(errors))
