"""The stages of a job: all tables belong to some, they run as they need each other, and a new one is a line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.job import job_tables, load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.stages.stage import BODIES, STAGES, JobStage, Work, in_order
from morembs.app.jobs.tables import Job, ModesTable
from morembs.base.errors import InputError
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


class FrequencyList(JobStage):
    """The frequencies of all bodies as a text beside the body file."""

    needs = (BODIES,)

    def writes(self, job: Job) -> Mapping[str, Path]:
        return {"the list of frequencies": job.output.with_suffix(".txt")}

    def check(self, job: Job, facts: ProblemSummary, rigid: int) -> tuple[str, ...]:
        if not facts.inputs:
            raise InputError("a list of frequencies needs interfaces")
        return ("frequencies are listed",)

    def run(self, work: Work) -> None:
        lines = [f"{body.name} {hz:.6g}" for body in work[BODIES] for hz in body.frequencies_hz]
        work.job.output.with_suffix(".txt").write_text("\n".join(lines))


def test_a_new_stage_is_checked_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, run = folder(tmp_path), CliRunner().invoke
    monkeypatch.setitem(STAGES, "frequency list", FrequencyList())
    checked = run(cli.app, ["check", str(job)])
    assert checked.exit_code == 0 and "frequencies are listed" in checked.stdout
    assert run(cli.app, ["reduce", str(job)]).exit_code == 0
    assert (tmp_path / "part.txt").read_text().startswith("cb ")
    job = folder(tmp_path, {"interface": None, "interface2": None, "reduce": 'method = "modal"\nmodes = 3'})
    assert "needs interfaces" in run(cli.app, ["check", str(job)]).stderr
    job = folder(tmp_path, {"output": 'path = "part.h5"\npicture = "part.png"', "model": 'mesh = "part.txt"'})
    assert "would overwrite the mesh" in run(cli.app, ["check", str(job)]).stderr


def test_what_is_written_beside_the_body_file_counts_to_its_time(tmp_path: Path) -> None:
    output = 'path = "part.h5"\npicture = "part.png"'
    system = 'path = "part.npz"\ninputs = ["left:force:x"]\noutputs = ["right:displacement:x"]'
    result = run_job(load_job(folder(tmp_path, {"output": output, "state_space": system})))
    names = [stage.name for stage in result.stages]
    assert names[-2:] == ["write", "draw"] and names.count("write") == 1
    assert (tmp_path / "part.npz").exists()
