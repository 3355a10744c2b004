"""Small decks for CalculiX, its own frequencies of them, and programs that stand in for it."""

from __future__ import annotations

import shutil
import stat
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from morembs.fem import FEModel
from morembs.importers.matrices.calculix import CalculixMatrices, read_calculix_matrices

CCX = next((path for name in ("ccx", "ccx_2.20") if (path := shutil.which(name))), None)
needs_ccx = pytest.mark.skipif(CCX is None, reason="ccx is not installed (Debian package calculix-ccx)")
STORED = Path(__file__).parents[1] / "data" / "calculix"
STEEL = "*MATERIAL, NAME=STEEL\n*ELASTIC\n2.1e11, 0.3\n*DENSITY\n7850.\n"


def grid(n: Sequence[int], size: Sequence[float], middle: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (k, 3) and hexahedra (8 or 20 nodes) of a box, rows from 0."""
    from tests.support.meshes import box

    mesh = box("hex20" if middle else "hex8", n, size)
    return mesh.nodes.xyz, mesh.blocks[0].nodes


def nodes_text(xyz: np.ndarray, first: int = 1) -> str:
    """*NODE with labels from ``first`` on."""
    return "*NODE\n" + "".join(f"{first + i}, {x:.12g}, {y:.12g}, {z:.12g}\n" for i, (x, y, z) in enumerate(xyz))


def elements_text(code: str, rows: np.ndarray, name: str, first: int = 1, label: int = 1) -> str:
    """*ELEMENT with labels from ``label`` on, of nodes with labels from ``first`` on."""
    lines = [f"*ELEMENT, TYPE={code}, ELSET={name}"]
    for i, row in enumerate(rows):
        words = [str(label + i), *(str(first + j) for j in row)]
        lines.append(",\n".join(", ".join(words[at : at + 10]) for at in range(0, len(words), 10)))
    return "\n".join(lines) + "\n"


def solids(code: str, n: Sequence[int], size: Sequence[float]) -> str:
    """A steel box without steps, elements BODY."""
    xyz, rows = grid(n, size, code.startswith("C3D20"))
    section = "*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL\n"
    return nodes_text(xyz) + elements_text(code, rows, "BODY") + STEEL + section


def on_plane(text: str, axis: int, value: float) -> list[int]:
    """Labels of the nodes of a deck on a plane."""
    lines = text.split("*NODE\n")[1].split("*")[0].split()
    rows = np.array(" ".join(lines).replace(",", " ").split(), dtype=float).reshape(-1, 4)
    return rows[np.abs(rows[:, 1 + axis] - value) < 1e-9, 0].astype(int).tolist()


def own_frequencies(deck: str, folder: Path, count: int = 6, before: str = "") -> np.ndarray:
    """Eigenvalues that ccx prints for a deck with the steps ``before`` and *FREQUENCY."""
    kind = ", PERTURBATION" if before else ""
    (folder / "own.inp").write_text(f"{deck}{before}*STEP{kind}\n*FREQUENCY\n{count}\n*END STEP\n")
    subprocess.run([str(CCX), "own"], cwd=folder, capture_output=True, check=True, timeout=60)
    lines = [line.split() for line in (folder / "own.dat").read_text().splitlines()]
    return np.array([float(fields[1]) for fields in lines if len(fields) == 5 and fields[0].isdigit()][:count])


def stored_matrices(deck: str, folder: Path, step: str = "") -> tuple[CalculixMatrices | None, str]:
    """Matrices that ccx stores of a deck with more lines in its step, None where it stops, and what it says."""
    for path in folder.glob("stored.*"):
        path.unlink()
    (folder / "stored.inp").write_text(f"{deck}*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n{step}*END STEP\n")
    done = subprocess.run([str(CCX), "stored"], cwd=folder, capture_output=True, timeout=60, check=False)
    written = folder / "stored.sti"
    read = read_calculix_matrices(written) if written.is_file() and written.stat().st_size else None
    return read, done.stdout.decode(errors="replace")


def independent(model: FEModel) -> tuple[sp.csr_array, sp.csr_array]:
    """K and M of the dofs that follow no others and carry something."""
    K, M = model.K, model.M
    if model.dependent is not None:
        T = sp.csr_array(model.dependent.S[:, np.flatnonzero(model.dependent.owner < 0)])
        K, M = sp.csr_array(T.T @ K @ T), sp.csr_array(T.T @ M @ T)
    rows = np.flatnonzero(np.abs(K.diagonal()) + np.abs(M.diagonal()) > 0)
    return sp.csr_array(K[rows][:, rows]), sp.csr_array(M[rows][:, rows])


def eigenvalues(model: FEModel, count: int = 6) -> np.ndarray:
    """The first eigenvalues of a model that is held."""
    K, M = (sp.csc_array(A) for A in independent(model))
    start = np.random.default_rng(1).standard_normal(K.shape[0])
    return np.sort(sla.eigsh(K, count, M=M, sigma=0.0, v0=start, return_eigenvectors=False))


def program(folder: Path, body: str) -> Path:
    """An executable of Python ``body``, with the name of the job in ``job``."""
    path = folder / "ccx-of-the-test"
    head = f"#!{sys.executable}\nimport sys, time, zipfile, pathlib\njob = sys.argv[1]\n"
    path.write_text(head + body)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def replay(folder: Path, name: str) -> Path:
    """A program that writes what ccx 2.20 wrote for the runs of a deck: tests/data/calculix/NAME.zip."""
    return program(
        folder,
        f"""
with zipfile.ZipFile({str(STORED / name)!r} + ".zip") as stored:
    for entry in stored.namelist():
        if entry.split(".")[0] == job:
            pathlib.Path(entry).write_bytes(stored.read(entry))
print("Job finished" if job != "shape" else "")
""",
    )


def store(kept: Path, name: str) -> None:
    """Keep what ccx wrote (``--keep-files``) for ``replay``."""
    STORED.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(STORED / f"{name}.zip", "w", zipfile.ZIP_DEFLATED, compresslevel=9) as stored:
        for path in sorted(kept.iterdir()):
            if path.suffix in (".sti", ".mas", ".dof", ".12d", ".frd") and path.stat().st_size:
                stored.writestr(zipfile.ZipInfo(path.name), path.read_bytes(), zipfile.ZIP_DEFLATED)
