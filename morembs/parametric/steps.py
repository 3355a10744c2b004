"""Steps of a greedy search in files beside the body file, so that a run that was ended goes on where it was."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from glob import escape
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.parametric.terms import AffineProblem
from morembs.storage.checksums import Checksums
from morembs.storage.contents import own_files
from morembs.storage.hdf5 import reading
from morembs.storage.writer import writing

MARK = ".search-"


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """What joined a basis: the values ``p`` (P,) with the largest bound ``value`` at ``hz``, and ``columns`` (Nc, k)
    from there, which are read when they are needed."""

    p: Floats
    value: float
    hz: float
    columns: Floats | None = None


class SearchSteps:
    """The steps of the search ``kind`` on ``problem``, those of an earlier run to begin with; without ``path`` none are
    kept. Each is a file of its own beside ``path``, of the size of its columns."""

    def __init__(self, problem: AffineProblem, kind: str, path: Path | None) -> None:
        self.path, self.signature = path, "" if path is None else _signature(problem, kind)
        self.known: list[Step] = []
        while (step := self._read(len(self.known), columns=False)) is not None:
            self.known.append(step)

    def _file(self, number: int) -> Path | None:
        if self.path is None:
            return None
        return self.path.with_name(f"{self.path.name}{MARK}{self.signature[:8]}-{number}.h5")

    def _read(self, number: int, *, columns: bool) -> Step | None:
        """A step of an earlier run, None where there is none, or a damaged one."""
        place = self._file(number)
        if place is None or not place.exists():
            return None
        try:
            with own_files(), reading(place, "a step of a search") as file:
                Checksums(place, file).verify()
                if file["signature"][()] != self.signature.encode():
                    return None
                return Step(
                    p=file["p"][()],
                    value=float(file["value"][()]),
                    hz=float(file["hz"][()]),
                    columns=file["columns"][()] if columns else None,
                )
        except InputError:
            return None

    def columns(self, number: int) -> Floats | None:
        """Columns of step ``number``, None where they have to be computed."""
        step = self._read(number, columns=True) if number < len(self.known) else None
        return None if step is None else step.columns

    def add(self, number: int, step: Step) -> None:
        """Keep a step that was computed.

        Raises:
            OutputError: its file cannot be written.
        """
        place = self._file(number)
        if place is None or step.columns is None:
            return
        with writing(place) as file:
            file.put("signature", np.bytes_(self.signature.encode()), "of the model, its parameters and the search")
            file.put("p", step.p, "values of the parameters")
            file.put("value", step.value, "largest bound before")
            file.put("hz", step.hz, "where that is", "Hz")
            file.columns("columns", step.columns, "what joins the basis")
        self.known[number : number + 1] = [replace(step, columns=None)]


def clear_steps(path: Path) -> None:
    """Remove the steps of all searches for the body file ``path``, which is written."""
    for file in path.parent.glob(f"{escape(path.name)}{MARK}*-*.h5"):
        file.unlink(missing_ok=True)


def _signature(problem: AffineProblem, kind: str) -> str:
    """Of everything that the steps depend on."""
    box, words = problem.box, [kind, repr(problem.damping), repr(problem.box.names), repr(problem.box.kinds)]
    found = hashlib.sha256("\n".join(words).encode())
    parts = [box.low, box.high, box.nominal, problem.rigid, problem.B.data, problem.B.indices]
    for terms in (problem.K_terms, problem.M_terms):
        parts += [array for A in terms for array in (A.data, A.indices)]
    for part in parts:
        found.update(np.ascontiguousarray(part).view(np.uint8).data)
    return found.hexdigest()
