"""What runs load late, loaded once for all children."""

from __future__ import annotations

import contextlib
import importlib
import pkgutil

MODULES = (
    "h5py",
    "matplotlib.backends.backend_agg",
    "matplotlib.pyplot",
    "meshio",
    "pydantic.type_adapter",
    "scipy.io",
    "morembs.app.cli.commands",
    "morembs.dynamics.gmp.stored",
    "morembs.dynamics.nonlinear",
    "rich.table",
    "casadi",
)


def everything() -> None:
    """Load them, and measure the machine; libraries that are not installed are passed over."""
    for name in MODULES:
        try:
            importlib.import_module(name)
        except ImportError:
            if name.startswith("morembs."):
                raise
    from morembs.linalg.sparse.threads import measured_speed

    # Each check would measure it anew, which takes as long as a small job.
    measured_speed()


def package() -> None:
    """Every module of the program too; those of simulators that are not installed are passed over."""
    everything()
    import morembs

    for found in pkgutil.walk_packages(morembs.__path__, "morembs."):
        if not found.name.endswith("__main__"):
            with contextlib.suppress(ImportError):
                importlib.import_module(found.name)
    for name in ("encodings.latin_1", "encodings.ascii", "psutil"):
        importlib.import_module(name)
