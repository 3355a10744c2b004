"""Case about starting: processor time and memory of short commands and of a small job, beside those of importing what
they cannot do without."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from measure import ROOT, Report, Row, Settings, in_rounds, ratios, required

BARE, LIBRARIES = "python", "import numpy, scipy.sparse, h5py"
_COLUMNS = (("cpu_seconds", "processor s", "s"), ("process_peak_bytes", "peak MB", "MB"))
MESH = ROOT / "data" / "small_meshes" / "bracket.msh"
# Starts are short: the median of a few more of them than of other cases.
STARTS = 5


def startup(settings: Settings) -> None:
    """--version, --help and info of a small body file; the target of info is 1.3 times the libraries."""
    body = settings.folder / "startup.h5"
    required("startup", settings, file=str(body))
    job = _job(settings.folder / "bracket.toml")
    commands = {
        BARE: ["-c", "pass"],
        LIBRARIES: ["-c", LIBRARIES],
        "morembs --version": ["-m", "morembs", "--version"],
        "morembs --help": ["-m", "morembs", "--help"],
        "morembs info": ["-m", "morembs", "info", str(body)],
        "morembs info --json": ["-m", "morembs", "info", "--json", str(body)],
        "morembs reduce": ["-m", "morembs", "reduce", "--quiet", str(job)],
    }
    measures = {name: _measure([sys.executable, *arguments]) for name, arguments in commands.items()}
    rounds = in_rounds(measures, settings.repeat if settings.quick else max(settings.repeat, STARTS))
    report = Report("startup", settings)
    report.add(rounds)
    report.table("startup: whole processes", _COLUMNS)
    for name in list(commands)[2:]:
        report.compare(f"{name} over {LIBRARIES}", ratios(rounds, (name, "cpu_seconds"), (LIBRARIES, "cpu_seconds")))
    report.write()


def bar_body(path: Path, modes: int) -> Path:
    """A body file of one reduction: a steel bar with an interface at each end; called in a child."""
    import numpy as np
    from models import box

    from morembs import CraigBampton, Problem, elastic_body, isotropic, make_interface, make_part, write_body
    from morembs.fem import ElementBlock, Mesh, Nodes
    from morembs.fem.assembly import assemble

    points, cells = box((0.5, 0.05, 0.03), (6, 1, 1))
    nodes = Nodes(ids=np.arange(1, len(points) + 1), xyz=points)
    block = ElementBlock(type="tet10", nodes=cells, ids=np.arange(1, len(cells) + 1))
    steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    model = assemble(Mesh(nodes=nodes, blocks=(block,)), [steel])
    ends = {name: np.flatnonzero(np.isclose(points[:, 0], x)) for name, x in (("left", 0.0), ("right", 0.5))}
    interfaces = [make_interface(model, name=name, nodes=rows) for name, rows in ends.items()]
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=modes).reduce(problem, "cb")
        return write_body(path, [elastic_body(problem, reduced, make_part(problem))])


def _job(path: Path) -> Path:
    """The first job of a bracket with 844 nodes, as ``morembs init`` writes it."""
    if not path.exists():
        subprocess.run(
            [sys.executable, "-m", "morembs", "init", str(MESH), "--units", "mm-t-s", "-o", str(path)],
            stdout=subprocess.DEVNULL,
            check=True,
        )
    return path


def _measure(command: Sequence[str]) -> Callable[[], Row]:
    def measure() -> Row:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, command)
        unit = 1 if sys.platform == "darwin" else 1024
        return {"cpu_seconds": used.ru_utime + used.ru_stime, "process_peak_bytes": used.ru_maxrss * unit}

    return measure


CASES = {"startup": startup}
