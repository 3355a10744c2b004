#!/usr/bin/env python3
"""What bodies and certificates draw: responses, limits, receptances, modal density, MAC, Campbell diagram, cost.

A bracket is reduced by two methods, and once more to a body that turns about its bolts. Draws plots.png and, beside it,
plots_response.png, plots_density.png, plots_mac.png, plots_campbell.png and plots_cost.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from common import parse

import morembs
from morembs.app.jobs.job import load_job
from morembs.app.jobs.picture import save
from morembs.app.jobs.run import JobResult, run_job

JOB = """
[model]
mesh = "bracket.msh"
units = "mm-t-s"

[[material]]
set = "all"
young = 210e3
poisson = 0.3
density = 7.85e-9

[[interface]]
name = "BOLTS"
nodes = "set:BOLTS"

[[interface]]
name = "PIN"
nodes = "set:PIN"

[[reduce]]
method = "craig-bampton"
modes = 8

[[reduce]]
method = "guyan"
"""
CERTIFY = """
[certify]
band_hz = [0, 20000]
"""
SPIN = """
[spin]
speed = [0, 8000]
axis = [0, 0, 1]
held = ["BOLTS"]
"""


def run(folder: Path, name: str, more: str, nodes: str) -> JobResult:
    """The job with a further table, on the bracket of the examples; its bodies keep some nodes."""
    if not (folder / "bracket.msh").exists():
        morembs.examples.bracket(folder)
    job = folder / f"{name}.toml"
    job.write_text(f'{JOB}{more}\n[output]\npath = "{name}.h5"\nnodes = "{nodes}"\n')
    return run_job(load_job(job))


def main(arguments: Sequence[str] | None = None) -> int:
    """Reduces, draws, and says what was drawn."""
    options = parse(arguments, __doc__ or "", __file__)
    folder = options.folder
    still = run(folder, "plots_still", CERTIFY, "skin")
    turning = run(folder, "plots_turning", SPIN, "interfaces")
    exact, static = still.bodies
    figures = {
        "plots": exact.certificate.plot(),
        "plots_response": exact.plot_response(entries=[(1, 1), (7, 1)]),
        "plots_density": exact.plot_modal_density(),
        "plots_mac": exact.plot_mac(static),
        "plots_campbell": turning.bodies[0].plot_campbell(),
        "plots_cost": still.plot_cost(),
    }
    for name, figure in figures.items():
        save(figure, folder / f"{name}.png")
    worst = exact.certificate.limit
    print(f"craig-bampton, order {exact.reduced.order}: error at most {worst.upper:.3g}, at {worst.at_hz:,.0f} Hz")
    print(folder / "plots.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
