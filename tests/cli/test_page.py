"""The report: what it says, that it needs nothing else, and that a browser shows and sorts it."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.cli.page import Entry, write_report
from morembs.app.jobs.compare import recommended
from tests.support import decks

RUNNER = CliRunner()
BROWSER = shutil.which("chromium")


class Page(HTMLParser):
    """The links, sources and ids of a page, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.sources: list[str] = []
        self.ids: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.links += [given["href"]] if "href" in given else []
        self.sources += [given["src"]] if "src" in given else []
        self.ids += [given["id"]] if "id" in given else []

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two parts, one of which failed."""
    folder = tmp_path_factory.mktemp("report")
    for name, cells in (('a <b>&"x', decks.BEAM[:12]), ("long", decks.BEAM)):
        (folder / name).mkdir()
        job = {"certify": "band_hz = [0, 4000]", "reduce2": 'name = "worse"\nmethod = "guyan"'}
        decks.folder(folder / name, job, decks.deck(cells)).rename(folder / name / f"{name}.toml")
    (folder / "wrong.toml").write_text(decks.job({"model": 'mesh = "nothing.inp"\nunits = "m-kg-s"'}))
    jobs = [folder / 'a <b>&"x' / 'a <b>&"x.toml', folder / "wrong.toml", folder / "long" / "long.toml"]
    path = folder / "night.html"
    done = RUNNER.invoke(cli.app, ["reduce", *map(str, jobs), "--report", str(path), "-q"])
    assert done.exit_code == 2, done.stderr
    return path


def test_a_report_says_what_was_made_and_needs_no_other_file(report: Path) -> None:
    text = report.read_text()
    page = Page(text)
    assert page.sources and all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not re.search(r"https?://|@import|url\(", text)
    for link in page.links:
        assert link[1:] in page.ids if link.startswith("#") else (report.parent / unquote(link)).is_file()
    words = " ".join(page.texts)
    assert 'a <b>&"x' in page.texts and "nothing.inp" in words and "craig-bampton" in words and "proven" in words
    assert "damping of 1 % of critical assumed beside its own" in words
    # Stages stand in the order in which they ran.
    turns = [page.texts.index(name) for name in ("couple", "factorise", "certify", "compare", "deliver")]
    assert turns == sorted(turns)
    assert len(text) < 3 * 500_000  # three parts


def test_the_body_that_is_shown_is_the_best(report: Path) -> None:
    assert "modes of cb of long" in report.read_text()
    # Both bodies in the row: the one with the smallest error is the one that was asked for first.
    assert '<a href="#part-3">long</a><br><span class="soft">cb</span>' in report.read_text()
    assert recommended({"a": None, "b": 0.2, "c": 0.1}) == "c"
    assert recommended({"a": None, "b": None}) == "a"


def test_a_body_that_is_gone_is_a_failure_in_the_report(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(path, [Entry(name="x", job="x.toml", output=str(tmp_path / "x.h5"), state="done")], "x")
    assert "no such file" in path.read_text()


@pytest.mark.parametrize(("name", "said"), [("night.txt", "ends in .html"), ("nowhere/night.html", "does not exist")])
def test_where_no_report_can_be_written_nothing_is_run(tmp_path: Path, name: str, said: str) -> None:
    job = decks.folder(tmp_path)
    done = RUNNER.invoke(cli.app, ["reduce", str(job), "--report", str(tmp_path / name)])
    assert done.exit_code == 2 and said in done.stderr and not (tmp_path / "part.h5").exists()


def browsed(text: str, clicks: Sequence[str], folder: Path) -> tuple[list[str], str]:
    """Numbers of the parts that a browser shows at first and after each script, and what its console says."""
    rows = "Array.from(document.links).map(link => link.hash).filter(hash => hash.startsWith('#part-'))"
    note = f"shown.push({rows}.map(hash => hash.slice(6)).join(''));"
    seen = (
        "var e = document.createElement('pre'); e.id = 'shown'; e.textContent = shown.join(); document.body.append(e);"
    )
    script = "var shown = [];" + note + "".join(click + note for click in clicks) + seen
    page = folder / "page.html"
    page.write_text(text.replace("</body>", f"<script>{script}</script></body>"))
    done = subprocess.run(
        [
            str(BROWSER),
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--enable-logging=stderr",
            "--v=0",
            f"--user-data-dir={folder / 'profile'}",
            "--dump-dom",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    shown = re.search(r'<pre id="shown">(.*?)</pre>', done.stdout)
    faults = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)
    return shown[1].split(",") if shown else [], faults


def by(column: str) -> str:
    """A click on the head of a column."""
    heads = "Array.from(document.querySelectorAll('#parts th'))"
    return f"{heads}.find(head => head.textContent.startsWith('{column}')).click();"


@pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")
def test_a_browser_shows_the_report_and_sorts_it(report: Path, tmp_path: Path) -> None:
    def shown(clicks: Sequence[str], most: int = 1000) -> tuple[list[str], str]:
        text = report.read_text()
        assert "most = 1000" in text
        return browsed(text.replace("most = 1000", f"most = {most}"), clicks, tmp_path)

    dofs, more = by("dofs"), "document.getElementById('more').click();"
    wanted = "var f = document.getElementById('filter'); f.value = 'LONG'; f.dispatchEvent(new Event('input'));"
    # Failed parts come last.
    assert shown([dofs, dofs, wanted]) == (["123", "132", "312", "3"], "")
    # Very many rows are shown only when they are asked for.
    assert shown([dofs, more], 2)[0] == ["12", "13", "132"]
    assert shown([wanted], 1)[0] == ["1", "3"]


@pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")
def test_parts_without_a_certificate_and_long_numbers_are_sorted_as_numbers(tmp_path: Path) -> None:
    """By errors, those without one last; by the first elastic frequency, 1.27e+05 Hz after 25,426 and 88,424."""
    entries = []
    certify = {"certify": "band_hz = [0, 4000]"}
    for name, cells, size, job in (
        ("short", decks.BEAM[:8], 10.0, {**certify, "reduce": 'name = "g"\nmethod = "guyan"'}),
        ("bare", decks.BEAM, 10.0, {}),
        ("small", decks.BEAM, 2.0, certify),
    ):
        (tmp_path / name).mkdir()
        decks.folder(tmp_path / name, job, decks.deck(cells, size))
        done = RUNNER.invoke(cli.app, ["reduce", str(tmp_path / name / "job.toml"), "-q"])
        assert done.exit_code == 0, done.stderr
        output = next((tmp_path / name).glob("*.h5"))
        entries.append(Entry(name=name, job=f"{name}.toml", output=str(output), state="done"))
    write_report(tmp_path / "report.html", entries, "x")
    text = (tmp_path / "report.html").read_text()
    clicks = [by("error"), by("error"), by("elastic")]
    assert browsed(text, clicks, tmp_path)[0][1:] == ["312", "132", "213"]
