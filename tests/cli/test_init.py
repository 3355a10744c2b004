"""``morembs init``: examples and what is proposed for parts reduce as they are, and nothing is written over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import morembs
from morembs.app.cli.commands import app
from morembs.examples import EXAMPLES

RUNNER = CliRunner()
# Volumes in mm^3 of the bushes of the rod and of the bracket.
BUSHES = np.pi * 16 * (12.5**2 - 10**2 + 8**2 - 6**2)
BRACKET = 8 * (3 * 40**2 + 8 * 80 - np.pi * (2 * 5.5**2 + 8**2))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the commands run."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(*arguments: str, code: int = 0) -> str:
    """What a command says."""
    done = RUNNER.invoke(app, list(arguments))
    assert done.exit_code == code, done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, morembs.Body]:
    """Bodies of all examples, each by the commands that are said."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("examples"))
        for name in EXAMPLES:
            words = said("init", "--example", *([] if name == "rod" else [name]))
            command = words.partition("then: morembs ")[2].split()
            assert command == ["reduce", f"{name}.toml"]
            said(*command, "-q")
            assert Path(f"{name}.png").stat().st_size > 10_000
            (found[name],) = morembs.read_body(f"{name}.h5").bodies.values()
    return found


def test_examples_reduce_to_bodies_of_their_shapes(bodies: dict[str, morembs.Body]) -> None:
    mass = {name: bodies[name].floating.integrals.mass for name in ("rod", "bracket", "deck")}
    assert mass["bracket"] == pytest.approx(BRACKET * 7.85e-6, rel=1e-5)
    # The bushes of the deck are of bronze, all else of the rod is the same.
    assert mass["deck"] - mass["rod"] == pytest.approx(BUSHES * (8.8e-6 - 7.85e-6), rel=1e-3)
    for name, ends in (("rod", ["BIGEND", "SMALLEND"]), ("deck", ["BIGEND", "SMALLEND"])):
        points = [bodies[name].floating.markers[end].point for end in ends]
        np.testing.assert_allclose(points, [[0, 0, 0], [0.12, 0, 0]], atol=1e-9)
    # A cantilever of Euler and Bernoulli, 200 x 20 x 10 mm, which its held end makes stiffer by some per cent.
    first = 1.8751**2 / (2 * np.pi * 0.2**2) * np.sqrt(210e9 * 0.01**2 / 12 / 7850)
    assert first < bodies["matrices"].frequencies_hz[0] < 1.03 * first


def test_an_example_writes_over_nothing(folder: Path) -> None:
    for there in ("rod.toml", "rod.msh"):
        (folder / there).write_text("mine")
        assert f"{there} is there already" in said("init", "--example", code=2)
        assert [path.name for path in folder.iterdir()] == [there] and (folder / there).read_text() == "mine"
        (folder / there).unlink()
    said("init", "--example", "matrices")
    assert "K.mtx is there already" in said("init", "--example", "matrices", "-o", "other.toml", code=2)
    assert not (folder / "other.toml").exists()


@pytest.mark.usefixtures("folder")
def test_an_example_that_is_not_there_is_named() -> None:
    assert "did you mean 'bracket'?" in said("init", "--example", "braket", code=2)
    assert "leave --units out" in said("init", "--example", "--units", "m-kg-s", code=2)
    assert "NAME" not in said("init", "--example", "deck", "-o", "part.toml")
    assert 'path = "deck.h5"' in Path("part.toml").read_text()


@pytest.mark.usefixtures("folder")
def test_examples_in_python_are_there_twice_and_take_nothing_away() -> None:
    Path("other").mkdir()
    for name, example in EXAMPLES.items():
        write = getattr(morembs.examples, name)
        assert write() == Path(example.files[0]) and write("other") == Path("other") / example.files[0]
        written = Path(example.files[0]).read_bytes()
        # The same again: a cell of a notebook that is run a second time.
        assert write() == Path(example.files[0]) and Path(example.files[0]).read_bytes() == written
        Path(example.files[0]).write_bytes(b"mine")
        with pytest.raises(morembs.InputError, match="is there already"):
            write()
        assert Path(example.files[0]).read_bytes() == b"mine"
