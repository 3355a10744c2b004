"""The examples of all public names run as they stand, on the bar of the package's own docstring."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import morembs

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL
# Without a table.
NAMES = [name for name in morembs.__all__ if name != "REDUCERS"]


def run(text: str, names: dict[str, Any], where: str) -> dict[str, Any]:
    """Run the examples in ``text`` with ``names``; those that there are then."""
    test = doctest.DocTestParser().get_doctest(text, names, where, None, 0)
    assert test.examples, f"{where} has no example"
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    # Packages that other tests import print as NumPy 1 did.
    with np.printoptions(legacy=False):
        runner.run(test, out=said.append, clear_globs=False)
    assert runner.failures == 0, "".join(said)
    return test.globs


@pytest.fixture(scope="module")
def bar() -> dict[str, Any]:
    return {name: getattr(morembs, name) for name in NAMES} | run(morembs.__doc__ or "", {}, "morembs")


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_a_public_name_runs(
    bar: dict[str, Any], name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run(getattr(morembs, name).__doc__ or "", bar, name)
