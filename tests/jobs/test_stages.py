"""The stages of a job: all tables belong to some, they run as they need each other, and a new one is a line."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.job import job_tables, load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.stages.stage import BODIES, STAGES, JobStage, Results, Work, in_order
from morembs.app.jobs.tables import Job, ModesTable, OptionalTable
from morembs.app.report.sections import Section
from morembs.base import limits
from morembs.base.errors import InputError
from morembs.body.file import read_body
from morembs.reducers import ProblemSummary
from tests.support.decks import folder

# The table of another command.
BESIDE = {ModesTable}


def test_each_table_of_a_job_belongs_to_a_stage() -> None:
    read = {table for stage in STAGES.values() for table in stage.tables}
    assert {kind.key() for kind in read | BESIDE} == {field.name for field in fields(job_tables())}


def test_stages_come_after_what_they_need() -> None:
    stages = list(in_order(list(STAGES.values())[::-1]))
    assert len(stages) == len(STAGES)
    for at, stage in enumerate(stages):
        # Preload and spin change what they need of a stage before.
        later = {result for other in stages[at + 1 :] for result in other.gives if result not in other.needs}
        assert not later & set(stage.needs), stage


@dataclass(frozen=True, kw_only=True)
class FrequencyListTable(OptionalTable):
    """``[frequency_list]``: frequencies as a text."""

    path: Annotated[str, limits.text("the path of a .txt file", r"\.txt$")]
    digits: Annotated[int, limits.number("a count of digits", ge=1, le=9)] = 6


class FrequencyList(JobStage):
    """The frequencies of all bodies as a text beside the body file."""

    tables = (FrequencyListTable,)
    needs = (BODIES,)
    # The body file has its provenance, so it comes before.
    gives = (BODIES,)
    step = "list frequencies"
    on_page = True

    def is_asked(self, job: Job) -> bool:
        return FrequencyListTable.of(job) is not None

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"the list of frequencies": job.result(FrequencyListTable.require(job).path)}

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        if not facts.inputs:
            raise InputError("a list of frequencies needs interfaces")
        return ("frequencies are listed",)

    def run(self, work: Work) -> None:
        given = FrequencyListTable.require(work.job)
        lines = [f"{body.name} {hz:.{given.digits}g}" for body in work[BODIES] for hz in body.frequencies_hz]
        work.job.result(given.path).write_text("\n".join(lines))

    def provenance(self, work: Work) -> Mapping[str, object]:
        return {"listed_frequencies": len(work[BODIES][0].frequencies_hz)}

    def document(self, job: Job, results: Results) -> Mapping[str, Any]:
        return {"bodies": {body.name: {"highest_hz": float(body.frequencies_hz[-1])} for body in results[BODIES]}}

    def sections(self, document: Mapping[str, Any]) -> Sequence[Section]:
        rows = [(name, f"{body['highest_hz']:.6g}") for name, body in document["bodies"].items()]
        return [Section(title="the highest frequency", columns=("body", "<Hz>"), rows=rows)]


def test_a_new_stage_brings_its_keys_and_is_checked_run_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, run = {"frequency_list": 'path = "part.txt"\ndigits = 4'}, CliRunner().invoke
    job = folder(tmp_path, asked)
    assert "unknown key 'frequency_list'" in run(cli.app, ["check", str(job)]).stderr
    monkeypatch.setitem(STAGES, "frequency list", FrequencyList())
    checked = run(cli.app, ["check", str(job)])
    assert checked.exit_code == 0 and "frequencies are listed" in checked.stdout
    assert "FrequencyListTable" in json.loads(run(cli.app, ["schema"]).stdout)["$defs"]
    shown = run(cli.app, ["reduce", str(job), "--report", str(tmp_path / "report.html")])
    (document,) = json.loads(run(cli.app, ["reduce", str(job), "--json"]).stdout)
    highest = document["bodies"]["cb"]["highest_hz"]
    assert highest == document["bodies"]["cb"]["frequencies_hz"][-1]
    assert (tmp_path / "part.txt").read_text().endswith(f"cb {highest:.4g}")
    assert "list frequencies" in document["seconds"] and str(tmp_path / "part.txt") in document["written"]
    page = (tmp_path / "report.html").read_text()
    assert "the highest frequency" in page and f"{highest:.6g}" in page and "&lt;Hz&gt;" in page
    assert "the highest frequency" in shown.stdout and f"{highest:.6g}" in shown.stdout and "part.txt" in shown.stdout
    stored = read_body(tmp_path / "part.h5")
    assert stored.provenance["listed_frequencies"] == len(document["bodies"]["cb"]["frequencies_hz"])
    assert stored.recipe["frequency_list"] == {"path": "part.txt", "digits": 4}


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"frequency_list": 'path = "part.csv"'}, "path = 'part.csv' was given; expected the path of"),
        ({"frequency_list": 'path = "part.txt"\ndigits = 10'}, "expected a count of digits"),
        ({"interface": None, "interface2": None, "reduce": 'method = "modal"\nmodes = 3'}, "needs interfaces"),
        ({"output": 'path = "part.txt"', "frequency_list": 'path = "part.txt"'}, "give it a name of its own"),
    ],
)
def test_a_new_stage_refuses_what_it_declares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tables: dict[str, str | None], said: str
) -> None:
    monkeypatch.setitem(STAGES, "frequency list", FrequencyList())
    job = folder(tmp_path, {"frequency_list": 'path = "part.txt"', **tables})
    done = CliRunner().invoke(cli.app, ["check", str(job)])
    assert done.exit_code == 2 and said in done.stderr


def test_what_is_written_beside_the_body_file_counts_to_its_time(tmp_path: Path) -> None:
    output = 'path = "part.h5"\npicture = "part.png"'
    system = 'path = "part.npz"\ninputs = ["left:force:x"]\noutputs = ["right:displacement:x"]'
    result = run_job(load_job(folder(tmp_path, {"output": output, "state_space": system})))
    names = [stage.name for stage in result.stages]
    assert names[-2:] == ["write", "draw"] and names.count("write") == 1
    assert (tmp_path / "part.npz").exists()
