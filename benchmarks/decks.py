"""What own assembly and the engines make of all decks of folders, beside the frequencies of the deck's own program.

    python -m benchmarks.decks FOLDER... [--rows 4000] [--only NAME ...] [--without WAY ...]
    python -m benchmarks.decks --count 20 --seed 1 --json scratch.json

Each deck goes through own assembly, CalculiX, MYSTRAN and ``auto``, with the cures that their messages name. The first
frequencies of each free model are compared with those of ccx (of MYSTRAN for Nastran decks) for the deck itself. A deck
that its program computes and a way refuses is a failure, listed with its reason; so is a model whose frequencies differ
by more than 1e-6 without a warning that has a code. Figures of all go to benchmarks/results/decks.json. A sample
(``--count``, drawn by ``--seed``) fails where a deck has failures that these figures do not have.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from benchmarks.deck_programs import (
    COMPARED,
    DENSITY,
    HELD,
    Holds,
    decks_of,
    difference,
    holds,
    of_ccx,
    of_held_ccx,
    of_mystran,
    spectrum_of,
    unpacked,
)
from morembs.app.jobs.import_job import read_files_model
from morembs.base.errors import InputError, MorembsError
from morembs.fem import FEModel, rigid_motion
from morembs.fem.material import Material, isotropic
from morembs.importers.decks.problems import DeckError, Form
from morembs.importers.options import read_import_options

RESULTS = Path(__file__).parent / "results" / "decks.json"
# The decks that Debian's package calculix-ccx-test brings.
EXAMPLES = Path("/usr/share/doc/calculix-ccx-test/examples/test")
SAME, RIGID, SECONDS, ROUNDS = 1e-6, 1e-9, 300, 6
# The engine of each way, and the formats that it is for.
WAYS: dict[str, tuple[str | None, tuple[str, ...]]] = {
    "own": (None, ("abaqus", "nastran", "ansys")),
    "calculix": ("calculix", ("abaqus",)),
    "mystran": ("mystran", ("nastran",)),
    "auto": ("auto", ("abaqus", "nastran", "ansys")),
    # With what *BOUNDARY holds, beside the frequencies that ccx prints.
    "held": ("calculix", ("abaqus",)),
}
_FLAG = re.compile(r"--(density|contact|skip|material|format|pretension)(?: \"[^\"]+\"| '[^']+'| [^\s;\"']+)?")
# Elements with stiffness: a model without them is another one, so that skipping them is no cure.
_CARRIES = re.compile(
    r"^(C3D|S\d|STRI|SC\d|B3\d|M3D|T3D|CHEXA|CPENTA|CTETRA|CQUAD|CTRIA|CBAR|CBEAM|CROD|CONROD|CTUBE|CSHEAR)"
)
_CODE = re.compile(r"\[([a-z0-9-]+)\]")


@dataclass
class Cures:
    """Options that the messages of a deck name, gathered until it comes in."""

    format: str | None = None
    density: dict[str, float] = field(default_factory=dict)
    contact: str = "refuse"
    skip: list[str] = field(default_factory=list)
    pretension: str = "auto"
    materials: dict[str, Material] = field(default_factory=dict)

    def learn(self, error: MorembsError) -> bool:
        """Take up what a message names; whether that is anything new."""
        before = repr(self)
        if isinstance(error, DeckError) and all(problem.flags for problem in error.problems):
            flags = [flag for problem in error.problems for flag in problem.flags]
        else:
            # In prose the name of a set may go on behind a blank.
            flags = [re.sub(r",set=.*", "", found[0]) for found in _FLAG.finditer(str(error))]
        named = [(name, value.strip("'\"")) for name, _, value in (flag[2:].partition(" ") for flag in flags)]
        # A message that names both leaves the choice; a density leaves the deck its own stiffness.
        other = "material" if not self.density and any(name == "density" for name, _ in named) else ""
        for name, value in named:
            if name != other:
                self._take(name, value)
        return repr(self) != before

    def _take(self, name: str, value: str) -> None:
        if name == "density":
            self.density = {"all": DENSITY}
        elif name == "contact":
            self.contact = "skip"
        elif name == "skip" and not _CARRIES.match(value):
            self.skip += [word for word in value.split(",") if word not in self.skip]
        elif name == "material":
            owner = value.partition("set=")[2] or "all"
            self.materials[owner] = isotropic(set=owner, young=2.1e5, poisson=0.3, density=DENSITY)
        elif name == "format":
            self.format = value
        elif name == "pretension":
            # As ccx has it; own assembly offers both.
            self.pretension = "cut"

    @property
    def words(self) -> list[str]:
        """The options by name."""
        bolts = self.pretension != "auto"
        given = {"density": self.density, "contact skip": self.contact != "refuse", "format": self.format}
        given |= {f"pretension {self.pretension}": bolts}
        return [
            *(name for name, value in given.items() if value),
            *(f"skip {word}" for word in self.skip),
            *(f"material of {name}" for name in self.materials),
        ]


@contextmanager
def _limited(seconds: int) -> Iterator[None]:
    """End what takes longer by an error."""

    def late(number: int, frame: FrameType | None) -> None:
        raise InputError(f"it took more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def imported(path: Path, format: str, engine: str | None, boundary: str = "drop") -> tuple[FEModel | str, list[str]]:
    """The model of a deck, or why there is none; with the cures that were taken."""
    cures = Cures(format=None if format == "abaqus" and path.suffix == ".inp" else format)
    for _ in range(ROUNDS):
        try:
            options = read_import_options(
                file=path,
                format=cures.format,
                density=cures.density or None,
                contact=cures.contact,
                skip=cures.skip,
                pretension=cures.pretension,
                engine=engine,
                boundary=boundary,
                dialect="calculix" if format == "abaqus" and engine != "calculix" else "auto",
            )
            return read_files_model(options, tuple(cures.materials.values()), Form()), cures.words
        except MorembsError as error:
            reason = str(error)
            if not cures.learn(error):
                break
    return reason, cures.words


def examine(path: Path, rows: int, ways: Sequence[str]) -> dict[str, Any]:
    """Figures of one deck: of each way, and of the deck's own program."""
    held = holds(path)
    result: dict[str, Any] = {"deck": path.name, **vars(held), "ways": {}}
    models: dict[str, FEModel] = {}
    for name in ways:
        engine, formats = WAYS[name]
        if held.format not in formats:
            continue
        start = time.perf_counter()
        with _limited(SECONDS):
            try:
                model, cures = imported(path, held.format, engine, "keep" if name == "held" else "drop")
            except Exception as error:  # a traceback is a finding, too
                model, cures = f"{type(error).__name__}: {error}", []
        row: dict[str, Any] = {"taken": not isinstance(model, str), "cures": cures}
        row["seconds"] = round(time.perf_counter() - start, 2)
        if isinstance(model, str):
            row["reason"] = model[:300]
        else:
            models[name] = model
            row |= {"rows": model.size, "codes": sorted(set(_CODE.findall(" ".join(model.warnings))))} | _rigid(model)
        result["ways"][name] = row
    with _limited(SECONDS):
        _compare(path, held, models, result, rows)
    return result


def _rigid(model: FEModel) -> dict[str, float]:
    """Mass, and K R of what cancels in it."""
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    terms = float((abs(model.K) @ np.abs(R)).max())
    return {
        "mass": float(R[:, 0] @ (model.M @ R[:, 0])),
        "rigid": float(np.abs(model.K @ R).max()) / max(terms, 1e-300),
    }


def _compare(path: Path, held: Holds, models: dict[str, FEModel], result: dict[str, Any], rows: int) -> None:
    """Frequencies of the models and of the program of the deck."""
    program = {"abaqus": of_ccx, "nastran": of_mystran}.get(held.format)
    if program is None or max((model.size for model in models.values()), default=0) > rows:
        result["program"] = "not run"
        return
    try:
        wanted = program(path)
    except (MorembsError, OSError, ValueError) as error:
        result["program"] = str(error)[:300]
        return
    result |= {"program": "computes", "frequencies": wanted.frequencies}
    for name, model in models.items():
        with suppress(MorembsError, OSError):
            found = spectrum_of(model)
            own = of_held_ccx(path) if name == "held" else wanted
            if name != "held" or found.values[0] > HELD * found.values[: 2 * COMPARED].max():
                row = {"difference": difference(found, own)}
                apart = {"frequencies": found.frequencies} if row["difference"] > SAME else {}
                result["ways"][name] |= row | apart


def failures(result: dict[str, Any]) -> list[str]:
    """What is wrong with a deck: its program computes it and a way refuses it, or differs from it without a word."""
    found = []
    for name, row in result["ways"].items():
        if not row["taken"] and result["program"] == "computes" and name != "held":
            found.append(f"{name} refuses: {row['reason']}")
        elif row.get("difference", 0.0) > SAME and not row["codes"]:
            found.append(f"{name} differs by {row['difference']:.1e} without a warning")
    return found


def _kinds(result: dict[str, Any]) -> list[str]:
    """Failures of a deck without their figures and reasons."""
    return [" ".join(words.replace(":", "").split()[:2]) for words in failures(result)] if result["structure"] else []


def table(results: Sequence[dict[str, Any]]) -> str:
    """Counts of each way: decks by what they hold, frequencies by what they are."""
    lines = []
    for format in dict.fromkeys(result["format"] for result in results):
        own = [result for result in results if result["format"] == format and result["structure"]]
        lines.append(f"\n{format}: {len(own)} structures, {sum(r['solids'] for r in own)} of solids alone")
        lines.append(
            "way       structures       complete         solids           same   told  silent  refused, computed"
        )
        for name in WAYS:
            mine = [result for result in own if name in result["ways"]]
            if mine:
                lines.append(f"{name:9} " + _counts(mine, name))
        both = [r["ways"] for r in own if all("mass" in r["ways"].get(way, {}) for way in ("own", "calculix"))]
        if both:
            masses = [abs(way["own"]["mass"] / way["calculix"]["mass"] - 1) for way in both]
            lines.append(
                f"mass of own assembly and of CalculiX: {sum(m <= SAME for m in masses)} of {len(both)} the same"
            )
        for way in WAYS:
            strains = [r["ways"][way]["rigid"] for r in own if "rigid" in r["ways"].get(way, {})]
            if strains and way != "held":
                few = sum(value <= RIGID for value in strains)
                lines.append(f"K R of {way}: {few} of {len(strains)} below {RIGID:g} of its terms")
    return "\n".join(lines)


def _counts(results: Sequence[dict[str, Any]], name: str) -> str:
    words = []
    for which in ("structure", "complete", "solids"):
        of = [result["ways"][name]["taken"] for result in results if result[which]]
        words.append(f"{sum(of):4} of {len(of):3} {100 * sum(of) / max(len(of), 1):3.0f} %")
    rows = [result["ways"][name] for result in results]
    apart = [row for row in rows if "difference" in row]
    same = sum(row["difference"] <= SAME for row in apart)
    told = sum(row["difference"] > SAME and bool(row["codes"]) for row in apart)
    refused = sum(not result["ways"][name]["taken"] and result["program"] == "computes" for result in results)
    return "  ".join(words) + f"  {same:4}   {told:4}  {len(apart) - same - told:6}  {refused:6}"


def reasons(results: Sequence[dict[str, Any]]) -> str:
    """Refusals by kind and way, the most frequent first, with one deck each."""
    kinds: Counter[tuple[str, str]] = Counter()
    example: dict[tuple[str, str], str] = {}
    for result in results:
        for name, row in result["ways"].items():
            if not row["taken"] and result["structure"]:
                plain = re.sub(r"'[^']*'|\d+(\.\d*)?(e[-+]?\d+)?", "#", row["reason"].replace(result["deck"], "DECK"))
                kinds[name, plain[:110]] += 1
                example.setdefault((name, plain[:110]), result["deck"])
    return "\n".join(
        f"{count:4} {name}: {kind} ({example[name, kind]})" for (name, kind), count in kinds.most_common(40)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Examine all decks; 1 where there are failures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*", default=[EXAMPLES])
    parser.add_argument("--rows", type=int, default=4000, help="of models whose frequencies are compared")
    parser.add_argument("--megabytes", type=float, default=2.0, help="of a deck at most")
    parser.add_argument("--only", nargs="*", default=[], help="names of decks")
    parser.add_argument("--without", nargs="*", default=[], choices=WAYS, help="ways to leave out")
    parser.add_argument("--count", type=int, help="decks that are drawn; all without it")
    parser.add_argument("--seed", type=int, default=1, help="of the decks that are drawn (1)")
    parser.add_argument("--json", type=Path, default=RESULTS)
    given = parser.parse_args(arguments)
    if given.count and given.json == RESULTS:
        parser.error("--count leaves out decks; name another file with --json")
    ways = [name for name in WAYS if name not in given.without]
    paths = [path for folder in given.folders for path in decks_of(folder, given.megabytes)]
    paths = [path for path in paths if not given.only or path.name.split(".")[0] in given.only]
    known = {row["deck"]: set(_kinds(row)) for row in json.loads(RESULTS.read_text())} if given.count else {}
    if given.count:
        paths = random.Random(given.seed).sample(paths, min(given.count, len(paths)))
    results, failed = [], 0
    for path in paths:
        with unpacked(path) as deck:
            results.append(examine(deck, given.rows, ways))
        wrong = failures(results[-1]) if results[-1]["structure"] else []
        if set(_kinds(results[-1])) <= known.get(results[-1]["deck"], set()):
            wrong = []
        failed += bool(wrong)
        print(_line(results[-1]), *wrong, sep="\n    ", flush=True)
        given.json.write_text("[\n" + ",\n".join(map(json.dumps, results)) + "\n]\n")
    print(table(results), reasons(results), f"{failed} of {len(results)} decks failed", sep="\n\n")
    return int(failed > 0)


def _line(result: dict[str, Any]) -> str:
    words = [result["deck"], "solids" if result["solids"] else "structure" if result["structure"] else "no structure"]
    for name, row in result["ways"].items():
        said = f"{row['difference']:.0e}" if "difference" in row else "in" if row["taken"] else "-"
        words.append(f"{name} {said}")
    return ", ".join(words)


if __name__ == "__main__":
    sys.exit(main())
