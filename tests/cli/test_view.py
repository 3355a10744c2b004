"""The viewer: its pages load in a browser without a fault or a request, move, and say what was clicked."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.body.file import read_body
from tests.support import decks
from tests.support.browser import CHROMIUM, Page, browser

RUNNER = CliRunner()
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
HOSTILE = "<img src=x onerror=alert(1)>"
VIEWER = "document.querySelector('.morembs-viewer').viewer"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A beam and two bodies of it in one file, and another mesh of it; an interface has a name that is HTML."""
    place = tmp_path_factory.mktemp("view")
    for name, cells in (("part", decks.BEAM), ("other", [(x, 0, 0) for x in range(3)])):
        tables = {"reduce2": 'name = "guyan"\nmethod = "guyan"', "stress": 'nodes = "skin"'}
        tables["interface"] = f"name = '{HOSTILE}'\nnodes = \"set:LEFT\""
        tables |= {"output": f'path = "{name}.h5"', "model": f'mesh = "{name}.inp"\nunits = "mm-t-s"'}
        (place / f"{name}.inp").write_text(decks.deck(cells, 10.0 if name == "part" else 20.0))
        (place / f"{name}.toml").write_text(decks.job(tables))
        done = RUNNER.invoke(cli.app, ["reduce", str(place / f"{name}.toml"), "-q"])
        assert done.exit_code == 0, done.stderr
    return place


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def shown(page: Page, *arguments: str, **how: object) -> Path:
    """Write a page with ``morembs view`` and open it until it is drawn."""
    target = Path(arguments[0]).with_suffix(".page.html")
    done = RUNNER.invoke(cli.app, ["view", *arguments, "-o", str(target), "--no-open"])
    assert done.exit_code == 0, done.stderr
    page.faults.clear(), page.requests.clear()
    page.open(target, **how)
    page.wait(f"{VIEWER}?.drawing")
    return target


def drawn(page: Page) -> NDArray[np.int64]:
    """Pixels of the drawing alone."""
    page.run(f"{VIEWER}.paint(), 1")
    box = page.run(
        "(({x, y, width, height}) => [x, y, width, height])(document.querySelector('.stage').getBoundingClientRect())"
    )
    x, y, width, height = (round(value) for value in box)
    return page.picture()[y : y + height, x : x + width]


def difference(one: NDArray[np.int64], two: NDArray[np.int64]) -> float:
    """Part of the pixels that differ visibly."""
    return float((np.abs(one - two).max(axis=2) > 24).mean())


def colored(picture: NDArray[np.int64]) -> float:
    """Part of the pixels that have a color: neither paper nor ink."""
    return float((np.ptp(picture, axis=2) > 30).mean())


@needs_browser
def test_a_body_moves_in_a_page_that_asks_nobody(page: Page, folder: Path) -> None:
    path = shown(page, str(folder / "part.h5"))
    first = drawn(page)
    assert 0.05 < colored(first) < 0.7
    # The mode menu changes the picture, and nothing else does: people who want no motion get none.
    page.wait("true")
    assert difference(first, drawn(page)) == 0
    menu = "document.querySelector('.modes')"
    page.run(f"{menu}.value = 2, {menu}.dispatchEvent(new Event('change')), 1")
    assert difference(first, drawn(page)) > 0.02
    names = page.run("[...document.querySelectorAll('.modes option')].map((o) => o.textContent)")
    body = read_body(folder / "part.h5").bodies["cb"]
    assert len(names) == min(12, len(body.frequencies_hz) - 6)
    assert float(names[0].split(": ")[1].removesuffix(" Hz").replace(",", "")) == pytest.approx(
        body.frequencies_hz[6], rel=1e-4
    )
    assert page.faults == []
    assert {url.partition(":")[0] for url in page.requests} <= {"file", "data"}
    assert not re.search(r"https?://|@import|<link|src=\"(?!data:)", path.read_text())
    assert HOSTILE not in path.read_text()


@needs_browser
def test_a_mode_swings_where_motion_is_welcome_and_stops_by_a_key(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"), still=False)
    assert page.run(f"{VIEWER}.playing")
    page.run(f"{VIEWER}.clock = 0, new Promise((done) => setTimeout(done, 300))")
    first = page.picture()
    page.run("new Promise((done) => setTimeout(done, 400))")
    assert difference(first, page.picture()) > 0.005
    page.run(f"{VIEWER}.canvas.focus(), 1")
    page.key(" ")
    assert not page.run(f"{VIEWER}.playing")
    page.key("n")
    assert page.run(f"{VIEWER}.panes[0].mode") == 1
    page.key("6")
    assert page.run(f"{VIEWER}.camera.turn.slice(6)") == [0, 0, -1]
    assert page.faults == []


@needs_browser
def test_stress_colors_and_names_are_texts(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"))
    first = drawn(page)
    page.run(f"{VIEWER}.color = 'stress', 1")
    assert difference(first, drawn(page)) > 0.02
    assert HOSTILE in page.run("document.querySelector('.panel').textContent")
    assert page.run("document.images.length") == 0 and page.faults == []


@needs_browser
def test_a_browser_without_streams_that_inflate_shows_the_same(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"))
    first = drawn(page)
    shown(page, str(folder / "part.h5"), before="delete globalThis.DecompressionStream")
    assert page.run("typeof DecompressionStream") == "undefined"
    assert difference(first, drawn(page)) == 0 and page.faults == []


@needs_browser
def test_without_webgl_a_still_picture_is_left(page: Page, folder: Path) -> None:
    page.faults.clear()
    target = folder / "part.page.html"
    page.open(target, before="HTMLCanvasElement.prototype.getContext = () => null")
    page.wait("document.querySelector('.morembs-viewer p:last-child')?.textContent.includes('no WebGL 2')")
    assert page.run("document.querySelector('.still img').naturalWidth") > 300 and page.faults == []


@needs_browser
def test_two_files_stand_side_by_side_with_their_mac(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"), str(folder / "other.h5"))
    picture = drawn(page)
    halves = np.array_split(picture, 2, axis=1)
    assert all(colored(half) > 0.03 for half in halves)
    # Where two modes are one, the other body's is chosen with it.
    best = json.loads(page.run(f"JSON.stringify({VIEWER}.mac().map((row) => Math.max(...row)))"))
    assert max(best) > 0.9
    page.run(f"{VIEWER}.choose(0, 1), 1")
    assert page.run(f"{VIEWER}.mac()[1][{VIEWER}.panes[1].mode] === Math.max(...{VIEWER}.mac()[1])")
    assert page.faults == []
