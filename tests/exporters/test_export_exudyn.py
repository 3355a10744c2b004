"""The Exudyn file, against Exudyn itself: its own reduction of the same full model, and beams with known answers."""

import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.exporters import EXPORTERS, export_body
from morembs.exporters.exudyn import exudyn_marker
from morembs.fem.interface import Interface, make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import STEEL, box, steel, where
from tests.support.refusals import refusal

exu = pytest.importorskip("exudyn")
fem = pytest.importorskip("exudyn.FEM")
items = pytest.importorskip("exudyn.itemInterface")

LENGTH, WIDTH, HEIGHT = 1.0, 0.04, 0.02
ARRAYS = (
    "massMatrixReduced",
    "stiffnessMatrixReduced",
    "inertiaLocal",
    "Mtt",
    "chiU",
    "chiUtilde",
    "mPsiTildePsi",
    "mPsiTildePsiTilde",
    "mPhitTPsi",
    "mPhitTPsiTilde",
    "mXRefTildePsi",
    "mXRefTildePsiTilde",
    "modeBasis",
    "xRef",
)


def beam_file(path, *, nodes="all", origin=(0, 0, 0), damping=None, modes=6, kind="hex20"):
    """A steel beam along x, its left end at the origin, as a body file; returns the model."""
    mesh = box(kind, (8, 2, 1), (LENGTH, WIDTH, HEIGHT), warp=lambda x: x - [0, WIDTH / 2, HEIGHT / 2])
    model = steel(mesh)
    faces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling="average", point=[x, 0, 0])
        for n, x in (("left", 0.0), ("right", LENGTH))
    ]
    with Problem(model, faces, **({} if damping is None else {"damping": damping})) as problem:
        reduced = CraigBampton(modes=modes).reduce(problem, "cb")
        floating = floating_frame(problem, reduced, kind="tangent", interfaces=("left",), origin=origin)
        write_body(path, [elastic_body(problem, reduced, make_part(problem, nodes=nodes), floating=floating)])
    return model


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """Model, body file and Exudyn file of the beam, its frame at the left end."""
    path = tmp_path_factory.mktemp("exudyn") / "beam.h5"
    model = beam_file(path)
    return model, path, export_body(path, "exudyn").paths[0]


def loaded(path):
    cms = fem.ObjectFFRFreducedOrderInterface()
    cms.LoadFromFile(str(path))
    return cms


def own_reduction(model, shapes, origin=(0, 0, 0)):
    """Exudyn's reduction of the full model with the given shapes (3 n, m), rows node by node."""
    full = fem.FEMinterface()
    full.nodes = {"Position": model.nodes.xyz - np.asarray(origin)}
    order = model.dofs.of_nodes(np.arange(len(model.nodes))).ravel()
    full.massMatrix, full.stiffnessMatrix = (sp.csr_matrix(A.tocsr()[order][:, order]) for A in (model.M, model.K))
    full.modeBasis = {"matrix": shapes, "type": "NormalModes"}
    return fem.ObjectFFRFreducedOrderInterface(full, roundMassMatrix=0, roundStiffnessMatrix=0)


def pendulum(cms, path, steps=1000, end=0.5):
    """Tip at ``end`` of the beam that hangs at its left end, turning about y, and falls from rest along x."""
    system = exu.SystemContainer()
    mbs = system.AddSystem()
    body = cms.AddObjectFFRFreducedOrder(mbs, positionRef=[0, 0, 0], gravity=[0, 0, -9.81])["oFFRFreducedOrder"]
    left, right = (exudyn_marker(read_body(path), name) for name in ("left", "right"))
    ground = mbs.AddObject(items.ObjectGround())
    held = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=ground))
    hinge = mbs.AddMarker(
        items.MarkerSuperElementRigid(
            bodyNumber=body, meshNodeNumbers=left.numbers, weightingFactors=left.weights, offset=left.offset
        )
    )
    mbs.AddObject(items.GenericJoint(markerNumbers=[held, hinge], constrainedAxes=[1, 1, 1, 1, 0, 1]))
    tip = mbs.AddMarker(
        items.MarkerSuperElementPosition(bodyNumber=body, meshNodeNumbers=right.numbers, weightingFactors=right.weights)
    )
    sensor = mbs.AddSensor(
        items.SensorMarker(markerNumber=tip, outputVariableType=exu.OutputVariableType.Position, storeInternal=True)
    )
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps = steps
    settings.timeIntegration.endTime = end
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.8
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.newton.relativeTolerance = 1e-12
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    return np.array(mbs.GetSensorStoredData(sensor)[-1, 1:4])


@pytest.mark.parametrize("origin", [(0, 0, 0), (0.3, -0.1, 0.2)])
def test_exudyn_computes_the_same_arrays_from_the_full_model(tmp_path, origin):
    # Of quadratic elements this stiff, Exudyn's V' K V has only eight digits.
    model = beam_file(tmp_path / "beam.h5", origin=origin, kind="hex8")
    ours = loaded(export_body(tmp_path / "beam.h5", "exudyn").paths[0])
    theirs = own_reduction(model, ours.modeBasis, origin)
    for name in ARRAYS:
        exported, computed = getattr(ours, name), getattr(theirs, name)
        assert exported.shape == computed.shape
        assert np.abs(exported - computed).max() <= 1e-10 * np.abs(computed).max(), name
    assert ours.totalMass == pytest.approx(theirs.totalMass, rel=1e-12)


def test_pendulum_ends_where_that_of_exudyns_own_reduction_ends(beam, tmp_path):
    model, path, file = beam
    tip = pendulum(loaded(file), path)
    own = pendulum(own_reduction(model, loaded(file).modeBasis), path)
    assert np.abs(tip - own).max() < 1e-8
    # A rigid rod, d2/dt2 angle = 3 g / 2 l cos(angle), is near.
    angle, speed, dt = 0.0, 0.0, 0.5 / 20000
    for _ in range(20000):
        speed += dt * 1.5 * 9.81 / LENGTH * np.cos(angle)
        angle += dt * speed
    assert tip == pytest.approx([LENGTH * np.cos(angle), 0, -LENGTH * np.sin(angle)], abs=5e-3)
    # Only the interfaces' nodes: the same motion.
    few = tmp_path / "few.h5"
    beam_file(few, nodes="interfaces")
    fewer = loaded(export_body(few, "exudyn").paths[0])
    assert len(fewer.xRef) < len(loaded(file).xRef) / 4
    assert np.abs(pendulum(fewer, few) - tip).max() < 1e-8


def test_spinning_beam_stretches_as_a_rod(beam):
    """u(L) = rho w2 L3 / (3 E), with rho, E of the steel; one end held on the axis."""
    _, path, file = beam
    speed = 100.0
    cms = loaded(file)
    mbs = exu.SystemContainer().AddSystem()
    ffrf = cms.AddObjectFFRFreducedOrder(mbs, initialAngularVelocity=[0, 0, speed])
    ground = mbs.AddObject(items.ObjectGround())
    held = mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=ground))
    frame = mbs.AddMarker(items.MarkerNodeRigid(nodeNumber=ffrf["nRigidBody"]))
    mbs.AddObject(items.GenericJoint(markerNumbers=[held, frame], constrainedAxes=[1, 1, 1, 1, 1, 0]))
    turn = mbs.AddMarker(items.MarkerNodeRotationCoordinate(nodeNumber=ffrf["nRigidBody"], rotationCoordinate=2))
    fixed = mbs.AddMarker(items.MarkerNodeCoordinate(nodeNumber=mbs.AddNode(items.NodePointGround()), coordinate=0))
    mbs.AddObject(items.CoordinateConstraint(markerNumbers=[fixed, turn], velocityLevel=True, offset=speed))
    cms_damping = exu.MatrixContainer()
    cms_damping.SetWithDenseMatrix(1e-4 * cms.stiffnessMatrixReduced, useDenseMatrix=True)
    mbs.SetObjectParameter(ffrf["oFFRFreducedOrder"], "dampingMatrixReduced", cms_damping)
    right = exudyn_marker(read_body(path), "right")
    mbs.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 2000, 0.1
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.5
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    mbs.SolveDynamic(settings)
    q = mbs.GetNodeOutput(ffrf["nGenericODE2"], exu.OutputVariableType.Coordinates)
    tip = right.weights @ (cms.modeBasis @ q).reshape(-1, 3)[right.numbers]
    expected = STEEL["density"] * speed**2 * LENGTH**3 / (3 * STEEL["young"])
    assert tip[0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("kind", "nodes"), [("hex20", "all"), ("tet10", "skin"), ("hex8", "all"), ("wedge6", "skin")])
def test_triangles_close_the_skin(tmp_path, kind, nodes):
    """Volume by Gauss' theorem, and no edge that only one triangle has."""
    path = tmp_path / "beam.h5"
    beam_file(path, kind=kind, nodes=nodes, modes=2)
    cms = loaded(export_body(path, "exudyn").paths[0])
    triangles, x = np.array(cms.trigList), cms.xRef.reshape(-1, 3)
    a, b, c = (x[triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(LENGTH * WIDTH * HEIGHT, rel=1e-9)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    forward, backward = ({tuple(e) for e in some.tolist()} for some in (edges, edges[:, ::-1]))
    assert forward == backward and len(forward) == len(edges)
    plain = export_body(path, "exudyn", options={"triangles": False}, path=tmp_path / "plain.hdf5")
    assert loaded(plain.paths[0]).trigList == []


def test_marker_is_the_frame_of_the_interface(beam):
    """Weighted mean of the node displacements: the translation of the average interface."""
    _, path, file = beam
    source, cms = read_body(path), loaded(file)
    frame = source.bodies["cb"].floating
    for name in ("left", "right"):
        marker = exudyn_marker(source, name)
        point = marker.weights @ source.coordinates[marker.numbers] + marker.offset
        assert point == pytest.approx(source.interfaces[name].point, abs=1e-12)
        motion = np.einsum("s,scm->cm", marker.weights, cms.modeBasis.reshape(-1, 3, cms.nModes)[marker.numbers])
        assert np.abs(motion - frame.markers[name].motion[:3]).max() < 1e-9 * np.abs(cms.modeBasis).max()
    with refusal("unknown", "", "right"):
        exudyn_marker(source, "rigth")


def test_one_reference_node_has_no_marker(tmp_path):
    """As of RBE2 and couplings of decks: Exudyn would fail as it assembles the system."""
    path, model = tmp_path / "beam.h5", steel(box("hex8", (4, 1, 1), (LENGTH, WIDTH, HEIGHT)))
    one = Interface(
        name="hinge",
        nodes=np.array([0]),
        coupling="direct",
        point=model.nodes.xyz[0].copy(),
        weights=np.ones(1),
        components=(0, 1, 2),
    )
    tip = make_interface(model, name="tip", nodes=where(model, 0, LENGTH))
    with Problem(model, [one, tip]) as problem:
        reduced = CraigBampton(modes=2).reduce(problem, "cb")
        floating = floating_frame(problem, reduced, kind="tangent", interfaces=("tip",))
        write_body(path, [elastic_body(problem, reduced, make_part(problem, nodes="all"), floating=floating)])
    notes = " | ".join(export_body(path, "exudyn").notes)
    assert "no Exudyn marker can follow 'hinge'" in notes
    source = read_body(path)
    with refusal("unsupported", "", "hinge", "average"):
        exudyn_marker(source, "hinge")
    assert len(exudyn_marker(source, "tip").numbers) == 4


def test_notes_say_what_stays_behind(tmp_path):
    path = tmp_path / "beam.h5"
    damping = Damping(alpha=1.0, beta=1e-5, structural=0.02)
    beam_file(path, damping=damping, origin=(0.5, 0, 0), modes=2, nodes="interfaces")
    notes = " | ".join(export_body(path, "exudyn").notes)
    for words in ("dampingMatrixReduced", "(0.5, 0, 0) m", "structural damping of 0.02", "cannot be drawn"):
        assert words in notes
    assert "stiffening" not in notes
    beam_file(path, modes=2)
    (markers,) = export_body(path, "exudyn").notes  # how markers are made
    (page,) = re.findall(r"docs/[\w/]+\.md", markers)
    assert "exudyn_system" in (Path(__file__).parents[2] / page).read_text()


def test_bad_input(beam, tmp_path):
    _, path, _ = beam
    for wrong, message in (
        ({"to": "exudin"}, ("unknown", "to", "exudyn")),
        ({"options": {"triangle": True}}, ("unknown", "triangle", "triangles")),
        ({"options": {"triangles": "no"}}, ("value", "triangles", "no")),
        ({"body": "cbx"}, ("unknown", "", "cbx", "cb")),
        ({"path": tmp_path / "beam.h5"}, ("value", "out", "hdf5")),
        ({"path": path}, ("output", "out")),
    ):
        with refusal(*message):
            export_body(path, **{"to": "exudyn", **wrong})
    with refusal("file", "none.h5"):
        export_body(tmp_path / "none.h5", "exudyn")
    shutil.copy(path, tmp_path / "new.h5")
    with h5py.File(tmp_path / "new.h5", "r+") as file:
        file["format_version"][()] = 99
    with refusal("file", "new.h5", "99"):
        export_body(tmp_path / "new.h5", "exudyn")
    assert [file.name for file in tmp_path.iterdir()] == ["new.h5"]


def test_table_names_its_exporters():
    for name, exporter in EXPORTERS.items():
        assert exporter.name == name and exporter.suffix.startswith(".") and exporter.about
