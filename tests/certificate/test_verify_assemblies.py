"""Certificates of assemblies against their unreduced parts, proven again from the models and joints."""

import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmarks.joined_verification import TAMPERS, joined, tamper
from benchmarks.verification import reseal
from morembs.body.file import read_body
from morembs.certificate import morembs_verify
from tests.test_unreduced import CASES, STRUCTURAL, arm, link, run, true_errors, whole

VERIFIED = re.compile(r"verified: error <= (\S+) at every frequency from 0 to 60000 Hz")


def proven_arm(folder: Path, *, couple: str = "", turned: bool = False, more: str = STRUCTURAL, **tables: str):
    """Body, assembly and witness of two links, and the job of a link."""
    job = link(folder, **tables)
    path = arm(folder, [job, job], couple=couple, turned=turned, more=more)
    path.write_text(path.read_text().replace("points = 20\n", "points = 20\nwitness = true\n"))
    run("reduce", str(path), "--quiet")
    return tuple(folder / f"arm{end}.h5" for end in ("", ".model", ".witness")), job


@pytest.mark.parametrize(("case", "turned"), [(case, "joint" not in case) for case in CASES])
def test_limits_against_the_unreduced_parts_are_proven_again(case: str, turned: bool, tmp_path: Path) -> None:
    couple, joints, interfaces, same = CASES[case]
    tables = {
        f"interface{k}": f'name = "{name}"\nnodes = "set:{name.upper()}"\n'
        + "".join(f'{key} = "{value}"\n' for key, value in interfaces.items())
        for k, name in (("", "left"), (2, "right"))
    }
    damped = "stiffness" in couple
    if damped:
        tables["damping"] = "rayleigh = { beta = 2e-6 }"
    files, job = proven_arm(tmp_path, couple=couple, turned=turned, more="" if damped else STRUCTURAL, **tables)
    shown = run("verify", *map(str, files))
    (limit,) = VERIFIED.findall(shown)
    assert "belongs: yes" in shown
    # The limit is that of dense solutions, made of nothing but meshes.
    dense = whole([job, job], joints, turned=turned, damping=[{"beta": 2e-6 * damped}] * 2, **same)
    stored = read_body(files[0])
    (body,) = stored.bodies.values()
    limits = {name: each.upper for name, each in body.certificate.limits.items()}
    assert float(limit) == pytest.approx(limits["envelope"], rel=1e-5)
    hz = np.random.default_rng(2).uniform(100.0, 60000.0, 15)
    assert (true_errors(stored, dense, hz, 0.0 if damped else 0.02) <= limits["pointwise"]).all()


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ball")
    return joined(1, 4, folder)


@pytest.mark.parametrize("change", TAMPERS, ids=[change.__name__ for change in TAMPERS])
def test_false_assemblies_are_refused(ball, change) -> None:
    kept = [path.read_bytes() for path in ball.files]
    try:
        assert tamper(ball, change)
        belongs, proven, said = morembs_verify.verify(*map(str, ball.files))
        assert belongs and not proven and "not verified: lemma" in said
    finally:
        for path, data in zip(ball.files, kept, strict=True):
            path.write_bytes(data)
    assert morembs_verify.verify(*map(str, ball.files))[1]


def put(name, value):
    def change(file):
        del file[name]
        file[name] = value

    return change


@pytest.mark.parametrize(
    ("which", "change", "said"),
    [
        (1, put("parts/0/rotation", np.diag([1.0, 1.0, -1.0])), "the place of 'p0' is none"),
        (1, put("parts/0/rotation", np.eye(2)), "has another shape"),
        (1, put("parts/0/position", [np.nan] * 3), "the place of 'p0' is none"),
        (1, put("parts/1/beta", -1e-6), "the damping of 'p1' is negative"),
        (1, put("couples/1/stiffness", [-1.0] * 6), "a spring is negative"),
        (1, put("couples/0/components", [0, 1, 2, 9]), "a component beside 0 to 5"),
        (1, put("couples/0/components", [0, 1, 2, 2]), "holds nothing, or what others hold"),
        (1, put("couples/0/between", [b"p0:right", b"p9:left"]), "joint 0 has no two interfaces of parts"),
        (1, put("part_names", [b"p0", b"p0", b"p2"]), "two parts have one name"),
        (1, put("outer", [b"p0:right", b"p2:right"]), "'left_0' is not at 'p0:right'"),
        (0, put("interfaces/left_0/coupling", b"average"), "is not one frame"),
        (1, lambda file: file.copy("models/0/matrices/M", "models/0/matrices/G"), "matrices beside K, M and D"),
        (1, put("parts/0/inputs/component", np.zeros(12, dtype=int)), "inputs in another order"),
    ],
)
def test_assemblies_that_are_none_are_refused(ball, tmp_path, which, change, said) -> None:
    copies = [Path(shutil.copy(file, tmp_path)) for file in ball.files]
    with h5py.File(copies[which], "r+") as file:
        change(file)
    reseal(*copies)
    belongs, proven, words = morembs_verify.verify(*map(str, copies))
    assert belongs and not proven and said in words, words


def test_models_of_parts_lie_in_the_file(ball, tmp_path) -> None:
    copies = [Path(shutil.copy(file, tmp_path)) for file in ball.files]
    shutil.copy(copies[1], tmp_path / "other.h5")
    with h5py.File(copies[1], "r+") as file:
        del file["models/1"]
        file["models/1"] = h5py.ExternalLink("other.h5", "models/1")
    reseal(*copies)
    assert morembs_verify.main([str(each) for each in copies]) == 2


def test_what_a_witness_of_an_assembly_does_not_hold_is_refused(tmp_path: Path) -> None:
    witness = "points = 20\nwitness = true\n"
    job = link(tmp_path, damping="modal = 0.02")
    path = arm(tmp_path, [job, job])
    path.write_text(path.read_text().replace("points = 20\n", witness))
    assert "part 'p0' has modal damping, and a witness" in " ".join(run("reduce", str(path), code=2).split())
    path = arm(tmp_path, [job, job], certified=False, name="other")
    path.write_text(path.read_text().replace("points = 20\n", witness))
    for command in ("check", "reduce"):
        out = " ".join(run(command, str(path), code=2).split())
        assert "name the job of each [[substructure]]" in out
    assert not list(tmp_path.glob("*.h5"))
