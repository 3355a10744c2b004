"""K and M of CalculiX, exported by the program itself, against our assembly of the same decks."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from typer.testing import CliRunner

from morembs.cli import app
from morembs.importers.model_file import read_model
from morembs.model import FEModel
from tests.support.meshes import box

CCX = next((path for name in ("ccx", "ccx_2.20") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(CCX is None, reason="ccx is not installed (Debian package calculix-ccx)")
NAMES = {"tet4": "C3D4", "tet10": "C3D10", "hex8": "C3D8", "hex20": "C3D20", "wedge6": "C3D6", "wedge15": "C3D15"}
MATERIAL = (
    "*MATERIAL, NAME=STEEL\n*ELASTIC\n2.1e11, 0.3\n*DENSITY\n7850.\n*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL\n"
)
STEP = "*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n1\n*END STEP\n"


def bent(x: np.ndarray) -> np.ndarray:
    """A curved and twisted bar; nine decimals, so that both programs read the same number."""
    y = x.copy()
    y[..., 1] += 0.6 * x[..., 0] ** 2
    y[..., 2] += 0.8 * x[..., 0] * x[..., 1]
    return np.round(y, 9)


def write_deck(path: Path, kind: str, n: Sequence[int] = (3, 2, 2), material: str = MATERIAL) -> Path:
    """A bar of one element type with labels in no order and with gaps."""
    mesh = box(kind, n, (0.3, 0.1, 0.08), bent)
    label = 7 + 3 * np.random.default_rng(4).permutation(len(mesh.nodes))
    lines = ["*NODE"]
    lines += [f"{i}, {x:.9f}, {y:.9f}, {z:.9f}" for i, (x, y, z) in zip(label, mesh.nodes.xyz, strict=True)]
    lines.append(f"*ELEMENT, TYPE={NAMES[kind]}, ELSET=BODY")
    (block,) = mesh.blocks
    for i, row in zip(block.ids, block.nodes, strict=True):
        words = [str(i), *map(str, label[row])]
        lines.append(",\n".join(", ".join(words[at : at + 12]) for at in range(0, len(words), 12)))
    path.write_text("\n".join(lines) + "\n" + material + STEP)
    return path


def imported(*arguments: object) -> FEModel:
    out = Path(str(arguments[0])).with_suffix(".model.h5")
    result = CliRunner().invoke(app, ["import", *map(str, arguments), "-o", str(out), "--strict"])
    assert result.exit_code == 0, result.stderr
    return read_model(out)


def both(deck: Path, rule: str = "exact") -> tuple[FEModel, FEModel]:
    """Our model of a deck, and that of the matrices which CalculiX makes of it."""
    assert CCX is not None
    done = subprocess.run([CCX, deck.stem], cwd=deck.parent, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-500:]
    theirs = imported(deck.with_suffix(".sti"), "--nodes", deck)
    ours = imported(deck, "--mass-integration", rule)
    # Rows come in the order of CalculiX; both models name node and component of each.
    row = 3 * theirs.dofs.node + theirs.dofs.component
    assert np.array_equal(ours.nodes.ids, theirs.nodes.ids) and ours.dofs.is_solid and len(row) == ours.size
    sorted_back = np.argsort(row)
    K, M = (sp.csr_array(A[sorted_back][:, sorted_back]) for A in (theirs.K, theirs.M))
    return ours, dataclasses.replace(ours, K=K, M=M)


def apart(A: sp.csr_array, B: sp.csr_array) -> float:
    return float(np.abs(A - B).max() / np.abs(B).max())


@pytest.mark.parametrize(
    ("kind", "rule"),
    [("tet4", "reduced"), ("tet10", "reduced"), ("hex8", "exact"), ("hex20", "exact"), ("wedge15", "reduced")],
)
def test_stiffness_and_mass_are_those_of_calculix(tmp_path: Path, kind: str, rule: str) -> None:
    ours, theirs = both(write_deck(tmp_path / f"{kind}.inp", kind), rule)
    assert apart(ours.K, theirs.K) <= 1e-12 and apart(ours.M, theirs.M) <= 1e-12


def test_exact_mass_of_a_tetrahedron_differs_from_that_of_calculix(tmp_path: Path) -> None:
    """CalculiX takes its four points for the mass of C3D10: the total is right, the distribution is another one."""
    ours, theirs = both(write_deck(tmp_path / "tet10.inp", "tet10"), "exact")
    assert apart(ours.K, theirs.K) <= 1e-12 and apart(ours.M, theirs.M) > 0.1
    assert ours.M.sum() == pytest.approx(theirs.M.sum(), rel=1e-3)


def test_linear_wedges_have_more_points_than_those_of_calculix(tmp_path: Path) -> None:
    """C3D6 has 2 points, ours 6: stiffer, and the same when the mesh is refined."""
    gap = []
    for n in (2, 6):
        pair = both(write_deck(tmp_path / f"wedge6_{n}.inp", "wedge6", (2 * n, n, n)))
        f = [frequencies(one) for one in pair]
        gap.append(float((f[0] / f[1] - 1).max()))
    assert 0 < gap[1] < gap[0] / 2


def frequencies(model: FEModel) -> np.ndarray:
    values = spl.eigsh(sp.csc_array(model.K), 9, sp.csc_array(model.M), sigma=-1e6, return_eigenvectors=False)
    return np.sqrt(np.sort(values)[6:])


def test_orthotropic_material_in_turned_axes(tmp_path: Path) -> None:
    """The order of the shear moduli and the sense of the rotation: a mistake in either shows here."""
    material = (
        "*ORIENTATION, NAME=TURNED, SYSTEM=RECTANGULAR\n0.8, 0.5, 0.1, -0.3, 0.7, 0.2\n"
        "*MATERIAL, NAME=WOOD\n*ELASTIC, TYPE=ENGINEERING CONSTANTS\n"
        "1.4e11, 9e9, 1.1e10, 0.3, 0.25, 0.4, 5e9, 4e9\n3e9, 293.\n*DENSITY\n1600.\n"
        "*SOLID SECTION, ELSET=BODY, MATERIAL=WOOD, ORIENTATION=TURNED\n"
    )
    ours, theirs = both(write_deck(tmp_path / "hex20.inp", "hex20", material=material))
    assert apart(ours.K, theirs.K) <= 1e-12 and apart(ours.M, theirs.M) <= 1e-12
