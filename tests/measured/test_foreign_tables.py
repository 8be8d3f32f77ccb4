"""Tables as other programs write them: text beside numbers, long stamps, rows that share one."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.errors import LogError
from hilserver.logs import read_log
from hilserver.measured.reading import read_measured

LEFT = "channels:\n  wheel.fl.speed_rpm: {column: left}\n"
SPEED = "wheel.fl.speed_rpm"
T = [0.02 * i for i in range(100)]


def measured(folder, text, mapping=LEFT):
    (folder / "map.yaml").write_text(mapping)
    path = folder / "log.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_measured([path], folder / "map.yaml")


def table(header, row, n=100):
    return "\n".join([header, *(row.format(t=0.02 * i, i=i) for i in range(n))]) + "\n"


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("t_s,left,frame_id", "{t},{i},base_link"),
        ("t_s,comment,left", '{t},"a, ""b""",{i}'),
        ("t_s,left,right,,", "{t},{i},1,,"),
        ("t_s,left,,", "{t},{i},,x"),
        ("t_s,left,x,x", "{t},{i},1,oops"),
        ("t_s,left", "{t},{i},,"),
        ("t_s,left,segment name", "{t},{i},-"),
        ("\ufefft_s,left,date", "{t},{i},2026-01-01"),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_columns_that_the_mapping_does_not_name_do_not_matter(
    tmp_path, header, row, end
):
    log = measured(tmp_path, table(header, row).replace("\n", end))
    assert set(log.channels) == {SPEED}
    assert log[SPEED].values.tolist() == list(range(100))


def test_an_export_of_rostopic_echo(tmp_path):
    """Stamps of 19 digits, 100 us apart at times: a double tells 256 ns."""
    stamps = [
        1_700_000_000_123_456_789 + 20_000_000 * i + (i % 2) * 100 for i in range(100)
    ]
    rows = [
        f"{s},{i},{s},base_link,wheel_l,wheel_r,{i},{-i}" for i, s in enumerate(stamps)
    ]
    head = (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.name0,field.name1,"
        "field.velocity0,field.velocity1"
    )
    mapping = 'time: {column: "%time", unit: ns}\nchannels:\n' + "".join(
        f"  wheel.{w}.speed_rpm: {{column: field.velocity{k}, unit: rad/s}}\n"
        for k, w in enumerate(("fl", "fr"))
    )
    log = measured(tmp_path, "\n".join([head, *rows]) + "\n", mapping)
    exact = [(s - stamps[0]) * 1e-9 for s in stamps]
    assert log[SPEED].t_s.tolist() == exact
    assert not log.notices


def test_stamps_that_one_double_holds_are_still_two(tmp_path):
    text = "stamp,left\n" + "".join(
        f"{1_700_000_000_000_000_000 + 100 * i},{i}\n" for i in T_NS
    )
    log = measured(tmp_path, text, "time: {column: stamp, unit: ns}\n" + LEFT)
    assert len(log[SPEED]) == len(T_NS)


T_NS = [*range(20), *range(10**7, 2 * 10**7, 10**6)]


def test_a_long_stamp_that_falls_is_named_as_it_stands(tmp_path):
    text = "stamp,left\n1700000000000000200,1\n1700000000000000300,1\n1700000000000000250,1\n"
    with pytest.raises(
        LogError, match="1700000000000000250 is not later than 1700000000000000300"
    ):
        measured(tmp_path, text, "time: {column: stamp, unit: ns}\n" + LEFT)


@pytest.mark.parametrize(
    "form",
    [
        "2026-11-25T23:59:{:06.3f}",
        "2026-11-25 23:59:{:09.6f}Z",
        "2026-11-25T23:59:{:06.3f}+01:00",
        "2026-11-25 23:59:{:012.9f}",
    ],
)
@pytest.mark.parametrize("comma", [False, True])
def test_dates_are_stamps(tmp_path, form, comma):
    dates = [form.format(57 + t) for t in T]
    dates = [date.replace(".", ",") for date in dates] if comma else dates
    text = "".join(f"{date};{i},0\n" for i, date in enumerate(dates))
    mapping = "time: {column: when, unit: iso}\n" + LEFT
    log = measured(tmp_path, "when;left\n" + text, mapping)
    assert np.allclose(log[SPEED].t_s, T, rtol=0, atol=1e-6)
    assert log[SPEED].t_s[0] == 0.0


def test_what_is_no_date_is_named(tmp_path):
    mapping = "time: {column: when, unit: iso}\n" + LEFT
    with pytest.raises(
        LogError, match="row 3, column 1 'when': 'noon' is not a date with a time"
    ):
        measured(tmp_path, "when,left\n2026-11-25T12:00:00,1\nnoon,2\n", mapping)


def test_rows_that_complete_each_other_are_one_row(tmp_path):
    text = "t_s,left,x\n" + "".join(
        f"{t},{i},\n{t},,{2 * i}\n" for i, t in enumerate(T)
    )
    log = measured(tmp_path, text, LEFT + "  nav.x_m: {column: x}\n")
    assert log[SPEED].values.tolist() == list(range(100))
    assert log["nav.x_m"].values.tolist() == [2 * i for i in range(100)]
    assert log["nav.x_m"].t_s.tolist() == T
    assert not log.notices


def test_of_equal_stamps_the_first_row_counts_and_the_others_are_counted(tmp_path):
    text = "t_s,left\n" + "".join(
        f"{t},{i}\n" + f"{t},7\n" * (i < 3) for i, t in enumerate(T)
    )
    log = measured(tmp_path, text)
    assert log[SPEED].values.tolist() == list(range(100))
    assert log[SPEED].t_s.tolist() == T
    (notice,) = log.notices
    assert notice.endswith(
        "3 rows with a repeated time stamp were dropped; the first of each is kept"
    )


def test_equal_stamps_of_two_segments_stay_apart(tmp_path):
    text = f"t_s,segment,{SPEED}\n" + "".join(
        f"{i // 2 * 0.02},{i // 100},1\n" for i in range(200)
    )
    text += "1.98,2,5\n" + "".join(f"{2 + 0.02 * i},2,5\n" for i in range(60))
    path = tmp_path / "log.csv"
    path.write_text(text)
    log = read_log(path)
    assert np.bincount(log.segment).tolist() == [50, 50, 61]


def test_parquet_follows_the_same_rules(tmp_path):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    stamps = [1_700_000_000_000_000_000 + 10**7 * i + 100 * (i % 2) for i in range(200)]
    for kind in (pa.int64(), pa.timestamp("ns")):
        columns = {
            "stamp": pa.array([s for s in stamps for _ in range(2)], type=kind),
            "frame": ["base"] * 400,
            "left": [None if i % 2 else i / 2 for i in range(400)],
        }
        parquet.write_table(pa.table(columns), tmp_path / "log.parquet")
        (tmp_path / "map.yaml").write_text("time: {column: stamp, unit: ns}\n" + LEFT)
        log = read_measured([tmp_path / "log.parquet"], tmp_path / "map.yaml")
        assert log[SPEED].t_s.tolist() == [(s - stamps[0]) * 1e-9 for s in stamps]
        assert not log.notices


cells = st.sampled_from(
    ["", "nan", "0", "0.02", "1", "-3.5", "1e400", "x", '"', "1700000000000000000"]
)


@given(
    st.one_of(
        st.binary(max_size=300),
        st.lists(st.lists(cells, max_size=4), max_size=8).map(
            lambda rows: "\n".join(["t_s,left,,left2", *map(",".join, rows)]).encode()
        ),
    )
)
@settings(max_examples=150, deadline=None)
def test_any_bytes_are_read_or_refused_in_one_sentence(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp()
    with contextlib.suppress(LogError):
        measured(folder, data)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 5),
            st.one_of(st.none(), st.integers(0, 9)),
            st.one_of(st.none(), st.integers(0, 9)),
        ),
        min_size=1,
        max_size=12,
    )
)
@settings(max_examples=100, deadline=None)
def test_every_stamp_has_the_first_value_of_every_column(tmp_path_factory, rows):
    rows = sorted(rows, key=lambda row: row[0])
    path = tmp_path_factory.getbasetemp() / "rows.csv"
    lines = [",".join("" if v is None else str(v) for v in row) for row in rows]
    path.write_text("t_s,a,b\n" + "\n".join(lines) + "\n")
    log = read_log(path)
    assert log.t_s.tolist() == sorted({row[0] for row in rows})
    for k, name in enumerate("ab", 1):
        for t, value in zip(log.t_s, log.columns[name], strict=True):
            first = next(
                (row[k] for row in rows if row[0] == t and row[k] is not None), np.nan
            )
            assert np.array_equal(value, first, equal_nan=True)
