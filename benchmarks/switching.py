"""Case about static modes switching: time and peak memory of the tables of 5,000 candidates on 300,000 dofs.

These are on a line along a bar, where neighbours are loaded together (a band). Beside it a cube of 100,000 dofs with
2,000 candidates along the normals of its surface, of which any two may be loaded (all pairs).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from measure import Report, Row, Settings, child, in_rounds

from morembs.base.budget import Budget
from morembs.base.memory import peak_memory_bytes, resident_bytes
from morembs.fem import ElementBlock, FEModel, Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.material import isotropic
from morembs.linalg.sparse.select import select_solver
from morembs.problem import Problem
from morembs.reducers import ReducedModel, StaticModesSwitching
from morembs.responses.static_mode_tables import StaticModeTables

Spec = dict[str, Any]
LINE, SURFACE = "line, band 24", "surface, all pairs"
# Memory that the process may take, bytes; what is asked for is less than 8 GB.
MEMORY = 7_000_000_000
MODES, BAND = 20, 24
_STEEL = {"set": "all", "young": 2.1e11, "poisson": 0.3, "density": 7850.0}
_HEX = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
_COLUMNS = (
    ("dofs", "dofs", "n"),
    ("candidates", "candidates", "n"),
    ("basis_seconds", "basis s", "s"),
    ("table_seconds", "tables s", "s"),
    ("resident_bytes", "before MB", "MB"),
    ("process_peak_bytes", "peak MB", "MB"),
    ("difference", "difference", "e"),
)


def switching(settings: Settings) -> None:
    """Time and memory of the tables."""
    measures: dict[str, Callable[[], Row]] = {who: _measure(settings, who) for who in (LINE, SURFACE)}
    report = Report("switching", settings)
    report.add(in_rounds(measures, settings.repeat))
    report.table(
        "switching: static modes of all candidates\npeak MB: of the whole process, by the operating system;\n"
        "difference: of R for some candidates to solves one by one, relative",
        _COLUMNS,
    )
    report.write()


def _measure(settings: Settings, who: str) -> Callable[[], Row]:
    return lambda: child("switching", settings, who=who, quick=settings.quick)


def bar(cells: tuple[int, int, int]) -> tuple[FEModel, str]:
    """A steel bar of 8-node hexahedra of 12 mm length, and its line of candidates."""
    shape = np.array(cells) + 1
    first = np.array(list(itertools.product(*(range(k) for k in cells))))
    numbers = np.ravel_multi_index(np.moveaxis(first[:, None] + _HEX, -1, 0), tuple(shape))
    steps = np.stack(np.unravel_index(np.arange(shape.prod()), tuple(shape)), axis=1)
    nodes = np.flatnonzero((steps[:, 1] == cells[1] // 2) & (steps[:, 2] == cells[2]))
    ids = np.arange(1, len(steps) + 1)
    mesh = Mesh(
        nodes=Nodes(ids=ids, xyz=steps * [0.012, 0.01, 0.02], sets={"LINE": nodes}),
        blocks=(ElementBlock(type="hex8", nodes=numbers, ids=np.arange(len(numbers))),),
    )
    return assemble(mesh, [isotropic(**_STEEL)]), "set:LINE"


def cube(steel: Callable[[str, int], FEModel], dofs: int, count: int) -> tuple[FEModel, str]:
    """A steel cube of 10-node tetrahedra, and ``count`` nodes of its surface."""
    model = steel("cube", dofs)
    xyz = model.nodes.xyz
    outside = np.flatnonzero((np.abs(xyz - xyz.max(axis=0)) < 1e-9 * np.ptp(xyz)).any(axis=1))
    return model, "ids:" + ",".join(map(str, model.nodes.ids[outside[:count]]))


def measure(spec: Spec, steel: Callable[[str, int], FEModel]) -> Row:
    """What one child finds."""
    small, line = spec["quick"], spec["who"] == LINE
    if line:
        model, candidates = bar((100, 3, 3) if small else (1666, 7, 7))
        reducer = StaticModesSwitching(
            base_options={"modes": MODES}, candidates=candidates, directions=[0, 1, 2], band=BAND
        )
    else:
        model, candidates = cube(steel, 10_000 if small else 100_000, 200 if small else 2000)
        reducer = StaticModesSwitching(
            base_options={"modes": MODES}, candidates=candidates, directions="normals", kind="surface"
        )
    resident, start = resident_bytes(), time.perf_counter()
    folder = Path(spec["folder"])
    solver = select_solver(memory=MEMORY, scratch=folder)
    with Budget(MEMORY, folder), Problem(model, solver=solver) as problem:
        reduced = reducer.reduce(problem)
        middle = time.perf_counter()
        tables = reducer.tabulate_static_modes(problem, reduced)
        end = time.perf_counter()
        difference = _difference(problem, reduced, tables)
    return {
        "dofs": model.size,
        "candidates": tables.count,
        "band": len(tables.stiffness) - 1,
        "basis_seconds": middle - start,
        "table_seconds": end - middle,
        "resident_bytes": resident,
        "rise_bytes": peak_memory_bytes() - resident,
        "table_bytes": tables.stiffness.nbytes + tables.mass.nbytes,
        "difference": difference,
    }


def _difference(problem: Problem, reduced: ReducedModel, tables: StaticModeTables) -> float:
    """Of R: b' G b less what the modes give, for neighbours in the middle."""
    place = {int(label): row for row, label in enumerate(problem.model.nodes.ids)}
    some = tables.of_nodes(len(tables.node_ids) // 2, 2)
    loads = np.zeros((problem.model.size, len(some)))
    for column, k in enumerate(some):
        # All dofs are translations, three at each node.
        row = 3 * place[int(tables.node_ids[tables.node[k]])]
        loads[row : row + 3, column] = tables.direction[k]
    whole = loads.T @ problem.free_free.flexibility(loads)
    modes, first = tables.modes[some], reduced.rigid_count
    want = whole - modes[:, first:] / np.diag(reduced.K)[first:] @ modes[:, first:].T
    return float(np.abs(tables.R(some) - want).max() / np.abs(want).max())


CASES = {"switching": switching}
