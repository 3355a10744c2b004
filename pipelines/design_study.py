#!/usr/bin/env python3
"""A sintered connecting rod with four parameters: one reduction, then a design, its scatter and an update.

The modulus grows with the density as in sintered steel (exponent 3.4; McAdam 1951), the shank may gain depth: the least
mass whose first frequency keeps a limit. Depth stiffens more per mass than density does, so the density goes down to
its least value, and the depth meets the limit. Then the scatter of frequencies with the parameters, and the moduli and
the depth from frequencies with noise. Models that are assembled at the values check it. Draws design_study.png.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from common import THEIRS, Curve, Floats, Panel, draw, parse
from scipy.optimize import OptimizeResult, minimize
from scipy.stats import qmc

import morembs
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.stages.model import materials_of
from morembs.app.jobs.stages.parameters import build_varied_model
from morembs.app.jobs.tables import Job
from morembs.body.parametric import ParametricBody
from morembs.parametric.update import Measured

MESH = Path(__file__).resolve().parents[1] / "data" / "small_meshes" / "conrod.msh"
EXPONENT, YOUNG, DENSITY = 3.4, 1.8e11, 7400.0  # of sintered steel
DEPTH = 8.0  # mm, half of the shank's
LIMIT = 1325.0  # Hz
LEAST, MOST, DEEPER = 0.97, 1.03, 0.2  # density over the nominal one, and mm
NOISE, COUNT = 0.005, 4  # of measured frequencies, all in the band


def prepare(folder: Path) -> Job:
    """The job in ``folder``, with its mesh and its morph: the shank's depth grows, the ends stay."""
    job = Path(__file__).with_suffix(".toml")
    if folder.resolve() != job.parent:
        shutil.copyfile(job, folder / job.name)
    shutil.copyfile(MESH, folder / "design_study.msh")
    nodes = morembs.read_mesh(MESH, "mm-t-s").nodes
    x, _, z = 1e3 * nodes.xyz.T
    d = np.clip(np.minimum((x - 45) / 20, (130 - x) / 15), 0, 1) * z / DEPTH
    rows = [f"{node},0,0,{dz:.12g}" for node, dz in zip(nodes.ids, d, strict=True)]
    (folder / "design_study.csv").write_text("\n".join(["id,dx,dy,dz", *rows]) + "\n")
    return load_job(folder / job.name)


def sintered(x: Floats) -> dict[str, float]:
    """Parameters at ``x``: density over the nominal one, and t."""
    young = YOUNG * x[0] ** EXPONENT
    return {"E_big": young, "E_small": young, "rho": DENSITY * x[0], "t": x[1]}


def chain(x: Floats, slopes: dict[str, float]) -> Floats:
    """Derivatives by ``x`` from those by the parameters."""
    by_young = YOUNG * EXPONENT * x[0] ** (EXPONENT - 1)
    return np.array([(slopes["E_big"] + slopes["E_small"]) * by_young + slopes["rho"] * DENSITY, slopes["t"]])


def optimum(body: ParametricBody) -> OptimizeResult:
    """The least mass above the limit of the first frequency, by exact derivatives."""
    along = body.model.rigid[:, 0, 0]  # a translation at all values
    reference = along @ body.at().M @ along

    def mass(x: Floats) -> tuple[float, Floats]:
        at = body.at(**sintered(x))
        slopes = {name: along @ dM @ along / reference for name, dM in at.sensitivity(1).M.items()}
        return along @ at.M @ along / reference, chain(x, slopes)

    def slack(x: Floats) -> float:
        return float(body.at(**sintered(x)).frequencies_hz[0] / LIMIT - 1)

    def slope(x: Floats) -> Floats:
        return chain(x, {k: df[0] / LIMIT for k, df in body.sensitivity(**sintered(x)).frequencies_hz.items()})

    return minimize(
        mass,
        [1.0, 0.0],
        jac=True,
        method="SLSQP",
        bounds=[(LEAST, MOST), (-DEEPER, DEEPER)],
        constraints={"type": "ineq", "fun": slack, "jac": slope},
        options={"ftol": 1e-12},
    )


def full_frequencies(job: Job, table: Floats) -> tuple[Floats, float]:
    """Elastic frequencies (k, COUNT) of models assembled at each row of ``table``, and processor seconds for one."""
    mesh = morembs.read_mesh(MESH, "mm-t-s")
    varied = build_varied_model(job, mesh, materials_of(job))
    result, start = [], time.process_time()
    for p in table:
        model = varied.assemble_at(p)
        ends = [
            morembs.make_interface(model, name=name, nodes=mesh.nodes.sets[nodes], coupling="rigid")
            for name, nodes in (("big_end", "BIGEND"), ("small_end", "SMALLEND"))
        ]
        with morembs.Problem(model, ends) as there:
            result.append(there.elastic_modes(count=COUNT).frequencies_hz[:COUNT])
    return np.array(result), (time.process_time() - start) / len(table)


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments, __doc__, __file__)
    job, rng = prepare(options.folder), np.random.default_rng(3)
    run_job(job)
    body = morembs.read_body(job.output).bodies["rod"].parametric
    best = optimum(body)
    design = body.at(**sintered(best.x))
    start = time.process_time()
    samples = 8 if options.quick else 12
    table = qmc.scale(qmc.Sobol(d=len(body.names), rng=1).random_base2(samples), *body.box)
    sampled = body.frequencies_hz(table, count=COUNT)
    each = (time.process_time() - start) / len(table)
    checked = 3 if options.quick else 20
    full, seconds = full_frequencies(job, np.vstack([table[:checked], design.p]))
    hidden = {"E_big": 1.70e11, "E_small": 1.92e11, "t": 0.1}
    exact = body.at(**hidden).frequencies_hz[:COUNT]
    draws = exact * (1 + NOISE * rng.standard_normal((10 if options.quick else 100, COUNT)))
    seen = [Measured(modes=np.arange(1, COUNT + 1), frequencies_hz=hz, sigma_hz=NOISE * exact) for hz in draws]
    updated = [body.update(each, fixed=["rho"]) for each in seen]
    print(f"order {len(design.M)}, bound over the box {body.box_bound:.2e}")
    print(f"optimum: density {design.values['rho']:.1f} kg/m3, t {best.x[1]:.4f} mm, mass {best.fun:.4f} of nominal")
    print(f"first frequency {design.frequencies_hz[0]:.4f} Hz, full model {full[-1, 0]:.4f} Hz, limit {LIMIT} Hz")
    error = np.abs(sampled[:checked] / full[:-1] - 1).max()
    print(f"largest error of {full[:-1].size} frequencies against full models {error:.2e}")
    print("means of frequencies", sampled.mean(0).round(1), "spreads", sampled.std(0).round(1), "Hz")
    print(f"a full solution takes {seconds / each:.0f} times as long as a value of {len(table)}")
    for name, value in hidden.items():
        k = body.names.index(name)
        within = sum(abs(each.p[k] - value) < 2 * each.sigma[k] for each in updated)
        print(
            f"updated {name} = {updated[0].p[k]:.5g} +- {updated[0].sigma[k]:.2g}, hidden {value:.5g}; "
            f"{within} of {len(updated)} draws within two sigma"
        )
    depths = np.linspace(-DEEPER, DEEPER, 41)
    lines = [
        Curve(
            depths,
            np.array([body.at(**sintered(np.array([r, t]))).frequencies_hz[0] for t in depths]),
            f"{DENSITY * r:.0f} kg/m3",
            f"C{k}",
        )
        for k, r in enumerate((LEAST, 1.0, MOST))
    ]
    lines += [Curve(best.x[1:], np.array([LIMIT]), "optimum", THEIRS, "o")]
    counts, edges = np.histogram(sampled[:, 0], 60)
    draw(
        options.folder / "design_study.png",
        "A connecting rod with four parameters",
        [
            Panel("First frequency", "t, mm", "Hz", lines),
            Panel("Scatter of the first frequency", "Hz", "samples", [Curve((edges[1:] + edges[:-1]) / 2, counts)]),
        ],
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
