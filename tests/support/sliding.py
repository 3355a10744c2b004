"""Models that loads slide along: a beam of Hermite elements, held at both ends, and its reduction."""

import numpy as np
import scipy.sparse as sp

from morembs.fem import DofMap, FEModel, Nodes
from morembs.problem import Problem
from morembs.reducers import StaticModesSwitching

ELEMENTS = 32


def hermite_beam(n=ELEMENTS):
    """Simply supported beam of unit length, stiffness EI and mass per length: deflection along y, rotation about z."""
    h = 1.0 / n
    k = (
        np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h * h, -6 * h, 4 * h * h],
            ]
        )
        / h**3
    )
    m = (
        h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
            ]
        )
    )
    K, M = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros((2 * n + 2, 2 * n + 2))
    for e in range(n):
        at = slice(2 * e, 2 * e + 4)
        K[at, at] += k
        M[at, at] += m
    keep = np.setdiff1d(np.arange(2 * n + 2), [0, 2 * n])
    xyz = np.zeros((n + 1, 3))
    xyz[:, 0] = np.linspace(0, 1, n + 1)
    return FEModel(
        K=sp.csr_array(K[np.ix_(keep, keep)]),
        M=sp.csr_array(M[np.ix_(keep, keep)]),
        nodes=Nodes(ids=np.arange(1, n + 2), xyz=xyz, sets={"RAIL": np.arange(n + 1)}),
        dofs=DofMap(node=keep // 2, component=np.where(keep % 2, 5, 1)),
    )


def reduced_beam(modes, n=ELEMENTS, **keys):
    reducer = StaticModesSwitching(base_options={"modes": modes}, candidates="set:RAIL", directions=[1, 5], **keys)
    with Problem(hermite_beam(n)) as problem:
        reduced = reducer.reduce(problem)
        return reduced, reducer.tabulate_static_modes(problem, reduced)
