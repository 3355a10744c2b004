"""Modal tables, structural damping and damping matrices against dense solutions of the full equations."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.app.jobs.job import load_job
from morembs.app.jobs.stages.couple import damping_of
from morembs.base.errors import InputError
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.certificate.certify import certify
from morembs.certificate.response import full_response, reduced_response
from morembs.problem import Problem
from morembs.problem.damping import NAMED, STRUCTURAL, Damping, frequency_domain_only
from morembs.reducers import REDUCERS, AutoReducer, BalancedTruncation, FreeInterface, Gramian, Irka, Krylov, Modal
from morembs.responses.certified import certified_reference
from morembs.responses.direct import direct_response, elastic_states
from morembs.responses.reference import reference_model
from tests.support.commands import refused
from tests.support.decks import folder
from tests.support.meshes import beam, ends, where
from tests.support.refusals import refusal

OMEGA = 2 * np.pi * np.array([40.0, 500.0, 1090.0, 2500.0])
# The beams have modes on both sides of all jumps; the first jump parts the modes within the band.
TABLE = [[0.0, 0.01], [1200.0, 0.1], [6000.0, 1.0]]


def table_ratio(hz):
    return np.where(hz < 1200.0, 0.01, np.where(hz < 6000.0, 0.1, 1.0))


def modal_matrix(M, values, phi, ratio):
    """D = M Phi diag(2 zeta omega) Phi' M of elastic modes."""
    omega = np.sqrt(values)
    P = M @ phi
    return (P * (2 * ratio(omega / (2 * np.pi)) * omega)) @ P.T


def pencil(problem):
    """Dense K, M and all elastic eigenvalues and vectors."""
    K, M = problem.K.toarray(), problem.M.toarray()
    values, phi = sl.eigh(K, M)
    r = problem.rigid.shape[1]
    return K, M, values[r:], phi[:, r:]


def dense_response(problem, omega, D, eta=0.0):
    """H (nf, m, m) under loads without rigid part, by dense solutions of the full equations."""
    K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
    F = B - M @ problem.rigid @ (problem.rigid.T @ B)
    s = 1 / np.sqrt(np.diag(K))[:, None]
    return np.array(
        [B.T @ (s * np.linalg.solve(s * ((1 + 1j * eta) * K + 1j * w * D - w**2 * M) * s.T, s * F)) for w in omega]
    )


def each(H, true, problem):
    """Relative error at each frequency, moments scaled to forces."""
    S = np.outer(problem.motion_scale, problem.motion_scale)
    return np.linalg.norm((H - true) * S, axis=(1, 2)) / np.linalg.norm(true * S, axis=(1, 2))


def off(H, true, problem):
    return each(H, true, problem).max()


# The table itself.


def test_each_ratio_holds_from_its_frequency_to_the_next():
    hz = np.array([0.0, 99.999, 100.0, 999.999, 1000.0, 1e6])
    expected = [0.01, 0.01, 0.1, 0.1, 1.0, 1.0]
    for given in ("adams", NAMED["adams"], [[0, 0.01], [100, 0.1], [1000, 1]]):
        assert Damping(modal_table=given).ratio(2 * np.pi * hz) == pytest.approx(expected)
    assert Damping(modal_table="adams") == Damping(modal_table=[[0, 0.01], [100, 0.1], [1000, 1]])
    assert Damping(modal=0.03).ratio(2 * np.pi * hz) == pytest.approx([0.03] * 6)
    assert len(Damping(modal=0.03).jumps) == 0 and Damping(modal_table="adams").jumps == pytest.approx(
        2 * np.pi * np.array([100.0, 1000.0])
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"modal_table": [[0, 0.01], [200, 0.1], [100, 0.2]]}, ["100 Hz after 200 Hz", "ascending"]),
        ({"modal_table": [[0, 0.01], [100, 0.1], [100, 0.2]]}, ["100 Hz after 100 Hz", "ascending"]),
        ({"modal_table": [[0, -0.01]]}, ["ratio -0.01 at 0 Hz", "0 to 1"]),
        ({"modal_table": [[0, 0.01], [100, 2.0]]}, ["ratio 2 at 100 Hz", "0.02 for 2 percent"]),
        ({"modal_table": [[0, float("nan")]]}, ["[[0, nan]]", "number"]),
        ({"modal_table": [[50, 0.01]]}, ["begins at 50 Hz", "[0, ratio]"]),
        ({"modal_table": [[0, 0.01], [100]]}, ["expected points"]),
        ({"modal_table": "adam"}, ["'adam'", "'adams'"]),
        ({"modal": 2.0}, ["modal = 2.0", "0.02 for 2 percent"]),
        ({"modal": -0.1}, ["modal = -0.1", "from 0 to 1"]),
        ({"structural": -0.1}, ["structural = -0.1", "zero or more"]),
        ({"modal": 0.1, "modal_table": "adams"}, ["not both"]),
        ({"alpha": 0.1, "modal_table": "adams"}, ["not both"]),
    ],
)
def test_wrong_damping_is_refused_in_words(options, words):
    with pytest.raises(InputError) as error:
        Damping(**options)
    assert all(word in str(error.value) for word in words), str(error.value)


# Modal tables.


def test_the_reduced_damping_of_a_table_is_that_of_the_modes():
    model = beam()
    with Problem(model, ends(model), damping=Damping(modal_table=TABLE)) as problem:
        _, M, values, phi = pencil(problem)
        D = modal_matrix(M, values, phi, table_ratio)
        every = Modal(modes=len(values)).reduce(problem)
        assert np.abs(every.D - every.V.T @ D @ every.V).max() < 1e-8 * np.abs(every.D).max()
        for body in (FreeInterface(modes=9).reduce(problem), REDUCERS["craig-bampton"](modes=9).reduce(problem)):
            theta, Y = sl.eigh(body.K, body.M)
            own = modal_matrix(body.M, theta[6:], Y[:, 6:], table_ratio)
            assert np.abs(body.D - own).max() < 1e-9 * np.abs(own).max()
            assert np.abs(body.D @ Y[:, :6]).max() < 1e-12 * np.abs(own).max()


def test_modal_damping_of_matrices_that_are_not_symmetric():
    """Each right eigenvector keeps its own: D x = 2 zeta omega M x, whatever the scale of x."""
    rng = np.random.default_rng(6)
    M = np.eye(7) + 0.2 * rng.normal(size=(7, 7))
    X = rng.normal(size=(7, 7))
    values = (2 * np.pi * np.array([0.0, 100.0, 800.0, 1500.0, 2500.0, 7000.0, 9000.0])) ** 2
    K = M @ X @ np.diag(values) @ np.linalg.inv(X)
    D = Damping(modal_table=TABLE).matrix(M, K, X[:, :1], symmetric=False)
    omega = np.sqrt(values)
    wanted = M @ X * (2 * table_ratio(omega / (2 * np.pi)) * omega)
    assert np.abs(D @ X - wanted).max() < 1e-7 * np.abs(wanted).max()
    assert np.abs(D - D.T).max() > 1e-2 * np.abs(D).max()


@pytest.mark.parametrize(("coupling", "table"), [("average", TABLE), ("rigid", "adams")])
def test_the_response_of_a_table_solves_the_dense_equations(coupling, table):
    model = beam((14, 2, 1))
    damping = Damping(modal_table=table)
    with Problem(model, ends(model, coupling), damping=damping) as problem:
        _, M, values, phi = pencil(problem)
        ratio = table_ratio if table == TABLE else lambda hz: np.where(hz < 100, 0.01, np.where(hz < 1000, 0.1, 1.0))
        true = dense_response(problem, OMEGA, modal_matrix(M, values, phi, ratio))
        assert off(full_response(problem, OMEGA), true, problem) < 1e-6
        assert len(reference_model(problem, OMEGA).values) < 0.9 * len(values)
        with refusal("unsupported", "damping"):
            elastic_states(problem.system, 100j, problem.B)


def test_a_table_that_jumps_among_modes_of_a_larger_model_makes_an_estimate():
    model = beam((20, 2, 2))
    with Problem(model, ends(model)) as problem:
        hz = problem.elastic_modes(count=2).frequencies_hz
    for table, proven in (([[0, 0.01], [1e5, 1.0]], False), ([[0, 0.5], [0.5 * float(hz[0]), 0.01]], True)):
        with Problem(model, ends(model), damping=Damping(modal_table=table)) as problem:
            reference = certified_reference(problem, [0.0, float(hz[1])])
            assert reference.proven == proven and len(reference.values) < 0.5 * problem.K.shape[0]
            assert proven or "table jumps among modes" in reference.doubts[0]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_a_jump_among_modes_that_are_not_resolved_counts_as_error_of_the_response(tolerance):
    """Jumps high above the band, wherever they lie among the Ritz values: the reported error covers the true one."""
    model, w = beam((14, 2, 1)), OMEGA[1:2]
    with Problem(model, ends(model)) as problem:
        _, M, values, phi = pencil(problem)
    part = []
    for jump in np.geomspace(6e4, 1e5, 6):
        with Problem(model, ends(model), damping=Damping(modal_table=[[0, 0.01], [jump, 1.0]])) as problem:
            reference = reference_model(problem, w, tolerance=tolerance)
            D = modal_matrix(M, values, phi, lambda hz, at=jump: np.where(hz < at, 0.01, 1.0))
            assert reference.error <= tolerance
            part.append(off(reference.response(w), dense_response(problem, w, D), problem) / reference.error)
    assert max(part) < 1.5


def test_a_certificate_names_the_modes_that_a_jump_parts():
    model = beam()
    damping = Damping(modal_table=TABLE)
    hz = np.linspace(100.0, 2600.0, 60)
    with Problem(model, ends(model), damping=damping) as problem:
        _, M, values, phi = pencil(problem)
        first = float(np.sqrt(values[0]) / (2 * np.pi))
        true = dense_response(problem, 2 * np.pi * hz, modal_matrix(M, values, phi, table_ratio))
        bodies = [
            reducer.reduce(problem)
            for reducer in (
                FreeInterface(modes=6),
                Krylov(shifts_hz=[0.0, 1500.0]),
                Gramian(band_hz=[100.0, 2600.0], order=20),
            )
        ]
        for body, certificate in zip(bodies, certify(problem, bodies, hz[[0, -1]], points=hz), strict=True):
            error = each(reduced_response(body, 2 * np.pi * hz), true, problem)
            assert np.abs(certificate.error - error).max() < 1e-6 * error.max() + 2e-6
            # The reference has all modes of this small model, and none of them is near a jump.
            assert certificate.kind == "proven" and not [note for note in certificate.notes if "jumps between" in note]
            part = certificate.bound / error
            assert part.min() > 0.99 and np.median(part) < 1.1
    # Constraint modes alone are too stiff: a jump lies between both frequencies of the first mode.
    with Problem(model, ends(model), damping=Damping(modal_table=[[0, 0.01], [1.0001 * first, 0.1]])) as problem:
        (certificate,) = certify(problem, [REDUCERS["guyan"]().reduce(problem)], hz[[0, -1]], points=hz)
        assert [note for note in certificate.notes if "jumps between" in note and f"{first:,.6g} Hz" in note]


def test_a_table_that_damps_some_modes_only():
    """Undamped resonances in the band are integrated beside the axis; over all frequencies they are refused."""
    model = beam()
    omega = 2 * np.pi * np.array([300.0, 900.0, 1500.0])
    for table in ([[0, 0.02], [1200, 0.0]], [[0, 0.0], [1200, 0.02]]):
        with Problem(model, ends(model), damping=Damping(modal_table=table)) as problem:
            H = full_response(problem, omega)
            for reducer in (
                Gramian(band_hz=[50.0, 2600.0], order=30),
                BalancedTruncation(order=26, band_hz=[50.0, 2600.0]),
            ):
                body = reducer.reduce(problem)
                assert off(reduced_response(body, omega), H, problem) < 1e-3
                assert float(body.recipe.get("delta_1_per_s", body.recipe.get("delta", 0.0))) > 0
            with refusal("unsupported", "", "balanced-truncation", "band_hz"):
                BalancedTruncation(order=12).reduce(problem)


@pytest.mark.parametrize(
    "reducer", [BalancedTruncation(order=24), Irka(order=24, band_hz=[50.0, 2600.0], max_steps=5)], ids=repr
)
def test_methods_that_follow_poles_take_a_table(reducer):
    model = beam()
    interfaces = ends(model)[:1]
    with Problem(model, interfaces, damping=Damping(modal_table=TABLE)) as problem:
        _, M, values, phi = pencil(problem)
        true = dense_response(problem, OMEGA, modal_matrix(M, values, phi, table_ratio))
        assert off(reduced_response(reducer.reduce(problem), OMEGA), true, problem) < 1e-2


# Structural damping.

WITH = {
    "alone": Damping(structural=0.03),
    "rayleigh": Damping(structural=0.03, alpha=8.0, beta=3e-6),
    "table": Damping(structural=0.03, modal_table=TABLE),
}


def viscous(problem, damping):
    _, M, values, phi = pencil(problem)
    if damping.modal_table:
        return modal_matrix(M, values, phi, table_ratio)
    return damping.alpha * M + damping.beta * problem.K.toarray()


@pytest.mark.parametrize(("coupling", "name"), zip(["average", "rigid", "average"], WITH, strict=True))
def test_structural_damping_solves_the_dense_complex_equations(name, coupling):
    model, damping = beam((14, 2, 1)), WITH[name]
    omega = np.concatenate([[1e-3], OMEGA])
    with Problem(model, ends(model, coupling), damping=damping) as problem:
        true = dense_response(problem, OMEGA, viscous(problem, damping), 0.03)
        H = full_response(problem, omega)
        assert off(H[1:], true, problem) < 1e-6
        every = Modal(modes=problem.K.shape[0] - 6).reduce(problem)
        assert off(reduced_response(every, OMEGA), true, problem) < 1e-6
        reference = reference_model(problem, OMEGA, tolerance=1e-6)
        assert off(reference.response(OMEGA), true, problem) < 3 * reference.error < 3e-6
        # The error is seen as it is: the space does not grow to the whole model.
        assert len(reference.values) < (0.25 if name != "table" else 0.5) * problem.K.shape[0]
        if name != "table":
            assert off(direct_response(problem, OMEGA), true, problem) < 1e-8
            assert off(direct_response(problem, np.zeros(1)), H[:1], problem) < 1e-6
        assert off(reduced_response(every, np.zeros(1)), H[:1], problem) < 1e-6
        plain = replace(damping, structural=0.0)
    with Problem(model, ends(model, coupling), damping=plain) as problem:
        same = Modal(modes=problem.K.shape[0] - 6).reduce(problem)
        assert np.array_equal(same.D, every.D) and STRUCTURAL not in same.recipe


@pytest.mark.parametrize(("coupling", "name"), [("average", "alone"), ("rigid", "rayleigh")])
def test_the_bound_holds_with_structural_damping(name, coupling):
    model, damping = beam((8, 2, 1)), WITH[name]
    with Problem(model, ends(model, coupling), damping=damping) as problem:
        modes = problem.elastic_modes(below=(2 * np.pi * 3300.0) ** 2).frequencies_hz
        hz = np.unique(np.concatenate([np.linspace(30.0, 2600.0, 40), modes[modes < 2600]]))
        true = dense_response(problem, 2 * np.pi * hz, viscous(problem, damping), 0.03)
        bodies = [
            reducer.reduce(problem)
            for reducer in (
                Modal(modes=12),
                FreeInterface(modes=6),
                Krylov(shifts_hz=[0.0, 1500.0]),
                Gramian(band_hz=[30.0, 2600.0], order=18),
            )
        ]
        for body, certificate in zip(bodies, certify(problem, bodies, hz[[0, -1]], points=hz), strict=True):
            error = each(reduced_response(body, 2 * np.pi * hz), true, problem)
            assert certificate.bound_kind == "bound"
            # The dense solution itself is known to 1e-9.
            assert (certificate.bound + 1e-9 >= error).all()
            assert np.median(certificate.bound / np.maximum(error, 1e-9)) < 1.1
            assert np.abs(certificate.error - error).max() < 1e-8 * (1 + error.max()) ** 2
            # Statics are real in both.
            assert body.name != "free-interface" or certificate.static_error < 1e-8


def test_a_real_krylov_basis_matches_the_response_where_the_complex_frequency_is_the_shift():
    """A(s) = (1 + i eta) (K + f M) with f = s^2 / (1 + i eta) = -omega_0^2."""
    model, eta, w0 = beam(), 0.03, 2 * np.pi * 900.0
    with Problem(model, ends(model), damping=Damping(structural=eta)) as problem:
        body = Krylov(shifts_hz=[900.0]).reduce(problem)
        K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
        F = B - M @ problem.rigid @ (problem.rigid.T @ B)
    for s, matched in ((1j * w0 * np.sqrt(1 + 1j * eta), True), (1j * w0 * 1.3, False)):
        true = F.T @ np.linalg.solve((1 + 1j * eta) * K + s**2 * M, F)
        E = slice(6, None)
        A = (1 + 1j * eta) * body.K[E, E] + s**2 * body.M[E, E]
        error = np.abs(body.C[:, E] @ np.linalg.solve(A, body.B[E]) - true).max() / np.abs(true).max()
        assert error < 1e-9 if matched else error > 1e-6


@pytest.mark.parametrize(("direct", "name"), [(True, "alone"), (False, "rayleigh")])
def test_gramians_of_a_band_take_structural_damping(direct, name):
    model, band = beam(), [50.0, 2600.0]
    with Problem(model, ends(model), damping=WITH[name]) as problem:
        true = dense_response(problem, OMEGA, viscous(problem, WITH[name]), 0.03)
        reducer = Gramian(band_hz=band, order=26, direct=direct)
        body = reducer.reduce(problem)
        assert off(reduced_response(body, OMEGA), true, problem) < 1e-4
        assert body.recipe["delta_1_per_s"] == 0 and body.recipe[STRUCTURAL] == 0.03
        if not direct:
            balanced = BalancedTruncation(order=26, band_hz=band).reduce(problem)
            assert off(reduced_response(balanced, OMEGA), true, problem) < 1e-4 and "delta" not in balanced.recipe


@pytest.mark.parametrize("damping", [Damping(structural=0.02), Damping(modal_table=TABLE)], ids=["eta", "table"])
def test_auto_keeps_its_tolerance(damping):
    model = beam()
    with Problem(model, ends(model), damping=damping) as problem:
        body = AutoReducer(band_hz=[50.0, 2600.0], tolerance=1e-3, measure="pointwise").reduce(problem)
        true = dense_response(problem, OMEGA, viscous(problem, damping), damping.structural)
        assert off(reduced_response(body, OMEGA), true, problem) <= 1e-3
        assert body.order < 60


def test_what_structural_damping_has_not_is_refused():
    model = beam((4, 1, 1))
    with Problem(model, ends(model), damping=Damping(structural=0.02, alpha=1.0)) as problem:
        with refusal("unsupported", "", "band_hz"):
            BalancedTruncation(order=6).reduce(problem)
        with refusal("unsupported", "", '"irka"', '"gramian"', '"krylov"'):
            Irka(order=4, band_hz=[0.0, 1000.0]).reduce(problem)
    with refusal("conflict", "damping"):
        Problem(replace(model, D=1e-6 * model.K), ends(model), damping=Damping(structural=0.02))


def test_a_body_says_that_the_time_domain_cannot_hold_its_structural_damping(tmp_path):
    model = beam((4, 1, 1))
    for damping, noted in ((Damping(structural=0.02), True), (Damping(modal=0.02), False)):
        with Problem(model, ends(model), damping=damping) as problem:
            body = elastic_body(problem, Modal(modes=3).reduce(problem), make_part(problem))
        write_body(tmp_path / "body.h5", [body])
        stored = read_body(tmp_path / "body.h5").bodies["modal"]
        words = frequency_domain_only(stored.recipe)
        assert bool(words) == noted and ("0.02" in words) == noted
        assert (np.abs(stored.damping_matrix).max() == 0) == noted


# Damping matrices of the model's own.


def test_a_damping_matrix_of_the_model_is_projected():
    model = beam()
    rows = [model.dofs.of_nodes(where(model, 0, x)[:1])[0][2] for x in (0.0, 0.5)]
    v = sp.csr_array((np.array([1.0, -1.0]), (rows, [0, 0])), shape=(model.size, 1))
    D = sp.csr_array(300.0 * (v @ v.T) + 2e-6 * model.K)
    for extra in (Damping(), Damping(alpha=6.0, beta=1e-6)):
        with Problem(replace(model, D=D), ends(model), damping=extra) as problem:
            for reducer in (Modal(modes=9), REDUCERS["craig-bampton"](modes=9), FreeInterface(modes=9)):
                body = reducer.reduce(problem)
                Z = np.linalg.lstsq(body.V, problem.rigid, rcond=None)[0]
                own = body.V.T @ problem.D @ body.V
                MZ = body.M @ Z
                own += extra.alpha * (body.M - MZ @ MZ.T) + extra.beta * body.K
                assert np.abs(body.D - own).max() < 1e-9 * np.abs(own).max()
                # Neither a damper between two points nor Rayleigh damping acts on translations.
                still = Z @ np.linalg.lstsq(problem.rigid, problem.coupling.R[:, :3], rcond=None)[0]
                assert np.abs(body.D @ still).max() < 1e-8 * np.abs(own).max()


def test_rayleigh_damping_beside_a_matrix_counts_in_the_response_of_small_models():
    model, extra = beam((4, 1, 1)), Damping(alpha=6.0, beta=1e-5)
    with Problem(replace(model, D=sp.csr_array(2e-5 * model.K)), ends(model), damping=extra) as problem:
        D = problem.D.toarray() + extra.alpha * problem.M.toarray() + extra.beta * problem.K.toarray()
        assert off(full_response(problem, OMEGA), dense_response(problem, OMEGA, D), problem) < 1e-8
    with (
        Problem(replace(model, D=sp.csr_array(2e-5 * model.K)), ends(model), damping=Damping(modal=0.1)) as problem,
        refusal("unsupported", "damping"),
    ):
        full_response(problem, OMEGA)


# Jobs.


@pytest.mark.parametrize("units", ["mm-t-s", "m-kg-ms"])
def test_a_table_of_a_job_is_in_hz_whatever_the_unit_of_time(tmp_path, units):
    def given(text):
        model = f'mesh = "part.inp"\nunits = "{units}"'
        return damping_of(load_job(folder(tmp_path, {"model": model, "damping": text})))

    assert given('modal = "adams"') == Damping(modal_table=NAMED["adams"])
    assert given("modal = [[0, 0.01], [50.5, 1]]\nstructural = 0.1") == Damping(
        modal_table=[[0.0, 0.01], [50.5, 1.0]], structural=0.1
    )
    assert given("modal = 1") == Damping(modal=1.0)
    assert given("structural = 0.02") == Damping(structural=0.02)
    time = 1e-3 if units == "m-kg-ms" else 1.0
    both = given("rayleigh = { alpha = 2.0, beta = 3.0 }\nstructural = 0.02")
    assert both == Damping(alpha=2.0 / time, beta=3.0 * time, structural=0.02)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('modal = "adam"', ["[damping]: modal", "'adam'", "did you mean 'adams'?"]),
        ("modal = [[0, 0.1], [200, 0.1], [100, 0.2]]", ["100 Hz after 200 Hz", "ascending"]),
        ("modal = [[0, -0.1]]", ["ratio -0.1 at 0 Hz"]),
        ("modal = [[0, 5]]", ["ratio 5 at 0 Hz", "0.02 for 2 percent"]),
        ("modal = [[100, 0.1]]", ["begins at 100 Hz"]),
        ("modal = []", ["expected points"]),
        ("modal = [[0, 0.1, 3]]", ["expected points"]),
        ('modal = [[0, "0.1"]]', ["modal = [[0, '0.1']]", "adams"]),
        ("modal = 5.0", ["modal = 5.0", "0.02 for 2 percent"]),
        ("modal = true", ["modal = true", "adams"]),
        ("modal = { values = [0.1] }", ["modal", "adams"]),
        ("structural = -0.1", ["structural = -0.1", "loss factor"]),
        ('modal = "adams"\nrayleigh = { alpha = 1.0 }', ["rayleigh and modal", "choose one"]),
    ],
)
def test_wrong_damping_of_a_job_gives_one_message(tmp_path, text, words):
    message = refused(folder(tmp_path, {"damping": text}))
    assert all(word in message for word in words), message
