"""A reduced motion over time, and the files it comes in: .npz, tables with a header, HDF5."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError, MorembsError, nearest
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.body.tolerances import TOL
from morembs.body.vtkhdf_series import read_arrays
from morembs.storage.archive import refuse_unsafe_archive

TABLES = (".csv", ".txt", ".dat")
HDF5 = (".h5", ".hdf5", ".hdf")
_FRAME = ("x", "y", "z")
_ROTATION = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Motion of one body: ``times`` (nt,) in s, ascending, and ``coordinates`` (nt, nr) of the reduced model or
    (nt, n) of the elastic coordinates of its floating frame.

    With elastic coordinates ``position`` (nt, 3) in m and ``rotation`` (nt, 3, 3) are those of the frame (rotation
    takes components along the body's axes to those of the ground). ``loads`` (nt, m) are the forces and moments that
    joints and neighbours put on the body at its interfaces, one for each column of the input matrix, along the body's
    axes.

    Raises:
        InputError: shapes that do not fit, numbers that are not finite, times that do not ascend, no rotation.

    >>> Trajectory(times=np.linspace(0, 1, 11), coordinates=np.zeros((11, 18)))
    Trajectory: times 11 numbers; coordinates 11×18 numbers
    """

    times: Floats
    coordinates: Floats
    position: Floats | None = None
    rotation: Floats | None = None
    loads: Floats | None = None

    def __post_init__(self) -> None:
        for attribute in fields(self):
            if getattr(self, attribute.name) is not None:
                object.__setattr__(self, attribute.name, _numbers(attribute.name, getattr(self, attribute.name)))
        if self.times.ndim != 1:
            raise InputError(
                f"times has the shape {self.times.shape}; expected (any), one number for each step", keyword="times"
            )
        nt = len(self.times)
        shapes = {"times": (nt,), "coordinates": (nt, None), "position": (nt, 3), "rotation": (nt, 3, 3)}
        for name, shape in {**shapes, "loads": (nt, None)}.items():
            value = getattr(self, name)
            if value is None:
                continue
            if len(shape) != value.ndim or any(b not in (None, a) for a, b in zip(value.shape, shape, strict=True)):
                wanted = ", ".join("any" if size is None else str(size) for size in shape)
                raise InputError(
                    f"{name} has the shape {value.shape}; expected ({wanted}), one row for each time", keyword=name
                )
            bad = np.flatnonzero(~np.isfinite(value.reshape(nt, value.size // max(nt, 1))).all(axis=1))
            if len(bad):
                raise InputError(
                    f"{name} holds a number that is not finite at step {bad[0] + 1} of {nt}; the simulation went wrong "
                    "there: give the steps before it",
                    keyword=name,
                )
        if not nt:
            raise InputError("the trajectory has no steps; give at least one", kind="missing", keyword="times")
        back = np.flatnonzero(np.diff(self.times) <= 0)
        if len(back):
            at = back[0]
            raise InputError(
                f"times must ascend, but step {at + 2} at {self.times[at + 1]:.9g} s follows {self.times[at]:.9g} s; "
                "give each time once and in order",
                kind="value",
                keyword="times",
            )
        if self.rotation is not None:
            off = np.abs(self.rotation @ np.swapaxes(self.rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
            wrong = np.flatnonzero((off > TOL.rotation_error) | (np.linalg.det(self.rotation) < 0))
            if len(wrong):
                raise InputError(
                    f"rotation at step {wrong[0] + 1} is no rotation (A A' - I = {off[wrong[0]]:.1e}); expected "
                    "orthonormal matrices (3, 3) with determinant 1, no angles",
                    keyword="rotation",
                )

    def refuse_too_large(self, name: str, results: Floats) -> None:
        """Refuse ``results`` (nt, ...) of these steps that a series in single precision cannot hold.

        Raises:
            InputError: there are some; the first step is in the message.
        """
        size = np.abs(results.reshape(len(results), -1)).max(axis=1, initial=0.0)
        bad = np.flatnonzero(~(size <= TOL.largest_stress))
        if len(bad):
            step = int(bad[0])
            given = (self.coordinates, self.loads, self.position)
            largest = max(float(np.abs(array[step]).max(initial=0.0)) for array in given if array is not None)
            raise InputError(
                f"{name} at {self.times[step]:.9g} s is {size[step]:.3g}, from numbers up to {largest:.3g}; expected "
                f"{TOL.largest_stress:.1e} at most: check the units, or give the steps before the simulation went wrong"
            )

    def part(self, steps: slice) -> Trajectory:
        """The same at some of the steps."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        return Trajectory(**{name: value[steps] for name, value in given.items()})


def _numbers(name: str, value: Any) -> Floats:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "iuf":
            raise ValueError(f"it holds {array.dtype}")
        return np.asarray(array, dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{name} cannot be taken as numbers ({error}); expected an array of real numbers") from error


def read_trajectory(path: str | Path) -> Trajectory:
    """Trajectory of a file.

    NPZ and HDF5 files hold arrays time (or times), coordinates and perhaps position, rotation, loads as in
    ``Trajectory``.
    Tables (.csv, .txt, .dat; columns apart by comma, semicolon or blanks) begin with the names of their columns: t,
    q1, q2, ..., and perhaps x, y, z and r11, r12, ..., r33 of the frame (r12: row 1, column 2) and loads f1, f2, ...

    Args:
        path: .npz, .h5, .csv, .txt or .dat.

    Raises:
        InputError: no such file, another format, or what ``Trajectory`` refuses.

    >>> np.savez("motion.npz", time=np.linspace(0, 1, 11), coordinates=np.zeros((11, 18)))
    >>> read_trajectory("motion.npz").coordinates.shape
    (11, 18)
    """
    place = Path(path)
    if not place.is_file():
        raise InputError(f"{place} was given as a trajectory; there is no such file", kind="file", keyword=place.name)
    kind = place.suffix.lower()
    if kind in TABLES:
        arrays = _read_table(place)
    elif kind == ".npz":
        arrays = _read_npz(place)
    elif kind in HDF5:
        arrays = read_arrays(place)
    else:
        raise InputError(
            f"{place}: a trajectory is an .npz file, a table ({', '.join(TABLES)}) or an HDF5 file ({', '.join(HDF5)})",
            kind="file",
        )
    if "time" in arrays and "times" in arrays:
        raise InputError(
            f"{place} holds both time and times; expected one of them, leave the other out", kind="conflict"
        )
    arrays = {"times" if name == "time" else name: value for name, value in arrays.items()}
    known = [attribute.name for attribute in fields(Trajectory)]
    for name in arrays:
        if name not in known:
            raise InputError(f"{place} holds an array {name!r}; {nearest(name, known)}", kind="unknown")
    for name in ("times", "coordinates"):
        if name not in arrays:
            raise InputError(f"{place} holds no array {name!r}; expected times and coordinates")
    try:
        return Trajectory(**arrays)
    except InputError as error:
        raise error.restate(f"{place}: {error}") from error


def _read_npz(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            if isinstance(file, np.lib.npyio.NpzFile):
                refuse_unsafe_archive(path.name, file.zip)
            return {name: file[name] for name in file.files}
    except MorembsError:
        raise
    except Exception as error:  # zipfile and numpy raise many kinds
        raise InputError(
            f"{path} cannot be read as an .npz file ({error}); save it with numpy.savez", kind="file", keyword=path.name
        ) from error


def _read_table(path: Path) -> dict[str, Any]:
    try:
        with path.open(encoding="utf-8-sig") as file:
            head = file.readline().rstrip("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path} cannot be read as a text file ({error})", kind="file", keyword=path.name) from error
    comma = next((sign for sign in ";," if sign in head), None)
    names = [name.strip().strip("\"'").lower() for name in head.lstrip("# ").split(comma) if name.strip()]
    if not names or names[0] not in ("t", "time"):
        raise InputError(f"{path} begins with {head[:60]!r}; expected the names of its columns: t, q1, q2, ...")
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path} has {names.count(twice)} columns {twice!r}; expected each name once", kind="conflict")
    try:
        with warnings.catch_warnings():
            # No rows: that is said below.
            warnings.simplefilter("ignore", UserWarning)
            table = np.loadtxt(path, delimiter=comma, skiprows=1, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise InputError(f"{path} has a row that is not like the others or not of numbers ({error})") from error
    if len(table) and table.shape[1] != len(names):
        raise InputError(f"{path} names {len(names)} columns in its first line, but its rows have {table.shape[1]}")
    table = table.reshape(len(table), len(names))
    arrays: dict[str, Any] = {"times": table[:, 0], "coordinates": table[:, _columns(path, names, "q")]}
    loads = _columns(path, names, "f")
    if loads:
        arrays["loads"] = table[:, loads]
    for name, group in (("position", _FRAME), ("rotation", _ROTATION)):
        if any(column in names for column in group):
            missing = [column for column in group if column not in names]
            if missing:
                raise InputError(f"{path} has some columns of the {name} but not {', '.join(missing)}")
            arrays[name] = table[:, [names.index(column) for column in group]]
    if "rotation" in arrays:
        arrays["rotation"] = arrays["rotation"].reshape(-1, 3, 3)
    for column in names[1:]:
        if column not in (*_FRAME, *_ROTATION) and not re.fullmatch(r"[qf]\d+", column):
            raise InputError(
                f"{path} has a column {column!r}; expected t, q1, ..., x, y, z, f1, ... and for rotations r11, r12, "
                "..., r33 (matrices, no angles)"
            )
    return arrays


def _columns(path: Path, names: list[str], letter: str) -> list[int]:
    """Places of q1, q2, ... in the order of their numbers."""
    count = sum(bool(re.fullmatch(rf"{letter}\d+", name)) for name in names)
    wanted = [f"{letter}{number}" for number in range(1, count + 1)]
    for name in wanted:
        if name not in names:
            raise InputError(f"{path} has {count} columns {letter}1, {letter}2, ... but no {name}")
    return [names.index(name) for name in wanted]
