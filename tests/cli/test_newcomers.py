"""What newcomers type and write is answered with what works: lists in tests/data/newcomers, begun before any answer."""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
import typer.main

import morembs
from morembs.app.batches.plan import parts_of
from morembs.app.cli.commands import app

LISTS = Path(__file__).parent.parent / "data" / "newcomers"
COMMANDS = tomllib.loads((LISTS / "commands.toml").read_text())["command"]
CALLS = tomllib.loads((LISTS / "calls.toml").read_text())["call"]
CHAIN = 1e4 * sp.diags_array([np.r_[np.full(11, 2.0), 1.0], -np.ones(11), -np.ones(11)], offsets=[0, 1, -1]).tocsr()
JOB = """
model = { mesh = "bar.msh" }
material = [{ young = 2e11, poisson = 0.3, density = 7850.0 }]
interface = [{ name = "TIP", nodes = "set:TIP" }]
reduce = [{ method = "craig-bampton", modes = 4 }]
output = { path = "bar.h5" }
"""

MEMBER = """
member = { length = 0.3, elements = 6, young = 3e6, density = 2770.0, area = 7.854e-5, second_moment = 4.909e-10 }
reduce = [{ name = "arm", method = "global-modal-parameterisation", modes = 2, reach = 0.5 }]
output = { path = "arm.h5" }
"""


def run(typed: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code of a command line in this process, and all that it says."""
    with pytest.raises(SystemExit) as end:
        typer.main.get_command(app).main(typed.split()[1:], prog_name="morembs")
    said = capsys.readouterr()
    return int(end.value.code or 0), " ".join(f"{said.out} {said.err}".split())


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory, small_meshes: Path) -> Path:
    folder = tmp_path_factory.mktemp("newcomer")
    shutil.copy(small_meshes / "block.msh", folder / "bar.msh")
    shutil.copy(small_meshes / "bracket.inp", folder / "bracket.inp")
    (folder / "part.step").write_text("ISO-10303-21;\n")
    (folder / "surface.stl").write_text("solid s\nendsolid s\n")
    for name, matrix in (("K", CHAIN), ("M", sp.eye_array(12).tocsr()), ("B", sp.csr_array(np.eye(12)[:, -1:]))):
        scipy.io.mmwrite(folder / f"{name}.mtx", matrix)
    named = {"K": CHAIN, "M": sp.eye_array(12).tocsr(), "B": np.eye(12)[:, -1:]}
    scipy.io.savemat(folder / "model.mat", named)
    np.savez(folder / "model.npz", K=CHAIN.toarray(), M=np.eye(12), B=np.eye(12)[:, -1])
    (folder / "bar.msh.gz").write_bytes(gzip.compress((folder / "bar.msh").read_bytes()))
    (folder / "bar.toml").write_text(JOB)
    mesh = morembs.read_mesh(folder / "bar.msh", "m-kg-s")
    steel = morembs.isotropic(set="all", young=2e11, poisson=0.3, density=7850.0)
    morembs.write_model(folder / "bar.model.h5", morembs.assemble(mesh, [steel]))
    return folder


@pytest.fixture(scope="module")
def whole(files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with the body of the job."""
    with pytest.raises(SystemExit) as end:
        typer.main.get_command(app).main(["reduce", str(files / "bar.toml"), "--quiet"])
    assert not end.value.code
    return files


@pytest.fixture
def folder(whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy, in which the command runs, of a user without a home of his own."""
    shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    # The shell that a test is started from may be none.
    monkeypatch.setattr("shellingham.detect_shell", lambda *_, **__: ("bash", "/bin/bash"))
    return tmp_path


@pytest.mark.usefixtures("folder", "forked_jobs")
@pytest.mark.parametrize("entry", COMMANDS, ids=lambda entry: entry["typed"].replace(" ", "_"))
def test_a_command_line_is_answered_with_what_works(entry: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(entry["typed"], capsys)
    assert entry["answer"] in said
    assert code in (0, 2) and "Traceback" not in said
    assert len(said) < 600 or code == 0 or entry["typed"] == "morembs"


def test_the_answer_to_a_mesh_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for typed in ("morembs init bar.msh -o other.toml", "morembs check other.toml"):
        assert run(typed, capsys)[0] == 0
    code, said = run("morembs reduce K.mtx M.mtx --input B.mtx --method krylov --order 6 -o k.h5", capsys)
    assert code == 0 and "krylov: 6 krylov = 6 coordinates" in said
    assert len(morembs.read_body(folder / "k.h5").bodies["krylov"].stiffness_matrix) == 6


def test_the_answer_to_a_body_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for typed in ("init bar.h5", "bar.system.toml", "simulate bar.system.toml --set simulation.end=0.01"):
        assert run(f"morembs {typed}", capsys)[0] == 0
    assert (folder / "bar.motion.h5").exists()
    # Not over what is there.
    assert run("morembs init bar.h5", capsys)[0] == 2


def test_the_answer_to_a_member_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "arm.toml").write_text(MEMBER)
    simulate = "simulate arm.system.toml --set simulation.end=0.01"
    for typed in ("reduce arm.toml", "init arm.h5", "check arm.system.toml", simulate):
        assert run(f"morembs {typed}", capsys)[0] == 0, typed
    assert (folder / "arm.motion.h5").exists()


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("entry", CALLS, ids=lambda entry: entry["typed"])
def test_a_call_is_answered_with_what_works(entry: dict[str, str]) -> None:
    K = CHAIN
    M = sp.eye_array(12).tocsr()
    mesh = morembs.read_mesh("bar.msh", "m-kg-s")
    names = {"morembs": morembs, "K": K, "M": M, "B": sp.csr_array(np.eye(12)[:, :1]), "diagonal": np.ones(12)}
    names |= {"mesh": mesh, "model": SimpleNamespace(), "masked": np.ma.masked_less(K.toarray(), 0.0)}
    if "model" in entry["typed"]:
        names["model"] = morembs.read_model("bar.model.h5")
    if "answer" not in entry:
        assert eval(entry["typed"], names) is not None
        return
    with pytest.raises((morembs.InputError, AttributeError, KeyError)) as caught:
        eval(entry["typed"], names)
    assert entry["answer"] in str(caught.value)


def shell_of(name: str) -> str:
    """The program of a shell; the test is skipped where it is not installed."""
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


@pytest.fixture
def own(folder: Path) -> dict[str, str]:
    """The environment of a user with a command of this program; a job and a body lie in a folder of their own too."""
    (folder / "morembs").write_text(f'#!/bin/sh\nexec {sys.executable} -m morembs "$@"\n')
    (folder / "morembs").chmod(0o755)
    (folder / "night").mkdir()
    for name in ("bar.toml", "bar.h5", "bar.msh"):
        shutil.copy(folder / name, folder / "night" / name)
    return {**os.environ, "HOME": str(folder), "PATH": f"{folder}:{os.environ['PATH']}", "TERM": "dumb"}


# What is typed -> words that are offered.
OFFERED = {
    "morembs exp": {"export"},
    "morembs export --f": {"--frame"},
    "morembs export bar.h5 --to ex": {"exudyn", "extptfm"},
    "morembs reduce bar.toml --method cr": {"craig-bampton"},
    "morembs import --format mat": {"matrix-market", "matlab"},
    "morembs import --contact s": {"skip"},
    "morembs init bar.msh --units mm-t": {"mm-t-s"},
    "morembs init --example r": {"rod"},
    "morembs check b": {"bar.toml"},
    "morembs reduce K": {"K.mtx"},
    "morembs view part": {"part.step"},
    "morembs info night/": {"night/bar.h5"},
    "morembs info nig": {"night/bar.h5"},
    "morembs init night/": {"night/bar.msh"},
    "morembs reduce --input B": {"B.mtx"},
}


def test_bash_completes_verbs_options_values_and_files(folder: Path, own: dict[str, str]) -> None:
    """A shell that loads what --install-completion wrote."""
    script = """
        morembs --install-completion > /dev/null
        source ~/.bash_completions/morembs.sh
        while read -r line; do
            COMP_WORDS=($line); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=()
            _morembs_completion morembs; echo "${COMPREPLY[@]}"
        done
    """
    done = subprocess.run(
        [shell_of("bash"), "-c", script],
        input="\n".join(OFFERED) + "\n",
        capture_output=True,
        text=True,
        env={**own, "SHELL": "/bin/bash"},
        cwd=folder,
    )
    answers = [set(line.split()) for line in done.stdout.splitlines()]
    assert dict(zip(OFFERED, answers, strict=True)) == OFFERED, done.stderr


def test_fish_completes_the_same(folder: Path, own: dict[str, str]) -> None:
    fish = shell_of("fish")
    subprocess.run([fish, "-c", "morembs --install-completion"], env=own, cwd=folder, check=True, capture_output=True)
    (script,) = (folder / ".config" / "fish" / "completions").iterdir()
    lines = "\n".join(f"complete --do-complete '{typed}'; echo ---" for typed in OFFERED)
    done = subprocess.run(
        [fish, "-c", f"source {script}\n{lines}"], capture_output=True, text=True, env=own, cwd=folder
    )
    answers = [{line.split("\t")[0] for line in part.splitlines() if line} for part in done.stdout.split("---\n")[:-1]]
    assert dict(zip(OFFERED, answers, strict=True)) == OFFERED, done.stderr


def test_zsh_completes_the_same(folder: Path, own: dict[str, str]) -> None:
    """The words that the function of the completion hands to ``_arguments``, which shows them in a terminal alone."""
    zsh = shell_of("zsh")
    script = f"""
        morembs --install-completion > /dev/null
        compdef() {{ }}
        _arguments() {{ print -r -- ${{1#*: :}} }}
        _files() {{ print -r -- none }}
        source {folder}/.zfunc/_morembs
        while read -r line; do
            words=(${{(z)line}}); CURRENT=${{#words}}; _morembs_completion; echo ---
        done
    """
    done = subprocess.run(
        [zsh, "-f", "-c", script], input="\n".join(OFFERED) + "\n", capture_output=True, text=True, env=own, cwd=folder
    )
    answers = [set(re.findall(r'"([^"]+)"(?::"[^"]*")?', part)) for part in done.stdout.split("---\n")[:-1]]
    assert dict(zip(OFFERED, answers, strict=True)) == OFFERED, done.stderr


def test_a_link_to_a_job_keeps_its_name(folder: Path) -> None:
    (folder / "links").mkdir()
    (folder / "links" / "night.toml").symlink_to(folder / "bar.toml")
    (part,) = parts_of([folder / "links"])
    assert part.name == "night"
