"""Ways to damage one array within a file of arrays, which is a valid file of its format again."""

from __future__ import annotations

import random
from collections.abc import Callable, MutableMapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

Dice = random.Random


def _value(array: Any, dice: Dice, values: tuple[Any, ...]) -> Any:
    flat = np.array(array).reshape(-1)
    if flat.size and flat.dtype.kind in "iufc":
        with np.errstate(all="ignore"):
            value = np.array([dice.choice(values)]).astype(flat.dtype)
        flat[dice.randrange(flat.size)] = value[0]
    return flat.reshape(np.shape(array))


ARRAYS: dict[str, Callable[[Any, Dice], Any]] = {
    "value nan": lambda a, dice: _value(a, dice, (np.nan, np.inf, -np.inf)),
    "value huge": lambda a, dice: _value(a, dice, (1e300, 1e80, -1e30, 2**62, 2**31)),
    "value small": lambda a, dice: _value(a, dice, (0, -1, 1, 7, 1e-300)),
    "shorter": lambda a, dice: np.asarray(a).reshape(-1)[: max(0, np.size(a) - dice.choice((1, 3, 10**6)))],
    "longer": lambda a, dice: np.concatenate([np.asarray(a).reshape(-1)] * 2),
    "transposed": lambda a, dice: np.asarray(a).T[..., None] if dice.random() < 0.5 else np.asarray(a).T,
    "reversed": lambda a, dice: np.asarray(a).reshape(-1)[::-1].reshape(np.shape(a)),
    "kind": lambda a, dice: _kind(np.asarray(a), dice),
    "scalar": lambda a, dice: np.array(dice.choice((0, -1, 1.5, np.nan, 10**12))),
    "empty": lambda a, dice: np.zeros(dice.choice(((0,), (0, 3), (3, 0)))),
}


def _kind(array: Any, dice: Dice) -> Any:
    if array.dtype.kind in "SUO":
        return np.arange(max(1, array.size))
    with np.errstate(all="ignore"):
        return array.astype(dice.choice(("float32", "int8", "uint64", "complex128", "bool", "float16", "S8", ">f8")))


def _other_array(held: MutableMapping[str, Any], dice: Dice) -> str:
    """Change one array of a mapping; what was done."""
    name = dice.choice(sorted(held))
    how = dice.choice([*ARRAYS, "lost", "renamed", "other's"])
    if how in ARRAYS:
        held[name] = ARRAYS[how](held[name], dice)
    elif how == "lost":
        del held[name]
    elif how == "renamed":
        held[name + "x"] = held.pop(name)
    else:
        held[name] = held[dice.choice(sorted(held))]
    return f"array {how}: {name}"


def npz_arrays(path: Path, dice: Dice) -> str:
    """Damage an array of a NumPy archive."""
    with np.load(path, allow_pickle=False) as file:
        held = dict(file)
    words = _other_array(held, dice)
    np.savez(path, **held)
    return words


def mat_arrays(path: Path, dice: Dice) -> str:
    """Damage an array of a MATLAB file."""
    import scipy.io

    held = {name: value for name, value in scipy.io.loadmat(path).items() if not name.startswith("__")}
    held = {name: value.toarray() if hasattr(value, "toarray") else value for name, value in held.items()}
    words = _other_array(held, dice)
    scipy.io.savemat(path, held)
    return words


def hdf5_items(path: Path, dice: Dice) -> str:
    """Damage one dataset or link of an HDF5 file."""
    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        groups = sorted({name.rsplit("/", 1)[0] for name in names if "/" in name})
        name = dice.choice(sorted(names))
        how = dice.choice([*ARRAYS, *ARRAYS, "lost", "group lost", "other's", "hollow", "loop", "dangling", "external"])
        attributes = dict(file[name].attrs)
        value = file[name][()]
        if how == "group lost" and groups:
            name = dice.choice(groups)
        del file[name]
        if how in ARRAYS:
            file[name] = ARRAYS[how](value, dice)
            file[name].attrs.update(attributes)
        elif how == "other's" and file.get(other := dice.choice(names)) is not None:
            file[name] = file[other]
        elif how == "hollow":
            file.create_dataset(name, shape=(10**11,), dtype="f8", chunks=(1024,))
        elif how == "loop":
            file[name] = h5py.SoftLink(f"/{name}")
        elif how == "dangling":
            file[name] = h5py.SoftLink("/nowhere")
        elif how == "external":
            file[name] = h5py.ExternalLink("elsewhere.h5", "/there")
    return f"array {how}: {name}"


# Files whose arrays are damaged one by one, besides their bytes.
INSIDE: dict[str, Callable[[Path, Dice], str]] = {
    ".npz": npz_arrays,
    ".mat": mat_arrays,
    ".h5": hdf5_items,
    ".med": hdf5_items,
}
