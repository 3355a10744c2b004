"""Writes tests/data/public_api.json: what a program beside morembs may rely on (docs/reference/stability.md).

    python scripts/public_api.py [--check]

With --check nothing is written; each difference is printed, and the exit code is 1 where there is one. What is gone or
another breaks programs of users, and waits for the next major version; what joins may come in a minor one.
"""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import typer
from typer.testing import CliRunner

from morembs.app.batches.manifest import ManifestFormat
from morembs.app.cli.commands import app
from morembs.app.cli.models import import_command
from morembs.app.jobs.job import job_tables
from morembs.app.pages.kept import ReportFormat
from morembs.app.simulations.result_file import ResultVersion
from morembs.app.simulations.tables import SystemTables
from morembs.base.arguments import hints_of
from morembs.base.errors import ExitCode
from morembs.base.key_tables import Table, inner_table
from morembs.body.stored import FormatVersion
from morembs.dynamics.gmp.checkpoint import EquilibriaFormat
from morembs.dynamics.gmp.stored import MemberFormat
from morembs.exporters import EXPORTERS
from morembs.fem.interface import COUPLINGS
from morembs.importers import IMPORTERS
from morembs.importers.native import Version as ModelVersion
from morembs.linalg.sparse.select import SOLVERS
from morembs.reducers import REDUCERS
from scripts.schema import SHOWN, left_out, lines

RECORDED = Path(__file__).resolve().parents[1] / "tests" / "data" / "public_api.json"
# Modules whose __all__ is documented whole, and names of others that docs/howto/extending.md has plug-ins take.
MODULES = (
    "morembs",
    "morembs.dynamics.gmp",
    "morembs.dynamics.multibody",
    "morembs.dynamics.nonlinear",
    "morembs.examples",
    "morembs.exporters",
)
NAMES = {
    "morembs.app.jobs.job": ("load_job",),
    "morembs.app.jobs.run": ("run_job",),
    "morembs.body.file": ("read_body",),
    "morembs.dynamics.gmp.stored": ("read_members",),
    "morembs.exporters.base": ("Exported", "Exporter"),
    "morembs.exporters.exudyn_system": ("ExudynBody", "ExudynSystem"),
    "morembs.fem.interface": ("COUPLINGS", "CouplingKind", "Elimination"),
    "morembs.importers": ("Importer", "import_file"),
    "morembs.importers.model_file": ("read_model", "write_model"),
    "morembs.linalg.sparse.session": ("FactorSize", "Session", "SessionSolver"),
    "morembs.linalg.sparse.solver": ("STRUCTURES",),
    "morembs.reducers": ("REDUCERS",),
    "morembs.reducers.base": ("Reducer", "elastic_basis"),
    "morembs.storage.checksums": ("seal",),
    "morembs.storage.safefile": ("replacing_all",),
}
# Reductions and further tables, one of them for each command, of the model of the example.
BODY = '[[reduce]]\nmethod = "craig-bampton"\nmodes = 4\n'
ADDED = {
    "part": BODY + "[certify]\nband_hz = [0, 500]\nwitness = true\n[modes]\ncount = 4\n",
    "rotor": BODY + '[spin]\naxis = [0, 0, 1]\nspeed = [0, 100]\nheld = ["BOLTS"]\n',
    "design": '[[parameter]]\nname = "E"\nproperty = "young"\nset = "all"\nrange = [2e5, 2.2e5]\n'
    '[[reduce]]\nmethod = "parametric"\nband_hz = [0, 500]\ntolerance = 0.1\n',
}
COMMANDS = """
check part.toml
reduce part.toml
compare part.toml
info part.h5
certify part.h5 --model part.model.h5 --witness w.h5
export part.h5 --to sid
modes part.toml
solvers
recover part.h5 motion.csv -o motion.vtkhdf --no-stress
import --stiffness K.mtx --mass M.mtx -o m.model.h5
reduce rotor.toml
campbell rotor.toml -o c.csv --points 3
reduce design.toml
evaluate design.h5 --at E=2.1e11
update design.h5 --measured measured.csv
check system.toml
simulate system.toml
batch jobs
"""
# Mappings of JSON documents whose keys are names of a user, a stage or a method; their values are alike.
BY_NAME = {"bodies", "interface_nodes", "interfaces", "largest_reactions", "reduction_seconds"}
# Mappings that are free to change, or that hold numbers by name.
OPEN = {"at", "complete", "inputs", "numbers", "peak_memory_bytes", "recipe", "seconds", "values"}


def names() -> dict[str, dict[str, str]]:
    """Public names of each module, with the arguments of what can be called."""
    whole = {name: importlib.import_module(name).__all__ for name in MODULES}
    return {
        module: {name: called(getattr(importlib.import_module(module), name)) for name in sorted(held)}
        for module, held in sorted({**whole, **NAMES}.items())
    }


def called(value: object) -> str:
    """Arguments of a function or class, ``=`` behind those that may be left out; "" for another value."""
    if not callable(value) or (isinstance(value, type) and issubclass(value, BaseException)):
        return ""
    parts, by_keyword = [], False
    with contextlib.suppress(ValueError):
        for one in inspect.signature(value).parameters.values():
            if one.kind is one.KEYWORD_ONLY and not by_keyword:
                parts.append("*")
                by_keyword = True
            star = {one.VAR_POSITIONAL: "*", one.VAR_KEYWORD: "**"}.get(one.kind, "")
            by_keyword |= star == "*"
            parts.append(star + one.name + ("" if one.default is one.empty else "="))
    return f"({', '.join(parts)})"


def keys(tables: type[Table]) -> dict[str, str]:
    """Keys of a file, with what they are where they are left out."""

    def of(kind: type[Table], at: str, within: tuple[type, ...]) -> Iterator[tuple[str, str]]:
        hints = hints_of(kind)
        for field in fields(kind):
            inner = inner_table(hints[field.name])
            yield f"{at}{field.name}", left_out(field)
            if inner is not None and inner not in within:
                yield from of(inner, f"{at}{field.name}.", (*within, inner))

    return {
        f"{table}.{key}": value
        for table, hint in hints_of(tables).items()
        if (kind := inner_table(hint)) is not None
        for key, value in of(kind, "", (kind,))
    }


def files() -> dict[str, Any]:
    """Versions of the formats, and datasets of those in HDF5."""
    datasets = {
        name: sorted(line.split("`")[1] for at, table in parts for line in lines(at, table))
        for name, parts in SHOWN.items()
    }
    versions = {
        "morembs-body": FormatVersion.LATEST,
        "morembs-model": max(ModelVersion),
        "morembs-simulation": ResultVersion.LATEST,
        ManifestFormat.NAME: ManifestFormat.VERSION,
        ReportFormat.NAME: ReportFormat.VERSION,
        MemberFormat.NAME: MemberFormat.VERSION,
        EquilibriaFormat.NAME: EquilibriaFormat.VERSION,
    }
    return {"newest versions": versions, "datasets": datasets}


def commands() -> dict[str, list[str]]:
    """Options of each command."""
    shown = {**typer.main.get_command(app).commands, "import": import_command()}  # type: ignore[attr-defined]
    return {
        name: sorted(option for one in command.params for option in one.opts) for name, command in sorted(shown.items())
    }


def paths(value: Any, at: str = "") -> Iterator[str]:
    """Keys of a JSON document, as a.b[].c."""
    if isinstance(value, list):
        for inner in value:
            yield from paths(inner, f"{at}[]")
    if isinstance(value, Mapping):
        by_name = at.rpartition(".")[2] in BY_NAME
        for key, inner in value.items():
            place = f"{at}.{'NAME' if by_name else key}"
            yield place
            if key not in OPEN:
                yield from paths(inner, place)


def documents() -> dict[str, list[str]]:
    """Keys of what each command prints with --json."""
    told: dict[str, set[str]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for example in ("bracket", "matrices"):
            command(folder, "init", "--example", example)
        model = (folder / "bracket.toml").read_text(encoding="utf-8").partition("[[reduce]]")[0]
        for name, tables in ADDED.items():
            (folder / f"{name}.toml").write_text(f'{model}{tables}[output]\npath = "{name}.h5"\n', encoding="utf-8")
        for line in COMMANDS.strip().splitlines():
            prepare(folder, line)
            said = json.loads(command(folder, *line.split(), "--json"))
            told.setdefault(line.split()[0], set()).update(paths(said))
    return {name: sorted(keys) for name, keys in sorted(told.items())}


def prepare(folder: Path, line: str) -> None:
    """Write the files that a command needs beside those of the commands before."""
    if line.startswith("recover"):
        import h5py

        with h5py.File(folder / "part.h5") as file:
            (body,) = file["bodies"].values()
            count = body["mass_matrix"].shape[0]
        head = ",".join(["time", *(f"q{number + 1}" for number in range(count))])
        rows = "\n".join(f"{time}" + ",0" * count for time in (0.0, 0.1))
        (folder / "motion.csv").write_text(f"{head}\n{rows}\n", encoding="utf-8")
    elif line.startswith("update"):
        (folder / "measured.csv").write_text("mode,frequency_hz\n1,1000\n", encoding="utf-8")
    elif line == "check system.toml":
        command(folder, "init", "part.h5", "-o", "system.toml")
    elif line.startswith("batch"):
        (folder / "jobs").mkdir()
        for name in ("bracket.msh", "rotor.toml"):
            (folder / name).rename(folder / "jobs" / name)


def command(folder: Path, *arguments: str) -> str:
    """What a command prints on standard output."""
    with contextlib.chdir(folder):
        ended = CliRunner().invoke(app, arguments)
    if ended.exit_code:
        raise SystemExit(f"morembs {' '.join(arguments)} ended with {ended.exit_code}:\n{ended.stderr}")
    return ended.stdout


def reducers() -> dict[str, dict[str, str]]:
    """Keys of each method, with what they are where they are left out."""
    return {name: {one.name: left_out(one) for one in fields(REDUCERS[name])} for name in sorted(REDUCERS.own)}


def tables() -> dict[str, list[str]]:
    """Names that each table of plug-ins has of its own."""
    held = {"couplings": COUPLINGS, "exporters": EXPORTERS, "importers": IMPORTERS, "solvers": SOLVERS}
    return {name: sorted(table.own) for name, table in held.items()}


def exit_codes() -> dict[str, int]:
    """Exit code of each end of a command."""
    ends = {"done": ExitCode.DONE, "fault": ExitCode.FAULT, "bad input": ExitCode.BAD_INPUT}
    signals = {"hung up": getattr(signal, "SIGHUP", 1), "interrupted": signal.SIGINT, "terminated": signal.SIGTERM}
    return ends | {name: ExitCode.of_signal(number) for name, number in signals.items()}


PARTS: dict[str, Callable[[], Any]] = {
    "python": names,
    "commands": commands,
    "exit codes": exit_codes,
    "job keys": lambda: keys(job_tables()),
    "system keys": lambda: keys(SystemTables),
    "reducers": reducers,
    "tables": tables,
    "files": files,
    "json": documents,
}


def differences(recorded: Any, now: Any, at: str = "") -> Iterator[str]:
    """A line for each that is gone, another or new."""
    if isinstance(recorded, Mapping) and isinstance(now, Mapping):
        for key in recorded.keys() | now.keys():
            place = f"{at}: {key}" if at else key
            if key not in now:
                yield f"gone: {place}"
            elif key not in recorded:
                yield f"new: {place}"
            else:
                yield from differences(recorded[key], now[key], place)
    elif isinstance(recorded, list) and isinstance(now, list):
        yield from (f"gone: {at}: {one}" for one in recorded if one not in now)
        yield from (f"new: {at}: {one}" for one in now if one not in recorded)
    elif recorded != now:
        yield f"changed: {at}: {recorded} is now {now}"


def main() -> int:
    """Write the file, or with --check say what differs."""
    now = {name: part() for name, part in PARTS.items()}
    recorded = json.loads(RECORDED.read_text(encoding="utf-8")) if RECORDED.is_file() else {}
    found = sorted(differences(recorded, now))
    print(*found, sep="\n")
    if "--check" in sys.argv[1:]:
        return int(bool(found))
    RECORDED.write_text(json.dumps(now, indent=1, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
