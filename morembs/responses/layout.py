"""Entries of small transfer matrices as rows, and the norms of the whole and of the blocks between interfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from morembs.base.types import Floats
from morembs.responses.rational import squares


class BlockIndex:
    """Entries of m x m matrices as rows (P, e), and the norms of the whole and of the blocks from their squares.

    ``blocks`` are the columns of each of the ni interfaces; ``symmetric`` matrices are held by one triangle. The nb
    ``pairs`` of interfaces follow the whole; a single interface is the whole.
    """

    def __init__(self, m: int, blocks: Sequence[slice], symmetric: bool) -> None:
        self.symmetric = symmetric
        self.i, self.j = np.triu_indices(m) if symmetric else (i.ravel() for i in np.indices((m, m)))
        self.weight = np.where((self.i != self.j) & symmetric, np.sqrt(2.0), 1.0)
        owner = np.zeros(m, dtype=np.int64)
        for number, block in enumerate(blocks):
            owner[block] = number
        n = len(blocks)
        self.pairs = [(a, b) for a in range(n) for b in range(n) if not symmetric or a <= b] if n > 1 else []
        self.blocks = blocks
        first, second = owner[self.i], owner[self.j]
        if symmetric:
            first, second = np.minimum(first, second), np.maximum(first, second)
        # Entries block by block, in the order of the pairs.
        pair = n * first + second
        self.order = np.argsort(pair, kind="stable")
        self.starts = np.flatnonzero(np.diff(pair[self.order], prepend=-1))
        # Of blocks beside the diagonal one triangle holds either entry once, with the weight of both.
        self.share = np.array([0.5 if symmetric and a != b else 1.0 for a, b in self.pairs])

    def rows(self, left: NDArray[np.number], right: NDArray[np.number]) -> NDArray[np.number]:
        """(P, e) of left_p right_p' for ``left`` and ``right`` (P, m)."""
        return left[:, self.i] * right[:, self.j] * self.weight

    def norms(self, X: NDArray[np.complex128]) -> Floats:
        """(..., 1 + nb) Frobenius norms of the whole and of the blocks of entries ``X`` (..., e)."""
        size = squares(np.asarray(X, dtype=complex))
        total = size.sum(axis=-1, keepdims=True)
        if not self.pairs:
            return np.asarray(np.sqrt(total))
        parts = np.add.reduceat(size[..., self.order], self.starts, axis=-1) * self.share
        return np.asarray(np.sqrt(np.concatenate([total, parts], axis=-1)))

    def lengths(self, b: NDArray[np.number]) -> Floats:
        """(P, 1 + ni) norms of the rows ``b`` (P, m) and of their parts at each interface."""
        parts = [b, *(b[:, block] for block in self.blocks)]
        return np.stack([np.linalg.norm(part, axis=1) for part in parts], axis=1)

    def products(self, left: Floats, right: Floats) -> Floats:
        """(..., 1 + nb) for the whole and the blocks of what ``lengths`` (..., 1 + ni) of both sides make."""
        i, j = (np.array([0, *(1 + pair[side] for pair in self.pairs)]) for side in (0, 1))
        return np.asarray(left[..., i] * right[..., j])

    def sizes(self, b: Floats, alike: Sequence[slice] = ()) -> Floats:
        """(P, 1 + nb) norms of the contributions b_p b_p' for ``b`` (P, m).

        Modes that are ``alike`` have equal shares in the product of their norms, which no rotation among them changes.
        """
        own = self.lengths(b)
        for cluster in alike:
            own[cluster] = np.sqrt((own[cluster] ** 2).mean(axis=0))
        return self.products(own, own)
