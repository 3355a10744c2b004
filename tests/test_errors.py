"""Kinds and keywords of errors: what programs go by in place of words."""

import copy
import json
import pickle
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import morembs
from morembs.base.errors import BudgetError, Kind, MorembsError, OutputError, SolverError
from morembs.base.plugins import UnknownNameError
from morembs.base.worker_pool import WorkerPool
from morembs.dynamics.gmp.equilibria import NotFollowedError
from morembs.dynamics.multibody.contact.lemke import RayError
from morembs.dynamics.multibody.contact.result import ContactError
from morembs.dynamics.multibody.sliding.handler import UnfinishedRunError
from morembs.dynamics.nonlinear.nodal import LeftTablesError
from morembs.importers.decks.problems import DeckError, Problem
from morembs.reducers import REDUCERS
from tests.support import decks
from tests.support.refusals import refusal

ROOT = Path(__file__).parents[1]


def test_the_page_of_commands_has_a_line_for_each_kind() -> None:
    text = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    table = text[text.index("| `kind` |") :].partition("\n")[2]
    assert set(re.findall(r"^\| `([a-z]+)` \| ", table, re.MULTILINE)) == set(get_args(Kind))


class OwnInitError(morembs.InputError):
    """Of a plug-in, with arguments of its own."""

    def __init__(self, modes: int) -> None:
        super().__init__(f"{modes} modes were given", kind="conflict", keyword="modes")
        self.modes = modes


@pytest.mark.parametrize(
    "error",
    [
        morembs.InputError("modes = 0", keyword="modes"),
        SolverError("no convergence", keyword="shifts_hz"),
        OutputError("disk full", kind="output", keyword="out"),
        UnknownNameError("no such method", keyword="method"),
        OutputError(28, "disk full", keyword="out"),
        DeckError("a.inp", [Problem(what="no density", kind="missing", keyword="DENSITY")]),
        BudgetError("9 MB", needed=9, keyword="memory_budget_mb"),
        LeftTablesError("left", share=1.5),
        RayError("ray", direction=np.ones(2)),
        ContactError("ended", result=None),
        UnfinishedRunError("ended", None),
        NotFollowedError("bends", np.ones(2)),
        OwnInitError(3),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_pass_whole_to_other_processes(error: MorembsError) -> None:
    for other in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
        assert (type(other), str(other)) == (type(error), str(error))
        assert (other.kind, other.keyword) == (error.kind, error.keyword)
        assert repr(vars(other)) == repr(vars(error)) or isinstance(error, DeckError)


def refuse(shared: object, task: int) -> None:
    """The work of a process: with task 0 the error can be sent, with 1 it holds what cannot."""
    error = OwnInitError(3)
    error.modes = task if task == 0 else (lambda: task)  # type: ignore[assignment]
    raise error


@pytest.mark.parametrize("task", [0, 1])
def test_errors_of_workers_keep_kind_and_keyword(task: int) -> None:
    with WorkerPool(None, 2) as pool, refusal("conflict", "modes", "3", by=MorembsError):
        list(pool.each(refuse, [task, task]))


def test_a_memory_budget_that_is_too_small_stays_one_in_other_words() -> None:
    error = BudgetError("9 MB", needed=9, keyword="budget").restate("part 2: 9 MB")
    assert (str(error), error.needed, error.kind, error.keyword) == ("part 2: 9 MB", 9, "memory", "budget")


@pytest.mark.parametrize(
    ("at", "keys", "keyword"),
    [
        ("automatic.certified_reference", 'method = "auto"\nband_hz = [0.0, 500.0]\ntolerance = 0.05', "tolerance"),
        ("balanced.reference_model", 'method = "balanced-truncation"\norder = 6', "memory"),
    ],
)
def test_a_reference_beyond_the_memory_budget_is_a_matter_of_memory(
    at: str, keys: str, keyword: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise BudgetError("9 MB", needed=9, keyword="memory")

    monkeypatch.setattr(f"morembs.reducers.{at}", refuse)
    tables = {"reduce": keys, "damping": "modal = 0.02"}
    job = decks.folder(tmp_path, tables, decks.deck(decks.BEAM[:12]))
    (told,) = json.loads(run_json("reduce", job, "--json", "--quiet"))
    assert (told["kind"], told["keyword"]) == ("memory", keyword) and "9 MB" in told["error"]


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


def test_what_a_method_refuses_within_a_job_keeps_kind_and_keyword(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise morembs.InputError("no such pair", kind="unsupported", keyword="pairs")

    monkeypatch.setattr(REDUCERS["craig-bampton"], "reduce", refuse)
    job = decks.folder(tmp_path, {}, decks.deck(decks.BEAM[:12]))
    (told,) = json.loads(run_json("reduce", job, "--json", "--quiet"))
    assert (told["kind"], told["keyword"]) == ("unsupported", "pairs") and "'cb': no such pair" in told["error"]


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
