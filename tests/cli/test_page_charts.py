"""Charts of a report in a browser, by mouse and by keys, and what axe says of the page."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from tests.support import decks
from tests.support.browser import CHROMIUM, Page, browser
from tests.support.node import NODE, fetched

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a part with two bodies."""
    folder = tmp_path_factory.mktemp("charts")
    job = {"certify": "band_hz = [0, 40000]", "reduce2": 'name = "worse"\nmethod = "guyan"'}
    decks.folder(folder, job, decks.deck(decks.BEAM))
    done = CliRunner().invoke(cli.app, ["reduce", str(folder / "job.toml"), "--report", str(folder / "r.html"), "-q"])
    assert done.exit_code == 0, done.stderr
    return folder / "r.html"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def chart(page: Page, title: str) -> None:
    """Bring a chart to the middle of the window, and draw it."""
    figures = "Array.from(document.querySelectorAll('figure.chart'))"
    page.run("document.querySelector('.charts').scrollIntoView()")
    page.wait(f"{figures}.length > 3")
    page.run(f"window.shown = {figures}.find(f => f.textContent.includes({json.dumps(title)}))")
    page.run("window.shown.scrollIntoView({block: 'center'})")


def place(page: Page, share: float) -> tuple[float, float]:
    """A place in the first panel of the chart, ``share`` of its width from the left."""
    x, y, width, height = page.run(
        "(() => { var b = window.shown.querySelector('svg[tabindex]').getBoundingClientRect();"
        "return [b.x, b.y, b.width, b.height]; })()"
    )
    return x + share * width, y + height / 2


def said(page: Page) -> list[str]:
    """What is read off each panel."""
    return list(page.run("Array.from(window.shown.querySelectorAll('output')).map(o => o.textContent)"))


def marks(page: Page) -> list[str]:
    """The numbers at the axis of frequencies."""
    return list(
        page.run(
            "Array.from(window.shown.querySelector('svg[tabindex]').querySelectorAll('text[text-anchor=middle]'))"
            ".map(t => t.textContent).filter(t => /\\d/.test(t))"
        )
    )


def test_values_stand_below_the_pointer_and_dragging_zooms(report: Path, page: Page) -> None:
    page.open(report, 1000, 900)
    chart(page, "Elastic frequency response")
    whole = marks(page)
    page.mouse("mouseMoved", *place(page, 0.6))
    above, below = said(page)
    # The same frequency in both panels, and every curve of each.
    assert above.partition(":")[0] == below.partition(":")[0] != "\xa0"
    assert all(f"{name} " in above for name in ("full model", "cb", "worse")) and "cb, limit " in below
    at = float(above.partition(":")[0].replace(",", ""))
    data = json.loads(page.run("document.querySelector('.charts script').textContent"))
    [full] = [curve for curve in data[0]["panels"][0]["curves"] if curve["name"] == "full model"]
    nearest = min(range(len(full["x"])), key=lambda k: abs(full["x"][k] - at))
    read = float(above.split("full model ")[1].split(",")[0])
    assert read == pytest.approx(full["y"][nearest], rel=0.02)

    page.drag(place(page, 0.7), place(page, 0.9))
    closer = marks(page)
    assert closer != whole and page.run("!window.shown.querySelector('button').hidden")
    page.run("window.shown.querySelector('button').click()")
    assert marks(page) == whole


def test_keys_read_and_zoom(report: Path, page: Page) -> None:
    page.open(report, 1000, 900)
    chart(page, "Elastic frequency response")
    whole = marks(page)
    page.run("window.shown.querySelector('svg[tabindex]').focus()")
    page.key("ArrowRight")
    first = said(page)[0]
    page.key("ArrowRight")
    second = said(page)[0]
    hz = [float(text.partition(":")[0].replace(",", "")) for text in (first, second)]
    assert hz[0] < hz[1]
    page.key("+")
    assert marks(page) != whole
    page.key("Escape")
    assert marks(page) == whole


def test_all_charts_are_there_and_nothing_goes_wrong(report: Path, page: Page) -> None:
    page.open(report, 1000, 900)
    chart(page, "Modal assurance")
    titles = page.run("Array.from(document.querySelectorAll('figure.chart strong')).map(s => s.textContent)")
    assert titles == [
        "Elastic frequency response between the interfaces",
        "Modes over frequency",
        "Modal assurance criterion",
        "Time and memory by stage",
    ]
    cells = page.run("window.shown.querySelectorAll('svg rect').length")
    assert cells == 10 * 6
    assert page.faults == [] and all(request.startswith(("file:", "data:")) for request in page.requests)


@pytest.mark.skipif(NODE is None, reason="npm is not installed")
@pytest.mark.parametrize("dark", [False, True])
def test_axe_finds_nothing_serious(report: Path, page: Page, tmp_path: Path, dark: bool) -> None:
    axe = (fetched("axe-core@4.14.1", tmp_path) / "axe.min.js").read_text()
    page.open(report, 1000, 900, dark=dark)
    chart(page, "Time and memory")
    # What is far away is laid out too, for once.
    page.run(
        "document.head.append(Object.assign(document.createElement('style'), {textContent: "
        "'section { content-visibility: visible !important; }'}))"
    )
    page.run(axe + ";0")
    found = page.run(
        "axe.run(document, {resultTypes: ['violations']}).then(r => r.violations.filter(v => "
        "['serious', 'critical'].includes(v.impact)).map(v => [v.id, v.nodes.map(n => n.html.slice(0, 200))]))"
    )
    assert found == []


def test_a_dark_page_prints_light_with_whole_words_and_two_charts_a_page(report: Path, page: Page) -> None:
    page.open(report, 1400, 900, dark=True)
    chart(page, "Time and memory")
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    try:
        # A4 without its margins, in pixels of CSS.
        page.send("Emulation.setDeviceMetricsOverride", width=718, height=1045, deviceScaleFactor=1, mobile=False)
        page.send("Emulation.setEmulatedMedia", media="print", features=dark)
        style = "(where, name) => getComputedStyle(document.querySelector(where))[name]"
        assert page.run(f"({style})('body', 'backgroundColor')") == "rgb(255, 255, 255)"
        assert page.run(f"({style})('#tools', 'display')") == "none"
        heights = page.run("[...document.querySelectorAll('figure.chart')].map((f) => f.offsetHeight)")
        assert len(heights) == 4 and 0 < max(a + b for a, b in zip(heights[::2], heights[1::2], strict=True)) < 1045
        # A state and a name of a method are on one line, broken at a hyphen alone; nothing is cut off at the right.
        line = page.run("parseFloat(getComputedStyle(document.querySelector('td.done')).lineHeight)")
        cell = "(() => { var r = document.createRange(); r.selectNodeContents(document.querySelector('td.done')); "
        assert page.run(cell + "return r.getBoundingClientRect().height; })()") < 1.5 * line
        assert page.run("document.documentElement.scrollWidth") <= 718
    finally:
        page.send("Emulation.setEmulatedMedia", media="", features=[])
