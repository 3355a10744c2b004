"""Small files as a released version wrote them, and what its readers made of them.

The files of 0.1.0 in ``tests/data/0.1.0`` were made by this module with the code of that version:

    git archive c6ca06f | tar x -C OLD
    PYTHONPATH=OLD python tests/support/released.py tests/data/0.1.0

Those of 0.2.0 in ``tests/data/0.2.0``, with what 0.1.0 could not hold, were made with its code and ``later`` behind.

They are never made anew: ``tests/storage/test_released_files.py`` reads them with today's readers.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

# The code under test may be that of another folder, which comes first.
sys.path.append(str(Path(__file__).parents[2]))

from tests.support import decks

CELLS, SIZE = (4, 1, 1), (400.0, 50.0, 30.0)
PLAIN = (str, int, float, list, type(None))
# Tables of the jobs, by ``decks.job``.
BAR: dict[str, str | None] = {
    "model": 'mesh = "bar.inp"\nunits = "mm-t-s"',
    "material": "young = 2.1e5\npoisson = 0.3\ndensity = 7.85e-9",
    "interface": 'name = "left end"\nnodes = "box:-1,-1,-1,1,51,31"',
    "interface2": 'name = "right"\nnodes = "box:399,-1,-1,401,51,31"\ncoupling = "average"\ncomponents = [0, 1, 2]',
    "damping": "rayleigh = { alpha = 2.0, beta = 1e-6 }",
}
JOBS: dict[str, dict[str, str | None]] = {
    "symmetric": {
        "reduce": 'name = "rail"\nmethod = "static-modes-switching"\nbase_options = { modes = 2 }\n'
        'candidates = "box:99,49,29,301,51,31"\ndirections = [2]\nstress = true',
        "reduce2": 'method = "craig-bampton"\nmodes = 2',
        "certify": "band_hz = [10.0, 2000.0]\npoints = 4",
        "frame": 'kind = "tangent"\ninterfaces = ["left end"]',
        "envelope": "speed = 10.0\nforce = 100.0",
        "stiffening": "",
        "stress": 'nodes = "box:-1,-1,-1,101,51,31"',
        "output": 'path = "symmetric.h5"',
    },
    "two_sided": {
        "reduce": 'name = "both"\nmethod = "krylov"\nshifts_hz = [1000.0]\ntwo_sided = true\ninputs = ["left end"]\n'
        'outputs = ["right"]',
        "output": 'path = "two_sided.h5"\nnodes = "interfaces"',
    },
}
LATER_JOBS: dict[str, dict[str, str | None]] = {
    "limits": {
        "reduce": 'method = "craig-bampton"\nmodes = 2',
        "certify": "band_hz = [0.0, 2000.0]\npoints = 4",
        "output": 'path = "limits.h5"\nnodes = "interfaces"',
    },
    "design": {
        "parameter": 'name = "E"\nproperty = "young"\nset = "all"\nrange = [2e5, 2.2e5]',
        "reduce": 'method = "parametric"\nband_hz = [0.0, 500.0]\ntolerance = 0.1',
        "output": 'path = "design.h5"\nnodes = "interfaces"',
    },
}


def described(value: Any, name: str = "") -> dict[str, Any]:
    """What a reader gave, flat: place -> number, text, or shape and checksum of the bytes of an array."""
    if sp.issparse(value):
        parts = {"shape": np.array(value.shape), **{key: getattr(value, key) for key in ("data", "indices", "indptr")}}
        return described(parts, name)
    if is_dataclass(value):
        value = {part.name: getattr(value, part.name) for part in fields(value)}
    if isinstance(value, Mapping):
        return {place: text for key, part in value.items() for place, text in described(part, f"{name}/{key}").items()}
    if isinstance(value, tuple | list) and value:
        return {place: text for i, part in enumerate(value) for place, text in described(part, f"{name}/{i}").items()}
    if isinstance(value, np.ndarray):
        # Widths of whole numbers are free.
        plain = value.astype(np.int64) if value.dtype.kind in "iu" else value
        digest = hashlib.sha256(np.ascontiguousarray(plain).tobytes()).hexdigest()
        return {name: f"{plain.dtype.str} {list(plain.shape)} {digest[:16]}"}
    if callable(value):
        return {}
    return {name: value.item() if isinstance(value, np.generic) else list(value) if value == () else value}


def deck() -> str:
    """An Abaqus deck of a bar of hexahedra, in mm."""
    steps = [np.linspace(0, size, count + 1) for count, size in zip(CELLS, SIZE, strict=True)]
    place = {at: i + 1 for i, at in enumerate(itertools.product(*(range(count + 1) for count in CELLS)))}
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    lines = ["*NODE"]
    lines += [f"{i}, " + ", ".join(f"{x[k]:g}" for x, k in zip(steps, at, strict=True)) for at, i in place.items()]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=ALL"]
    cells = itertools.product(*map(range, CELLS))
    for number, cell in enumerate(cells, 1):
        row = (place[tuple(a + b for a, b in zip(cell, corner, strict=True))] for corner in corners)
        lines.append(", ".join(map(str, (number, *row))))
    return "\n".join([*lines, ""])


def member(**options: Any) -> Any:
    """A rod with large deflections, tabulated."""
    from morembs.dynamics.gmp import ReducedMember
    from morembs.dynamics.nonlinear import PlanarBeam, Section

    section = Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770)
    beam = PlanarBeam.straight(0.304, 6, section)
    return ReducedMember(beam, modes=2, formulation="membrane", reach=0.6, points_per_angle=5, **options)


def make(folder: Path) -> None:
    """Write the files of 0.1.0; runs with the code of that version alone."""
    from morembs.conversion.imported import AverageElement, Imported, PointMass, RigidElement
    from morembs.conversion.to_model import model_of
    from morembs.material import isotropic
    from morembs.storage.body_file import read_body
    from morembs.storage.model_file import write_model
    from morembs.stress.shapes import read_recovery

    from morembs.app.jobs.job import load_job
    from morembs.app.jobs.run import run_job
    from morembs.dynamics.gmp.stored import read_members, write_members
    from morembs.fem import Nodes
    from morembs.importers import read_mesh
    from morembs.importers.native import import_native

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bar.inp").write_text(deck())
    expected = {}
    for name, tables in JOBS.items():
        toml = folder / f"{name}.toml"
        toml.write_text(decks.job({**BAR, **tables}))
        run_job(load_job(toml))
        toml.unlink()
        expected[f"{name}.h5"] = body_file(folder / f"{name}.h5", read_body, read_recovery)
    mesh = read_mesh(folder / "bar.inp")
    (folder / "bar.inp").unlink()
    left, right = (np.flatnonzero(np.isclose(mesh.nodes.xyz[:, 0], x)) for x in (0.0, SIZE[0]))
    xyz = np.vstack([mesh.nodes.xyz, [[500.0, 25, 10], [-50.0, 25, 10]]])
    nodes = Nodes(ids=np.append(mesh.nodes.ids, [900, 901]), xyz=xyz, sets={"END": right})
    first = len(mesh.nodes)
    imported = Imported(
        source="bar",
        nodes=nodes,
        mesh=mesh,
        materials=(isotropic(set="all", young=70.0, poisson=0.3, density=2.7),),
        rigid=(RigidElement(name="RBE2_1", master=first, slaves=right),),
        average=(AverageElement(name="RBE3 2", reference=first + 1, nodes=left, weights=np.arange(1.0, 5)),),
        masses=(PointMass(name="CONM2_3", node=first, mass=2.0, inertia=np.diag([1.0, 2.0, 3.0])),),
    )
    write_model(folder / "coupled.model.h5", model_of(imported))
    expected["coupled.model.h5"] = described(import_native(folder / "coupled.model.h5"))
    write_members(folder / "members.h5", {"rod": member(checkpoint=folder / "equilibria.h5").data})
    expected["members.h5"] = described(read_members(folder / "members.h5"))
    (folder / "expected.json").write_text(json.dumps(expected, indent=0, sort_keys=True) + "\n")


def make_later(folder: Path) -> None:
    """Write files of 0.2.0 with what 0.1.0 could not hold: proven limits, parameters, equations, skew parts.

    Runs with the code of that version alone.
    """
    import morembs
    from morembs.app.jobs.job import load_job
    from morembs.app.jobs.run import run_job
    from morembs.body.recovery_shapes import read_recovery

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bar.inp").write_text(deck())
    expected = {}
    for name, tables in LATER_JOBS.items():
        toml = folder / f"{name}.toml"
        toml.write_text(decks.job({**BAR, **tables}))
        run_job(load_job(toml))
        toml.unlink()
        expected[f"{name}.h5"] = body_file(folder / f"{name}.h5", morembs.read_body, read_recovery)
    (folder / "tied.inp").write_text(deck() + "*EQUATION\n2\n17, 1, 1., 18, 1, -1.\n")
    steel = morembs.isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    tied = morembs.import_model(folder / "tied.inp", materials=[steel], units="mm-t-s")
    K, M = np.diag([2.0, 3.0, 5.0, 7.0]) * 1e6, np.eye(4)
    G = np.array([[0, 40.0, 0, 0], [-40.0, 0, 0, 0], [0, 0, 0, 3.0], [0, 0, -3.0, 0]])
    turning = morembs.from_matrices(K, M, B=np.eye(4)[:, :2], C=np.eye(4)[1:3], G=G, name="turning")
    for name, model in (("tied", tied), ("turning", turning)):
        morembs.write_model(folder / f"{name}.model.h5", model)
        expected[f"{name}.model.h5"] = described(morembs.read_model(folder / f"{name}.model.h5"))
    inputs = [morembs.matrix_interface(turning, name="B", matrix="B")]
    with morembs.Problem(turning, inputs) as problem:
        reduced = morembs.Krylov(shifts_hz=[100.0], order=2).reduce(problem, name="turning")
        body = morembs.elastic_body(problem, reduced, morembs.make_part(problem))
    morembs.write_body(folder / "turning.h5", [body])
    expected["turning.h5"] = body_file(folder / "turning.h5", morembs.read_body, read_recovery)
    for path in folder.glob("*.inp"):
        path.unlink()
    # Without objects that read at demand.
    plain = {name: {at: v for at, v in found.items() if isinstance(v, PLAIN)} for name, found in expected.items()}
    (folder / "expected.json").write_text(json.dumps(plain, indent=0, sort_keys=True) + "\n")


def body_file(path: Path, read_body: Any, read_recovery: Any) -> dict[str, Any]:
    """All that a reader finds in a body file, with what it reads at demand."""
    import h5py

    stored = read_body(path)
    more = {}
    with h5py.File(path) as file:
        for name, body in stored.bodies.items():
            group = file[f"bodies/{name}"]
            more[name] = {
                "basis": body.basis(),
                "switching": body.switching() if body.has_switching else None,
                "stress": read_recovery(group["recovery"]) if body.has_recovery else None,
            }
    # Properties now, fields then.
    flags = ("has_recovery", "has_switching")
    found = {f"/bodies/{name}/{flag}": getattr(body, flag) for name, body in stored.bodies.items() for flag in flags}
    for name, body in stored.bodies.items():
        if body.certificate is not None:
            found |= described(body.certificate.datasets, f"/bodies/{name}/certificate")
    content = described(stored) | described(more, "/read") | found
    # Times and memory of the run, and the version of the program.
    return {name: value for name, value in content.items() if not name.startswith("/provenance")}


if __name__ == "__main__":
    (make_later if "later" in sys.argv[2:] else make)(Path(sys.argv[1]))
