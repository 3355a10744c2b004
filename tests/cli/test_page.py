"""The report: what it says, that it needs nothing else, and that a browser shows and sorts it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.compare import recommend_body
from morembs.app.pages.kept import seal_content, sum_of
from morembs.app.pages.page import write_report
from morembs.app.pages.parts import Entry
from morembs.app.report.words import clean_center
from morembs.body.file import read_body
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
    assert page.sources and all(re.match(r"data:image/(png|webp);base64,", source) for source in page.sources)
    assert not re.search(r"https?://|@import|url\((?!#)", text)
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
    assert recommend_body({"a": None, "b": 0.2, "c": 0.1}) == "c"
    assert recommend_body({"a": None, "b": None}) == "a"


def test_a_body_that_is_gone_is_a_failure_in_the_report(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(path, [Entry(name="x", job="x.toml", output=str(tmp_path / "x.h5"), state="done")], "x")
    assert "no such file" in path.read_text()


@pytest.mark.parametrize(("name", "said"), [("night.txt", "ends in .html"), ("nowhere/night.html", "does not exist")])
def test_where_no_report_can_be_written_nothing_is_run(tmp_path: Path, name: str, said: str) -> None:
    job = decks.folder(tmp_path)
    done = RUNNER.invoke(cli.app, ["reduce", str(job), "--report", str(tmp_path / name)])
    assert done.exit_code == 2 and said in done.stderr and not (tmp_path / "part.h5").exists()


def test_its_data_is_beside_it_as_json(report: Path) -> None:
    data = json.loads(report.with_suffix(".json").read_text())
    assert (data["format"], data["version"]) == ("morembs-report", 1)
    named = {part["name"]: part for part in data["parts"]}
    assert list(named) == ['a <b>&"x', "wrong", "long"]
    assert named["wrong"]["state"] == "failed" and "nothing.inp" in named["wrong"]["message"]
    told = named["long"]["body_file"]
    body = read_body(report.parent / unquote(named["long"]["output"])).bodies["cb"]
    assert told["shown"] == "cb" and list(told["bodies"]) == ["cb", "worse"]
    assert told["bodies"]["cb"]["asked"] == {"modes": 4} and told["bodies"]["cb"]["order"] == 16
    assert told["bodies"]["cb"]["frequencies_hz"] == body.frequencies_hz[6:26].tolist()
    assert told["bodies"]["cb"]["limits"]["envelope"] == body.certificate.limits["envelope"].upper
    assert told["sha256"] == hashlib.sha256((report.parent / "long" / "part.h5").read_bytes()).hexdigest()
    assert "".join(part["name"] for part in data["parts"]) not in report.read_text()  # names are escaped there too


def test_frequencies_have_equal_digits_and_reductions_say_what_was_asked_for(report: Path) -> None:
    text = report.read_text()
    page = Page(text)
    [shown] = [words for words in page.texts if words.startswith("25,426.4")][:1]
    assert {len(number.partition(".")[2]) for number in shown.split(", ")} == {1}
    assert "118,146.8" in text and "modes = 4" in " ".join(page.texts)


def test_files_to_take_are_linked(report: Path) -> None:
    done = RUNNER.invoke(cli.app, ["export", str(report.parent / "long/part.h5"), "--to", "op4", "--body", "cb"])
    assert done.exit_code == 0, done.stderr
    path = report.with_name("again.html")
    write_report(path, [entry_of(report.parent / "long/part.h5")], "x")
    assert '<a href="long/part_cb.op4" download>part_cb.op4</a> <span class="soft">op4</span>' in path.read_text()


def entry_of(body: Path, state: str = "unchanged") -> Entry:
    return Entry(name=body.parent.name, job=str(body.with_suffix(".toml")), output=str(body), state=state)


def test_pictures_and_words_on_unchanged_bodies_are_kept(report: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the last report holds of the same file is taken from it; a damaged report, or another file, is not."""
    path, body = report.with_name("kept.html"), report.parent / "long" / "part.h5"
    write_report(path, [entry_of(body)], "x")
    first, drawn = path.read_text(), []
    figures = Figure.__init__

    def counted(self: Figure, *args: object, **options: object) -> None:
        drawn.append(1)
        figures(self, *args, **options)

    monkeypatch.setattr(Figure, "__init__", counted)
    write_report(path, [entry_of(body)], "x")
    assert not drawn and path.read_text() == first
    # Another file, with the name of one that is known.
    other = report.parent / 'a <b>&"x' / "part.h5"
    write_report(path, [replace(entry_of(other), name="long")], "x")
    assert len(drawn) == 3 and "58,949.2" in path.read_text()
    # Words of the old report that somebody changed are not believed.
    path.write_text(first.replace("25426.", "11111."))
    write_report(path, [entry_of(body)], "x")
    assert path.read_text() == first


def test_nothing_but_pictures_and_numbers_gets_out_of_an_old_report(report: Path) -> None:
    path, body = report.with_name("evil.html"), report.parent / "long" / "part.h5"
    write_report(path, [entry_of(body)], "x")
    first = path.read_text()
    for old in (
        re.sub(r"base64,[A-Za-z0-9+/=]+", 'base64,AAAA" onerror="alert(1)', first),
        # A picture that is another one, or is damaged, and numbers that JSON does not have.
        re.sub(r"base64,iVBORw0KGgo[A-Za-z0-9+/=]+", "base64,iVBORw0KGgoAAAA", first),
        re.sub(r'"mass_kg":[^,]+', '"mass_kg":NaN', first),
    ):
        assert old != first
        path.write_text(old)
        write_report(path, [entry_of(body)], "x")
        assert path.read_text() == first


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("shown",), "other"),
        (("mass_kg",), None),
        (("warnings",), 3),
        (("dofs",), 10**400),
        (("origin",), ["x"]),
        (("interfaces", "left"), None),
        (("bodies", "cb", "band_hz"), [[]]),
        (("bodies", "cb", "limits", "envelope"), "x"),
        (("bodies", "cb", "asked"), {"modes": {}}),
        (("stages", "read", "seconds"), True),
        (("stages", "read"), {}),
        (("center_of_mass_m", 0), "1e999"),
    ],
)
def test_wrong_values_with_their_checksums_do_not_get_into_a_page(
    report: Path, place: tuple[str | int, ...], value: object
) -> None:
    path, body = report.with_name("wrong.html"), report.parent / "long" / "part.h5"
    write_report(path, [entry_of(body)], "x")
    first, data = path.read_text(), path.with_suffix(".json")
    document = json.loads(data.read_text())
    at = document["parts"][0]["body_file"]
    del at["seal"]
    for key in place[:-1]:
        at = at[key]
    assert at[place[-1]] != value
    at[place[-1]] = value
    document["parts"][0]["body_file"] = seal_content(document["parts"][0]["body_file"])
    path.write_text(json.dumps(document).replace('"1e999"', "1e999"))
    write_report(path, [entry_of(body)], "x")
    assert path.read_text() == first


@pytest.mark.parametrize("value", ["NaN", "1e999", "[1", "[" * 10**5])
def test_charts_and_pictures_that_cannot_be_read_are_made_anew(report: Path, value: str) -> None:
    path, body = report.with_name("charts.html"), report.parent / "long" / "part.h5"
    write_report(path, [entry_of(body)], "x")
    first, picture = path.read_text(), "iVBORw0KGgoAA="

    def with_value(found: re.Match[str]) -> str:
        return f'{found[1]}:charts" data-sum="{sum_of(value)}">{value}</script>'

    old = re.sub(r'(data-key="[0-9a-f]{64}):charts" data-sum="[0-9a-f]{64}">[^<]*</script>', with_value, first)
    old = re.sub(
        r'(:row" data-sum=")[^"]*(" src="data:image/png;base64,)[^"]*', rf"\g<1>{sum_of(picture)}\2{picture}", old
    )
    assert picture in old and f">{value}</script>" in old
    path.write_text(old)
    write_report(path, [entry_of(body)], "x")
    assert path.read_text() == first


def test_names_that_are_no_utf_8_get_into_a_report(report: Path) -> None:
    """As linked files they are found by their bytes."""
    body = report.parent / os.fsdecode(b"p\xff# b.h5")
    body.write_bytes((report.parent / "long" / "part.h5").read_bytes())
    path = report.with_name("names.html")
    write_report(path, [replace(entry_of(body), name=body.stem)], body.stem)
    assert "p%FF%23%20b.h5" in Page(path.read_text(encoding="utf-8")).links


def browser(folder: Path) -> list[str]:
    """A browser without a window, with a profile of its own."""
    plain = ("--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0")
    return [str(BROWSER), *plain, f"--user-data-dir={folder / 'profile'}"]


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
    command = [*browser(folder), "--dump-dom", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
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


# Styles of what is asked for by a selector, in a frame of a width, as ``dump`` writes them.
MEASURE = """
var e = document.createElement('pre'); e.id = 'measured';
var img = document.querySelector('#parts td img').getBoundingClientRect();
e.textContent = [img.width, img.height, getComputedStyle(document.body).backgroundColor,
  document.documentElement.scrollWidth <= innerWidth].join(';');
document.body.append(e);
"""


def in_browser(text: str, script: str, folder: Path, width: int = 1400, options: Sequence[str] = ()) -> str:
    """The text of #measured that a ``script`` leaves in a page as wide as ``width``."""
    # The window of a browser has a least width; a frame has none, and its page goes by its width.
    (folder / "inner.html").write_text(text.replace("</body>", f"<script>{script}</script></body>"))
    tell = (
        "addEventListener('message', e => { var p = document.createElement('pre'); p.id = 'told'; "
        "p.textContent = e.data; document.body.append(p); });"
    )
    (folder / "outer.html").write_text(
        f'<!DOCTYPE html><body><script>{tell}</script><iframe src="inner.html" style="width:{width}px;height:900px">'
    )
    inner = (folder / "inner.html").read_text()
    post = "parent.postMessage(document.getElementById('measured').textContent, '*');"
    (folder / "inner.html").write_text(inner.replace("</body>", f"<script>{post}</script></body>"))
    done = subprocess.run(
        [*browser(folder), *options, "--virtual-time-budget=3000", "--dump-dom", (folder / "outer.html").as_uri()],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "CONSOLE" not in done.stderr, done.stderr
    told = re.search(r'<pre id="told">(.*?)</pre>', done.stdout)
    return told[1] if told else ""


@pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")
@pytest.mark.parametrize(("width", "size"), [(390, "64;40"), (820, "96;60"), (1400, "96;60")])
def test_thumbnails_have_a_size_at_all_widths_and_the_page_does_not_scroll(
    report: Path, tmp_path: Path, width: int, size: str
) -> None:
    assert in_browser(report.read_text(), MEASURE, tmp_path, width) == f"{size};rgb(255, 255, 255);true"


@pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")
def test_the_page_is_dark_where_the_reader_wants_it(report: Path, tmp_path: Path) -> None:
    dark = "--blink-settings=preferredColorScheme=0"
    assert "rgb(21, 24, 28)" in in_browser(report.read_text(), MEASURE, tmp_path, options=[dark])


@pytest.mark.skipif(BROWSER is None, reason="chromium is not installed")
def test_heads_are_sorted_by_keys_and_the_filter_hides_sections(report: Path, tmp_path: Path) -> None:
    script = """
    var said = [], heads = Array.from(document.querySelectorAll('#parts th button'));
    var dofs = heads.find(head => head.textContent === 'dofs'), f = document.getElementById('filter');
    var shown = () => Array.from(document.querySelectorAll('section')).filter(s => s.offsetParent !== null).length;
    dofs.focus(); said.push(document.activeElement === dofs && dofs.tabIndex === 0);
    // What a browser makes of Enter on a button is a click.
    dofs.click(); said.push(dofs.parentNode.getAttribute('aria-sort'));
    dofs.click(); said.push(dofs.parentNode.getAttribute('aria-sort'));
    said.push(shown());
    f.value = 'LONG'; f.dispatchEvent(new Event('input')); said.push(shown());
    // Before the page is printed nothing comes back.
    window.dispatchEvent(new Event('beforeprint')); said.push(shown());
    said.push(document.querySelectorAll('#parts tbody tr').length);
    var e = document.createElement('pre'); e.id = 'measured'; e.textContent = said.join(';'); document.body.append(e);
    """
    assert in_browser(report.read_text(), script, tmp_path) == "true;ascending;descending;3;1;1;1"


def test_round_off_of_the_centre_of_mass_is_zero() -> None:
    """Against its distance, or the size of a part that lies about the origin; small offsets stay."""
    rod = np.diag([1e-6, 3e-4, 3e-4])
    assert clean_center([0.044245, -2.0e-10, 2.4e-10], 0.75, rod).tolist() == [0.044245, 0.0, 0.0]
    assert clean_center([3e-18, -2e-17, 1e-12], 0.75, rod).tolist() == [0.0, 0.0, 0.0]
    assert clean_center([3e-8, 0.044245, -1e-8], 0.75, rod).tolist() == [3e-8, 0.044245, -1e-8]
    assert clean_center([1e-12, 2e-9, 0.0], 0.0, np.zeros((3, 3))).tolist() == [1e-12, 2e-9, 0.0]
