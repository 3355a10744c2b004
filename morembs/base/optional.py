"""Packages that are used only where they are installed."""

from __future__ import annotations

import importlib
from typing import Any

from morembs.base.errors import InputError


def optional(module: str, what: str) -> Any:
    """The ``module``, which ``what`` needs.

    Raises:
        InputError: it is not installed, or cannot be loaded.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise InputError(
            f"{what} needs the package {package} ({error}); to get it: pip install {package}",
            kind="program",
            keyword=package,
        ) from error
