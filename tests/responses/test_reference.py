"""References that cannot become good enough, samples on resonances, and models with hundreds of inputs."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from benchmarks import certificates as campaign
from morembs.base.errors import SolverError
from morembs.certificate.limits import error_limits
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import Gramian, Modal
from morembs.responses.certified import certified_reference
from morembs.responses.layout import BlockIndex
from morembs.responses.reference import has_stagnated, reference_model
from tests.support.refusals import refusal


def net(n, penalty):
    """Springs between n x n points that move across their plane, held along one side; some are ``penalty`` stiff."""
    rng, point = np.random.default_rng(0), np.arange(n * n).reshape(n, n)
    pairs = np.vstack(
        [
            np.stack([point[:-1].ravel(), point[1:].ravel()], 1),
            np.stack([point[:, :-1].ravel(), point[:, 1:].ravel()], 1),
        ]
    )
    k = 1e4 * rng.uniform(0.5, 2, len(pairs))
    k[: len(pairs) // 2 : 37] = penalty
    A = sp.csr_array((np.repeat([1.0, -1.0], len(pairs)), (np.tile(np.arange(len(pairs)), 2), pairs.T.ravel())))
    K = A.T @ sp.diags_array(k) @ A + sp.diags_array(np.where(np.arange(n * n) < n, 1e4, 0.0))
    xyz = np.stack([np.repeat(np.arange(n), n), np.tile(np.arange(n), n), np.zeros(n * n)], axis=1).astype(float)
    dofs = DofMap(node=np.arange(n * n), component=np.full(n * n, 2))
    return FEModel(
        K=sp.csr_array(K),
        M=sp.csr_array(sp.eye_array(n * n)),
        dofs=dofs,
        nodes=Nodes(ids=np.arange(1, n * n + 1), xyz=xyz),
    )


def tip(model, node):
    return make_interface(model, name="tip", nodes=np.array([node]), coupling="direct", components=[2])


def test_an_error_that_stands_still_ends_the_growth():
    """Links a billion times stiffer than the rest: it used to grow to 2,000 vectors."""
    model = net(40, 1e13)
    with Problem(model, [tip(model, 1599)], damping=Damping(structural=0.002)) as problem:
        omega = np.sqrt(problem.elastic_modes(count=12).eigenvalues)
        with refusal("result", "tolerance", by=SolverError):
            reference_model(problem, np.linspace(0, omega[-1], 40), tolerance=1e-13)
        # A certificate says how much is hidden.
        reference = certified_reference(problem, [0.0, omega[-1] / (2 * np.pi)], tolerance=1e-18)
        assert len(reference.values) < 300 and reference.proven and 1e-18 < reference.error_bounds.max() < 1e-6


@pytest.mark.parametrize(
    ("errors", "still"),
    [
        ([1.0, 0.5, 1e-3, *[8e-4] * 11], False),
        ([1.0, 0.5, 1e-3, *[8e-4] * 12], True),
        ([0.5, 0.3, 0.2] * 10, False),
        ([1e-3] * 12, False),
        ([1.0, *[1e-3, 9e-4] * 20, 4e-4], False),
    ],
)
def test_what_stands_still(errors, still):
    """Neither errors that still fall, nor those so large that modes may be missing."""
    assert has_stagnated(errors) is still


def test_samples_on_undamped_resonances_are_looked_at_beside_them():
    model = campaign.truss(np.random.default_rng(3), 40, held=True, twins=False)
    face = make_interface(model, name="a", nodes=np.array([7]), coupling="direct", components=[0, 1])
    with Problem(model, [face]) as problem, warnings.catch_warnings():
        warnings.simplefilter("error")
        known = reference_model(problem, np.linspace(0, 10.0, 5))
        on = float(np.sqrt(known.values[2]))
        reference = reference_model(problem, np.array([0.0, on, 1.3 * on]))
        assert reference.error <= 1e-8 and np.isfinite(reference.error)
        Gramian(band_hz=[0.0, 2 * on / (2 * np.pi)], order=8).reduce(problem)


@pytest.mark.parametrize("symmetric", [True, False])
def test_norms_of_blocks(symmetric):
    rng = np.random.default_rng(4)
    blocks = [slice(0, 2), slice(2, 5), slice(5, 6)]
    layout = BlockIndex(6, blocks, symmetric)
    H = rng.standard_normal((3, 6, 6)) + 1j * rng.standard_normal((3, 6, 6))
    H = H + H.transpose(0, 2, 1) if symmetric else H
    sizes = layout.norms(H[:, layout.i, layout.j] * layout.weight)
    expected = [np.linalg.norm(H, axis=(1, 2))] + [
        np.linalg.norm(H[:, blocks[a], blocks[b]], axis=(1, 2)) for a, b in layout.pairs
    ]
    assert sizes == pytest.approx(np.stack(expected, axis=1), rel=1e-13)


def test_a_search_that_ends_at_few_cells_gives_limits_all_the_same():
    """Limits of a search that is cut short hold as well, and say so."""
    model = campaign.truss(np.random.default_rng(5), 30, held=False, twins=False)
    faces = [make_interface(model, name=str(n), nodes=np.array([n]), coupling="direct") for n in (3, 11, 25)]
    with Problem(model, faces, damping=Damping(structural=1e-3)) as problem:
        band = [0.0, float(problem.elastic_modes(count=9).frequencies_hz[-1])]
        body = Modal(modes=12).reduce(problem)
        reference = certified_reference(problem, band)
        sharp, short = error_limits(reference, body), error_limits(reference, body, most_cells=60)
    assert any("the search ended at" in note for note in short.notes) and not any("ended" in n for n in sharp.notes)
    for name, limit in short.limits.items():
        # Both hold, so neither lower limit is above the other upper one.
        assert limit.lower <= sharp.limits[name].upper <= limit.upper * 1.05 and sharp.limits[name].lower <= limit.upper


@pytest.mark.parametrize("seed", [11, 12, 16, 23, 29, 30])
def test_what_is_unsure_of_a_damped_model_with_stiff_links(seed):
    """Against solutions refined with more digits: round-off of links a billion times stiffer moves soft resonances."""
    rng = np.random.default_rng(seed)
    model = campaign.truss(rng, int(rng.integers(14, 40)), held=True, twins=False)
    xyz, size = model.nodes.xyz, model.size

    def links(k, far):
        total = np.zeros((size, size))
        for first in rng.integers(1, len(xyz) - far, 2):
            v, along = np.zeros((len(xyz), 3)), xyz[first + far] - xyz[first]
            v[first], v[first + far] = -along, along
            total += k * np.outer(v, v) / (along @ along)
        return sp.csr_array(0.5 * (total + total.T))

    K, D = model.K + links(10 ** rng.uniform(3, 13), 1), links(10 ** rng.uniform(-3, 2), 2)
    model = replace(model, K=K, D=D)
    nodes = rng.choice(len(xyz), 2, replace=False)
    faces = [make_interface(model, name=str(n), nodes=np.array([n]), coupling="direct") for n in nodes]
    with Problem(model, faces) as problem:
        hz = problem.elastic_modes(count=8).frequencies_hz
        reference = certified_reference(problem, [0.0, float(hz[-1])])
        omega = 2 * np.pi * np.concatenate([hz, np.linspace(0.01 * hz[0], hz[-1], 40)])
        K, M, D = (A.toarray().astype(np.longdouble) for A in (problem.K, problem.M, problem.D))
        B = problem.B.toarray() * problem.motion_scale
        true = np.array([B.T @ refined(K - w * w * M + 1j * w * D, B) for w in omega.astype(np.longdouble)])
        off = np.linalg.norm(reference.H(omega) - true.astype(complex), axis=(1, 2))
        assert (off <= reference.uncertainty(omega)).all() and reference.proven


def refined(A, B):
    """A^-1 B by iterative refinement in the precision of ``A``."""
    factor = sl.lu_factor(A.astype(complex))
    X = np.zeros(B.shape, dtype=A.dtype)
    for _ in range(8):
        X = X + sl.lu_solve(factor, (B - A @ X).astype(complex))
    return X
