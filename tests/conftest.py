"""Paths of optional data; the helpers in ``tests.support`` are importable from every test."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

import pytest
import typer.main
import typer.testing

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# Processes that tests start are like those of a user: their byte code is kept, their output has a buffer.
for name in ("PYTHONDONTWRITEBYTECODE", "PYTHONUNBUFFERED"):
    os.environ.pop(name, None)
# So is that of the tests: asserts are else rewritten in each run, which takes most of the time of collection.
sys.dont_write_bytecode = False
# What a command opens in a browser is opened by a program that does nothing.
os.environ["BROWSER"] = "true"
# Open MPI refuses root, as which a container runs its tests, and more processes than there are processors.
for name in ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe"):
    os.environ[name] = "1"
# What is kept from run to run is kept for the tests alone; workers have the folder of the process that starts them.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["XDG_CACHE_HOME"] = tempfile.mkdtemp(prefix="morembs-cache-")
    atexit.register(shutil.rmtree, os.environ["XDG_CACHE_HOME"], ignore_errors=True)
# typer builds its tree of commands anew at each call, which takes ten times as long as a command that is refused.
typer.testing._get_command = cache(typer.main.get_command)  # noqa: SLF001


# Files with a test or a fixture of half a minute, which would leave other workers idle if it came last.
LONG = ("test_site.py", "test_cluster.py", "test_slurm.py", "test_attack.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long tests come first."""
    items.sort(key=lambda item: item.path.name not in LONG)


def pytest_collection_finish() -> None:
    """What the tests themselves hold is left out of collections of garbage, of which each command makes one."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with models from elsewhere, beside the project; tests that need it skip without it."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the folder ../shared/data is not here")
    return folder


@pytest.fixture(scope="session")
def small_meshes() -> Path:
    """Folder of the small meshes of the project."""
    return ROOT / "data" / "small_meshes"


@pytest.fixture
def forked_jobs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs of a batch run in forks, which import nothing anew; tests of a batch itself start whole processes."""
    from tests.support.processes import fork_jobs

    fork_jobs(monkeypatch)
