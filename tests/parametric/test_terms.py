"""Terms of K and M in the parameters, against models assembled at the values."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morembs.errors import InputError
from morembs.importers import read_mesh
from morembs.interface import make_interface
from morembs.model.assembly import assemble
from morembs.model.material import isotropic, orthotropic
from morembs.model.selection import select_nodes
from morembs.parametric.law import Law, chebyshev_points, lagrange
from morembs.parametric.parameter import Box, Parameter
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.units import parse_units

BRACKET = Path(__file__).parents[2] / "data" / "small_meshes" / "bracket.inp"
ARM = ("Volume2", "Volume3", "Volume4", "Volume5")
STEEL = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)


def parameters():
    return (
        Parameter(name="E_arm", kind="young", low=1.5e11, high=2.7e11, nominal=2.1e11, sets=ARM),
        Parameter(name="E_rest", kind="young", low=1.5e11, high=2.7e11, nominal=2.0e11, sets=("Volume1", "Volume6")),
        Parameter(name="rho", kind="density", low=7000.0, high=8700.0, nominal=7850.0),
        Parameter(name="alpha", kind="alpha", low=0.0, high=50.0, nominal=10.0),
    )


@pytest.fixture(scope="module")
def mesh():
    return read_mesh(BRACKET, parse_units("mm-kg-s"))


@pytest.fixture(scope="module")
def varied(mesh):
    return varied_model(mesh, [STEEL], parameters())


def interfaces(model):
    return [make_interface(model, name=name, nodes=select_nodes(model, f"set:{name}")) for name in ("FOOT", "TIP")]


def test_sums_of_terms_are_the_matrices_assembled_at_the_values(varied, mesh):
    p = varied.box.point({"E_arm": 1.6e11, "E_rest": 2.6e11, "rho": 8000.0})
    arm = [isotropic(set=name, young=1.6e11, poisson=0.3, density=8000.0) for name in ARM]
    rest = [isotropic(set=name, young=2.6e11, poisson=0.3, density=8000.0) for name in ("Volume1", "Volume6")]
    expected = assemble(mesh, [*arm, *rest])
    for model in (varied.model(p), varied.assembled(p)):
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
    with pytest.raises(InputError, match="E_arm and E_rest both give the young of element 77"):
        varied_model(mesh, [STEEL], [first, replace(second, sets=("Volume2",))])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sets": ("Volume22",)}, "names the element set 'Volume22'.*did you mean 'Volume2'"),
        ({"low": 0.0}, "positive values"),
        ({"low": 3e11}, r"expected \[LOW, HIGH\]"),
        ({"nominal": 1e11}, "nominal = 1e.11 lies outside"),
        ({"kind": "yong"}, "did you mean 'young'"),
        ({"name": "E arm"}, "letters, digits"),
    ],
)
def test_wrong_parameters_are_refused(mesh, change, message):
    with pytest.raises(InputError, match=message):
        varied_model(mesh, [STEEL], [replace(parameters()[0], **change)])


def test_the_modulus_of_an_anisotropic_material_is_refused(mesh):
    ply = orthotropic(
        set="all", young=(140e9, 10e9, 10e9), poisson=(0.3, 0.3, 0.4), shear=(5e9, 5e9, 3.5e9), density=1600.0
    )
    with pytest.raises(InputError, match="not isotropic"):
        varied_model(mesh, [ply], parameters()[:1])


def test_values_outside_the_box_are_refused():
    box = Box.of(parameters())
    with pytest.raises(InputError, match=r"E_arm = 3e\+11 lies outside \[1.5e\+11, 2.7e\+11\]; the bound"):
        box.point({"E_arm": 3e11})
    with pytest.raises(InputError, match="did you mean 'E_arm'"):
        box.point({"E_amr": 2e11})
