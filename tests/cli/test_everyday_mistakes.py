"""Mistakes of the first day: each message says what was given, what was expected, and the words that cure it."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from morembs import CraigBampton, Problem, make_interface, select_nodes, to_pymor, write_body
from morembs.app.jobs.job import load_job
from morembs.app.kinds import SYSTEM_FILE, instead
from morembs.base.options import pairs
from tests.support.decks import folder
from tests.support.meshes import box, steel
from tests.support.processes import morembs
from tests.support.refusals import refusal

STEEL = 'set = "all"\nyoung = 210e3\npoisson = 0.3\ndensity = 7.85e-9'


@pytest.mark.parametrize(("key", "wrong"), [("density", "-7.85e-09"), ("young", "-210000.0")])
def test_a_material_is_quoted_in_the_units_of_the_job(tmp_path: Path, key: str, wrong: str) -> None:
    right = {"density": "7.85e-9", "young": "210e3"}[key]
    job = folder(tmp_path, {"material": STEEL.replace(f"{key} = {right}", f"{key} = {wrong}")})
    with refusal("value", key, "[[material]]", wrong):
        load_job(job)


def test_a_key_that_is_given_twice_is_named_with_its_line(tmp_path: Path) -> None:
    job = tmp_path / "twice.toml"
    job.write_text('[output]\npath = "a.h5"\npath = "b.h5"\n')
    with refusal("file", "twice.toml", "twice.toml", "'path'", "3"):
        load_job(job)


def test_damping_says_its_three_forms_once(tmp_path: Path) -> None:
    with refusal("value", "modal", "modal", "2", "0.02", '"adams"') as caught:
        load_job(folder(tmp_path), ["damping.modal=2"])
    assert "(each" not in str(caught.value)


def test_a_misspelt_keyword_of_a_deck_is_answered_with_the_right_one(tmp_path: Path) -> None:
    text = (folder(tmp_path).parent / "part.inp").read_text()
    deck = tmp_path / "wrong.inp"
    deck.write_text(text.replace("*NODE\n", "*NODES\n", 1))
    done = morembs("import", deck.name, "--dry-run", folder=tmp_path)
    assert done.code == 2 and "*NODES" in done.output + done.errors and "*NODE?" in done.output + done.errors


def test_options_that_are_no_pairs_or_pairs_twice() -> None:
    with refusal("value", "certify.band_hz", "certify.band_hz=VALUE"):
        pairs(["certify.band_hz"])
    with refusal("conflict", "a", "--set"):
        pairs(["a=1", "a=2"])


def test_a_reduced_model_is_no_body_to_write(tmp_path: Path) -> None:
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.05)))
    left = make_interface(model, name="LEFT", nodes=select_nodes(model, "box:-1,-1,-1,0,1,1"))
    with Problem(model, [left]) as problem:
        reduced = CraigBampton(modes=2).reduce(problem)
    with refusal("value", "bodies", "ReducedModel", "elastic_body(problem,"):
        write_body(tmp_path / "x.h5", [reduced])  # type: ignore[list-item]
    with refusal("value", "bodies", "ReducedModel", "[body]"):
        write_body(tmp_path / "x.h5", reduced)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_a_number_is_no_model_of_pymor() -> None:
    with refusal("value", "model", "1", "Problem"):
        to_pymor(1)  # type: ignore[arg-type]


def test_the_cure_keeps_the_words_that_were_typed(tmp_path: Path) -> None:
    """Copied into a shell, the command of a message does what was meant."""
    folder(tmp_path)
    typed = ["import", "part.inp", "--units", "mm-t-s"]
    done = morembs(*typed, folder=tmp_path)
    assert done.code == 2
    cure = shlex.split(done.errors.rpartition("morembs ")[2])
    assert cure[: len(typed)] == typed and cure[len(typed) :] == ["-o", "part.model.h5"]
    done = morembs("export", "part.h5", folder=tmp_path)
    assert done.code == 2 and "morembs export part.h5 --to" in done.errors
    (tmp_path / "missing.toml").write_text("")
    done = morembs("init", "missing.msh", folder=tmp_path)
    assert done.code == 2 and "'missing.msh'" in done.errors


def test_a_job_in_place_of_a_system_is_answered_with_both_steps(tmp_path: Path) -> None:
    job = folder(tmp_path)
    cure = instead(job, SYSTEM_FILE)
    assert "morembs reduce" in cure and "morembs init" in cure
