"""Certificates over whole bands: bodies of every method and from files, undamped models, round-off, bad input."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from benchmarks import certificates as campaign
from morembs.app.jobs.job import load_job
from morembs.base.errors import InputError, SolverError
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.certificate.certify import certify
from morembs.certificate.limits import error_limits, merge_cells
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, BalancedTruncation, CraigBampton, FreeInterface, Modal
from morembs.reducers.automatic import unreachable
from morembs.responses.certified import certified_reference
from morembs.responses.direct import direct_response
from morembs.responses.measures import Limit
from tests.support.exact_responses import Truth, envelope, norms, response_of
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

DAMPED = Damping(alpha=2.0, beta=4e-7)


def beam(n=(6, 1, 1), kind="hex20"):
    return steel(box(kind, n, (0.5, 0.05, 0.03)))


def ends(model, coupling="average"):
    return [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling=coupling)
        for name, x in (("left", 0.0), ("right", 0.5))
    ]


@pytest.mark.parametrize(("seed", "number"), [(1, 0), (1, 3), (1, 6), (1, 11), (9, 0)])
def test_random_bodies_against_dense_solutions(seed, number):
    """A short form of benchmarks/certificates.py; of soft free twins round-off turns modes towards rigid motion."""
    for verdict in campaign.trial(seed, number):
        assert not verdict.above, verdict.words
        # A dense grid may miss the largest value, which the certificate then names.
        assert (verdict.effectivity[verdict.clear] >= 1).all(), verdict.words
        assert (verdict.gap[verdict.clear] < 1.15).all(), verdict.words


@pytest.mark.parametrize("damping", [DAMPED, Damping(), Damping(structural=1e-4)])
def test_the_reference_is_known_to_its_uncertainty(damping):
    """Against solutions in extended precision, on and beside resonances, with references of all qualities."""
    model = beam()
    with Problem(model, ends(model, "rigid"), damping=damping) as problem:
        band = [50.0, 3500.0]
        modes = problem.elastic_modes(count=10).eigenvalues
        omega = np.sqrt(modes[modes < (2 * np.pi * band[1]) ** 2])
        omega = np.concatenate([2 * np.pi * np.linspace(*band, 9), omega, omega * (1 + 1e-4)])
        H = Truth(problem)(omega)
        for tolerance in (1e-2, 1e-6, 1e-9):
            reference = certified_reference(problem, band, tolerance=tolerance)
            off = norms(reference.H(omega) - H)
            assert (off <= reference.uncertainty(omega)).all() and reference.proven
            assert (reference.error_bounds <= tolerance).all()


def test_a_changed_body_has_a_larger_limit():
    """One residue off by 1e-3, one pole by 1e-4, another model: limits rise to the true errors."""
    model = beam()
    with Problem(model, ends(model), damping=DAMPED) as problem:
        sound = FreeInterface(modes=8).reduce(problem)
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        B, K = sound.B.copy(), sound.K.copy()
        B[7] *= 1.001
        K[8, 8] *= 1.0001
        other = Problem(steel(box("hex20", (6, 1, 1), (0.5, 0.05, 0.031))), ends(model), damping=DAMPED)
        with other:
            foreign = FreeInterface(modes=8).reduce(other)
        wrong = [replace(sound, B=B, C=B.T), replace(sound, K=K), replace(foreign, name="foreign")]
        (before, *after) = certify(problem, [sound, *wrong], [50.0, 3000.0])
        for body, certificate in zip(wrong, after, strict=True):
            assert certificate.limit.lower > 2 * before.limit.upper
            w = 2 * np.pi * np.array([certificate.limits["pointwise"].at_hz])
            A = [(1 + 1j * w[0] * 4e-7) * body.K + 1j * w[0] * (body.D - 4e-7 * body.K) - w[0] ** 2 * body.M]
            H = (body.C[:, 6:] @ np.linalg.solve(A[0][6:, 6:], body.B[6:])) * scale
            full = Truth(problem)(w)[0]
            error = np.linalg.norm(H - full) / np.linalg.norm(full)
            assert certificate.limits["pointwise"].lower * (1 - 1e-6) <= error <= certificate.limits["pointwise"].upper


def test_bodies_that_are_no_projections_and_bodies_of_files(tmp_path):
    """Separate bases of positions and velocities, and what was read back, are certified as others are."""
    model = beam()
    with Problem(model, ends(model), damping=DAMPED) as problem:
        band = [50.0, 3000.0]
        bodies = [
            FreeInterface(modes=8).reduce(problem, "free"),
            BalancedTruncation(band_hz=band, order=24, variant="pv").reduce(problem, "pv"),
        ]
        certificates = certify(problem, bodies, band)
        assert [certificate.kind for certificate in certificates] == ["proven", "proven"]
        assert certificates[1].limit.upper < 1
        part = make_part(problem)
        write_body(
            tmp_path / "two.h5",
            [
                elastic_body(problem, body, part, certificate)
                for body, certificate in zip(bodies, certificates, strict=True)
            ],
        )
        stored = read_body(tmp_path / "two.h5").bodies
        for body, certificate in zip(bodies, certificates, strict=True):
            again = error_limits(certified_reference(problem, band), stored[body.name].reduced)
            for name, limit in certificate.limits.items():
                assert again.limits[name].upper == pytest.approx(limit.upper, rel=1e-6)
        few = replace(bodies[0], B=bodies[0].B[:, :3], C=bodies[0].C[:3])
        with refusal("conflict", "interfaces", "12"):
            error_limits(certified_reference(problem, band), few)


def test_undamped_bodies_with_good_poles_serve():
    """Frequencies to 0.02 % and MAC 1: with 1 % the envelope is off by about 0.0002 / 0.01."""
    model = beam()
    with Problem(model, ends(model)) as problem:
        band = [0.0, 3000.0]
        sound = FreeInterface(modes=12).reduce(problem)
        body = replace(sound, K=sound.K * 1.0004)
        (certificate,) = certify(problem, [body], band)
        assert certificate.damping_floor == 0.01 and certificate.mode_mac.min() > 1 - 1e-9
        assert certificate.mode_deviation.max() == pytest.approx(2e-4, rel=1e-3)
        assert 0.015 < certificate.limit.lower <= certificate.limit.upper < 0.03
        (bare,) = certify(problem, [body], band, damping_floor=0.0)
        assert all(limit.upper == np.inf for limit in bare.limits.values()) and np.isinf(bare.cell_limit).all()
        assert bare.mode_deviation == pytest.approx(certificate.mode_deviation)
        assert [note for note in bare.notes if "undamped resonance at" in note]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("floor", [None, 0.0])
def test_samples_and_ends_on_an_undamped_resonance(floor):
    model = beam()
    with Problem(model, ends(model)) as problem:
        first = float(problem.elastic_modes(count=1).frequencies_hz[0])
        body = FreeInterface(modes=6).reduce(problem)
        for band in ([0.0, 2 * first], [0.5 * first, first]):
            (certificate,) = certify(problem, [body], band, points=41, damping_floor=floor)
            assert np.isfinite(certificate.error).all() and certificate.frequencies_hz[0] >= band[0]
            assert np.isfinite(certificate.limit.upper) == (floor is None)
        for tolerance in (1e-1, 1e-2, 1e-3, 1e-4) if floor is None else ():
            reduced = AutoReducer(band_hz=[0.0, 2 * first], tolerance=tolerance).reduce(problem)
            assert reduced.recipe["certified"] <= tolerance


def test_frequencies_of_the_full_model_are_enclosed():
    model = beam((5, 1, 1))
    with Problem(model, ends(model, "rigid")) as problem:
        values = sl.eigh(problem.K.toarray(), problem.M.toarray(), eigvals_only=True)[6:]
        (certificate,) = certify(problem, [Modal(modes=4).reduce(problem)], [10.0, 4000.0])
        true = np.sqrt(values[: len(certificate.mode_frequencies_hz)]) / (2 * np.pi)
        low, high = certificate.mode_enclosure_hz.T
        assert (low * (1 - 1e-9) <= true).all() and (true <= high * (1 + 1e-9)).all()
        assert (high - low < 1e-6 * true).all()


def test_modes_that_no_load_excites_are_there_and_not_missing():
    """Only axial motion is asked for: bending modes count in the reference and are no fault of a body."""
    model = beam()
    faces = [
        make_interface(model, name=str(x), nodes=where(model, 0, x), coupling="average", components=[0])
        for x in (0.0, 0.5)
    ]
    with Problem(model, faces, damping=DAMPED) as problem:
        hz = problem.elastic_modes(count=14).frequencies_hz
        body = AutoReducer(band_hz=[0.0, float(hz[-1])], tolerance=1e-3).reduce(problem)
        (certificate,) = certify(problem, [body], [0.0, float(hz[-1])])
        assert certificate.limit.upper <= 1e-3 and (certificate.mode_mac < 0.5).sum() > 5
        assert np.isnan(certificate.residue_deviation[certificate.mode_mac < 0.5]).all()
        assert not [note for note in certificate.notes if "are not in this body" in note]


def test_limits_with_a_damping_matrix_of_the_models_own_are_proven():
    """Poles that couple the modes: three dampers and stiffness damping."""
    model = beam()
    D = sp.lil_array(model.K * 1e-6)
    for dof in (4, 50, 90):
        D[dof, dof] += 50.0
    with Problem(replace(model, D=sp.csr_array(D)), ends(model)) as problem:
        body = FreeInterface(modes=6).reduce(problem)
        (certificate,) = certify(problem, [body], [50.0, 3000.0], points=12)
        omega = 2 * np.pi * certificate.frequencies_hz
        H = direct_response(problem, omega) * np.outer(problem.motion_scale, problem.motion_scale)
        assert certificate.kind == "proven" and certificate.limit.upper < np.inf
        reference = certified_reference(problem, [50.0, 3000.0])
        assert norms(reference.H(omega) - H).max() < 1e-6 * norms(H).max()
        assert (certificate.error <= certificate.limits["pointwise"].upper).all()


@pytest.mark.parametrize("damping", [DAMPED, Damping(modal=0.01), Damping(structural=0.02)])
@pytest.mark.parametrize("sharpness", [1.01, 1.05])
def test_limits_are_as_sharp_as_was_asked_for(damping, sharpness):
    model = beam()
    with Problem(model, ends(model, "rigid"), damping=damping) as problem:
        bodies = [CraigBampton(modes=6).reduce(problem), FreeInterface(modes=8).reduce(problem)]
        for certificate in certify(problem, bodies, [0.0, 3000.0], sharpness=sharpness, points=5):
            for limit in certificate.limits.values():
                assert limit.lower <= limit.upper <= sharpness * limit.lower


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"measure": "max"}, ("value", "measure", "max", "envelope", "peak", "pointwise")),
        ({"damping_floor": -0.1}, ("value", "damping_floor", "-0.1")),
        ({"damping_floor": 1.0}, ("value", "damping_floor", "1.0")),
        ({"damping_floor": float("nan")}, ("value", "damping_floor")),
        ({"sharpness": 1.0}, ("value", "sharpness", "1.0", "1.01")),
        ({"sharpness": 3.0}, ("value", "sharpness", "3.0")),
    ],
)
def test_options_that_are_none(options, message):
    model = beam((2, 1, 1))
    with Problem(model, ends(model)) as problem, refusal(*message):
        certify(problem, [], [10.0, 100.0], **options)
    if "sharpness" not in options:
        with refusal(*message):
            AutoReducer(band_hz=[10.0, 100.0], tolerance=1e-3, **options)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('measure = "max"', ("value", "measure", "envelope", "peak", "pointwise")),
        ("damping_floor = -0.1", ("value", "damping_floor", "0.01")),
        ("sharpness = 1.0", ("value", "sharpness", "1.01")),
        ("band_hz = [0, 1e-300]", ("value", "band_hz", "1e-300", "HIGH", "1e-09")),
        ("band_hz = [10, 5]", ("value", "band_hz", "10", "5", "HIGH")),
    ],
)
def test_keys_of_a_job_that_are_wrong(tmp_path, line, message):
    path = tmp_path / "job.toml"
    band = "" if line.startswith("band_hz") else "band_hz = [0, 10]\n"
    path.write_text(
        '[model]\nmesh = "m.msh"\n[[material]]\nyoung = 1.0\npoisson = 0.3\ndensity = 1.0\n[[reduce]]\n'
        f'method = "guyan"\n[output]\npath = "o.h5"\n[certify]\n{band}{line}\n'
    )
    with refusal(*message):
        load_job(path)


@pytest.mark.parametrize("damping", [DAMPED, Damping()])
def test_a_band_far_below_the_first_mode_has_sharp_limits(damping):
    """What the small eigenproblem leaves counts beside the stiffness of modes, not beside the end of the band."""
    model, band = beam((3, 1, 1)), [0.0, 0.01]
    with Problem(model, ends(model), damping=damping) as problem:
        body = AutoReducer(band_hz=band, tolerance=1e-6).reduce(problem)
        assert body.recipe["certified"] <= 1e-6
        for reduced in (body, Modal(modes=3).reduce(problem)):
            (certificate,) = certify(problem, [reduced], band)
            H = Truth(problem)(2 * np.pi * np.array(band))
            true = (
                norms(response_of(reduced, 2 * np.pi * np.array(band)) * np.outer(*[problem.motion_scale] * 2) - H)
                / envelope(problem, 2 * np.pi * np.array(band))
            ).max()
            limit = certificate.limit
            assert true <= limit.upper + 1e-9 and limit.upper <= max(1.06 * limit.lower, 1e-8)


def test_tolerances_that_no_body_keeps():
    model = beam()
    with Problem(model, ends(model)) as problem:
        with refusal("unsupported", "damping"):
            AutoReducer(band_hz=[0.0, 3000.0], tolerance=1e-3, damping_floor=0.0).reduce(problem)
        with refusal("result", "tolerance", "1e-14", by=SolverError):
            AutoReducer(band_hz=[0.0, 3000.0], tolerance=1e-14).reduce(problem)
    tip = make_interface(model, name="tip", nodes=where(model, 0, 0.5)[:1], coupling="direct", components=[1])
    words = ("result", "tolerance", "0.003", "pointwise", '"envelope"')
    with Problem(model, [tip], damping=Damping(structural=1e-7)) as problem, refusal(*words):
        AutoReducer(band_hz=[0.0, 3000.0], tolerance=3e-3, measure="pointwise").reduce(problem)


def test_a_tolerance_that_no_certificate_keeps_is_not_told_a_larger_error():
    wanted = AutoReducer(band_hz=[0.0, 300.0], tolerance=1e-7)
    for least, words in ((3e-6, "the smallest error found is 3.0e-06"), (8e-15, "keeps their certificate above it")):
        error = unreachable(wanted, SimpleNamespace(worst=Limit(lower=least, upper=least, at_hz=10.0)))
        assert words in str(error)


def test_a_tolerance_that_is_refused_for_round_off_names_one_that_will_do():
    model = beam((2, 1, 1), "hex8")
    # A bar along z between two nodes, far stiffer than what it joins.
    K = model.K.toarray()
    K[np.ix_([2, 5], [2, 5])] += 1e8 * K.max() * np.array([[1, -1], [-1, 1]])
    with Problem(replace(model, K=sp.csr_array(K)), ends(model)[:1]) as problem:
        with refusal("result", "tolerance", by=SolverError) as refused:
            AutoReducer(band_hz=[0.0, 1000.0], tolerance=1e-9).reduce(problem)
        named = float(re.search(r"raise the tolerance to (\S+) or more", str(refused.value))[1])
        body = AutoReducer(band_hz=[0.0, 1000.0], tolerance=named).reduce(problem)
        assert 1e-9 < body.recipe["certified"] <= named < 0.1


def test_curves_stand_at_the_frequencies_that_are_chosen():
    model = beam((2, 1, 1))
    with Problem(model, ends(model), damping=DAMPED) as problem:
        body = Modal(modes=4).reduce(problem)
        hz = np.linspace(20.0, 700.0, 5)
        (certificate,) = certify(problem, [body], [10.0, 800.0], points=hz)
        assert np.array_equal(certificate.frequencies_hz, hz) and certificate.band_hz == (10.0, 800.0)
        (counted,) = certify(problem, [body], [10.0, 800.0], points=5)
        assert counted.limit == certificate.limit and len(counted.frequencies_hz) > 5
        for wrong in ([], [900.0], [5.0, 20.0], [30.0, 20.0], [[20.0], [30.0]]):
            with pytest.raises(InputError) as refused:
                certify(problem, [body], [10.0, 800.0], points=wrong)
            assert refused.value.keyword == "points"
        with pytest.raises(InputError) as refused:
            certify(problem, [body], hz)
        assert refused.value.keyword == "band_hz"


def test_infinite_limits_beside_finite_ones_are_stored_in_as_many_cells_as_others():
    """20,001 cells whose limits take turns: the larger ones hold on what is stored, which covers the band."""
    edges = np.linspace(0.0, 1.0, 20_002)
    cells, upper = np.stack([edges[:-1], edges[1:]], axis=1), np.full((20_001, 3), 1e-3)
    upper[::2] = np.inf
    hz, limits = merge_cells(cells, upper)
    assert len(hz) <= 5000 and hz[0, 0] == 0.0 and hz[-1, 1] == 1.0 and (hz[1:, 0] == hz[:-1, 1]).all()
    assert np.isinf(limits).all()
