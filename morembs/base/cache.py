"""The cache folder of the user: what takes time to find out about a machine, kept from run to run.

Nothing depends on it. A folder that cannot be written and a file that cannot be read only mean that things are found
out again.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path


def cache_folder() -> Path:
    """The folder ``morembs`` below ``XDG_CACHE_HOME``, by default where the system keeps caches; it may not be there.

    Source: XDG Base Directory Specification 0.8 (relative paths are ignored).

    Raises:
        RuntimeError: the user has no home.
    """
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        if Path(parent := os.environ.get(variable, "")).is_absolute():
            return Path(parent) / "morembs"
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "morembs"


def read_cached(name: str) -> object:
    """What was kept under ``name``; None where nothing is, or nothing that can be read."""
    with contextlib.suppress(OSError, RuntimeError, ValueError):
        path = cache_folder() / f"{name}.json"
        # A pipe would wait for ever, and a device never end.
        if path.is_file():
            with path.open("rb") as file:
                return json.loads(file.read(1 << 16))
    return None


def keep_cached(name: str, values: Mapping[str, object]) -> None:
    """Keep plain values under ``name``, for this user alone; nothing happens where the folder cannot be written."""
    with contextlib.suppress(OSError, RuntimeError):
        folder = cache_folder()
        folder.mkdir(mode=stat.S_IRWXU, parents=True, exist_ok=True)
        # mkstemp makes files that others cannot read. Another run sees the old file or the whole new one.
        handle, new = tempfile.mkstemp(dir=folder, prefix=f"{name}.", suffix=".part")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(values, file)
            os.replace(new, folder / f"{name}.json")
        except BaseException:
            os.unlink(new)
            raise
