"""Held and free models of every kind against dense solutions: refused where the spectrum says so, and only there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.diagnostics.warnings import examined
from morembs.errors import InputError, MorembsError
from morembs.importers.from_matrices import from_matrices
from morembs.interface import Interface, make_interface, matrix_interface
from morembs.linalg.null_space import DENSE, null_space
from morembs.linalg.sparse.select import select_solver
from morembs.model import FEModel
from morembs.problem import Damping, Problem
from morembs.problem.rigid_motions import need_factor
from morembs.reducers import (
    Balanced,
    CraigBampton,
    FreeInterface,
    Guyan,
    Krylov,
    Modal,
    Reducer,
)  # fmt: skip
from tests.support.frames import beams, chain, clamped_beam, eigenvalues, line, model_on, plate, springs, without
from tests.support.meshes import box, steel

RNG = np.random.default_rng


def planar_beam(components: tuple[int, ...]) -> FEModel:
    """A clamped beam in the plane: the dofs of the other directions are taken out."""
    whole = clamped_beam(7)
    rows = np.flatnonzero(np.isin(whole.dofs.component, components))
    node, component = whole.dofs.node[rows], whole.dofs.component[rows]
    return replace(
        whole, K=sp.csr_array(whole.K[rows][:, rows]), M=sp.csr_array(whole.M[rows][:, rows]),
        dofs=replace(whole.dofs, node=node, component=component),
    )  # fmt: skip


def grounded_chain(stiffness: float = 1e6) -> FEModel:
    """Masses on a line that move along it alone."""
    K = stiffness * (2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    return model_on(K, np.eye(6), line(6), (0,))


def truss(held: tuple[int, ...]) -> FEModel:
    xyz = np.array([[x, y, z] for x in (0.0, 1.0, 2.0) for y in (0.0, 1.0) for z in (0.0, 1.1)])
    pairs = [(a, b) for b in range(len(xyz)) for a in range(b) if np.linalg.norm(xyz[a] - xyz[b]) < 1.9]
    return model_on(*springs(xyz, pairs), xyz, range(3), without(3 * len(xyz), held))


def two_beams(held: tuple[int, ...]) -> FEModel:
    """Two beams that nothing joins, of which the first nodes of ``held`` ones are held."""
    xyz = np.concatenate([line(4), line(4) + [0.0, 1.0, 0.0]])
    K, M = beams(xyz, [*chain(4), *((a + 4, b + 4) for a, b in chain(4))])
    return model_on(K, M, xyz, range(6), without(48, [24 * which + c for which in held for c in range(6)]))


def modal(free: int = 0) -> FEModel:
    """Modal coordinates, ``free`` of them rigid."""
    values = np.r_[np.zeros(free), (2 * np.pi * np.geomspace(0.5, 500.0, 12)) ** 2]
    return from_matrices(np.diag(values), np.eye(len(values)), B=RNG(1).standard_normal((len(values), 2)))


def turned() -> FEModel:
    """Modal coordinates turned by a random rotation: full matrices without nodes."""
    Q = np.linalg.qr(RNG(2).standard_normal((14, 14)))[0]
    values = np.r_[0.0, 0.0, np.geomspace(1e2, 1e6, 12)]
    K = (Q * values) @ Q.T
    return from_matrices(0.5 * (K + K.T), np.eye(14), B=RNG(1).standard_normal((14, 2)))


def lumped_rotations(model: FEModel) -> FEModel:
    """``model`` without mass in its rotations."""
    M = np.diag(model.M.toarray().sum(axis=1) * (model.dofs.component < 3))
    return replace(model, M=sp.csr_array(np.abs(M)))


SOUND: dict[str, tuple[Callable[[], FEModel], int]] = {
    "straight cantilever": (lambda: clamped_beam(6), 0),
    "oblique cantilever": (lambda: clamped_beam(6, axis=(0.6, 0.8, 0.0)), 0),
    **{f"{n} nodes clamped at both ends": ((lambda n=n: clamped_beam(n, (0, -1))), 0) for n in (3, 4, 5)},
    "free straight beam": (lambda: clamped_beam(5, ()), 6),
    "beam on a ball joint": (lambda: ball_joint(), 3),
    "planar beam, three dofs a node": (lambda: planar_beam((0, 1, 5)), 0),
    "planar beam, two dofs a node": (lambda: planar_beam((1, 5)), 0),
    "grounded chain": (grounded_chain, 0),
    "held truss": (lambda: truss(tuple(range(12))), 0),
    "free truss": (lambda: truss(()), 6),
    "two held beams": (lambda: two_beams((0, 1)), 0),
    "held plate": (lambda: plate(3, 2, held=True), 0),
    "free plate": (lambda: plate(3, 2, held=False), 3),
    "lumped cantilever": (lambda: lumped_rotations(clamped_beam(6)), 0),
    "modal coordinates": (modal, 0),
    "free modal coordinates": (lambda: modal(2), 2),
    "turned modal coordinates": (turned, 2),
    "springs and masses alone": (lambda: model_on(np.diag(np.geomspace(1e3, 1e6, 12)), np.eye(12), line(4), range(3)), 0),
}  # fmt: skip


def ball_joint() -> FEModel:
    xyz = line(6)
    return model_on(*beams(xyz, chain(6)), xyz, range(6), without(36, range(3)))


def interface_of(model: FEModel) -> Interface:
    if model.inputs is not None:
        return matrix_interface(model, name="tip", matrix="B")
    last = np.array([int(model.dofs.node.max())])
    return make_interface(model, name="tip", nodes=last, coupling="direct")


@pytest.mark.parametrize("name", SOUND)
def test_what_the_spectrum_allows_is_reduced_and_right(name: str) -> None:
    make, free = SOUND[name]
    model = make()
    examined(model)
    tip = interface_of(model)
    size = model.size - free
    with Problem(model, [tip], damping=Damping(beta=1e-5)) as problem:
        assert problem.rigid.shape[1] == free
        K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
        theta = sl.eigh(M, K + 1e3 * np.trace(K) / np.trace(M) * M, eigvals_only=True)
        finite = int((theta > 1e-14 * theta[-1]).sum()) - free
        exact = np.sort(sl.eigvals(K, M).real)[: free + finite][free:]
        for reducer in (
            Modal(modes=min(4, finite)), FreeInterface(modes=min(2, finite)), Guyan(), Krylov(shifts_hz=[10.0], moments=1),
            CraigBampton(modes=2), CraigBampton(modes=max(2, B.shape[1]), inertia_modes=True),
        ):  # fmt: skip
            held = reducer.method in ("craig-bampton", "guyan")
            try:
                body = reducer.reduce(problem)
            except InputError as error:
                # The interface does not hold a free body, or leaves no coordinates: true.
                assert held and ("leave" in str(error) and free or size - B.shape[1] < 2), str(error)
                continue
            values = body.modes()[0]
            assert np.abs(values[:free]).max(initial=0.0) <= 1e-9 * values[-1]
            # From above (Rayleigh and Ritz), the lowest ones of modal reductions to the digits of LAPACK.
            lowest = exact[: len(values) - free]
            assert (values[free:] >= lowest * (1 - 1e-6)).all()
            if reducer.method == "modal":
                assert values[free : free + 2] == pytest.approx(exact[:2], rel=1e-6)
            if reducer.method == "krylov":
                s = 2j * np.pi * 10.0
                D = 1e-5 * K
                H = B.T @ np.linalg.solve(s * s * M + s * D + K, B)
                own = body.C @ np.linalg.solve(s * s * body.M + s * body.D + body.K, body.B)
                assert np.abs(own - H).max() <= 1e-5 * np.abs(H).max()
