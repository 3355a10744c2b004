"""Case about the time that "morembs check" tells of a job, against what "morembs reduce" then takes.

The jobs are examples of "morembs init", jobs of pipelines/ and bodies of models.py: every method, from a thousand to a
hundred thousand degrees of freedom.
"""

from __future__ import annotations

import gzip
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jobs import checked
from measure import ROOT, Report, Row, Settings, command, in_rounds, required, run

_MESHES = ROOT / "data" / "small_meshes"
_AUTO = 'method = "auto"\nband_hz = [0, 3000]\ntolerance = 1e-3\n'
_DAMPED = "[damping]\nmodal = 0.01\n"
_CERTIFIED = _DAMPED + "[certify]\nband_hz = [0, 3000]\n"
_VARIED = (
    '[[parameter]]\nname = "E"\nproperty = "young"\nset = "{}"\nrange = [180e3, 240e3]\n'
    '[[parameter]]\nname = "rho"\nproperty = "density"\nrange = [7.0e-9, 8.5e-9]\n'
)
_PRELOAD = "[preload]\nspeed = 20.0\naxis = [0, 0, 1]\n"
_SPIN = '[spin]\nspeed = [0, 20, 40]\naxis = [1, 0, 0]\nheld = ["{}"]\n'
# The factor of the forecast that is wanted, and of how many jobs of ten.
WANTED, OF_TEN = 2.0, 9


@dataclass(frozen=True)
class Asked:
    """A job: an example or a shape of models.py with its dofs, the keys of its reduction (None: as the example has
    it), and further tables."""

    source: str
    dofs: int = 0
    reduction: str | None = None
    more: str = ""


JOBS: dict[str, Asked] = {
    "rod, as init writes it": Asked("rod"),
    "bracket, as init writes it": Asked("bracket"),
    "deck, as init writes it": Asked("deck"),
    "matrices, as init writes them": Asked("matrices"),
    "connecting rod of the demo": Asked("connecting_rod.toml"),
    "flexible pendulum, a member": Asked("flexible_pendulum.toml"),
    "rod, auto": Asked("rod", reduction=_AUTO, more=_DAMPED),
    "rod, gramian": Asked("rod", reduction='method = "gramian"\nband_hz = [0, 3000]\norder = 30\n'),
    "rod, krylov": Asked("rod", reduction='method = "krylov"\norder = 30\n'),
    "bracket, certified with a witness": Asked("bracket", more=_CERTIFIED + "witness = true\n"),
    "bracket, stress and stiffening": Asked("bracket", more="[stress]\n[stiffening]\n"),
    "bracket, parametric": Asked(
        "bracket",
        reduction='method = "parametric"\nband_hz = [0, 3000]\ntolerance = 1e-2\n',
        more=_VARIED.format("LUG"),
    ),
    "cube, craig-bampton": Asked("cube", 20_000),
    "cube, auto": Asked("cube", 20_000, _AUTO, _DAMPED),
    "crankshaft, craig-bampton": Asked("crankshaft", 60_000),
    "crankshaft, certified": Asked("crankshaft", 20_000, more=_CERTIFIED),
    "crankshaft, krylov": Asked("crankshaft", 60_000, 'method = "krylov"\norder = 60\n'),
    "crankshaft, gramian": Asked("crankshaft", 20_000, 'method = "gramian"\nband_hz = [0, 3000]\norder = 40\n'),
    "crankshaft, auto": Asked("crankshaft", 60_000, _AUTO, _DAMPED),
    "beam, 150 modes": Asked("beam", 30_000, 'method = "modal"\nmodes = 150\n'),
    "beam, a response": Asked("beam", 30_000, more="[response]\nfrom_hz = 10\nto_hz = 3000\n"),
    "beam, guyan": Asked("beam", 10_000, 'method = "guyan"\n'),
    "beam, up to 10 kHz": Asked("beam", 30_000, 'method = "craig-bampton"\nup_to_hz = 10000\n'),
    "cube, free-interface": Asked("cube", 100_000, 'method = "free-interface"\nmodes = 40\n'),
    "rod, preloaded": Asked("rod", more=_PRELOAD),
    "beam, preloaded": Asked("beam", 30_000, more=_PRELOAD),
    "rod, spinning": Asked("rod", more=_SPIN.format("BIGEND")),
    "crankshaft, spinning": Asked("crankshaft", 20_000, more=_SPIN.format("nose")),
    "crankshaft, effective masses": Asked("crankshaft", 20_000, more='[effective_mass]\npath = "masses.csv"\n'),
}
QUICK = ("bracket, as init writes it", "cube, craig-bampton")


def written(asked: Asked, settings: Settings) -> Path:
    """Path of a job, in a folder of its own: it is written anew each time, its mesh is not."""
    folder = settings.folder / "forecast-time"
    if asked.source.endswith(".toml"):
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "pipelines" / asked.source, folder)
        if asked.source == "connecting_rod.toml":
            packed = gzip.decompress((_MESHES / "connecting_rod.msh.gz").read_bytes())
            (folder / "connecting_rod.msh").write_bytes(packed)
        return folder / asked.source
    if asked.dofs:
        folder /= f"{asked.source}_{asked.dofs}"
        job = required("job", settings, shape=asked.source, dofs=asked.dofs, to=str(folder))
        path = Path(job["job"])
    else:
        path = folder / asked.source / f"{asked.source}.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            ended = run(command("init", "--example", asked.source, "--out", path), settings)
            if ended.code:
                raise RuntimeError(ended.last_error())
    text = path.read_text(encoding="utf-8")
    if asked.reduction is not None:
        text = re.sub(r"(?ms)^(\[\[reduce\]\][^\n]*\n).*?(?=^#? ?\[|\Z)", rf"\1{asked.reduction}\n", text, count=1)
    changed = path.with_name("asked.toml")
    changed.write_text(f"{text}\n{asked.more}", encoding="utf-8")
    return changed


def forecast_time(settings: Settings) -> None:
    """The seconds that "morembs check" tells against processor seconds of "morembs reduce": others may work beside.
    Each row is written when it is there, and is not measured again to ``resume``.

    On one thread (``--threads 1``) both are those of a clock where nobody does.
    """
    report = Report("forecast-time", settings)
    if settings.resume:
        report.resume()
    for name, asked in JOBS.items():
        if name in report.rows or (settings.quick and name not in QUICK):
            continue
        job = written(asked, settings)
        plan = checked(job, settings)
        report.add(in_rounds({name: lambda plan=plan, job=job: compared(plan, job, settings)}, settings.repeat))
        report.write()
    report.table(
        "forecast of the time of whole jobs",
        [
            ("dofs", "dofs", "n"),
            ("forecast_seconds", "forecast s", "s"),
            ("seconds", "job s", "s"),
            ("processor", "job, processor s", "s"),
            ("ratio", "ratio", "x"),
        ],
    )
    ratios = [row["ratio"] for row in report.rows.values() if "ratio" in row]
    report.compare("forecast over processor seconds of the job", ratios)
    good = sum(1 / WANTED <= ratio <= WANTED for ratio in ratios)
    print(f"within a factor of {WANTED:g}: {good} of {len(ratios)} jobs ({OF_TEN} of 10 wanted)")
    report.write()


def compared(plan: Row, job: Path, settings: Settings) -> Row:
    """A job against its forecast."""
    if "error" in plan:
        return plan
    ended = run(command("reduce", job, "--json"), settings)
    if ended.code:
        return {"error": ended.last_error().replace(str(settings.folder), "FOLDER")}
    (document,) = json.loads(ended.output)
    told = sum(plan["seconds"].values())
    return {
        "dofs": plan["dofs"],
        "seconds": ended.seconds,
        "processor": ended.processor,
        "forecast_seconds": told,
        "ratio": told / ended.processor,
        "forecast": plan["seconds"],
        "stages": document["seconds"],
    }


CASES: dict[str, Callable[[Settings], None]] = {"forecast-time": forecast_time}
