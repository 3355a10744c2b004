"""What HDF5 files hold, to the last bit."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np


def datasets(path: Path) -> dict[str, np.ndarray]:
    """Values of all datasets of a file by their names, but of /provenance."""
    values = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: values.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return {name: np.asarray(value) for name, value in values.items() if not name.startswith("provenance")}


def everything(file):
    """Type, shape and bytes of every object and attribute outside /provenance."""
    datasets = {}

    def note(name, item):
        if name.split("/")[0] == "provenance":
            return
        value = (item.dtype.str, item.shape, item[()].tobytes()) if isinstance(item, h5py.Dataset) else "group"
        datasets[name] = value, {k: (v.dtype.str, v.tobytes()) for k, v in sorted(item.attrs.items())}

    file.visititems(note)
    return datasets
