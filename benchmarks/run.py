"""Benchmarks: each case runs in a child process of its own; the operating system counts its peak memory.

usage: python benchmarks/run.py [CASE ...] [--runs 3]

Cases are run in turn within each round, so that a drift of the machine's speed hits all alike; medians
and ratios are printed. Figures of one machine say little on another: compare within one run.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))
ROD = ROOT / "pipelines" / "connecting_rod.msh"


def box_file(folder: Path, kind: str, n: tuple[int, int, int]) -> Path:
    """Structured box mesh as arrays; made apart from the case that is measured."""
    from meshes import box

    path = folder / f"{kind}_{'x'.join(map(str, n))}.npz"
    if not path.exists():
        mesh = box(kind, n, (1.0, 1.0, n[2] / n[0]))
        np.savez(path, xyz=mesh.nodes.xyz, nodes=mesh.blocks[0].nodes)
    return path


def load_box(path: Path, kind: str):
    """Mesh of ``box_file``."""
    from morembs.model import ElementBlock, Mesh, Nodes

    data = np.load(path)
    block = ElementBlock(type=kind, nodes=data["nodes"], ids=np.arange(len(data["nodes"])))
    return Mesh(nodes=Nodes(ids=np.arange(len(data["xyz"])), xyz=data["xyz"]), blocks=(block,))


def rod():
    """Connecting rod of the demo with rigid bores, 71 thousand dofs."""
    from morembs import Problem, assemble, isotropic, make_interface, parse_units, read_mesh

    mesh = read_mesh(ROD, parse_units("mm-t-s"))
    model = assemble(mesh, [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)])
    ends = [make_interface(model, name=n, nodes=mesh.nodes.sets[n], coupling="rigid") for n in ("BIGEND", "SMALLEND")]
    return Problem(model, ends)


def assemble_million(folder: Path) -> dict[str, float]:
    """K and M of a cube of second-order tetrahedra, 0.99 million dofs."""
    from morembs import assemble, isotropic

    mesh = load_box(folder / "tet10_34x34x34.npz", "tet10")
    start = time.perf_counter()
    model = assemble(mesh, [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)])
    seconds = time.perf_counter() - start
    matrices = sum(a.nbytes for A in (model.K, model.M) for a in (A.data, A.indices, A.indptr))
    return {"seconds": seconds, "dofs": model.size, "bytes_of_K_and_M": matrices}


def average_interface(folder: Path) -> dict[str, float]:
    """One average interface with 50,000 nodes on a plate of hex8; seconds and memory of the coupling alone."""
    from morembs import assemble, isotropic, make_interface
    from morembs.interface import couple
    from morembs.progress import peak_memory_bytes

    mesh = load_box(folder / "hex8_224x224x1.npz", "hex8")
    model = assemble(mesh, [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)])
    top = np.flatnonzero(model.nodes.xyz[:, 2] > model.nodes.xyz[:, 2].mean())
    before, start = peak_memory_bytes(), time.perf_counter()
    couple(model, [make_interface(model, name="top", nodes=top, coupling="average")])
    return {
        "seconds": time.perf_counter() - start,
        "nodes": len(top),
        "peak_rise_bytes": peak_memory_bytes() - before,
    }


def cube(folder: Path):
    """Free cube of second-order tetrahedra, 108 thousand dofs: a compact body with a heavy factor."""
    from morembs import Problem, assemble, isotropic

    mesh = load_box(folder / "tet10_16x16x16.npz", "tet10")
    return Problem(assemble(mesh, [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)]))


def modes_ours(problem) -> dict[str, float]:
    """50 free-free modes by block Lanczos, counted by a second factorisation."""
    with problem:
        problem.elastic.flexibility(np.zeros((problem.K.shape[0], 1)))
        start = time.perf_counter()
        modes = problem.elastic_modes(count=50)
        return {"seconds": time.perf_counter() - start, "last_hz": float(modes.frequencies_hz[-1])}


def modes_arpack(problem) -> dict[str, float]:
    """The same modes by ARPACK through the same factorisation, without a count."""
    import scipy.sparse.linalg as spl

    with problem:
        elastic, M = problem.elastic, problem.M
        elastic.flexibility(np.zeros((M.shape[0], 1)))
        start = time.perf_counter()
        operator = spl.LinearOperator(M.shape, matvec=lambda f: elastic.flexibility(f.reshape(-1, 1))[:, 0])
        v0 = elastic.flexibility(M @ np.random.default_rng(0).standard_normal((M.shape[0], 1)))[:, 0]
        values = spl.eigsh(problem.K, 50, M, sigma=0.0, OPinv=operator, v0=v0, tol=1e-9, return_eigenvectors=True)[0]
        return {"seconds": time.perf_counter() - start, "last_hz": float(np.sqrt(values.max()) / (2 * np.pi))}


def demo(folder: Path) -> dict[str, float]:
    """The whole main job through the command line."""
    start = time.perf_counter()
    command = [sys.executable, "-m", "morembs.cli", "reduce", str(ROOT / "pipelines" / "connecting_rod.toml"), "--json"]
    subprocess.run(command, check=True, capture_output=True)
    return {"seconds": time.perf_counter() - start}


CASES: dict[str, tuple[Callable[[Path], dict[str, float]], tuple[str, tuple[int, int, int]] | None]] = {
    "assemble_million": (assemble_million, ("tet10", (34, 34, 34))),
    "average_interface": (average_interface, ("hex8", (224, 224, 1))),
    "rod_modes_ours": (lambda folder: modes_ours(rod()), None),
    "rod_modes_arpack": (lambda folder: modes_arpack(rod()), None),
    "cube_modes_ours": (lambda folder: modes_ours(cube(folder)), ("tet10", (16, 16, 16))),
    "cube_modes_arpack": (lambda folder: modes_arpack(cube(folder)), ("tet10", (16, 16, 16))),
    "demo": (demo, None),
}


def child(name: str, folder: Path) -> dict[str, float]:
    """Result of one case in a child process, with the child's peak memory."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read)
        os.dup2(write, 1)
        os.execv(sys.executable, [sys.executable, __file__, "--child", name, "--folder", str(folder)])
    os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    _, status, usage = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"case {name} failed")
    result = json.loads(text.strip().splitlines()[-1])
    # A case that starts processes of its own reports the largest of them.
    result["peak_bytes"] = usage.ru_maxrss * 1024
    return result


def main() -> None:
    """Run the cases and print medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=list(CASES), help=", ".join(CASES))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--child")
    parser.add_argument("--folder")
    options = parser.parse_args()
    if options.child:
        print(json.dumps(CASES[options.child][0](Path(options.folder))))
        return
    subprocess.run([sys.executable, str(ROOT / "pipelines" / "connecting_rod.py")], check=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.cases:
            if (needed := CASES[name][1]) is not None:
                box_file(Path(folder), *needed)
        rounds = [{name: child(name, Path(folder)) for name in options.cases} for _ in range(options.runs)]
    for name in options.cases:
        rows = [r[name] for r in rounds]
        median = {key: statistics.median(row[key] for row in rows) for key in rows[0]}
        print(name, json.dumps({key: float(f"{value:.6g}") for key, value in median.items()}))
    for part in ("rod", "cube"):
        ours, theirs = f"{part}_modes_ours", f"{part}_modes_arpack"
        if {ours, theirs} <= set(options.cases):
            ratios = sorted(r[theirs]["seconds"] / r[ours]["seconds"] for r in rounds)
            print(f"{part}: ARPACK / ours, pair by pair:", ", ".join(f"{ratio:.2f}" for ratio in ratios))


if __name__ == "__main__":
    main()
