"""Static equilibria of a component that is being tabulated, in a file, so that a run that was ended can go on.

The file is replaced as a whole, never changed in place. Datasets: ``signature`` of the component, ``options`` of the
run (JSON), ``reach`` (rad, 0 while it is not known), ``notes`` (JSON), and per equilibrium a row of ``keys`` (n, 4),
``X`` (n, N), ``W`` (n,), ``moments`` (n, 2), ``modes`` (n, N, 2). A key holds two fractions, numerator and
denominator: the place of t1 and t2 among Chebyshev points, t = reach sin(pi fraction).
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.storage.checksums import Checksums, seal
from morembs.storage.hdf5 import reading, refuse_newer
from morembs.storage.safefile import check_writable, replacing

Floats = NDArray[np.float64]
Key = tuple[int, int, int, int]
# The attribute ``kind`` is this and the version.
_KIND, _VERSION = "morembs equilibria", 1
_NAMES = ("X", "W", "moments", "modes")
# Time between two files per time that one takes; relative difference of signatures of one component.
_SELDOM, _SAME = 10.0, 1e-8


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
        self.found: dict[Key, dict[str, Any]] = {}
        self._last, self._took, self._unsaved = -np.inf, 0.0, False
        check_writable(self.path)
        if self.path.exists():
            self._read()

    reach: float
    notes: tuple[str, ...]

    def _read(self) -> None:
        cure = "give the name of another such file, or of a new one"
        with reading(self.path, "equilibria of an earlier run", cure) as file:
            kind, _, version = str(file.attrs.get("kind")).rpartition(" ")
            if kind != _KIND or not version.isdecimal():
                raise KeyError("kind")
            refuse_newer(self.path, int(version), _VERSION, f"install a newer one, or {cure}")
            signature, options = file["signature"][()], str(file["options"].asstr()[()])
            values = {name: file[name][()] for name in ("keys", *_NAMES)}
            reach, notes = float(file["reach"][()]), json.loads(file["notes"].asstr()[()])
            n, N = len(values["keys"]), values["X"].shape[-1] if values["X"].ndim else 0
            expected = {"keys": (n, 4), "X": (n, N), "W": (n,), "moments": (n, 2), "modes": (n, N, 2)}
            for name, shape in expected.items() if n else ():
                if values[name].shape != shape:
                    raise ValueError(f"{name} has the shape {values[name].shape}, expected {shape}")
            if values["keys"].dtype.kind not in "iu":
                raise ValueError("keys are no integers")
            for name in _NAMES:
                if values[name].dtype.kind != "f" or not np.isfinite(values[name]).all():
                    raise ValueError(f"{name} holds what is no finite number")
            if not isinstance(notes, list) or not all(isinstance(note, str) for note in notes):
                raise ValueError("notes")
            Checksums(self.path, file).verify()
        same = signature.shape == self.signature.shape and np.allclose(signature, self.signature, rtol=_SAME, atol=0)
        if not same or options != self.options:
            what = f"with the options {options}, not {self.options}" if same else "of another component"
            raise InputError(
                f"{self.path} holds equilibria {what}; give the name of a new file, or remove this one to begin anew"
            )
        self.reach, self.notes = reach, tuple(notes)
        for row, key in enumerate(values["keys"]):
            a, b, c, d = (int(number) for number in key)
            self.found[a, b, c, d] = {name: values[name][row] for name in _NAMES}

    def begin(self, reach: float, notes: tuple[str, ...]) -> None:
        """The range is known now, or another one; equilibria of the last one go."""
        if reach != self.reach:
            self.found = {}
        self.reach, self.notes, self._unsaved = reach, notes, True

    def add(self, key: Key, **values: Any) -> None:
        """One equilibrium more; a file is written where the last is not too recent."""
        self.found[key], self._unsaved = values, True
        if time.monotonic() - self._last >= _SELDOM * self._took:
            self.save()

    def save(self) -> None:
        """Write the file, if there is anything new.

        Raises:
            OutputError: it cannot be written; the old file stays.
        """
        if not self._unsaved:
            return
        begin = time.monotonic()
        with replacing(self.path) as safe, h5py.File(safe, "w", libver=("earliest", "v108"), rdcc_nbytes=0) as file:
            file.attrs["kind"] = f"{_KIND} {_VERSION}"
            file["signature"], file["options"] = self.signature, self.options
            file["reach"], file["notes"] = self.reach, json.dumps(self.notes)
            file["keys"] = np.array(list(self.found), dtype=np.int64).reshape(-1, 4)
            first = next(iter(self.found.values()), None)
            for name in _NAMES:
                safe.doing = name
                shape = np.shape(first[name]) if first is not None else (0,)
                data = file.create_dataset(name, (len(self.found), *shape), dtype=np.float64)
                for row, values in enumerate(self.found.values()):
                    data[row] = values[name]
                safe.check()
            safe.doing = "the checksums"
            seal(file)
            safe.check()
        self._last, self._unsaved = time.monotonic(), False
        self._took = self._last - begin
