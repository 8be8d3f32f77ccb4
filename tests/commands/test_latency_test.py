"""The command latency-test, for real but briefly."""

import json

import numpy as np
import pytest

from hilserver.bench.report import percentile_us
from hilserver.commands import main
from hilserver.commands.latency_test import histogram_lines


def test_prints_histogram_percentiles_audit_and_how_to_read_them(capsys, tmp_path):
    path = tmp_path / "latency.json"
    assert main(["latency-test", "--duration", "3", "--json", str(path)]) == 0
    text = capsys.readouterr().out
    for word in (
        "10 to 20",
        "p99.9",
        "max",
        "kernel",
        "thread_priority",
        "How to read this",
    ):
        assert word in text
    document = json.loads(path.read_text())
    assert document["schema"] == "hilserver.bench/1"
    names = [result["name"] for result in document["results"]]
    assert names == [f"wake_latency_{n}_us" for n in ("p50", "p99", "p99.9", "max")]
    raw = document["results"][-1]["raw"]
    counts = np.zeros(20_000, dtype=np.int64)
    for latency, count in raw["histogram_us"].items():
        counts[int(latency)] = count
    assert counts.sum() + raw["missed_ticks"] > 0
    assert document["results"][0]["value"] == percentile_us(counts, 50.0)
    assert {item["name"] for item in raw["audit"]} >= {
        "governor",
        "swap",
        "memory_lock",
    }


def test_every_sample_is_in_one_line():
    counts = np.zeros(20_000, dtype=np.int64)
    counts[[0, 1, 19, 20, 999, 19_999]] = [1, 2, 4, 8, 16, 32]
    lines = histogram_lines(counts)
    assert sum(int(line.split("us")[1].split()[0]) for line in lines) == 63
    assert lines[-1].startswith(" 10000 and more")


@pytest.mark.parametrize("words", [["--duration", "0"], ["--period-us", "3"]])
def test_senseless_values_are_refused(words, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["latency-test", *words])
    assert stop.value.code == 2
    assert "between" in capsys.readouterr().err
