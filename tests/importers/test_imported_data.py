"""Every folder of models from elsewhere through ``morembs import``, against the figures that came with it."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.linalg as sl
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs import Problem
from morembs.app.cli import app
from morembs.fem import FEModel
from morembs.importers import import_file
from morembs.importers.model_file import read_model

STEEL = ["--material", "young=2.1e11,poisson=0.3,density=7850"]
STEEL_MM = ["--units", "mm-t-s", "--material", "young=210e3,poisson=0.3,density=7.85e-9"]


def imported(folder: Path, arguments: list[str], out: Path) -> tuple[FEModel, dict[str, object]]:
    """The model of ``arguments``, in which @ stands for the folder of the data."""
    given = [argument.replace("@", f"{folder}/") for argument in arguments]
    result = CliRunner().invoke(app, ["import", *given, "-o", str(out), "--json"])
    assert result.exit_code == 0, result.stderr
    return read_model(out), json.loads(result.stdout)[0]


def frequencies(model: FEModel, rigid: int, count: int, K_times: float) -> np.ndarray:
    """Hz of the first elastic modes: straight from LAPACK, or of the program for large models."""
    if model.size > 1000:
        with Problem(model) as problem:
            return problem.elastic_modes(count=count).frequencies_hz
    K, M = K_times * model.K.toarray(), model.M.toarray()
    # M need not be regular, K + s M is.
    s = np.trace(K) / np.trace(M) * 1e-3
    last = model.size - rigid
    mu = sl.eigh(M, K + s * M, eigvals_only=True, subset_by_index=[last - count, last - 1])
    return np.sqrt(1 / mu[::-1] - s) / (2 * np.pi)


@dataclass(frozen=True, kw_only=True)
class Case:
    """``hz`` of the first elastic modes as they are printed: the last digit is met, or ``rel`` where that is given."""

    arguments: list[str]
    hz: str
    rel: float | None = None
    rigid: int = 6
    K_times: float = 1.0
    mass: float | None = None
    sizes: tuple[int, int] | None = None


def block(kind: str, hz: str) -> Case:
    matrices = [
        f"--{role}=@abaqus_block/block{kind}_{name}1.mtx" for role, name in (("stiffness", "STIF"), ("mass", "MASS"))
    ]
    return Case(arguments=[*matrices, "--nodes", f"@abaqus_block/block{kind}.inp"], hz=hz, mass=11600.0)


ROTOR = "@ansys_rotor/rotorAnsys"
ANSYS_ROTOR = [
    f"{ROTOR}StiffnessMatrixSparse.txt",
    "--format",
    "ansys-matrices",
    "--set",
    f"mass={ROTOR}MassMatrixSparse.txt",
    "--set",
    f"mapping={ROTOR}MatrixDofMappingVector.txt",
    "--set",
    f"nodes={ROTOR}NodalCoordinates.txt",
]
CASES = {
    "rotor of ANSYS": Case(arguments=ANSYS_ROTOR, hz="104.637011 104.637011 187.824087 212.329701", sizes=(345, 115)),
    "first mode of the rotor of ANSYS": Case(
        arguments=ANSYS_ROTOR, hz="104.63701055079783", rel=1e-12, sizes=(345, 115)
    ),
    # Its K is a hundred times too large, as the README says.
    "rotor of Abaqus": Case(
        arguments=[
            "--stiffness",
            "@ansys_rotor/rotorDiscTestSTIF1.mtx",
            "--mass",
            "@ansys_rotor/rotorDiscTestMASS1.mtx",
            "--nodes",
            "@ansys_rotor/rotorDiscTest.inp",
        ],
        hz="104.6370132606291",
        rel=1e-12,
        K_times=0.01,
        sizes=(345, 115),
    ),
    "block C3D4 of Abaqus": block("C3D4", "489.296266 489.854771 697.543460"),
    "block C3D8 of Abaqus": block("C3D8", "438.775166 438.775166 555.888157 967.040273"),
    "block C3D10 of Abaqus": block("C3D10", "451.333341 452.009851 607.870197 1026.459420"),
    # The decks of these blocks, assembled here, against CalculiX.
    "block C3D4 of CalculiX": Case(
        arguments=["@abaqus_block/blockC3D4.inp", "--dialect", "calculix"], hz="512.71", mass=11600.0
    ),
    "block C3D8 of CalculiX": Case(
        arguments=["@abaqus_block/blockC3D8.inp", "--dialect", "calculix"], hz="472.77", mass=11600.0
    ),
    "block C3D10 of CalculiX": Case(
        arguments=["@abaqus_block/blockC3D10.inp", "--dialect", "calculix"],
        hz="451.4782 452.1581 608.1007",
        mass=11600.0,
    ),
    # The same decks as Abaqus takes them.
    "deck C3D4 of Abaqus": Case(
        arguments=["@abaqus_block/blockC3D4.inp"], hz="489.296266 489.854771 697.543460", mass=11600.0
    ),
    "deck C3D8 of Abaqus": Case(
        arguments=["@abaqus_block/blockC3D8.inp", "--dialect", "abaqus"],
        hz="438.775166 438.775166 555.888157 967.040273",
        rel=1e-8,
        mass=11600.0,
    ),
    "deck C3D10 of Abaqus": Case(
        arguments=["@abaqus_block/blockC3D10.inp"], hz="451.333341 452.009851 607.870197 1026.459420", mass=11600.0
    ),
    "beam of ANSYS, one end held": Case(
        arguments=[
            "@mapdl_reader/file.full",
            "--set",
            "nodes=@mapdl_reader/HexBeam.cdb",
            "--set",
            "drop_constrained=true",
        ],
        hz="1283.20037 1283.20037 5781.97486 6919.39888 6919.39888 10172.61498",
        rigid=0,
        sizes=(900, 300),
    ),
    "deck of a conrod by CalculiX": Case(
        arguments=["@conrod_abaqus/conrod_ccx_matrixstorage.inp"],
        hz="5931.72907 10572.56166 13006.48953 14286.39617 22263.38637 24315.61338 24728.82045 28365.58687",
        mass=0.1379211513593743,
        sizes=(2805, 935),
    ),
    "deck of a wheelset by CalculiX": Case(
        arguments=["@wheelset/wheelset.inp"],
        hz="54.58978 72.29301 72.38615 142.5101 142.6563 350.9457 377.8997 378.2487 618.7531",
        sizes=(16371, 5457),
    ),
    "mesh of a conrod by Gmsh": Case(
        arguments=["@generator/conrod_h4.msh", *STEEL_MM, "--mass-integration", "reduced"],
        hz="1647.260 2194.819 2606.671 4259.869 5750.689 5855.780 6845.360 8305.509",
        sizes=(68898, 22966),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_frequencies_that_came_with_the_data(tmp_path: Path, shared_data: Path, name: str) -> None:
    case = CASES[name]
    model, said = imported(shared_data, case.arguments, tmp_path / "a.model.h5")
    if case.sizes is not None:
        assert (said["dofs"], said["nodes"]) == case.sizes
    if case.mass is not None:
        along_x = (model.dofs.component == 0).astype(float)
        assert along_x @ model.M @ along_x == pytest.approx(case.mass, rel=1e-6)
    words = case.hz.split()
    computed = frequencies(model, case.rigid, len(words), case.K_times)
    for f, word in zip(computed, words, strict=True):
        digit = 10.0 ** -len(word.partition(".")[2])
        # Matrices with numbers of 16 digits give frequencies to nine.
        near = max(0.51 * digit, 2e-9 * f) if case.rel is None else case.rel * f
        assert f == pytest.approx(float(word), abs=near)


def test_matrices_of_a_conrod_by_three_programs(tmp_path: Path, shared_data: Path) -> None:
    """K and M of CalculiX, M of Abaqus and the assembly here, all of the same 136 elements C3D20."""
    there = shared_data / "conrod_abaqus"
    for end in (".sti", ".mas"):
        (tmp_path / f"rod{end}").write_bytes(gzip.decompress((there / f"conrod_ccx{end}.gz").read_bytes()))
    (tmp_path / "rod.dof").write_bytes((there / "conrod_ccx.dof").read_bytes())
    deck = "@conrod_abaqus/job_matrix_generate_conrod.inp"
    theirs, _ = imported(shared_data, [str(tmp_path / "rod.sti"), "--nodes", deck], tmp_path / "a.model.h5")
    ours, _ = imported(shared_data, [deck], tmp_path / "b.model.h5")
    back = np.argsort(3 * theirs.dofs.node + theirs.dofs.component)
    K, M = (A[back][:, back] for A in (theirs.K, theirs.M))
    abaqus = import_file(there / "job_matrix_generate_conrod_MASS1.mtx").K
    assert abaqus is not None
    for A, B in ((ours.K, K), (ours.M, M), (ours.M, abaqus)):
        assert np.abs(A - B).max() <= 1e-12 * np.abs(B).max()


def volumes(x: np.ndarray) -> np.ndarray:
    """Of tetrahedra with corners (ne, 4, 3)."""
    return np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / 6


# Meshes with flat sides, so that corners give the volume: nodes and, where they were told, elements.
MESHES = {
    "amfe_meshes/pleuel_7000.msh": (1251, 4123),
    "finetools/twoblocks.nas": (119, None),
    "finetools/trunc_cyl_shell_2.nas": (3903, None),
    "mapdl_reader/TetBeam.cdb": (1041, None),
    "wheelset/wheelset.vtk": (5457, 21934),
}


@pytest.mark.parametrize("name", MESHES)
def test_meshes_keep_their_nodes_elements_and_volume(tmp_path: Path, shared_data: Path, name: str) -> None:
    nodes, elements = MESHES[name]
    model, said = imported(shared_data, [f"@{name}", *STEEL], tmp_path / "a.model.h5")
    assert said["nodes"] == nodes and said["dofs"] == 3 * nodes and (elements is None or said["elements"] == elements)
    assert model.mesh is not None
    x = np.concatenate([model.nodes.xyz[block.nodes[:, :4]] for block in model.mesh.blocks])
    volume = float(np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum() / 6)
    assert model.M.sum() / 3 / 7850 == pytest.approx(volume, rel=1e-9)


def test_crankshaft_with_its_named_surfaces(shared_data: Path) -> None:
    mesh = import_file(shared_data / "generator" / "crankshaft_h8.msh").mesh
    assert mesh is not None and len(mesh.nodes) == 59019 and [block.type for block in mesh.blocks] == ["tet10"]
    assert {f"MAIN{i}" for i in range(1, 6)} | {f"PIN{i}" for i in range(1, 5)} <= set(mesh.nodes.sets)


@pytest.mark.parametrize(
    ("name", "elements", "groups"), [("JuliaFEMSMP18.med", 6131, False), ("joint.med", None, True)]
)
def test_med_files_are_read_in_full(shared_data: Path, name: str, elements: int | None, groups: bool) -> None:
    """Nodes, elements and groups against the datasets of the file."""
    path = shared_data / "juliafem_med" / name
    imported = import_file(path).mesh
    assert imported is not None
    with h5py.File(path) as file:
        (mesh,) = (step for meshes in file["ENS_MAA"].values() for step in meshes.values())
        xyz = mesh["NOE/COO"][:].reshape(3, -1).T
        cells = {kind: item["NOD"][:] for kind, item in mesh["MAI"].items()}
        names = [
            bytes(row.tolist()).rstrip(b"\0").decode()
            for item in file["FAS"].values()
            for group in item.get("ELEME", {}).values()
            if "GRO" in group
            for row in group["GRO/NOM"][:]
        ]
    solid = cells["T10"].reshape(10, -1).T - 1
    used = np.unique(solid)
    assert [block.type for block in imported.blocks] == ["tet10"] and len(imported.blocks[0].ids) == len(solid)
    assert elements is None or (len(solid), len(used)) == (elements, 14078)
    assert np.array_equal(imported.nodes.xyz, xyz[used])
    ours = np.sort(imported.nodes.xyz[imported.blocks[0].nodes], axis=1)
    assert np.array_equal(ours, np.sort(xyz[solid], axis=1))
    assert sorted(name for name in imported.nodes.sets if ":" not in name) == sorted(names) and bool(names) == groups


def test_a_med_mesh_with_two_elements_inside_out_makes_no_model(tmp_path: Path, shared_data: Path) -> None:
    path = shared_data / "juliafem_med" / "joint.med"
    result = CliRunner().invoke(app, ["import", str(path), *STEEL, "-o", str(tmp_path / "a.model.h5")])
    assert result.exit_code == 2 and "2 tet10 elements are inverted or degenerate: 3098, 3310" in result.stderr


def test_second_order_models_keep_every_entry(tmp_path: Path, shared_data: Path) -> None:
    """Real and complex K, M and D of MATLAB files, bit by bit as SciPy reads them."""
    names = {
        "foundation": {"K": "K", "M": "M", "D": "D"},
        "shaft": {"K": "K", "M": "M", "D": "C"},
        "sandwich_beam_168": {"K": "Ke", "M": "M"},
        "sandwich_beam_3360": {"K": "Kv", "M": "M"},
        "cd_player": {"K": "K", "D": "D"},
    }
    for name, matrices in names.items():
        given = scipy.io.loadmat(shared_data / "nlevp_second_order" / f"{name}.mat", spmatrix=False)
        options = [part for key, value in matrices.items() for part in ("--set", f"{key}={value}")]
        if "M" not in matrices:
            options += ["--set", "M=identity"]
        model, _ = imported(shared_data, [f"@nlevp_second_order/{name}.mat", *options], tmp_path / "a.model.h5")
        for key, value in matrices.items():
            A = sp.csr_array(given[value])
            assert (getattr(model, key) != A).nnz == 0 and getattr(model, key).dtype == A.dtype, (name, key)
    assert model.K.dtype == float


@pytest.mark.parametrize(
    "name", ["mapdl_reader/file.rst", "generator/conrod_h4.step", "conrod_abaqus/job_matrix_generate_conrod_MASS1.mtx"]
)
def test_files_that_are_no_model_are_refused(tmp_path: Path, shared_data: Path, name: str) -> None:
    """Results, geometry without a mesh, a mass without a stiffness."""
    result = CliRunner().invoke(app, ["import", str(shared_data / name), "-o", str(tmp_path / "a.model.h5")])
    assert result.exit_code == 2 and result.stderr.startswith("error: ") and not list(tmp_path.iterdir())
