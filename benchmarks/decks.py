"""How many decks of a folder become a model through CalculiX, and whether it is the model that CalculiX has.

    python -m benchmarks.decks /usr/share/doc/calculix-ccx-test/examples/test [--limit 1000] [--only NAME ...]

Taken are decks with *ELASTIC and solids, shells or beams in space, without user or hyperelastic material. Each is
imported with --contact skip --density 7.8e-9 --skip "CYCLIC SYMMETRY MODEL", free and with --boundary keep. For those
of at most --limit rows ccx itself computes frequencies of the deck as it stands (its steps replaced by *FREQUENCY), and
these are compared with those of the held model. Printed are a line for each deck and the figures of all; --json FILE
keeps them.
"""

from __future__ import annotations

import argparse
import gzip
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from morembs.base.errors import MorembsError
from morembs.fem import FEModel, rigid_motion
from morembs.importers import import_file
from morembs.importers.engines.calculix.importer import import_with_calculix
from morembs.importers.engines.calculix.program import find_ccx
from morembs.importers.to_model import model_of

DENSITY, MODES, SECONDS, SECTOR = 7.8e-9, 10, 60, "CYCLIC SYMMETRY MODEL"
# The first eigenvalue of a held body, of the largest one that is looked at, at least.
HELD = 1e-9
_IN_SPACE = re.compile(r"^\*ELEMENT.*TYPE *= *\"?(C3D|S3|S4|S6|S8|B3|M3D|T3D|SC)", re.IGNORECASE | re.MULTILINE)
_NOT_IN_SPACE = re.compile(r"TYPE *= *\"?(CPE|CPS|CAX|D[ ,\n]|F3D|DC3D|U\d|T2D|B2|AC3D)", re.IGNORECASE)
_NOT_LINEAR = re.compile(r"^\*(USER MATERIAL|HYPER|USER ELEMENT|DEFORMATION PLAST)", re.IGNORECASE | re.MULTILINE)
# What a deck may hold its body with, so that rigid motion is strained by its own will.
_CONSTRAINED = re.compile(r"^\*(EQUATION|MPC|SPRING|ELEMENT.*TYPE *= *(SPRING|GAP))", re.IGNORECASE | re.MULTILINE)
_CONTACT = (
    "*CONTACTPAIR",
    "*SURFACEINTERACTION",
    "*SURFACEBEHAVIOR",
    "*FRICTION",
    "*CLEARANCE",
    "*CONTACTDAMPING",
    "*GAPCONDUCTANCE",
)


def structural(text: str) -> bool:
    """Whether a deck holds a linear structure in space."""
    elastic = re.search(r"^\*ELASTIC", text, re.IGNORECASE | re.MULTILINE) is not None
    return elastic and bool(_IN_SPACE.search(text)) and not (_NOT_IN_SPACE.search(text) or _NOT_LINEAR.search(text))


def as_frequency(text: str) -> str:
    """The deck with its steps replaced by *FREQUENCY, contact left out and densities filled in."""
    blocks, boundary, in_step, steps = [], [], False, 0
    for block in re.split(r"(?m)^(?=\*[A-Za-z])", re.sub(r"(?m)^\*\*.*\n", "", text)):
        word = re.sub(r"\s", "", block.split("\n", 1)[0].split(",")[0]).upper()
        if word == "*STEP":
            in_step, steps = True, steps + 1
        if in_step:
            if word == "*BOUNDARY" and steps == 1:
                _, *rows = [row for row in block.split("\n") if row.strip()]
                boundary.append("\n".join(["*BOUNDARY", *(",".join(row.split(",")[:3]) for row in rows)]) + "\n")
            in_step = word != "*ENDSTEP"
        elif word not in _CONTACT:
            blocks.append(block if block.endswith("\n") else block + "\n")
    model = _with_densities(blocks)
    return f"{model}{''.join(boundary)}*STEP\n*FREQUENCY\n{MODES}\n*END STEP\n"


def _with_densities(blocks: list[str]) -> str:
    result: list[str] = []
    materials = [i for i, block in enumerate(blocks) if block.upper().replace(" ", "").startswith("*MATERIAL")]
    for i, block in enumerate(blocks):
        result.append(block)
        if i in materials:
            end = next((j for j in materials if j > i), len(blocks))
            if not any(b.upper().replace(" ", "").startswith("*DENSITY") for b in blocks[i:end]):
                result.append(f"*DENSITY\n{DENSITY}\n")
    return "".join(result)


def own_eigenvalues(model: FEModel) -> np.ndarray:
    """The first eigenvalues of the independent dofs of a model that is held, ascending."""
    K, M = model.K, model.M
    if model.dependent is not None:
        T = sp.csr_array(model.dependent.S[:, np.flatnonzero(model.dependent.owner < 0)])
        K, M = T.T @ K @ T, T.T @ M @ T
    moves = np.flatnonzero(abs(K).max(axis=0).toarray().ravel() > 0)
    K, M = (sp.csc_array(A[moves][:, moves]) for A in (K, M))
    if len(moves) < MODES + 2:
        return np.sort(sl.eigvals(K.toarray(), M.toarray()).real)
    start = np.random.default_rng(1).standard_normal(len(moves))
    return np.sort(sla.eigsh(K, MODES, M=M, sigma=0.0, v0=start, return_eigenvectors=False))


def ccx_eigenvalues(folder: Path, name: str) -> np.ndarray:
    """Eigenvalues that ccx writes into its .dat."""
    subprocess.run([find_ccx().path, name], cwd=folder, capture_output=True, timeout=SECONDS, check=False)
    values = []
    for line in (folder / f"{name}.dat").read_text(errors="replace").splitlines():
        fields = line.split()
        if len(fields) == 5 and fields[0].isdigit():
            values.append(float(fields[1]))
        elif values and "P A R T I C" in line:
            break
    return np.array(values)


def examine(path: Path, limit: int) -> dict[str, Any]:
    """Figures of one deck."""
    result: dict[str, Any] = {"deck": path.name}
    options: dict[str, Any] = {"density": DENSITY, "contact": "skip", "skip": SECTOR, "timeout": SECONDS}
    start = time.perf_counter()
    try:
        model = model_of(import_with_calculix(path, **options))
    except MorembsError as error:
        return result | {"error": str(error)}
    result |= {"seconds": time.perf_counter() - start, "rows": model.size}
    K, R = model.K, rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    terms = float((abs(K) @ np.abs(R)).max())
    result["rigid"] = float(np.abs(K @ R).max()) / max(terms, 1e-300)
    result["own_constraints"] = bool(_CONSTRAINED.search(path.read_text(errors="replace")))
    if model.dependent is not None:
        result["follows"] = float(np.abs(model.dependent.S @ R - R).max() / np.abs(R).max())
    kilograms = float(R[:, 0] @ (model.M @ R[:, 0]))
    try:
        own_options = {key: options[key] for key in ("density", "contact", "skip")} | {"dialect": "calculix"}
        own = model_of(import_file(path, options=own_options))
        along = (own.dofs.component == 0).astype(float)
        result["mass"] = abs(kilograms / float(along @ (own.M @ along)) - 1)
    except MorembsError:
        pass  # own assembly does not take it
    if model.size > limit:
        return result
    try:
        held = model_of(import_with_calculix(path, **options, boundary="keep"))
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "a.inp").write_text(as_frequency(path.read_text(errors="replace")))
            wanted = ccx_eigenvalues(Path(folder), "a")
        computed = own_eigenvalues(held)[: len(wanted)]
        count = min(len(computed), len(wanted))
        computed, wanted = computed[:count], wanted[:count]
        if count and min(wanted.min(), computed[0]) > HELD * wanted.max():
            result["frequency"] = float((np.abs(computed / wanted - 1) / 2).max())
            result["ccx"], result["own"] = wanted.tolist(), computed.tolist()
        else:
            result["held"] = "the deck does not hold its body, of which ccx finds no frequencies"
    except (MorembsError, OSError, subprocess.TimeoutExpired, RuntimeError, ValueError) as error:
        result["held"] = str(error)
    return result


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--limit", type=int, default=1000)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--json", type=Path)
    given = parser.parse_args(arguments)
    results = []
    for path in sorted(path for path in given.folder.rglob("*.inp*") if path.name.endswith((".inp", ".inp.gz"))):
        packed = path.suffix == ".gz"
        text = (gzip.decompress(path.read_bytes()) if packed else path.read_bytes()).decode("latin-1")
        if not structural(text) or (given.only and path.name.split(".inp")[0] not in given.only):
            continue
        with tempfile.TemporaryDirectory() as folder:
            if packed:
                path = Path(folder) / path.stem
                path.write_text(text, encoding="latin-1")
            results.append(examine(path, given.limit))
        print({k: v for k, v in results[-1].items() if k not in ("ccx", "own")}, flush=True)
        if given.json:
            given.json.write_text(json.dumps(results, indent=1))
    taken = [result for result in results if "error" not in result]
    print(f"{len(taken)} of {len(results)} imported ({100 * len(taken) / max(len(results), 1):.1f} %)")
    for key, most in (("rigid", 1e-9), ("follows", 1e-12), ("mass", 1e-6), ("frequency", 1e-6)):
        values = [result[key] for result in taken if key in result]
        print(
            f"{key}: {sum(v <= most for v in values)} of {len(values)} within {most:g}; worst "
            f"{max(values, default=0):.1e}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
