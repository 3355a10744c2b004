"""K and M of CalculiX, exported by the program itself, against our assembly of the same decks."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.fem import FEModel, formulations, rigid_motion
from morembs.importers.model_file import read_model
from tests.support.meshes import box

CCX = next((path for name in ("ccx", "ccx_2.20") if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(CCX is None, reason="ccx is not installed (Debian package calculix-ccx)")
NAMES = {"tet4": "C3D4", "tet10": "C3D10", "hex8": "C3D8", "hex20": "C3D20", "wedge6": "C3D6", "wedge15": "C3D15"}
MATERIAL = "*MATERIAL, NAME=STEEL\n*ELASTIC\n2.1e11, 0.3\n*DENSITY\n7850.\n*SOLID SECTION, ELSET=BODY, MATERIAL=STEEL\n"
STEP = "*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n1\n*END STEP\n"


def bent(x: np.ndarray) -> np.ndarray:
    """A curved and twisted bar; nine decimals, so that both programs read the same number."""
    y = x.copy()
    y[..., 1] += 0.6 * x[..., 0] ** 2
    y[..., 2] += 0.8 * x[..., 0] * x[..., 1]
    return np.round(y, 9)


def torn(x: np.ndarray) -> np.ndarray:
    """Elements of no regular shape."""
    turn = np.array([[1.0, 2.0, 3.0], [0.3, 0.7, 1.9], [2.2, 0.1, 5.0]])
    return np.round(x + 0.012 * np.sin(1e3 * x @ turn), 9)


def write_deck(
    path: Path,
    kind: str,
    n: Sequence[int] = (3, 2, 2),
    material: str = MATERIAL,
    *,
    code: str = "",
    warp: Callable[[np.ndarray], np.ndarray] = bent,
) -> Path:
    """A bar of one element type (``code`` in CalculiX) with labels in no order and with gaps."""
    mesh = box(kind, n, (0.3, 0.1, 0.08), warp)
    label = 7 + 3 * np.random.default_rng(4).permutation(len(mesh.nodes))
    lines = ["*NODE"]
    lines += [f"{i}, {x:.9f}, {y:.9f}, {z:.9f}" for i, (x, y, z) in zip(label, mesh.nodes.xyz, strict=True)]
    lines.append(f"*ELEMENT, TYPE={code or NAMES[kind]}, ELSET=BODY")
    (block,) = mesh.blocks
    for i, row in zip(block.ids, block.nodes, strict=True):
        words = [str(i), *map(str, label[row])]
        lines.append(",\n".join(", ".join(words[at : at + 12]) for at in range(0, len(words), 12)))
    path.write_text("\n".join(lines) + "\n" + material + STEP)
    return path


def imported(*arguments: object, strict: bool = True) -> FEModel:
    out = Path(str(arguments[0])).with_suffix(".model.h5")
    result = CliRunner().invoke(app, ["import", *map(str, arguments), "-o", str(out), *["--strict"] * strict])
    assert result.exit_code == 0, result.stderr
    return read_model(out)


def both(deck: Path, rule: str = "element", *, strict: bool = True) -> tuple[FEModel, FEModel]:
    """Our model of a deck, and that of the matrices which CalculiX makes of it."""
    assert CCX is not None
    done = subprocess.run([CCX, deck.stem], cwd=deck.parent, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-500:]
    theirs = imported(deck.with_suffix(".sti"), "--nodes", deck, strict=strict)
    ours = imported(deck, "--mass-integration", rule)
    # Rows come in the order of CalculiX; both models name node and component of each.
    row = 3 * theirs.dofs.node + theirs.dofs.component
    assert np.array_equal(ours.nodes.ids, theirs.nodes.ids) and ours.dofs.is_solid and len(row) == ours.size
    sorted_back = np.argsort(row)
    K, M = (sp.csr_array(A[sorted_back][:, sorted_back]) for A in (theirs.K, theirs.M))
    return ours, dataclasses.replace(ours, K=K, M=M)


def apart(A: sp.csr_array, B: sp.csr_array) -> float:
    return float(np.abs(A - B).max() / np.abs(B).max())


@pytest.mark.parametrize(("kind", "code"), [*NAMES.items(), ("hex8", "C3D8R"), ("hex20", "C3D20R")])
def test_stiffness_and_mass_are_those_of_calculix(tmp_path: Path, kind: str, code: str) -> None:
    ours, theirs = both(write_deck(tmp_path / f"{code}.inp", kind, code=code))
    assert apart(ours.K, theirs.K) <= 1e-12 and apart(ours.M, theirs.M) <= 1e-12


@pytest.mark.parametrize(("kind", "code"), [("hex8", "C3D8"), ("wedge6", "C3D6")])
def test_elements_of_no_regular_shape(tmp_path: Path, kind: str, code: str) -> None:
    ours, theirs = both(write_deck(tmp_path / f"{code}.inp", kind, code=code, warp=torn))
    assert apart(ours.K, theirs.K) <= 1e-12 and apart(ours.M, theirs.M) <= 1e-12


def test_hourglasses_of_distorted_elements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """CalculiX takes its hourglass vectors orthogonal along z only: rigid motion strains its elements, not ours. With
    its vectors the stiffness is the same, so all else is."""

    def along_z(elements: formulations.Elements) -> np.ndarray:
        r, g, V = 2 * elements.kind.reference - 1, elements.here.dN[:, 0], elements.here.dV[:, 0]
        h = np.array([r[:, 0] * r[:, 1], r[:, 1] * r[:, 2], r[:, 2] * r[:, 0], r.prod(axis=1)])
        gamma = h - (elements.x[:, :, 2] @ h.T)[:, :, None] * g[:, None, :, 2]
        size = 0.0005 * 2.1e11 * V * np.square(g).sum(axis=(1, 2))
        return size[:, None, None] * np.einsum("eki,ekj->eij", gamma, gamma)

    deck = write_deck(tmp_path / "C3D8R.inp", "hex8", code="C3D8R", warp=torn)
    # The examination finds the fault of theirs.
    ours, theirs = both(deck, strict=False)
    R = rigid_motion(ours.nodes.xyz[ours.dofs.node], ours.dofs.component)
    assert np.abs(ours.K @ R).max() < 1e-13 * np.abs(ours.K).max() < 1e-7 * np.abs(theirs.K @ R).max()
    assert 1e-4 < apart(ours.K, theirs.K) < 1e-2 and apart(ours.M, theirs.M) <= 1e-12
    assert any("distorted" in warning for warning in ours.warnings)
    like = dataclasses.replace(formulations.FORMULATIONS["mean-strain"], hourglass=along_z)
    monkeypatch.setattr(formulations, "FORMULATIONS", {**formulations.FORMULATIONS, "mean-strain": like})
    assert apart(imported(deck, strict=False).K, theirs.K) <= 1e-12


def test_incompatible_modes_are_dofs_with_mass(tmp_path: Path) -> None:
    """CalculiX numbers the modes of C3D8I element by element behind all nodes, and so do we."""
    deck = write_deck(tmp_path / "C3D8I.inp", "hex8", code="C3D8I")
    ours = imported(deck)
    assert CCX is not None
    subprocess.run([CCX, deck.stem], cwd=deck.parent, capture_output=True, check=True, timeout=600)
    label, axis = np.array([line.split(".") for line in deck.with_suffix(".dof").read_text().split()], dtype=int).T
    inner = label > ours.nodes.ids.max()
    order = 3 * np.searchsorted(ours.nodes.ids, label) + axis - 1
    order[inner] = 3 * len(ours.nodes) + 3 * (label[inner] - label[inner].min()) + axis[inner] - 1
    assert inner.sum() == 9 * 12 and ours.size == len(order) == len(set(order.tolist()))
    for name, end in (("K", ".sti"), ("M", ".mas")):
        i, j, values = np.loadtxt(deck.with_suffix(end)).T
        theirs = sp.coo_array((values, (i.astype(int) - 1, j.astype(int) - 1)), shape=(len(label),) * 2).toarray()
        theirs = np.triu(theirs) + np.triu(theirs, 1).T
        own = getattr(ours, name).toarray()[np.ix_(order, order)]
        assert np.abs(own - theirs).max() <= 1e-12 * np.abs(theirs).max()


def test_exact_mass_of_a_tetrahedron_differs_from_that_of_calculix(tmp_path: Path) -> None:
    """CalculiX takes its four points for the mass of C3D10: the total is right, the distribution is another one."""
    ours, theirs = both(write_deck(tmp_path / "tet10.inp", "tet10"), "exact")
    assert apart(ours.K, theirs.K) <= 1e-12 and apart(ours.M, theirs.M) > 0.1
    assert ours.M.sum() == pytest.approx(theirs.M.sum(), rel=1e-3)


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
