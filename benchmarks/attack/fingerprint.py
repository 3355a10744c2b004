"""What a file that was written says, in a few numbers that do not depend on how it is laid out."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.linalg as sl

# Relative difference of two numbers that are the same; part of the largest eigenvalue that counts as none.
SAME, RIGID = 1e-6, 1e-9
Prints = dict[str, list[float]]


def fingerprint(path: Path) -> Prints:
    """Of a model file, a body file, another HDF5 file, or any other file."""
    data = path.read_bytes()
    if not data.startswith(b"\x89HDF"):
        return _text(data)
    with h5py.File(path, "r") as file:
        kind = file["format"][()] if "format" in file else b""
    if kind == b"morembs-model":
        return _model(path)
    return _tables(path)


def printed(text: str) -> Prints:
    """Of a JSON document on standard output: its numbers by their keys."""
    numbers: Prints = {}

    def walk(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                walk(f"{name}/{key}", inner)
        elif isinstance(value, list):
            for inner in value:
                walk(name, inner)
        elif isinstance(value, int | float):
            numbers.setdefault(name, []).append(float(value))

    walk("", json.loads(text))
    return numbers


def differences(before: Prints, after: Prints) -> list[str]:
    """Names of what differs, with the largest relative difference of each."""
    lines = []
    for name in sorted(before.keys() | after.keys()):
        a, b = (np.asarray(prints.get(name, []), dtype=float) for prints in (before, after))
        if a.shape != b.shape:
            lines.append(f"{name}: {len(a)} numbers -> {len(b)}")
            continue
        scale = float(np.abs(a[np.isfinite(a)]).max(initial=0.0))
        with np.errstate(invalid="ignore"):
            gap = np.abs(a - b)
        gap[np.isnan(a) & np.isnan(b) | (a == b)] = 0.0
        if not (gap <= SAME * scale).all():
            worst = int(np.argmax(np.nan_to_num(gap, nan=np.inf)))
            lines.append(f"{name}: {a[worst]:.6g} -> {b[worst]:.6g}")
    return lines


def _model(path: Path) -> Prints:
    from morembs.importers.model_file import read_model

    model = read_model(path)
    prints: Prints = {"dofs": [float(model.size)], "nodes": [float(len(model.nodes))]}
    xyz = model.nodes.xyz
    prints["places"] = [float(np.nansum(xyz[:, c] * (1.0 + 0.1 * np.arange(len(xyz))))) for c in range(3)]
    for name, nodes in sorted(model.nodes.sets.items()):
        prints[f"set {name}"] = [float(len(nodes)), float(np.sum(model.nodes.ids[nodes]))]
    for name in ("K", "M", "D"):
        matrix = getattr(model, name)
        if matrix is not None:
            size = np.abs(matrix.data)
            prints[f"norm of {name}"] = [float(np.sqrt((size**2).sum()))]
    if model.M is not None:
        ones = [np.asarray(model.dofs.component == c, dtype=float) for c in range(3)]
        prints["mass"] = [float(np.real(x @ (model.M @ x))) for x in ones]
    prints["squares of frequencies"] = _squares(model)
    couplings = getattr(model, "couplings", {})
    for name in sorted(couplings):
        parts = [value for value in vars(couplings[name]).values() if isinstance(value, np.ndarray)]
        prints[f"coupling {name}"] = [float(np.size(part)) for part in parts]
    return prints


def _squares(model: Any) -> list[float]:
    """The lowest elastic eigenvalues of a small model."""
    if model.K is None or model.M is None or model.size > 600:
        return []
    K, M = model.K.toarray(), model.M.toarray()
    if np.iscomplexobj(K) or np.iscomplexobj(M):
        return []
    try:
        values = sl.eigh((K + K.T) / 2, (M + M.T) / 2, eigvals_only=True)
    except (sl.LinAlgError, ValueError):
        return [np.nan]
    elastic = values[np.abs(values) > RIGID * np.abs(values).max(initial=0.0)]
    return elastic[:6].tolist()


def _tables(path: Path) -> Prints:
    """Sizes of all datasets but those of the provenance; labels and text by a checksum."""
    prints: Prints = {}

    def take(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith(("provenance", "source")) or "recipe" in name:
            return
        value = np.asarray(item[()])
        if value.dtype.kind in "fc":
            # A model may be damaged until its size has no square in double.
            with np.errstate(over="ignore"):
                prints[name] = [float(np.linalg.norm(np.nan_to_num(np.abs(value)))), float(value.size)]
        else:
            digest = hashlib.sha256(value.tobytes() if value.dtype != object else repr(value).encode()).digest()
            prints[name] = [float(int.from_bytes(digest[:6], "big"))]

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return prints


def _text(data: bytes) -> Prints:
    """Of another file: its bytes."""
    return {"bytes": [float(len(data)), float(int.from_bytes(hashlib.sha256(data).digest()[:6], "big"))]}
