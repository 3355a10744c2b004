"""Blocks of columns against dense references."""

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.linalg.columns import orthonormal
from morembs.linalg.space import Space


def test_directions_that_keep_less_than_a_part_of_their_length_go_also_where_all_columns_have_a_share():
    """Six new directions and one known one, turned into each other: no single column is known, one direction is."""
    rng = np.random.default_rng(0)
    M = sp.diags_array(rng.uniform(1.0, 3.0, 60)).tocsr()
    A = rng.standard_normal((60, 14))
    A = A @ np.linalg.inv(np.linalg.cholesky(A.T @ (M @ A))).T
    known, new = A[:, :8], A[:, 8:]
    turn = np.linalg.qr(rng.standard_normal((7, 7)))[0]
    # Of the known direction there is a thousandth that is not known.
    mixed = np.hstack([new, known[:, :1] + 1e-3 * rng.standard_normal((60, 1))]) @ turn
    assert Space(M).complement(known, mixed.copy()).shape[1] == 7
    Space(M).orthogonalize_in_place(known, mixed)
    kept = orthonormal(mixed, M, np.ones(7), least=np.sqrt(0.5))
    assert kept.shape[1] == 6
    np.testing.assert_allclose(kept.T @ (M @ kept), np.eye(6), atol=1e-13)
    np.testing.assert_allclose(known.T @ (M @ kept), 0.0, atol=1e-13)
    assert sl.svdvals(new.T @ (M @ kept)).min() > 1 - 1e-4
