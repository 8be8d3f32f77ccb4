"""Files that others could not read elsewhere: each as in the public report that is named."""

import contextlib
import re
import sqlite3
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from hilserver.errors import LogError
from hilserver.measured.proposal import ForeignLog
from hilserver.measured.reading import read_measured

N = 150
LEFT = "wheel.fl.speed_rpm"
S = np.arange(N) * 0.02
NS = np.arange(N) * 20_000_000
EPOCH_NS = 1_790_000_000_000_000_000


class Situation(NamedTuple):
    """One report: where it stands, what its file is, what comes of it here."""

    source: str
    make: Callable[[Any], Any]  # folder to the file
    mapping: str | None = None
    says: str | None = None  # the sentence that refuses it; None if it is read
    lasts_s: float = S[-1]


def csv(header, row, end="\n", encoding="utf-8", name="log.csv"):
    def make(folder):
        path = folder / name
        rows = [row(i) for i in range(N)]
        path.write_bytes((end.join([header, *rows]) + end).encode(encoding))
        return path

    return make


def parquet(columns, **options):
    def make(folder):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame(columns())
        index = options.pop("index_of", None)
        frame = frame if index is None else frame.set_index(index)
        frame.to_parquet(folder / "log.parquet", **options)
        return folder / "log.parquet"

    return make


def clock(i, begin_s=36_000.0):
    t = begin_s + 0.02 * i
    return f"{int(t // 3600):02d}:{int(t // 60 % 60):02d}:{t % 60:06.3f}"


def spring(i):
    """Local time over the hour that is not there."""
    return clock(i, 7199.0 if i < 50 else 7199.0 + 3600.0)


def times_of_nanoseconds(folder):
    pa = pytest.importorskip("pyarrow")
    writer = pytest.importorskip("pyarrow.parquet")
    table = pa.table({"t": pa.array(NS, type=pa.time64("ns")), "left": S})
    writer.write_table(table, folder / "log.parquet")
    return folder / "log.parquet"


def bag_with_stamps(stamps, cut=None):
    def make(folder):
        path = folder / "log.mcap"
        with path.open("wb") as file:
            writer = McapWriter(file, chunk_size=200)
            writer.start("ros2")
            schema = writer.register_schema(
                "std_msgs/msg/Float64", "ros2msg", b"float64 data\n"
            )
            channel = writer.register_channel("/left", "cdr", schema)
            for i, stamp_ns in enumerate(stamps):
                data = b"\x00\x01\x00\x00" + np.float64(i).tobytes()
                writer.add_message(channel, stamp_ns, data, stamp_ns)
            writer.finish()
        data = path.read_bytes()
        path.write_bytes(data[: len(data) if cut is None else int(cut * len(data))])
        return path

    return make


def sqlite_bag(folder, *, of_eloquent=False, with_empty=False):
    """A bag of ROS 2; without its metadata.yaml unless a topic without messages is in it."""
    path = folder / "bag"
    store = get_typestore(Stores.ROS2_HUMBLE)
    number = "std_msgs/msg/Float64"
    with Rosbag2Writer(path, version=8) as writer:
        left = writer.add_connection("/left", number, typestore=store)
        if with_empty:
            writer.add_connection("/right", number, typestore=store)
        for i, stamp_ns in enumerate((EPOCH_NS + NS).tolist()):
            data = store.serialize_cdr(store.types[number](float(i)), number)
            writer.write(left, stamp_ns, data)
    (file,) = path.glob("*.db3")
    if not with_empty:
        (path / "metadata.yaml").unlink()
    if of_eloquent:
        with contextlib.closing(sqlite3.connect(file)) as database:
            database.execute("ALTER TABLE topics DROP COLUMN offered_qos_profiles")
            database.commit()
    return file if of_eloquent else path


def set_back(i, by_s=1.0):
    """A clock that is set back by a second in the middle."""
    return EPOCH_NS + int(NS[i]) - (int(by_s * 1e9) if i >= N // 2 else 0)


def mapped(time="", column="left", unit=""):
    return f"{time}\nchannels: {{{LEFT}: {{column: {column}{unit}}}}}\n"


TOPIC = f"channels: {{{LEFT}: {{topic: /left, field: data}}}}\n"
GUESSED = "guessed"

SITUATIONS = [
    Situation(
        "PlotJuggler#46: an index without a name, as pandas writes it",
        csv(",left_rpm,right_rpm", lambda i: f"{i},{i},1"),
        GUESSED,
    ),
    Situation(
        "PlotJuggler#1070: ISO 8601 with a T and no fraction",
        csv("when,left", lambda i: f"2025-04-17T17:{i // 60:02d}:{i % 60:02d},{i}"),
        mapped("time: {column: when}"),
        lasts_s=149.0,
    ),
    Situation(
        "PlotJuggler#1220: date and time of day in two columns",
        csv("Date,Time,left", lambda i: f"2026-01-01,{clock(i)},{i}"),
        mapped("time: {column: Date}"),
    ),
    Situation(
        "PlotJuggler#1259: the same, guessed",
        csv("Date,Time,left_rpm", lambda i: f"2026-01-01,{clock(i)},{i}"),
        GUESSED,
    ),
    Situation(
        "PlotJuggler#1110: an hour of local time that is not there in spring",
        csv("when,left", lambda i: f"2025-03-30 {spring(i)},{i}"),
        mapped("time: {column: when}"),
        lasts_s=S[-1] + 3600.0,
    ),
    Situation(
        "PlotJuggler#1326: a text that looks like a time is no number of anything",
        csv("t_s,left,note", lambda i: f"{S[i]},{i},17:03:22"),
        mapped(),
    ),
    Situation(
        "PlotJuggler#906: nanoseconds since 1970 as rostopic writes them",
        csv("%time,field.left_rpm", lambda i: f"{EPOCH_NS + NS[i]},{i}"),
        GUESSED,
    ),
    Situation(
        "evo#379: a ground truth of EuRoC, whose header is a comment with units",
        csv(
            "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],q_RS_x [],q_RS_y []",
            lambda i: f"{EPOCH_NS + NS[i]},{S[i]},{S[i]},0.1,0.2",
        ),
        GUESSED,
    ),
    Situation(
        "evo#544: a trajectory whose rows end with a space",
        csv("# timestamp tx ty", lambda i: f"{S[i]} {S[i]} 1.0 "),
        GUESSED,
    ),
    Situation(
        "evo#260: two trajectories in one file",
        csv("t_s,left", lambda i: f"{S[i % 75]},{i}"),
        mapped(),
        r"0.0 is not later than 1.48; number the runs in a column 'segment'",
    ),
    Situation(
        "mcap#697: a file that ends in the middle",
        bag_with_stamps((EPOCH_NS + NS).tolist(), cut=0.7),
        TOPIC,
        lasts_s=-1.0,
    ),
    Situation(
        "rosbag2#2389: stamps that ran over",
        bag_with_stamps([*(EPOCH_NS + NS).tolist(), 2**64 - 1]),
        TOPIC,
        lasts_s=-1.0,
    ),
    Situation(
        "rosbag2#1801: a type that only the bag defines",
        bag_with_stamps((EPOCH_NS + NS).tolist()),
        TOPIC,
    ),
    Situation(
        "explorer#781: TOA5: the header in row 2, then units, then what was sampled",
        csv(
            '"TOA5","6843","CR3000"\n"TIMESTAMP","RECORD","left","co2"\n"TS","RN","rad/s",'
            '"mg/m^3"\n"","","Smp","Smp"',
            lambda i: f'"2012-06-07 {clock(i)}",{i},{i},659.7',
        ),
        mapped("time: {column: TIMESTAMP}"),
    ),
    Situation(
        "spark-csv#351: lines before the header, decimal commas",
        csv(
            "Pruefstand 3\nvom 7. Juni\nt_s;left",
            lambda i: f"{S[i]};{i},5".replace(".", ","),
        ),
        mapped(),
    ),
    Situation(
        "pandas#57792: no header at all",
        csv("0,1.99e-06,0", lambda i: f"{S[i]},1.99e-06,0"),
        None,
        "row 1 contains numbers instead of a header; put 't_s",
    ),
    Situation(
        "cudf#13409: durations in whole seconds",
        parquet(lambda: {"t": np.arange(N).astype("timedelta64[s]"), "left": S}),
        mapped("time: {column: t}"),
        lasts_s=149.0,
    ),
    Situation(
        "arrow-rs#1459: stamps of nanoseconds that were coerced to milliseconds",
        parquet(
            lambda: {"Date": (EPOCH_NS + NS).astype("datetime64[ns]"), "left": S},
            coerce_timestamps="ms",
            allow_truncated_timestamps=True,
        ),
        mapped("time: {column: Date}"),
    ),
    Situation(
        "arrow-rs#455: an index of dates in a file of version 1.0",
        parquet(
            lambda: {"Date": (EPOCH_NS + NS).astype("datetime64[ns]"), "left_rpm": S},
            index_of="Date",
            version="1.0",
        ),
        GUESSED,
    ),
    Situation(
        "pgcolumnar#865: times of day in nanoseconds",
        times_of_nanoseconds,
        mapped("time: {column: t}"),
    ),
    Situation(
        "pandas#40201: a header of another separator behind a byte-order mark",
        csv("\ufefft_s;left", lambda i: f"{S[i]};{i}", end="\r\n"),
        mapped(),
    ),
    Situation(
        "rosbag2#395: power was cut: no metadata.yaml",
        sqlite_bag,
        TOPIC,
    ),
    Situation(
        "rosbag2#1089: a bag of Eloquent, whose topics have no QoS",
        lambda folder: sqlite_bag(folder, of_eloquent=True),
        TOPIC,
    ),
    Situation(
        "rosbag2#1719: a topic without messages",
        lambda folder: sqlite_bag(folder, with_empty=True),
        "channels:\n"
        f"  {LEFT}: {{topic: /left, field: data}}\n"
        "  wheel.fr.speed_rpm: {topic: /right, field: data}\n",
    ),
    Situation(
        "rtabmap_ros#1333: the clock was set back while a bag was recorded",
        bag_with_stamps([set_back(i) for i in range(N)]),
        TOPIC,
        "topic '/left': the clock was set back by 0.98 s after message 75; cut the bag",
    ),
    Situation(
        "imu_tools#160: the clock was set from 2016 to now",
        bag_with_stamps([set_back(i, -6 * 31_536_000) for i in range(N)]),
        TOPIC,
        lasts_s=-1.0,
    ),
    Situation(
        "hokuyo3d#33: stamps with small jumps back",
        bag_with_stamps(
            [EPOCH_NS + int(t) - 25_000_000 * (i % 10 == 0) for i, t in enumerate(NS)]
        ),
        TOPIC,
        lasts_s=-1.0,
    ),
    Situation(
        "DSView#788: decimal commas between commas, where there is a decimal",
        csv("t_s, left, 2", lambda i: f"{i},{i % 2},{i},0" if i % 2 else f"{i},{i},0"),
        mapped(),
        "row 3 has 4 columns, the header has 3; .* separate the columns with semicolons",
    ),
    Situation(
        "sdc-issue-reports#170: decimal commas between commas, everywhere",
        csv("t_s, left, right", lambda i: f"0,{i:03d}, 0,{i:03d}, 12,18"),
        mapped(),
        "row 2 has 6 columns, the header has 3",
    ),
    Situation(
        "telegraf#3571: a comma before the milliseconds",
        csv("when;left", lambda i: f"2017-12-10 {clock(i).replace('.', ',')};{i}"),
        mapped("time: {column: when}"),
    ),
    Situation(
        "can-utils#60: microseconds without their leading zeros",
        csv("t_s,left", lambda i: f"{i // 50}.{i % 50 * 20_000},{i}"),
        mapped(),
        "row 7, column 1 't_s': 0.1 is not later than 0.8",
    ),
    Situation(
        "PlotJuggler#497: a form of date that nobody knows",
        csv("when,left", lambda i: f"day 7 at {i},{i}"),
        mapped("time: {column: when, unit: iso}"),
        "is not a date with a time; write one, as 2026-11-25T12:00:00.020",
    ),
]


@pytest.mark.parametrize("situation", SITUATIONS, ids=lambda s: s.source.split(":")[0])
def test_it_is_read_or_refused_with_a_remedy(situation, tmp_path):
    path = situation.make(tmp_path)
    mapping = tmp_path / "map.yaml"
    if situation.mapping == GUESSED:
        with pytest.raises(ForeignLog) as refusal:
            read_measured([path])
        mapping.write_text(refusal.value.proposal)
    elif situation.mapping is not None:
        mapping.write_text(situation.mapping)
    if situation.says is not None:
        with pytest.raises(LogError, match=situation.says) as refusal:
            read_measured([path], mapping if mapping.exists() else None)
        assert "\n" not in str(refusal.value)
        return
    log = read_measured([path], mapping)
    stamps = np.concatenate([channel.t_s for channel in log.channels.values()])
    if situation.lasts_s >= 0.0:
        assert np.ptp(stamps) == pytest.approx(situation.lasts_s, abs=2e-6)
    assert all(np.isfinite(channel.values).all() for channel in log.channels.values())
    assert all(re.search(r"\w", notice) for notice in log.notices)
