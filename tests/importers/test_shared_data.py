"""Models from elsewhere, with frequencies by Abaqus and CalculiX."""

import numpy as np
import pytest

from morembs.base.units import parse_units
from morembs.fem.assembly import assemble
from morembs.fem.mass import mass_properties
from morembs.fem.material import isotropic
from morembs.importers import read_mesh
from morembs.problem import Problem
from tests.support.meshes import STEEL, steel

CONROD_HZ = [5931.72907, 10572.56166, 13006.48953, 14286.39617, 22263.38637, 24315.61338, 24728.82045, 28365.58687]
WHEELSET_HZ = [54.58978, 72.29301, 72.38615, 142.5101, 142.6563, 350.9457, 377.8997, 378.2487, 618.7531]
BLOCK_ABAQUS_HZ = [451.333341, 452.009851, 607.870197]
BLOCK_CALCULIX_HZ = [451.4782, 452.1581, 608.1007]


def test_abaqus_conrod(shared_data):
    model = steel(read_mesh(shared_data / "conrod_abaqus" / "job_matrix_generate_conrod.inp"))
    assert model.mesh.blocks[0].type == "hex20" and "_PickedSet16" in model.nodes.sets
    with Problem(model) as problem:
        mass, _, _ = mass_properties(problem.M, problem.coupling.R, problem.coupling.pole)
        assert mass == pytest.approx(0.1379211513593743, rel=1e-10)
        assert problem.elastic_modes(count=8).frequencies_hz == pytest.approx(CONROD_HZ, rel=1e-6)


def test_physical_groups_of_gmsh(shared_data):
    """Its frequencies are in test_imported_data."""
    mesh = read_mesh(shared_data / "generator" / "conrod_h4.msh", parse_units("mm-t-s"))
    assert len(mesh.nodes.sets["BIGEND"]) == 1126 and len(mesh.nodes.sets["SMALLEND"]) == 556


def test_wheelset_against_calculix(shared_data):
    """CalculiX integrates the mass of tetrahedra at the points of the stiffness; so do we when asked."""
    mesh = read_mesh(shared_data / "wheelset" / "wheelset.vtk")
    assert "mat_id:0" in mesh.element_sets
    with Problem(assemble(mesh, [isotropic(set="mat_id:0", **STEEL)], mass_integration="reduced")) as problem:
        assert problem.elastic_modes(count=9).frequencies_hz == pytest.approx(WHEELSET_HZ, rel=1e-6)
    with Problem(steel(mesh)) as problem:
        # The exact mass is larger for every motion that varies within an element.
        f = problem.elastic_modes(count=9).frequencies_hz
        assert (f < WHEELSET_HZ).all() and f == pytest.approx(WHEELSET_HZ, rel=3e-3)


def test_tet10_block_against_abaqus_and_calculix(shared_data):
    mesh = read_mesh(shared_data / "abaqus_block" / "blockC3D10.inp")
    material = isotropic(set="Set-1", young=2e11, poisson=0.3, density=2900.0)
    for rule, expected in (("exact", BLOCK_ABAQUS_HZ), ("reduced", BLOCK_CALCULIX_HZ)):
        with Problem(assemble(mesh, [material], mass_integration=rule)) as problem:
            assert problem.elastic_modes(count=3).frequencies_hz == pytest.approx(expected, rel=5e-7)


def test_med_files_are_read(shared_data):
    mesh = read_mesh(shared_data / "juliafem_med" / "JuliaFEMSMP18.med")
    assert mesh.blocks[0].type == "tet10" and len(mesh.nodes) <= 14078
    # MED lists solids mirrored; read as they stand every element would be inside out.
    low, high = mesh.nodes.xyz.min(axis=0), mesh.nodes.xyz.max(axis=0)
    volume = steel(mesh).M.sum() / 3 / STEEL["density"]
    assert 0 < volume < np.prod(high - low)
