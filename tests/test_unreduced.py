"""Certificates of assemblies against the unreduced parts: from the command line, against dense solutions of these."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import morembs
from morembs.body.file import StoredBodies, read_body
from morembs.cli.commands import app
from tests.support import decks
from tests.support.dense_assembly import Joint, Part, Whole, elastic

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


def link(folder: Path, name: str = "link", *, cells: int = 3, **tables: str) -> Path:
    """The job of a part, done."""
    (folder / name).mkdir()
    job = decks.folder(folder / name, {"output": 'path = "part.h5"', **tables}, decks.deck(decks.BEAM[: 4 * cells]))
    run("reduce", str(job), "--quiet")
    return job


def arm(
    folder: Path, jobs: list[Path], *, couple: str = "", turned: bool = False, swapped: bool = False, more: str = "",
    modes: int = 6, certified: bool = True, name: str = "arm",
) -> Path:  # fmt: skip
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
    for part in (couple or "").split("+"):
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
    return stored, body.certificate


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
        [(*RIGID[:2], (0, 1, 2), None, None), (*SPRUNG[:2], (3, 4, 5), *SPRUNG[3:])], {}, {},
    ),
    "means": ("", [RIGID], {"coupling": "average"}, {"average": True}),
}  # fmt: skip


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_the_error_against_the_unreduced_parts_is_that_of_dense_solutions(
    case: str, turned: bool, tmp_path: Path
) -> None:
    couple, joints, interfaces, same = CASES[case]
    tables = {
        f"interface{k}": f'name = "{name}"\nnodes = "set:{name.upper()}"\n'
        + "".join(f'{key} = "{value}"\n' for key, value in interfaces.items())
        for k, name in (("", "left"), (2, "right"))
    }
    job = link(tmp_path, **tables)
    damped = "stiffness" in couple
    floor = 0.0 if damped else 0.03
    more = "" if damped else f"[damping]\nstructural = {floor}\n"
    stored, known = certificate(arm(tmp_path, [job, job], couple=couple, turned=turned, more=more))
    dense = whole([job, job], joints, turned=turned, **same)
    assert not any("own errors are not in them" in warning for warning in stored.warnings)
    assert known["bound_kind"] == ("estimate" if damped else "bound")
    hz = known["frequencies_hz"][1:]
    true = true_errors(stored, dense, hz, floor)
    assert (known["bound"][1:] >= true * (1 - 1e-9)).all()
    assert known["error"][1:] == pytest.approx(true, rel=1e-4, abs=1e-7)
    # Between these frequencies too, and not by far.
    hz = np.random.default_rng(5).uniform(100.0, BAND[1], 25)
    cell = np.searchsorted(known["cells_hz"][:, 1], hz)
    limit = known["cell_limit"][cell, 2]
    assert (limit >= true_errors(stored, dense, hz, floor)).all()
    elastic_hz = dense.frequencies_hz[6:]
    count = int((elastic_hz < BAND[1]).sum())
    assert count >= 2 and known["mode_frequencies_hz"] == pytest.approx(elastic_hz[:count], rel=1e-7)
    (body,) = stored.bodies.values()
    off = body.frequencies_hz[6 : 6 + count] / elastic_hz[:count] - 1
    assert known["mode_deviation"][:2] == pytest.approx(off[:2], rel=1e-3, abs=1e-9)
    # The body is compared with the frequencies of the whole.
    assert body.full_frequencies_hz[6 : 6 + count] == pytest.approx(elastic_hz[:count], rel=1e-6)
