"""Bodies that become FMUs and C code, and FMUs in CasADi, which the project needs anyway."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import casadi
import numpy as np
import pytest

from morembs import isotropic, stress_recovery
from morembs.body import elastic_body, make_part
from morembs.body.file import write_body
from morembs.body.floating.frame import floating_frame
from morembs.exporters import export_body
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.problem import Problem
from morembs.problem.damping import Damping
from morembs.reducers.base import Reducer
from tests.support.meshes import box, where

LENGTH, WIDTH, HEIGHT = 0.4, 0.04, 0.02
needs_compiler = pytest.mark.skipif(
    not (shutil.which("cc") or shutil.which("gcc")), reason="no C compiler is here: sudo apt-get install gcc libc6-dev"
)


def strip(folder: Path, reducer: Reducer, *, young: float = 2e9, damping: float = 2e-6, kind: str = "tangent") -> Path:
    """Body file "strip.h5" of a plastic strip along x with the rigid interfaces "left-end" and "tip", and stresses."""
    mesh = box("hex20", (6, 1, 1), (LENGTH, WIDTH, HEIGHT))
    model = assemble(mesh, [isotropic(set="all", young=young, poisson=0.3, density=1200.0)])
    ends = [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("left-end", 0.0), ("tip", LENGTH))]
    with Problem(model, ends, damping=Damping(beta=damping)) as problem:
        reduced = reducer.reduce(problem, name="strip")
        names = ["left-end"] if kind == "tangent" else []
        frame = floating_frame(problem, reduced, kind=kind, interfaces=names)
        body = elastic_body(problem, reduced, make_part(problem), floating=frame)
        stress = stress_recovery(problem, reduced, single=False)
        return write_body(folder / "strip.h5", [replace(body, recovery=stress)])


def exported(source: Path, name: str, to: str = "fmu", **options: object) -> Path:
    """The FMU (or C source) ``name`` beside the body file."""
    return export_body(source, to, path=source.with_name(f"{name}.{to}"), options=options).paths[0]


class InCasadi:
    """An FMU for model exchange in CasADi: rates and outputs at any states and inputs, by name."""

    def __init__(self, fmu: Path) -> None:
        folder = fmu.with_suffix("")
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        self.description = casadi.DaeBuilder(fmu.stem, str(folder))
        self.function = self.description.create("f", ["x", "u", "p"], ["ode", "y"])
        self.x, self.u, self.p, self.y = (getattr(self.description, kind)() for kind in "xupy")

    def __call__(self, x: dict[str, float], u: dict[str, float], p: dict[str, float] | None = None):
        """Rates by the names of states, and outputs."""
        given = [
            [values.get(name, 0.0) for name in names] for names, values in ((self.x, x), (self.u, u), (self.p, p or {}))
        ]
        rate, y = (np.array(part).ravel() for part in self.function(*given))
        return dict(zip(self.x, rate.tolist(), strict=True)), dict(zip(self.y, y.tolist(), strict=True))


def by_axes(*names: str, axes: str = "xyz") -> list[str]:
    """``name.x``, ``name.y``, ... of each."""
    return [f"{name}.{axis}" for name in names for axis in axes]


def run(fmpy, fmu: Path, end: float, step: float, outputs: list[str], **options: object) -> np.ndarray:
    """Outputs (steps, m) of a simulation by FMPy, as co-simulation unless told."""
    options.setdefault("fmi_type", "CoSimulation")
    result = fmpy.simulate_fmu(str(fmu), stop_time=end, output_interval=step, output=outputs, **options)
    return np.array([result[name] for name in outputs]).T
