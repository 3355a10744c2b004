"""A search that was killed goes on where it was, and gives the same body."""

import os
import shutil
import signal

import pytest

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.parametric.steps import clear_steps
from tests.support.parametric import BRACKET
from tests.support.processes import apart
from tests.support.stored import datasets

JOB = """
[model]
mesh = "bracket.inp"
units = "mm-t-s"
[[material]]
young = 2.1e5
poisson = 0.3
density = 7.85e-9
[[interface]]
name = "TIP"
nodes = "set:TIP"
[[parameter]]
name = "E"
property = "young"
set = ["Volume2", "Volume3", "Volume4", "Volume5"]
range = [0.5e5, 2.7e5]
[[reduce]]
method = "parametric"
band_hz = [0, 12000]
tolerance = 1e-5
training = 3
[output]
path = "bracket.h5"
"""


class Told:
    """Progress that keeps what it is told, and calls ``then`` at some text."""

    def __init__(self, text="", then=lambda: None):
        self.text, self.then, self.told = text, then, []

    def stage(self, name):
        pass

    def update(self, text):
        self.told.append(text)
        if self.text and self.text in text:
            self.then()


def killed():
    os.kill(os.getpid(), signal.SIGKILL)


def reduced(folder, progress=None, job=JOB):
    folder.mkdir(exist_ok=True)
    (folder / "bracket.inp").write_bytes(BRACKET.read_bytes())
    (folder / "job.toml").write_text(job)
    run_job(load_job(folder / "job.toml"), progress or Told())
    return {name: value.tobytes() for name, value in datasets(folder / "bracket.h5").items()}


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """Folder of a reduction that was killed when the third value of p was taken."""
    folder = tmp_path_factory.mktemp("killed")
    ended = apart(lambda: reduced(folder, Told("from 3 values of p", killed)), tmp_path_factory.mktemp("apart"))
    assert ended.code == -signal.SIGKILL, ended.errors
    return folder


def test_a_killed_reduction_goes_on_and_gives_the_same_body(left, tmp_path):
    told = Told()
    straight = reduced(tmp_path / "straight", told)
    assert any("from 3 values of p" in text for text in told.told)
    folder = tmp_path / "killed"
    for name in ("killed", "lost"):
        shutil.copytree(left, tmp_path / name)
    kept = sorted(folder.glob("bracket.h5*"))
    assert len(kept) == 3 and all(".search-" in file.name for file in kept)
    # What is whole is read and not written again; the last one is damaged, and made anew.
    kept[2].write_bytes(kept[2].read_bytes()[:-200])
    before, after = ([file.stat().st_mtime_ns for file in kept], [])
    again = Told("from 3 values of p", lambda: after.extend(file.stat().st_mtime_ns for file in kept))
    assert reduced(folder, again) == straight
    assert after[:2] == before[:2] and after[2] > before[2]
    assert sorted(file.name for file in folder.iterdir()) == ["bracket.h5", "bracket.inp", "job.toml"]
    # A step that is lost while later ones are known is computed in its place.
    lost = sorted((tmp_path / "lost").glob("*.search-*"))[1]
    again = Told("from 1 values of p", lambda: os.truncate(lost, lost.stat().st_size - 200))
    assert reduced(tmp_path / "lost", again) == straight


def test_steps_of_a_file_with_brackets_in_its_name_are_removed_and_no_others(tmp_path):
    own, other = tmp_path / "rod[12].h5.search-01234567-0.h5", tmp_path / "rod1.h5.search-01234567-0.h5"
    for file in (own, other):
        file.touch()
    clear_steps(tmp_path / "rod[12].h5")
    assert not own.exists() and other.exists()


def test_steps_of_another_model_are_not_taken(left, tmp_path):
    folder, other = tmp_path / "killed", JOB.replace("7.85e-9", "7.7e-9").replace("1e-5", "1e-2")
    shutil.copytree(left, folder)
    assert reduced(folder, job=other) == reduced(tmp_path / "straight", job=other)
    assert not list(folder.glob("*.search-*"))
