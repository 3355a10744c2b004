"""Campaigns with new seeds for as long as one night has, and one page with what came of them, night by night.

    python -m benchmarks.nightly [--hours 1] [--seed S] [--only CAMPAIGN ...] [--folder build/nightly]
    python -m benchmarks.nightly --repeat CAMPAIGN SEED

Each campaign has a share of the time and runs in chunks of few trials, each with a seed of its own. The seed of a chunk
that fails goes to tests/data/nightly_seeds.toml, which a test runs again until it passes. ``history.jsonl`` in the
folder has one line for a campaign and a night, ``index.html`` shows all of them. Exit code 1 where a chunk failed.
"""

from __future__ import annotations

import argparse
import html
import io
import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.measure import ROOT

SEEDS = ROOT / "tests" / "data" / "nightly_seeds.toml"
# The operating system counts processor time in such seconds.
TICK = 0.01
# Lines of a failed chunk that the page shows.
SHOWN = 30


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Trials that end with another exit code than 0 where one of them fails. ``arguments`` of Python; SEED and FOLDER
    in them stand for the seed and a scratch folder. ``share`` of the time, beside those of the others."""

    name: str
    words: str
    arguments: tuple[str, ...]
    trials: int
    share: float

    def run(self, seed: int) -> Chunk:
        """Run one chunk."""
        with tempfile.TemporaryDirectory(prefix="nightly-") as folder:
            given = [part.replace("SEED", str(seed)).replace("FOLDER", folder) for part in self.arguments]
            before, start = os.times(), time.perf_counter()
            ended = subprocess.run(
                [sys.executable, *given],
                cwd=ROOT,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                check=False,
            )
            seconds, after = time.perf_counter() - start, os.times()
        processor = sum(after[2:4]) - sum(before[2:4])
        lines = ended.stdout.strip().splitlines()
        return Chunk(
            seed=seed, code=ended.returncode, seconds=seconds, processor=processor, lines=tuple(lines[-SHOWN:])
        )


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """One run of a campaign: exit code, wall and processor seconds, and the last lines that it printed."""

    seed: int
    code: int
    seconds: float
    processor: float
    lines: tuple[str, ...]


def _attack(verb: str, trials: int) -> tuple[str, ...]:
    return ("-m", "benchmarks.attack", verb, *_drawn(trials), "--results", "FOLDER")


def _drawn(trials: int) -> tuple[str, ...]:
    return "--count", str(trials), "--seed", "SEED"


CAMPAIGNS = (
    Campaign(
        name="jobs",
        words="jobs across all features, judged in extended arithmetic",
        arguments=_attack("jobs", 40),
        trials=40,
        share=6,
    ),
    Campaign(
        name="certificates",
        words="certificates of random trusses beside dense solutions",
        arguments=("benchmarks/certificates.py", *_drawn(10), "--own", "0.3", "--above-zero", "0.3"),
        trials=10,
        share=4,
    ),
    Campaign(
        name="verification",
        words="stated limits and false ones before the program of a stranger",
        arguments=("benchmarks/verification.py", *_drawn(10), "--tampers", "10"),
        trials=20,
        share=2,
    ),
    Campaign(
        name="structured",
        words="models of all decades of stiffness beside dense solutions",
        arguments=("-m", "benchmarks.attack", "structured", *_drawn(25)),
        trials=25,
        share=2,
    ),
    Campaign(
        name="decks",
        words="decks of CalculiX beside ccx",
        arguments=("-m", "benchmarks.decks", *_drawn(8), "--json", "FOLDER/decks.json"),
        trials=8,
        share=3,
    ),
    Campaign(name="kill", words="commands killed at any instant", arguments=_attack("kill", 20), trials=20, share=2),
    Campaign(
        name="damage", words="damaged files of every format", arguments=_attack("damage", 200), trials=200, share=2
    ),
    Campaign(
        name="published",
        words="published models by all methods beside pyMOR",
        arguments=("benchmarks/published.py",),
        trials=1,
        share=0,
    ),
)


def campaign_of(name: str) -> Campaign:
    """The campaign of a name."""
    return next(each for each in CAMPAIGNS if each.name == name)


@dataclass(frozen=True, kw_only=True)
class Night:
    """What one night made of one campaign."""

    date: str
    commit: str
    campaign: str
    trials: int
    chunks: int
    failed_seeds: tuple[int, ...]
    seconds: float
    processor_seconds: float
    failures: tuple[str, ...] = ()


def run_night(campaign: Campaign, seed: int, seconds: float) -> Night:
    """Run chunks of ``campaign`` from ``seed`` on until ``seconds`` have passed, one at least."""
    chunks: list[Chunk] = []
    start = time.perf_counter()
    while not chunks or time.perf_counter() - start + chunks[-1].seconds < seconds:
        chunks.append(campaign.run(seed + len(chunks)))
        state = "passed" if chunks[-1].code == 0 else f"FAILED ({chunks[-1].code})"
        print(f"{campaign.name} --seed {chunks[-1].seed}: {state}, {chunks[-1].seconds:.0f} s", flush=True)
    failed = [chunk for chunk in chunks if chunk.code]
    return Night(
        date=f"{datetime.now(UTC):%Y-%m-%d %H:%M}",
        commit=commit(),
        campaign=campaign.name,
        trials=campaign.trials * len(chunks),
        chunks=len(chunks),
        failed_seeds=tuple(chunk.seed for chunk in failed),
        seconds=round(sum(chunk.seconds for chunk in chunks), 2),
        processor_seconds=round(sum(chunk.processor for chunk in chunks), 2),
        failures=tuple("\n".join(chunk.lines) for chunk in failed),
    )


def commit() -> str:
    """The commit that runs; "" outside of a repository."""
    ended = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "--short=8", "HEAD"], capture_output=True, text=True, check=False
    )
    return ended.stdout.strip()


def stored_seeds(path: Path = SEEDS) -> list[dict[str, Any]]:
    """Seeds of chunks that once failed: ``campaign``, ``seed``, ``commit``."""
    return tomllib.loads(path.read_text()).get("failure", []) if path.exists() else []


def store_seeds(night: Night, path: Path = SEEDS) -> None:
    """Add the failed seeds of ``night`` that are not stored yet."""
    known = {(each["campaign"], each["seed"]) for each in stored_seeds(path)}
    text = path.read_text() if path.exists() else ""
    for seed in night.failed_seeds:
        if (night.campaign, seed) not in known:
            text += f'\n[[failure]]\ncampaign = "{night.campaign}"\nseed = {seed}\ncommit = "{night.commit}"\n'
    _replace(path, text)


def _replace(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(path.name + ".new")
    new.write_text(text)
    new.replace(path)


def nights_of(history: Path) -> list[Night]:
    """All nights that the history holds, oldest first."""
    if not history.exists():
        return []
    rows = [json.loads(line) for line in history.read_text().splitlines() if line]
    return [Night(**{name: tuple(v) if isinstance(v, list) else v for name, v in row.items()}) for row in rows]


def page(nights: Sequence[Night]) -> str:
    """All nights as one HTML page without a script: a table, trends as curves, failures as they printed."""
    by_campaign = {
        campaign.name: mine for campaign in CAMPAIGNS if (mine := [n for n in nights if n.campaign == campaign.name])
    }
    rows, failures = [], []
    for name, mine in by_campaign.items():
        campaign = campaign_of(name)
        last, trials = mine[-1], sum(night.trials for night in mine)
        bad = len(last.failed_seeds)
        cells = [
            html.escape(campaign.name),
            html.escape(campaign.words),
            f"{last.trials:,}",
            f"{bad} of {last.chunks}" if bad else "0",
            f"{last.seconds / 60:.1f}",
            f"{last.processor_seconds / last.trials:.2f}",
            f"{trials:,}",
            str(sum(len(night.failed_seeds) for night in mine)),
            html.escape(f"{last.date} {last.commit}"),
        ]
        rows.append(f"<tr class={'bad' if bad else 'good'}><td>" + "</td><td>".join(cells) + "</td></tr>")
        for seed, words in zip(last.failed_seeds, last.failures, strict=True):
            again = f"python -m benchmarks.nightly --repeat {campaign.name} {seed}"
            failures.append(f"<h3><code>{again}</code></h3><pre>{html.escape(words)}</pre>")
    head = (
        *("campaign", "what it tries", "trials", "failed chunks", "minutes", "processor seconds of a trial"),
        *("trials of all nights", "failed chunks of all nights", "last night"),
    )
    return _PAGE.format(
        summary=_summary([mine[-1] for mine in by_campaign.values()]),
        head="</th><th>".join(head),
        rows="\n".join(rows),
        trend=_trend(by_campaign),
        failures="".join(failures) or "<p>None in the last night.</p>",
    )


def _summary(last: Sequence[Night]) -> str:
    """One sentence about the last night of each campaign."""
    trials, minutes = sum(night.trials for night in last), sum(night.seconds for night in last) / 60
    chunks = sum(len(night.failed_seeds) for night in last)
    end = f"failed chunks: {chunks}" if chunks else "all passed"
    return f"Last night: {len(last)} campaigns, {trials:,} trials in {minutes:.0f} minutes; {end}."


def _trend(by_campaign: Mapping[str, Sequence[Night]]) -> str:
    """Processor seconds of a trial over the nights, as SVG."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(11, 3.8), layout="constrained")
    axes = figure.subplots()
    most = max((len(nights) for nights in by_campaign.values()), default=1)
    for name, nights in by_campaign.items():
        y = [max(night.processor_seconds, TICK) / night.trials for night in nights]
        (line,) = axes.plot(range(1, len(y) + 1), y, marker="o", label=name)
        failed = [i for i, night in enumerate(nights) if night.failed_seeds]
        axes.plot([i + 1 for i in failed], [y[i] for i in failed], "x", color=line.get_color(), markersize=12)
    axes.set(xlabel="night (a cross: a failure)", ylabel="processor seconds of a trial", yscale="log")
    axes.set_xlim(0.5, most + 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes.grid(True, color="#d0d4d8", linewidth=0.5)
    figure.legend(frameon=False, loc="outside right upper")
    text = io.StringIO()
    figure.savefig(text, format="svg")
    return text.getvalue().partition("?>")[2].partition('.dtd">')[2] or text.getvalue()


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>morembs: campaigns night by night</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 80rem; padding: 0 1rem }}
body {{ color: #1b1f23; background: #fff }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
div {{ overflow-x: auto }}
th, td {{ padding: .35rem .7rem; border-bottom: 1px solid #d0d4d8; text-align: left; vertical-align: top }}
th {{ vertical-align: bottom }}
:is(th, td):nth-child(n + 3):nth-child(-n + 8) {{ text-align: right }}
:is(th, td):nth-child(9), td:first-child {{ white-space: nowrap }}
tr.good td:first-child {{ border-left: .4rem solid #2e7d4f }}
tr.bad td:first-child {{ border-left: .4rem solid #b3261e }}
pre {{ background: #f3f4f6; padding: .8rem; overflow-x: auto }}
svg {{ max-width: 100%; height: auto }}
</style></head><body>
<h1>Campaigns, night by night</h1>
<p>{summary}</p>
<div><table><thead><tr><th>{head}</th></tr></thead><tbody>
{rows}
</tbody></table></div>
<h2>Trends</h2>
{trend}
<h2>Failures</h2>
{failures}
</body></html>
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; 1 where a chunk failed."""
    names = [campaign.name for campaign in CAMPAIGNS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="of all campaigns (1)")
    parser.add_argument("--seed", type=int, help="of the first chunks; without it the seconds since 1970")
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="CAMPAIGN", help=", ".join(names))
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "nightly")
    parser.add_argument(
        "--repeat", nargs=2, metavar=("CAMPAIGN", "SEED"), help="one chunk, and all that it prints last"
    )
    given = parser.parse_args(arguments)
    if given.repeat:
        chunk = campaign_of(given.repeat[0]).run(int(given.repeat[1]))
        print("\n".join(chunk.lines))
        return int(chunk.code != 0)
    some = [campaign_of(name) for name in dict.fromkeys(given.only)]
    shares = sum(campaign.share for campaign in some) or 1
    seed = int(time.time()) if given.seed is None else given.seed
    history, nights = given.folder / "history.jsonl", []
    for campaign in some:
        nights.append(run_night(campaign, seed, 3600 * given.hours * campaign.share / shares))
        store_seeds(nights[-1])
        _replace(history, "".join(json.dumps(asdict(n)) + "\n" for n in (*nights_of(history), nights[-1])))
        _replace(given.folder / "index.html", page(nights_of(history)))
    print(given.folder / "index.html")
    return int(any(night.failed_seeds for night in nights))


if __name__ == "__main__":
    sys.exit(main())
