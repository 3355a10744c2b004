"""Single parts of a job, each measured alone: assembly, coupling, modes, and the demo as a whole.

Libraries are imported in the functions, because the process that starts the children has to stay small.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from measure import ROOT, Report, Row, Settings, child, command, in_rounds, ratios, required, run

ROD = ROOT / "pipelines" / "connecting_rod"
ROD_MAKER = ROOT / "data" / "make_connecting_rod.py"
_STEEL = {"set": "all", "young": 2.1e11, "poisson": 0.3, "density": 7850.0}
_COLUMNS = (
    ("seconds", "seconds", "s"),
    ("cpu_seconds", "processor s", "s"),
    ("process_peak_bytes", "peak MB", "MB"),
    ("dofs", "dofs", "n"),
    ("bytes_of_K_and_M", "K and M MB", "MB"),
    ("peak_rise_bytes", "rise MB", "MB"),
    ("rise_over_matrices", "rise over K and M", "x"),
    ("last_hz", "last Hz", "f"),
)


@dataclass(frozen=True)
class Part:
    """``work`` takes the mesh, where there is one: a box of elements of ``kind``, ``cells`` or ``quick`` along
    its edges."""

    work: Callable[..., Row]
    kind: str = ""
    cells: tuple[int, int, int] = (0, 0, 0)
    quick: tuple[int, int, int] = (0, 0, 0)

    def measure(self, folder: Path, quick: bool) -> Row:
        """What the work takes; called in a child."""
        return self.work(load_box(self.file(folder, quick), self.kind)) if self.kind else self.work()

    def file(self, folder: Path, quick: bool) -> Path:
        """Where the mesh is kept."""
        return folder / f"{self.kind}_{'x'.join(map(str, self.quick if quick else self.cells))}.npz"


def prepare(part: Part, folder: Path, quick: bool) -> None:
    """Write the structured mesh of ``part`` as arrays, apart from what is measured; called in a child."""
    import numpy as np

    path = part.file(folder, quick)
    if part.kind and not path.exists():
        sys.path.insert(0, str(ROOT))
        from tests.support.meshes import box

        n = part.quick if quick else part.cells
        mesh = box(part.kind, n, (1.0, 1.0, n[2] / n[0]))
        np.savez(path, xyz=mesh.nodes.xyz, nodes=mesh.blocks[0].nodes)


def load_box(path: Path, kind: str) -> Any:
    """Mesh that ``prepare`` wrote."""
    import numpy as np

    from morembs.fem import ElementBlock, Mesh, Nodes

    with np.load(path) as data:
        block = ElementBlock(type=kind, nodes=data["nodes"], ids=np.arange(len(data["nodes"])))
        return Mesh(nodes=Nodes(ids=np.arange(len(data["xyz"])), xyz=data["xyz"]), blocks=(block,))


def assemble_tetrahedra(mesh: Any) -> Row:
    """K and M of a cube of second-order tetrahedra; memory of the assembly, matrices included."""
    from morembs import assemble, isotropic
    from morembs.base.memory import peak_memory_bytes, resident_bytes

    before, start, used = resident_bytes(), time.perf_counter(), time.process_time()
    model = assemble(mesh, [isotropic(**_STEEL)])
    seconds, used = time.perf_counter() - start, time.process_time() - used
    matrices = sum(a.nbytes for A in (model.K, model.M) for a in (A.data, A.indices, A.indptr))
    rise = peak_memory_bytes() - before
    return {
        "seconds": seconds,
        "cpu_seconds": used,
        "dofs": model.size,
        "bytes_of_K_and_M": matrices,
        "peak_rise_bytes": rise,
        "rise_over_matrices": rise / matrices,
    }


def assemble_with_scikit_fem(mesh: Any) -> Row:
    """The same K and M by the forms of scikit-fem, as its users assemble them."""
    import numpy as np
    import skfem
    from skfem.helpers import dot
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    from morembs.base.memory import peak_memory_bytes, resident_bytes

    corners, cells = np.unique(mesh.blocks[0].nodes[:, :4], return_inverse=True)
    points = np.ascontiguousarray(mesh.nodes.xyz[corners].T)
    tetrahedra = skfem.MeshTet1(points, np.ascontiguousarray(cells.reshape(-1, 4).T))
    element = skfem.ElementVector(skfem.ElementTetP2())
    inertia = skfem.BilinearForm(lambda u, v, _: _STEEL["density"] * dot(u, v))
    before, start, used = resident_bytes(), time.perf_counter(), time.process_time()
    stiffness = linear_elasticity(*lame_parameters(_STEEL["young"], _STEEL["poisson"]))
    K = skfem.asm(stiffness, skfem.Basis(tetrahedra, element, intorder=2))
    M = skfem.asm(inertia, skfem.Basis(tetrahedra, element, intorder=4))
    seconds, used = time.perf_counter() - start, time.process_time() - used
    matrices = sum(a.nbytes for A in (K, M) for a in (A.data, A.indices, A.indptr))
    return {
        "seconds": seconds,
        "cpu_seconds": used,
        "dofs": K.shape[0],
        "bytes_of_K_and_M": matrices,
        "peak_rise_bytes": peak_memory_bytes() - before,
    }


def couple_beam(mesh: Any, folder: Path | None = None) -> Row:
    """A beam with rigid ends, from its matrices to those of the coupled body and its rigid-body modes; with ``folder``
    all arrays are in scratch files there."""
    import numpy as np

    from morembs import Problem, assemble, isotropic, make_interface
    from morembs.base.budget import Budget

    model, z = assemble(mesh, [isotropic(**_STEEL)]), mesh.nodes.xyz[:, 2]
    ends = [
        make_interface(model, name=name, nodes=np.flatnonzero(z == place), coupling="rigid")
        for name, place in (("start", z.min()), ("end", z.max()))
    ]
    with Budget(scratch=folder, in_memory=None if folder is None else 0):
        start, used, before = time.perf_counter(), time.process_time(), os.times().system
        with Problem(model, ends):
            return {
                "dofs": model.size,
                "seconds": time.perf_counter() - start,
                "cpu_seconds": time.process_time() - used,
                "system_seconds": os.times().system - before,
            }


def read_deck(mesh: Any) -> Row:
    """An Abaqus deck of nodes and elements, until the mesh is there."""
    import meshio

    from morembs import read_mesh

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "box.inp"
        meshio.abaqus.write(path, meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes)]))
        start, used = time.perf_counter(), time.process_time()
        read_mesh(path, "m-kg-s")
        return {
            "seconds": time.perf_counter() - start,
            "cpu_seconds": time.process_time() - used,
            "file_bytes": path.stat().st_size,
            "dofs": 3 * len(mesh.nodes.xyz),
        }


def assemble_hexahedra(mesh: Any, formulation: str) -> Row:
    """K and M of hexahedra with a formulation, a tenth of a million dofs."""
    from dataclasses import replace

    from morembs import assemble, isotropic

    block = replace(mesh.blocks[0], formulation=formulation)
    start = time.perf_counter()
    model = assemble(replace(mesh, blocks=(block,)), [isotropic(**_STEEL)])
    return {"seconds": time.perf_counter() - start, "dofs": model.size}


def average_interface(mesh: Any) -> Row:
    """One average interface with 50,000 nodes on a plate of hex8; seconds and memory of the coupling alone."""
    import numpy as np

    from morembs import assemble, isotropic, make_interface
    from morembs.base.memory import peak_memory_bytes
    from morembs.fem.interface import couple

    model = assemble(mesh, [isotropic(**_STEEL)])
    top = np.flatnonzero(model.nodes.xyz[:, 2] > model.nodes.xyz[:, 2].mean())
    before, start = peak_memory_bytes(), time.perf_counter()
    couple(model, [make_interface(model, name="top", nodes=top, coupling="average")])
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "nodes": len(top), "peak_rise_bytes": peak_memory_bytes() - before}


def rod() -> Any:
    """Connecting rod of the demo with rigid bores, 71 thousand dofs."""
    from morembs import Problem, assemble, isotropic, make_interface, parse_units, read_mesh

    mesh = read_mesh(ROD.with_suffix(".msh"), parse_units("mm-t-s"))
    model = assemble(mesh, [isotropic(**_STEEL)])
    ends = [make_interface(model, name=n, nodes=mesh.nodes.sets[n], coupling="rigid") for n in ("BIGEND", "SMALLEND")]
    return Problem(model, ends)


def cube(mesh: Any) -> Any:
    """Free cube of second-order tetrahedra: a compact body with a heavy factor."""
    from morembs import Problem, assemble, isotropic

    return Problem(assemble(mesh, [isotropic(**_STEEL)]))


def modes_ours(problem: Any) -> Row:
    """50 free-free modes by block Lanczos, counted by a second factorisation."""
    import numpy as np

    with problem:
        problem.free_free.flexibility(np.zeros((problem.K.shape[0], 1)))
        start = time.perf_counter()
        modes = problem.elastic_modes(count=50)
        return {"seconds": time.perf_counter() - start, "last_hz": float(modes.frequencies_hz[-1])}


def modes_arpack(problem: Any) -> Row:
    """The same modes by ARPACK through the same factorisation, without a count."""
    import numpy as np
    import scipy.sparse.linalg as spl

    with problem:
        elastic, M = problem.free_free, problem.M
        elastic.flexibility(np.zeros((M.shape[0], 1)))
        start = time.perf_counter()
        operator = spl.LinearOperator(M.shape, matvec=lambda f: elastic.flexibility(f.reshape(-1, 1))[:, 0])
        v0 = elastic.flexibility(M @ np.random.default_rng(0).standard_normal((M.shape[0], 1)))[:, 0]
        values = spl.eigsh(problem.K, 50, M, sigma=0.0, OPinv=operator, v0=v0, tol=1e-9, return_eigenvectors=True)[0]
        return {"seconds": time.perf_counter() - start, "last_hz": float(np.sqrt(values.max()) / (2 * np.pi))}


_CUBE: dict[str, Any] = {"kind": "tet10", "cells": (16, 16, 16), "quick": (6, 6, 6)}
# "demo" is the whole main job through the command line.
_HEXAHEDRA: dict[str, Any] = {"kind": "hex8", "cells": (32, 32, 32), "quick": (8, 8, 8)}
_BEAM: dict[str, Any] = {"kind": "tet10", "cells": (16, 16, 306), "quick": (4, 4, 40)}
PARTS: dict[str, Part] = {
    "assemble_million": Part(assemble_tetrahedra, "tet10", (34, 34, 34), (8, 8, 8)),
    "assemble_cube": Part(assemble_tetrahedra, "tet10", (20, 20, 20), (8, 8, 8)),
    "assemble_cube_scikit_fem": Part(assemble_with_scikit_fem, "tet10", (20, 20, 20), (8, 8, 8)),
    "couple_beam": Part(couple_beam, **_BEAM),
    "couple_beam_in_files": Part(lambda mesh: couple_beam(mesh, Path(tempfile.gettempdir())), **_BEAM),
    "read_deck": Part(read_deck, "hex8", (100, 100, 50), (8, 8, 8)),
    "assemble_full": Part(lambda mesh: assemble_hexahedra(mesh, "full"), **_HEXAHEDRA),
    "assemble_b_bar": Part(lambda mesh: assemble_hexahedra(mesh, "b-bar"), **_HEXAHEDRA),
    "average_interface": Part(average_interface, "hex8", (224, 224, 1), (40, 40, 1)),
    "rod_modes_ours": Part(lambda: modes_ours(rod())),
    "rod_modes_arpack": Part(lambda: modes_arpack(rod())),
    "cube_modes_ours": Part(lambda mesh: modes_ours(cube(mesh)), **_CUBE),
    "cube_modes_arpack": Part(lambda mesh: modes_arpack(cube(mesh)), **_CUBE),
}
DEMO = "demo"
NAMES = (*PARTS, DEMO)
# These take the mesh of the demo, which Gmsh makes: their size is fixed.
NOT_QUICK = ("rod_modes_ours", "rod_modes_arpack", DEMO)


def measured(names: list[str], settings: Settings) -> None:
    """Measure some of ``NAMES``, print them, and compare with ARPACK where both are there."""
    if set(names) & set(NOT_QUICK) and run([sys.executable, str(ROD_MAKER)], settings).code:
        raise SystemExit(f"{ROD_MAKER} failed: it needs Gmsh (pip install 'morembs[mesh]')")
    for name in names:
        if name != DEMO:
            required("part", settings, part=name, quick=settings.quick, prepare=True)
    rounds = in_rounds({name: lambda name=name: _row_of(name, settings) for name in names}, settings.repeat)
    report = Report("parts", settings)
    report.add(rounds)
    report.table("parts of a job", _COLUMNS)
    for body in ("rod", "cube"):
        pair = [(f"{body}_modes_{who}", "seconds") for who in ("arpack", "ours")]
        if {name for name, _ in pair} <= set(names):
            report.compare(f"{body}: ARPACK over ours, seconds", ratios(rounds, *pair))
    pair = [(name, "cpu_seconds") for name in ("assemble_cube", "assemble_cube_scikit_fem")]
    if {name for name, _ in pair} <= set(names):
        report.compare("assembly over that of scikit-fem, processor seconds", ratios(rounds, *pair))
    report.write(some=True)


def _row_of(name: str, settings: Settings) -> Row:
    if name != DEMO:
        return child("part", settings, part=name, quick=settings.quick, prepare=False)
    ended = run(command("reduce", ROD.with_suffix(".toml"), "--json"), settings)
    if ended.code:
        return {"error": ended.last_error()}
    return {"seconds": ended.seconds, "process_peak_bytes": ended.peak}
