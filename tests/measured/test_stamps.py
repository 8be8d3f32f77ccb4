"""What a file itself says about its time and units, and what happens if the mapping says else."""

import re

import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.logs import read_log
from hilserver.measured.conversion import read_any
from hilserver.measured.reading import read_measured

LEFT = "channels:\n  wheel.fl.speed_rpm: {column: left}\n"
SPEED = "wheel.fl.speed_rpm"
T = np.arange(120) * 0.02
EPOCH_NS = 1_790_000_000_000_000_000


def read(folder, mapping, suffix=".csv"):
    (folder / "map.yaml").write_text(mapping)
    return read_measured([folder / f"log{suffix}"], folder / "map.yaml")


def write(folder, header, row):
    """Write a CSV whose rows are made by a function of seconds."""
    rows = [row(t) for t in T.tolist()]
    (folder / "log.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


def is_right(log, t=T):
    return np.allclose(log[SPEED].t_s - log[SPEED].t_s[0], t, rtol=0.0, atol=2e-6)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("kind", ["moments", "durations", "index of durations"])
@pytest.mark.parametrize("said", ["", ", unit: iso", ", unit: {unit}"])
def test_a_type_of_parquet_says_its_unit(tmp_path, unit, kind, said):
    pandas = pytest.importorskip("pandas")
    t = np.arange(120) if unit == "s" else T
    ns = np.rint(t * 1e9).astype(np.int64)
    at = (
        (EPOCH_NS + ns).astype("datetime64[ns]")
        if kind == "moments"
        else ns.astype("timedelta64[ns]")
    ).astype(f"{'datetime64' if kind == 'moments' else 'timedelta64'}[{unit}]")
    left = np.arange(120.0)
    if kind.startswith("index"):
        frame = pandas.DataFrame({"left": left}, index=pandas.Index(at, name="stamp"))
    else:
        frame = pandas.DataFrame({"stamp": at, "left": left})
    frame.to_parquet(tmp_path / "log.parquet")
    mapping = f"time: {{column: stamp{said.format(unit=unit)}}}\n{LEFT}"
    assert is_right(read(tmp_path, mapping, ".parquet"), t)


def test_a_mapping_that_contradicts_the_type_is_not_used(tmp_path):
    pandas = pytest.importorskip("pandas")
    at = (EPOCH_NS // 1_000_000 + np.arange(120) * 20).astype("datetime64[ms]")
    frame = pandas.DataFrame({"stamp": at, "left": np.arange(120.0)})
    frame.to_parquet(tmp_path / "log.parquet")
    log = read(tmp_path, f"time: {{column: stamp, unit: us}}\n{LEFT}", ".parquet")
    assert is_right(log)
    assert log.notices[0].endswith(
        "says its unit itself, ms; the mapping's us is not used"
    )


def test_a_moment_of_parquet_that_falls_is_said_as_a_date(tmp_path):
    pandas = pytest.importorskip("pandas")
    ms = EPOCH_NS // 1_000_000 + np.append(np.arange(119) * 20, 0)
    frame = pandas.DataFrame(
        {"stamp": ms.astype("datetime64[ms]"), "left": np.arange(120.0)}
    )
    frame.to_parquet(tmp_path / "log.parquet")
    with pytest.raises(
        LogError, match=r"'2026-09-21 \d\d:13:20.000' is not later than '2026"
    ):
        read(tmp_path, f"time: {{column: stamp}}\n{LEFT}", ".parquet")


def test_our_own_names_with_moments_and_dates(tmp_path):
    pandas = pytest.importorskip("pandas")
    at = (EPOCH_NS + np.rint(T * 1e9).astype(np.int64)).astype("datetime64[ns]")
    frame = pandas.DataFrame({"t_s": at, SPEED: np.arange(120.0)})
    frame.to_parquet(tmp_path / "log.parquet")
    frame.to_csv(tmp_path / "log.csv", index=False)
    for name in ("log.parquet", "log.csv"):
        assert is_right(read_measured([tmp_path / name])), name
        assert len(read_any(tmp_path / name)) == 120


@pytest.mark.parametrize(
    ("names", "parts", "time"),
    [
        ("sec,nanosec", (1, 10**9), "column: sec"),
        ("stamp.sec,stamp.nanosec", (1, 10**9), "column: stamp.sec"),
        ("secs,nsecs", (1, 10**9), "column: secs, rest: nsecs"),
        ("tv_sec,tv_usec", (1, 10**6), "column: tv_sec"),
        ("whole,part", (1, 10**3), "column: whole, rest: part, rest_unit: ms"),
    ],
)
@pytest.mark.parametrize("begin_s", [0, 1_790_000_000])
def test_seconds_and_the_rest_in_a_second_column(tmp_path, names, parts, time, begin_s):
    def row(t):
        n = round(t * parts[1])
        return f"{begin_s + n // parts[1]},{n % parts[1]},{t}"

    write(tmp_path, f"{names},left", row)
    log = read(tmp_path, f"time: {{{time}}}\n{LEFT}")
    assert is_right(log)
    assert len(log[SPEED]) == len(T)
    assert bool(log.notices) is ("rest" not in time)


def test_seconds_and_nanoseconds_of_parquet(tmp_path):
    pandas = pytest.importorskip("pandas")
    ns = np.rint(T * 1e9).astype(np.int64)
    columns = {"sec": ns // 10**9 + 1_790_000_000, "nanosec": ns % 10**9, "left": T}
    pandas.DataFrame(columns).to_parquet(tmp_path / "log.parquet")
    assert is_right(read(tmp_path, f"time: {{column: sec}}\n{LEFT}", ".parquet"))


def test_a_time_of_which_half_is_missing_is_refused(tmp_path):
    write(tmp_path, "when,left", lambda t: f"{int(t)},{t}")
    with pytest.raises(
        LogError, match=r"9\d % of the rows repeat a time stamp; if a second"
    ):
        read(tmp_path, f"time: {{column: when}}\n{LEFT}")


def clock(t, form="{h:02d}:{m:02d}:{s:06.3f}", begin_s=11 * 3600 + 3599.0):
    t += begin_s
    return form.format(h=int(t // 3600), m=int(t // 60 % 60), s=t % 60)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("when,left", lambda t: f"{t:.2f} sec,1"),
        ("when,left", lambda t: f"{t / 60:.8f} min,1"),
        ("when,left", lambda t: f"{clock(t)},1"),
        ("when,left", lambda t: f"0 days {clock(t)},1"),
        ("when,left", lambda t: f"25-Nov-2026 {clock(t)},1"),
        ("when;left", lambda t: f"25.11.2026 {clock(t)};1".replace(".020", ",020")),
        ("when,left", lambda t: f"11/25/2026 {clock(t)},1"),
        ("when,left", lambda t: f"2026/11/25 {clock(t)},1"),
        ("when,left", lambda t: f'"2026-11-25T{clock(t)}+01:00","1"'),
        ("when,clock,left", lambda t: f"2026-11-25,{clock(t)},1"),
        ("when;Uhrzeit;left", lambda t: f"25.11.2026;{clock(t)};1"),
    ],
)
def test_times_in_words_need_no_unit(tmp_path, header, row):
    write(tmp_path, header, row)
    log = read(tmp_path, f"time: {{column: when}}\n{LEFT}")
    assert is_right(log)
    assert len(log[SPEED]) == len(T)


@pytest.mark.parametrize(
    ("name", "per_second", "said"),
    [
        ("time_ms", 1e3, None), ("Time [us]", 1e6, None), ("t(ns)", 1e9, None),
        ("time_ms", 1.0, "s"), ("t", 1.0, None), ("atoms", 1.0, None),
    ],
)  # fmt: skip
def test_a_name_says_the_unit_of_time_unless_the_mapping_does(
    tmp_path, name, per_second, said
):
    write(tmp_path, f"{name},left", lambda t: f"{t * per_second!r},1")
    unit = f", unit: {said}" if said else ""
    log = read(tmp_path, f'time: {{column: "{name}"{unit}}}\n{LEFT}')
    assert is_right(log)
    assert any("as the file says" in n for n in log.notices) is (per_second != 1.0)


@pytest.mark.parametrize(
    ("header", "units", "channel", "factor", "notice"),
    [
        ("t,left", "s,rad/s", "", 9.549297, "is read in rad/s, as the file says"),
        ("t,left", "s,°/s", "", 1 / 6, "is read in deg/s, as the file says"),
        ("t,left", "s,1/min", "", 1.0, None),
        ("t,left", "s,rad/s", ", unit: rpm", 1.0, "though its row of units says rad/s"),
        ("t,left", "s,V", "", 1.0, None),
        ("t,left [rad s^-1]", None, "", 9.549297, "is read in rad/s"),
        ("t,left_rad_s", None, "", 9.549297, "is read in rad/s, as the file says"),
        ("t,left_rad_s", None, ", unit: rpm", 1.0, None),
        ("t,left_rad_s", None, ", scale: 2.0", 2.0, None),
    ],
)
def test_a_row_of_units_or_a_name_says_the_unit_of_a_channel(
    tmp_path, header, units, channel, factor, notice
):
    write(tmp_path, "\n".join(filter(None, (header, units))), lambda t: f"{t},1")
    column = header.split(",")[1]
    log = read(
        tmp_path,
        f'time: {{column: t}}\nchannels: {{{SPEED}: {{column: "{column}"{channel}}}}}\n',
    )
    assert log[SPEED].values[0] == pytest.approx(factor)
    found = [n for n in log.notices if f"'{column}'" in n]
    assert len(found) == (notice is not None)
    assert all(notice in n for n in found)


def test_a_row_of_units_that_contradicts_our_own_name_is_refused(tmp_path):
    write(tmp_path, f"t_s,{SPEED}\ns,rad/s", lambda t: f"{t},1")
    with pytest.raises(
        LogError, match="the row of units says rad/s, the name rpm; correct"
    ):
        read_measured([tmp_path / "log.csv"])


def summer_time(t):
    seconds = 3600 * 2 + 3599.0 + t
    return f"2026-10-25 {clock(seconds - (3600 if t >= 1.0 else 0), begin_s=0.0)},1"


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        (
            summer_time,
            "row 52, column 1 'when': '2026-10-25 02:00:00.000' is not later than"
            " '2026-10-25 02:59:59.980'; local time repeats an hour at the end of summer time:"
            " number the rows from here on in a column 'segment', or write UTC",
        ),
        (
            lambda t: f"{clock((86399.0 + t) % 86400, begin_s=0.0)},1",
            "row 52, column 1 'when': '00:00:00.000' is not later than '23:59:59.980'; it is past"
            " midnight: write the date, too",
        ),
        (
            lambda t: f"{t if t < 1.0 else t - 0.5:.2f} sec,1",
            "row 52, column 1 'when': '0.50 sec' is not later than '0.98 sec'; number the runs",
        ),
    ],
)
def test_a_time_that_falls_is_said_as_the_file_shows_it(tmp_path, row, sentence):
    write(tmp_path, "when,left", row)
    with pytest.raises(LogError, match=re.escape(sentence)):
        read(tmp_path, f"time: {{column: when}}\n{LEFT}")


def test_the_log_of_a_duration_is_in_seconds(tmp_path):
    write(tmp_path, f"t_s,{SPEED}", lambda t: f"{t:.2f} sec,1")
    assert read_log(tmp_path / "log.csv").t_s[1] == pytest.approx(0.02)
