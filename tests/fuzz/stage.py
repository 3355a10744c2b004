"""What the fixed cases share: their register, small models, and commands that must do their work or be refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np

from morembs import from_matrices
from morembs.importers import model_file
from tests.fuzz.judge import judge
from tests.fuzz.models import Model
from tests.fuzz.solids import Solid, block
from tests.fuzz.trials import FAULTS, Folder, Outcome, reason
from tests.fuzz.truth import Damping, Port, Truth

CASES: dict[str, Callable[[Folder], None]] = {}
MODEL = '[model]\nfile = "part.model.h5"\n'
MESH = '[model]\nmesh = "{name}"\n[[material]]\nyoung = 2.1e11\npoisson = 0.3\ndensity = 7850.0\n'
END = '[[interface]]\nname = "end"\nnodes = "ids:{labels}"\n'
MODAL = '[[reduce]]\nmethod = "modal"\nmodes = 3\n'
OUTPUT = '[output]\npath = "body.h5"\n'


def case(function: Callable[[Folder], None]) -> Callable[[Folder], None]:
    """List a case by its name."""
    CASES[function.__name__.replace("_", "-")] = function
    return function


def run(name: str, folder: Path, *, keep: bool = False) -> Outcome:
    """The outcome of one case."""
    outcome = Outcome(name, features={"case": name}, command=f'make attack ARGS="jobs --case {name}"')
    place = Folder(folder / name, outcome)
    CASES[name](place)
    place.check()
    if outcome.result not in FAULTS and not keep:
        place.close()
    return outcome


def bar(
    scale: float = 1.0, cells: tuple[int, int, int] = (3, 1, 1), size: tuple[float, ...] = (0.3, 0.02, 0.03)
) -> Solid:
    """A steel bar of hexahedra."""
    xyz, elements = block("hex8", cells, np.array(size) * scale)
    return Solid(kind="hex8", xyz=xyz, cells=elements, young=2.1e11, poisson=0.3, density=7850.0)


def write_mesh(place: Folder, name: str, solid: Solid) -> str:
    """A mesh file, and the table of an interface at its far end."""
    meshio.write(place.place / name, meshio.Mesh(solid.xyz, [("hexahedron", solid.cells)]))
    return end_of(solid)


def end_of(solid: Solid) -> str:
    rows = np.flatnonzero(solid.xyz[:, 0] >= solid.xyz[:, 0].max() - 1e-9) + 1
    return END.format(labels=",".join(map(str, rows)))


def write_job(place: Folder, *tables: str, name: str = "job.toml") -> None:
    (place.place / name).write_text("\n".join(tables))
    place.seal()


def gives(place: Folder, *arguments: str) -> bool:
    """Whether a command that must do its work did it."""
    ended = place.run(arguments)
    if ended.code == 2:
        place.outcome.fail("wrong", f"morembs {' '.join(arguments)}: refused though right: {reason(ended.errors)}")
    return ended.code == 0


def refused(place: Folder, *arguments: str) -> None:
    """A command that must be refused."""
    if place.run(arguments).code == 0:
        place.outcome.fail("wrong", f"morembs {' '.join(arguments)}: taken though it must be refused")


def expect(place: Folder, holds: bool, words: str) -> None:
    if not holds:
        place.outcome.fail("wrong", words)


def write_model(place: Folder, K: np.ndarray, M: np.ndarray, **more: object) -> None:
    """The model file of matrices."""
    model_file.write_model(place.place / "part.model.h5", from_matrices(K, M, name="part", **more))


def judged(place: Folder, truth: Truth, **kinds: str) -> None:
    verdict = judge(
        place.place / "body.h5", truth, np.random.default_rng(1), exact=set(), tolerances={}, promised=kinds
    )
    place.outcome.proven, place.outcome.points = verdict.proven, verdict.points
    for sentence in verdict.wrong:
        place.outcome.fail("wrong", sentence)


def abstract(K: np.ndarray, M: np.ndarray, rows: tuple[int, ...]) -> Truth:
    """Coordinates without places, and the truth of direct interfaces at some."""
    model = Model(
        family="chain",
        support="clamped",
        K=K,
        M=M,
        xyz=np.zeros((len(K), 3)),
        node=np.arange(len(K)),
        component=np.zeros(len(K), int),
        free=0,
        nodes=False,
    )
    port = Port(name="end", nodes=np.array(rows), coupling="direct", point=np.zeros(3), components=(0,))
    return Truth(model, (port,), Damping())
