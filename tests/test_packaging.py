"""Recipe, container file and citation say what the project says, and one line raises the version."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from morembs.version import VERSION
from scripts import schema

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Names of packages at conda-forge that differ.
CONDA = {"matplotlib": "matplotlib-base"}


def test_the_recipe_asks_for_what_the_project_asks_for() -> None:
    recipe = (ROOT / "conda" / "recipe" / "recipe.yaml").read_text()
    run = recipe.partition("  run:\n")[2].partition("\ntests:")[0]
    asked = dict(line.strip("- ").split(" >=") for line in run.strip().splitlines())
    wanted = {"python": PROJECT["requires-python"].removeprefix(">=")}
    for line in PROJECT["dependencies"]:
        name, least = line.partition(";")[0].split(">=")
        wanted[CONDA.get(name, name)] = least.strip()
    assert asked == wanted
    assert f"license: {PROJECT['license']}\n" in recipe and f"summary: {PROJECT['description']}\n" in recipe
    assert f"morembs = {PROJECT['scripts']['morembs']}\n" in recipe


def test_the_recipe_is_valid_once_its_version_stands_in_it() -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not here: pip install pyyaml")
    recipe = (ROOT / "conda" / "recipe" / "recipe.yaml").read_text()
    held = yaml.safe_load(recipe.replace("${{ version }}", VERSION).replace("${{ PYTHON }}", "python"))
    assert held["context"] == {"version": VERSION}
    assert held["package"] == {"name": "morembs", "version": VERSION} and held["build"]["noarch"] == "python"
    assert held["source"]["path"].endswith(f"dist/morembs-{VERSION}.tar.gz")


def test_the_container_copies_what_there_is() -> None:
    lines = re.findall(r"^COPY (?!--from)(.*) \S+$", (ROOT / "Containerfile").read_text(), re.MULTILINE)
    names = [name for line in lines for name in line.split()]
    assert {"pyproject.toml", "README.md", "LICENSE", "morembs"} == set(names)
    assert all((ROOT / name).exists() for name in names)


def test_the_citation_says_that_its_doi_is_a_placeholder() -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not here: pip install pyyaml")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0" and citation["version"] == VERSION and citation["authors"]
    (doi,) = citation["identifiers"]
    assert doi["type"] == "doi" and "laceholder" in doi["description"] and "doi" not in citation


def test_one_line_raises_the_version(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not schema.stale()
    monkeypatch.setattr(schema, "VERSION", "7.8.9")
    raised = {page.relative_to(ROOT).as_posix(): text for page, text in schema.stale().items()}
    assert {"CITATION.cff", "README.md", "conda/recipe/recipe.yaml", "docs/howto/scale.md"} <= set(raised)
    assert "\nversion: 7.8.9\n" in raised["CITATION.cff"] and "cff-version: 1.2.0" in raised["CITATION.cff"]
    assert "pip install morembs-7.8.9-py3-none-any.whl" in raised["README.md"]
    assert '\n  version: "7.8.9"\n' in raised["conda/recipe/recipe.yaml"]
