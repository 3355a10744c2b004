"""Certificates of random models, proven again by ``morembs_verify``; and false ones, none of which may be proven.

    python benchmarks/verification.py --count 300 --seed 5 --tampers 500

Models, bodies and bands are those of ``certificates.py``. A false certificate has new digests, and is false by
construction: a limit below an error that is computed exactly, a mode dropped below the shift, a stiffness or mass that
was changed so that the exact error exceeds the limit, cells left out, or the model of another trial. Others say what
is not so, or is not known: a mode of negative stiffness and mass, a peak outside of the band, a band that is reversed,
other rigid motions, axes or inputs, entries that are there twice, a damping matrix, another one or none, or a ratio
below zero.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import scipy.linalg
import scipy.sparse as sp

from benchmarks.certificates import bodies_of, dense_errors, drawn, low_end
from morembs.body import elastic_body, make_part
from morembs.body.file import write_body
from morembs.certificate.certify import certify
from morembs.certificate.morembs_verify import NotVerifiedError, verify
from morembs.certificate.record import Certificate
from morembs.certificate.witness import write_witness
from morembs.importers.model_file import write_model
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.measures import MEASURES

BLOCK = 512
TAMPERS = (
    *("limit", "mode", "stiffness", "cells", "model"),
    *("negative mass", "outer peak", "band", "rigid inertia", "rigid damping", "axes", "entry twice", "own damping"),
    *("ratio", "inputs", "damping", "no damping"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A certified body of a random model, with its three files."""

    words: str
    problem: Problem
    body: ReducedModel
    certificate: Certificate
    folder: Path

    @property
    def files(self) -> tuple[Path, Path, Path]:
        """Body, model and witness."""
        return self.folder / "body.h5", self.folder / "model.h5", self.folder / "witness.h5"


def cases(seed: int, number: int, folder: Path, own: float = 0.0) -> Iterator[Case]:
    """The certified bodies of the random model ``number``, each while its files are there; a part ``own`` of all has
    dashpots."""
    rng = np.random.default_rng([seed, number])
    trial = drawn(rng, number, own)
    band = (low_end(seed, number, trial.high, 0.33), trial.high)
    with trial.problem as problem:
        bodies = bodies_of(problem, trial.high, rng)
        for body, certificate in zip(bodies, certify(problem, bodies, band, points=10), strict=True):
            case = Case(words=trial.words, problem=problem, body=body, certificate=certificate, folder=folder)
            path, model, witness = case.files
            write_model(model, problem.model)
            write_body(path, [elastic_body(problem, body, make_part(problem), certificate)])
            write_witness(witness, problem, band, body=path, model=model)
            yield case


def reseal(body: Path, model: Path, witness: Path) -> None:
    """Make the digests of a witness anew."""
    with h5py.File(witness, "r+") as file:
        for name, path in (("body", body), ("model", model)):
            del file[f"{name}_sha256"]
            file[f"{name}_sha256"] = np.bytes_(hashlib.sha256(path.read_bytes()).hexdigest())
    data = witness.read_bytes()
    witness.write_bytes(hashlib.sha256(data[BLOCK:]).hexdigest().encode().ljust(BLOCK, b"\0") + data[BLOCK:])


def _put(file: h5py.File, name: str, value: object) -> None:
    del file[name]
    file[name] = value


def tamper(case: Case, kind: str, rng: np.random.Generator) -> bool:
    """Make the files of ``case`` false; False where that is not possible."""
    path, model, witness = case.files
    place, band = f"bodies/{case.body.name}/certificate", case.certificate.band_hz
    at = [limit.at_hz for limit in case.certificate.limits.values()]
    if kind == "limit":
        true = dense_errors(case.problem, case.body, band, at)[1].max(axis=0)
        j = int(rng.integers(3))
        with h5py.File(path, "r+") as file:
            cells, limit = file[f"{place}/cell_limit"][()], file[f"{place}/limits/{MEASURES[j]}"][()]
            limit[1] = true[j] * rng.uniform(0.5, 0.999)
            cells[:, j] = np.minimum(cells[:, j], limit[1])
            _put(file, f"{place}/cell_limit", cells)
            _put(file, f"{place}/limits/{MEASURES[j]}", limit)
    elif kind == "mode":
        with h5py.File(witness, "r+") as file:
            count = int(file["modes_below"][()])
            if not count:
                return False
            left = np.delete(np.arange(file["vectors"].shape[1]), rng.integers(count))
            for name in ("vectors", "coefficients"):
                _put(file, name, file[name][()][:, left])
            _put(file, "modes_below", count - 1)
    elif kind == "cells":
        with h5py.File(path, "r+") as file:
            hz, limits = file[f"{place}/cells_hz"][()], file[f"{place}/cell_limit"][()]
            first = int(rng.integers(len(hz)))
            left = np.delete(np.arange(len(hz)), np.arange(first, first + int(rng.integers(1, 4))) % len(hz))
            if not len(left):
                return False
            _put(file, f"{place}/cells_hz", hz[left])
            _put(file, f"{place}/cell_limit", limits[left])
    elif kind in ("stiffness", "model", "damping", "no damping"):
        if not _other_matrices(case, kind, rng):
            return False
    elif not _other_statement(case, kind, rng):
        return False
    reseal(path, model, witness)
    return True


def _other_matrices(case: Case, kind: str, rng: np.random.Generator) -> bool:
    """Another stiffness, or another stiffness and mass, whose exact errors exceed the limit."""
    model, at = case.problem.model, [limit.at_hz for limit in case.certificate.limits.values()]
    K, M = model.K.toarray(), model.M.toarray()
    held = np.linalg.eigvalsh(K)[0] > 1e-9 * np.linalg.norm(K)
    if "damping" in kind and model.D is None:
        return False
    for size in 10 ** np.arange(-4.0, 1.0):
        if kind == "damping":
            other = replace(model, D=sp.csr_array((1 + size) * model.D))
        elif kind == "no damping":
            other = replace(model, D=sp.csr_array(1e-9 * model.D))
        elif kind == "stiffness" and held:
            v = np.zeros(len(K))
            v[rng.integers(len(K))] = 1.0
            other = replace(model, K=sp.csr_array(K + size * K.max() * np.outer(v, v)))
        elif kind == "stiffness":
            other = replace(model, K=sp.csr_array(K * (1 + size)))
        else:
            d = np.repeat(np.exp(size * rng.standard_normal(len(K) // 3)), 3)
            other = replace(model, M=sp.csr_array(d[:, None] * M * d))
        with Problem(other, case.problem.interfaces, damping=case.problem.damping) as changed:
            error = dense_errors(changed, case.body, case.certificate.band_hz, at)[1][:, 0].max()
        if error > 1.01 * case.certificate.limits["envelope"].upper:
            write_model(case.files[1], replace(other, D=None) if kind == "no damping" else other)
            return True
    return False


def _other_statement(case: Case, kind: str, rng: np.random.Generator) -> bool:
    """Files that say what is not so, or is not what the limits are of."""
    path, model, witness = case.files
    place = f"bodies/{case.body.name}"
    which = {"negative mass": model, "entry twice": model, "own damping": model, "ratio": witness}.get(kind, path)
    with h5py.File(which, "r+") as file:
        if kind == "negative mass":
            _add_a_mode(file, case.certificate.band_hz)
        elif kind == "own damping":
            if "D" in file["matrices"]:
                return False
            file.copy("matrices/K", "matrices/D")
            file["matrices/D/data"][...] *= rng.uniform(1e-7, 1e-3)
        elif kind == "entry twice":
            _add_entries(file, int(rng.integers(len(file["dofs/node"]))))
        elif kind == "ratio":
            given = json.loads(file["damping"][()]) | {"modal": -0.01}
            _put(file, "damping", np.bytes_(json.dumps(given)))
        elif kind == "band":
            _put(file, f"{place}/certificate/band_hz", np.array(case.certificate.band_hz[::-1]))
        elif kind == "outer peak":
            return _hide_the_peak(case, file)
        elif kind == "axes":
            name = rng.choice(list(file["interfaces"]))
            angle = rng.uniform(0.01, 1.0)
            c, s = np.cos(angle), np.sin(angle)
            _put(file, f"interfaces/{name}/axes", np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))
        elif kind == "inputs":
            index = file["inputs/component"][()]
            if (index == index[::-1]).all():
                return False
            _put(file, "inputs/component", index[::-1].copy())
        else:
            return _other_rigid_motions(file, place, kind, rng)
    if kind == "negative mass":
        with h5py.File(witness, "r+") as file:
            # Dofs of the model come before those of frames, and the new one is the last of them.
            at = len(file["vectors"]) - 6 * _frames(case)
            for name in ("rigid", "vectors", "solutions"):
                _put(file, name, np.insert(file[name][()], at, 0.0, axis=0))
    return True


def _frames(case: Case) -> int:
    return sum(interface.coupling == "rigid" and len(interface.nodes) > 1 for interface in case.problem.interfaces)


def _add_a_mode(file: h5py.File, band: tuple[float, float]) -> None:
    """One more dof, with a stiffness and a mass below zero: a mode in the band, but never below the shift."""
    size, n = 1e-9 * file["matrices/M/data"][()].max(), len(file["dofs/node"])
    for name, value in (("K", -size * (np.pi * (band[0] + band[1])) ** 2), ("M", -size)):
        matrix = f"matrices/{name}"
        for part, more in (("data", value), ("indices", n), ("indptr", len(file[f"{matrix}/data"]) + 1)):
            _put(file, f"{matrix}/{part}", np.append(file[f"{matrix}/{part}"][()], more))
        _put(file, f"{matrix}/shape", file[f"{matrix}/shape"][()] + 1)
    ids = file["nodes/ids"][()]
    _put(file, "dofs/node", np.append(file["dofs/node"][()], len(ids)))
    _put(file, "dofs/component", np.append(file["dofs/component"][()], 0))
    _put(file, "nodes/ids", np.append(ids, ids.max() + 1))
    _put(file, "nodes/coordinates", np.vstack([file["nodes/coordinates"][()], file["nodes/coordinates"][-1:]]))


def _add_entries(file: h5py.File, row: int) -> None:
    """Two entries of one place whose sum, to round-off, is nothing."""
    indptr, n = file["matrices/K/indptr"][()], len(file["dofs/node"])
    at, size = indptr[row], 1e20 * file["matrices/K/data"][()].max()
    for part, more in (("data", [size, -size]), ("indices", [n - 1 - row] * 2)):
        _put(file, f"matrices/K/{part}", np.insert(file[f"matrices/K/{part}"][()], [at, at], more))
    indptr[row + 1 :] += 2
    _put(file, "matrices/K/indptr", indptr)


def _hide_the_peak(case: Case, file: h5py.File) -> bool:
    """A band without the largest peak, whose cells stay: the error over the largest response in it is larger."""
    low, high = case.certificate.band_hz
    omega, errors = dense_errors(case.problem, case.body, (low, high))
    size = errors[:, 1] / np.maximum(errors[:, 2], 1e-300)
    for part in np.linspace(0.1, 0.9, 17):
        first = low + part * (high - low)
        inside = omega > 2 * np.pi * first
        if errors[inside, 1].max() > 1.1 * case.certificate.limits["peak"].upper * size[inside].max():
            _put(file, f"bodies/{case.body.name}/certificate/band_hz", np.array([first, high]))
            return True
    return False


def _other_rigid_motions(file: h5py.File, place: str, kind: str, rng: np.random.Generator) -> bool:
    """Another inertia of a body that can move, or damping that couples its rigid motions to its modes."""
    rigid, size = int(file[f"{place}/rigid_count"][()]), 10 ** rng.uniform(-5, -1)
    M, K, D = (file[f"{place}/{name}_matrix"][()] for name in ("mass", "stiffness", "damping"))
    if not rigid:
        return False
    if kind == "rigid inertia":
        M, K, D = ((1 + size) * A for A in (M, K, D))
    elif "output_matrix" in file[place]:
        D[:rigid, rigid:] += size * max(np.abs(D).max(), 1.0)
    else:
        values, X = scipy.linalg.eigh(K, M)
        across = np.outer(M @ X[:, 0], M @ X[:, -1])
        D += size * np.sqrt(values[-1]) * (across + across.T)
    for name, A in (("mass", M), ("stiffness", K), ("damping", D)):
        _put(file, f"{place}/{name}_matrix", A)
    return True


def answer(case: Case, found: list[np.ndarray] | None = None) -> tuple[bool, str]:
    """Whether the limits of ``case`` are proven, and the last sentence."""
    try:
        _, proven, said = verify(*map(str, case.files), found)
    except (ValueError, IndexError, KeyError, NotVerifiedError) as error:
        return False, f"cannot be read: {error}"
    return proven, said.splitlines()[-1]


def main() -> None:
    """Print how many are proven, and of the false ones the lemmas that refuse them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=20, help="certificates of random models")
    parser.add_argument("--tampers", type=int, default=30, help="false certificates")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--own", type=float, default=0.0, help="part of models that have dashpots")
    given = parser.parse_args()
    rng, proven, told, wrong, largest = np.random.default_rng(given.seed), 0, 0, 0, 0.0
    refused, seconds, number, count, tampers, tried = Counter[str](), 0.0, 0, 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        while count < given.count or tampers < given.tampers:
            for case in cases(given.seed, number, Path(folder), given.own):
                if case.certificate.kind != "proven" or not np.isfinite(case.certificate.limit.upper):
                    continue
                if count < given.count:
                    count, told, start, found = count + 1, told + 1, time.process_time(), list[np.ndarray]()
                    holds, said = answer(case, found)
                    seconds += time.process_time() - start
                    proven += holds
                    largest = max([largest, *(float(each.max()) for each in found)])
                    if not holds:
                        print(f"{case.words}, {case.body.name}: {said}", flush=True)
                if tampers < given.tampers:
                    # What one case cannot have, the next one is not asked for.
                    kind, tried = TAMPERS[tried % len(TAMPERS)], tried + 1
                    if tamper(case, kind, rng):
                        tampers += 1
                        holds, said = answer(case)
                        wrong += holds
                        refused[
                            f"{kind}: {said.partition(' fails')[0].partition('not verified: ')[2] or said[:60]}"
                        ] += 1
                        if holds:
                            print(f"FALSE AND PROVEN: {case.words}, {case.body.name}, {kind}: {said}", flush=True)
            number += 1
            if number % 25 == 0:
                print(
                    f"{proven} of {told} verified, {wrong} of {tampers} false ones proven", file=sys.stderr, flush=True
                )
    print(
        f"{proven} of {told} stated limits verified; found at most {largest:.3f} of the stated limit; {seconds:.1f} s"
    )
    print(f"{wrong} of {tampers} false certificates proven")
    for name, times in sorted(refused.items()):
        print(f"  {times:4d} {name}")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
