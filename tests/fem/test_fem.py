"""Assembly against beam theory, exact solutions, convergence rates and CalculiX."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl

from morembs.fem import ElementBlock, Mesh, Nodes, rigid_motion
from morembs.fem.assembly import assemble
from morembs.fem.elements import TYPES
from morembs.fem.interface import make_interface
from morembs.fem.mass import mass_properties
from morembs.fem.material import isotropic, orthotropic
from morembs.problem import Problem
from tests.support.meshes import STEEL, ball, box, heavy, steel, where
from tests.support.refusals import refusal

KINDS = list(TYPES)
SIZES = {"tet4": 3, "hex8": 3, "wedge6": 3, "tet10": 2, "hex20": 2, "hex27": 2, "wedge15": 2}


def skewed(x):
    """An affine map: straight elements, no right angles."""
    return x @ np.array([[1.0, 0.1, 0.05], [0.2, 1.1, 0.1], [0.0, -0.1, 0.9]])


@pytest.mark.parametrize("kind", KINDS)
def test_rigid_motion_has_no_strain_and_its_inertia_is_exact(kind):
    n = SIZES[kind]
    model = steel(box(kind, (n, n, n), (0.3, 0.2, 0.1)))
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    assert np.abs(model.K @ R).max() <= 1e-12 * abs(model.K).max()
    assert abs(model.K - model.K.T).max() == 0.0
    mass, center, inertia = mass_properties(model.M, R, np.zeros(3))
    m = STEEL["density"] * 0.3 * 0.2 * 0.1
    assert mass == pytest.approx(m, rel=1e-13)
    assert center == pytest.approx([0.15, 0.1, 0.05], rel=1e-13)
    sides = np.array([0.3, 0.2, 0.1]) ** 2
    assert inertia == pytest.approx(np.diag(m * (sides.sum() - sides) / 12), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_mass_is_a_scalar_matrix_times_identity(kind):
    M = steel(box(kind, (2, 1, 1), (0.3, 0.2, 0.1))).M.toarray()
    for axis in range(3):
        assert np.array_equal(M[axis::3, axis::3], M[0::3, 0::3])
    assert not M[0::3, 1::3].any() and not M[1::3, 2::3].any()


@pytest.mark.parametrize("kind", KINDS)
def test_patch_of_constant_strain(kind):
    """Linear displacements: interior forces vanish and the energy is that of the constant strain."""
    model = steel(box(kind, (2, 2, 2), (1.0, 1.0, 1.0), warp=skewed))
    G = np.array([[1.0, 0.3, -0.2], [0.5, -0.4, 0.1], [0.2, 0.6, 0.8]]) * 1e-3
    u = (model.nodes.xyz @ G.T).ravel()
    strain = 0.5 * (G + G.T)
    voigt = np.array([strain[0, 0], strain[1, 1], strain[2, 2], 2 * strain[1, 2], 2 * strain[2, 0], 2 * strain[0, 1]])
    C = isotropic(set="all", **STEEL).stiffness
    volume = np.linalg.det(np.array([[1.0, 0.1, 0.05], [0.2, 1.1, 0.1], [0.0, -0.1, 0.9]]))
    assert u @ (model.K @ u) == pytest.approx(volume * voigt @ C @ voigt, rel=1e-10)
    unit = model.nodes.xyz @ np.linalg.inv(np.array([[1.0, 0.1, 0.05], [0.2, 1.1, 0.1], [0.0, -0.1, 0.9]]))
    inner = ((unit > 1e-9) & (unit < 1 - 1e-9)).all(axis=1)
    assert inner.any()
    force = (model.K @ u).reshape(-1, 3)
    assert np.abs(force[inner]).max() < 1e-10 * np.abs(force).max()


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_clamped_beam_against_timoshenko(kind):
    """First bending frequencies of a slender cantilever about both axes, and its torsion."""
    L, b, h = 1.0, 0.04, 0.02
    model = steel(box(kind, (20, 4, 2) if kind == "hex20" else (24, 4, 2), (L, b, h)), poisson=0.0)
    E, rho, A = STEEL["young"], STEEL["density"], b * h
    root = make_interface(model, name="root", nodes=where(model, 0, 0.0), coupling="rigid")
    with Problem(model, [root]) as problem:
        f = problem.fixed_modes(count=8).frequencies_hz
    for inertia, index in ((b * h**3 / 12, 0), (h * b**3 / 12, 1)):
        euler = 1.875104068711961**2 / (2 * np.pi) * np.sqrt(E * inertia / (rho * A * L**4))
        # Rotary inertia and shear lower it (Timoshenko), by 0.1 % here at most.
        assert 0.9985 * euler < f[index] < 1.0005 * euler
    torsion = np.sqrt(E / 2 / rho * torsion_constant(b, h) / (b * h * (b**2 + h**2) / 12)) / (4 * L)
    # The clamp holds the warping too, which stiffens it by about h / L.
    assert np.min(np.abs(f / torsion - 1)) < 0.015


def torsion_constant(b, h):
    """Saint-Venant torsion constant of a rectangle b > h (series of Timoshenko and Goodier)."""
    series = sum(np.tanh(n * np.pi * b / (2 * h)) / n**5 for n in range(1, 40, 2))
    return b * h**3 * (1 / 3 - 64 * h / (np.pi**5 * b) * series)


def timoshenko_free_free(E, G, rho, A, inertia, kappa, L, guess):
    """Frequency (Hz) of a free-free Timoshenko beam near ``guess``: zero of the boundary determinant."""

    def determinant(f):
        w2 = (2 * np.pi * f) ** 2
        # State (w, psi, M, Q) along x: d/dx y = S y; free ends: M = Q = 0.
        S = np.array(
            [
                [0, 1, 0, 1 / (kappa * G * A)],
                [0, 0, -1 / (E * inertia), 0],
                [0, rho * inertia * w2, 0, 1],
                [-rho * A * w2, 0, 0, 0],
            ]
        )
        d = np.array([1.0, 1.0 / L, E * inertia / L**2, E * inertia / L**3])
        P = sl.expm(S * L * 1.0) / d[:, None] * d
        return np.linalg.det(P[2:, :2])

    from scipy.optimize import brentq

    return brentq(determinant, 0.85 * guess, 1.1 * guess, xtol=1e-9)


def test_free_box_against_timoshenko():
    """A stout free beam: Euler is 4 % off, Timoshenko must be met."""
    L, b, h = 0.5, 0.05, 0.06
    model = steel(box("hex20", (20, 2, 3), (L, b, h)), poisson=0.0)
    E, rho, A = STEEL["young"], STEEL["density"], b * h
    with Problem(model) as problem:
        f = problem.elastic_modes(count=8).frequencies_hz
        assert problem.rigid.shape[1] == 6
    for inertia in (b * h**3 / 12, h * b**3 / 12):
        euler = 4.730040744862704**2 / (2 * np.pi) * np.sqrt(E * inertia / (rho * A * L**4))
        exact = timoshenko_free_free(E, E / 2, rho, A, inertia, 5 / 6, L, euler)
        assert exact < 0.985 * euler
        assert np.min(np.abs(f / exact - 1)) < 2e-3
    axial = np.sqrt(E / rho) / (2 * L)
    assert np.min(np.abs(f / axial - 1)) < 1e-3


@pytest.mark.parametrize("kind", ["hex20", "tet10"])
def test_free_solid_sphere(kind):
    """Lamb's first torsional and spheroidal modes, each five-fold."""
    model = assemble(ball(kind, 4, 0.010), [isotropic(set="all", young=1e8, poisson=0.3, density=1e4)])
    with Problem(model) as problem:
        f = problem.elastic_modes(count=10).frequencies_hz
    assert f[:5] == pytest.approx(np.full(5, 2468.711), rel=2e-3)
    assert f[5:] == pytest.approx(np.full(5, 2611.914), rel=2e-3)
    assert np.ptp(f[:5]) < 2e-3 * f[0] and np.ptp(f[5:]) < 2e-3 * f[5]


QUADRATIC = ("tet10", "hex20", "hex27", "wedge15")


@pytest.mark.parametrize(("kind", "rate"), [(kind, 4.0 if kind in QUADRATIC else 2.0) for kind in KINDS])
def test_frequencies_converge_at_the_order_of_the_elements(kind, rate):
    """Axial vibration of a clamped bar with nu = 0, whose frequency is known exactly."""
    levels = (4, 8) if rate == 4.0 else (8, 16)
    errors = []
    for n in levels:
        model = steel(box(kind, (n, 1, 1), (1.0, 0.1, 0.1)), poisson=0.0)
        fixed = where(model, 0, 0.0)
        # Held to its axis, so that the wanted mode is the first one.
        free = np.setdiff1d(np.arange(len(model.nodes)), fixed) * 3
        K, M = model.K[free][:, free].toarray(), model.M[free][:, free].toarray()
        f = np.sqrt(sl.eigh(K, M, eigvals_only=True, subset_by_index=[1, 1])[0]) / (2 * np.pi)
        exact = 0.75 * np.sqrt(STEEL["young"] / STEEL["density"])
        errors.append(f / exact - 1)
    assert errors[0] > errors[1] > 0
    assert np.log2(errors[0] / errors[1]) == pytest.approx(rate, abs=0.25)


def test_orthotropic_reduces_to_isotropic_and_turns_with_its_axes():
    E, nu = 2.1e11, 0.3
    G = E / (2 * (1 + nu))
    iso = isotropic(set="all", young=E, poisson=nu, density=1.0).stiffness
    ortho = orthotropic(set="all", young=(E,) * 3, poisson=(nu,) * 3, shear=(G,) * 3, density=1.0)
    assert ortho.stiffness == pytest.approx(iso, rel=1e-12, abs=1e-3)
    constants = {"young": (140e9, 10e9, 9e9), "poisson": (0.3, 0.28, 0.4), "shear": (5e9, 4.5e9, 3.2e9)}
    plain = orthotropic(set="all", **constants, density=1600.0)
    # Material direction 1 along the model's y: a quarter turn about z swaps moduli and shear planes.
    turned = orthotropic(set="all", **constants, density=1600.0, axes=np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]))
    swap = [1, 0, 2, 4, 3, 5]
    assert turned.stiffness == pytest.approx(plain.stiffness[np.ix_(swap, swap)], rel=1e-12, abs=1e-2)
    compliance = np.linalg.inv(turned.stiffness)
    assert 1 / compliance[1, 1] == pytest.approx(140e9) and 1 / compliance[5, 5] == pytest.approx(5e9)
    assert -compliance[0, 1] * 140e9 == pytest.approx(0.3)


def test_orthotropic_bar_has_the_frequency_of_its_axial_modulus():
    mesh = box("hex20", (10, 1, 1), (1.0, 0.02, 0.02))
    wood = orthotropic(
        set="all", young=(12e9, 0.8e9, 0.5e9), poisson=(0.4, 0.45, 0.3), shear=(0.7e9, 0.6e9, 0.1e9), density=450.0
    )
    with Problem(assemble(mesh, [wood])) as problem:
        f = problem.elastic_modes(count=30).frequencies_hz
    assert np.min(np.abs(f / (np.sqrt(12e9 / 450.0) / 2) - 1)) < 1e-3


def test_two_materials_by_element_set():
    mesh = box("hex8", (4, 1, 1), (1.0, 0.1, 0.1))
    left = mesh.nodes.xyz[mesh.blocks[0].nodes].mean(axis=1)[:, 0] < 0.5
    sets = {"left": (np.flatnonzero(left),), "right": (np.flatnonzero(~left),)}
    mesh = Mesh(nodes=mesh.nodes, blocks=mesh.blocks, element_sets=sets)
    both = [
        isotropic(set="left", young=1e9, poisson=0.3, density=1000.0),
        isotropic(set="right", young=2e9, poisson=0.3, density=3000.0),
    ]
    model = assemble(mesh, both)
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    mass, center, _ = mass_properties(model.M, R, np.zeros(3))
    assert mass == pytest.approx(0.01 * 2000.0)
    assert center[0] == pytest.approx((0.25 * 1000 + 0.75 * 3000) / 4000)
    with refusal("missing", "material"):
        assemble(mesh, both[:1])
    with refusal("conflict", "", "'left'", "'all'"):
        assemble(mesh, [*both, isotropic(set="all", **STEEL)])


def test_inverted_element_is_named():
    mesh = box("hex8", (3, 1, 1), (1.0, 0.1, 0.1))
    nodes = mesh.blocks[0].nodes.copy()
    nodes[1] = nodes[1][[4, 5, 6, 7, 0, 1, 2, 3]]
    bad = Mesh(nodes=mesh.nodes, blocks=(ElementBlock(type="hex8", nodes=nodes, ids=[11, 22, 33]),))
    with refusal("model", "", "22"):
        steel(bad)


@pytest.mark.parametrize("size", [1e80, -1e150, np.inf])
@pytest.mark.filterwarnings("error")
def test_coordinates_that_overflow_are_named(size):
    mesh, model = box("hex8", (1, 1, 1), (1.0, 1.0, 1.0)), steel(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0)))
    xyz = mesh.nodes.xyz.copy()
    xyz[3, 1] = size
    far = Nodes(ids=mesh.nodes.ids + 100, xyz=xyz)
    for whole, place in ((mesh, "mesh"), (replace(model, source="a.npz"), "a.npz")):
        with refusal("file", "nodes", "75", place, "104"):
            replace(whole, nodes=far)


def test_assembly_in_pieces_is_that_of_two_blocks():
    whole, parts = (steel(mesh) for mesh in heavy())
    assert abs(whole.K - parts.K).max() <= 1e-15 * abs(whole.K).max()
    assert abs(whole.M - parts.M).max() <= 1e-15 * abs(whole.M).max()


def joined(first, second):
    """Two meshes as one, coincident nodes merged."""
    xyz = np.vstack([first.nodes.xyz, second.nodes.xyz])
    _, at, inverse = np.unique(np.round(xyz, 9), axis=0, return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    blocks = []
    for mesh, offset in ((first, 0), (second, len(first.nodes))):
        block = mesh.blocks[0]
        blocks.append(ElementBlock(type=block.type, nodes=inverse[block.nodes + offset], ids=block.ids + offset))
    return Mesh(nodes=Nodes(ids=np.arange(len(at)), xyz=xyz[at]), blocks=tuple(blocks))


def moved(x):
    return x + np.array([0.3, 0.0, 0.0])


def test_types_that_fit_together_carry_a_linear_field_across():
    """hex8 beside wedge6 on a quadrilateral: constant strain has no force at the seam."""
    mesh = joined(box("hex8", (2, 2, 2), (0.3, 0.2, 0.1)), box("wedge6", (2, 2, 2), (0.3, 0.2, 0.1), warp=moved))
    model = steel(mesh)
    inner = (np.abs(mesh.nodes.xyz - [0.3, 0.1, 0.05]) < 1e-9).all(axis=1)
    force = (model.K @ (mesh.nodes.xyz @ np.diag([1.0, -0.3, -0.3])).ravel()).reshape(-1, 3)
    assert inner.sum() == 1 and np.abs(force[inner]).max() < 1e-10 * np.abs(force).max()


@pytest.mark.parametrize(
    ("kind", "other_kind"), [("hex20", "hex8"), ("tet10", "tet4"), ("hex8", "tet4"), ("hex20", "tet10")]
)
def test_types_that_gape_are_refused(kind, other_kind):
    mesh = joined(box(kind, (2, 2, 2), (0.3, 0.2, 0.1)), box(other_kind, (2, 2, 2), (0.3, 0.2, 0.1), warp=moved))
    with refusal("model", "mesh"):
        steel(mesh)


def test_axes_are_rows_also_where_the_turn_is_not_its_own_inverse():
    """Directions 1, 2, 3 along the model's y, z, x."""
    cyclic = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    constants = {"young": (140e9, 10e9, 9e9), "poisson": (0.3, 0.28, 0.4), "shear": (5e9, 4.5e9, 3.2e9)}
    turned = orthotropic(set="all", **constants, density=1600.0, axes=cyclic)
    compliance = np.linalg.inv(turned.stiffness)
    assert 1 / np.diag(compliance) == pytest.approx([9e9, 140e9, 10e9, 5e9, 3.2e9, 4.5e9])
