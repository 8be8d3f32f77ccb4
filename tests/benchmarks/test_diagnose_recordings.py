"""Recordings beside rivals: one line of results for each, and no second measurement of any."""

import json

import pytest

from benchmarks import diagnose, diagnose_recordings
from benchmarks.baselines import RIVALS
from benchmarks.diagnose_recordings import QUANTITIES, Row
from hilserver.diagnosis.schema.findings import Gain
from hilserver.errors import FailedError
from tests.benchmarks.test_diagnose import arguments


def rows_of(name, engine=2.0, ratio=1.25):
    gain = Gain(horizon_s=2.0, before=ratio, after=1.0, ratio=ratio, ci95=(1.0, 1.5))
    for quantity in QUANTITIES.values():
        ahead = dict.fromkeys(RIVALS, gain)
        yield Row(name=name, quantity=quantity, engine=engine, ahead=ahead)


@pytest.fixture
def measured(monkeypatch):
    """Recordings of the names that were measured; no log is read."""
    pytest.importorskip(
        "pysindy", reason="the extra hilserver[rivals] is not installed"
    )
    names = []

    def against_rivals(name, log, robot):
        names.append(name)
        if name == "broken":
            raise FailedError("no such file: broken.csv")
        yield from rows_of(name)

    monkeypatch.setattr(
        diagnose_recordings, "read_measured", lambda files, mapping: files
    )
    monkeypatch.setattr(diagnose_recordings, "against_rivals", against_rivals)
    return names


def test_what_was_measured_is_not_measured_again(tmp_path, measured, capsys):
    first = arguments(tmp_path, ("--recordings", "m.yaml=a.csv,b.csv"))
    more = arguments(tmp_path, ("--recordings", "m.yaml=b.csv,c.csv", "n.yaml=a.csv"))
    found = {row.name: row for row in diagnose.run(first)}
    assert found["yaw: geometric mean"].value == pytest.approx(1.25)
    assert measured == ["a", "b"]
    diagnose.run(more)
    assert measured == ["a", "b", "c", "a"]
    table = capsys.readouterr().out.splitlines()[-6:]
    assert [line.split("|")[1].strip() for line in table] == [
        "b",
        "b",
        "c",
        "c",
        "a",
        "a",
    ]
    assert "1.250 (1.00 to 1.50)" in table[0]
    assert "1.60" in table[0]


def test_of_other_sources_nothing_counts(tmp_path, measured):
    args = arguments(tmp_path, ("--recordings", "m.yaml=a.csv"))
    diagnose.run(args)
    file = args.resume
    line = json.loads(file.read_text(encoding="utf-8")) | {"sources": "others"}
    file.write_text(json.dumps(line) + "\n", encoding="utf-8")
    diagnose.run(args)
    assert measured == ["a", "a"]


def test_what_was_measured_is_shown_where_the_next_one_fails(
    tmp_path, measured, capsys
):
    args = arguments(tmp_path, ("--recordings", "m.yaml=a.csv,broken.csv"))
    with pytest.raises(FailedError, match=r"broken\.csv"):
        diagnose.run(args)
    assert "| a | yaw | 2.00 |" in capsys.readouterr().out
