"""Terms of K and M in the parameters, against models assembled at the values."""

from dataclasses import replace

import numpy as np
import pytest

from morembs.fem.assembly import assemble, integrate
from morembs.fem.elements import TYPES
from morembs.fem.material import isotropic, orthotropic
from morembs.fem.mesh import material_of_elements
from morembs.parametric.law import Law, chebyshev_points, lagrange
from morembs.parametric.parameter import Box
from morembs.parametric.terms import AffineProblem, varied_model
from tests.support.parametric import ARM, REST, STEEL, bracket, interfaces, longer, parameters
from tests.support.refusals import refusal


@pytest.fixture(scope="module")
def mesh():
    return bracket()


@pytest.fixture(scope="module")
def varied(mesh):
    return varied_model(mesh, [STEEL], parameters())


def test_sums_of_terms_are_the_matrices_assembled_at_the_values(varied, mesh):
    p = varied.box.point({"E_arm": 1.6e11, "E_rest": 2.6e11, "rho": 8000.0})
    arm = [isotropic(set=name, young=1.6e11, poisson=0.3, density=8000.0) for name in ARM]
    rest = [isotropic(set=name, young=2.6e11, poisson=0.3, density=8000.0) for name in REST]
    expected = assemble(mesh, [*arm, *rest])
    for model in (varied.model(p), varied.assemble_at(p)):
        assert abs(model.K - expected.K).max() <= 1e-14 * abs(expected.K).max()
        assert abs(model.M - expected.M).max() <= 1e-14 * abs(expected.M).max()


def test_coupled_terms_sum_up_to_the_problem_at_the_values(varied):
    model = varied.model(varied.box.nominal)
    with AffineProblem(varied, interfaces(model), model=model) as problem:
        p = problem.box.point({"E_arm": 2.5e11, "rho": 7100.0, "alpha": 30.0})
        with problem.at(p) as there:
            K = sum(a * term for a, term in zip(problem.law_K(p), problem.K_terms, strict=True))
            M = sum(b * term for b, term in zip(problem.law_M(p), problem.M_terms, strict=True))
            assert abs(K - there.K).max() <= 1e-14 * abs(there.K).max()
            assert abs(M - there.M).max() <= 1e-14 * abs(there.M).max()
            assert there.damping.alpha == 30.0
        assert problem.damping.alpha == 10.0


def test_derivatives_of_a_law_are_those_of_its_products():
    points = chebyshev_points(-3.0, 3.0, 6)
    law = Law(factors=np.array([[0, 0], [1, 0], [2, 3], [1, 8], [0, 5]]), points=(np.zeros(0), points))
    rng = np.random.default_rng(0)
    p = np.column_stack([rng.uniform(1, 2, 7), rng.uniform(-3, 3, 7)])
    p[0, 1] = points[2]
    h = 1e-5
    for j in range(2):
        step = h * np.eye(2)[j]
        expected = (law(p + step) - law(p - step)) / (2 * h)
        np.testing.assert_allclose(law.derivative(p)[..., j], expected, atol=1e-8)


def test_lagrange_polynomials_reproduce_a_polynomial_and_its_derivative():
    points, t = chebyshev_points(-2.0, 5.0, 8), np.linspace(-2.0, 5.0, 31)
    polynomial = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.1, 0, 0, 0, 1e-4])
    values, slopes = lagrange(points, t)
    np.testing.assert_allclose(values @ polynomial(points), polynomial(t), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(slopes @ polynomial(points), polynomial.deriv()(t), rtol=1e-11, atol=1e-11)


def test_sets_of_two_parameters_may_not_overlap(mesh):
    first, second, *_ = parameters()
    with refusal("conflict", "young", "E_arm", "E_rest", "77"):
        varied_model(mesh, [STEEL], [first, replace(second, sets=("Volume2",))])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sets": ("Volume22",)}, ("unknown", "set", "Volume22", "Volume2")),
        ({"low": 0.0}, ("value", "range")),
        ({"low": 3e11}, ("value", "range", "HIGH")),
        ({"nominal": 1e11}, ("value", "nominal")),
        ({"kind": "yong"}, ("unknown", "property", "young")),
        ({"name": "E arm"}, ("value", "name")),
    ],
)
def test_wrong_parameters_are_refused(mesh, change, message):
    with refusal(*message):
        varied_model(mesh, [STEEL], [replace(parameters()[0], **change)])


def test_the_modulus_of_an_anisotropic_material_is_refused(mesh):
    ply = orthotropic(
        set="all", young=(140e9, 10e9, 10e9), poisson=(0.3, 0.3, 0.4), shear=(5e9, 5e9, 3.5e9), density=1600.0
    )
    with refusal("unsupported", "young"):
        varied_model(mesh, [ply], parameters()[:1])


def test_values_outside_the_box_are_refused():
    box = Box.of(parameters())
    with refusal("value", "E_arm", "3e+11", "1.5e+11", "2.7e+11"):
        box.point({"E_arm": 3e11})
    with refusal("unknown", "E_amr", "E_arm"):
        box.point({"E_amr": 2e11})


@pytest.fixture(scope="module")
def morphed(mesh):
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        yield problem


def random_values(problem, count):
    rng = np.random.default_rng(8)
    return rng.uniform(problem.box.low, problem.box.high, (count, len(problem.box.low)))


def test_rigid_motion_has_no_stiffness_under_a_morph(morphed):
    for p in random_values(morphed, 20):
        K = morphed.stiffness_sum(morphed.law_K(p))
        R = morphed.rigid_at(p)
        size = abs(K).max() * np.abs(R).max(axis=0)
        assert (np.abs(K @ R).max(axis=0) <= 1e-14 * size).all()


def test_rigid_terms_are_the_rigid_motions_of_the_moved_model(morphed):
    p = morphed.box.point({"t": 2.0})
    with morphed.at(p) as there:
        expected = there.coupling.R.copy()
        away = morphed.coupling.pole - there.coupling.pole
        expected[:, 3:] += expected[:, :3] @ np.array(
            [[0, -away[2], away[1]], [away[2], 0, -away[0]], [-away[1], away[0], 0]]
        )
        np.testing.assert_allclose(morphed.rigid_at(p), expected, atol=1e-13)


def test_a_morph_has_the_matrices_assembled_on_the_moved_mesh(morphed):
    assert morphed.varied.points == 12
    rng = np.random.default_rng(3)
    for p in random_values(morphed, 2):
        with morphed.at(p) as terms, morphed.at(p, assembled=True) as exact:
            assert abs(terms.M - exact.M).max() <= 1e-13 * abs(exact.M).max()
            X = np.column_stack([rng.standard_normal((terms.K.shape[0], 100)), exact.elastic_modes(count=4).vectors])
            energy, other = (np.einsum("ij,ij->j", X, K @ X) for K in (exact.K, terms.K))
            off = np.abs(other / energy - 1)
            assert off.max() <= morphed.eps
            # The modes see the interpolation.
            assert off.max() > 1e-3 * morphed.eps


@pytest.mark.parametrize(("count", "expected"), [(3, 1.4e-2), (4, 2.6e-3), (5, 4.9e-4), (6, 9.4e-5), (8, 3.4e-6)])
def test_error_of_the_interpolated_volumes_of_a_stretched_arm(morphed, count, expected):
    morph = morphed.varied.morph
    eps, ((bits, chosen),) = morph.error(count), morph.groups()
    assert eps == pytest.approx(expected, rel=0.04)
    # It is largest at the ends of the range, where it was not looked at.
    for t in morph.range(morph.which[0]):
        weights = morph.factors(morphed.box.point({"t": t}), morph.roots(bits, count))
        off = [np.abs(weights(block, np.flatnonzero(chosen[id(block)])) - 1).max() for block in morph.mesh.blocks]
        assert 0.9 * eps < max(off) <= eps


def test_terms_are_the_weighted_integrals_at_any_value(morphed):
    # What the terms say between their points is what integration with the factors gives there.
    varied, p = morphed.varied, morphed.box.point({"t": 1.234, "E_arm": 1.7e11})
    morph, owner = varied.morph, material_of_elements(varied.morph.mesh, varied.materials(p))
    data = np.zeros(varied.stiffness.size)
    integrate(
        morph.move_mesh(p),
        varied.materials(p),
        owner,
        varied.graph,
        stiffness=data,
        weights=morph.factors(p, morph.roots(1, varied.points)),
    )
    np.testing.assert_allclose(varied.stiffness.combine(varied.stiffness.law(p)), data, atol=1e-13 * data.max())


def test_limits_of_volumes_hold_and_are_reached(morphed):
    groups, ratios = morphed.varied.volume_ratios()
    assert groups.tolist() == [2]
    (block,), rule = morphed.varied.morph.mesh.blocks, TYPES["hex20"].rule(5)
    rows = np.arange(len(block.ids))
    volume = {
        t: morphed.varied.morph.determinants(block, rows, rule, morphed.box.point({"t": t}))
        for t in (-3.0, -1.234, 0.0, 2.9)
    }
    for t, det in volume.items():
        low, high = ratios.at(morphed.box.point({"t": t}))
        true = det / volume[0.0]
        assert true.min() - 1e-5 < low[0] <= true.min()
        assert true.max() <= high[0] < true.max() + 1e-5


def test_a_morph_that_turns_elements_is_refused(mesh):
    with refusal("model", "displacement", "-3", "12", "hex20"):
        given = longer(mesh)
        varied_model(mesh, [STEEL], [replace(given, high=12.0, displacement=-given.displacement)])


def test_a_morph_that_bends_an_interface_is_refused(mesh):
    given = longer(mesh)
    d = given.displacement.copy()
    d[:, 0] = 1e-2 * mesh.nodes.xyz[:, 2]
    varied = varied_model(mesh, [STEEL], [replace(given, displacement=d)])
    with refusal("unsupported", "displacement"):
        AffineProblem(varied, interfaces(varied.model(varied.box.nominal)))
