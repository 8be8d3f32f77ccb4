"""Semicolons or tabs between columns, and decimal commas: what half of Europe's programs export."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.errors import LogError
from hilserver.logs import read_log
from hilserver.logs.csv_dialects import separator_of

SEPARATORS = {";": "semicolons", "\t": "tabs"}


def written(path, rows, separator, comma, end, is_quoted):
    """Write a table; one with a quoted name goes to the strict reader."""
    header = ["t_s", '"left"' if is_quoted else "left", "right"]
    lines = [separator.join(row).replace(".", comma) for row in rows]
    path.write_bytes(
        "".join(f"{line}{end}" for line in [separator.join(header), *lines]).encode()
    )
    return path


@pytest.mark.parametrize("separator", SEPARATORS)
@pytest.mark.parametrize("is_quoted", [False, True])
@given(
    rows=st.lists(
        st.tuples(
            st.floats(allow_nan=False, allow_infinity=False), st.integers(-99, 99)
        ),
        min_size=1,
        max_size=9,
    ),
    comma=st.sampled_from([",", "."]),
    end=st.sampled_from(["\n", "\r\n"]),
)
@settings(max_examples=60, deadline=None)
def test_it_is_the_table_with_points_and_commas(
    tmp_path_factory, separator, is_quoted, rows, comma, end
):
    folder = tmp_path_factory.getbasetemp()
    texts = [
        (f"{0.5 * i}", repr(a), "" if b == 7 else str(b))
        for i, (a, b) in enumerate(rows)
    ]
    ours = read_log(written(folder / "ours.csv", texts, ",", ".", "\n", is_quoted))
    theirs = read_log(
        written(folder / "theirs.csv", texts, separator, comma, end, is_quoted)
    )
    assert theirs.t_s.tolist() == ours.t_s.tolist()
    for name in ("left", "right"):
        assert np.array_equal(theirs.columns[name], ours.columns[name], equal_nan=True)
    said = f"{folder / 'theirs.csv'}: {SEPARATORS[separator]} separate its columns: commas are"
    assert [notice[: len(said)] for notice in theirs.notices] == [said] * (comma == ",")


@pytest.mark.parametrize(
    ("head", "separator"),
    [
        ("t_s,a", ","),
        ("t_s;a", ";"),
        ("t_s\ta", "\t"),
        ("t_s", ","),
        ("", ","),
        ("t_s,a;b", ","),
        ('"t_s";"left, front"', ";"),
        ('"t_s","left; front"', ","),
        ("t_s;a\tb", ";"),
    ],
)
def test_the_first_row_says_what_separates(head, separator):
    assert separator_of(head) == separator


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ("0,0;1,5\n0.1;1,5\n", "row 3, column 1 't_s': '0.1'"),
        ("0;1.234,5\n", "row 2, column 2 'a': '1.234,5'"),
        ("0;1,234.5\n", "row 2, column 2 'a': '1,234.5'"),
        ("0.0;1.5\n0.1;1,5\n", "row 3, column 2 'a': '1,5'"),
    ],
)
def test_two_kinds_of_marks_are_refused_at_the_second(tmp_path, rows, place):
    path = tmp_path / "log.csv"
    path.write_text(f"t_s;a\n{rows}")
    with pytest.raises(LogError) as error:
        read_log(path)
    assert str(error.value).startswith(
        f"{path}: {place}: the file has both decimal commas and points;"
    )
    assert "\n" not in str(error.value)


def test_marks_of_columns_that_nobody_reads_do_not_matter(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "t_s;a;date;\n" + "".join(f"{i},5;1,5;26.11.2026;x\n" for i in range(3))
    )
    with pytest.raises(
        LogError, match=r"'26.11.2026': the file has both decimal commas and points"
    ):
        read_log(path)
    path.write_text(
        "t_s;a;;\n" + "".join(f"{i},5;1,5;26.11.2026;x\n" for i in range(3))
    )
    assert read_log(path).t_s.tolist() == [0.5, 1.5, 2.5]


@pytest.mark.parametrize("number", ["1,5,5", "1,", ",5", "1,5e-3", "-,5", "1 5"])
def test_a_number_reads_as_with_a_point_or_is_named(tmp_path, number):
    path = tmp_path / "log.csv"
    path.write_text(f"t_s;a\n0;{number}\n")
    try:
        expected = float(number.replace(",", "."))
    except ValueError:
        with pytest.raises(LogError, match=r"row 2, column 2 'a': .* is not a number"):
            read_log(path)
    else:
        assert read_log(path).columns["a"].tolist() == [expected]
