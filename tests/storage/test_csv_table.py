"""Tables of numbers that users write as CSV: taken as spreadsheets leave them, refused with what is wrong."""

import pytest

from morembs.base.errors import InputError
from morembs.storage.csv_table import read_table
from tests.support.refusals import refusal


@pytest.fixture
def read(tmp_path):
    def run(text, *columns, encoding="utf-8", **options):
        path = tmp_path / "table.csv"
        path.write_text(text, encoding=encoding)
        return {name: column.tolist() for name, column in read_table(path, *columns, **options).items()}

    return run


def test_columns_come_in_the_order_that_was_asked_for(read):
    text = '# measured\nb , "a",c\n\n1, 2,3\n# left out,\n4,5,6\n'
    found = read(text, ("a", "b"), ("c", "d"), encoding="utf-8-sig")
    assert list(found.items()) == [("a", [2, 5]), ("b", [1, 4]), ("c", [3, 6])]
    assert read("y,x\n1,2\n", optional=None) == {"y": [1], "x": [2]}
    assert read('a,b\n1,2\n# a tube of 2", say\n3,4\n\t# once "more\n5,6\n', ("a", "b"))["a"] == [1, 3, 5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has the columns none above 0 rows; expected a,b (c if known), each name once"),
        ("a,b\n", "has the columns a,b above 0 rows"),
        ("a,c\n1,2\n", "has the columns a,c above 1 rows"),
        ("a,b,d\n1,2,3\n", "has the columns a,b,d above 1 rows"),
        ("a,b,a\n1,2,3\n", "has the columns a,b,a above 1 rows"),
        ("a,b\n1,2\n3\n", "row 2 below its header has 1 values; expected 2 finite numbers"),
        ("a,b\n1,2,5\n", "row 1 below its header has 3 values; expected 2"),
        ("a,b\n1,soft\n", "row 1 below its header: could not convert string to float: 'soft'"),
        ("a,b\n1,inf\n", "row 1 below its header is 1,inf; expected 2 finite numbers"),
        ("a,b\n1," + 150_000 * "1", "cannot be read (field larger"),
    ],
)
def test_what_is_wrong_is_told(read, text, message):
    with pytest.raises(InputError) as caught:
        read(text, ("a", "b"), ("c",), what="rows of")
    assert str(caught.value).startswith("rows of /") and message in str(caught.value)


def test_a_table_that_is_not_there_or_no_text_is_refused(read, tmp_path):
    with refusal("file", "table"):
        read_table(tmp_path / "absent.csv")
    with refusal("file", "table"):
        read("a\nü\n", ("a",), encoding="latin-1")
