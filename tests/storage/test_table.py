"""Tables of datasets: what is written by one is read back by it, and what a file lacks or holds else is named."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.storage.table import Row, Table, read_rows
from morembs.storage.table_check import TableCheck
from morembs.storage.writer import Columns, Writer, writing

INNER = Table((Row("values", "real", "k"),))
TABLE = Table(
    (
        Row("order", "whole", about="number of shapes"),
        Row("shapes", "later", "N n", units="m", columns=True),
        Row("names", "text", "n"),
        Row("notes", "notes"),
        Row("options", "json"),
        Row("on", "flag", "n"),
        Row("error", "any", "", when="if known"),
        Row("loads/*", "real", "n"),
        Row("block_#", INNER, field="blocks"),
    )
)
VALUES = {
    "order": 2,
    "shapes": np.arange(6.0).reshape(3, 2),
    "names": ("a", "b"),
    "notes": ("one", "two"),
    "options": {"modes": 2},
    "on": np.array([True, False]),
    "error": None,
    "loads": {"x": np.ones(2)},
    "blocks": [{"values": np.ones(1)}, {"values": np.ones(4)}],
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with writing(tmp_path / "a.h5") as out:
        out.rows("at/", TABLE, VALUES)
    return tmp_path / "a.h5"


def test_what_is_written_is_read(file: Path) -> None:
    with h5py.File(file) as opened:
        group = opened["at"]
        TableCheck(file, opened, "file").table("at/", TABLE, {})
        values = read_rows(group, TABLE)
        assert group["shapes"].chunks == (3, 1) and group["shapes"].attrs["units"] == b"m"
        assert group["order"].attrs["description"] == b"number of shapes" and group["on"].dtype == np.uint8
    expected = VALUES | {"notes": ("one; two",), "blocks": tuple(VALUES["blocks"])}
    del expected["error"]
    np.testing.assert_equal(values, expected)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda g: g.pop("order"), "incomplete file; missing: /at/order; write it again"),
        (lambda g: (g.pop("names"), g.create_group("names")), "missing: /at/names"),
        (lambda g: g.create_group("error"), "/at/error is a group; expected a dataset"),
        (
            lambda g: (g.pop("loads/x"), g.create_dataset("loads/x", data=np.ones(3))),
            r"/at/loads/x has the shape \(3,\); expected \(2\) by /at/shapes",
        ),
        (lambda g: g["block_1/values"].__setitem__(0, np.nan), r"/at/block_1/values holds nan at \[0\]"),
    ],
)
def test_what_is_wrong_is_named(file: Path, change: object, words: str) -> None:
    with h5py.File(file, "a") as opened:
        change(opened["at"])
        with pytest.raises(InputError, match=words):
            TableCheck(file, opened, "file").table("at/", TABLE, {})


def test_matrices_without_columns_and_in_blocks(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        Writer(file).columns("none", np.empty((3, 0)))
        Writer(file).columns("two", Columns((2, 3), np.float32, (np.full((2, k), k) for k in (1, 2))))
        assert file["none"].shape == (3, 0)
        assert file["two"][()].tolist() == [[1, 2, 2], [1, 2, 2]]
