"""MF4 keeps every bit, opens in foreign readers with units, and what is damaged is a sentence."""

import itertools
import json
import random
import sys

import asammdf
import mf4_rs
import numpy as np
import pytest

from hilserver import commands
from hilserver.errors import LogError
from hilserver.logs import read_log
from hilserver.logs.mf4 import META
from tests.logs.samples import NAMES, run_of

SPEED = "wheel.fl.speed_rpm"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A drive of our own, in virtual time, and the same as MF4."""
    folder = tmp_path_factory.mktemp("recording")
    scenario = folder / "drive.yaml"
    scenario.write_text(
        "steps:\n  - {at_s: 0.1, write: {wheels.setpoints_rpm: [40, 40, -30, -30]}}\n"
    )
    path = folder / "drive.mcap"
    assert commands.main(["simulate", str(scenario), "-o", str(path)]) == 0
    convert(path, path.with_suffix(".mf4"))
    return path


def convert(*words):
    assert commands.main(["convert", *map(str, words)]) == 0


def in_order(run):
    return {
        **run,
        "signals": sorted(run["signals"], key=lambda signal: signal["slots"]),
    }


def bits(values):
    return np.asarray(values, dtype=np.float64).view(np.int64)


def test_a_recording_survives_there_and_back(recording, tmp_path):
    convert(recording.with_suffix(".mf4"), tmp_path / "again.mcap")
    first, between, last = map(
        read_log, (recording, recording.with_suffix(".mf4"), tmp_path / "again.mcap")
    )
    assert any(codes.any() for codes in first.status.values())
    for log in (between, last):
        assert list(log.columns) == list(first.columns)
        np.testing.assert_array_equal(bits(log.t_s), bits(first.t_s))
        np.testing.assert_array_equal(log.segment, first.segment)
        for name, values in first.columns.items():
            np.testing.assert_array_equal(
                bits(log.columns[name]), bits(values), err_msg=name
            )
            np.testing.assert_array_equal(
                log.status[name], first.status[name], err_msg=name
            )
        assert in_order(log.run) == in_order(first.run)
        assert [(s.segment, s.tick, s.words.tobytes()) for s in log.states] == [
            (s.segment, s.tick, s.words.tobytes()) for s in first.states
        ]


def test_what_is_replayed_from_it_is_the_same_bit_for_bit(recording, tmp_path, capsys):
    log = str(recording.with_suffix(".mf4"))
    assert (
        commands.main(["replay", log, "-o", str(tmp_path / "x.mcap"), "--check"]) == 0
    )
    assert "equal, bit for bit" in capsys.readouterr().out


def test_foreign_numbers_survive_with_segments_blocks_and_gaps(tmp_path):
    rng = np.random.default_rng(1)
    lines = [f"t_s,segment,block,{SPEED},nav.x_m"]
    for i in range(300):
        x = "" if i % 3 else repr(float(rng.normal()))
        lines.append(
            f"{i % 150 * 0.013!r},{i // 150},{i // 60},{rng.normal() * 1e-7!r},{x}"
        )
    (tmp_path / "0.csv").write_text("\n".join(lines) + "\n")
    for before, after in itertools.pairwise(
        ["0.csv", "1.mf4", "2.mcap", "3.mf4", "4.csv"]
    ):
        convert(tmp_path / before, tmp_path / after)
    assert (tmp_path / "0.csv").read_text() == (tmp_path / "4.csv").read_text()
    with asammdf.MDF(tmp_path / "3.mf4") as mdf:
        speed = mdf.get(SPEED)
    assert speed.unit == "rpm"
    # over both segments, as viewers need it
    assert (np.diff(speed.timestamps) > 0).all()


def test_asammdf_and_another_reader_see_names_units_and_numbers(recording):
    log = read_log(recording)
    units = {signal["name"]: signal["unit"] for signal in log.run["signals"]}
    other = mf4_rs.Mdf(str(recording.with_suffix(".mf4")))
    of_other = {channel.name: channel.unit for channel in other.groups[0].channels}
    with asammdf.MDF(recording.with_suffix(".mf4")) as mdf:
        for name, values in log.columns.items():
            channel = mdf.get(name)
            assert (channel.unit, of_other[name]) == (units[name], units[name])
            np.testing.assert_array_equal(bits(channel.samples), bits(values))
            np.testing.assert_array_equal(bits(channel.timestamps), bits(log.t_s))
            np.testing.assert_array_equal(bits(other.values(name)), bits(values))


def test_whatever_is_cut_or_flipped_is_read_or_refused_in_one_sentence(
    recording, tmp_path, capfd
):
    whole = recording.with_suffix(".mf4").read_bytes()
    rng, path = random.Random(2), tmp_path / "damaged.mf4"
    complaints = []
    for number in range(60):
        data = bytearray(whole[: rng.randrange(len(whole))] if number % 2 else whole)
        for _ in range(number % 7):
            data[rng.randrange(min(len(data), 4000))] = rng.randrange(256)
        path.write_bytes(data)
        try:
            read_log(path)
        except LogError as error:
            complaints.append(str(error))
    assert len(complaints) > 30
    assert all(text.startswith(f"{path}: ") and "\n" not in text for text in complaints)
    assert capfd.readouterr() == ("", "")


def test_a_column_that_its_run_does_not_know_is_a_sentence(tmp_path):
    path = tmp_path / "renamed.mf4"
    run = run_of() | {"states": []}
    with asammdf.MDF() as mdf:
        names = ("t_s", "segment", *NAMES[1:], "another")
        mdf.append(
            [asammdf.Signal(np.zeros(3), np.arange(3.0), name=name) for name in names]
        )
        mdf.attach(json.dumps(run).encode(), META, mime="application/json")
        mdf.save(path)
    with pytest.raises(LogError, match="does not list the signal 'another'"):
        read_log(path)


def test_mf4_of_others_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "theirs.mf4"
    with asammdf.MDF() as mdf:
        mdf.append(
            [asammdf.Signal(np.arange(3.0), np.arange(3.0), name="n_FL", unit="1/min")]
        )
        mdf.save(path)
    with pytest.raises(
        LogError, match=r"not written by hilserver .*; export it as CSV"
    ):
        read_log(path)


def test_without_the_library_it_is_a_sentence(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(
        LogError, match=r"needs the library asammdf; install .*hilserver\[mdf\]"
    ):
        read_log(recording.with_suffix(".mf4"))
    assert commands.main(["convert", str(recording), str(tmp_path / "x.mf4")]) == 2
