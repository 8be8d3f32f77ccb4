"""Tables of other people, through the reading path: each hides a cause, and one way of recording.

The cause comes out, beside it what is wrong with the file, and never a wrong name. Units and held
rows are read in every run by `tests/measured` and found by `tests/diagnosis/checks`.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recorder, make

from hilserver.commands import main
from tests.diagnosis.hidden.logs import recipe

NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")
HIDDEN = {"rotation_gain": -0.1}


@pytest.fixture(scope="module")
def drive():
    recorder = Recorder(channels=("speed", "gyro", "nav"))
    made = replace(recipe("nothing drive", 6, 60.0), causes=HIDDEN, recorder=recorder)
    return make(made)[0]


def in_degrees(table):
    table.columns["nav.yaw_rad"] = np.degrees(table.columns["nav.yaw_rad"]) % 360.0
    return "unit: deg"


def with_one_wheel_turned(table):
    table.columns["wheel.fl.speed_rpm"] *= -1.0


def once_a_second_and_filled_forward(table):
    there = np.flatnonzero(np.isfinite([table.columns[n] for n in NAV]).all(axis=0))[
        ::20
    ]
    last = np.clip(
        np.searchsorted(there, np.arange(len(table.t_s)), side="right") - 1, 0, None
    )
    for name in NAV:
        table.columns[name] = table.columns[name][there[last]]


def in_rows_of_their_own(table):
    for place, name in enumerate(NAV):
        others = np.cumsum(np.isfinite(table.columns[name])) % len(NAV) != place
        table.columns[name][others] = np.nan


@pytest.mark.parametrize(
    ("spoil", "faults"),
    [
        pytest.param(in_degrees, set(), marks=pytest.mark.long),
        (with_one_wheel_turned, {"sign_flip"}),
        pytest.param(
            once_a_second_and_filled_forward, {"held_samples"}, marks=pytest.mark.long
        ),
        (in_rows_of_their_own, set()),
    ],
)
def test_the_cause_comes_out_of_a_foreign_table(
    drive, tmp_path, monkeypatch, spoil, faults
):
    monkeypatch.chdir(tmp_path)
    table = replace(
        drive, columns={name: v.copy() for name, v in drive.columns.items()}
    )
    more = spoil(table) or ""
    columns = {name: name.upper().replace(".", " ") for name in table.columns}
    mapped = [
        f"  {name}: {{column: {column}{', ' + more if more and name == NAV[2] else ''}}}"
        for name, column in columns.items()
    ]
    lines = ["time: {column: T, unit: ms}", "channels:", *mapped]
    (tmp_path / "map.yaml").write_text("\n".join(lines), encoding="utf-8")
    rows = np.column_stack([1e3 * table.t_s, *table.columns.values()])
    body = "\n".join(
        ",".join("" if v != v else f"{v:.7g}" for v in row) for row in rows.tolist()
    )
    head = ",".join(["T", *columns.values()])
    (tmp_path / "log.csv").write_text(f"{head}\n{body}\n", encoding="utf-8")
    assert main(["diagnose", "log.csv", "--mapping", "map.yaml", "-o", "out"]) == 0
    found = json.loads((tmp_path / "out" / "findings.json").read_text())["findings"]
    causes = [f["causes"] for f in found]
    assert {c for (c,) in causes} == faults | HIDDEN.keys(), causes
    (turn,) = (
        f["parameters"]["rotation_gain"]
        for f in found
        if f["causes"] == ["rotation_gain"]
    )
    low, high = turn["ci95"]
    assert low - 0.003 <= HIDDEN["rotation_gain"] <= high + 0.003
