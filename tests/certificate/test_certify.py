"""Certificates against dense and sparse direct solutions of the full equations, refined in extended precision."""

import dataclasses
import importlib
import sys
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import InputError, SolverError
from morembs.base.units import parse_units
from morembs.certificate.certify import certify
from morembs.certificate.record import Certificate
from morembs.fem import DofMap, FEModel
from morembs.fem.interface import make_interface
from morembs.importers import read_mesh
from morembs.linalg.eigen import Modes
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, CraigBampton, FreeInterface, Guyan, Modal
from morembs.responses.band import band_frequencies
from tests.support.exact_responses import Truth, envelope, norms, pencil, response_of
from tests.support.meshes import box, merged, points_and_cells, steel, where
from tests.support.refusals import refusal

EPS = np.finfo(float).eps
# What the full response is known to, as part of its envelope.
REFERENCE = 1e-9
ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared" / "data"
SMALL = ROOT / "data" / "small_meshes"
COSTLY = 5000
DAMPINGS = {"undamped": Damping(), "rayleigh": Damping(alpha=5.0, beta=2e-6)}


def show(*words):
    """Figures for pytest -s."""
    sys.stdout.write(" ".join(map(str, words)) + "\n")


def errors_of(reduced, omega, H, scale):
    return norms(response_of(reduced, omega) * scale - H) / norms(H)


def round_off(problem, omega, values):
    """(nf,) what the round-off of the entries of K does to H, relatively, beside resonances at ``values``."""
    highest = 2 * (problem.K.diagonal() / problem.M.diagonal()).max()
    width = problem.damping.alpha + problem.damping.beta * values
    away = np.abs(values[:, None] + 1j * omega * width[:, None] - omega**2).min(axis=0)
    return 5 * EPS * highest / away


# Bodies.


def beam(n=(5, 1, 1), size=(0.5, 0.05, 0.03), kind="hex20"):
    return steel(box(kind, n, size))


def pair(model, coupling, axis=0, **options):
    low, high = (float(f(model.nodes.xyz[:, axis])) for f in (np.min, np.max))
    return [
        make_interface(model, name=name, nodes=where(model, axis, x), coupling=coupling, **options)
        for name, x in (("left", low), ("right", high))
    ]


def ends(coupling, **options):
    model = beam(**options)
    return model, pair(model, coupling)


def direct():
    model = beam()
    return model, [
        make_interface(model, name=name, nodes=where(model, 0, x)[:3], coupling="direct")
        for name, x in (("left", 0.0), ("right", 0.5))
    ]


def one_interface():
    model = beam()
    return model, pair(model, "rigid")[1:]


def held():
    """A bar clamped at one end, as matrices."""
    free = beam()
    keep = np.setdiff1d(np.arange(free.size), free.dofs.of_nodes(where(free, 0, 0.0)).ravel())
    model = FEModel(
        K=free.K[keep][:, keep],
        M=free.M[keep][:, keep],
        nodes=free.nodes,
        dofs=DofMap(node=free.dofs.node[keep], component=free.dofs.component[keep]),
    )
    return model, [make_interface(model, name="tip", nodes=where(free, 0, 0.5), coupling="average")]


def disc():
    """Two-fold eigenvalues: a square drawn out to a circle, held at its middle and at a patch on its rim."""

    def drawn(p):
        x, y = p[..., 0] * 2 - 1, p[..., 1] * 2 - 1
        return 0.1 * np.stack([x * np.sqrt(1 - y**2 / 2), y * np.sqrt(1 - x**2 / 2), 0.2 * p[..., 2]], axis=-1)

    model = steel(box("hex8", (4, 4, 1), (1.0, 1.0, 1.0), warp=drawn))
    away = np.linalg.norm(model.nodes.xyz[:, :2], axis=1)
    rim = np.flatnonzero((away > 0.099) & (model.nodes.xyz[:, 0] > 0.06))
    return model, [
        make_interface(model, name="hub", nodes=np.flatnonzero(away < 0.06), coupling="average"),
        make_interface(model, name="rim", nodes=rim, coupling="average"),
    ]


def angle():
    """An L of hexahedra."""
    cells = [(i, 0, 0) for i in range(3)] + [(0, j, 0) for j in (1, 2)]
    model = steel(merged("hex20", points_and_cells("hex20", cells) * [0.05, 0.04, 0.03]))
    xyz = model.nodes.xyz
    return model, [
        make_interface(model, name="a", nodes=np.flatnonzero(xyz[:, 0] > 0.149), coupling="rigid"),
        make_interface(model, name="b", nodes=np.flatnonzero(xyz[:, 1] > 0.119), coupling="average"),
    ]


def small(name, coupling, first="ROOT", second="TIP", units="mm-t-s"):
    def make():
        model = steel(read_mesh(SMALL / name, parse_units(units)))
        return model, [
            make_interface(model, name=s, nodes=model.nodes.sets[s], coupling=coupling) for s in (first, second)
        ]

    return make


def foreign(name, axis, units="m-kg-s"):
    def make():
        if not (SHARED / name).is_file():
            pytest.skip(f"{name} is not here")
        model = steel(read_mesh(SHARED / name, parse_units(units)))
        along = model.nodes.xyz[:, axis]
        edge = 0.02 * np.ptp(along)
        rows = {"low": along < along.min() + edge, "high": along > along.max() - edge}
        return model, [
            make_interface(model, name=end, nodes=np.flatnonzero(on), coupling="average") for end, on in rows.items()
        ]

    return make


BODIES = {
    "beam rigid": lambda: ends("rigid"),
    "beam average": lambda: ends("average", n=(6, 1, 1)),
    "beam direct": direct,
    "beam stubby": lambda: ends("rigid", n=(3, 2, 1), size=(0.2, 0.1, 0.05)),
    "square beam": lambda: ends("rigid", n=(5, 1, 1), size=(0.4, 0.04, 0.04)),
    "one interface": one_interface,
    "held": held,
    "disc": disc,
    "angle": angle,
    "thick plate": lambda: ends("average", n=(4, 3, 1), size=(0.4, 0.3, 0.03)),
    "block rigid": small("block.msh", "rigid"),
    "wedge": small("wedge.msh", "average"),
    "rotor": foreign("ansys_rotor/rotorDiscTest.inp", 2),
}
LARGE = {
    "bracket": small("bracket.msh", "rigid", "FOOT", "TIP"),
    "abaqus block": foreign("abaqus_block/blockC3D8.inp", 0),
    "plate": small("plate.msh", "average", "LEFT", "RIGHT"),
    "wheelset": foreign("wheelset/wheelset.vtk", 0),
}


# Reduction methods; those of modules that are not here are left out.


def _optional(module, name):
    try:
        return getattr(importlib.import_module(f"morembs.reducers.{module}"), name)
    except (ImportError, AttributeError):
        return None


def methods():
    """Name -> reducer for a band (low, high) in Hz and m interface degrees of freedom."""
    reducers = {
        "modal": lambda low, high, m: Modal(modes=10),
        "guyan": lambda low, high, m: Guyan(),
        "craig-bampton": lambda low, high, m: CraigBampton(modes=10),
        "craig-bampton inertia": lambda low, high, m: CraigBampton(modes=m + 4, inertia_modes=True),
        "free-interface": lambda low, high, m: FreeInterface(modes=8),
        "auto": lambda low, high, m: AutoReducer(band_hz=[low, high], tolerance=1e-4),
    }
    Krylov, Gramian, BalancedTruncation = (
        _optional("krylov", "Krylov"),
        _optional("gramian", "Gramian"),
        _optional("balanced", "BalancedTruncation"),
    )
    if Krylov:
        reducers["krylov"] = lambda low, high, m: Krylov(shifts_hz=[0.0, 0.9 * high])
        reducers["krylov cut"] = lambda low, high, m: Krylov(shifts_hz=[0.0, 0.9 * high], moments=2, order=20)
        reducers["krylov two-sided"] = lambda low, high, m: Krylov(
            shifts_hz=[0.0, 0.9 * high], two_sided=True, inputs=["left"], outputs=["right"]
        )
    if Gramian:
        reducers["gramian"] = lambda low, high, m: Gramian(band_hz=[low, high], order=20)
    if BalancedTruncation:
        known = {field.name for field in fields(BalancedTruncation)}
        reducers["balanced"] = lambda low, high, m: BalancedTruncation(
            **{k: v for k, v in {"band_hz": [low, high], "order": 14}.items() if k in known}
        )
    return reducers


METHODS = methods()
# Not symmetric: stable with some damping only.
TWO_SIDED = "krylov two-sided"


@dataclass
class Case:
    """A body with certificates of all methods; ``errors`` are those against the direct solutions."""

    omega: Any
    full: Any
    unknown: Any
    floor: Any
    outcomes: dict[str, tuple[Certificate, Any] | Exception]


def band_of(problem):
    """A band that holds the first four modes and begins at a tenth of the first."""
    known = problem.elastic_modes(count=12).frequencies_hz
    # Its end lies in a gap, not in a cluster.
    last = next(k for k in range(3, 11) if known[k + 1] > 1.02 * known[k])
    return 0.1 * float(known[0]), float(0.3 * known[last] + 0.7 * known[last + 1])


def case(name, damping):
    outcome = _case(name, damping)
    if isinstance(outcome, BaseException):
        raise outcome
    return outcome


@cache
def _case(name, damping):
    try:
        return _computed(name, damping)
    except (Exception, pytest.skip.Exception) as error:
        return error


def _computed(name, damping):
    model, interfaces = BODIES[name]()
    with Problem(model, interfaces, damping=DAMPINGS[damping]) as problem:
        low, high = band_of(problem)
        hz = band_frequencies(problem, [low, high], points=8)
        outcomes, reduced = {}, {}
        for method in METHODS:
            if (name, damping, method) not in CASES:
                continue
            try:
                reduced[method] = METHODS[method](low, high, problem.B.shape[1]).reduce(problem, name=method)
            except Exception as error:
                outcomes[method] = error
        omega = 2 * np.pi * hz
        H = Truth(problem)(omega)
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        for body, certificate in zip(
            reduced.values(), certify(problem, list(reduced.values()), hz[[0, -1]], points=hz), strict=True
        ):
            outcomes[body.name] = (certificate, errors_of(body, omega, H, scale))
        floor = round_off(problem, omega, problem.elastic_modes(count=6).eigenvalues)
        return Case(omega, norms(H), REFERENCE * envelope(problem, omega) / norms(H), floor, outcomes)


def certified(name, damping, method):
    known = case(name, damping)
    outcome = known.outcomes[method]
    if isinstance(outcome, SolverError) and method == TWO_SIDED and "unstable" in str(outcome):
        pytest.skip(str(outcome))
    if isinstance(outcome, Exception):
        raise outcome
    return known, *outcome


# The first body with both dampings and all methods, each other with one damping and every third method.
CASES = [
    (name, damping, method)
    for i, name in enumerate(BODIES)
    for j, damping in enumerate(DAMPINGS)
    for k, method in enumerate(METHODS)
    if (i < 1 or (i % 2 == j and ((i // 2 + k) % 3 == 0 or method == TWO_SIDED)))
    and (method != TWO_SIDED or (damping != "undamped" and name.split()[0] in ("beam", "square", "thick")))
]


@pytest.mark.parametrize(("name", "damping", "method"), CASES)
def test_the_bound_holds_and_is_sharp(name, damping, method):
    known, certificate, error = certified(name, damping, method)
    floor = known.floor
    assert certificate.bound_kind == "bound"
    # What is not known of the full response counts where a response is small beside its modes.
    seen = error > 100 * floor + 20 * known.unknown
    hz = known.omega / (2 * np.pi)
    cell = np.clip(np.searchsorted(certificate.cells_hz[:, 0], hz, side="right") - 1, 0, None)
    limit = certificate.cell_limit[cell, 2]
    over = (certificate.bound[seen] / error[seen]).max(initial=0)
    show(
        f"{name:14s} {damping:9s} {method:22s} error {error.max():.1e} limit {limit.max():.1e} "
        f"over it {over:.2f} round-off {floor.max():.0e}"
    )
    # What is proven holds without any allowance.
    assert (error <= certificate.bound).all() and (error <= limit).all()
    assert (certificate.error <= certificate.bound).all()
    assert (certificate.bound[seen] < 1.1 * error[seen]).all()
    assert (certificate.reference_error <= known.unknown + 100 * floor).all()
    assert np.abs(certificate.full / known.full - 1).max() < 1e-7 + floor.max()
    assert (np.abs(certificate.error - error) <= 10 * REFERENCE + floor * (1 + error) ** 2).all()
    assert error.max() <= certificate.limits["pointwise"].upper


@pytest.mark.parametrize("name", LARGE)
def test_the_bound_holds_where_modes_are_counted(name):
    """Models of thousands of dofs: their modes come from Lanczos iterations and a Sturm count."""
    model, interfaces = LARGE[name]()
    with Problem(model, interfaces) as problem:
        low, high = band_of(problem)
        hz = np.array([low, 0.63 * high, high])
        omega = 2 * np.pi * hz
        # At the upper end errors are largest; solutions of the largest models are costly.
        seen = slice(None) if problem.K.shape[0] < COSTLY else slice(2, None)
        H = Truth(problem)(omega[seen])
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        bodies = [FreeInterface(modes=8).reduce(problem), CraigBampton(modes=8).reduce(problem)]
        floor = round_off(problem, omega, problem.elastic_modes(count=6).eigenvalues)
        for body, certificate in zip(bodies, certify(problem, bodies, hz[[0, -1]], points=hz), strict=True):
            error, bound = errors_of(body, omega[seen], H, scale), certificate.bound[seen]
            show(name, body.name, error, bound / error)
            assert (error <= bound * (1 + 1e-6) + floor[seen]).all()
            assert np.median(bound / error) < 1.1


def test_band_from_zero():
    """At 0 Hz all of K counts, and the error there is the static one."""
    model, interfaces = ends("average")
    with Problem(model, interfaces) as problem:
        hz = np.array([0.0, 1e-3, 1.0, 900.0])
        H = Truth(problem)(2 * np.pi * hz)
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        bodies = [Modal(modes=8).reduce(problem), FreeInterface(modes=2).reduce(problem)]
        modal, static = certify(problem, bodies, hz[[0, -1]], points=hz)
        for body, certificate in zip(bodies, (modal, static), strict=True):
            error = errors_of(body, 2 * np.pi * hz, H, scale)
            assert np.abs(certificate.error - error).max() < 1e-9
            assert (error <= certificate.bound * (1 + 1e-6) + 1e-11).all()
        assert modal.static_error == pytest.approx(modal.error[0], rel=1e-9) and modal.static_error > 0.01
        assert static.static_error < 1e-10
        wrong, full = response_of(bodies[0], np.zeros(1))[0] * scale - H[0], H[0]
        blocks = list(problem.coupling.columns.values())
        expected = [[np.linalg.norm(wrong[i, j]) / np.linalg.norm(full[i, j]) for j in blocks] for i in blocks]
        assert modal.static_block_error == pytest.approx(np.array(expected), rel=1e-7)
        assert static.static_block_error.max() < 1e-9


@pytest.mark.parametrize("shift", [1 - 1e-5, 1 + 1e-5, 1 + 1e-4])
def test_band_that_ends_at_an_eigenfrequency(shift):
    """Beside a double eigenvalue, and with an eigenvalue just at the limit up to which modes are known."""
    model, interfaces = BODIES["square beam"]()
    with Problem(model, interfaces) as problem:
        values, _ = pencil(problem)
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        bodies = [FreeInterface(modes=6).reduce(problem), CraigBampton(modes=8).reduce(problem)]
        for high in (values[3], values[3] / 1.25**2):
            hz = np.sqrt(high) / (2 * np.pi) * shift * np.array([0.3, 0.77, 1.0])
            omega = 2 * np.pi * hz
            H = Truth(problem)(omega)
            for body, certificate in zip(bodies, certify(problem, bodies, hz[[0, -1]], points=hz), strict=True):
                error = errors_of(body, omega, H, scale)
                floor = round_off(problem, omega, values)
                assert (error <= certificate.bound * (1 + 1e-6) + floor * (1 + error) ** 2).all()
                assert np.isfinite(certificate.bound).all()


def test_modes_that_no_interface_excites():
    """Only axial motion of a symmetric beam is asked for: most modes do not answer, the certificate does."""
    model = beam(n=(4, 2, 2))
    interfaces = pair(model, "average", components=[0])
    with Problem(model, interfaces) as problem:
        modes = problem.elastic_modes(count=14)
        hz = band_frequencies(problem, [10.0, 1.02 * modes.frequencies_hz[-1]], points=4)[::2]
        bodies = [FreeInterface(modes=9).reduce(problem), Modal(modes=14).reduce(problem)]
        omega = 2 * np.pi * hz
        H = Truth(problem)(omega)
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        for body, certificate in zip(bodies, certify(problem, bodies, hz[[0, -1]], points=hz), strict=True):
            error = errors_of(body, omega, H, scale)
            floor = round_off(problem, omega, modes.eigenvalues)
            assert (error <= certificate.bound * (1 + 1e-6) + floor * (1 + error) ** 2).all()


def test_exact_bodies():
    """All modes of a tiny model: no error beyond round-off, a finite bound of it, and every mode found."""
    model = beam(n=(1, 1, 1), size=(0.1, 0.08, 0.06))
    with Problem(model, pair(model, "average")) as problem:
        count = problem.K.shape[0] - 6
        hz = np.linspace(100.0, 1.1 * problem.elastic_modes(count=5).frequencies_hz[-1], 13)
        bodies = [Modal(modes=count).reduce(problem), CraigBampton(modes=count + 6 - 12).reduce(problem)]
        for certificate in certify(problem, bodies, hz[[0, -1]], points=hz):
            assert certificate.error.max() < 1e-10 and certificate.static_error < 1e-10
            assert certificate.block_error.max() < 1e-9
            assert np.isfinite(certificate.bound).all() and certificate.bound.max() < 1e-9
            assert certificate.mode_deviation.max() < 1e-10 and certificate.mode_mac.min() > 1 - 1e-9


def test_a_body_of_one_coordinate():
    model, interfaces = ends("rigid")
    with Problem(model, interfaces) as problem:
        hz = np.linspace(10.0, 1500.0, 7)
        omega = 2 * np.pi * hz
        H, scale = Truth(problem)(omega), np.outer(problem.motion_scale, problem.motion_scale)
        tiny = Modal(modes=1).reduce(problem)
        r, part = tiny.rigid_count, slice(tiny.rigid_count)
        none = dataclasses.replace(
            tiny,
            M=tiny.M[part, part],
            K=tiny.K[part, part],
            D=tiny.D[part, part],
            B=tiny.B[part],
            C=tiny.C[:, part],
            V=tiny.V[:, part],
            mode_kind=tiny.mode_kind[:r],
        )
        certificate, nothing = certify(problem, [tiny, none], hz[[0, -1]], points=hz)
        error = errors_of(tiny, omega, H, scale)
        assert np.abs(certificate.error - error).max() < 1e-7 and (error <= certificate.bound).all()
        assert certificate.mode_mac[0] == pytest.approx(1.0) and certificate.mode_mac[1:].max() < 1e-6
        assert nothing.error == pytest.approx(1.0) and not nothing.mode_mac.any()
        assert all(1 <= limit.upper < 1.06 for name, limit in nothing.limits.items() if name != "envelope")


SPOILED = {
    "K": lambda r, E: replace(r, K=r.K + 1e-3 * np.abs(np.diag(r.K)).mean() * E),
    "one stiffness": lambda r, E: replace(r, K=r.K * np.where(np.arange(r.order) == 7, 1.001, 1.0)),
    "M": lambda r, E: replace(r, M=r.M + 1e-3 * E),
    "B": lambda r, E: replace(r, B=r.B * 1.001, C=r.C * 1.001),
    "C": lambda r, E: replace(r, C=r.C * 0.99),
    "D": lambda r, E: replace(r, D=r.D * 1.05),
}


@pytest.mark.parametrize("damping", DAMPINGS)
def test_reduced_matrices_that_are_not_projections_are_bounded_too(damping):
    """The bound sees what was stored, not what ought to have been."""
    model, interfaces = ends("average")
    with Problem(model, interfaces, damping=DAMPINGS[damping]) as problem:
        hz = band_frequencies(problem, [100.0, 3000.0], points=8)
        omega = 2 * np.pi * hz
        H, scale = Truth(problem)(omega), np.outer(problem.motion_scale, problem.motion_scale)
        sound = FreeInterface(modes=8).reduce(problem)
        E = np.zeros_like(sound.K)
        E[6:, 6:] = np.random.default_rng(1).standard_normal((sound.order - 6,) * 2)
        E = (E + E.T) / (2 * np.sqrt(len(E)))
        spoiled = {what: replace(spoil(sound, E), name=what) for what, spoil in SPOILED.items()}
        before, *certificates = certify(problem, [sound, *spoiled.values()], hz[[0, -1]], points=hz)
    for (what, wrong), certificate in zip(spoiled.items(), certificates, strict=True):
        error = errors_of(wrong, omega, H, scale)
        if what != "D" or damping == "rayleigh":
            assert error.max() > 1.5 * before.error.max(), what
        assert (np.abs(certificate.error - error) <= 1e-3 * error + 10 * certificate.reference_error).all(), what
        assert (error <= certificate.bound * (1 + 1e-6) + certificate.reference_error).all(), what


def known_by(model, interfaces, modes):
    """A problem that knows these elastic modes, whatever it is asked for."""

    class Knowing(Problem):
        def elastic_modes(self, **_):
            return modes

    return Knowing(model, interfaces)


def test_without_a_mode_there_is_no_certificate():
    """What the count of modes is for: the reference has one that is missing among the known ones."""
    model, interfaces = ends("average", n=(6, 1, 1))
    with Problem(model, interfaces) as problem:
        values, _ = pencil(problem)
        # A basis of the other modes: the one left out is its whole error.
        known = problem.elastic_modes(count=20)
        sound = Modal(modes=20).reduce(problem)
        keep = np.delete(np.arange(26), 6 + 1)
        body = replace(
            sound,
            **{k: getattr(sound, k)[np.ix_(keep, keep)] for k in "MKD"},
            B=sound.B[keep],
            C=sound.C[:, keep],
            V=sound.V[:, keep],
            mode_kind=tuple(sound.mode_kind[k] for k in keep),
        )
        hz = np.sqrt(values[1]) / (2 * np.pi) * np.array([0.5, 0.97, 0.995, 1.005])
        omega = 2 * np.pi * hz
        error = errors_of(body, omega, Truth(problem)(omega), np.outer(problem.motion_scale, problem.motion_scale))
        (certificate,) = certify(problem, [body], hz[[0, -1]], points=hz)
        assert (error <= certificate.bound * (1 + 1e-6)).all()
        without = np.delete(np.arange(8), 1)
        missing = Modes(
            eigenvalues=known.eigenvalues[without],
            vectors=known.vectors[:, without],
            verified_below=float(known.eigenvalues[8]),
        )
    refused = refusal("result", "band_hz", by=SolverError)
    with known_by(model, interfaces, missing) as problem, refused:
        certify(problem, [body], [0.1, hz[-1]])


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_modal_damping_is_proven(coupling):
    model, interfaces = ends(coupling)
    with Problem(model, interfaces, damping=Damping(modal=0.01)) as problem:
        values, phi = pencil(problem)
        hz = band_frequencies(problem, [60.0, 3000.0], points=20)
        omega = 2 * np.pi * hz
        S = problem.motion_scale
        L = (problem.B.T @ phi) * S[:, None]
        H = np.array([(L / (values + 2j * w * 0.01 * np.sqrt(values) - w**2)) @ L.T for w in omega])
        bodies = [
            method(60.0, 3000.0, 12).reduce(problem, name=name) for name, method in METHODS.items() if name != TWO_SIDED
        ]
        for body, certificate in zip(bodies, certify(problem, bodies, hz[[0, -1]], points=hz), strict=True):
            error = errors_of(body, omega, H, np.outer(S, S))
            assert np.abs(certificate.error - error).max() < 1e-8 * (1 + error.max()) ** 2
            ratio = certificate.bound / error
            show(coupling, body.name, f"error {error.max():.1e}, over it {ratio.min():.2f} to {ratio.max():.2f}")
            # Here the ratio acts on all true modes, there on those of the reference: as far apart as these converged.
            assert certificate.kind == "proven" and (error <= certificate.bound + 1e-8).all() and np.median(ratio) < 1.1


# Modes and blocks.


def test_mode_deviation_and_mac_of_a_double_eigenvalue():
    """Vectors of a two-fold eigenvalue are free to turn: as a plane they agree, one by one they do not."""
    model, interfaces = BODIES["square beam"]()
    with Problem(model, interfaces) as problem:
        values, phi = pencil(problem)
        assert values[1] == pytest.approx(values[0], rel=1e-9) and values[3] == pytest.approx(values[2], rel=1e-9)
        body = FreeInterface(modes=3).reduce(problem)
        theta, Y = body.modes()
        V = body.V @ Y[:, 6:]
        # The vectors of the first pair in other directions than those of the eigensolver.
        cross = phi.T @ problem.M @ V
        high = float(np.sqrt(values[7])) / (2 * np.pi)
        assert values[8] > values[7] * 1.01
        (certificate,) = certify(problem, [body], np.array([100.0, 1.001 * high]))
        assert certificate.mode_frequencies_hz == pytest.approx(np.sqrt(values[:8]) / (2 * np.pi), rel=1e-8)
        assert certificate.verified_below_hz > 1.2 * high
        for first, last in ((0, 2), (2, 4), (4, 5)):
            block = cross[first:last]
            near = np.sort(np.argsort(-np.linalg.norm(block, axis=0))[: last - first])
            s = np.linalg.svd(block[:, near], compute_uv=False)
            assert certificate.mode_mac[first:last] == pytest.approx(np.full(last - first, s.min() ** 2), abs=1e-8)
            assert certificate.mode_deviation[first:last].max() == pytest.approx(
                np.abs(np.sqrt(theta[6:][near] / values[first:last]) - 1).max(), abs=1e-9
            )
        assert certificate.mode_mac[:2].min() > 1 - 1e-6


def test_turned_vectors_of_a_plane_are_the_same_plane():
    model, interfaces = BODIES["square beam"]()
    with Problem(model, interfaces) as problem:
        body = Modal(modes=9).reduce(problem)
        known = problem.elastic_modes(count=9)
        c, s = np.cos(0.7), np.sin(0.7)
        turned = known.vectors.copy()
        turned[:, :2] = turned[:, :2] @ np.array([[c, -s], [s, c]])
        single = (known.vectors[:, 0] @ (problem.M @ turned[:, 0])) ** 2
        assert single < 0.7
        few = int((known.frequencies_hz < 1.25 * 1.001 * known.frequencies_hz[1]).sum())
        turned = Modes(eigenvalues=known.eigenvalues[:few], vectors=turned[:, :few], verified_below=np.inf)
    with known_by(model, interfaces, turned) as problem:
        (certificate,) = certify(problem, [body], [100.0, 1.001 * known.frequencies_hz[1]])
        assert certificate.mode_mac == pytest.approx(np.ones(2), abs=1e-9) and certificate.mode_deviation.max() < 1e-9


def test_a_mode_that_the_body_misses_has_no_mac():
    model, interfaces = ends("average")
    with Problem(model, interfaces) as problem:
        body = Modal(modes=3).reduce(problem)
        high = problem.elastic_modes(count=6).frequencies_hz[4] * 1.01
        (certificate,) = certify(problem, [body], np.array([100.0, high]))
        assert certificate.mode_mac[:3] == pytest.approx(np.ones(3)) and certificate.mode_mac[3:].max() < 1e-6
        assert np.isnan(certificate.mode_deviation[3:]).all() and certificate.mode_deviation[:3].max() < 1e-9


def test_errors_between_pairs_of_interfaces():
    model = beam(n=(6, 1, 1))
    x = model.nodes.xyz[:, 0]
    middle = make_interface(model, name="middle", nodes=np.flatnonzero(np.abs(x - 0.25) < 1e-9), coupling="average")
    with Problem(model, [*pair(model, "rigid"), middle]) as problem:
        hz = band_frequencies(problem, [50.0, 2500.0], points=8)
        omega = 2 * np.pi * hz
        H, S = Truth(problem)(omega), problem.motion_scale
        body = CraigBampton(modes=6).reduce(problem)
        (certificate,) = certify(problem, [body], hz[[0, -1]], points=hz)
        wrong = response_of(body, omega) * np.outer(S, S) - H
        for i in range(3):
            for j in range(3):
                rows, loads = slice(6 * i, 6 * i + 6), slice(6 * j, 6 * j + 6)
                expected = (norms(wrong[:, rows, loads]) / norms(H[:, rows, loads])).max()
                assert certificate.block_error[i, j] == pytest.approx(expected, rel=1e-5)
        assert certificate.absolute_error == pytest.approx(norms(wrong).max() / norms(H).max(), rel=1e-5)


def test_damping_of_the_models_own():
    """A certificate of a model with its own D is proven, or a refusal that says why."""
    free = beam()
    model = replace(free, D=sp.csr_array(free.K * 1e-6))
    with Problem(model, pair(model, "average")) as problem:
        body = FreeInterface(modes=8).reduce(problem)
        hz = np.linspace(100.0, 2500.0, 9)
        try:
            (certificate,) = certify(problem, [body], hz[[0, -1]], points=hz)
        except InputError as error:
            assert "damping" in str(error)
            return
        omega = 2 * np.pi * hz
        error = errors_of(body, omega, Truth(problem)(omega), np.outer(problem.motion_scale, problem.motion_scale))
        assert certificate.bound_kind == "bound" and np.abs(certificate.error - error).max() < 1e-7
        assert (certificate.bound > 0.05 * error).all() and np.median(certificate.bound / error) < 20


def test_certificates_need_interfaces():
    with Problem(beam()) as problem, refusal("missing", "interfaces"):
        certify(problem, [Modal(modes=2).reduce(problem)], np.array([10.0, 100.0]))


def test_a_number_of_points_may_come_from_an_array():
    model, interfaces = next(iter(BODIES.values()))()
    with Problem(model, interfaces) as problem:
        bodies = [Modal(modes=2).reduce(problem)]
        (counted,), (same,) = (certify(problem, bodies, [10.0, 100.0], points=n) for n in (5, np.array([5])[0]))
    assert np.array_equal(counted.datasets["frequencies_hz"], same.datasets["frequencies_hz"])


@pytest.mark.parametrize("points", [[np.nan], [10.0, np.nan, 30.0], [], [20.0, 10.0], [10.0, 10.0], [5.0], [np.inf]])
def test_points_that_do_not_ascend_within_the_band_are_refused(points):
    model, interfaces = next(iter(BODIES.values()))()
    with Problem(model, interfaces) as problem, refusal("value", "points", "100"):
        certify(problem, [], [10.0, 100.0], points=points)
