"""The order of elimination: less fill, the displacements of a node together, and right for any pattern."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from morembs.linalg.sparse import ordering
from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps
from morembs.linalg.sparse.symmetric import Lower
from tests.support.matrices import brick, chain, random


@pytest.fixture(autouse=True)
def _forget() -> None:
    """No order from an earlier test: the last one is that of a matrix which is used nowhere else."""
    ordering.metis_ordering(Lower.of(chain(61)))


def _order(A: sp.csc_array) -> np.ndarray:
    order = ordering.metis_ordering(Lower.of(A))
    if order is None:
        pytest.skip("no METIS library; get it with: sudo apt-get install libmetis5")
    np.testing.assert_array_equal(np.sort(order), np.arange(A.shape[0]))
    return order


def _fill(A: sp.csc_array, order: np.ndarray) -> int:
    """Entries of the Cholesky factor of ``A`` in that order (SuperLU keeps the order it is given)."""
    P = sp.csc_array(A[order][:, order])
    return int(splu(P, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).L.nnz)


def test_order_is_a_permutation_with_less_fill() -> None:
    A = brick(9)
    order = _order(A)
    # The displacements of a node stay together.
    np.testing.assert_array_equal(order.reshape(-1, 3) % 3, np.tile([0, 1, 2], (729, 1)))
    assert _fill(A, order) < 0.7 * _fill(A, np.arange(A.shape[0]))


def test_order_does_not_depend_on_the_numbers_of_the_rows() -> None:
    """Rows of a node that lie apart are no group, and still the order is good."""
    A = brick(8)
    mixed = np.random.default_rng(1).permutation(1536)
    B = sp.csc_array(A[mixed][:, mixed])
    assert _fill(B, _order(B)) < 1.3 * _fill(A, _order(A))


def test_groups_of_equal_rows() -> None:
    """Three nodes with 3, 1 and 2 displacements in a row, then one that resembles no neighbour."""
    node = np.array([0, 0, 0, 1, 2, 2, 3])
    touch = np.array([[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 1], [0, 0, 1, 1]])
    A = Lower.of(sp.csc_array(touch[np.ix_(node, node)].astype(float)))
    graph, starts = ordering.node_graph(A)
    np.testing.assert_array_equal(starts, [0, 3, 4, 6])
    np.testing.assert_array_equal(graph.toarray() != 0, touch - np.eye(4) != 0)
    exploded = ordering.explode(np.array([2, 0, 3, 1]), np.array([0, 3, 4, 6]), np.array([3, 1, 2, 1]))
    np.testing.assert_array_equal(exploded, [4, 5, 0, 1, 2, 6, 3])


@pytest.mark.parametrize(
    ("pattern", "starts"),
    [
        # Equal columns of the triangle, but row 3 touches row 0.
        ([[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 1], [1, 0, 1, 1]], [0, 1, 2, 3]),
        # Equal rows of the triangle, but rows 0 and 1 go on differently.
        ([[1, 1, 1, 0], [1, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1]], [0, 1, 2, 3]),
        # As many entries in a column, but other ones.
        ([[1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [1, 0, 1, 1, 1], [0, 0, 1, 1, 1], [0, 0, 1, 1, 1]], [0, 1, 2, 3]),
        # Rows that do not touch each other are no node, though they touch the same others.
        ([[1, 0, 1], [0, 1, 1], [1, 1, 1]], [0, 1, 2]),
    ],
)
def test_rows_that_differ_are_not_put_together(pattern: list[list[int]], starts: list[int]) -> None:
    _, groups = ordering.node_graph(Lower.of(sp.csc_array(np.array(pattern, dtype=float))))
    np.testing.assert_array_equal(groups, starts)


def test_large_matrices_are_looked_at_in_pieces() -> None:
    """A chain of nodes with 1, 2, 3 or 4 displacements: 1.4 million entries of the triangle."""
    sizes = np.tile([1, 2, 3, 4], 30_000)
    starts = np.cumsum(sizes) - sizes
    node, within = np.repeat(np.arange(len(sizes)), sizes), np.arange(sizes.sum()) - np.repeat(starts, sizes)
    first = np.maximum(starts[np.maximum(node - 1, 0)], 0)
    counts = starts[node] + within + 1 - first
    rows = np.repeat(np.arange(len(node)), counts)
    columns = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first, counts)
    half = sp.csr_array((np.ones(len(rows)), (rows, columns)))
    graph, groups = ordering.node_graph(Lower.of(sp.csr_array(half + sp.tril(half, -1).T)))
    np.testing.assert_array_equal(groups, starts)
    assert graph.nnz == 2 * (len(sizes) - 1)


def test_groups_are_those_of_the_whole_matrix() -> None:
    """Any pattern: a row belongs to the row before it when the two rows of the whole matrix are equal."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        node = np.sort(rng.integers(0, 12, 30))
        touch = rng.random((12, 12)) < 0.3
        whole = (touch | touch.T | np.eye(12, dtype=bool))[np.ix_(node, node)]
        A = Lower.of(sp.csc_array(whole.astype(float)))
        new = np.flatnonzero(np.append(True, (whole[1:] != whole[:-1]).any(axis=1)))
        graph, starts = ordering.node_graph(A)
        np.testing.assert_array_equal(starts, new)
        expected = whole[np.ix_(starts, starts)] & ~np.eye(len(starts), dtype=bool)
        np.testing.assert_array_equal(graph.toarray() != 0, expected)


def test_order_of_a_pattern_that_is_stored_on_one_side_only() -> None:
    """METIS reads beyond its arrays when an edge is stored in one direction only."""
    A = brick(5)
    column = np.repeat(np.arange(375), np.diff(A.indptr))
    A.data[np.abs(A.indices - column) > 40] = 0.0
    one_sided = A.copy()
    one_sided.data[(A.data == 0) & (A.indices < column)] = 7.0
    one_sided.data[one_sided.data == 0] = 3e-300
    one_sided.data[one_sided.data == 7.0] = 0.0
    one_sided.eliminate_zeros()
    assert one_sided.nnz < A.nnz
    _order(one_sided)
    _order(sp.csc_array(one_sided.T))


@pytest.mark.parametrize("nodes", [3, 16, 17, 40])
def test_small_and_dense_matrices_need_no_order(nodes: int) -> None:
    assert ordering.metis_ordering(Lower.of(chain(nodes))) is None
    assert ordering.metis_ordering(Lower.of(sp.csc_array(np.eye(300)))) is None
    assert ordering.metis_ordering(Lower.of(sp.csc_array(np.ones((200, 200)) + 300 * np.eye(200)))) is None


def test_the_last_order_is_kept_and_only_for_its_own_pattern() -> None:
    order = _order(brick(5))
    assert _order(2.0 * brick(5)) is order
    _order(brick(6))
    again = _order(brick(5))
    assert again is not order
    np.testing.assert_array_equal(again, order)


def test_a_thread_gets_the_order_of_its_own_matrix() -> None:
    """Another thread may ask for an order between any two lines."""

    class Disturbed(Lower):
        @property
        def pattern(self) -> int:
            ordering.metis_ordering(other)
            return 12345

    other, A = Lower.of(brick(6)), Lower.of(brick(5))
    expected = ordering.metis_ordering(A)
    for _ in range(2):
        order = ordering.metis_ordering(Disturbed(A.indptr, A.indices, A.data))
        np.testing.assert_array_equal(order, expected)


@pytest.fixture
def _without_metis(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    find = ordering.find_library
    with monkeypatch.context() as patch:
        # The libraries of MUMPS are found in the same way, and remembered.
        patch.setattr(ordering, "find_library", lambda name: None if name == "metis" else find(name))
        ordering.metis_library.cache_clear()
        yield
    ordering.metis_library.cache_clear()


@pytest.mark.usefixtures("_without_metis")
@pytest.mark.parametrize("kind", [Mumps, EmbeddedMumps], ids=lambda kind: kind.name)
def test_without_metis_there_is_no_order_and_mumps_finds_its_own(kind: type[Mumps]) -> None:
    if reason := kind.unavailable():
        pytest.skip(reason)
    assert ordering.metis_ordering(Lower.of(brick(5))) is None
    with kind().factorize(brick(9), "spd") as factor:
        assert factor.stats.factor_entries < 1.2 * _fill(brick(9), np.arange(2187))
        assert np.abs(brick(9) @ factor.solve(random(2187)) - random(2187)).max() < 1e-11


def test_a_metis_of_another_version_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Version 4 has another interface; the C library stands for it."""
    monkeypatch.setattr(ordering, "find_library", lambda name: "libc.so.6")
    assert ordering.metis_library.__wrapped__() is None


def test_a_failure_of_metis_leaves_the_order_to_the_solver(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Failing:
        METIS_NodeND = staticmethod(lambda *arguments: -2)

    monkeypatch.setattr(ordering, "metis_library", lambda: (Failing, np.int32))
    assert ordering.metis_ordering(Lower.of(brick(5))) is None
    assert "METIS failed with code -2" in caplog.text
