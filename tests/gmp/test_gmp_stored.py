"""Reduced members in a file: what comes back, and the evaluator of docs/reference/member_file.md on its datasets."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.dynamics.gmp import ReducedMember
from morembs.dynamics.gmp.stored import read_members, write_members
from morembs.dynamics.nonlinear import PlanarBeam, Section
from studies import flexible_slider_crank as slider_crank
from tests.support.processes import morembs
from tests.support.refusals import refusal

PAGES = Path(__file__).parents[2] / "docs"
DOCS = PAGES / "howto" / "gmp.md"


@pytest.fixture(scope="module")
def member():
    section = Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770)
    return ReducedMember(
        PlanarBeam.straight(0.304, 12, section), modes=3, formulation="membrane", reach=0.8, points_per_angle=7
    )


@pytest.fixture(scope="module")
def file(member, tmp_path_factory):
    return write_members(tmp_path_factory.mktemp("members") / "members.h5", {"rod": member.data})


def configuration(turn=2.0):
    end = 0.29 * np.array([np.cos(turn), np.sin(turn)])
    return np.array([0.2, -0.1, turn + 0.55, 0.2 + end[0], -0.1 + end[1], turn - 0.4, 1e-3, -5e-4, 3e-4])


def test_a_member_comes_back_bit_by_bit(member, file):
    data = read_members(file)["rod"]
    before, after = member.at(configuration()), ReducedMember.of(data).at(configuration())
    for name in ("x", "J", "V", "force"):
        assert np.array_equal(getattr(before, name), getattr(after, name))
    assert np.array_equal(before.stiffness(), after.stiffness())
    # Memory is laid out otherwise, so that sums may be rounded otherwise.
    assert np.allclose(ReducedMember.of(data).nodes(before.x), member.nodes(before.x), atol=1e-14)
    outside = configuration() + np.array([0, 0, 0.4, 0, 0, 0, 0, 0, 0])
    assert ReducedMember.of(data).at(outside).V == member.at(outside).V
    assert data.formulation == "membrane" and member.outside(outside) == ReducedMember.of(data).outside(outside)


def test_the_evaluator_of_the_documentation_gives_the_same(member, file):
    (code,) = re.findall(
        r"```python evaluator\n(.*?)```", (PAGES / "reference" / "member_file.md").read_text(), re.DOTALL
    )
    space = {}
    exec(code, space)
    with h5py.File(file) as opened:
        group = opened["bodies/rod/parameterised"]
        for turn in (0.3, 2.0, -3.1, 9.0):
            q = configuration(turn)
            x, V = space["evaluate"](group, q)
            assert np.allclose(x, member.at(q).x, atol=1e-11)
            assert np.isclose(V, member.at(q).V, rtol=1e-9)


def test_the_example_of_the_documentation_runs():
    (code,) = re.findall(r"```python\n(.*?)```", DOCS.with_name("gmp_python.md").read_text(), re.DOTALL)
    space = {}
    exec(code, space)
    assert space["nodes"].shape == (75, 101) and space["motion"].warnings == ()


def test_the_job_of_the_documentation_makes_the_member_of_its_mechanism(tmp_path, monkeypatch, capsys):
    text = DOCS.read_text()
    (job,), (code,) = (re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("toml", "python job"))
    (tmp_path / "rod.toml").write_text(job)
    monkeypatch.chdir(tmp_path)
    run_job(load_job("rod.toml"))
    space = {}
    exec(code, space)
    assert space["member"].size == 9 and "[" in capsys.readouterr().out
    (line,) = re.findall(r"^    morembs (evaluate .*)$", DOCS.read_text(), re.MULTILINE)
    assert morembs(*line.split(), folder=tmp_path).code == 0
    tip = space["simulate"](space["mechanism"], end=0.1, step=1e-3).q[-1][:2]
    # The rod falls as a rigid one does at first, with 3 g / 2 at its tip.
    assert tip[1] == pytest.approx(-0.75 * 9.81 * 0.1**2, rel=0.5)


def test_the_slider_crank_of_the_documentation_bends_as_the_full_model(tmp_path, monkeypatch, capsys):
    text = DOCS.read_text() + (PAGES / "background" / "gmp_figures.md").read_text()
    (job,), (code,) = (re.findall(rf"```{kind}\n(.*?)```", text, re.DOTALL) for kind in ("toml", "python slider-crank"))
    assert len(code.splitlines()) <= 30
    (tmp_path / "rod.toml").write_text(job)
    monkeypatch.chdir(tmp_path)
    space = {}
    exec(code, space)
    assert "0.124 of its length" in capsys.readouterr().out
    reference = slider_crank.full(elements=(6, 12), step=2e-3, end=0.7)
    gap = space["deflection"][:701:2] - reference.deflection
    assert np.sqrt(np.mean(gap**2)) < 0.01 * np.abs(reference.deflection).max()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("errors", lambda a: np.array([np.inf, 0.0]), ("file", "damaged.h5", "/rod/parameterised/errors")),
        ("reach", lambda a: np.nan, ("file", "damaged.h5", "/reach")),
        ("squares", lambda a: a.astype(complex), ("file", "damaged.h5", "/squares", "complex128")),
        ("errors", lambda a: a[:1], ("file", "damaged.h5", "/errors")),
        ("translations", lambda a: a.T, ("file", "damaged.h5", "/translations")),
        ("U", lambda a: a.ravel(), ("file", "damaged.h5")),
    ],
)
def test_numbers_that_no_member_has_are_named(file, tmp_path, name, change, words):
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(file.read_bytes())
    with h5py.File(damaged, "a") as opened:
        # Other writers may leave it out.
        del opened["checksums"]
        group = opened["bodies/rod/parameterised"]
        value = group[name][()]
        del group[name]
        group[name] = change(value)
    with refusal(*words):
        read_members(damaged)


def test_damaged_files_are_named(file, tmp_path):
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(file.read_bytes())
    with h5py.File(damaged, "a") as opened:
        group = opened["bodies/rod/parameterised"]
        table = group["table"][:, :, :-1]
        del group["table"]
        group["table"] = table
    with refusal("file", "damaged.h5", "/table", "7"):
        read_members(damaged)
    with h5py.File(damaged, "a") as opened:
        del opened["bodies/rod/parameterised/M"]
    with refusal("file", "damaged.h5", "/bodies/rod/parameterised/M"):
        read_members(damaged)
    with h5py.File(damaged, "a") as opened:
        del opened["bodies/rod/parameterised"]
    with refusal("file", "damaged.h5"):
        read_members(damaged)
    with refusal("file", "none.h5"):
        read_members(tmp_path / "none.h5")
    with refusal("missing", "members"):
        write_members(tmp_path / "new.h5", {})
    with refusal("value", "name", "a/b"):
        write_members(tmp_path / "new.h5", {"a/b": None})
