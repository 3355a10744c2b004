"""Programs of npm that judge what is written: fetched once into a folder, and run by node."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

UNREACHABLE = ("ENOTFOUND", "EAI_AGAIN", "ECONNREFUSED", "ECONNRESET", "ETIMEDOUT", "ENETUNREACH")  # codes of npm
NODE = shutil.which("node") if shutil.which("npm") else None


def fetched(package: str, folder: Path) -> Path:
    """The folder of a package, in ``folder``/node_modules; the test is skipped where the registry cannot be reached."""
    npm = ["npm", "install", "--no-save", "--no-audit", "--no-fund", "--prefer-offline", "--prefix", str(folder)]
    done = subprocess.run([*npm, package], capture_output=True, text=True)
    if any(code in done.stderr for code in UNREACHABLE):
        pytest.skip(f"the registry of npm cannot be reached for {package}")
    assert done.returncode == 0, done.stderr
    return folder / "node_modules" / package.rpartition("@")[0]


def evaluated(script: str, *arguments: object) -> Any:
    """What a script of node prints, as JSON."""
    command = [str(NODE), "-e", script, *map(str, arguments)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
