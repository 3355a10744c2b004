"""Block Lanczos with full reorthogonalisation and thick restart.

The operator F -> G M F, with G a symmetric flexibility, is self-adjoint in the inner product of M; its
largest eigenvalues 1/lambda belong to the lowest modes. Blocks make the sparse solves several times
cheaper per column than single vectors and find multiple eigenvalues (Grimes, Lewis, Simon 1994;
restart: Wu and Simon 2000). The space may go on with another shift, so that it is a rational Krylov space (Ruhe 1998).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sl

from morembs.base import progress
from morembs.base.errors import SolverError
from morembs.base.types import Floats
from morembs.linalg.columns import m_norms, orthonormal_pair
from morembs.linalg.dense import symmetric
from morembs.linalg.space import Space
from morembs.linalg.tolerances import TOL


class BlockLanczos:
    """Krylov space of ``flexibility(M .)`` that grows block by block.

    Peak memory: ``capacity`` columns of length N, where the budget of ``space`` wants them, and a few blocks.
    """

    def __init__(
        self, flexibility: Callable[[Floats], Floats], space: Space, start: Floats, *, capacity: int, seed: int = 1
    ) -> None:
        self.flexibility = flexibility
        self.space, self.M = space, space.M
        self.block = start.shape[1]
        self.capacity = max(capacity, 3 * self.block)
        self.rng = np.random.default_rng(seed)
        self.V = space.budget.empty((self.M.shape[0], self.capacity), order="F")
        self.T = np.zeros((self.capacity, self.capacity))
        self.size = 0
        self.pending, self.M_pending = orthonormal_pair(start, self.M)
        self.rest_vectors = np.zeros((self.M.shape[0], 0))
        self.residual_gram = np.zeros((0, 0))
        self.last = slice(0, 0)
        # First column along which Op of the next block has a part; columns that are eigenvectors already.
        self.near = self.locked = 0
        # Op V = V T + W tail with W, of which W' M W is kept.
        self.tail = np.zeros((0, 0))
        self._turned: Floats | None = None

    def expand(self) -> None:
        """One block more: afterwards ``size`` columns satisfy Op V = V T + W E'."""
        k, b = self.size, self.pending.shape[1]
        self.V[:, k : k + b] = self.pending
        # Blocks that are done with make room for those of the solution.
        self.pending = self.rest_vectors = self.V[:, :0]
        W = self.flexibility(self.M_pending)
        self.M_pending = self.pending
        MW = self.M @ W
        norms = m_norms(W, MW)
        H = np.zeros((k + b, b))
        H[self.near :] = self.space.orthogonalize_once([self.V[:, self.near : k + b]], W, MW=MW)
        # What is left of W keeps the round-off of what was taken out, along all of V.
        for _ in range(TOL.lanczos_passes):
            MW = self.M @ W
            G = W.T @ MW
            again = self.space.orthogonalize_once([self.V[:, : k + b]], W, MW=MW)
            H += again
            if (np.abs(again) <= TOL.repeated_part * norms).all():
                break
        self.T[: k + b, k : k + b] = H
        self.T[k : k + b, : k + b] = H.T
        self.T[k : k + b, k : k + b] = 0.5 * (H[k:] + H[k:].T)
        self.tail = np.hstack([np.zeros((b, k)), np.eye(b)])
        if self._turned is not None:
            self.T[:k, :k] = symmetric(self.T[:k, :k] + H[:k] @ self._turned)
            self.tail[:, :k], self._turned = self._turned, None
        self.size = k + b
        self.rest_vectors = W
        self.residual_gram = symmetric(G - again.T @ again)
        self.last = slice(k, k + b)
        # Op of the next block has no part along what came before this one.
        self.near = k
        del MW
        self.pending, self.M_pending = self._next(W, norms)

    def _next(self, W: Floats, norms: Floats) -> tuple[Floats, Floats]:
        Q, MQ = orthonormal_pair(W, self.M, norms, self.residual_gram)
        if Q.shape[1] < W.shape[1]:
            # Directions ran out (an invariant subspace): random ones keep looking for what it misses.
            missing = self.block - Q.shape[1]
            fresh = self.flexibility(self.M @ self.rng.standard_normal((W.shape[0], missing)))
            Q = np.hstack([Q, self.space.complement([self.V[:, : self.size], Q], fresh)])
            MQ = self.M @ Q
        return Q, MQ

    def ritz(self) -> tuple[Floats, Floats, Floats]:
        """Eigenvalues theta (k,), largest magnitude first, coordinates (size, k), residual norms in M (k,).

        Those of the k columns that are not locked.
        """
        free = slice(self.locked, self.size)
        theta, free_Y = sl.eigh(self.T[free, free])
        order = np.argsort(-np.abs(theta), kind="stable")
        theta, Y = theta[order], np.zeros((self.size, len(theta)))
        Y[free] = free_Y[:, order]
        y = self.tail @ Y
        residual = np.sqrt(np.maximum(np.einsum("ij,ik,kj->j", y, self.residual_gram, y), 0.0))
        return theta, Y, residual

    def restart(self, keep: int) -> None:
        """Keep the ``keep`` best Ritz vectors and go on from them; none may be locked."""
        theta, Y, _ = self.ritz()
        self.space.multiply_into(self.V[:, : self.size], Y[:, :keep], self.V[:, :keep])
        self.T[:] = 0.0
        self.T[range(keep), range(keep)] = theta[:keep]
        self.tail = self.tail @ Y[:, :keep]
        self.size, self.near = keep, 0

    def turn(self, flexibility: Callable[[Floats], Floats], distance: float, locked: int) -> None:
        """Go on with the ``flexibility`` of a shift that lies ``distance`` above the one so far.

        The space is kept: what Op V = V T + W tail says of the other operator is known once the next block has been
        solved for (Ruhe 1998). The ``locked`` best Ritz vectors have converged and stay as they are.
        """
        k = self.size
        self.restart(k)
        theta = np.diag(self.T)[:k]
        moved = 1.0 / (1.0 - distance * theta)
        tail = distance * (self.M_pending.T @ self.rest_vectors) @ self.tail * moved
        tail[:, :locked] = 0.0
        self.T[range(k), range(k)] = theta * moved
        self.flexibility, self.locked, self._turned = flexibility, locked, tail

    def store(self) -> None:
        """Put the blocks in use where the budget wants them, before something else needs the memory."""
        self.pending, self.M_pending, self.rest_vectors = (
            self.space.budget.store(one) for one in (self.pending, self.M_pending, self.rest_vectors)
        )

    def enlarge(self, capacity: int) -> None:
        """Make room for ``capacity`` columns."""
        V, T = self.space.budget.empty((len(self.V), capacity), order="F"), np.zeros((capacity, capacity))
        V[:, : self.size], T[: self.size, : self.size] = self.V[:, : self.size], self.T[: self.size, : self.size]
        self.V, self.T, self.capacity = V, T, capacity

    def grew_since(self, looked: int) -> bool:
        """True if another look at the Ritz values pays: their small eigenproblem costs more than the growth of a large
        space. True where it cannot grow further."""
        return self.size >= TOL.ritz_growth * looked or self.full() or not self.pending.shape[1]

    def full(self) -> bool:
        """No room for another block."""
        return bool(self.size + self.pending.shape[1] > self.capacity)

    def vectors(self, Y: Floats) -> Floats:
        """Columns V Y (N, j)."""
        return self.space.multiply(self.V[:, : self.size], Y)


def largest(lanczos: BlockLanczos, count: int, *, what: str = "modes") -> tuple[Floats, Floats]:
    """The ``count`` largest eigenvalues theta and their vectors, M-orthonormal, to ``TOL.ritz_residual``.

    They are fewer where no more motions have mass.

    Raises:
        SolverError: no convergence.
    """
    looked = 0
    for _ in range(TOL.lanczos_steps):
        if lanczos.full():
            lanczos.restart(min(count + 2 * lanczos.block, lanczos.size - lanczos.block))
            looked = 0
        lanczos.expand()
        ended = not lanczos.pending.shape[1]
        if not ended and (lanczos.size < count or not lanczos.grew_since(looked)):
            continue
        looked = lanczos.size
        theta, Y, residual = lanczos.ritz()
        good = residual[:count] <= TOL.ritz_residual * np.abs(theta[:count])
        progress.update(f"{int(good.sum())} of {count} {what} converged")
        if good.all() or ended:
            return theta[:count], lanczos.vectors(Y[:, :count])
    raise SolverError(
        f"{count} {what} did not converge in {TOL.lanczos_steps} steps; ask for fewer, "
        "or check the model for a mechanism"
    )
