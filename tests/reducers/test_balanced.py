"""Second-order balanced truncation against pyMOR, dense Lyapunov equations and the full response."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

import morembs
from benchmarks.certificates import truss
from morembs.base.errors import SolverError
from morembs.certificate.response import full_response, reduced_response
from morembs.fem import DofMap, FEModel
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers.balanced import BalancedTruncation
from morembs.reducers.petrov_galerkin import refuse_unstable
from morembs.reducers.second_order_balancing import VARIANTS, band_factor, lyapunov_factor
from tests.support.matrices import dense_gramians, difference
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

RAYLEIGH = Damping(alpha=200.0, beta=1e-5)
OMEGA = 2 * np.pi * np.linspace(20.0, 3000.0, 25)


def held():
    """A clamped beam with a damping matrix of its own; forces act at one node of its tip."""
    free = steel(box("hex8", (4, 1, 1), (0.5, 0.05, 0.03)))
    keep = np.setdiff1d(np.arange(free.size), free.dofs.of_nodes(where(free, 0, 0.0)).ravel())
    K, M = free.K[keep][:, keep], free.M[keep][:, keep]
    dofs = DofMap(node=free.dofs.node[keep], component=free.dofs.component[keep])
    extra = np.zeros(len(keep))
    extra[7] = 500.0
    D = sp.csr_array(200.0 * M + 1e-5 * K + sp.diags_array(extra))
    model = FEModel(K=K, M=M, D=D, nodes=free.nodes, dofs=dofs)
    tip = make_interface(model, name="tip", nodes=where(free, 0, 0.5)[:1], coupling="direct")
    return model, [tip]


def free_beam(coupling="rigid", cells=8):
    model = steel(box("hex20", (cells, 1, 1), (0.5, 0.05, 0.03)))
    return model, [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling=coupling) for n, x in (("l", 0.0), ("r", 0.5))
    ]


def error(actual, exact):
    return (np.linalg.norm(actual - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))).max()


def modal_model():
    """Six modes between 3 and 40 rad/s, damped by 1 to 5 percent, and two loads."""
    values = np.array([3.0, 7.0, 7.1, 15.0, 28.0, 40.0]) ** 2
    damping = 2 * np.linspace(0.01, 0.05, 6) * np.sqrt(values)
    return values, damping, np.random.default_rng(4).standard_normal((6, 2))


def test_closed_form_of_a_modal_model_solves_the_lyapunov_equation():
    values, damping, F = modal_model()
    Z = np.vstack(lyapunov_factor(values, damping, F))
    P, _ = dense_gramians(np.eye(6), np.diag(damping), np.diag(values), F)
    assert difference(Z @ Z.T, P) < 1e-11


@pytest.mark.parametrize("overdamped", [False, True])
def test_a_band_without_end_gives_the_gramian_of_all_frequencies(overdamped):
    values, damping, F = modal_model()
    if overdamped:
        damping[4] = 200.0
    whole = np.vstack(lyapunov_factor(values, damping, F))

    def states(s):
        return F / (values + s[:, None] * damping + s[:, None] ** 2)[:, :, None]

    P = whole @ whole.T
    Z = np.vstack(band_factor(states, values, damping, (0.0, 1e9)))
    assert difference(Z @ Z.T, P) < 1e-6
    # Two bands together are one, to the accuracy of the rule.
    low, high, both = (np.vstack(band_factor(states, values, damping, band)) for band in ((0, 9), (9, 30), (0, 30)))
    assert difference(low @ low.T + high @ high.T, both @ both.T) < 1e-9


def energy_factor(G):
    """L with L L' = G, columns by falling size; scaled, so that small entries keep their digits."""
    d = np.sqrt(np.diag(G))
    values, Y = sl.eigh(G / np.outer(d, d))
    return d[:, None] * (Y * np.sqrt(np.maximum(values, 0.0)))[:, ::-1]


@pytest.mark.parametrize(("balancing", "variants"), [("bfsr", VARIANTS), ("sr", ("pv", "so"))])
def test_all_variants_agree_with_pymor(balancing, variants):
    """pyMOR truncates with the exact Gramians, both of them: singular values and responses are the same."""
    pytest.importorskip("pymor")
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import SecondOrderModel
    from pymor.reductors import sobt

    set_log_levels({"pymor": "ERROR"})
    model, tip = held()
    with Problem(model, tip) as problem:
        M, D, K, B = (A.toarray() for A in (problem.M, problem.D, problem.K, problem.B))
        n = len(M)
        c, o = (energy_factor(G) for G in dense_gramians(M, D, K, B))
        factors = {"pc": c[:n], "vc": c[n:], "po": o[:n], "vo": o[n:]}

        class Exact(SecondOrderModel):
            def gramian(self, typ, mu=None):
                return self.M.source.from_numpy(factors[typ[:2]])

        full = SecondOrderModel.from_matrices(M, D, K, B, B.T)
        full = Exact(**{name: getattr(full, name) for name in ("M", "E", "K", "B", "Cp", "Cv")})
        names = {
            "p": ("SOBTp", full.psv),
            "v": ("SOBTv", full.vsv),
            "pv": ("SOBTpv", full.pvsv),
            "vp": ("SOBTvp", full.vpsv),
            "fv": ("SOBTfv", full.psv),
            "so": ("SOBT", full.vsv),
        }
        for variant in variants:
            name, values = names[variant]
            reference = getattr(sobt, name + "Reductor")(full).reduce(9, projection=balancing)
            reduced = BalancedTruncation(variant=variant, order=9, balancing=balancing, adi_tolerance=1e-13).reduce(
                problem
            )
            H = np.array([reference.transfer_function.eval_tf(1j * w) for w in OMEGA])
            exact = values()[:9]
            assert np.abs(reduced.recipe["singular_values"][:9] - exact).max() < 1e-8 * exact[0], variant
            assert error(reduced_response(reduced, OMEGA), H) < 1e-8, variant
            assert reduced.symmetric == (variant in ("fv", "pv"))


def test_lightly_damped_modes_of_a_small_model_have_a_dense_gramian():
    """Masses of one chain, a mode of each of which ADI would take a shift for: exact singular values."""
    size = 320
    K = sp.diags_array([np.full(size, 2.0), -np.ones(size - 1), -np.ones(size - 1)], offsets=[0, 1, -1]).tocsr()
    D = sp.diags_array(np.r_[np.full(size - 1, 2e-4), 3e-2])
    model = morembs.from_matrices(K, sp.eye_array(size), D, B=np.eye(size)[:, :1])
    with Problem(model, [morembs.matrix_interface(model, name="B", matrix="B")]) as problem:
        reduced = BalancedTruncation(order=6).reduce(problem)
        with refusal("result", "max_steps", by=SolverError):
            BalancedTruncation(order=6, adi_steps=250).reduce(problem)
    assert "dense" in reduced.recipe["gramian"]
    P, Q = dense_gramians(np.eye(size), D.toarray(), K.toarray(), np.eye(size)[:, :1])
    exact = np.sort(np.sqrt(np.linalg.eigvals(P[:size, :size] @ Q[:size, :size]).real.clip(0.0)))[::-1]
    assert np.allclose(reduced.recipe["singular_values"][:6], exact[:6], rtol=1e-9)


def test_gramian_of_a_free_body_is_that_of_its_elastic_part():
    model, interfaces = free_beam(cells=5)
    with Problem(model, interfaces, damping=RAYLEIGH) as problem:
        K, M = problem.K.toarray(), problem.M.toarray()
        reduced = {
            v: BalancedTruncation(variant=v, order=24, adi_tolerance=1e-12).reduce(problem) for v in ("fv", "pv", "v")
        }
        F, Z = problem.B.toarray() * problem.motion_scale, problem.rigid
        H = full_response(problem, OMEGA)
    values, Phi = sl.eigh(K, M)
    values, F = values[6:], Phi[:, 6:].T @ F
    Zp, Zv = lyapunov_factor(values, RAYLEIGH.alpha + RAYLEIGH.beta * values, F)
    for variant, product in (("pv", Zp.T @ Zp), ("v", Zp.T @ Zv)):
        exact = sl.svdvals(product)[:24]
        assert np.abs(reduced[variant].recipe["singular_values"][:24] - exact).max() < 1e-8 * exact[0]
    for body in reduced.values():
        assert body.rigid_count == 6 and body.order == 30
        assert error(reduced_response(body, OMEGA), H) < 1e-3
        # Elastic motion does not move the body as a whole, and no force is lost on it.
        for X in (body.V[:, 6:], *([] if body.W is None else [body.W[:, 6:]])):
            assert np.abs(Z.T @ M @ X).max() < 1e-10 * np.sqrt(np.abs(np.einsum("ij,ij->j", X, M @ X)).max())


def test_a_band_spends_the_order_where_it_counts():
    for damping in (RAYLEIGH, Damping(modal=0.01), Damping()):
        model, interfaces = free_beam()
        with Problem(model, interfaces, damping=damping) as problem:
            H = full_response(problem, OMEGA)
            reduced = BalancedTruncation(order=30, band_hz=[0.0, 3500.0]).reduce(problem)
            assert error(reduced_response(reduced, OMEGA), H) < 1e-5
            assert ("delta" in reduced.recipe) == (damping == Damping())
            small = BalancedTruncation(tolerance=1e-4, band_hz=[0.0, 3500.0]).reduce(problem)
            values = np.array(small.recipe["singular_values"])
            assert (values > 1e-4 * values[0]).sum() == small.order - 6 < 24


def test_modal_damping_is_integrated_in_a_reference_model():
    model, interfaces = free_beam("average")
    with Problem(model, interfaces, damping=Damping(modal=0.02)) as problem:
        reduced = BalancedTruncation(variant="pv", order=12).reduce(problem)
        K, M, F = problem.K.toarray(), problem.M.toarray(), problem.B.toarray() * problem.motion_scale
    values, Phi = sl.eigh(K, M)
    values, F = values[6:], Phi[:, 6:].T @ F
    Zp, _ = lyapunov_factor(values, 2 * 0.02 * np.sqrt(values), F)
    exact = sl.svdvals(Zp.T @ Zp)[:12]
    assert np.abs(reduced.recipe["singular_values"][:12] - exact).max() < 1e-5 * exact[0]
    assert "modal damping" in reduced.recipe["gramian"]


def test_unstable_or_perpendicular_reductions_are_refused():
    model, interfaces = free_beam()
    cuts_a_pair = refusal("result", "variant", by=SolverError)
    with Problem(model, interfaces, damping=Damping(alpha=5.0, beta=2e-6)) as problem, cuts_a_pair:
        BalancedTruncation(variant="p", order=24, band_hz=[0.0, 3500.0]).reduce(problem)
    # Negative stiffness that only a test space other than the trial space can give.
    with refusal("result", "order", by=SolverError):
        refuse_unstable(np.eye(2), 1e-3 * np.eye(2), np.array([[4.0, 3.0], [-3.0, 4.0]]), "it", "take another order")


def test_what_cannot_be_integrated_is_refused():
    model, interfaces = free_beam()
    with Problem(model, interfaces) as problem, refusal("unsupported", "", "band_hz"):
        BalancedTruncation(order=6).reduce(problem)
    with Problem(model, interfaces, damping=Damping(alpha=1.0)) as problem:
        with refusal("result", "max_steps", "4", by=SolverError):
            BalancedTruncation(order=6, adi_steps=4).reduce(problem)
        with refusal("model", "order"):
            BalancedTruncation(order=9000, band_hz=[0.0, 100.0]).reduce(problem)
    for given in ({}, {"order": 3, "tolerance": 1e-3}):
        with refusal("missing", "order", "order", "tolerance"):
            BalancedTruncation(**given)
    for given, wrong in (
        ({}, {"order": 0}),
        ({}, {"tolerance": 2.0}),
        ({"order": 3}, {"variant": "x"}),
        ({"order": 3}, {"balancing": "x"}),
        ({"order": 3}, {"adi_steps": 0}),
        ({"order": 3}, {"adi_tolerance": 0.0}),
    ):
        with refusal("value", *wrong, *wrong.values()):
            BalancedTruncation(**given, **wrong)
    for band in ([5.0, 1.0], [5.0]):
        with refusal("value", "band_hz", "LOW", "HIGH"):
            BalancedTruncation(order=3, band_hz=band)


def test_damping_of_rigid_motion_is_refused():
    model, interfaces = free_beam(cells=2)
    grounded = FEModel(K=model.K, M=model.M, D=sp.csr_array(10.0 * model.M), nodes=model.nodes, dofs=model.dofs)
    with Problem(grounded, interfaces) as problem, refusal("model", "damping"):
        BalancedTruncation(order=6).reduce(problem)
    # A damping matrix that leaves it alone serves as Rayleigh damping does.
    inner = FEModel(K=model.K, M=model.M, D=sp.csr_array(1e-5 * model.K), nodes=model.nodes, dofs=model.dofs)
    spectra = []
    for damped, damping in (
        (inner, Damping()),
        (model, Damping(beta=1e-5)),
        (inner, Damping(alpha=200.0)),
        (model, RAYLEIGH),
    ):
        with Problem(damped, interfaces, damping=damping) as problem:
            spectra.append(BalancedTruncation(order=12).reduce(problem).recipe["singular_values"])
    assert spectra[0] == pytest.approx(spectra[1], abs=1e-8 * spectra[1][0])
    assert spectra[2] == pytest.approx(spectra[3], abs=1e-8 * spectra[3][0])


@pytest.mark.parametrize(("variant", "orders", "error"), [("p", (2, 3, 9), 0.005), ("vp", (2, 3), 0.1)])
def test_bodies_of_two_bases_have_a_positive_mass(variant, orders, error):
    """W'MV of balanced spaces has any sign; solved for the accelerations it is positive, as simulations want it."""
    band, model = [0.0, 600.0], truss(np.random.default_rng(0), 12, held=True, twins=False)
    node = make_interface(model, name="i", nodes=np.array([5]), coupling="direct", components=(0, 1, 2))
    omega = 2 * np.pi * np.linspace(*band, 200)
    with Problem(model, [node], damping=Damping(modal=0.01)) as problem:
        H = full_response(problem, omega)
        errors = []
        for order in orders:
            reduced = BalancedTruncation(order=order, variant=variant, band_hz=band).reduce(problem)
            assert np.linalg.eigvalsh(reduced.M + reduced.M.T).min() > 0
            errors.append(np.abs(reduced_response(reduced, omega) - H).max() / np.abs(H).max())
    assert errors[-1] < error and errors[-1] < 0.5 * errors[0]
