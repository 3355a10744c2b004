"""Case about floating-frame data: ours and Exudyn's own integrals of the same model and the same shapes.

The shapes are polynomials of the coordinates (rigid motion among them), so that nothing has to be factorised: the
integrals do not care where shapes come from.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg as sl
from measure import Report, Row, Settings, child, in_rounds, ratios

from morembs.base.memory import peak_memory_bytes, resident_bytes
from morembs.base.types import Floats
from morembs.body.floating.frame import floating_frame
from morembs.body.floating.integrals import ShapeIntegrals
from morembs.fem import FEModel
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel

Spec = dict[str, Any]
OURS, OTHER = "morembs", "Exudyn"
# Shapes of the large body, and of those that both can do.
LARGE, BOTH = 1_000_000, 100_000
COUNT, FEW = 66, 30
_COLUMNS = (
    ("dofs", "dofs", "n"),
    ("shapes", "shapes", "n"),
    ("seconds", "seconds", "s"),
    ("basis_bytes", "basis MB", "MB"),
    ("peak_rise_bytes", "peak MB", "MB"),
    ("difference", "difference", "e"),
)


def frames(settings: Settings) -> None:
    """Time and memory of all integrals of a body, ours at a million dofs too."""
    large, both = (30_000, 10_000) if settings.quick else (LARGE, BOTH)
    measures: dict[str, Callable[[], Row]] = {
        f"{both:,}: {who}": _measure(settings, who=who, dofs=both, shapes=FEW) for who in (OURS, OTHER)
    }
    measures[f"{large:,}: {OURS}"] = _measure(settings, who=OURS, dofs=large, shapes=COUNT)
    rounds = in_rounds(measures, settings.repeat)
    report = Report("frames", settings)
    report.add(rounds)
    report.table(
        "frames: mass, inertia and all integrals over the shapes\npeak MB: highest memory less what was resident "
        "before, that is beside the basis;\ndifference: largest of the integrals that both have, relative to its array",
        _COLUMNS,
    )
    for key, words in (("seconds", "seconds"), ("peak_rise_bytes", "memory")):
        pair = (f"{both:,}: {OTHER}", key), (f"{both:,}: {OURS}", key)
        report.compare(f"{both:,}: {words}, {OTHER} over {OURS}", ratios(rounds, *pair))
    report.write()


def _measure(settings: Settings, **wanted: object) -> Callable[[], Row]:
    return lambda: child("frames", settings, **wanted)


def measure(spec: Spec, steel: Callable[[str, int], FEModel]) -> Row:
    """What one child finds."""
    model = steel("cube", spec["dofs"])
    if spec["who"] == OTHER:
        try:
            return _exudyn(model, spec["shapes"])
        except ImportError:
            return {"error": "not installed: pip install exudyn"}
    problem = Problem(model)
    V = polynomials(model.nodes.xyz, spec["shapes"])
    M, K = problem.space.project(V, problem.M), problem.space.project(V, problem.K)
    reduced = ReducedModel(
        name="polynomials",
        M=M,
        K=K,
        D=np.zeros_like(K),
        B=np.zeros((len(K), 0)),
        C=np.zeros((0, len(K))),
        V=V,
        mode_kind=("elastic",) * len(K),
        rigid_count=6,
    )
    resident, start = resident_bytes(), time.perf_counter()
    frame = floating_frame(problem, reduced)
    seconds, peak = time.perf_counter() - start, peak_memory_bytes()
    row = {
        "dofs": model.size,
        "shapes": spec["shapes"],
        "seconds": seconds,
        "basis_bytes": V.nbytes,
        "peak_rise_bytes": peak - resident,
    }
    return row if spec["dofs"] > BOTH else {**row, "difference": _difference(model, frame.integrals, V @ frame.elastic)}


def polynomials(xyz: Floats, count: int) -> Floats:
    """``count`` displacement fields (N, count): monomials of the scaled coordinates along each axis, low ones first."""
    x = (xyz - xyz.mean(axis=0)) / np.ptp(xyz, axis=0).max() * 2
    powers = sorted(itertools.product(range(6), repeat=3), key=sum)
    V = np.zeros((3 * len(x), count), order="F")
    for column, (power, axis) in zip(range(count), itertools.product(powers, range(3)), strict=False):
        V[axis::3, column] = np.prod(x ** np.array(power), axis=1)
    return V


def _exudyn_body(model: FEModel, shapes: Floats) -> Any:
    import exudyn.FEM

    fem = exudyn.FEM
    full = fem.FEMinterface()
    full.nodes = {"Position": model.nodes.xyz}
    full.massMatrix, full.stiffnessMatrix = model.M.tocsr(), model.K.tocsr()
    full.modeBasis = {"matrix": shapes, "type": "NormalModes"}
    return fem.ObjectFFRFreducedOrderInterface(full, roundMassMatrix=0, roundStiffnessMatrix=0)


def _exudyn(model: FEModel, count: int) -> Row:
    V = polynomials(model.nodes.xyz, count)
    M, K = V.T @ (model.M @ V), V.T @ (model.K @ V)
    shapes = np.ascontiguousarray(V @ sl.eigh(K, M)[1][:, 6:])
    resident, start = resident_bytes(), time.perf_counter()
    _exudyn_body(model, shapes)
    return {
        "dofs": model.size,
        "shapes": count,
        "seconds": time.perf_counter() - start,
        "basis_bytes": shapes.nbytes,
        "peak_rise_bytes": peak_memory_bytes() - resident,
    }


def _difference(model: FEModel, integrals: ShapeIntegrals, shapes: Floats) -> float | None:
    """Largest difference to the integrals of Exudyn, each relative to its array."""
    try:
        other = _exudyn_body(model, shapes)
    except ImportError:
        return None
    n = integrals.count
    pairs = (
        (other.mPhitTPsi, integrals.Ct.T),
        (other.mXRefTildePsi, -integrals.Cr.T),
        (other.massMatrixReduced, integrals.Me),
        (other.mXRefTildePsiTilde, -integrals.C4.transpose(1, 0, 2).reshape(3, 3 * n)),
        (other.mPsiTildePsiTilde, -integrals.C6.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)),
    )
    # Mean axes make some arrays round-off; the mass and the size of the body give what they are small against.
    size = float(np.sqrt(integrals.mass)) * float(np.ptp(model.nodes.xyz, axis=0).max())
    differences = []
    for theirs, ours in pairs:
        dense = theirs.todense() if hasattr(theirs, "todense") else np.asarray(theirs)
        differences.append(float(np.abs(dense - ours).max() / max(float(np.abs(ours).max()), size)))
    return max(differences)


CASES = {"frames": frames}
