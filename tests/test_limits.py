"""Limits that stand with types: checked, told in messages and shown in schemas from one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pytest

import morembs
from morembs.base.arguments import check_options, fits
from morembs.base.key_tables import Table, declare_key, json_schema, read_table
from morembs.base.limits import Count, Finite, Hertz, Positive, PositiveCount, length, one_of, text
from morembs.reducers.base import Reducer
from tests.support.refusals import refusal


@dataclass(frozen=True, kw_only=True)
class Options:
    order: PositiveCount | None = None
    shifts_hz: list[Hertz] | None = None
    kind: Annotated[str, one_of("path", "surface")] = "path"


@dataclass(frozen=True, kw_only=True)
class Inner(Table):
    size: Positive
    name: Annotated[str, text("a short name", r"^[a-z]+$", longest=5)] = "a"


@dataclass(frozen=True, kw_only=True)
class Whole(Table):
    first: Inner
    several: Annotated[list[Inner], length("one table or two", 1, 2)]
    point: Annotated[list[Finite], length("[x, y]", 2)] | None = declare_key("a point of the plane", None)
    kind: Literal["a", "b"] = "a"

    def refuse_conflicts(self):
        if "kind" in self.given and self.point is not None:
            raise morembs.InputError("kind was given beside point; leave one of them out")


RIGHT = {"first": {"size": 1}, "several": [{"size": 2.0, "name": "b"}]}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1, 0, 10**400, True, "1", [1.0], None, 1j])
def test_what_is_no_positive_number(value):
    assert not fits(value, Positive)


def test_numbers_of_numpy_are_numbers():
    assert fits(np.float32(2), Positive) and fits(np.int64(3), Count) and fits(np.array([0.0, 1.0]), list[Hertz])
    assert not fits(np.array([0.0, np.nan]), list[Hertz]) and not fits(np.float64(3), Count)


@pytest.mark.parametrize(
    ("given", "quoted"),
    [
        ({"order": 0}, ("0", "1")),
        ({"order": 2.5}, ("2.5", "1")),
        ({"shifts_hz": [0.0, -1.0]}, ("-1.0]", "Hz", "1e+12")),
        ({"kind": "line"}, ("'line'", '"path"', '"surface"')),
    ],
)
def test_an_option_beyond_its_limits_is_named(given, quoted):
    check_options(Options(order=3, shifts_hz=[0, 1e3]))
    with refusal("value", *given, *quoted) as caught:
        check_options(Options(**given))
    # The option stands first, with what was given.
    assert str(caught.value).startswith(f"{next(iter(given))} = ")


def test_a_reducer_of_another_package_may_check_its_options_itself():
    @dataclass(frozen=True, kw_only=True)
    class Own(Reducer):
        method = "own"
        count: int = 1

        def __post_init__(self):
            if self.count > 3:
                raise morembs.InputError(f"count = {self.count} was given; three at most", keyword="count")

        def _basis(self, problem, progress):
            raise NotImplementedError

    assert Own(count=2).count == 2
    with refusal("value", "count", "4"):
        Own(count=4)


def test_a_table_is_read_with_the_types_of_its_keys():
    table = read_table(Whole, {**RIGHT, "point": [1, 2]})
    assert table.values(but={"kind"}) == {
        "first": {"size": 1.0, "name": "a"},
        "several": [{"size": 2.0, "name": "b"}],
        "point": [1.0, 2.0],
    }
    assert isinstance(table.first.size, float) and table.given == {"first", "several", "point"}


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        ({"first": {"size": -1}}, ["[first]: size = -1 was given; expected a positive number"]),
        ({"first": {"siz": 1}}, ["[first]: unknown key 'siz'; did you mean 'size'?"]),
        ({"first": {}, "kind": "c"}, ["[first]: size is missing; expected a positive number", "kind = 'c' was given"]),
        ({"first": 3}, ["first = 3 was given; expected a table [first]"]),
        ({"several": [1]}, ["several = [1] was given; expected one table or two"]),
        ({"several": []}, ["several = [] was given; expected one table or two"]),
        (
            {"several": [{"size": 1}, {"size": 1, "name": "a\n"}]},
            ["[[several]] 2: name = 'a\\n' was given; expected a"],
        ),
        ({"point": [1.0, float("nan")]}, ["point = [1.0, nan] was given; expected a point of the plane"]),
        ({"point": [1, 2], "kind": "a"}, ["kind was given beside point; leave one of them out"]),
    ],
)
def test_each_wrong_key_has_its_line(change, lines):
    with pytest.raises(morembs.InputError) as caught:
        read_table(Whole, {**RIGHT, **change})
    told = str(caught.value).splitlines()
    assert len(told) == len(lines) and all(line in whole for line, whole in zip(lines, told, strict=True))


def test_the_json_schema_knows_the_limits():
    jsonschema = pytest.importorskip("jsonschema")
    schema = json_schema(Whole)
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(RIGHT, schema)
    for change in ({"first": {"size": 0}}, {"first": {"size": 1, "name": "longer"}}, {"several": []}, {"kin": "a"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**RIGHT, **change}, schema)
    assert schema["properties"]["point"]["description"] == "a point of the plane"
