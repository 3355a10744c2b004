"""Workflows are valid, and run only what the repository has."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="PyYAML is not here: pip install pyyaml")
ROOT = Path(__file__).parents[1]
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
FILES = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
# What a workflow may use of others, with the inputs that it takes.
ACTIONS = {
    "actions/checkout@v4": set(),
    "actions/setup-python@v5": {"python-version"},
    "actions/upload-artifact@v4": {"name", "path"},
    "actions/cache@v4": {"path", "key", "restore-keys"},
}
# Folders that make targets fill, and files of the repository.
FILLED = {"build/site", "build/nightly", "dist", "tests/data/nightly_seeds.toml"}


def read(path: Path) -> dict[Any, Any]:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def steps(workflow: dict[Any, Any]) -> list[dict[str, Any]]:
    return [step for job in workflow["jobs"].values() for step in job["steps"]]


def test_what_a_project_needs_is_there() -> None:
    assert [path.stem for path in FILES] == ["nightly", "release", "tests"]
    tests, nightly = read(ROOT / ".github/workflows/tests.yml"), read(ROOT / ".github/workflows/nightly.yml")
    systems = tests["jobs"]["wheel"]["strategy"]["matrix"]["os"]
    assert {system.split("-")[0] for system in systems} == {"ubuntu", "macos", "windows"}
    # YAML 1.1 reads the key "on" as true.
    assert {"push", "pull_request"} <= set(tests[True]) and "schedule" in nightly[True]
    made = [step["run"] for path in FILES for step in steps(read(path)) if "run" in step]
    for target in ("test", "docs", "nightly", "release"):
        assert any(f"make {target}" in line for line in made), target


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_workflow_runs_what_there_is(path: Path) -> None:
    workflow = read(path)
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert {"runs-on", "timeout-minutes", "steps"} <= set(job) and job["timeout-minutes"] <= 360
        assert job["steps"][0] == {"uses": "actions/checkout@v4"}
    for step in steps(workflow):
        assert ("run" in step) != ("uses" in step), step
        for target in re.findall(r"\bmake ([a-z-]+)", step.get("run", "")):
            assert target in TARGETS, target
        for name in re.findall(r"\b(?:tests|scripts|benchmarks)/[\w./-]+", step.get("run", "")):
            assert (ROOT / name).exists(), name
        if "uses" in step:
            assert set(step.get("with", {})) <= ACTIONS[step["uses"]], step
            if not step["uses"].startswith("actions/setup"):
                assert set(step.get("with", {}).get("path", "").split()) <= FILLED, step


def test_pythons_are_those_of_the_project() -> None:
    told = set(re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text()))
    assert set(read(ROOT / ".github/workflows/tests.yml")["jobs"]["wheel"]["strategy"]["matrix"]["python"]) == told
    (command,) = (step["run"] for step in steps(read(ROOT / ".github/workflows/release.yml")) if "run" in step)
    assert set(re.findall(r"python(3\.\d+)", command)) == told
