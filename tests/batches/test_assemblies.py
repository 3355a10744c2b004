"""Parts and assemblies in one batch, and in one ``reduce``: in their order, whatever order they are given in."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.app.jobs.job import load_job
from morembs.app.jobs.order import order_of
from morembs.body.file import read_body
from tests.support import decks

pytestmark = pytest.mark.usefixtures("forked_jobs")

ARM = """
[[substructure]]
name = "upper"
body = "BODY"

[[substructure]]
name = "lower"
body = "BODY"
position = [30.0, 0.0, 0.0]

[[couple]]
between = ["upper:right", "lower:left"]

[model]
units = "mm-t-s"

[[interface]]
name = "tip"
nodes = "set:lower:right"

[[reduce]]
method = "craig-bampton"
modes = 2

[output]
path = "OUT"
"""


def parts(folder: Path, poisson: str = "0.3") -> list[str]:
    """A part and its assembly, which stands before it in every order of names."""
    material = f'set = "all"\nyoung = 210e3\npoisson = {poisson}\ndensity = 7.85e-9'
    decks.folder(folder, {"material": material, "output": 'path = "link.h5"'}, decks.deck(decks.BEAM[:12])).rename(
        folder / "link.toml"
    )
    (folder / "arm.toml").write_text(ARM.replace("BODY", "link.h5").replace("OUT", "arm.h5"))
    return [str(folder / "arm.toml"), str(folder / "link.toml")]


def run(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, list(words))
    assert "Traceback" not in done.output, done.output
    return done.exit_code, done.stderr + done.stdout


def test_an_assembly_is_made_of_the_part_that_is_made_before(tmp_path: Path) -> None:
    """A batch of a folder; a part that changes makes its assembly due again, and nothing else does."""
    parts(tmp_path)
    code, said = run("batch", str(tmp_path), "--check-only")
    assert code == 0 and "1 sound, 1 waits" in said
    code, said = run("batch", str(tmp_path))
    assert code == 0 and "2 done" in said and said.index("link: done") < said.index("arm: done")
    mass = read_body(tmp_path / "arm.h5").mass
    assert abs(mass / (2 * read_body(tmp_path / "link.h5").mass) - 1) < 1e-12
    assert "2 unchanged" in run("batch", str(tmp_path))[1]
    deck = tmp_path / "part.inp"
    deck.write_text(deck.read_text().replace("*NODE FILE", "** a comment\n*NODE FILE"))
    assert "2 done" in run("batch", str(tmp_path))[1]
    (tmp_path / "arm.h5").unlink()
    assert "1 done, 1 unchanged" in run("batch", str(tmp_path))[1]


def test_a_part_that_fails_fails_its_assembly_in_one_line(tmp_path: Path) -> None:
    both = parts(tmp_path, poisson="0.6")
    code, said = run("batch", str(tmp_path))
    assert (
        code == 2
        and f"failed: arm: the job link of its part failed ({tmp_path / 'link.toml'}); mend that job first" in said
    )
    code, said = run("reduce", *both)
    assert code == 2 and f"arm.toml: the job {tmp_path / 'link.toml'} of a part" in said
    assert not list(tmp_path.glob("*.h5"))


def test_reduce_takes_jobs_in_their_order(tmp_path: Path) -> None:
    code, said = run("reduce", *parts(tmp_path))
    assert code == 0 and said.index("written: ") and (tmp_path / "arm.h5").exists() and (tmp_path / "link.h5").exists()


def test_circles_are_refused_by_name(tmp_path: Path) -> None:
    parts(tmp_path)
    for name, body in (("x", "y"), ("y", "x")):
        (tmp_path / f"{name}.toml").write_text(ARM.replace("BODY", f"{body}.h5").replace("OUT", f"{name}.h5"))
    code, said = run("batch", str(tmp_path), "--check-only")
    assert code == 2 and said.count("in a circle") == 4  # of each its line, and at the end
    assert all(str(tmp_path / name) in said for name in ("x.toml", "y.toml")) and "1 sound, 1 waits, 2 failed" in said
    # A file that is no body is not to be waited for: a picture over a part is refused as before.
    text = (tmp_path / "x.toml").read_text().replace('path = "x.h5"', 'path = "z.h5"\npicture = "link.png"')
    (tmp_path / "x.toml").write_text(text)
    (tmp_path / "y.toml").write_text(ARM.replace("BODY", "link.png").replace("OUT", "y.h5"))
    jobs = {0: load_job(tmp_path / "x.toml"), 1: load_job(tmp_path / "y.toml")}
    order = order_of(jobs)
    assert list(order.refused) == [0] and "link.png is a body of" in order.refused[0] and order.parts[1] == ()
