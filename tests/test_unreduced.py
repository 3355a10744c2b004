"""Certificates of assemblies against the unreduced parts: from the command line, against dense solutions of these."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import morembs
from morembs.app.cli.commands import app
from morembs.app.jobs.assembly import assembly_of
from morembs.app.jobs.job import load_job
from morembs.app.jobs.stages.couple import interfaces_of
from morembs.base.budget import Budget
from morembs.base.errors import BudgetError
from morembs.body.file import StoredBodies, read_body, write_body
from tests.support import decks
from tests.support.dense_assembly import Joint, Part, Whole, elastic
from tests.support.refusals import refusal
from tests.support.tubes import STEEL

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "job" / "assemblies.md"
STRUCTURAL = "[damping]\nstructural = 0.02\n"
LENGTH, AXIS, DEGREES = 30.0, [1.0, -2.0, 0.5], 77.0
BAND = [0, 60000]
ENDS = [(0, "left"), (1, "right")]
RIGID: Joint = ((0, "right"), (1, "left"), range(6), None, None)
STIFFNESS, DAMPING = [4e5, 2e5, 3e5, 2e8, 1e8, 3e8], [0.5, 0.4, 0.3, 20.0, 30.0, 40.0]
SPRINGS = f"\nstiffness = {STIFFNESS}\ndamping = {DAMPING}"
# N/m and Ns/m from N/mm and Ns/mm, Nm/rad and Nms/rad from Nmm.
SI = np.array([1e3] * 3 + [1e-3] * 3)
SPRUNG: Joint = ((0, "right"), (1, "left"), range(6), STIFFNESS * SI, DAMPING * SI)


def run(*words: str, code: int = 0) -> str:
    done = CliRunner().invoke(app, list(words))
    assert done.exit_code == code and "Traceback" not in done.output, done.output + done.stderr
    return done.stderr + done.stdout


def link(folder: Path, name: str = "link", **tables: str) -> Path:
    """The job of a part, done, in a folder of its own."""
    done = reduced_link(folder.parent, tuple(tables.items()))
    return Path(shutil.copytree(done.parent, folder / name)) / done.name


@cache
def reduced_link(parent: Path, tables: tuple[tuple[str, str], ...]) -> Path:
    folder = Path(tempfile.mkdtemp(dir=parent, prefix="link"))
    job = decks.folder(folder, {"output": 'path = "part.h5"', **dict(tables)}, decks.deck(decks.BEAM[:12]))
    run("reduce", str(job), "--quiet")
    return job


def arm(
    folder: Path,
    jobs: list[Path],
    *,
    couple: str = "",
    turned: bool = False,
    swapped: bool = False,
    more: str = "",
    modes: int = 6,
    certified: bool = True,
    name: str = "arm",
) -> Path:
    """The job of two parts one behind the other."""
    R = turn(turned)
    tables = []
    for k, job in enumerate(jobs):
        x = (R @ [LENGTH * k, 0, 0]).tolist()
        tables.append(
            f'[[substructure]]\nname = "p{k}"\nbody = "{job.parent / "part.h5"}"\nposition = {x}\n'
            + (f"rotation = {{ axis = {AXIS}, degrees = {DEGREES} }}\n" if turned else "")
            + (f'job = "{job}"\n' if certified else "")
        )
    text = "\n".join(reversed(tables) if swapped else tables)
    for part in couple.split("+"):
        text += f'\n[[couple]]\nbetween = ["p0:right", "p1:left"]{part}\n'
    text += '\n[model]\nunits = "mm-t-s"\n'
    for k, end in ENDS:
        text += f'\n[[interface]]\nname = "{end}"\nnodes = "set:p{k}:{end}"\n'
    text += f'\n[[reduce]]\nmethod = "craig-bampton"\nmodes = {modes}\n[certify]\nband_hz = {BAND}\npoints = 20\n'
    path = folder / f"{name}.toml"
    path.write_text(f'{text}\n{more}\n[output]\npath = "{name}.h5"\n')
    return path


def turn(turned: bool) -> np.ndarray:
    axis = np.array(AXIS) / np.linalg.norm(AXIS)
    return Rotation.from_rotvec(np.radians(DEGREES * turned) * axis).as_matrix()


def certificate(path: Path) -> tuple[StoredBodies, Mapping[str, np.ndarray]]:
    run("reduce", str(path), "--quiet")
    stored = read_body(path.with_suffix(".h5"))
    (body,) = stored.bodies.values()
    assert ("against the unreduced parts" in "; ".join(body.certificate.notes)) == ('job = "' in path.read_text())
    return stored, body.certificate.datasets


def whole(jobs: list[Path], joints: list[Joint], *, turned: bool = False, damping: list[dict] | None = None, **same):
    """The same two parts without any code of assemblies."""
    parts = []
    for k, job in enumerate(jobs):
        mesh = morembs.read_mesh(job.parent / "part.inp", morembs.parse_units("mm-t-s"))
        rows = {name: mesh.nodes.sets[name.upper()] for name in ("left", "right")}
        place = turn(turned) @ [1e-3 * LENGTH * k, 0, 0]
        own = {} if damping is None else damping[k]
        parts.append(Part(mesh=mesh, turn=turn(turned), place=place, interfaces=rows, **own, **same))
    return Whole(parts, joints, ENDS)


def true_errors(stored: StoredBodies, dense: Whole, hz: np.ndarray, structural: float) -> np.ndarray:
    """(nf,) error of H by its definition, of dense solutions."""
    (body,) = stored.bodies.values()
    length = np.sqrt(np.trace(stored.inertia) / (2 * stored.mass))
    scale = np.tile([1.0] * 3 + [length] * 3, 2)
    errors = []
    for w in 2 * np.pi * hz:
        H = scale[:, None] * dense.response(w, structural) * scale
        M, K, D = body.matrices
        H_r = scale[:, None] * elastic(K, M, D, body.input_matrix, w, structural) * scale
        errors.append(np.linalg.norm(H_r - H) / np.linalg.norm(H))
    return np.array(errors)


CASES = {
    "rigid": ("", [RIGID], {}, {}),
    "springs": (SPRINGS, [SPRUNG], {}, {}),
    "ball joint with springs": (
        f"\ncomponents = [0, 1, 2]+\ncomponents = [3, 4, 5]{SPRINGS}",
        [(*RIGID[:2], (0, 1, 2), None, None), (*SPRUNG[:2], (3, 4, 5), *SPRUNG[3:])],
        {},
        {},
    ),
    "means": ("", [RIGID], {"coupling": "average"}, {"average": True}),
}


@pytest.mark.parametrize(("case", "turned"), [(case, "joint" not in case) for case in CASES])
def test_the_error_against_the_unreduced_parts_is_that_of_dense_solutions(
    case: str, turned: bool, tmp_path: Path
) -> None:
    couple, joints, interfaces, same = CASES[case]
    tables = {
        f"interface{k}": f'name = "{name}"\nnodes = "set:{name.upper()}"\n'
        + "".join(f'{key} = "{value}"\n' for key, value in interfaces.items())
        for k, name in (("", "left"), (2, "right"))
    }
    damped = "stiffness" in couple
    # Damped springs leave some modes undamped, whose responses have no limit.
    if damped:
        tables["damping"] = "rayleigh = { beta = 2e-6 }"
    job = link(tmp_path, **tables)
    floor = 0.0 if damped else 0.03
    more = "" if damped else f"[damping]\nstructural = {floor}\n"
    stored, known = certificate(arm(tmp_path, [job, job], couple=couple, turned=turned, more=more))
    dense = whole([job, job], joints, turned=turned, damping=[{"beta": 2e-6 * damped}] * 2, **same)
    assert not any("own errors are not in them" in warning for warning in stored.warnings)
    assert known["bound_kind"] == "bound"
    hz = known["frequencies_hz"][1:]
    true = true_errors(stored, dense, hz, floor)
    assert (known["bound"][1:] >= true * (1 - 1e-9)).all()
    assert known["error"][1:] == pytest.approx(true, rel=1e-4, abs=1e-7)
    # Between these frequencies too, and not by far.
    hz = np.random.default_rng(5).uniform(100.0, BAND[1], 25)
    cell = np.searchsorted(known["cells_hz"][:, 1], hz)
    limit = known["cell_limit"][cell, 2]
    true = true_errors(stored, dense, hz, floor)
    assert (limit >= true).all() and np.median(limit / true) < 1.5
    elastic_hz = dense.frequencies_hz[6:]
    count = int((elastic_hz < BAND[1]).sum())
    assert count >= 2 and known["mode_frequencies_hz"] == pytest.approx(elastic_hz[:count], rel=1e-7)
    (body,) = stored.bodies.values()
    off = body.frequencies_hz[6 : 6 + count] / elastic_hz[:count] - 1
    assert known["mode_deviation"][:2] == pytest.approx(off[:2], rel=1e-3, abs=1e-9)
    # The body is compared with the frequencies of the whole.
    assert body.full_frequencies_hz[6 : 6 + count] == pytest.approx(elastic_hz[:count], rel=1e-6)


DAMPINGS: dict[str, list[dict[str, float]]] = {
    "equal beta": [{"beta": 1e-6}] * 2,
    "unequal": [{"alpha": 300.0, "beta": 1e-6}, {"beta": 3e-6}],
    "modal": [{"modal": 0.02}, {"modal": 0.05}],
}


@pytest.mark.parametrize("case", DAMPINGS)
def test_damping_of_parts_is_that_of_their_jobs(case: str, tmp_path: Path) -> None:
    jobs = []
    for number, values in enumerate(DAMPINGS[case]):
        modal = values.get("modal")
        rayleigh = ", ".join(f"{key} = {value}" for key, value in values.items())
        text = f"rayleigh = {{ {rayleigh} }}" if modal is None else f"modal = {modal}"
        jobs.append(link(tmp_path, f"link{number}", damping=text))
    stored, known = certificate(arm(tmp_path, jobs))
    dense = whole(jobs, [RIGID], damping=DAMPINGS[case])
    assert known["bound_kind"] == "bound"
    true = true_errors(stored, dense, known["frequencies_hz"][1:], 0.0)
    assert (known["bound"][1:] >= true * (1 - 1e-9)).all()
    assert known["error"][1:] == pytest.approx(true, rel=1e-4, abs=1e-7)
    # The job of the same part with other damping, or without any, is that of another body.
    old, new = (text, "modal = 0.03") if case == "modal" else (f"[damping]\n{text}", "")
    jobs[1].write_text(jobs[1].read_text().replace(old, new))
    assert "part 'p1': its body was not reduced from its model: its damping is not V' A V" in run(
        "reduce", str(tmp_path / "arm.toml"), code=2
    )


def test_parts_with_all_their_modes_have_no_error(tmp_path: Path) -> None:
    # 36 nodes, 18 of them in two frames: 54 dofs inside.
    job = link(tmp_path, reduce='name = "cb"\nmethod = "craig-bampton"\nmodes = 54')
    _, known = certificate(arm(tmp_path, [job, job], modes=114, more=STRUCTURAL))
    assert known["limits"]["envelope"][1] < 1e-8 and known["error"].max() < 1e-8
    assert np.abs(known["mode_deviation"]).max() < 1e-9 and known["mode_mac"] == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("modes", [1, 6, 20])
def test_parts_that_are_too_coarse_are_seen(modes: int, tmp_path: Path) -> None:
    """The limits of docs/reference/job/assemblies.md: of an assembly that reduces its bodies hardly or not at all."""
    job = link(tmp_path, reduce=f'name = "cb"\nmethod = "craig-bampton"\nmodes = {modes}')
    limits = []
    for certified in (False, True):
        path = arm(tmp_path, [job, job], modes=min(2 * modes + 6, 30), certified=certified, more=STRUCTURAL)
        path.write_text(path.read_text().replace(f"band_hz = {BAND}", "band_hz = [0, 30000]"))
        stored, known = certificate(path)
        limits.append(float(known["limits"]["envelope"][1]))
        assert any("own errors are not in them" in warning for warning in stored.warnings) is not certified
    (line,) = (line for line in PAGE.read_text().splitlines() if line.startswith(f"| {modes} mode"))
    told = [float(cell) for cell in line.split("|")[2:4]]
    assert limits[1] == pytest.approx(told[1], rel=0.05)
    # Round-off is told as a power of ten that it stays below.
    assert limits[0] <= told[0] if told[0] < 1e-8 else limits[0] == pytest.approx(told[0], rel=0.05)


def test_the_certificate_knows_neither_the_order_of_the_parts_nor_their_place(tmp_path: Path) -> None:
    job = link(tmp_path)
    _, one = certificate(arm(tmp_path, [job, job], more=STRUCTURAL))
    _, other = certificate(arm(tmp_path, [job, job], more=STRUCTURAL, name="other", swapped=True, turned=True))
    assert other["limits"]["envelope"] == pytest.approx(one["limits"]["envelope"], rel=1e-8)
    assert other["mode_frequencies_hz"] == pytest.approx(one["mode_frequencies_hz"], rel=1e-9)
    assert other["mode_deviation"][:2] == pytest.approx(one["mode_deviation"][:2], rel=1e-8)
    assert other["mode_mac"] == pytest.approx(one["mode_mac"], rel=1e-8) and one["mode_mac"][:2].min() > 0.99


def test_bodies_that_keep_few_nodes_are_reduced_again(tmp_path: Path) -> None:
    known = []
    for nodes in ("all", "interfaces"):
        job = link(tmp_path, f"link-{nodes}", output=f'path = "part.h5"\nnodes = "{nodes}"')
        known.append(certificate(arm(tmp_path, [job, job], name=nodes, more=STRUCTURAL))[1])
    assert known[1]["limits"]["envelope"] == pytest.approx(known[0]["limits"]["envelope"], rel=1e-8)
    assert known[1]["mode_mac"] == pytest.approx(known[0]["mode_mac"], rel=1e-8)


def test_jobs_that_did_not_make_the_bodies_are_refused(tmp_path: Path) -> None:
    job = link(tmp_path)
    good, mesh = job.read_text(), (job.parent / "part.inp").read_text()
    path = arm(tmp_path, [job, job])
    text = path.read_text()

    def refused(words: str) -> None:
        # Both take the same road, checks without what a reduction compares.
        reduction = "V' A V" in words or "was not reduced" in words
        for command in ("reduce",) if reduction else ("check", "reduce") if "masses" in words else ("check",):
            out = run(command, str(path), code=2)
            assert words in " ".join(out.split()), out
            assert not path.with_suffix(".h5").exists()

    def changed(old: str, new: str, words: str) -> None:
        assert old in good
        job.write_text(good.replace(old, new))
        refused(words)
        job.write_text(good)

    changed("young = 210e3", "young = 200e3", "its stiffness is not V' A V of the model, by 4.8e-02 of it")
    changed("density = 7.85e-9", "density = 7.9e-9", "the masses are")
    changed('name = "right"', 'name = "end"', "the interfaces are left, right and left, end")
    average = 'nodes = "set:RIGHT"\ncoupling = "average"'
    changed('nodes = "set:RIGHT"', average, "is rigid [0, 1, 2, 3, 4, 5] and average")
    changed('nodes = "set:RIGHT"', 'nodes = "box:29,-1,-1,31,11,21"', "interface 'right' is at")
    changed("[output]", "[preload]\nspeed = 1.0\naxis = [1, 0, 0]\n\n[output]", "it has a table 'preload'")
    damped = "[damping]\nrayleigh = { beta = 1e-6 }\n\n[output]"
    changed("[output]", damped, "its damping is not V' A V of the model, and it has none")
    changed("[output]", f"{STRUCTURAL}\n[output]", "has structural damping of 0.02; reduce the parts without it")
    changed("young", "youngs", "unknown key 'youngs'")
    # A node has moved since, and one more cube is there.
    (job.parent / "part.inp").write_text(mesh.replace("20.0, 10.0, 10.0", "20.0, 10.5, 10.0"))
    refused("its body was not reduced from its model")
    (job.parent / "part.inp").write_text(decks.deck(decks.BEAM[:16]))
    refused("its body was not reduced from its model")
    (job.parent / "part.inp").write_text(mesh)
    for old, new, words in (
        (str(job), str(job) + "l", "cannot be read"),
        (f'job = "{job}"', f'job = "{path}"', "it has a table 'substructure'"),
        ("[certify]", "[response]", "add [certify], or leave job out"),
        ('path = "arm.h5"', f'path = "{job.parent / "part.inp"}"', "would overwrite the mesh of it"),
        ("position", "at = { E = 1.0 }\nposition", "job was given beside at"),
    ):
        assert old in text
        new_text = text.replace(old, new)
        if words.startswith("add"):
            new_text = new_text.replace(f"band_hz = {BAND}\npoints = 20", "from_hz = 10\nto_hz = 20")
        path.write_text(new_text)
        refused(words)
    path.write_text(text.replace(f'job = "{job}"\n', "", 1))
    refused("the parts 'p0' have no job")


def test_a_budget_that_the_parts_exceed_is_refused(tmp_path: Path) -> None:
    job = load_job(arm(tmp_path, [part := link(tmp_path), part]))
    model = assembly_of(job)
    with (
        Budget(1_000_000, tmp_path),
        morembs.Problem(model, interfaces_of(job, model)) as problem,
        refusal("memory", "", "[[substructure]]", by=BudgetError),
    ):
        morembs.Unreduced(problem)


def test_beams_with_rotations_are_parts(tmp_path: Path) -> None:
    """Two straight tubes at an angle are the bent one, with a frame beside its end too."""
    line = np.linspace([0.0, 0, 0], [0.4, 0, 0], 7)
    model = morembs.tube_model(line, STEEL)
    ends = [
        morembs.make_interface(model, name=name, nodes=[row], point=line[row] + shift)
        for name, row, shift in (("A", 0, [0.0, 0.01, 0.02]), ("B", 6, [0.0, 0, 0]))
    ]
    turn = Rotation.from_rotvec([0.3, 0.8, -0.5]).as_matrix()
    with morembs.Problem(model, ends) as single:
        reduced = morembs.CraigBampton(modes=4).reduce(single)
        bodies = read_body(
            write_body(tmp_path / "tube.h5", [morembs.elastic_body(single, reduced, morembs.make_part(single))])
        )
        # The tubes meet at their ends B: the second goes on from there.
        place = line[6] - turn @ line[6]
        parts = [
            morembs.Substructure(name="a", bodies=bodies, problem=single, basis=lambda: reduced.V),
            morembs.Substructure(
                name="b", bodies=bodies, problem=single, basis=lambda: reduced.V, position=place, rotation=turn
            ),
        ]
        assembled = morembs.assemble_bodies(parts, [morembs.Couple(between=("a:B", "b:B"))])
        tips = [morembs.make_interface(assembled, name=n, nodes=assembled.nodes.sets[f"{n}:A"]) for n in "ab"]
        with morembs.Problem(assembled, tips) as small, morembs.Unreduced(small) as full:
            ours = full.problem.elastic_modes(count=8).frequencies_hz
            again = morembs.CraigBampton(modes=10).reduce(small)
            [known] = morembs.certify(full.problem, [full.expand(again)], [0.0, float(ours[5])])
    bent = morembs.tube_model(np.vstack([line, (line @ turn.T + place)[5::-1]]), STEEL)
    with morembs.Problem(bent, [morembs.make_interface(bent, name="A", nodes=[0])]) as problem:
        assert ours == pytest.approx(problem.elastic_modes(count=8).frequencies_hz, rel=1e-7)
    assert known.kind == "proven" and known.mode_mac[:3].min() > 0.99
    assert (known.mode_deviation[:3] < 1e-2).all()
