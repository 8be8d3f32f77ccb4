"""Tables below other lines: where the header, the units and the numbers are."""

import pytest

from hilserver.errors import LogError
from hilserver.logs.csv_layout import read_layout
from hilserver.logs.csv_reader import read_table

LABVIEW = """LabVIEW Measurement
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t,
Multi_Headings\tNo
X_Columns\tOne
Time_Pref\tRelative
Operator\tlab
Date\t2026/07/22
Time\t17:18:18,938945770263671875
***End_of_Header***

Channels\t2
Samples\t100\t100
Date\t2026/07/22\t2026/07/22
X_Dimension\tTime\tTime
X0\t0,0000000000000000E+0\t0,0000000000000000E+0
Delta_X\t0,020000\t0,020000
***End_of_Header***
X_Value\tleft\tright\tComment
"""
SCOPE = """Name\tYT Scope Project
File\tdrive.svdx
Starttime of export\t134086000000000000
Endtime of export\t134086000600000000

Name\tleft\tName\tright
SymbolComment\t\tSymbolComment\t
Data-Type\tREAL64\tData-Type\tREAL64
SampleTime[ms]\t20\tSampleTime[ms]\t20
Port\t851\tPort\t851
Offset\t0\tOffset\t0
Unit\trad/s\tUnit\t(None)

"""


def written(folder, text, n=60):
    """Write a text in which a row with {t} stands for many."""
    lines = []
    for line in text.splitlines():
        rows = range(n) if "{" in line else [0]
        lines += [
            line.format(t=0.02 * i, ms=20 * i, i=i) if "{" in line else line
            for i in rows
        ]
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "header", "at", "units"),
    [
        ("t,left\n{t},{i}", ["t", "left"], (1, 2), ""),
        ("t,left\ns,rad/s\n{t},{i}", ["t", "left"], (1, 3), "rad/s"),
        ("t;left\n[s];[°/s]\n{t};{i}", ["t", "left"], (1, 3), "°/s"),
        ("t,left\nsec,1/min\nfloat,int16\n{t},{i}", ["t", "left"], (1, 4), "1/min"),
        ("# made by me at 12:00\n# run 3\nt,left\n{t},{i}", ["t", "left"], (3, 4), ""),
        ("# t,left\n{t},{i}", ["t", "left"], (1, 2), ""),
        ("#t [ns],left [rad/s]\n{i},{i}", ["t [ns]", "left [rad/s]"], (1, 2), ""),
        ("sep=;\nt;left\n{t};{i}", ["t", "left"], (2, 3), ""),
        ("sep=|\nt|left\n{t}|{i}", ["t", "left"], (2, 3), ""),
        ("# timestamp tx ty\n{t} {i} 1.0", ["timestamp", "tx", "ty"], (1, 2), ""),
        ("Robot 7\nOperator,Ann\n\nt,left,x\n{t},{i},1", ["t", "left", "x"], (4, 5), ""),
        ("ID,7,\nDate,2026-01-01,\nt,left,frame\n{t},{i},base", ["t", "left", "frame"], (3, 4), ""),
        (LABVIEW + "{i}\t{i},5\t1,0", ["X_Value", "left", "right"], (21, 22), ""),
        (SCOPE + "{ms}\t{i}\t{ms}\t1", ["time", "left", "", "right"], (6, 14), "rad/s"),
        (
            '"TOA5","6843","CR3000"\n"TIMESTAMP","left","co2","diag"\n"TS","m/s","mg/m^3",""\n'
            '"","Smp","Smp","Smp"\n"{t}",{i},1,0',
            ["TIMESTAMP", "left", "co2", "diag"], (2, 5), "m/s",
        ),
        ("v,w\n{t},{i}", ["v", "w"], (1, 2), ""),
        ("made by me\nv,w\n{t},{i}", ["v", "w"], (2, 3), ""),
    ],
)  # fmt: skip
def test_the_header_is_the_row_that_names_the_numbers(
    tmp_path, text, header, at, units
):
    path = written(tmp_path, text)
    layout = read_layout(path)
    assert (layout.header, (layout.header_row, layout.data_row)) == (header, at)
    assert layout.unit(header[1]) == units
    table = read_table(path, time=None, used=header[:2])
    assert list(table.lines) == list(range(at[1], at[1] + 60))
    assert table.column(header[1])[-1] in (59, 59.5, 1.18)
    assert bool(table.notices) is (at != (1, 2)) or "decimal" in table.notices[-1]


@pytest.mark.parametrize(
    "broken", ["0.06,fast", "0.06", "x,y", "0.06,1,2", ",", "made by me"]
)
@pytest.mark.parametrize("before", ["t,left\n", "# by me\nt,left\n", "t,left\ns,rpm\n"])
def test_a_broken_row_is_no_header(tmp_path, before, broken):
    text = f"{before}0.00,1\n0.02,1\n{broken}\n{{t}},{{i}}"
    layout = read_layout(written(tmp_path, text))
    assert layout.header == ["t", "left"]
    assert layout.data_row == before.count("\n") + 1


def test_channels_with_times_of_their_own_are_one_sentence(tmp_path):
    with pytest.raises(
        LogError, match=r"column 3 holds times of its own.* export it with one"
    ):
        read_layout(written(tmp_path, SCOPE + "{ms}\t{i}\t{i}\t1"))
