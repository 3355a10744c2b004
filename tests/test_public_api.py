"""What programs of users rely on is as it was recorded, or the change is one that was meant."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from pathlib import Path
from typing import Any

import pytest

import morembs
from scripts import public_api
from scripts.public_api import RECORDED, called, differences, paths


@pytest.fixture(scope="module")
def recorded() -> dict[str, Any]:
    return json.loads(RECORDED.read_text(encoding="utf-8"))


@pytest.mark.parametrize("part", public_api.PARTS)
def test_the_public_interface_is_the_recorded_one(recorded: dict[str, Any], part: str) -> None:
    found = sorted(differences(recorded[part], public_api.PARTS[part](), part))
    words = "\n".join(found)
    assert not found, (
        f"{words}\nIs it meant? What joins goes with the next minor version, what is gone or changed with the next "
        "major one (docs/reference/stability.md): write it into CHANGELOG.md and run python scripts/public_api.py"
    )


def test_all_is_recorded(recorded: dict[str, Any]) -> None:
    assert set(recorded) == set(public_api.PARTS)
    assert set(recorded["python"]["morembs"]) == set(morembs.__all__)
    assert set(recorded["json"]) == {line.split()[0] for line in public_api.COMMANDS.strip().splitlines()}
    takes_json = {name for name, options in recorded["commands"].items() if "--json" in options}
    assert takes_json == set(recorded["json"])


def test_public_functions_describe_their_arguments(recorded: dict[str, Any]) -> None:
    found = {
        f"{module}.{name}": getattr(importlib.import_module(module), name)
        for module, names in recorded["python"].items()
        for name in names
    }
    functions = {name: f for name, f in found.items() if inspect.isfunction(f) and inspect.signature(f).parameters}
    assert len(functions) > 80
    assert not [name for name, f in functions.items() if "Args:\n" not in (f.__doc__ or "")]


def test_differences_are_told_one_by_one() -> None:
    old = {"a": {"x": "(y)", "z": ""}, "b": ["one", "two"]}
    new = {"a": {"x": "(y, w)", "v": ""}, "b": ["two", "three"]}
    assert sorted(differences(old, new)) == [
        "changed: a: x: (y) is now (y, w)",
        "gone: a: z",
        "gone: b: one",
        "new: a: v",
        "new: b: three",
    ]


def test_arguments_and_keys_are_told_as_a_caller_sees_them() -> None:
    def example(a, b=1, *rest, c, d=2, **more):
        pass

    def keyword(a, *, b):
        pass

    assert called(example) == "(a, b=, *rest, c, d=, **more)" and called(keyword) == "(a, *, b)" and called(3) == ""
    told = [{"bodies": {"rod": {"order": 3, "recipe": {"free": 1}}}, "seconds": {"read": 1}}]
    assert sorted(paths(told)) == [
        "[].bodies",
        "[].bodies.NAME",
        "[].bodies.NAME.order",
        "[].bodies.NAME.recipe",
        "[].seconds",
    ]


def test_the_page_names_every_part() -> None:
    page = (Path(__file__).parents[1] / "docs" / "reference" / "stability.md").read_text(encoding="utf-8")
    for module in (*public_api.MODULES, *public_api.NAMES):
        assert re.search(rf"`{re.escape(module)}`", page), module
