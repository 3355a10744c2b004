"""Certificates of random models, proven again by ``morembs_verify``; and false ones, none of which may be proven.

    python benchmarks/verification.py --count 300 --seed 5 --tampers 500

Models, bodies and bands are those of ``certificates.py``. A false certificate has new digests, and is false by
construction: a limit below an error that is computed exactly, a mode dropped below the shift, a stiffness or mass that
was changed so that the exact error exceeds the limit, cells left out, or the model of another trial.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
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
TAMPERS = ("limit", "mode", "stiffness", "cells", "model")


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


def cases(seed: int, number: int, folder: Path) -> Iterator[Case]:
    """The certified bodies of the random model ``number``, each while its files are there."""
    rng = np.random.default_rng([seed, number])
    trial = drawn(rng, number)
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
    elif not _other_matrices(case, kind, rng):
        return False
    reseal(path, model, witness)
    return True


def _other_matrices(case: Case, kind: str, rng: np.random.Generator) -> bool:
    """Another stiffness, or another stiffness and mass, whose exact errors exceed the limit."""
    model, at = case.problem.model, [limit.at_hz for limit in case.certificate.limits.values()]
    K, M = model.K.toarray(), model.M.toarray()
    held = np.linalg.eigvalsh(K)[0] > 1e-9 * np.linalg.norm(K)
    for size in 10 ** np.arange(-4.0, 1.0):
        if kind == "stiffness" and held:
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
            write_model(case.files[1], other)
            return True
    return False


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
    given = parser.parse_args()
    rng, proven, told, wrong, largest = np.random.default_rng(given.seed), 0, 0, 0, 0.0
    refused, seconds, number, count, tampers = Counter[str](), 0.0, 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        while count < given.count or tampers < given.tampers:
            for case in cases(given.seed, number, Path(folder)):
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
                    kind = TAMPERS[tampers % len(TAMPERS)]
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
