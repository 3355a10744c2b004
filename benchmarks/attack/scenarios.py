"""What is killed: every command, batches, jobs out of core, and the offline stage of large deflections."""

from __future__ import annotations

import itertools
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.attack import forked
from benchmarks.attack.forked import program

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT))

from tests.support import decks  # noqa: E402

# A part that takes some tenths of a second.
PART = tuple(itertools.product(range(6), range(1), range(1)))
STEEL = "young=210e3,poisson=0.3,density=7.85e-9"
OLD = b"an older result"
MOTION = "time," + ",".join(f"q{i}" for i in range(1, 17)) + "\n"


@dataclass(frozen=True)
class Scenario:
    """A run: inputs, what it does, what it writes. ``inputs`` fills a folder; it may take bodies of other runs.

    ``checkpoint``: an output that grows, and is only read, not compared. ``library``: it has no command line, so that
    SIGTERM ends it without further ado. ``cli`` are the arguments of a whole process that does the same.
    """

    inputs: Callable[[Path], None]
    work: Callable[[], object]
    outputs: tuple[str, ...] = ()
    checkpoint: str = ""
    library: bool = False
    cli: tuple[str, ...] = ()


def _verb(inputs: Callable[[Path], None], outputs: tuple[str, ...], *arguments: str) -> Scenario:
    return Scenario(inputs, program(arguments), outputs, cli=arguments)


def _deck(folder: Path) -> None:
    decks.folder(folder, text=decks.deck(PART))


def _jobs(tables: Mapping[str, Mapping[str, str]]) -> Callable[[Path], None]:
    """Jobs NAME.toml that write NAME.h5, with tables of their own."""

    def inputs(folder: Path) -> None:
        (folder / "part.inp").write_text(decks.deck(PART))
        for name, own in tables.items():
            output = f'path = "{name}.h5"' + own.get("picture", "")
            own = {key: text for key, text in own.items() if key != "picture"}
            (folder / f"{name}.toml").write_text(decks.job({**own, "output": output}))
        (folder / "scratch").mkdir()

    return inputs


CERTIFIED = {"certify": "band_hz = [0, 4000]\npoints = 3", "reduce2": 'name = "guyan"\nmethod = "guyan"', "stress": ""}
DRAWN = {**CERTIFIED, "picture": '\npicture = "drawn.png"'}


def _body(folder: Path) -> None:
    """A body file, made by a run of the program."""
    _jobs({"body": {"stress": ""}})(folder)
    ended = forked.run(program(["reduce", "body.toml", "-q"]), folder, folder / "logs")
    if ended.code:
        raise SystemExit(f"the body that others work with cannot be made: {ended.errors}")
    for path in (folder / "body.toml", folder / "part.inp"):
        path.unlink()
    for path in (folder / "logs", folder / "scratch"):
        shutil.rmtree(path)


def _motion(folder: Path) -> None:
    """A body and a motion of its 16 coordinates."""
    _body(folder)
    rows = [",".join([str(0.1 * k), *(f"{1e-6 * k * (i + 1)}" for i in range(16))]) for k in range(40)]
    (folder / "motion.csv").write_text(MOTION + "\n".join(rows) + "\n")


# A body that swings about its first end, and its moving mesh.
SYSTEM = """
simulation = { end = 0.02, step = 1e-4 }
gravity = { acceleration = [0, 0, -9.81] }
body = [{ name = "bar", file = "body.h5" }]
joint = [{ kind = "revolute", between = ["ground", "bar:left"], axis = [0, 1, 0] }]
observe = [{ body = "bar", path = "bar.vtkhdf", every = 10 }]
output = { path = "swing.h5" }
"""


def _system(folder: Path) -> None:
    """A body, and a system that it swings in."""
    _body(folder)
    (folder / "system.toml").write_text(SYSTEM)


def _spilled(folder: Path) -> None:
    """A job all of whose arrays and factors go to the scratch folder, however small they are."""
    from morembs.linalg.sparse.mumps import EmbeddedMumps

    key = "" if EmbeddedMumps.unavailable() else '\nname = "mumps-embedded"\nout_of_core = true'
    _jobs({"big": {"solver": f'memory = "4 GB"\nscratch = "scratch"{key}'}})(folder)


def offline(workers: int) -> Callable[[], None]:
    def work() -> None:
        from morembs.dynamics.gmp import ReducedMember
        from morembs.dynamics.gmp.stored import write_members
        from morembs.dynamics.nonlinear import PlanarBeam, Section

        section = Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770)
        beam = PlanarBeam.straight(0.304, 6, section)
        member = ReducedMember(beam, modes=2, reach=0.8, tolerance=2e-3, checkpoint="kept.h5", workers=workers)
        write_members("member.h5", {"rod": member.data})

    return work


def _nothing(folder: Path) -> None:
    """No inputs."""


_IMPORT = "import", "part.inp", "--units", "mm-t-s", "--material", STEEL, "-o", "part.model.h5"
SCENARIOS: dict[str, Scenario] = {
    "import": _verb(_deck, ("part.model.h5",), *_IMPORT, "--check"),
    "check": _verb(_deck, (), "check", "job.toml"),
    "reduce": _verb(_jobs({"one": CERTIFIED}), ("one.h5",), "reduce", "one.toml"),
    "draw": _verb(_jobs({"one": DRAWN}), ("one.h5", "drawn.png"), "reduce", "one.toml"),
    "compare": _verb(
        _jobs({"one": CERTIFIED}), ("one.h5", "compared.png"), "compare", "one.toml", "--picture", "compared.png"
    ),
    "export": _verb(
        _body, tuple(f"out_{role}.mtx" for role in "MKB"), "export", "body.h5", "--to", "matrix-market", "-o", "out.mtx"
    ),
    "recover": _verb(_motion, ("motion.vtkhdf",), "recover", "body.h5", "motion.csv", "-o", "motion.vtkhdf"),
    "simulate": _verb(_system, ("swing.h5", "bar.vtkhdf"), "simulate", "system.toml"),
    "info": _verb(_body, (), "info", "body.h5"),
    "batch": _verb(
        _jobs({"a": {}, "b": {"stress": ""}, "c": {"reduce": 'method = "guyan"'}}),
        ("a.h5", "b.h5", "c.h5"),
        "reduce",
        "a.toml",
        "b.toml",
        "c.toml",
    ),
    "beside": replace(
        _verb(
            _jobs({"a": {}, "b": {"stress": ""}, "c": {"reduce": 'method = "guyan"'}}),
            ("a.h5", "b.h5", "c.h5"),
            "batch",
            "a.toml",
            "b.toml",
            "c.toml",
        ),
        checkpoint="batch.manifest",
    ),
    "out-of-core": _verb(_spilled, ("big.h5",), "reduce", "big.toml", "-q"),
    "gmp": Scenario(_nothing, offline(1), ("member.h5",), "kept.h5", library=True),
    "gmp-pool": Scenario(_nothing, offline(2), ("member.h5",), "kept.h5", library=True),
}
# Parts of all trials; the other kinds share what is left.
SHARES = {
    "out-of-core": 0.1,
    "batch": 0.1,
    "gmp": 0.07,
    "gmp-pool": 0.03,
    "draw": 0.05,
    "compare": 0.05,
    "beside": 0.02,
}
