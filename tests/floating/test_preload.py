"""Preload: stress stiffness in K before reduction, against beam theory and the terms of floating frames."""

import meshio
import numpy as np
import psutil
import pytest
import scipy.linalg as sl

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.stages.preload import preload_of
from morembs.app.jobs.stages.spin import rotation_of
from morembs.base.budget import Budget
from morembs.body.file import read_body
from morembs.body.floating.frame import floating_frame
from morembs.body.floating.preload import Preload, apply_preload, apply_prestress
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.fem import DofMap, FEModel
from morembs.fem.interface import make_interface
from morembs.linalg.sparse.select import select_solver
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import STEEL, box, steel, where
from tests.support.refusals import refusal

LENGTH, SIDE = 1.0, 0.02
EI = STEEL["young"] * SIDE**4 / 12
LINE_MASS = STEEL["density"] * SIDE**2
EULER = np.pi**2 * EI / LENGTH**2
MID = SIDE / 2


def beam(coupling="rigid", n=12, off=0.0):
    """Slender square beam along x with an interface at each end, their points ``off`` outwards."""
    model = steel(box("hex20", (n, 1, 1), (LENGTH, SIDE, SIDE)), poisson=0.0)
    return model, [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling, point=[x + d, MID, MID])
        for name, x, d in (("root", 0.0, -off), ("tip", LENGTH, off))
    ]


def pulled(force):
    """Tension on both ends."""
    return Preload(wrench={"root": [-force, 0, 0, 0, 0, 0], "tip": [force, 0, 0, 0, 0, 0]})


def held_squares(problem, motions, softening=None):
    """(rad/s)2 of the body with some frame motions (columns of ``frames``) held; dense."""
    N = sl.null_space(problem.coupling.frames[:, motions].toarray().T)
    K = problem.K.toarray()
    if softening is not None:
        K = K - softening
    return sl.eigh(N.T @ K @ N, N.T @ (problem.M @ N), eigvals_only=True)


PINNED = [0, 1, 2, 3, 7, 8]


@pytest.mark.parametrize("coupling", ["rigid", "average"])
@pytest.mark.parametrize("part", [3.0, 0.5, -0.5, -0.9])
def test_a_pinned_beam_in_tension_rises_as_a_string_and_falls_in_compression(coupling, part):
    model, interfaces = beam(coupling)
    with Problem(model, interfaces) as problem:
        plain = held_squares(problem, PINNED)
        stressed = apply_preload(problem, pulled(part * EULER))
    with Problem(stressed.model, interfaces) as problem:
        loaded = held_squares(problem, PINNED)
    k = np.pi * np.array([1, 2]) / LENGTH
    # Every bending mode comes twice.
    change = (loaded - plain)[[0, 2]]
    assert change == pytest.approx(part * EULER * k**2 / LINE_MASS, rel=4e-3)
    off = loaded[[0, 2]] - (k**4 * EI + k**2 * part * EULER) / LINE_MASS
    assert (np.abs(off) < 1.2e-2 * k**4 * EI / LINE_MASS).all()


def test_a_preloaded_body_still_has_six_free_motions_and_reduces_as_any_other():
    model, interfaces = beam("average")
    with Problem(model, interfaces) as problem:
        stressed = apply_preload(problem, pulled(-0.9 * EULER))
    with Problem(stressed.model, interfaces) as problem:
        size = np.abs(problem.K).max()
        assert problem.rigid.shape[1] == 6
        assert np.abs(problem.K @ problem.rigid).max() < 1e-14 * size * np.abs(problem.rigid).max()
        reduced = CraigBampton(modes=8).reduce(problem)
        exact = held_squares(problem, PINNED)[:4]
        hold = sl.null_space(reduced.B[:, PINNED].T)
        values = sl.eigh(hold.T @ reduced.K @ hold, hold.T @ reduced.M @ hold, eigvals_only=True)[:4]
        assert values == pytest.approx(exact, rel=1e-4)
        assert floating_frame(problem, reduced).count == reduced.order - 6


@pytest.mark.parametrize(("follows", "length"), [((), 1.0), (("root",), 2.0)])
def test_the_critical_factor_is_that_of_euler(follows, length):
    """Loads that turn with the chord: both ends pinned. Loads that turn with one end: a column clamped there."""
    model, interfaces = beam()
    force = 0.2 * EULER
    with Problem(model, interfaces) as problem:
        load = pulled(-force)
        stressed = apply_preload(problem, Preload(wrench=load.wrench, follows=follows))
        # The section's own rotation and shear take less than the third digit.
        assert stressed.critical_factor == pytest.approx(EULER / length**2 / force, rel=4e-3)
        assert stressed.notes["preload_critical_factor"] == stressed.critical_factor
        limit = stressed.critical_factor
        with refusal("model", "preload", "0.99"):
            apply_preload(problem, Preload(wrench=pulled(-force * limit * 1.005).wrench, follows=follows))
        near = apply_preload(problem, Preload(wrench=pulled(-force * limit * 0.999).wrench, follows=follows))
    with Problem(near.model, interfaces) as problem:
        lowest = held_squares(problem, PINNED if not follows else list(range(6)))[0]
    with Problem(model, interfaces) as problem:
        plain = held_squares(problem, PINNED if not follows else list(range(6)))[0]
    # The square of the frequency falls in proportion to the load.
    assert 0 < lowest < 2e-3 * plain


def test_tension_and_rotation_far_from_buckling_have_no_critical_factor():
    model, interfaces = beam()
    with Problem(model, interfaces) as problem:
        stressed = apply_preload(problem, pulled(EULER))
    assert stressed.critical_factor is None and stressed.notes["preload_critical_factor"] == "above 20"


def test_a_spinning_blade_rises_as_southwell_says():
    """Flap 1.193, and 0.193 in the plane of rotation, where the softening of the floating frame is taken off."""
    model, interfaces = beam(n=16)
    speed = 10.0
    load = Preload(speed=speed, axis=[0, 0, 2.0], point=[0.0, MID, MID], held=("root",))
    with Problem(model, interfaces) as problem:
        plain = held_squares(problem, list(range(6)))[:2]
        stressed = apply_preload(problem, load)
        mass, center, _ = problem.mass_properties
    reaction = stressed.notes["preload_reactions"]["root"]
    # The hub pulls the blade inwards.
    assert reaction[0] == pytest.approx(-mass * speed**2 * center[0], rel=1e-6)
    with Problem(stressed.model, interfaces) as problem:
        T = problem.coupling.T
        in_plane = np.repeat([[1.0, 1.0, 0.0]], len(model.nodes), axis=0).ravel()
        softening = speed**2 * (T.T @ (model.M.multiply(in_plane) @ T)).toarray()
        squares = held_squares(problem, list(range(6)), 0.5 * (softening + softening.T))[:2]
    rise = (squares - plain) / speed**2
    assert rise[0] == pytest.approx(0.193, abs=0.01) and rise[1] == pytest.approx(1.193, abs=0.01)


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_the_change_of_a_body_is_that_of_its_geometric_stiffening_terms(coupling):
    """Loads that turn with a tangent frame change K as its stiffening terms do, offsets and moments included."""
    model, interfaces = beam(coupling, n=6, off=0.1)
    tip = np.array([40.0, -30.0, 20.0, 5.0, 3.0, -4.0])
    speed, a = 30.0, np.array([50.0, 200.0, -300.0])
    load = Preload(
        wrench={"tip": tip}, speed=speed, axis=[0, 1, 0], point=[-0.1, MID, MID], acceleration=a, held=("root",)
    )
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=6).reduce(problem)
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=["root"], origin=[-0.1, MID, MID])
        terms = geometric_stiffening(problem, reduced, frame)
        wanted = terms.matrix(acceleration=a, velocity=[0, speed, 0], wrench={"tip": tip})
        stressed = apply_preload(problem, load)
        V = problem.coupling.T @ reduced.V @ frame.elastic
        change = V.T @ ((stressed.model.K - model.K) @ V)
    if coupling == "average":
        # Six dofs on a rigid patch are its frame; on an average one they are near it for the lowest shapes.
        change, wanted = change[:4, :4], wanted[:4, :4]
    assert np.abs(change - wanted).max() < (1e-7 if coupling == "rigid" else 0.02) * np.abs(wanted).max()


def test_a_free_body_balances_what_is_left_by_its_inertia():
    """One force on a free bar: it accelerates, tension falls linearly along it."""
    model, interfaces = beam("average")
    force = 0.5 * EULER
    with Problem(model, interfaces) as problem:
        stressed = apply_preload(problem, Preload(wrench={"tip": [force, 0, 0, 0, 0, 0]}))
        mass, _, _ = problem.mass_properties
    assert stressed.notes["preload_balanced_by_inertia"] == pytest.approx([force, 0, 0, 0, 0, 0], abs=1e-9 * force)
    x, u = model.nodes.xyz[:, 0], stressed.displacements[0::3]
    area = SIDE**2
    line = force / (STEEL["young"] * area * LENGTH) * x**2 / 2
    inner = (x > 0.1) & (x < 0.9)
    assert (u - u[inner].mean() - line + line[inner].mean())[inner] == pytest.approx(0, abs=1e-3 * line.max())
    assert mass == pytest.approx(LINE_MASS * LENGTH, rel=1e-9)
    # Half the tension on average: the exact lowest pinned change is T k2 / (2 m) by symmetry of sin2.
    with Problem(stressed.model, interfaces) as problem:
        k = np.pi / LENGTH
        expected = (k**4 * EI + k**2 * force / 2) / LINE_MASS
        assert held_squares(problem, PINNED)[0] == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_inertia_relief_is_a_held_body_that_accelerates_with_its_load(coupling):
    """Held at the root and moved as the force at the tip moves it, nothing is left for the root to carry."""
    model, interfaces = beam(coupling, n=6, off=0.1)
    load = {"tip": [500.0, 0, 0, 0, 0, 0]}
    with Problem(model, interfaces) as problem:
        mass, _, _ = problem.mass_properties
        free = apply_preload(problem, Preload(wrench=load, follows=("root",)))
        held = apply_preload(problem, Preload(wrench=load, acceleration=[500.0 / mass, 0, 0], held=("root",)))
    assert np.abs(held.notes["preload_reactions"]["root"]).max() < 1e-6
    change = free.model.K - model.K
    assert np.abs(free.model.K - held.model.K).max() < 1e-8 * np.abs(change).max()


def test_known_displacements_prestress_alike():
    model, interfaces = beam("average")
    with Problem(model, interfaces) as problem:
        load = pulled(0.7 * EULER)
        stressed = apply_preload(problem, load)
        again = apply_prestress(problem, stressed.displacements)
        assert np.abs(again.model.K - stressed.model.K).max() < 1e-12 * np.abs(stressed.model.K).max()
        with refusal("value", "displacements"):
            apply_prestress(problem, stressed.displacements[:-1])


def test_a_budget_changes_nothing(tmp_path):
    model, interfaces = beam(n=6)
    with Problem(model, interfaces) as problem:
        free = apply_preload(problem, pulled(EULER)).model.K
    with Budget(1, tmp_path) as budget:
        # What other tests left in this process may be more than a gigabyte.
        budget.memory = psutil.Process().memory_info().rss + 10**9
        with Problem(model, interfaces, solver=select_solver()) as problem:
            assert np.abs(apply_preload(problem, pulled(EULER)).model.K - free).max() < 1e-13 * np.abs(free).max()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, ("missing", "preload")),
        ({"wrench": {"tip": [1.0, 2.0]}}, ("value", "wrench.tip", "6")),
        ({"speed": 3.0}, ("missing", "axis")),
        ({"speed": 3.0, "axis": [0, 0, 0]}, ("value", "axis")),
        ({"speed": float("nan"), "axis": [0, 0, 1]}, ("value", "speed")),
        ({"acceleration": [0, 0, 9.81]}, ("missing", "held")),
        ({"wrench": {"tip": [1e300, 0, 0, 0, 0, 0]}}, ("value", "wrench.tip", "6", "1e+60")),
        ({"acceleration": [1e308, 0, 0], "held": ("root",)}, ("value", "acceleration", "1e+60")),
        ({"speed": 1e200, "axis": [0, 0, 1]}, ("value", "speed", "1e+60")),
    ],
)
def test_loads_that_make_no_sense_are_refused(given, words):
    with refusal(*words):
        Preload(**given)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"wrench": {"tipp": [1, 0, 0, 0, 0, 0]}}, ("unknown", "mesh", "tip")),
        ({"wrench": {"tip": [1, 0, 0, 0, 0, 0]}, "held": ("tip",)}, ("conflict",)),
        ({"wrench": {"corner": [1, 0, 0, 0, 0, 0]}}, ("unknown", "mesh")),
        ({"wrench": {"tip": [1, 0, 0, 0, 0, 0]}, "follows": ("corner",)}, ("model", "follows")),
        ({"wrench": {"tip": [1, 0, 0, 0, 0, 0]}, "follows": ("rot",)}, ("unknown", "held", "root")),
    ],
)
def test_loads_that_do_not_fit_the_interfaces_are_refused(given, words):
    model, interfaces = beam("average", n=2)
    corner = make_interface(model, name="corner", nodes=[int(where(model, 0, 0.5)[0])], coupling="direct")
    with Problem(model, [*interfaces, corner]) as problem, refusal(*words):
        apply_preload(problem, Preload(**given))


def test_matrices_alone_cannot_be_preloaded():
    model, interfaces = beam("average", n=2)
    bare = FEModel(K=model.K, M=model.M, nodes=model.nodes, dofs=DofMap.translations(len(model.nodes)))
    with Problem(bare, interfaces) as problem, refusal("unsupported", "preload"):
        apply_preload(problem, pulled(1.0))


JOB = """
[model]
mesh = "beam.vtk"
units = {units}
[[material]]
young = 210e3
poisson = 0.0
density = 7.85e-9
[[interface]]
name = "root"
nodes = "box:-1,-1,-1,1,100,100"
coupling = "rigid"
point = [0, 10, 10]
[[interface]]
name = "tip"
nodes = "box:999,-1,-1,1001,100,100"
coupling = "rigid"
point = [1000, 10, 10]
{preload}
[[reduce]]
method = "craig-bampton"
modes = 8
[output]
path = "beam.h5"
"""


def job(folder, preload, units='"mm-t-s"'):
    mesh = box("hex20", (12, 1, 1), (1000 * LENGTH, 1000 * SIDE, 1000 * SIDE))
    cells = [("hexahedron20", mesh.blocks[0].nodes)]
    meshio.Mesh(np.array(mesh.nodes.xyz), cells).write(folder / "beam.vtk", binary=True)
    (folder / "job.toml").write_text(JOB.format(preload=preload, units=units))
    return load_job(folder / "job.toml")


def test_a_job_preloads_in_its_own_units(tmp_path):
    # N and N mm: the force is the same number.
    text = f"[preload]\nwrench = {{ root = [{-EULER}, 0, 0, 0, 0, 0], tip = [{EULER}, 0, 0, 0, 0, 0] }}"
    result = run_job(job(tmp_path, text))
    assert "preload" in [stage.name for stage in result.stages]
    file = read_body(tmp_path / "beam.h5")
    body = next(iter(file.bodies.values()))
    hold = sl.null_space(body.input_matrix[:, PINNED].T)
    squares = sl.eigh(hold.T @ body.stiffness_matrix @ hold, hold.T @ body.mass_matrix @ hold, eigvals_only=True)
    k = np.pi / LENGTH
    assert squares[0] == pytest.approx((k**4 * EI + k**2 * EULER) / LINE_MASS, rel=4e-3)
    assert file.recipe["preload"]["wrench"]["tip"][0] == EULER
    assert file.recipe["preload_critical_factor"] == "above 20"
    assert body.floating is not None


def test_a_job_turns_all_loads_into_si_units(tmp_path):
    text = """[preload]
wrench = { tip = [1, 2, 3, 4, 5, 6] }
speed = 7.0
axis = [0, 0, 2]
point = [8, 9, 10]
acceleration = [11, 0, 0]
held = ["root"]
follows = ["tip"]"""
    load = preload_of(job(tmp_path, text, units='{ length = "mm", mass = "g", time = "ms" }'))
    # One unit of force is 1 g mm/ms2 = 1 N, of acceleration 1000 m/s2.
    assert load.wrench["tip"] == pytest.approx([1, 2, 3, 4e-3, 5e-3, 6e-3])
    assert (load.speed, *load.axis) == pytest.approx((7e3, 0, 0, 2))
    assert load.point == pytest.approx([8e-3, 9e-3, 1e-2]) and load.acceleration == pytest.approx([11e3, 0, 0])
    assert load.held == ("root",) and load.follows == ("tip",)
    heavy = preload_of(job(tmp_path, "[preload]\nwrench = { tip = [1, 0, 0, 0, 0, 0] }", units='"m-t-s"'))
    assert heavy.wrench["tip"] == pytest.approx([1000, 0, 0, 0, 0, 0])


@pytest.mark.filterwarnings("error")
def test_the_largest_loads_overflow_nowhere():
    model, interfaces = beam("average", n=2)
    with Problem(model, interfaces) as problem, refusal("model", "preload"):
        apply_preload(problem, Preload(wrench={"tip": [-1e60, 0, 0, 0, 0, 0]}, held=("root",)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wrench = { tip = [1, 2] }", ("value", "wrench", "[preload]")),
        ("speed = 10.0", ("missing", "axis", "[preload]")),
        ("acceleration = [0, 0, 1]", ("missing", "held", "[preload]")),
        ("spin = 3.0", ("unknown", "spin")),
    ],
)
def test_wrong_lines_in_a_job_are_refused(tmp_path, text, words):
    with refusal(*words):
        job(tmp_path, f"[preload]\n{text}")


def test_a_job_spins_at_speeds_in_range(tmp_path):
    given = job(tmp_path, "[spin]\nspeed = [0, 1e200]\naxis = [0, 0, 1]")
    with refusal("value", "speed", "[spin]", "1e+200"):
        rotation_of(given)
