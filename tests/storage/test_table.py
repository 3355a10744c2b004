"""Tables of datasets: what is written by one is read back by it, and what a file lacks or holds else is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest

from morembs.storage.table import Row, Table, dataset, derived, read_rows, repeat_table, table_of, variants
from morembs.storage.table_check import TableCheck
from morembs.storage.writer import Columns, Writer, writing
from tests.support.refusals import Refusal, refusal

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
        (lambda g: g.pop("order"), ("file", "a.h5", "/at/order")),
        (lambda g: (g.pop("names"), g.create_group("names")), ("file", "a.h5", "/at/names")),
        (lambda g: g.create_group("error"), ("file", "a.h5", "/at/error")),
        (
            lambda g: (g.pop("loads/x"), g.create_dataset("loads/x", data=np.ones(3))),
            ("file", "a.h5", "/at/loads/x", "/at/shapes"),
        ),
        (lambda g: g["block_1/values"].__setitem__(0, np.nan), ("file", "a.h5", "/at/block_1/values")),
    ],
)
def test_what_is_wrong_is_named(file: Path, change: object, words: Refusal) -> None:
    with h5py.File(file, "a") as opened:
        change(opened["at"])
        with refusal(*words):
            TableCheck(file, opened, "file").table("at/", TABLE, {})


def test_matrices_without_columns_and_in_blocks(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        Writer(file).columns("none", np.empty((3, 0)))
        Writer(file).columns("two", Columns((2, 3), np.float32, (np.full((2, k), k) for k in (1, 2))))
        assert file["none"].shape == (3, 0)
        assert file["two"][()].tolist() == [[1, 2, 2], [1, 2, 2]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Stands in the group of what it belongs to."""

    x: np.ndarray = dataset("real", "N", "along the line", "m", name="line/x")


@dataclass(frozen=True, kw_only=True)
class Spring:
    name: str = dataset("text", "springs", name="names", beside=True)
    ends: np.ndarray = dataset("whole", "2", largest="N-1")


@dataclass(frozen=True, kw_only=True)
class Weight:
    node: int = dataset("whole", largest="N-1")


@dataclass(frozen=True, kw_only=True)
class Load:
    node: int = dataset("whole", largest="N-1")
    force: float = dataset("real", units="N")


ACTING = variants({"weight": Weight, "load": Load}, Row("kind", "text"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Everything that a declaration can say."""

    place: Place = dataset(table_of(Place), inline=True)
    springs: tuple[Spring, ...] = dataset(repeat_table(table_of(Spring), "spring"))
    acting: tuple[Weight | Load, ...] = dataset(repeat_table(ACTING, "acting"))
    solver: str = dataset("text", known=("direct", "iterative"), default="direct", since="0.2")
    mass: float = dataset("real", positive=True)
    first: int = dataset("whole", counts="f", largest="N")
    loads: Mapping[str, float] = dataset("real", name="loads/*", known="springs", default_factory=dict)

    @derived("text", "springs")
    def names(self) -> list[str]:
        return [spring.name for spring in self.springs]

    @derived("real", "", "distance of the ends", "m")
    def length(self) -> float:
        return float(np.ptp(self.place.x))


CHAIN = table_of(Chain, attributes={"format": "chain"})


@pytest.fixture
def chain() -> Chain:
    springs = tuple(Spring(name=name, ends=np.array([i, i + 1])) for i, name in enumerate(("near", "far")))
    acting = (Load(node=2, force=3.0), Weight(node=1))
    place = Place(x=np.array([0.0, 1.0, 3.0]))
    return Chain(place=place, springs=springs, acting=acting, mass=2.0, first=2, loads={"far": 1.5})


@pytest.fixture
def chain_file(tmp_path: Path, chain: Chain) -> Path:
    with writing(tmp_path / "chain.h5") as out:
        out.rows("", CHAIN, chain)
    return tmp_path / "chain.h5"


def test_classes_are_read_back_from_their_declarations(chain_file: Path, chain: Chain) -> None:
    with h5py.File(chain_file) as file:
        TableCheck(chain_file, file, "file").table("", CHAIN, {})
        again = read_rows(file, CHAIN)
        assert file["length"][()] == 3.0 and file["length"].attrs["units"] == b"m" and file.attrs["format"] == b"chain"
        assert file["springs/names"][()].tolist() == [b"near", b"far"] and "name" not in file["springs/spring_0"]
        assert "force" not in file["acting/acting_1"]
    np.testing.assert_equal(again.place.x, chain.place.x)
    assert again.acting == chain.acting and again.loads == chain.loads and again.solver == "direct"
    assert [(spring.name, spring.ends.tolist()) for spring in again.springs] == [("near", [0, 1]), ("far", [1, 2])]


def test_files_before_a_dataset_are_read(chain_file: Path) -> None:
    with h5py.File(chain_file, "a") as file:
        del file["solver"]
        TableCheck(chain_file, file, "file").table("", CHAIN, {})
        assert read_rows(file, CHAIN).solver == "direct"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("solver", np.bytes_("magic"), ("file", "chain.h5", "/solver", "magic")),
        ("mass", 0.0, ("file", "chain.h5", "/mass")),
        ("first", 4, ("file", "chain.h5", "/first", "4")),
        ("springs/spring_1/ends", [1, 3], ("file", "chain.h5", "/springs/spring_1/ends", "/line/x")),
        ("acting/acting_1/node", -1, ("file", "chain.h5", "/acting/acting_1/node", "-1", "/line/x")),
        ("loads/middle", 1.0, ("file", "chain.h5", "/loads", "middle", "/names")),
        ("line/x", None, ("file", "chain.h5", "/line/x")),
    ],
)
def test_limits_are_those_of_the_declaration(chain_file: Path, name: str, value: object, words: Refusal) -> None:
    with h5py.File(chain_file, "a") as file:
        if name in file:
            del file[name]
        if value is not None:
            file[name] = value
        with refusal(*words):
            TableCheck(chain_file, file, "file").table("", CHAIN, {})


def test_an_unknown_variant_is_refused(chain_file: Path) -> None:
    with h5py.File(chain_file, "a") as file:
        del file["acting/acting_0/kind"]
        file["acting/acting_0/kind"] = np.bytes_("moment")
        with refusal("unknown", "kind", "moment"):
            read_rows(file, CHAIN)
