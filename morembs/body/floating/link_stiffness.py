"""Geometric stiffness of interface couplings: the frame of an interface turns, and its nodes move on arcs.

A coupling says u_s = z + theta x a_s for small rotations theta of its frame, with arms a_s from the point of the
interface. To second order the arc adds 1/2 theta x (theta x a_s), on which the forces r_s that the coupling passes to
the nodes do work: 1/2 theta' A theta with A = sum_s (r_s a_s' + a_s r_s') / 2 - (r_s . a_s) I. It matters where the
point lies off its nodes, and for moments, which then are those of a rigid frame (semitangential, Argyris et al. 1979).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from morembs.base.types import Floats, Ints
from morembs.problem import Problem


class Links:
    """The couplings of all interfaces of ``problem`` that have a frame.

    ``dofs`` (ns,) of the model are those of their nodes, interface by interface; ``M`` (ns, N) is the mass there.
    """

    def __init__(self, problem: Problem) -> None:
        model, self.columns = problem.model, problem.coupling.frame_columns
        of = {interface.name: interface for interface in problem.interfaces}
        self.arms, self.places = {}, {}
        # Interfaces whose nodes share forces as the body decides.
        self.carried: set[str] = set()
        dofs: list[Ints] = []
        spread: list[sp.csc_array] = []
        at = 0
        for name in self.columns:
            interface = of[name]
            xyz = model.nodes.xyz[interface.nodes]
            self.arms[name] = xyz - interface.point
            rows = model.dofs.of_nodes(interface.nodes).ravel()
            forces = interface.kind.nodal_forces(model, interface)
            if forces is None:
                self.carried.add(name)
                forces = np.zeros((len(rows), 6))
            row, col = np.repeat(rows, 6), np.tile(np.arange(6), len(rows))
            spread.append(sp.csc_array((forces.ravel(), (row, col)), shape=(model.size, 6)))
            self.places[name] = slice(at, at + len(rows))
            dofs.append(rows)
            at += len(rows)
        self.dofs = np.concatenate(dofs) if dofs else np.empty(0, dtype=np.int64)
        # Forces of unit wrenches where the coupling alone spreads them, stiffness and mass: at interface nodes only.
        self.spread = sp.csr_array(sp.hstack(spread))[self.dofs] if spread else sp.csr_array((0, 0))
        self.K, self.M = (sp.csr_array(A[self.dofs]) for A in (model.K, model.M))

    def turning(self, U: Floats, inertial: Floats, wrench: Floats) -> dict[str, Floats]:
        """A (k, 3, 3) in Nm of every interface for k states of the body.

        Args:
            U: displacements (N, k) in m.
            inertial: M a (ns, k) in N at ``dofs``, a the accelerations.
            wrench: forces and moments (6 interfaces, k) on the interfaces, the reactions of a frame included.
        """
        spread = self.spread @ wrench
        passed = self.K @ U + inertial - spread
        terms = {}
        for name, place in self.places.items():
            a = self.arms[name]
            r = (passed if name in self.carried else self._alone(name, wrench))[place]
            virial = np.einsum("sak,sb->kab", r.reshape(len(a), 3, -1), a)
            trace = np.einsum("kaa->k", virial)
            terms[name] = 0.5 * (virial + virial.transpose(0, 2, 1)) - trace[:, None, None] * np.eye(3)
        return terms

    def _alone(self, name: str, wrench: Floats) -> Floats:
        """Nodal forces (ns, k) of the wrench on one interface whose coupling spreads it."""
        columns = self.columns[name]
        return np.asarray(self.spread[:, columns] @ wrench[columns])
