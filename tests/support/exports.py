"""Exported files, read and simulated as the documents of their formats say."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

NO_RUMOCA = "Rumoca is not installed: pip install rumoca"


def extptfm_file(path: Path) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Matrices and loads by the keywords of the documentation, in any case; other lines with ! are comments."""
    lines = path.read_text().splitlines()
    assert lines[0].startswith("!") and "flex 5 format" in lines[1].lower()
    header: dict[str, float] = {}
    matrices: dict[str, np.ndarray] = {}
    at = 0
    while at < len(lines):
        line = lines[at].lower()
        for key in ("!dimension:", "!time increment in simulation:", "!total simulation time in file:"):
            if line.startswith(key):
                header.setdefault(key, float(line.removeprefix(key)))
        at += 1
        n = int(header.get("!dimension:", 0))
        for key in ("mass matrix", "stiffness matrix", "damping matrix"):
            if line.startswith(f"!{key}"):
                matrices[key] = np.array([row.split() for row in lines[at + 1 : at + 1 + n]], dtype=float)
                at += 1 + n
        if line.startswith("!loading"):
            steps = round(header["!total simulation time in file:"] / header["!time increment in simulation:"]) + 1
            matrices["loads"] = np.array([row.split() for row in lines[at + 1 : at + 1 + steps]], dtype=float)
            at += 1 + steps
    return header, matrices


def mbdyn_groups(path: Path) -> dict[int | str, list[str] | int]:
    """Record groups as MBDyn reads them: a '**' line with the number, comments, then numbers or words."""
    text = path.read_text()
    assert text.endswith("** END OF FILE\n")
    records: dict[int | str, list[str] | int] = {}
    for part in re.split(r"^\*\* RECORD GROUP ", text, flags=re.MULTILINE)[1:]:
        number, _, rest = part.partition(",")
        words = [line for line in rest.split("\n")[1:] if not line.startswith("**")]
        records[int(number)] = " ".join(words).split()
        # MBDyn skips one line of comment in front of each mode.
        if int(number) == 8:
            records["modes"] = sum(line.startswith("**    NORMAL MODE") for line in rest.split("\n"))
    return records


def simulated_modelica(text: str, model: str, end: float, names: Sequence[str]) -> np.ndarray:
    """Values (n,) of variables of a Modelica model at the end, by Rumoca."""
    rumoca = pytest.importorskip("rumoca", reason=NO_RUMOCA)
    result = (
        rumoca.Session()
        .loads(text, model=model)
        .simulate((0, end), dt=end / 20, config=rumoca.SimConfig(solver="bdf", rtol=1e-9, atol=1e-12))
    )
    return np.array([result[name][-1] for name in names])
