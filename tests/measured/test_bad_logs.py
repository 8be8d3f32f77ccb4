"""Everything that cannot be read: one sentence with file, place and remedy; exit code 2."""

import gzip
import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from hilserver.commands import main
from hilserver.errors import LogError
from hilserver.measured.reading import read_measured
from tests.logs.samples import run_of
from tests.measured.samples import MCAP, bag_file, write_bag, write_csv

SPEED = "wheel.fl.speed_rpm"
COLUMNS = "channels:\n  wheel.fl.speed_rpm: {column: left}\n"
TOPICS = (
    "channels:\n  wheel.fl.speed_rpm: {topic: /iotbot/rpm, field: front_left_rpm}\n"
)


def raw(content, name="log.csv"):
    def make(folder):
        (folder / name).write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
        return folder / name

    return make


def csv(**how):
    return lambda folder: write_csv(folder / "log.csv", **how)


def row_of(text):
    """A sound log whose fourth row (line 5) is `text`."""
    rows = [f"{0.02 * i},{i}" for i in range(120)]
    rows[3] = text
    return raw(f"t_s,{SPEED}\n" + "\n".join(rows) + "\n")


def bag(edit=lambda file: None, **how):
    def make(folder):
        path = write_bag(folder / "bag", **how)
        edit(bag_file(path))
        return path

    return make


def cut(share):
    def edit(file):
        data = file.read_bytes()
        file.write_bytes(data[: int(len(data) * share)])

    return edit


def folder_without_a_bag(folder):
    (folder / "empty").mkdir()
    return folder / "empty"


def pipe(folder):
    os.mkfifo(folder / "log.csv")
    return folder / "log.csv"


def parquet(table):
    def make(folder):
        pa = pytest.importorskip("pyarrow")
        parquet_of = pytest.importorskip("pyarrow.parquet")
        parquet_of.write_table(pa.table(table), folder / "log.parquet")
        return folder / "log.parquet"

    return make


def two(first, second):
    def make(folder):
        paths = []
        for index, one in enumerate((first, second)):
            (folder / str(index)).mkdir()
            paths.append(one(folder / str(index)))
        return paths

    return make


def recording(track_m):
    """A recording of ours, of a plant with this track."""

    def make(folder):
        path = write_csv(folder / "run.csv")
        config = f"plant: {{track_m: {track_m}}}\nkinematics: {{}}\n"
        run = {**run_of(("t_s", SPEED)), "configuration": config, "states": []}
        path.with_name("run.csv.meta.json").write_text(json.dumps(run))
        with path.open("a") as file:
            file.write(f"9.9,{track_m}\n")
        return path

    return make


T = np.arange(120) * 0.02

# kind: how the log is made, mapping text or None, what the sentence says
KINDS = {
    "missing": (lambda folder: folder / "none.csv", None, "none.csv: no such file"),
    "missing, mapped": (lambda folder: folder / "none", COLUMNS, "none: no such file"),
    "missing bag": (
        lambda folder: folder / "none.bag",
        TOPICS,
        "none.bag: no such file",
    ),
    "folder": (
        folder_without_a_bag,
        TOPICS,
        "the folder contains no bag .* name the log",
    ),
    "folder without mapping": (
        folder_without_a_bag,
        None,
        "the folder contains no bag .* name the log",
    ),
    "empty": (raw(""), None, "log.csv: is empty; the first row must be the header"),
    "only header": (
        raw(f"t_s,{SPEED}\n"),
        None,
        "contains no samples of any signal; record",
    ),
    "one row": (csv(rows=1), None, "contains only 0 s; a diagnosis needs at least 1 s"),
    "too short": (
        csv(rows=30),
        None,
        "contains only 0.58 s; a diagnosis needs at least 1 s",
    ),
    "no header": (
        raw("0.0,1.0\n0.1,2.0\n"),
        None,
        "row 1 contains numbers instead of a header; put 't_s",
    ),
    "no time column": (
        csv(header=f"time,{SPEED}"),
        None,
        "row 1: there is no column 't_s'; give",
    ),
    "unknown column": (
        csv(header="t_s,wheel.fl.speed"),
        None,
        r"row 1, column 2 'wheel.fl.speed': .* did you mean 'wheel.fl.speed_rpm'\?",
    ),
    "column twice": (
        csv(header=f"t_s,{SPEED},{SPEED}", row="{t},{i},{i}"),
        None,
        "column 3 .* appears twice; remove",
    ),
    "semicolons of others": (
        csv(header="Zeit;links;rechts;theta", row="0,1;0,2;0,3;0,4"),
        None,
        "row 1: none of the columns 'Zeit', 'links', 'rechts', 'theta' is a hilserver",
    ),
    "points and decimal commas": (
        csv(header=f"t_s;{SPEED}", row="{t};{i},5"),
        None,
        f"row 2, column 2 '{SPEED}': '0,5': the file has both decimal commas and points; use only",
    ),
    "a comment of one cell above numbers without a header": (
        raw("# made by x at 12:00\n0,1\n0.02,2\n0.04,3\n"),
        None,
        "row 1 begins with '# ma'; .* remove everything before it",
    ),
    "decimal commas between commas": (
        raw(f"t_s,{SPEED}\n" + "".join(f"0,{i:03d},{i},0\n" for i in range(120))),
        None,
        "row 2 has 4 columns, the header has 2; .*semicolons if decimals have commas",
    ),
    "backwards": (
        csv(row="-{t},{i}"),
        None,
        "row 3, column 1 't_s': -0.02 is not later than -0.0; sort the rows by time",
    ),
    "milliseconds": (
        raw(f"t_s,{SPEED}\n" + "".join(f"{20 * i},{i}\n" for i in range(400))),
        None,
        r"its rows are 20 s apart, .* in a mapping, as time: \{unit: ms\}",
    ),
    "decimal commas": (
        row_of("0,06,3"),
        None,
        "row 5 has 3 columns, the header has 2; remove",
    ),
    "device": (
        lambda _folder: Path("/dev/zero"),
        None,
        "is a device or pipe, not a file; save",
    ),
    "pipe": (
        pipe,
        None,
        "log.csv: is a device or pipe, not a file; save the log to a file",
    ),
    "time of no clock": (
        csv(row="{i}e30,1"),
        None,
        r"its times are about 5.95e\+31 s, impossible for a recording; write seconds, or",
    ),
    "years": (
        csv(row="{i}e6,1"),
        None,
        "lasts 1.19e[+]08 s; a diagnosis accepts 28800 s at most",
    ),
    "text": (
        row_of("0.06,fast"),
        None,
        f"row 5, column 2 '{SPEED}': 'fast' is not a number; write",
    ),
    "infinite": (
        row_of("0.06,inf"),
        None,
        f"row 5, column .*'{SPEED}': inf is not a possible value",
    ),
    "absurd": (
        row_of("0.06,1e300"),
        None,
        "row 5, .* 1e[+]300 is not a possible value for a robot; write",
    ),
    "too few fields": (
        row_of("0.06"),
        None,
        "row 5 has 1 columns, the header has 2; remove",
    ),
    "time falls": (
        row_of("0.01,3"),
        None,
        "row 5, column 1 't_s': 0.01 is not later than .*; sort",
    ),
    "time begins anew": (
        raw(f"t_s,{SPEED}\n" + "".join(f"{0.02 * (i % 60)},{i}\n" for i in range(120))),
        None,
        "row 62, column 1 't_s': 0.0 is not later than 1.18; number the runs in a column 'seg",
    ),
    "a run in between": (
        raw(
            f"t_s,{SPEED}\n"
            + "".join(f"{0.02 * i - (i // 60)},{i}\n" for i in range(120))
        ),
        None,
        "is not later than 1.18; number the runs",
    ),
    "time is NaN": (
        row_of("nan,3"),
        None,
        "row 5, column 1 't_s': the time is missing; every row",
    ),
    "time is infinite": (
        row_of("inf,3"),
        None,
        "row 5, column 1 't_s': the time is missing",
    ),
    "letters": (row_of("0.06,ä"), None, "row 5, .*'ä' is not a number"),
    "not UTF-8": (
        raw(b"t_s,a\n0,1\n0.1,\xe4\n"),
        None,
        "byte 14 is not UTF-8; save the file",
    ),
    "UTF-16": (
        raw("t_s,a\n0,1\n".encode("utf-16")),
        None,
        "is not UTF-8; save the file",
    ),
    "binary": (raw(bytes(range(256)) * 20), None, "is not UTF-8; save the file"),
    "zeros": (raw(b"\0" * 400), None, "log.csv: .*(not CSV|no column 't_s')"),
    "quote not closed": (row_of('0.06,"3'), None, "not CSV: .*; write UTF-8 text"),
    "gzip": (
        raw(gzip.compress(b"t_s\n"), "log.csv.gz"),
        None,
        "log.csv.gz: not a readable log; supported",
    ),
    "gzip named CSV": (raw(gzip.compress(b"t_s,a\n0,1\n" * 99)), None, "is not UTF-8"),
    "kind": (raw("x", "log.xlsx"), None, "not a readable log; supported are"),
    "kind, mapped": (
        raw("x", "log.xlsx"),
        COLUMNS,
        "not a readable table; supported are",
    ),
    "kind of text": (
        raw("0.0 1.0\n0.1 2.0\n", "odometry.dat"),
        None,
        "odometry.dat: .*; a table of text is read as well if its name ends in .csv",
    ),
    "kind of text, mapped": (
        raw("0.0 1.0\n0.1 2.0\n", "odometry.txt"),
        COLUMNS,
        "odometry.txt: .*; a table of text is read as well if its name ends in .csv",
    ),
    "spaces, remark, no names": (
        raw("# my robot\n0.0 1.0 2.0\n0.1 1.0 2.0\n0.2 1.0 2.0\n"),
        None,
        "row 1 begins with '#'; .* or write the names if there are none",
    ),
    "segment not whole": (
        csv(header=f"t_s,segment,{SPEED}", row="{t},0.5,{i}"),
        None,
        "row 2, column 2 'segment': 0.5 is not a whole number; write one",
    ),
    "block not whole": (
        csv(header=f"t_s,block,{SPEED}", row="{t},nan,{i}"),
        None,
        "row 2, column 2 'block': nan is not a whole number; write one",
    ),
    "a segment every few rows": (
        raw(
            f"t_s,segment,{SPEED}\n"
            + "".join(f"{0.02 * i},{i // 12},{i}\n" for i in range(150))
        ),
        None,
        "the longest of 13 segments lasts 0.22 s; a diagnosis needs 0.5 s without a pause: number"
        " runs, not rows",
    ),
    "segment begins twice": (
        raw(
            f"t_s,segment,{SPEED}\n"
            + "".join(f"{0.02 * i},{i // 50 % 2},{i}\n" for i in range(150))
        ),
        None,
        "segment 0 begins twice; give each run its own number",
    ),
    "no usable channel": (
        csv(row="{t},"),
        None,
        "contains no samples of any signal; record some",
    ),
    "only time": (
        csv(header="t_s", row="{t}"),
        None,
        "contains no samples of any signal",
    ),
    "same log twice": (
        two(csv(), csv()),
        None,
        "1.log.csv: is the same log as .*0.log.csv; name it only once",
    ),
    "two machines": (
        two(recording(0.31), recording(0.5)),
        None,
        "was recorded with a different plant from that of .*; pool only logs of one machine",
    ),
    "mapped column missing": (
        csv(header="t_s,lefft"),
        COLUMNS,
        r"row 1: there is no column 'left', which the mapping .*; did you mean 'lefft'\?",
    ),
    "time column missing": (
        csv(header="t_s,left"),
        "time: {column: stamp}\n" + COLUMNS,
        "row 1: there is no column 'stamp'",
    ),
    "segment column missing": (
        csv(header="t_s,left"),
        "segment: {column: run}\n" + COLUMNS,
        "row 1: there is no column 'run', which the mapping names for segment",
    ),
    "mapping missing": (
        csv(),
        "none",
        "such mapping file; built-in mappings are iotbot, iotbot_5_6",
    ),
    "mapping no YAML": (csv(), "channels: [\n", r"map.yaml:\d+: not YAML"),
    "mapping key": (
        csv(),
        COLUMNS.replace("column", "colum"),
        r"map.yaml:2: unknown key '.*colum'.*|map.yaml:2: .*column",
    ),
    "mapping signal": (
        csv(),
        COLUMNS.replace("speed_rpm", "speed"),
        r"map.yaml:2: channels.wheel.fl.speed: .* did you mean 'wheel.fl.speed_rpm'\?",
    ),
    "mapping unit": (
        csv(),
        COLUMNS.replace("left", "left, unit: m"),
        "map.yaml:2: .*unit 'm' does not fit a signal in rpm; write one of rad/s, deg/s, rpm",
    ),
    "mapping sign": (
        csv(),
        COLUMNS.replace("left", "left, sign: 2"),
        "map.yaml:2: .*sign",
    ),
    "mapping scale": (
        csv(),
        COLUMNS.replace("left", "left, scale: 0"),
        "scale must not be 0",
    ),
    "mapped far": (
        csv(header="time,left", row="{t},1{i}"),
        "time: {column: time}\n" + COLUMNS.replace("left", "left, scale: 1.0e+300"),
        "row 2, .*'left', as wheel.fl.speed_rpm: .* is not a possible value for a robot",
    ),
    "mapping without channels": (
        csv(),
        "time: {rate_hz: 50}\n",
        "key 'channels' is missing",
    ),
    "mapping rate": (
        csv(),
        "time: {rate_hz: -1}\n" + COLUMNS,
        "map.yaml:1: time.rate_hz",
    ),
    "mapping column and rate": (
        csv(),
        "time: {rate_hz: 50, column: t}\n" + COLUMNS,
        "column and rate_hz exclude each other; remove one",
    ),
    "mapping plant": (
        csv(),
        "plant: {wheel_radius: 0.1}\n" + COLUMNS,
        r"map.yaml:1: .*wheel_radius.*did you mean '.*wheel_radius_m'\?",
    ),
    "mapping mixes": (
        csv(),
        COLUMNS + "  nav.x_m: {topic: /a, field: x}\n",
        "a log is either a table or a bag; use only columns or only topics",
    ),
    "mapping topic without field": (
        csv(),
        "channels:\n  nav.x_m: {topic: /a}\n",
        "map.yaml:2: .*topic and field belong together; write both",
    ),
    "bag mapping for a table": (
        csv(),
        TOPICS,
        "names topics of a bag, but this is a table",
    ),
    "column mapping for a bag": (bag(), COLUMNS, "names columns, but this is a bag"),
    "bag without mapping": (
        bag(),
        None,
        r"a bag needs a mapping of its topics; give .*; its topics are .*/iotbot/rpm \(iotbot",
    ),
    "topic missing": (
        bag(topics=("/iotbot/rmp",)),
        TOPICS,
        r"there is no topic '/iotbot/rpm', .*; did you mean '/iotbot/rmp'\?",
    ),
    "field missing": (
        bag(),
        TOPICS.replace("front_left_rpm", "left_front_rpm"),
        "topic '/iotbot/rpm': there is no field 'left_front_rpm'; it has front_left_rpm",
    ),
    "field no number": (
        bag(),
        "channels:\n  nav.x_m: {topic: /poseStamped, field: pose.position}\n",
        "topic '/poseStamped': field 'pose.position' is not a number; choose one",
    ),
    "no header in messages": (
        bag(),
        "time: {stamp: header}\n" + TOPICS,
        "its messages have no header; use 'stamp: received'",
    ),
    "bag without messages": (
        bag(n=0),
        TOPICS,
        "the mapped topics contain no messages; record",
    ),
    "db3 truncated": (
        bag(cut(0.02)),
        TOPICS,
        "not a readable bag .*; copy it again, or run",
    ),
    "db3 that is none": (raw("hello " * 99, "bag.db3"), TOPICS, "not a readable bag"),
    "MCAP that is none": (
        raw("hello", "run.mcap"),
        None,
        "run.mcap: not an MCAP file; is its",
    ),
    "MCAP bag, cut early": (bag(cut(0.001), storage=MCAP), TOPICS, "no topic|no MCAP"),
    "foreign MCAP unmapped": (
        lambda folder: bag_file(write_bag(folder / "bag", storage=MCAP)),
        None,
        "a bag needs a mapping of its topics; give",
    ),
    "Parquet that is none": (
        raw("hello", "log.parquet"),
        None,
        "not a readable Parquet file",
    ),
    "Parquet with text": (
        parquet({"t_s": T, SPEED: ["x"] * 120}),
        None,
        "contains no numbers; leave",
    ),
    "Parquet without time": (
        parquet({SPEED: T}),
        None,
        "there is no column 't_s'; give",
    ),
    "Parquet unknown": (
        parquet({"t_s": T, "speed": T}),
        None,
        "column 'speed': there is no such",
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_what_cannot_be_read_is_one_sentence(kind, tmp_path, capsys):
    make, text, complaint = KINDS[kind]
    made = make(tmp_path)
    paths = made if isinstance(made, list) else [made]
    mapping = None
    if text is not None:
        mapping = tmp_path / "map.yaml"
        if text != "none":
            mapping.write_text(text)
    with pytest.raises(LogError) as error:
        read_measured(paths, mapping)
    sentence = str(error.value)
    assert error.value.exit_code == 2
    assert re.search(complaint, sentence), sentence
    assert "\n" not in sentence
    assert len(sentence) < 500 + len(str(tmp_path)) * 2


def test_there_are_at_least_thirty_kinds():
    assert len(KINDS) >= 30


def test_what_may_not_be_read(tmp_path, monkeypatch):
    path = write_csv(tmp_path / "log.csv")

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(path), "read_bytes", refuse)  # root may read everything
    with pytest.raises(LogError, match=r"log.csv: permission denied"):
        read_measured([path])


def test_parquet_without_its_library(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    path = tmp_path / "log.parquet"
    path.write_bytes(b"PAR1")
    with pytest.raises(
        LogError, match=r"needs the library pyarrow; install .*hilserver\[parquet\]"
    ):
        read_measured([path])


def test_no_log_at_all():
    with pytest.raises(LogError, match="no log given; name at least one"):
        read_measured([])


def test_the_command_ends_with_2(tmp_path, capsys):
    path = write_csv(tmp_path / "log.csv", header="t_s,speed")
    code = main(
        ["diagnose", str(path), "-c", "config.yaml", "--out", str(tmp_path / "out")]
    )
    said = capsys.readouterr().err
    assert code == 2
    assert "column 2 'speed'" in said
    assert "Traceback" not in said
