"""The forecast of the time of a whole job: each stage that runs is in it, and none takes nothing."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.stages.durations import START, STEPS, least_seconds
from morembs.app.jobs.stages.stage import STAGES
from morembs.base.cache import keep_cached
from morembs.linalg.sparse.threads import Speed, blas_threads, kept_speed, speed_name
from tests.support.decks import folder

RUNNER = CliRunner()
BAND = "band_hz = [0, 5000]"
# Tables of a job, and the steps that they add to those of every job.
JOBS = {
    "two reductions": ({"reduce2": 'name = "second"\nmethod = "guyan"'}, {"reduce second"}),
    "certified with a witness": (
        {"damping": "modal = 0.01", "certify": f"{BAND}\nwitness = true"},
        {"certify", "witness"},
    ),
    "a response": ({"response": "from_hz = 10\nto_hz = 5000\npoints = 5"}, {"response"}),
    "effective masses": ({"effective_mass": 'held = ["left"]\npath = "masses.csv"'}, {"effective mass"}),
    "nothing to compare": ({"check": "full_modes = 0"}, set[str]()),
}


def document(command: str, job: Path) -> Any:
    ended = RUNNER.invoke(cli.app, [command, "--json", str(job)])
    assert ended.exit_code == 0, ended.output
    (found,) = json.loads(ended.stdout)
    return found


@pytest.mark.parametrize("name", JOBS)
def test_stages_of_a_job_are_those_of_its_forecast(tmp_path: Path, name: str) -> None:
    tables, added = JOBS[name]
    job = folder(tmp_path, tables)
    forecast, ran = document("check", job)["seconds"], document("reduce", job)["seconds"]
    assert forecast.keys() == {START, *ran} and added <= ran.keys()
    assert min(forecast.values()) > 0


def test_longest_stage_is_named_in_words(tmp_path: Path) -> None:
    ended = RUNNER.invoke(cli.app, ["check", str(folder(tmp_path, {}))])
    assert "longest step: start of Python" in " ".join(ended.stdout.split())


def test_every_step_that_a_stage_can_have_takes_time() -> None:
    steps = {step for stage in STAGES.values() for step in (stage.step, *stage.steps) if step}
    assert {START, *steps} == STEPS.keys()
    assert all(once > 0 and each >= 0 for once, each in STEPS.values())


def test_slow_machine_takes_longer(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def at(mhz: float) -> float:
        speed = Speed(gemm_gflops=30.0, triad_gbs=10.0, python_mhz=mhz)
        keep_cached(speed_name(blas_threads()), asdict(speed))
        kept_speed.cache_clear()
        return least_seconds("assemble", 10_000)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    once, each = STEPS["assemble"]
    try:
        assert at(5.0) == pytest.approx(2 * at(10.0))
        assert at(11.0) == pytest.approx(once + 10 * each)
    finally:
        kept_speed.cache_clear()


def test_modes_of_each_speed_take_their_time(tmp_path: Path) -> None:
    def at(speeds: list[int]) -> float:
        spin = f'speed = {speeds}\naxis = [1, 0, 0]\nheld = ["left"]'
        return float(document("check", folder(tmp_path, {"spin": spin}))["seconds"]["spin modes"])

    assert at([0, 10, 20]) == pytest.approx(3 * at([0])) and at([0]) > 0
