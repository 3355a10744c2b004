"""Case about parametric bodies: their bound against direct solutions at random values, and their cost.

The bracket with two moduli, a density and an arm that grows by 3 mm either way; connecting rods (the small one, and
that of the demo with 73,728 dofs) with the moduli of two halves, a density and a length that changes by 5 %. References
are solved for with models assembled at the values, which the affine terms know nothing of.

usage: python benchmarks/parametric.py bracket|conrod|rod [--values N] [--frequencies N] [--seed N]
"""

from __future__ import annotations

# First, as in any program that uses it: it quiets the idle threads of OpenBLAS before NumPy loads its copy.
import morembs  # noqa: F401

# isort: split
import argparse
import gzip
import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from morembs.base.memory import peak_memory_bytes
from morembs.base.progress import Progress
from morembs.base.types import Floats
from morembs.base.units import parse_units
from morembs.fem import FEModel, Mesh
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.fem.selection import select_nodes
from morembs.importers import read_mesh
from morembs.parametric.basis import ParametricBasis
from morembs.parametric.parameter import Parameter
from morembs.parametric.terms import AffineProblem
from morembs.parametric.varied import varied_model
from morembs.problem.damping import Damping
from morembs.reducers import CraigBampton
from morembs.reducers.parametric import ParametricReducer
from morembs.responses.direct import elastic_states

MESHES = Path(__file__).parents[1] / "data" / "small_meshes"
YOUNG, DENSITY = (1.5e11, 2.7e11, 2.1e11), (7000.0, 8700.0, 7850.0)
STEEL = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
# Values between two reports.
EVERY = 10
ARM, REST = ("Volume2", "Volume3", "Volume4", "Volume5"), ("Volume1", "Volume6")


@dataclass(frozen=True, kw_only=True)
class Case:
    """Mesh, interfaces, parameters, damping and method."""

    mesh: Mesh
    sets: tuple[str, str]
    parameters: tuple[Parameter, ...]
    damping: Damping
    method: ParametricReducer


class Lines(Progress):
    """Progress as lines."""

    def update(self, message: str) -> None:
        print(f"{time.process_time():8.1f} s  {message}", flush=True)


def bracket() -> Case:
    """The bracket of the small meshes."""
    mesh = read_mesh(MESHES / "bracket.inp", parse_units("mm-kg-s"))
    xyz = 1e3 * mesh.nodes.xyz
    d = np.zeros_like(xyz)
    d[:, 2] = 1e-3 * np.where(xyz[:, 1] <= 10 + 1e-9, np.clip((xyz[:, 2] - 10) / 10, 0, 1), 0)
    return Case(
        mesh=mesh,
        sets=("FOOT", "TIP"),
        damping=Damping(),
        parameters=_parameters((ARM, REST), d, 3.0),
        method=ParametricReducer(band_hz=[0.0, 30000.0], tolerance=1e-3),
    )


def rod(path: Path) -> Case:
    """A connecting rod in two halves along x; the shank takes what its length changes by."""
    mesh = read_mesh(path, parse_units("mm-t-s"))
    x = mesh.nodes.xyz[:, 0]
    ends = [mesh.nodes.xyz[mesh.nodes.sets[name], 0] for name in ("BIGEND", "SMALLEND")]
    low, high = ends[0].max(), ends[1].min()
    centre = [0.5 * (each.min() + each.max()) for each in ends]
    middle = 0.5 * (low + high)
    halves = {"NEAR": [], "FAR": []}
    for block in mesh.blocks:
        near = x[block.nodes].mean(axis=1) < middle
        halves["NEAR"].append(np.flatnonzero(near))
        halves["FAR"].append(np.flatnonzero(~near))
    mesh = replace(mesh, element_sets={**mesh.element_sets, **{name: tuple(rows) for name, rows in halves.items()}})
    d = np.zeros_like(mesh.nodes.xyz)
    # Per percent of the distance of the bores.
    d[:, 0] = 0.01 * (centre[1] - centre[0]) * np.clip((x - low) / (high - low), 0, 1)
    return Case(
        mesh=mesh,
        sets=("BIGEND", "SMALLEND"),
        damping=Damping(alpha=5.0, beta=2e-7),
        parameters=_parameters((("NEAR",), ("FAR",)), d, 5.0),
        method=ParametricReducer(band_hz=[0.0, 5000.0], tolerance=1e-3),
    )


def _parameters(sets: tuple[tuple[str, ...], tuple[str, ...]], d: Floats, most: float) -> tuple[Parameter, ...]:
    low, high, nominal = YOUNG
    moduli = [
        Parameter(name=f"E_{k}", kind="young", low=low, high=high, nominal=nominal, sets=names)
        for k, names in enumerate(sets, start=1)
    ]
    low, high, nominal = DENSITY
    density = Parameter(name="rho", kind="density", low=low, high=high, nominal=nominal)
    return (*moduli, density, Parameter(name="t", kind="morph", low=-most, high=most, nominal=0.0, displacement=d))


def case_of(name: str, folder: Path) -> Case:
    """The case of that name; ``folder`` is for its mesh."""
    if name == "bracket":
        return bracket()
    if name == "conrod":
        return rod(MESHES / "conrod.msh")
    path = folder / "connecting_rod.msh"
    path.write_bytes(gzip.decompress((MESHES / "connecting_rod.msh.gz").read_bytes()))
    return rod(path)


def interfaces(model: FEModel, names: tuple[str, str]) -> list[object]:
    """Rigid interfaces at sets of nodes."""
    return [make_interface(model, name=name, nodes=select_nodes(model, f"set:{name}")) for name in names]


def compare(
    problem: AffineProblem, basis: ParametricBasis, values: int, count: int, seed: int, damping: Damping
) -> dict[str, object]:
    """Errors and bounds at random values and frequencies of the band."""
    rng, box, high = np.random.default_rng(seed), problem.box, basis.model.bound.highest / (2 * np.pi)
    rows, cpu, finite = [], [], []
    for number in range(1, values + 1):
        p = rng.uniform(box.low, box.high)
        # Nearer to zero a direct solution of a free body loses its digits to rigid motion.
        hz = rng.uniform(1e-3 * high, high, count)
        start = time.process_time()
        at = basis.model.at(p)
        at = replace(at, damping=damping)
        H, bound, kind = at.response(hz), at.bound(hz), at.bound_kind
        cpu.append(time.process_time() - start)
        S = np.outer(basis.model.scale, basis.model.scale)
        with problem.at(p, assembled=True) as there:
            there.damping = damping
            B = there.B.toarray()
            full = np.stack([B.T @ elastic_states(there.system, 2j * np.pi * f, B) for f in hz]) * S
        error = np.linalg.norm(H * S - full, axis=(1, 2))
        rows.append(np.stack([error, bound, np.linalg.norm(full, axis=(1, 2))]))
        finite.append(np.isfinite(bound).all())
        if number == values or not number % EVERY:
            compared = _compared(rows, finite, cpu, kind)
            print(json.dumps(compared), flush=True)
    return compared


def _compared(rows: list[Floats], finite: list[bool], cpu: list[float], kind: str) -> dict[str, object]:
    error, bound, size = np.hstack(rows)
    known = np.isfinite(bound)
    ratio = bound[known] / error[known]
    return {
        "kind": kind,
        "values": len(rows),
        "samples": len(error),
        "violations": int((error > bound).sum()),
        "finite_values": float(np.mean(finite)),
        "finite_samples": float(known.mean()),
        "error_median": float(np.median(error / size)),
        "error_95": float(np.percentile(error / size, 95)),
        "error_largest": float((error / size).max()),
        "least_ratio": float(ratio.min()),
        "median_ratio": float(np.median(ratio)),
        "ratio_95": float(np.percentile(ratio, 95)),
        "online_ms": 1e3 * float(np.median(cpu)),
    }


def main() -> None:
    """Reduce, compare and print one line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", choices=("bracket", "conrod", "rod"))
    parser.add_argument("--values", type=int, default=100)
    parser.add_argument("--frequencies", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--training", type=int, default=256)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        case = case_of(arguments.case, Path(folder))
    varied = varied_model(case.mesh, [STEEL], case.parameters, tolerance=case.method.tolerance)
    model = varied.model(varied.box.nominal)
    with AffineProblem(varied, interfaces(model, case.sets), model=model, damping=case.damping) as problem:
        start = time.process_time()
        basis = replace(case.method, training=arguments.training).search(problem, Lines())
        bound = basis.model.bound
        result: dict[str, object] = {
            "case": arguments.case,
            "dofs": model.size,
            "order": basis.model.order,
            "collected": basis.collected,
            "factorisations": basis.factorisations,
            "counts": basis.counts,
            "offline_s": time.process_time() - start,
            "box_bound": basis.box_bound,
            "kind": basis.kind,
            "terms": len(problem.K_terms),
            "eps": problem.eps,
            "cells": len(bound.cells.alpha),
            "alpha": float(bound.cells.alpha.min()),
            "least": float(np.sqrt(bound.cells.least.min()) / bound.highest),
            "coordinates": len(bound.residual_B),
            "peak_mb": peak_memory_bytes() / 1e6,
        }
        print(json.dumps(result), flush=True)
        p = np.random.default_rng(99).uniform(problem.box.low, problem.box.high)
        begin = time.process_time()
        with problem.at(p, assembled=True) as there:
            CraigBampton(modes=30).reduce(there)
        result["full_reduction_s"] = time.process_time() - begin
        hz = np.linspace(0, bound.highest / (2 * np.pi), 10)
        basis.model.at(p).bound(hz)
        times = []
        for _ in range(5):
            begin = time.process_time()
            basis.model.at(p).response(hz)
            times.append(time.process_time() - begin)
        result["online_ms_response"] = 1e3 * float(np.median(times))
        times = []
        for _ in range(5):
            begin = time.process_time()
            basis.model.at(p).bound(hz)
            times.append(time.process_time() - begin)
        result["online_ms_bound"] = 1e3 * float(np.median(times))
        print(json.dumps(result), flush=True)
        compared = compare(problem, basis, arguments.values, arguments.frequencies, arguments.seed, case.damping)
        print(json.dumps({**result, **compared}, indent=1))


if __name__ == "__main__":
    main()
