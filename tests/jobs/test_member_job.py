"""Planar members from jobs: their files hold the members of morembs.dynamics.gmp, and what is wrong is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.stages.member import MEMBERS
from morembs.base import progress
from morembs.dynamics.gmp import AngleRange, Parameterised, ReducedMember
from morembs.dynamics.gmp.stored import read_members, read_origin
from morembs.dynamics.nonlinear import PlanarBeam, Section
from morembs.storage.checksums import whole_sum
from studies import flexible_slider_crank as slider_crank
from tests.support.processes import morembs
from tests.support.refusals import Refusal, refusal

ROD = """
[member]
length = 0.304
elements = 6
young = 2e6
density = 2770.0
area = 7.854e-5
second_moment = 4.909e-10

[[reduce]]
name = "rod"
method = "global-modal-parameterisation"
formulation = "membrane"
modes = 3
reach = 0.7
points_per_angle = 5

[output]
path = "rod.h5"
"""


def write(folder: Path, text: str = ROD, name: str = "rod.toml") -> Path:
    (folder / name).write_text(text)
    return folder / name


def made(folder: Path, text: str) -> Parameterised:
    """The first member of the file of a job."""
    return next(iter(read_members(run_job(load_job(write(folder, text))).job.output).values()))


def rod(**keys: float) -> PlanarBeam:
    return PlanarBeam.straight(0.304, 6, Section.of(E=2e6, A=7.854e-5, I=4.909e-10, density=2770.0, **keys))


def agree(found: Parameterised, expected: Parameterised, tolerance: float = 1e-12) -> None:
    assert (found.formulation, found.count) == (expected.formulation, expected.count)
    for name in ("reach", "length", "Psi", "squares", "peaks", "H0"):
        a, b = np.asarray(getattr(found, name)), np.asarray(getattr(expected, name))
        assert np.abs(a - b).max() <= tolerance * np.abs(b).max(), name
    for name in ("table", "energy"):
        a, b = getattr(found, name).coefficients, getattr(expected, name).coefficients
        assert a.shape == b.shape and np.abs(a - b).max() <= tolerance * np.abs(b).max(), name


def test_the_slider_crank_moves_with_members_of_jobs_as_with_those_of_python(tmp_path: Path) -> None:
    sizes, members = ((2, slider_crank.REACH_CRANK), (3, slider_crank.REACH_ROD)), []
    lengths, moduli = (slider_crank.CRANK, slider_crank.ROD), (slider_crank.E_CRANK, slider_crank.E_ROD)
    for (modes, reach), length, young, elements in zip(
        sizes, lengths, moduli, slider_crank.QUICK_ELEMENTS, strict=True
    ):
        text = (
            ROD.replace("0.304", str(length))
            .replace("2e6", str(young))
            .replace("elements = 6", f"elements = {elements}")
        )
        text = text.replace("modes = 3", f"modes = {modes}").replace("reach = 0.7", f"reach = {reach}")
        text = text.replace("points_per_angle = 5", f"points_per_angle = {slider_crank.POINTS}")
        members.append(ReducedMember.of(made(tmp_path, text)))
    bars = slider_crank.bars(1.0, slider_crank.QUICK_ELEMENTS)
    own = [
        ReducedMember(bar, modes=modes, formulation="membrane", reach=reach, points_per_angle=slider_crank.POINTS)
        for bar, (modes, reach) in zip(bars, sizes, strict=True)
    ]
    for found, expected in zip(members, own, strict=True):
        agree(found.data, expected.data)
    run, expected_run = (slider_crank.run(*pair, end=0.1, step=1e-3) for pair in (members, own))
    assert np.abs(expected_run.deflection).max() > 1e-5
    gap = np.abs(run.deflection - expected_run.deflection).max()
    assert gap <= 1e-12 * slider_crank.ROD


@pytest.mark.parametrize(
    "member",
    [
        "length = 304.0\nelements = 6\nyoung = 2.0\ndensity = 2.77e-9\narea = 78.54\nsecond_moment = 490.9",
        "length = 304.0\nelements = 6\nsection = { EA = 157.08, GA = 51.78461538461538, EI = 981.8, "
        "mass = 2.175558e-7, rotary = 1.359793e-6 }",
    ],
)
def test_numbers_are_in_the_declared_units(tmp_path: Path, member: str) -> None:
    head, tail = ROD.index("length"), ROD.index("[[reduce]]")
    text = f'[model]\nunits = "mm-t-s"\n{ROD[:head]}{member}\n\n{ROD[tail:]}'
    agree(made(tmp_path, text), made(tmp_path, ROD), 1e-8)


def test_a_rectangle_and_an_envelope_along_points(tmp_path: Path) -> None:
    line = [(0.1 * np.sin(t), 0.1 * (1 - np.cos(t)), t) for t in np.linspace(0, 0.7, 6)]
    nodes = [[float(1e3 * x), float(1e3 * y), float(t)] for x, y, t in line]
    text = f"""
        model = {{ units = "mm-t-s" }}
        member = {{ points = {nodes}, young = 50.0, density = 1.1e-9, width = 20.0, height = 6.0 }}
        reduce = [{{ method = "global-modal-parameterisation", modes = 1, reach = {{ moment = 50.0 }} }}]
        output = {{ path = "arc.h5" }}
    """
    beam = PlanarBeam.along(line, Section.of(E=5e7, A=1.2e-4, I=3.6e-10, density=1100))
    expected = ReducedMember(beam, modes=1, reach=AngleRange(moment=0.05))
    assert expected.data.reach < 0.5
    agree(made(tmp_path, text), expected.data, 1e-7)


def test_the_command_line_checks_reduces_and_shows(tmp_path: Path) -> None:
    write(tmp_path)
    checked = morembs("check", "rod.toml", "--json", folder=tmp_path)
    forecast = json.loads(checked.output)[0]
    assert (forecast["dofs"], forecast["elements"], forecast["interface_nodes"]) == (21, 6, {"start": 1, "end": 1})
    assert 0 < forecast["reduction_seconds"]["rod"] < 60 and not (tmp_path / "rod.h5").exists()
    assert "to run it: morembs reduce rod.toml" in morembs("check", "rod.toml", folder=tmp_path).output
    done = morembs("reduce", "rod.toml", "--report", "rod.html", folder=tmp_path)
    page = (tmp_path / "rod.html").read_text()
    assert "9</td>" in page and "tables of 5 points per angle" in page and page.count("base64,iVBOR") == 2
    assert "--body rod --to fmu" in page and "source beam" in page and "written by morembs" in page
    assert done.code == 0 and "21 degrees of freedom" in done.output and "rod.h5" in done.output
    assert "global modal parameterisation" in done.output
    shown = morembs("info", "rod.h5", folder=tmp_path)
    assert "rod: membrane, 3 bending modes and two frames, length 0.304 m, end angles to 0.7 rad" in shown.output
    told = json.loads(morembs("info", "rod.h5", "--json", folder=tmp_path).output)[0]
    member = told["members"]["rod"]
    assert (member["coordinates"], member["points"]) == (9, 5) and 0 < member["error"] < 0.02
    refused = morembs("modes", "rod.toml", folder=tmp_path)
    assert refused.code == 2 and "[member]" in refused.errors
    batch = morembs("batch", ".", "--quiet", "--report", "batch.html", folder=tmp_path)
    page = (tmp_path / "batch.html").read_text()
    assert batch.code == 0 and "0 failed" in page and "global modal parameterisation, membrane" in page


def test_a_result_says_what_it_is_and_the_same_job_writes_the_same_bytes(tmp_path: Path) -> None:
    result = run_job(load_job(write(tmp_path)))
    assert result.bodies == () and result[MEMBERS]["rod"].modes == 3 and "rod.toml" in repr(result)
    before = whole_sum(tmp_path / "rod.h5")
    run_job(load_job(tmp_path / "rod.toml", ["solver.workers=2"]))
    assert whole_sum(tmp_path / "rod.h5") == before
    recipe, provenance = read_origin(tmp_path / "rod.h5")
    assert recipe["member"]["young"] == 2e6 and recipe["reduce"][0]["name"] == "rod"
    assert provenance["job"] == ROD and provenance["equilibria"]["rod"]["tables"] == 25
    assert provenance["seconds"]["reduce rod"] > 0 and provenance["changes"] == [b"solver.workers=2"]


def test_a_run_that_was_ended_goes_on_from_its_equilibria(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ended by the listener after some equilibria, of a job and of one that was changed since."""
    whole = made(tmp_path, ROD)
    (tmp_path / "rod.h5").unlink()

    class Ender:
        def stage(self, name: str) -> None: ...

        def update(self, text: str) -> None:
            if text.startswith("equilibria: 4"):
                raise KeyboardInterrupt

    job = load_job(write(tmp_path))
    with pytest.raises(KeyboardInterrupt), progress.listening(Ender()):
        run_job(job)
    left = list(tmp_path.glob("*.equilibria"))
    assert len(left) == 1 and not (tmp_path / "rod.h5").exists()
    kept = left[0].read_bytes()
    other = run_job(load_job(tmp_path / "rod.toml", ["reduce.reach=0.6"]))
    assert other.document()["members"]["rod"]["restored"] == 0 and not list(tmp_path.glob("*.equilibria"))
    left[0].write_bytes(kept)
    result = run_job(job)
    report = result.document()["members"]["rod"]
    assert report["restored"] >= 3 and report["restored"] + report["solved"] < 25
    agree(next(iter(read_members(job.output).values())), whole, 0.0)
    assert not list(tmp_path.glob("*.equilibria"))


def test_reductions_whose_names_differ_by_a_sign_keep_equilibria_of_their_own(tmp_path: Path) -> None:
    head, table = ROD.replace('"rod"\n', '"a+b"\n').split("[output]")[0], ROD[ROD.index("[[reduce]]") :]
    second = table.replace('"rod"\n', '"a.b"\n').replace("reach = 0.7", "reach = 0.5")
    result = run_job(load_job(write(tmp_path, head + second)))
    members = result.document()["members"]
    assert {name: member["restored"] for name, member in members.items()} == {"a+b": 0, "a.b": 0}
    assert [member["reach"] for member in members.values()] == [0.7, 0.5]


def test_a_text_may_begin_with_the_mark_of_its_encoding(tmp_path: Path) -> None:
    path = tmp_path / "rod.toml"
    path.write_text(ROD, encoding="utf-8-sig")
    assert load_job(path).text == ROD


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("elements = 6", "", ("value", "points")),
        ("elements = 6", "points = [[0, 0, 0], [1, 0, 0]]", ("value", "points")),
        ("length = 0.304", "length = -1.0", ("value", "length", "-1.0")),
        ("reach = 0.7", "reach = 4", ("value", "reach", "4")),
        ("reach = 0.7", "reach = true", ("value", "reach")),
        ("density = 2770.0", "", ("missing", "section", "second_moment")),
        ("area = 7.854e-5", "width = 1.0", ("missing", "section", "second_moment")),
        ("young = 2e6", "section = { EA = 1, GA = 1, EI = 1, mass = 1 }", ("conflict", "section")),
        ("modes = 3", "", ("missing", "modes")),
        ("modes = 3", "mode = 3", ("unknown", "mode", "modes")),
        ("modes = 3", "modes = -3", ("value", "modes", "-3")),
        ('"membrane"', '"shell"', ("value", "formulation", "shell")),
        ("reach = 0.7", "reach = 4.0", ("value", "reach")),
        ("reach = 0.7", "reach = { torque = 1.0 }", ("unknown", "torque")),
        ("reach = 0.7", "reach = { angle = 0.5, load = 1.0 }", ("value", "envelope")),
        ('"global-modal-parameterisation"', '"guyan"', ("conflict", "method", "guyan")),
        ("[output]", "[certify]\nband_hz = [1, 2]\n[output]", ("conflict", "certify", "[certify]", "[member]")),
        ("[output]", '[model]\nmesh = "a.msh"\n[output]', ("conflict", "mesh", "[model]", "[member]")),
        ("[output]", '[output]\nnodes = "skin"', ("conflict", "nodes", "[output]", "[member]")),
        ("[member]", "[remember]", ("unknown", "remember")),
    ],
)
def test_what_no_member_can_be_made_of_is_named(tmp_path: Path, old: str, new: str, words: Refusal) -> None:
    assert old in ROD
    with refusal(*words):
        load_job(write(tmp_path, ROD.replace(old, new)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("reduce.points_per_angle=2", ("result", "points", "0.7")),
        ("reduce.reach={ moment = 1e9 }", ("value", "reach", "1e+09")),
        ("member.length=1e300", ("value", "member")),
    ],
)
def test_what_the_tables_cannot_reach_names_the_reduction(tmp_path: Path, change: str, words: Refusal) -> None:
    job = load_job(write(tmp_path), [change])
    with refusal(*words, "[[reduce]]", "'rod'"):
        run_job(job)
    assert not (tmp_path / "rod.h5").exists()
