"""What runs load late, loaded once for all children."""

from __future__ import annotations

import importlib

MODULES = (
    "h5py", "matplotlib.backends.backend_agg", "matplotlib.pyplot", "meshio", "scipy.io", "morembs.cli.commands",
    "morembs.gmp.stored", "morembs.nonlinear", "rich.table", "casadi",
)  # fmt: skip


def everything() -> None:
    """Load them; libraries that are not installed are passed over."""
    for name in MODULES:
        try:
            importlib.import_module(name)
        except ImportError:
            if name.startswith("morembs."):
                raise
