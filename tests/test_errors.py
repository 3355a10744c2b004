"""Kinds and keywords of errors: what programs go by in place of words."""

import json
import pickle
import re
from pathlib import Path
from typing import get_args

import pytest

import morembs
from morembs.base.errors import Kind, MorembsError, OutputError, SolverError
from morembs.base.plugins import UnknownNameError
from morembs.importers.decks.problems import DeckError, Problem
from tests.support.refusals import refusal

ROOT = Path(__file__).parents[1]


def test_the_page_of_commands_has_a_line_for_each_kind() -> None:
    text = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    table = text[text.index("| `kind` |") :].partition("\n")[2]
    assert set(re.findall(r"^\| `([a-z]+)` \| ", table, re.MULTILINE)) == set(get_args(Kind))


@pytest.mark.parametrize(
    "error",
    [
        morembs.InputError("modes = 0", keyword="modes"),
        SolverError("no convergence", keyword="shifts_hz"),
        OutputError("disk full", kind="output", keyword="out"),
        UnknownNameError("no such method", keyword="method"),
        DeckError("a.inp", [Problem(what="no density", kind="missing", keyword="DENSITY")]),
    ],
)
def test_kind_and_keyword_pass_to_other_processes(error: MorembsError) -> None:
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy)) == (type(error), str(error))
    assert (copy.kind, copy.keyword) == (error.kind, error.keyword)


def test_an_error_keeps_its_kind_in_other_words() -> None:
    error = UnknownNameError("no 'bbar'", keyword="formulation").restate("piece 2: no 'bbar'")
    assert (type(error), error.kind, error.keyword) == (morembs.InputError, "unknown", "formulation")
    assert str(error) == "piece 2: no 'bbar'"


def test_the_block_of_the_page_says_the_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    block = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert block
    said: list[str] = []
    exec(block[1], {"print": lambda *words: said.append(" ".join(words))})
    assert block[1].count(f"# {said[0]}\n") == 1


def test_a_table_of_keys_has_the_kind_of_its_first_fault(tmp_path: Path) -> None:
    job = tmp_path / "job.toml"
    job.write_text('[model]\nmesh = "part.msh"\nunits = 3\ncolour = "red"\n')
    told = json.loads(run_json("reduce", job, "--json"))
    assert [(one["kind"], one["keyword"]) for one in told] == [("value", "units")]
    told = json.loads(run_json("batch", job, "--json", "--quiet"))
    assert [(one["state"], one["kind"], one["keyword"]) for one in told] == [("failed", "value", "units")]


def run_json(*arguments: object) -> str:
    """Standard output of a command that fails."""
    from typer.testing import CliRunner

    from morembs.app.cli import app

    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 2, result.output
    return result.stdout


@pytest.mark.parametrize(
    ("kind", "keyword", "quoted"), [("value", "modes", "0"), ("unknown", "mode", "0"), ("unknown", "modes", "1")]
)
def test_a_refusal_of_another_kind_keyword_or_value_fails(kind: Kind, keyword: str, quoted: str) -> None:
    with pytest.raises(AssertionError), refusal(kind, keyword, quoted):
        raise UnknownNameError("modes = 0", keyword="modes")


def test_words_in_a_row_are_no_quotation() -> None:
    with pytest.raises(AssertionError, match="by kind and keyword"), refusal("unknown", "", "two words"):
        raise UnknownNameError("two words")
