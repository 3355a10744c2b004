"""The wheel: what it holds, how large it is, and that the files about it say the same."""

import email
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from morembs.version import VERSION

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from links to what belongs to it, so that nothing is left in the repository."""
    pytest.importorskip("setuptools", "77")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE", "morembs"):
        (source / name).symlink_to(ROOT / name)
    command = [sys.executable, "-c", f"from setuptools.build_meta import build_wheel; build_wheel({str(out)!r})"]
    subprocess.run(command, cwd=source, check=True, capture_output=True)
    (path,) = out.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        yield path, archive


def test_it_is_small_and_runs_anywhere(wheel):
    path, _ = wheel
    assert path.name == f"morembs-{VERSION}-py3-none-any.whl"
    assert path.stat().st_size < 2_000_000


def test_it_holds_the_package_and_nothing_else(wheel):
    _, archive = wheel
    held = {name for name in archive.namelist() if ".dist-info/" not in name}
    files = (path for path in (ROOT / "morembs").rglob("*") if path.is_file() and path.suffix not in (".pyc", ".pyo"))
    assert held == {path.relative_to(ROOT).as_posix() for path in files}
    assert {"morembs/py.typed", "morembs/__init__.pyi", "morembs/app/pages/page.html"} <= held


def test_it_gives_a_first_body_and_a_picture_by_itself(wheel, tmp_path):
    """In an empty folder, without the repository."""
    _, archive = wheel
    package, folder = tmp_path / "site", tmp_path / "new"
    archive.extractall(package)
    folder.mkdir()
    for arguments in (["init", "--example"], ["reduce", "rod.toml"]):
        command = [sys.executable, "-m", "morembs", *arguments]
        done = subprocess.run(command, cwd=folder, env={**os.environ, "PYTHONPATH": str(package)}, capture_output=True)
        assert done.returncode == 0, done.stderr
    assert {path.name for path in folder.iterdir()} == {"rod.msh", "rod.toml", "rod.h5", "rod.png"}


def test_its_metadata_are_those_of_the_project(wheel):
    _, archive = wheel
    info = f"morembs-{VERSION}.dist-info"
    told = email.message_from_bytes(archive.read(f"{info}/METADATA"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert told["Author"] == "morembs developers" and told["License-Expression"] == "BSD-3-Clause"
    assert told.get_all("Classifier") == project["classifiers"]
    assert set(told.get_all("Provides-Extra")) == set(project["optional-dependencies"])
    assert "morembs = morembs.app.cli:console" in archive.read(f"{info}/entry_points.txt").decode()
    assert f"version: {VERSION}\n" in (ROOT / "CITATION.cff").read_text()
