"""Short commands load what they use and nothing else: modules are counted, not seconds."""

from __future__ import annotations

import gzip
import json
import subprocess
import sys
from pathlib import Path

import pytest

BODY = Path(__file__).parents[1] / "data" / "0.1.0" / "symmetric.h5.gz"
HEAVY = {"matplotlib", "skfem", "meshio", "casadi", "pyamg", "scipy"}
AT_WORK = {"morembs.problem", "morembs.reducers", "morembs.importers", "morembs.app.jobs"}
LOADED = """
import sys
sys.argv[0] = "morembs"
try:
    __import__("morembs.app.cli").app.cli.main()
finally:
    print("\\n" + " ".join({".".join(name.split(".")[:k]) for name in sys.modules for k in (2, 3)}), file=sys.stderr)
"""


def loaded(*arguments: str) -> tuple[str, set[str]]:
    """What a command prints, and the modules that it has loaded, to the third level."""
    done = subprocess.run([sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=True)
    return done.stdout, set(done.stderr.splitlines()[-1].split())


@pytest.fixture
def body(tmp_path: Path) -> str:
    (tmp_path / "body.h5").write_bytes(gzip.decompress(BODY.read_bytes()))
    return str(tmp_path / "body.h5")


def test_the_version_is_told_without_numpy() -> None:
    output, modules = loaded("--version")
    assert output.startswith("morembs ") and not modules & {*HEAVY, *AT_WORK, "numpy", "h5py", "rich", "typer"}


def test_help_needs_no_numbers() -> None:
    output, modules = loaded("--help")
    assert "reduce" in output and not modules & {*HEAVY, *AT_WORK, "numpy", "h5py"}


def test_info_loads_neither_methods_nor_solvers(body: str) -> None:
    heavy = {*HEAVY, *AT_WORK, "typer", "importlib.metadata", "rich.progress"}
    output, modules = loaded("info", body)
    assert "craig-bampton" in output and not modules & heavy
    document, modules = loaded("info", "--json", body)
    assert json.loads(document)[0]["bodies"] and not modules & {*heavy, "rich"}


def test_both_ways_to_info_say_the_same(body: str) -> None:
    """What is as plain as can be is not parsed by typer; with ``--`` it is."""
    for options in ([], ["--json"]):
        plain, _ = loaded("info", *options, body)
        parsed, modules = loaded("info", *options, "--", body)
        assert plain == parsed and "typer" in modules


def test_other_verbs_load_nothing_that_draws_or_reads_meshes() -> None:
    _, modules = loaded("solvers")
    assert not modules & {"matplotlib", "skfem", "meshio", "casadi", "pyamg"}


def test_a_small_job_loads_nothing_that_only_other_jobs_need(tmp_path: Path) -> None:
    """Certificates, searches for neighbours, optimisation and files of SciPy took an eighth of its memory."""
    mesh = Path(__file__).parents[2] / "data" / "small_meshes" / "bracket.msh"
    loaded("init", str(mesh), "--units", "mm-t-s", "-o", str(tmp_path / "job.toml"))
    _, modules = loaded("reduce", "--quiet", str(tmp_path / "job.toml"))
    assert (tmp_path / "bracket.h5").exists() and "morembs.problem" in modules
    unused = {"scipy.spatial", "scipy.optimize", "scipy.io", "scipy.special", "matplotlib", "casadi", "pyamg"}
    assert not modules & unused
