"""Nastran decks that MYSTRAN assembles: its matrices on the right grids, and its own frequencies."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse.linalg as sla
from typer.testing import CliRunner

from morembs import InputError
from morembs.app.cli import app
from morembs.fem import FEModel, rigid_motion
from morembs.fem.material import isotropic
from morembs.importers import import_file
from morembs.importers.decks.problems import DeckError
from morembs.importers.model_file import read_model
from morembs.importers.to_model import model_of
from tests.support import mystran
from tests.support.calculix import independent, program, solids
from tests.support.decks import refusals
from tests.support.meshes import box
from tests.support.mystran import HEAD, STEEL, eigenvalues, grids, needs_mystran, plate, turned
from tests.support.refusals import refusal

T = turned(0.7, 0.5)
SHEET = plate(6, 4, T) + "PSHELL,1,1,.01,1,,1\n" + STEEL
FRAME = np.array([[0, 0, 0], [0, 0, 1], [0.5, 0, 1], [1, 0.2, 1], [1, 0.2, 0.5], [1, 0.2, 0]], dtype=float)
BARS = (
    "CBAR,1,1,1,2,1.,.3,0.\nCBAR,2,1,2,3,0.,1.,.2\nCBAR,3,1,3,4,0.,1.,.2\nCBAR,4,1,4,5,1.,.3,0.\n"
    "CBAR,5,1,5,6,1.,.3,0.\nSPC1,1,123456,1,6\n"
)
PBAR = "PBAR,1,1,1.-3,2.-7,4.-7,3.-7,.5\n"
THIRD = "CBAR,3,1,3,4,0.,1.,.2\n"
SYSTEMS = "CORD2C,4,,.2,.1,0.,.3,.4,1.\n,1.,.1,.2\nCORD2R,5,,0.,0.,0.,.3,.2,1.\n,1.,.5,.2\n"
MIXED = (
    SHEET + "GRID,100,,1.2,.3,.4\nRBE2,910,100,123456,31,32,33,34\n,24\nCONM2,900,100,,3.\n,.1,,.2,,,.3\n"
    "CBAR,200,2,35,30,1.,.2,.3\n,,,.01,.02,0.,.01,.02,0.\nPBAR,2,1,1.-4,1.-9,2.-9,1.-9\n"
)


def imported(folder: Path, deck: str, executable: object = "", **options: object) -> FEModel:
    path = folder / "deck.bdf"
    path.write_text(deck if "ENDDATA" in deck else f"{deck}ENDDATA\n")
    return model_of(import_file(path, options=options, engine=f"mystran:{executable}"))


def of_rigid_motion(model: FEModel) -> np.ndarray:
    return rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)


def masses(model: FEModel) -> np.ndarray:
    R = of_rigid_motion(model)[:, :3]
    return R.T @ (model.M @ R)


def assert_free(model: FEModel, strain: float = 1e-14) -> None:
    """Rigid motion is followed and strains nothing, and nothing else costs no energy."""
    R = of_rigid_motion(model)
    assert np.abs(model.K @ R).max() < strain * (abs(model.K) @ np.abs(R)).max()
    if model.dependent is not None:
        assert np.abs(model.dependent.S @ R - R).max() < 1e-8 * np.abs(R).max()
    K = independent(model)[0].toarray()
    scale = 1.0 / np.sqrt(K.diagonal())
    assert (np.linalg.eigvalsh(scale[:, None] * K * scale) < 1e-11).sum() == 6


def boxes(head: str = "") -> str:
    """A skew block of 4 x 2 x 2 CHEXA with the property 1, held at x = 0."""
    at = [(i, j, k) for i in range(5) for j in range(3) for k in range(3)]
    number = {place: row for row, place in enumerate(at, 1)}
    xyz = np.array([(i / 4, 0.1 * j + 0.1 * i / 4, 0.08 * k) for i, j, k in at])
    lines = []
    for e, (i, j, k) in enumerate((i, j, k) for i in range(4) for j in range(2) for k in range(2)):
        a, b, c, d = ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1))
        nodes = [str(number[(*p, k + up)]) for up in (0, 1) for p in (a, b, c, d)]
        lines.append(f"CHEXA,{e + 1},1,{','.join(nodes[:6])}\n,{','.join(nodes[6:])}")
    held = "".join(f"SPC1,1,123,{n}\n" for place, n in number.items() if place[0] == 0)
    return grids(xyz) + "\n".join(lines) + "\n" + held + head


DECKS = {
    "shell turned in space": (SHEET, 39.25),
    "triangles": (plate(6, 4, T, triangles=True) + "PSHELL,1,1,.01,1,,1\n" + STEEL, 39.25),
    "cylinder": (plate(6, 4, T, radius=1.0) + "PSHELL,1,1,.01,1,,1\n" + STEEL, None),
    "orthotropic": (
        plate(6, 4, T, tail=",30.") + "PSHELL,1,2,.01,2,,2\nMAT8,2,1.+11,1.+10,.3,5.+9,5.+9,5.+9,1600.\n",
        8.0,
    ),
    "material axes": (
        plate(6, 4, T, tail=",4,.002") + SYSTEMS + "PSHELL,1,2,.01,2,,2,,3.\n"
        "MAT8,2,1.+11,1.+10,.3,5.+9,5.+9,5.+9,1600.\n",
        9.5,
    ),
    "rigid element with a mass": (
        SHEET + "GRID,100,,1.2,.3,.4\nRBE2,910,100,123456,31,32,33,34\n,24\nCONM2,900,100,,3.\n,.1,,.2,,,.3\n",
        42.25,
    ),
    "average element": (
        SHEET + "GRID,100,,1.2,.3,.4\nRBE3,910,,100,123456,1.,123,31,22\n,33,34,35\nCONM2,900,100,,3.\n,.1,,.2,,,.3\n",
        42.25,
    ),
    "equation": (SHEET + "MPC,1,33,3,1.,35,3,-.5\n,,31,3,-.5\n", 39.25),
    "springs": (
        SHEET + "GRID,999,,1.,0.,0.\nSPC1,1,123456,999\nCELAS2,901,5.+4,31,3,999,3\nCMASS2,903,1.5,31,1\n"
        "CBUSH,50,50,33,999,,,,5\nPBUSH,50,K,1.+4,2.+4,3.+4,100.,200.,300.\n" + SYSTEMS,
        None,
    ),
    "bars": (grids(FRAME) + BARS + PBAR + STEEL, None),
    "bars with shear": (grids(FRAME) + BARS + PBAR.strip() + "\n,,,,,,,,\n,.8,.7\n" + STEEL, None),
    "bars of skew section": (grids(FRAME) + BARS + PBAR.strip() + "\n,,,,,,,,\n,,,1.-7\n" + STEEL, None),
    "pins": (grids(FRAME) + BARS.replace(THIRD, f"{THIRD},,56\n") + PBAR + STEEL, None),
    "offsets along turned axes": (
        grids(FRAME, cd="4")
        + SYSTEMS
        + PBAR
        + STEEL
        + BARS.replace("SPC1,1,123456,1,6", "SPC1,1,123456,1\nSPC1,1,13,6").replace(
            THIRD, f"{THIRD},,,.0,.02,.05,.0,.02,.05\n"
        ),
        None,
    ),
    "third grid": (grids(FRAME) + "GRID,9,,5.,7.,3.\n" + BARS.replace("0.,1.,.2", "9") + PBAR + STEEL, None),
    "tubes": (grids(FRAME) + BARS + "PBARL,1,1,,TUBE\n,.03,.02,.5\n" + STEEL, None),
    "solids": (boxes("PSOLID,1,1,0,TWO\n" + STEEL), 251.2),
    "solids in full": (boxes("PSOLID,1,1,0,TWO,,FULL\n" + STEEL), 251.2),
}


@needs_mystran
@pytest.mark.parametrize("name", DECKS)
def test_decks_have_the_frequencies_of_mystran_and_their_mass(tmp_path, name):
    bulk, kilograms = DECKS[name]
    deck = HEAD.format(5).replace("SPC = 1\n", "SPC = 1\nMPC = 1\n" if "MPC," in bulk else "SPC = 1\n") + bulk
    held = imported(tmp_path, deck, boundary="keep")
    own = mystran.own_eigenvalues(f"{deck}ENDDATA\n", tmp_path)
    # It prints seven digits, and the last ones asked for are less exact.
    assert np.sqrt(eigenvalues(held, 4)) == pytest.approx(np.sqrt(own[:4]), rel=5e-7)
    free = imported(tmp_path, deck)
    if name not in ("springs", "equation", "pins"):
        assert_free(free)
    if kilograms is not None:
        assert masses(free) == pytest.approx(kilograms * np.eye(3), rel=1e-8, abs=1e-8 * kilograms)


@needs_mystran
@pytest.mark.parametrize(("card", "like", "triangles"), [("CQUADR", "CQUAD4", False), ("CTRIAR", "CTRIA3", True)])
def test_shells_that_resist_rotation_about_their_normal_are_plain_ones_with_a_warning(tmp_path, card, like, triangles):
    sheet = plate(6, 4, T, triangles=triangles) + "PSHELL,1,1,.01,1,,1\n" + STEEL
    plain, model = imported(tmp_path, sheet), imported(tmp_path, sheet.replace(like, card))
    assert (plain.K != model.K).nnz == 0 and (plain.M != model.M).nnz == 0
    (said,) = set(model.warnings) - set(plain.warnings)
    assert f"{card} are written as {like}" in said and said.endswith("[formulation-differs]")


@needs_mystran
def test_a_mass_beside_its_grid_turns_a_flat_sheet_about_its_normal(tmp_path):
    """Along the axes, where MYSTRAN leaves that rotation empty, as turned in space."""
    found = []
    for turn in (np.eye(3), T):
        x, y, z = turn @ [0.1, 0.2, 0.3]
        bulk = plate(6, 4, turn) + "PSHELL,1,1,.01,1,,1\n" + STEEL + f"CONM2,900,35,,3.,{x:.6f},{y:.6f},{z:.6f}\n"
        model = imported(tmp_path, bulk)
        assert_free(model)
        assert masses(model) == pytest.approx(42.25 * np.eye(3), rel=1e-8, abs=1e-6)
        K, M = (A.toarray() for A in independent(model)[:2])
        inverse = np.linalg.eigvals(np.linalg.solve(K + 1e4 * M, M)).real
        found.append(np.sort(1 / np.sort(inverse)[-10:-6] - 1e4))
    assert found[0] == pytest.approx(found[1], rel=1e-5) and found[0].min() > 1.0


@needs_mystran
def test_shear_that_mystran_leaves_out_is_told(tmp_path):
    bars = grids(FRAME) + BARS + PBAR.strip() + "\n,,,,,,,,\n,.8,.7,1.-7\n" + STEEL
    assert any("PBAR 1 has I12 and shear factors" in warning for warning in imported(tmp_path, bars).warnings)


@needs_mystran
def test_groups_add_up_to_the_whole(tmp_path):
    whole = imported(tmp_path, MIXED, grids=1000)
    parts = imported(tmp_path, MIXED, grids=9, jobs=2)
    assert np.array_equal(whole.dofs.node, parts.dofs.node)
    for matrix, summed in ((whole.K, parts.K), (whole.M, parts.M)):
        assert np.abs((matrix - summed).data).max() <= 1e-13 * np.abs(matrix.data).max()
    assert (imported(tmp_path, MIXED, grids=9, jobs=1).K != parts.K).nnz == 0


@needs_mystran
def test_a_bar_bends_and_a_plate_vibrates_as_theory_says(tmp_path):
    cantilever = grids(np.column_stack([np.linspace(0, 2, 5), np.zeros(5), np.zeros(5)]) @ T.T)
    y = ",".join(f"{value:.9f}" for value in T[:, 1])
    cantilever += "".join(f"CBAR,{i},1,{i},{i + 1},{y}\n" for i in range(1, 5)) + "SPC1,1,123456,1\n" + PBAR + STEEL
    model = imported(tmp_path, cantilever, boundary="keep")
    K, _ = independent(model)
    free = np.flatnonzero(model.dependent.owner < 0)
    for axis, inertia in ((1, 2e-7), (2, 4e-7)):
        load = np.where(model.nodes.ids[model.dofs.node] == 5, T[np.minimum(model.dofs.component, 2), axis], 0.0)
        load[model.dofs.component > 2] = 0.0
        deflection = load[free] @ sla.spsolve(K.tocsc(), load[free])
        assert deflection == pytest.approx(2.0**3 / (3 * 2.1e11 * inertia), rel=1e-9)

    def error(n: int) -> float:
        square = plate(n, n, np.diag([1.0, 2.0, 1.0])).split("SPC1")[0]
        # The hard simple support: an edge does not turn across itself.
        ends = [f"{i * (n + 1) + j + 1}" for i in range(n + 1) for j in range(n + 1) if i in (0, n)]
        sides = [f"{i * (n + 1) + j + 1}" for i in range(n + 1) for j in range(n + 1) if j in (0, n)]
        held = "".join(f"SPC1,1,1234,{i}\n" for i in ends) + "".join(f"SPC1,1,1235,{i}\n" for i in sides)
        deck = square + held + "PSHELL,1,1,.01,1,,1\n" + STEEL
        bending = 2.1e11 * 0.01**3 / (12 * (1 - 0.09))
        exact = 2 * np.pi**2 * np.sqrt(bending / (7850 * 0.01))
        return float(np.sqrt(eigenvalues(imported(tmp_path, deck, boundary="keep"), 1)[0]) / exact - 1)

    # Quadratic in the size of elements, but for the shear of a plate of finite thickness (3e-4).
    assert abs(error(16)) < 0.0015 and abs(error(16)) < 0.4 * abs(error(8))


# Decks of properties of each kind, and the mass along x.
PROPERTIES = [
    (SHEET.replace("PSHELL,1,1,.01,1,,1", "PCOMP,1,,3.\n,1,.003,0.,NO,1,.004,90.,NO\n,1,.002,0.,NO"), 36.825),
    (SHEET.replace("PSHELL,1,1,.01,1,,1", "PCOMP,1,,,,,,,SYM\n,1,.003,0.,NO,,,90.,NO"), 47.1),
    (SHEET.replace("PSHELL,1,1,.01,1,,1", "PCOMPG,1\n,1,1,.003,0.,NO\n,2,1,.004,0.,NO"), 27.475),
    (
        SHEET.replace("CQUAD4", "CSHEAR").replace("PSHELL,1,1,.01,1,,1", "PSHEAR,1,1,.01,2.")
        + "".join(f"CROD,{100 + i},2,{a},{b}\n" for i, (a, b) in enumerate([(1, 6), (6, 11)]))
        + "PROD,2,1,0.\n",
        40.25,
    ),
    (
        grids(FRAME[[0, 2]]) + "CTUBE,1,1,1,2\nPTUBE,1,1,.03,.004,.5\n" + STEEL,
        np.sqrt(1.25) * (7850 * np.pi / 4 * (0.03**2 - 0.022**2) + 0.5),
    ),
    (grids(FRAME[[0, 2]]) + "CONROD,7,1,2,1,1.-3,1.-7,,.2\n" + STEEL, np.sqrt(1.25) * 8.05),
    (
        grids(FRAME[[0, 2]]) + "CBEAM,1,1,1,2,0.,1.,0.\nPBEAM,1,1,1.-3,2.-7,4.-7,,3.-7,.5\n" + STEEL,
        np.sqrt(1.25) * 8.35,
    ),
    (
        grids(FRAME[[0, 2]])
        + "CBEAM,1,1,1,2,0.,1.,0.\nPBEAML,1,1,,BOX\n,.1,.2,.01,.02,.5,YES,1.,.1\n,.2,.01,.02,.5\n"
        + STEEL,
        np.sqrt(1.25) * (7850 * (0.02 - 0.06 * 0.18) + 0.5),
    ),
    (SHEET.replace("7850.", ""), 39.25),
]


@needs_mystran
@pytest.mark.parametrize(("bulk", "kilograms"), PROPERTIES)
def test_kinds_of_properties_have_their_mass(tmp_path, bulk, kilograms):
    extra = {} if "7850." in bulk else {"density": 7850.0}
    assert masses(imported(tmp_path, bulk, **extra)) == pytest.approx(kilograms * np.eye(3), rel=1e-8, abs=1e-8)


@needs_mystran
def test_means_are_those_of_grids_that_nothing_holds_along_an_axis(tmp_path):
    """Bars without area have no stiffness and no mass along themselves."""
    bars = grids(FRAME[:3]) + "GRID,9,,.2,.3,.4\nRBE3,5,,9,123456,1.,123,1,2\n,3\nCONM2,6,9,,3.\n"
    bars += "CBAR,1,1,1,2,1.,.3,0.\nCBAR,2,1,2,3,0.,1.,.2\nPBAR,1,1,,2.-7,4.-7,3.-7\n" + STEEL
    assert masses(imported(tmp_path, bars))[0, 0] == pytest.approx(3.0, rel=1e-12)


@needs_mystran
def test_solids_in_full_are_those_of_own_assembly(tmp_path):
    deck = boxes("PSOLID,1,1,0,TWO,,FULL\n" + STEEL)
    model = imported(tmp_path, deck)
    own = model_of(import_file(tmp_path / "deck.bdf"))
    assert np.array_equal(model.dofs.node, own.dofs.node) and model.mesh.element_count == 16
    assert np.abs((model.K - own.K).data).max() < 3e-13 * np.abs(own.K.data).max()
    mass = np.ones(own.size) @ (own.M @ np.ones(own.size))
    assert np.ones(own.size) @ (model.M @ np.ones(own.size)) == pytest.approx(mass, rel=1e-12)


@needs_mystran
@pytest.mark.parametrize(("kind", "card", "nearly"), [("hex20", "CHEXA", 1e-13), ("tet10", "CTETRA", 2e-8)])
def test_quadratic_solids_are_those_of_own_assembly(tmp_path, kind, card, nearly):
    """Points of MYSTRAN's tetrahedra have nine digits."""
    mesh = box(kind, (1, 1, 1), (1.0, 1.2, 0.9))
    # Nastran lists the middles of upright edges before those of the top.
    order = [*range(12), *range(16, 20), *range(12, 16)] if kind == "hex20" else list(range(10))
    lines = []
    for element, nodes in enumerate((mesh.blocks[0].nodes + 1).tolist(), 1):
        words = [card, str(element), "1", *(str(nodes[i]) for i in order)]
        lines.append(",".join(words[:9]))
        lines += [f",{','.join(words[at : at + 8])}" for at in range(9, len(words), 8)]
    model = imported(tmp_path, grids(mesh.nodes.xyz) + "\n".join(lines) + "\nPSOLID,1,1,0,THREE,,FULL\n" + STEEL)
    own = model_of(import_file(tmp_path / "deck.bdf"))
    assert np.abs((model.K - own.K).data).max() < nearly * np.abs(own.K.data).max()
    assert masses(model) == pytest.approx(masses(own), rel=1e-8, abs=1e-6)


@pytest.mark.parametrize("where", ["stored", pytest.param("mystran", marks=needs_mystran)])
def test_a_frame_with_a_sheet_becomes_a_body_on_the_command_line(tmp_path, where):
    executable = mystran.replay(tmp_path, "mixed") if where == "stored" else ""
    (tmp_path / "deck.bdf").write_text(f"{MIXED}ENDDATA\n")
    model, kept = tmp_path / "part.model.h5", tmp_path / "kept"
    line = ["import", str(tmp_path / "deck.bdf"), "--engine", f"mystran:{executable}", "-o", str(model)]
    done = CliRunner().invoke(app, [*line, "--keep-files", str(kept), "--check"])
    assert done.exit_code == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert "read as nastran (mystran)" in said and "those of MYSTRAN 18.0.0" in said and "[formulation-differs]" in said
    assert {"group1.bdf", "group1.OU1"} <= {path.name for path in kept.iterdir()}
    (tmp_path / "job.toml").write_text(
        f'[model]\nfile = "{model}"\n[[interface]]\nname = "tip"\nnodes = "coupling:RBE2_910"\n'
        '[[interface]]\nname = "foot"\nnodes = "ids:1,2,3,4,5"\ncoupling = "rigid"\n'
        '[[reduce]]\nmethod = "craig-bampton"\nmodes = 5\n[output]\npath = "out.h5"\n'
    )
    reduced = CliRunner().invoke(app, ["reduce", str(tmp_path / "job.toml")])
    assert reduced.exit_code == 0, reduced.stderr
    read = read_model(model)
    assert set(read.nodes.sets) >= {"PSHELL_1", "PBAR_2"}
    assert masses(read)[0, 0] == pytest.approx(42.25 + 7850e-4 * 0.5 / 3, rel=1e-2)


WRITES = "pathlib.Path(pathlib.Path(job).stem + '.OU1').write_bytes({!r})\nprint('MYSTRAN END')"
SAYS = "pathlib.Path(pathlib.Path(job).stem + '.ERR').write_text({!r})"


def output(size: int, value: float = 1.0) -> bytes:
    """KGG and MGG as MYSTRAN writes them: diagonal matrices."""
    data = b""
    for name in (b"KGG     ", b"MGG     "):
        head = np.array([size, size, 6, 2], dtype="<i4").tobytes() + name
        entry = np.array([value]).tobytes()
        columns = [np.array([i + 1, i + 1, 2], dtype="<i4").tobytes() + entry for i in range(size)]
        columns.append(np.array([size + 1, 1, 2], dtype="<i4").tobytes() + np.array([1.0]).tobytes())
        for record in (head, *columns):
            mark = np.array([len(record)], dtype="<i4").tobytes()
            data += mark + record + mark
    return data


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("time.sleep(60)", ("result", "engine_timeout", "MYSTRAN", "0.5", "35", "--engine-timeout")),
        (
            SAYS.format(" *ERROR  1950: QUAD4 ELEMENT 24 IS WRONG\n"),
            ("program", "", "ERROR", "1950", "QUAD4", "ELEMENT"),
        ),
        ("print('segmentation')", ("program", "", "segmentation")),
        (WRITES.format(b""), ("program",)),
        (WRITES.format(output(210)[:-40]), ("program",)),
        (WRITES.format(b"\x00\x01garbage" * 30), ("program",)),
        (WRITES.format(output(204)), ("program", "", "204", "210")),
        (WRITES.format(output(210, np.nan)), ("program", "", "KGG")),
        (
            WRITES.format(output(210)) + "\n" + SAYS.format(" *LOADB-WARNING : PRIOR ENTRY NOT PROCESSED BY MYSTRAN\n"),
            ("program",),
        ),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)", ("program", "", "SIGKILL")),
    ],
    ids=["hangs", "error", "crash", "empty", "half", "garbage", "size", "nan", "passed over", "killed"],
)
def test_what_mystran_may_do_wrong_is_one_message(tmp_path, body, message):
    executable = program(tmp_path, body)
    with refusal(*message):
        imported(tmp_path, SHEET, executable, timeout=0.5 if "sleep" in body else 30.0, jobs=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ccx-of-the-test", "deck.bdf"]


def test_a_run_that_fails_ends_the_others(tmp_path):
    body = "import os\nif 'group1.' in job:\n    time.sleep(0.3)\n    sys.exit()\ntime.sleep(60)"
    with refusal("program", "", "deck.bdf", "MYSTRAN", "--keep-files"):
        imported(tmp_path, SHEET, program(tmp_path, body), grids=20, jobs=4, timeout=50.0)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("CQUAD8,90,1,1,2,3,4,5,6\n,7,8\n", ("unsupported", "CQUAD8")),
        ("CBAR,90,9,1,2,0.,0.,1.\n", ("value", "CBAR", "90", "9", "PBAR", "PBARL")),
        ("CBAR,90,9,1,2\nPBAR,9,1,1.-3\n", ("missing", "CBAR", "90")),
        # The flag of COSMIC NASTRAN where others have OFFT.
        ("CBAR,90,9,1,2,0.,0.,1.,2\nPBAR,9,1,1.-3\n", ("file", "CBAR", "90")),
        ("CBAR,90,9,1,2,3,,,3\nPBAR,9,1,1.-3\n", ("value", "CBAR", "90")),
        ("CBAR,90,9,1,2,0.,0.,1.\nPBARL,9,1,,HAT\n,.1,.01,.1,.05\n", ("unsupported", "", "HAT", "MYSTRAN")),
        (
            "CBEAM,90,9,1,2,0.,0.,1.\nPBEAM,9,1,1.-3,1.-7,1.-7,,1.-7\n,,,,,,,,\n,NO,1.,2.-3\n",
            ("unsupported", "CBEAM", "PBEAM", "9"),
        ),
        ("CQUAD4,90,9,1,2,3,4\nPSHELL,9,1,.01,1,,,,\n,,,1\n", ("unsupported", "CQUAD4", "PSHELL", "9")),
        ("CQUAD4,90,9,1,2,2,4\nPSHELL,9,1,.01\n", ("conflict", "CQUAD4", "90")),
        ("CROD,90,9,1,2\nPROD,9,7,1.-3\n", ("missing", "MATERIAL", "7")),
        ("CROD,90,9,1,999\nPROD,9,1,1.-3\n", ("unknown", "CROD", "999")),
    ],
)
def test_what_mystran_has_not_is_refused_before_a_run(tmp_path, lines, message):
    with refusal(*message):
        imported(tmp_path, SHEET + lines, program(tmp_path, "sys.exit()"))


@needs_mystran
@pytest.mark.parametrize("owner", ["all", "PSHELL_1"])
def test_a_material_is_given_to_properties_without_one(tmp_path, owner):
    whole = imported(tmp_path, SHEET)
    (tmp_path / "deck.bdf").write_text(SHEET.replace(STEEL, "") + "ENDDATA\n")
    cure = "--material young=..,poisson=..,density=..,set=PSHELL_1"
    assert refusals(lambda: import_file(tmp_path / "deck.bdf", engine="mystran")) == [("MATERIAL", 0, (cure,))]
    steel = isotropic(set=owner, young=2.1e11, poisson=0.3, density=7850.0)
    given = model_of(import_file(tmp_path / "deck.bdf", engine="mystran", materials=[steel]))
    for A, B in ((given.K, whole.K), (given.M, whole.M)):
        assert abs(A - B).max() < 1e-12 * abs(B).max()


@pytest.mark.parametrize(
    ("name", "owner", "message"),
    [
        ("a.bdf", "NOPE", ("unknown", "", "--material", "NOPE", "a.bdf", "PSHELL_1")),
        ("a.bdf", "all", ("value", "", "--material", "all")),
        ("a.inp", "NOPE", ("unknown", "", "--material", "NOPE", "a.inp")),
        ("a.inp", "E", ("value", "", "--material", "E")),
    ],
)
def test_a_material_that_nothing_needs_is_refused(tmp_path, name, owner, message):
    shells = abaqus_plate("S4R", "*SHELL SECTION,ELSET=E,MATERIAL=S\n.01\n")
    (tmp_path / name).write_text(shells if name == "a.inp" else f"{SHEET}ENDDATA\n")
    steel = isotropic(set=owner, young=2.1e11, poisson=0.3, density=7850.0)
    with refusal(*message, by=DeckError):
        import_file(tmp_path / name, engine=f"mystran:{program(tmp_path, 'sys.exit()')}", materials=[steel])


@needs_mystran
def test_a_material_takes_the_place_of_one_without_density(tmp_path):
    """Of bulk data and of an Abaqus deck, whose sets and materials are told by their own names."""
    whole = imported(tmp_path, SHEET)
    section = "*SHELL SECTION,ELSET=E,MATERIAL=S\n.01\n"
    bare = abaqus_plate("S4R", section).replace("*DENSITY\n7850.\n", "")
    (tmp_path / "a.inp").write_text(bare.replace("2.1e11", "1e9"))
    (tmp_path / "a.bdf").write_text(SHEET.replace("2.1+11,,.3,7850.", "1.+9,,.3") + "ENDDATA\n")
    for name, told_set in (("a.bdf", "PSHELL_1"), ("a.inp", "E")):
        told = refusals(partial(import_file, tmp_path / name, engine="mystran"))
        assert told == [("DENSITY", 0, ("--density X",))]
        for owner in ("all", told_set):
            steel = isotropic(set=owner, young=2.1e11, poisson=0.3, density=7850.0)
            model = model_of(import_file(tmp_path / name, engine="mystran", materials=[steel]))
            assert abs(model.K - whole.K).max() < 1e-9 * abs(whole.K).max()
            assert abs(model.M - whole.M).max() < 1e-9 * abs(whole.M).max()
            assert any("the material that was given took its place" in warning for warning in model.warnings)
            assert not any("case control" in note for note in model.notes) or name == "a.bdf"


def test_shells_without_density_are_refused_beside_those_that_have_one(tmp_path):
    """Whoever assembles; bars of bulk data without RHO may hang on what has mass."""
    bare = abaqus_plate("S4R", "*SHELL SECTION,ELSET=A,MATERIAL=S\n.01\n*SHELL SECTION,ELSET=B,MATERIAL=S\n.01\n")
    sets = "*ELSET,ELSET=A,GENERATE\n1,12\n*ELSET,ELSET=B,GENERATE\n13,24\n"
    (tmp_path / "a.inp").write_text(bare.replace("*DENSITY\n7850.\n", "").replace("*MATERIAL", f"{sets}*MATERIAL", 1))
    engine = f"mystran:{program(tmp_path, 'sys.exit()')}"
    for way, card in ((engine, "DENSITY"), (None, "")):
        with refusal("missing", card, "B", "X,set=B"):
            model_of(import_file(tmp_path / "a.inp", engine=way, options={"density": {"A": 1.0}}))
    with refusal("program", "", "MYSTRAN"):
        import_file(tmp_path / "a.inp", engine=engine, options={"density": {"A": 7850.0, "B": 7850.0}})
    light = "CBAR,200,2,35,30,1.,.2,.3\nPBAR,2,2,1.-4,1.-9,2.-9,1.-9\nMAT1,2,2.1+11,,.3\n"
    (tmp_path / "a.bdf").write_text(f"{SHEET}{light}ENDDATA\n")
    with refusal("program", "", "MYSTRAN"):
        import_file(tmp_path / "a.bdf", engine=engine)


@needs_mystran
def test_supports_of_an_abaqus_deck_are_kept_or_dropped(tmp_path):
    """In the order of the deck, one along axes of its node; K of the body that is held along each."""
    turned = "*NSET,NSET=T\n1\n*TRANSFORM,NSET=T,TYPE=R\n.6,.8,0.,-.8,.6,0.\n*BOUNDARY\n2,1,6\nT,1\n2,1,2\n"
    text = abaqus_plate("S4R", "*SHELL SECTION,ELSET=E,MATERIAL=S\n.01\n") + turned
    (tmp_path / "a.inp").write_text(text)
    for boundary, count in (("drop", 0), ("keep", 7)):
        imported = import_file(tmp_path / "a.inp", engine="mystran", options={"boundary": boundary})
        assert sum(len(own) for own in imported.equations) == count
    (own,) = imported.equations
    labels = imported.nodes.ids[own.nodes]
    assert sorted(labels.tolist()) == [1, *[2] * 6] and sorted(own.components[labels == 2].tolist()) == list(range(6))
    assert imported.nodes.ids[own.term_nodes].tolist() == [1] and abs(own.coefficients[0]) == pytest.approx(0.75)


@needs_mystran
def test_a_density_that_is_given_for_a_set_of_an_abaqus_deck_is_taken(tmp_path):
    body = solids("C3D8", (2, 1, 1), (2.0, 1.0, 1.0)).replace("*DENSITY\n7850.\n", "")
    (tmp_path / "a.inp").write_text(body)
    told = refusals(lambda: import_file(tmp_path / "a.inp", engine="mystran"))
    assert told == [("DENSITY", 0, ("--density X",))]
    model = model_of(import_file(tmp_path / "a.inp", options={"density": {"BODY": 100.0}}, engine="mystran"))
    assert masses(model)[0, 0] == pytest.approx(200.0) and model.source == "a.inp"


@needs_mystran
def test_a_material_that_is_given_counts_behind_the_mass_scale(tmp_path):
    deck = boxes("PSOLID,1,1\nPARAM,WTMASS,.5\n") + "ENDDATA\n"
    (tmp_path / "deck.bdf").write_text(deck)
    steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    given = model_of(import_file(tmp_path / "deck.bdf", engine="mystran", materials=[steel]))
    assert masses(given)[0, 0] == pytest.approx(1.0 * 0.2 * 0.16 * 7850, rel=1e-9)


def test_all_problems_are_told_at_once_with_their_cures(tmp_path):
    lines = "CQUAD8,90,1,1,2,3,4,5,6\n,7,8\nCBAR,91,9,1,2\nCROD,92,8,1,2\nCGAP,93,1,1,2\n"
    with pytest.raises(InputError) as told:
        imported(tmp_path, (SHEET + lines).replace("7850.", ""), program(tmp_path, "sys.exit()"))
    text = str(told.value)
    assert all(word in text for word in ("CQUAD8", "CBAR 91", "CROD 92", "CGAP", "--density X"))
    assert len(told.value.problems) == 5


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            ["--engine", "mystran", "--format", "unv"],
            "--engine mystran reads Nastran bulk data, decks of Abaqus, and archives of ANSYS; deck.bdf is",
        ),
        (["--engine", "mystran:/nowhere/mystran"], "no file that can be run"),
        (["--engine", "mystran", "--boundary", "hold"], 'expected "drop" or "keep"'),
        (["--engine", "mystran", "--preload", "1"], "preload"),
        (["--engine", "mystran", "--contact", "tie"], "--contact was given with --engine mystran"),
        (["--engine", "mystran", "--set", "jobs=0"], "jobs = 0 was given; expected an integer, 1 or more"),
        ([], "MYSTRAN would read this deck: --engine mystran"),
    ],
)
def test_options_that_cannot_be_are_refused(tmp_path, line, message):
    (tmp_path / "deck.bdf").write_text(f"{SHEET}ENDDATA\n")
    words = [word if word != "mystran" else f"mystran:{program(tmp_path, 'sys.exit()')}" for word in line]
    done = CliRunner().invoke(app, ["import", str(tmp_path / "deck.bdf"), "-o", str(tmp_path / "a.model.h5"), *words])
    assert done.exit_code == 2 and message in " ".join(done.stderr.split()), done.stderr
    assert not (tmp_path / "a.model.h5").exists()


def test_a_missing_program_is_told_with_its_cure(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    monkeypatch.setitem(sys.modules, "mystran", None)
    monkeypatch.delenv("MOREMBS_MYSTRAN", raising=False)
    with refusal("program", "engine", "MYSTRAN"):
        imported(tmp_path, SHEET)
    monkeypatch.setenv("MOREMBS_MYSTRAN", str(mystran.replay(tmp_path, "mixed")))
    assert imported(tmp_path, MIXED).size > 150
    assert "MYSTRAN at" in CliRunner().invoke(app, ["import", "--list"]).stdout.splitlines()[-1]


@needs_mystran
def test_engines_are_listed_with_their_versions():
    assert "(MYSTRAN 18." in CliRunner().invoke(app, ["import", "--list"]).stdout.splitlines()[-1]


ABAQUS = "*MATERIAL,NAME=S\n*ELASTIC\n2.1e11,.3\n*DENSITY\n7850.\n"


def abaqus_plate(code: str, section: str) -> str:
    """The sheet of ``plate`` in words of Abaqus."""
    bulk = plate(6, 4, T)
    rows = [line.split(",") for line in bulk.splitlines()]
    nodes = "".join(f"{row[1]},{','.join(row[3:6])}\n" for row in rows if row[0] == "GRID")
    cells = "".join(f"{row[1]},{','.join(row[3:7])}\n" for row in rows if row[0] == "CQUAD4")
    edge = "*NSET,NSET=EDGE,GENERATE\n1,5,1\n"
    return f"*NODE\n{nodes}*ELEMENT,TYPE={code},ELSET=E\n{cells}{edge}{ABAQUS}{section}"


@needs_mystran
def test_shells_of_an_abaqus_deck_are_those_of_bulk_data(tmp_path):
    (tmp_path / "a.inp").write_text(abaqus_plate("S4R", "*SHELL SECTION,ELSET=E,MATERIAL=S\n.01\n"))
    model = model_of(import_file(tmp_path / "a.inp", engine="mystran"))
    same = imported(tmp_path, SHEET)
    for A, B in ((model.K, same.K), (model.M, same.M)):
        assert abs(A - B).max() < 1e-9 * abs(B).max()
    assert model.nodes.ids[model.nodes.sets["EDGE"]].tolist() == [1, 2, 3, 4, 5]
    assert model.source == "a.inp" and any("[formulation-differs]" in warning for warning in model.warnings)


@needs_mystran
@pytest.mark.parametrize(("dialect", "radius"), [("abaqus", 0.1), ("calculix", 0.05)])
def test_circles_are_meant_by_radius_in_abaqus_and_by_diameter_in_calculix(tmp_path, dialect, radius):
    deck = "*NODE\n1,0,0,0\n2,1,0,0\n*ELEMENT,TYPE=B31,ELSET=E\n1,1,2\n" + ABAQUS
    (tmp_path / "a.inp").write_text(f"{deck}*BEAM SECTION,ELSET=E,MATERIAL=S,SECTION=CIRC\n.1\n0,1,0\n")
    model = model_of(import_file(tmp_path / "a.inp", engine="mystran", options={"dialect": dialect}))
    assert masses(model)[0, 0] == pytest.approx(7850 * np.pi * radius**2, rel=1e-9)


LAYER = "*ELASTIC,TYPE=ENGINEERING CONSTANTS\n140.e9,10.e9,10.e9,.3,.3,.4,5.e9,5.e9\n3.5e9\n*DENSITY\n1600.\n"
# Along the plate and across it, with the normal of its cells or against it.
UP, DOWN = (
    f"*ORIENTATION,NAME=O\n{','.join(f'{x:.12f}' for x in [*T[:, 0], *(sign * T[:, 1])])}\n" for sign in (1.0, -1.0)
)


@needs_mystran
def test_layers_and_rigid_bodies_of_an_abaqus_deck_are_those_of_bulk_data(tmp_path):
    section = "*SHELL SECTION,ELSET=E,COMPOSITE,ORIENTATION=O\n.004,3,L,30.\n.006,3,S\n"
    body = f"*NODE\n100,1.2,.3,.4\n*RIGID BODY,NSET=END,REF NODE=100\n*NSET,NSET=END\n31,32,33,34\n{UP}"
    deck = abaqus_plate("S4", f"*MATERIAL,NAME=L\n{LAYER}{section}{body}")
    (tmp_path / "a.inp").write_text(deck)
    model = model_of(import_file(tmp_path / "a.inp", engine="mystran"))
    bulk = (
        plate(6, 4, T, tail=",6")
        + "PCOMP,1\n,2,.004,30.,NO,1,.006,0.,NO\nMAT8,2,1.4+11,1.+10,.3,5.+9,5.+9,3.5+9,1600.\n"
    )
    axes = ",".join(f"{x:.12f}" for x in [0, 0, 0, *T[:, 2]])
    bulk += f"CORD2R,6,,{axes}\n,{','.join(f'{x:.12f}' for x in T[:, 0])}\n{STEEL}"
    same = imported(tmp_path, bulk + "GRID,100,,1.2,.3,.4\nRBE2,910,100,123456,31,32,33,34\n")
    for A, B in ((model.K, same.K), (model.M, same.M), (model.dependent.S, same.dependent.S)):
        assert abs(A - B).max() < 1e-9 * abs(B).max()
    assert masses(model)[0, 0] == pytest.approx(0.5 * (0.004 * 1600 + 0.006 * 7850), rel=1e-8)


@needs_mystran
def test_beams_and_trusses_of_an_abaqus_deck_bend_as_theory_says(tmp_path):
    nodes = "*NODE\n" + "".join(f"{i},{i / 20},0,0\n" for i in range(1, 22)) + "30,1.05,.3,0.\n"
    cells = "".join(f"{i},{i},{i + 1}\n" for i in range(1, 21))
    deck = (
        f"{nodes}*ELEMENT,TYPE=B31,ELSET=B\n{cells}*ELEMENT,TYPE=T3D2,ELSET=R\n40,21,30\n{ABAQUS}"
        "*BEAM SECTION,ELSET=B,MATERIAL=S,SECTION=RECT\n.02,.01\n0,1,0\n*SOLID SECTION,ELSET=R,MATERIAL=S\n1e-4\n"
    )
    (tmp_path / "b.inp").write_text(deck)
    model = model_of(import_file(tmp_path / "b.inp", engine="mystran"))
    assert masses(model)[0, 0] == pytest.approx(7850 * (2e-4 * 1.0 + 1e-4 * 0.3), rel=1e-6)
    # The stiffer axis is that of the first dimension, along y; elements of 50 mm are soft in shear (Timoshenko).
    first = model.dofs.node == model.nodes.ids.tolist().index(1)
    y, z = (model.K.diagonal()[first & (model.dofs.component == axis)][0] for axis in (1, 2))
    shear = [1 + 2 * 1.3 / (5 / 6) * (height / 0.05) ** 2 for height in (0.02, 0.01)]
    assert y / z == pytest.approx(4.0 * shear[1] / shear[0], rel=1e-3)


ANSYS = "MP,EX,1,2.1e11\nMP,PRXY,1,.3\nMP,DENS,1,7850.\n"


def ansys_elements(bulk: str, routine: int, card: str, third: str = "") -> str:
    """Grids and elements of bulk data in free fields in words of ANSYS; beams with a third node."""
    rows = [line.split(",") for line in bulk.splitlines()]
    nodes = "".join(f"N,{row[1]},{','.join(row[3:6])}\n" for row in rows if row[0] == "GRID")
    count = 5 if card == "CBAR" else 7
    cells = "".join(f"EN,{row[1]},{','.join(row[3:count])}{third}\n" for row in rows if row[0] == card)
    return f"/PREP7\nET,1,{routine}\n{nodes}TYPE,1\nMAT,1\nREAL,1\nSECNUM,1\n{cells}{ANSYS}"


BARS_OF_ANSYS = grids(FRAME) + "GRID,9,,5.,7.,3.\n" + "".join(f"CBAR,{i},1,{i},{i + 1},9\n" for i in range(1, 6))


@needs_mystran
@pytest.mark.parametrize(
    ("archive", "bulk"),
    [
        (ansys_elements(SHEET, 181, "CQUAD4") + "SECTYPE,1,SHELL\nSECDATA,.01,1,0.,3\n", SHEET),
        (ansys_elements(SHEET, 181, "CQUAD4") + "R,1,.01\n", SHEET),
        (
            ansys_elements(SHEET, 181, "CQUAD4")
            + "SECTYPE,1,SHELL\nSECOFFSET,BOT\nSECBLOCK,2\n  .004,  1,  0.,  3\n  .006,  0,  0.,  3\n",
            plate(6, 4, T) + "PCOMP,1,0.\n,1,.004,0.,NO,1,.006,0.,NO\n" + STEEL,
        ),
        (ansys_elements(SHEET, 63, "CQUAD4") + "R,1,.01,.01,.01,.01\n", plate(6, 4, T) + "PSHELL,1,1,.01,1\n" + STEEL),
        (
            ansys_elements(BARS_OF_ANSYS, 188, "CBAR", ",9") + "SECTYPE,1,BEAM,RECT\nSECDATA,.1,.2\n",
            BARS_OF_ANSYS + "PBARL,1,1,,BAR\n,.1,.2\n" + STEEL,
        ),
        (
            ansys_elements(BARS_OF_ANSYS, 188, "CBAR", ",9")
            + "SECTYPE,1,BEAM,ASEC\nSECDATA,1.e-3,2.e-7,1.e-8,4.e-7,0,3.e-7\n",
            BARS_OF_ANSYS + "PBAR,1,1,1.-3,2.-7,4.-7,3.-7\n,,,,,,,,\n,,,-1.-8\n" + STEEL,
        ),
        (
            ansys_elements(BARS_OF_ANSYS, 4, "CBAR", ",9") + "R,1,.001,4.e-7,2.e-7,.1,.1,0\nRMORE,0,3.e-7,,,,.5\n",
            BARS_OF_ANSYS + "PBAR,1,1,1.-3,2.-7,4.-7,3.-7,.5\n" + STEEL,
        ),
        (
            ansys_elements(BARS_OF_ANSYS, 188, "CBAR") + "SECTYPE,1,BEAM,CTUBE\nSECDATA,.02,.03\n",
            BARS_OF_ANSYS + "PBARL,1,1,,TUBE\n,.03,.02\n" + STEEL,
        ),
        (
            # The y axis of a bar along z is along y, of others in the plane of x and y.
            ansys_elements(BARS_OF_ANSYS, 188, "CBAR") + "SECTYPE,1,BEAM,RECT\nSECDATA,.1,.2\n",
            grids(FRAME)
            + "".join(f"CBAR,{i},1,{i},{i + 1},{'1.,0.,0.' if i in (1, 4, 5) else '0.,0.,1.'}\n" for i in range(1, 6))
            + "PBARL,1,1,,BAR\n,.1,.2\n"
            + STEEL,
        ),
    ],
    ids=["SHELL181", "by real constants", "layers", "SHELL63", "RECT", "ASEC", "BEAM4", "tube", "no third node"],
)
def test_shells_and_beams_of_an_archive_are_those_of_bulk_data(tmp_path, archive, bulk):
    (tmp_path / "a.cdb").write_text(archive + "FINISH\n")
    model = model_of(import_file(tmp_path / "a.cdb", engine="mystran"))
    same = imported(tmp_path, bulk)
    assert model.size == same.size and model.source == "a.cdb"
    for A, B in ((model.K, same.K), (model.M, same.M)):
        assert abs(A - B).max() < 1e-9 * abs(B).max()


@pytest.mark.parametrize(
    ("archive", "message"),
    [
        (ansys_elements(SHEET, 181, "CQUAD4"), ("missing", "SHELL181")),
        (
            ansys_elements(SHEET, 181, "CQUAD4") + "SECTYPE,1,SHELL\nSECDATA,.01\nSECOFFSET,USER,.1\n",
            ("value", "SHELL181", "SECOFFSET", "USER"),
        ),
        (ansys_elements(SHEET, 181, "CQUAD4") + "R,1,.01,.02,.01,.02\n", ("unsupported", "SHELL181")),
        (
            ansys_elements(BARS_OF_ANSYS, 188, "CBAR") + "SECTYPE,1,BEAM,T\nSECDATA,.1,.2,.01,.01\n",
            ("value", "BEAM188", "RECT"),
        ),
        (
            ansys_elements(SHEET, 181, "CQUAD4").replace("MP,EX,1,2.1e11\n", "") + "R,1,.01\n",
            ("missing", "MATERIAL", "--material"),
        ),
        (ansys_elements(SHEET, 181, "CQUAD4") + "MP,EY,1,1e11\nR,1,.01\n", ("unsupported", "orientation")),
    ],
)
def test_what_mystran_is_not_given_of_an_archive_is_told(tmp_path, archive, message):
    (tmp_path / "a.cdb").write_text(archive + "FINISH\n")
    with refusal(*message):
        import_file(tmp_path / "a.cdb", engine=f"mystran:{program(tmp_path, 'sys.exit()')}")


@pytest.mark.parametrize(
    ("deck", "message"),
    [
        (abaqus_plate("M3D4", "*MEMBRANE SECTION,ELSET=E,MATERIAL=S\n.01\n"), ("unsupported", "M3D4")),
        (
            abaqus_plate("S4", "*SHELL SECTION,ELSET=E,COMPOSITE\n.01,3,L\n*MATERIAL,NAME=L\n" + LAYER),
            ("unsupported", "orientation"),
        ),
        (
            abaqus_plate("S4", f"*SHELL SECTION,ELSET=E,COMPOSITE,ORIENTATION=O\n.01,3,S,30.\n{DOWN}"),
            ("unsupported", "", "S4"),
        ),
        (abaqus_plate("S4", "*SHELL SECTION,ELSET=E,MATERIAL=S,NODAL THICKNESS\n.01\n"), ("missing", "SHELL SECTION")),
        (abaqus_plate("S4", "*SHELL SECTION,ELSET=E,MATERIAL=X\n.01\n"), ("unknown", "", "X")),
        (
            "*NODE\n1,0,0,0\n2,1,0,0\n*ELEMENT,TYPE=B31,ELSET=E\n1,1,2\n*NORMAL\n1,1,0.,.6,.8\n"
            f"{ABAQUS}*BEAM SECTION,ELSET=E,MATERIAL=S,SECTION=RECT\n.02,.01\n0,1,0\n",
            ("unsupported", "", "B31", "*NORMAL"),
        ),
    ],
)
def test_what_mystran_is_not_given_of_an_abaqus_deck_is_told(tmp_path, deck, message):
    (tmp_path / "a.inp").write_text(deck)
    with refusal(*message):
        import_file(tmp_path / "a.inp", engine=f"mystran:{program(tmp_path, 'sys.exit()')}")
