"""What a stranger needs to prove the certificates of a body file again, from the matrices of its model alone.

Of the reference: vectors of all its modes, solutions from which their residuals follow, rigid motions, the shift and
the number of modes below it, and the damping. Limits are those of the body file. ``morembs_verify`` believes nothing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.certificate.record import ErrorLimits
from morembs.certificate.tolerances import TOL
from morembs.problem import Problem
from morembs.responses.certified import certified_reference
from morembs.responses.certified_reference import CertifiedReference
from morembs.storage.safefile import SafeFile, replacing

FORMAT = "morembs-witness"


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitsAtValues:
    """What a witness states of bodies with parameters: ``values`` of all parameters, and the ``limits`` of each body
    there by its name, of which that of ``measure`` counts.

    >>> stated = LimitsAtValues(values={"E": 2e11}, limits={"parametric": limits}, measure="envelope")
    """

    values: Mapping[str, float]
    limits: Mapping[str, ErrorLimits]
    measure: str

    def datasets(self, band_hz: Sequence[float], floor: float) -> dict[str, Any]:
        """Names in a witness, and their values."""
        found: dict[str, Any] = {
            "at/names": np.array([name.encode() for name in self.values]),
            "at/values": np.array([float(value) for value in self.values.values()]),
        }
        for body, own in self.limits.items():
            place = f"certificates/{body}"
            found |= {
                f"{place}/band_hz": np.array([float(f) for f in band_hz]),
                f"{place}/damping_floor": floor,
                f"{place}/measure": np.bytes_(self.measure),
                f"{place}/cells_hz": own.cells_hz,
                f"{place}/cell_limit": own.cell_limit,
            }
            for name, limit in own.limits.items():
                found[f"{place}/limits/{name}"] = np.array([limit.lower, limit.upper, limit.at_hz])
        return found


def write_witness(
    path: Path,
    problem: Problem,
    band_hz: Sequence[float],
    *,
    body: Path,
    model: Path,
    damping_floor: float | None = None,
    expand: Callable[[Floats], Floats] = np.asarray,
    stated: LimitsAtValues | None = None,
) -> Path:
    """Write the witness of the certificates over ``band_hz`` in the file ``body``, of the model file ``model``.

    Peak memory: the vectors of the reference, (Nc, n), beside those of ``certified_reference``.

    Args:
        path: of the witness.
        problem: the full model with its interfaces.
        band_hz: (low, high) in Hz.
        body: body file.
        model: model file, or the file of an assembly.
        damping_floor: ratio of critical damping that is added.
        expand: makes vectors (Nc, k) of ``problem`` vectors of the dofs of the verifier: ``Unreduced.in_parts``.
        stated: limits of bodies with parameters at values, whose model ``problem`` has: the body file has none there.

    Raises:
        InputError: a model with a gyroscopic or circulatory matrix, or a table of modal damping that jumps.
        OutputError: the file cannot be written.
    """
    if not problem.symmetric or len(problem.damping.jumps):
        raise InputError(
            "a witness was asked for of a model with a gyroscopic or circulatory matrix, or a modal damping table that "
            "jumps, whose limits are not proven; leave the witness out",
            kind="unsupported",
            keyword="witness",
        )
    reference = certified_reference(problem, band_hz, damping_floor=damping_floor)
    progress.update("witness")
    damping = problem.damping
    values: dict[str, Any] = {
        "format": np.bytes_(FORMAT),
        "format_version": 1,
        "body_sha256": np.bytes_(_digest(body)),
        "model_sha256": np.bytes_(_digest(model)),
        "damping": np.bytes_(
            json.dumps(
                {
                    "alpha": damping.alpha,
                    "beta": damping.beta,
                    "modal": damping.steps[0][1],
                    "structural": damping.structural,
                }
            )
        ),
        "modes_below": len(reference.sigma),
        "shift": _shift(reference),
        "rigid": expand(problem.rigid),
        "vectors": expand(np.hstack([reference.vectors, _others(reference)])),
        "solutions": expand(np.asarray(reference.solutions)),
        "coefficients": reference.coefficients,
        **({} if stated is None else stated.datasets(band_hz, reference.floor)),
    }
    with replacing(path) as safe:
        with h5py.File(safe, "w", userblock_size=TOL.user_block_bytes, libver=("earliest", "v108")) as file:
            for name, value in values.items():
                safe.doing = name
                file[name] = value
        _seal(safe)
        safe.check()
    return path


def _others(reference: CertifiedReference) -> Any:
    """Vectors (Nc, n - k) of the modes above the cut."""
    n = len(reference.values)
    return reference.model.vectors(np.eye(n)[:, len(reference.sigma) :])


def _shift(reference: CertifiedReference) -> float:
    """A shift that the modes below the cut, and no others, lie below: far from all that are known, for the count."""
    k, values = len(reference.sigma), reference.values
    low = max(float(values[:k].max(initial=0.0)), (TOL.least_shift * 2 * np.pi * reference.band_hz[1]) ** 2)
    if len(values) == k or reference.solutions is None or reference.coefficients is None:
        return max(reference.cut, low)
    # An eigenvalue lies within this part below the first Ritz value above the cut (Weinstein 1934).
    solution = reference.solutions @ reference.coefficients[:, k]
    energy = float(np.sqrt(max(solution @ (reference.problem.K @ solution), 0.0)))
    high = float(values[k]) / (1 + energy * float(np.sqrt(values[k])))
    return 0.5 * (low + high) if high > reference.cut else reference.cut


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _seal(safe: SafeFile) -> None:
    """Put the digest of all behind the user block into it, so that any other byte of the file is noticed."""
    total = hashlib.sha256()
    safe.seek(TOL.user_block_bytes)
    while block := safe.read(TOL.digest_bytes):
        total.update(block)
    safe.seek(0)
    safe.write(total.hexdigest().encode().ljust(TOL.user_block_bytes, b"\0"))
