"""Static equilibria of a component that is being tabulated, in a file, so that a run that was ended can go on.

The file is replaced as a whole, never changed in place.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.dynamics.gmp.tolerances import TOL
from morembs.storage.checksums import Checksums
from morembs.storage.contents import own_files
from morembs.storage.hdf5 import reading, refuse_newer
from morembs.storage.safefile import check_writable
from morembs.storage.table import Row, Table, read_rows
from morembs.storage.table_check import TableCheck
from morembs.storage.writer import writing

Key = tuple[int, int, int, int]


class EquilibriaFormat:
    """Format of a file of equilibria, whose attribute ``kind`` is the name and the version."""

    NAME = "morembs equilibria"
    VERSION = 1


_EQUILIBRIA = Table(
    (
        Row("signature", "real", "any", doc="of the component"),
        Row("options", "text", doc="of the run, as JSON"),
        Row("reach", "real", units="rad", doc="0 while it is not known"),
        Row("notes", "text", doc="as JSON"),
        Row(
            "keys",
            "whole",
            "n 4",
            doc="two fractions, numerator and denominator: the place of t1 and t2 among Chebyshev "
            "points, t = reach sin(pi fraction)",
        ),
        Row("X", "real", "n N"),
        Row("W", "real", "n"),
        Row("moments", "real", "n 2"),
        Row("modes", "real", "n N 2"),
    )
)
_NAMES = ("X", "W", "moments", "modes")


class Checkpoint:
    """Equilibria in the file ``path``, those of an earlier run to begin with.

    Args:
        signature: (k,) numbers that tell the component from others.
        options: what the equilibria depend on besides, as text.

    Raises:
        InputError: the file is of another component or run, or none of this kind.
        OutputError: it cannot be written.
    """

    def __init__(self, path: str | Path, *, signature: Floats, options: str) -> None:
        self.path, self.signature, self.options = Path(path), np.asarray(signature, dtype=float), options
        self.reach, self.notes = 0.0, ()
        self.equilibria: dict[Key, dict[str, Any]] = {}
        self._last, self._took, self._unsaved = -np.inf, 0.0, False
        check_writable(self.path)
        if self.path.exists():
            self._read()

    reach: float
    notes: tuple[str, ...]

    def _read(self) -> None:
        cure = "give the name of another such file, or of a new one"
        with own_files(), reading(self.path, "equilibria of an earlier run", cure) as file:
            kind, _, version = str(file.attrs.get("kind")).rpartition(" ")
            if kind != EquilibriaFormat.NAME or not version.isdecimal():
                raise KeyError("kind")
            refuse_newer(self.path, int(version), EquilibriaFormat.VERSION, f"install a newer one, or {cure}")
            if len(file["keys"]):
                TableCheck(self.path, file, "file of equilibria", cure).table("", _EQUILIBRIA, {})
            values = read_rows(file, _EQUILIBRIA)
            signature, options, notes = values["signature"], values["options"], json.loads(values["notes"])
            if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
                raise ValueError("notes")
            Checksums(self.path, file).verify()
        same = signature.shape == self.signature.shape and np.allclose(
            signature, self.signature, rtol=TOL.same_signature, atol=0
        )
        if not same or options != self.options:
            what = f"with the options {options}, not {self.options}" if same else "of another component"
            raise InputError(
                f"{self.path} holds equilibria {what}; give the name of a new file, or remove this one to begin again",
                kind="conflict",
                keyword="checkpoint",
            )
        self.reach, self.notes = values["reach"], tuple(notes)
        for row, key in enumerate(values["keys"]):
            a, b, c, d = (int(number) for number in key)
            self.equilibria[a, b, c, d] = {name: values[name][row] for name in _NAMES}

    def begin(self, reach: float, notes: tuple[str, ...]) -> None:
        """The range is known now, or another one; equilibria of the last one go."""
        if reach != self.reach:
            self.equilibria = {}
        self.reach, self.notes, self._unsaved = reach, notes, True

    def add(self, key: Key, **values: Any) -> None:
        """One equilibrium more; a file is written where the last is not too recent."""
        self.equilibria[key], self._unsaved = values, True
        if time.monotonic() - self._last >= TOL.checkpoint_interval * self._took:
            self.save()

    def save(self) -> None:
        """Write the file, if there is anything new.

        Raises:
            OutputError: it cannot be written; the old file stays.
        """
        if not self._unsaved:
            return
        begin = time.monotonic()
        with writing(self.path) as out:
            file = out.file
            file.attrs["kind"] = f"{EquilibriaFormat.NAME} {EquilibriaFormat.VERSION}"
            file["signature"], file["options"] = self.signature, self.options
            file["reach"], file["notes"] = self.reach, json.dumps(self.notes)
            file["keys"] = np.array(list(self.equilibria), dtype=np.int64).reshape(-1, 4)
            first = next(iter(self.equilibria.values()), None)
            for name in _NAMES:
                out.name_step(name)
                shape = np.shape(first[name]) if first is not None else (0,)
                data = file.create_dataset(name, (len(self.equilibria), *shape), dtype=np.float64)
                for row, values in enumerate(self.equilibria.values()):
                    data[row] = values[name]
                out.check()
        self._last, self._unsaved = time.monotonic(), False
        self._took = self._last - begin
