"""What a report says of what changed since an earlier one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.cli.terminal import Done, each_job
from morembs.app.jobs.order import Order
from morembs.app.pages.against import BodyState, ChangeLimits, PartState, changes_of
from morembs.app.pages.kept import KeptParts, seal_content
from morembs.app.pages.page import ReportRequest
from morembs.base.errors import InputError
from morembs.version import VERSION
from tests.support import decks
from tests.support.refusals import refusal

RUNNER = CliRunner()


def body(hz: float = 100.0, limit: float | None = 0.01, order: int = 12, certified: bool = True) -> BodyState:
    return BodyState(order=order, frequencies_hz=[50.0, hz], limit=limit, certified=certified)


def part(state: str = "done", mass: float = 2.0, seconds: float = 10.0, **bodies: BodyState) -> PartState:
    return PartState(name="rod", output=None, state=state, mass=mass, seconds=seconds, bodies=bodies)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (part(cb=body()), part(cb=body()), []),
        (part(cb=body()), part(cb=body(100.05)), [("frequencies", False)]),
        (part(cb=body()), part(cb=body(100.2)), [("frequencies", True)]),
        (part(cb=body()), part(cb=body(99.8)), [("frequencies", True)]),
        (part(mass=2.0), part(mass=2.001), [("mass", False)]),
        (part(mass=2.0), part(mass=1.99), [("mass", True)]),
        (part(cb=body()), part(cb=body(limit=0.0105)), [("error", False)]),
        (part(cb=body()), part(cb=body(limit=0.02)), [("error", True)]),
        # Smaller is better, unknown is worse.
        (part(cb=body()), part(cb=body(limit=0.001)), [("error", False)]),
        (part(cb=body()), part(cb=body(limit=None)), [("error", True)]),
        (part(cb=body()), part(cb=body(limit=None, certified=False)), [("error", True)]),
        (part(cb=body(order=12)), part(cb=body(order=14)), [("order", False)]),
        (part(seconds=10.0), part(seconds=14.0), []),
        (part(seconds=10.0), part(seconds=16.0), [("time", True)]),
        (part(seconds=10.0), part(seconds=4.0), [("time", False)]),
        # Of short jobs nothing is said.
        (part(seconds=0.1), part(seconds=0.9), []),
        (part(cb=body()), part("failed"), [("state", True)]),
        (part("failed"), part(cb=body()), [("state", False), ("body", False)]),
        (part(cb=body(), worse=body()), part(cb=body()), [("body", True)]),
    ],
)
def test_what_is_red(old: PartState, new: PartState, told: list[tuple[str, bool]]) -> None:
    assert [(change.what, change.beyond) for change in changes_of(old, new, ChangeLimits())] == told


def test_a_change_tells_its_share() -> None:
    """Also of a body without elastic modes, and where frequencies change too."""
    still = BodyState(order=6, frequencies_hz=[], limit=0.01, certified=True)
    [error] = changes_of(part(cb=still), part(cb=replace(still, limit=0.02)), ChangeLimits())
    assert (error.share, error.words) == (pytest.approx(1.0), "1.00e-02 -> 2.00e-02 (+100 %)")
    both = changes_of(part(cb=body()), part(cb=body(101.0, 0.03)), ChangeLimits())
    assert [change.share for change in both] == [pytest.approx(0.01), pytest.approx(2.0)]


def test_numbers_next_to_zero_are_red_and_have_no_share() -> None:
    """A share beyond all numbers has no place in the JSON of a report."""
    least = body(5e-324, 5e-324)
    told = [*changes_of(part(mass=5e-324, seconds=5e-324, cb=least), part(cb=body()), ChangeLimits())]
    assert [change.what for change in told] == ["mass", "frequencies", "error", "time"]
    assert all(change.beyond and change.share is None and "%" not in change.words for change in told)


def test_tolerances_are_given_by_name() -> None:
    limits = ChangeLimits.of("frequencies=0.01, time=2")
    assert (limits.frequencies, limits.time, limits.mass) == (0.01, 2.0, ChangeLimits().mass)
    assert [c.beyond for c in changes_of(part(cb=body()), part(cb=body(100.9)), limits)] == [False]
    for wrong in ("frequency=1", "mass=-1", "mass=x", "error=nan"):
        with refusal("value", "within", "NAME", "NUMBER"):
            ChangeLimits.of(wrong)


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two parts in two nights: one of them has grown by 1 % meanwhile, one is gone and another came."""
    root = tmp_path_factory.mktemp("nights")
    for night, parts in (
        ("old", {"<b>rod": 10.0, "same": 10.0, "gone": 10.0}),
        ("new", {"<b>rod": 10.1, "same": 10.0, "came": 10.0}),
    ):
        for name, size in parts.items():
            (root / night / name).mkdir(parents=True)
            job = decks.folder(root / night / name, {}, decks.deck(decks.BEAM[:8], size))
            job.rename(job.with_name(f"{name}.toml"))
        done = RUNNER.invoke(cli.app, ["batch", str(root / night), "--report", str(root / night / "r.html"), "-q"])
        assert done.exit_code == 0, done.stderr
    return root


def report_of(nights: Path, *more: str) -> tuple[str, dict, str]:
    """Page, data and standard error of the second night's report."""
    page = nights / "new" / "again.html"
    done = RUNNER.invoke(cli.app, ["batch", str(nights / "new"), "--report", str(page), *more])
    assert done.exit_code == 0, done.stderr
    return page.read_text(), json.loads(page.with_suffix(".json").read_text()).get("against"), done.stderr


@pytest.mark.parametrize("old", ["r.html", "r.json", "batch.manifest"])
def test_a_report_says_what_changed_since_the_last_one(nights: Path, old: str) -> None:
    # Machines are as fast as they are.
    text, told, said = report_of(nights, "--against", str(nights / "old" / old), "--within", "time=100")
    assert f"against {old}: 1 of 3 parts beyond the tolerances, 0 changed within them, 1 new, 1 gone" in said
    assert told["new"] == ["came"] and told["gone"] == ["gone"] and told["within"]["mass"] == 1e-3
    [rod] = [changes for changes in told["changes"] if changes]
    shares = {change["what"]: change["share"] for change in rod if change["what"] != "time"}
    # A cube law for the mass; lengths lower all frequencies.
    assert shares["mass"] == pytest.approx(1.01**3 - 1) and shares["frequencies"] == pytest.approx(
        1 / 1.01 - 1, rel=1e-6
    )
    assert 'class="beyond">mode' in text and "&lt;b&gt;rod</a></td>" in text and "<b>rod" not in text
    assert "New: came" in text and "Gone: gone" in text


def test_what_is_within_the_tolerances_is_not_red(nights: Path) -> None:
    old = str(nights / "old" / "r.html")
    text, told, said = report_of(nights, "--against", old, "--within", "frequencies=0.02,mass=0.04,time=100")
    assert "0 of 3 parts beyond the tolerances, 1 changed within them" in said
    assert not any(change["beyond"] for changes in told["changes"] for change in changes)
    assert 'class="beyond">' not in text and "Within the tolerances" in text


def test_last_nights_report_may_be_the_one_that_is_replaced(nights: Path) -> None:
    page = nights / "new" / "again.html"
    report_of(nights)
    _, told, _ = report_of(nights, "--against", str(page))
    assert told["file"] == "again.html" and not any(told["changes"])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("hello", "has no data of a report; expected a report (.html or .json)"),
        ('{"format": "morembs-report", "version": 9, "parts": []}', "has the format version 9; this morembs reads 1"),
        (
            '{"format": "morembs-report", "version": 1, "parts": [{"name": "x", "state": "done", "seconds": "z"}]}',
            "is damaged",
        ),
        (
            '{"format": "morembs-report", "version": 1, "parts": [{"name": "x", "state": "done", "seconds": 1e999, '
            '"body_file": {"bodies": {"cb": {"order": 1e999, "frequencies_hz": [], "limits": {}, "measure": ""}}}}]}',
            "is damaged",
        ),
        ('{"format": "morembs-report", "version": 1, "parts": [{"name": "x", "seconds": NaN}]}', "has no data of a"),
        ('{"event": "begun", "format": "morembs-batch", "version": 1}\n{"event": 3\n', "cannot be read in line 2"),
    ],
)
def test_other_files_are_refused_before_anything_runs(nights: Path, tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "old.html").write_text(content)
    job = decks.folder(tmp_path)
    arguments = ["reduce", str(job), "--report", str(tmp_path / "r.html"), "--against", str(tmp_path / "old.html")]
    done = RUNNER.invoke(cli.app, arguments)
    assert done.exit_code == 2 and said in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "part.h5").exists()


def test_checksums_of_another_type_keep_nothing(tmp_path: Path) -> None:
    """Old reports may hold anything, also what was sealed anew."""
    content = seal_content({"sha256": [["a"]], "bodies": {}})
    document = {"format": "morembs-report", "version": 1, "morembs_version": VERSION}
    (tmp_path / "old.json").write_text(json.dumps({**document, "parts": [{"name": "x", "body_file": content}]}))
    assert KeptParts([tmp_path / "old.json"]).content("a") is None


def test_a_report_that_is_not_there_is_told_as_such(tmp_path: Path) -> None:
    job = str(decks.folder(tmp_path))
    done = RUNNER.invoke(cli.app, ["reduce", job, "--report", str(tmp_path / "r.html"), "--against", "none.html"])
    said = done.stderr.replace("\n", " ")
    assert done.exit_code == 2 and "none.html cannot be read as a report (No such file or directory)" in said
    assert "damaged" not in said


def test_reports_are_among_the_files_that_were_written(tmp_path: Path) -> None:
    job, page = str(decks.folder(tmp_path)), str(tmp_path / "r.html")
    for arguments in (["reduce", job, "--report", page], ["batch", job, "--report", page]):
        done = RUNNER.invoke(cli.app, arguments)
        assert done.stdout.splitlines()[-1] == f"written: {page}", done.stderr
    done = RUNNER.invoke(cli.app, ["reduce", job, "--report", page, "--json"])
    assert json.loads(done.stdout)[0]["written"] and f"written: {page}" not in done.stdout


def test_options_that_need_others_say_so(tmp_path: Path) -> None:
    job = str(decks.folder(tmp_path))
    for arguments, said in (
        (["--against", "x.html"], "it needs --report FILE.html"),
        (["--report", str(tmp_path / "r.html"), "--within", "mass=1"], "it needs --against OLD.html"),
    ):
        done = RUNNER.invoke(cli.app, ["reduce", job, *arguments])
        assert done.exit_code == 2 and said in done.stderr


def test_parts_stand_in_the_order_that_was_asked_for(tmp_path: Path) -> None:
    """An assembly that is asked for first runs after its part, and stands first."""
    ran = []

    def work(path: Path, progress: object) -> Done:
        ran.append(path.stem)
        raise InputError("not today")

    request, order = ReportRequest.of(tmp_path / "r.html"), Order(refused={}, parts={0: (1,)}, sequence=(1, 0))
    with pytest.raises(typer.Exit):
        each_job([tmp_path / "whole.toml", tmp_path / "part.toml"], False, work, True, order, request)
    assert ran == ["part"]
    data = json.loads((tmp_path / "r.json").read_text())
    assert [part["name"] for part in data["parts"]] == ["whole", "part"]
    assert ["not today" in part["message"] for part in data["parts"]] == [False, True]
