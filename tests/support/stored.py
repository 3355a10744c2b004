"""What HDF5 files hold, to the last bit."""

from __future__ import annotations

import h5py


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
