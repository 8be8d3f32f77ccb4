"""Comparing with cyclictest: percentiles, its output, the figures made from blocks."""

import argparse
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.bench import cyclictest, jitter
from hilserver.bench.report import (
    median_of_blocks_us,
    percentile_us,
    ratio_interval,
    sparse,
)
from hilserver.errors import FailedError

OUTPUT = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000007 000120
000008 004000
000150 000003
# Total: 000004123
# Min Latencies: 00007
# Histogram Overflows: 00002
# Histogram Overflow at cycle number:
# Thread 0: 00042 00043
"""


def histogram(samples, bins=2000):
    return np.bincount(np.asarray(samples, dtype=np.int64), minlength=bins)


@given(
    st.lists(st.integers(0, 1999), min_size=1, max_size=300),
    st.sampled_from([50.0, 99.0, 99.9]),
)
def test_percentile_is_the_smallest_value_that_enough_samples_do_not_exceed(
    samples, percent
):
    value = percentile_us(histogram(samples), percent)
    samples = np.array(samples)
    assert (samples <= value).sum() * 1000 >= round(percent * 10) * len(samples)
    assert (samples <= value - 1).sum() * 1000 < round(percent * 10) * len(samples)


def test_percentile_without_samples_is_not_a_number():
    assert np.isnan(percentile_us(histogram([]), 50.0))


def test_output_of_cyclictest():
    counts = cyclictest.parse(OUTPUT, 200)
    assert sparse(counts) == {"7": 120, "8": 4000, "150": 3, "199": 2}
    with pytest.raises(FailedError, match="printed no histogram"):
        cyclictest.parse("unable to set scheduler\n", 200)


def test_command_line_says_what_is_measured(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    line = cyclictest.command(period_us=1000, priority=80, duration_s=5, bins=400)
    assert " ".join(line) == "/usr/bin/cyclictest -q -m -t 1 -p 80 -i 1000 -D 5 -h 400"
    line = cyclictest.command(period_us=1000, priority=0, duration_s=5, bins=400)
    assert "--policy=other" in line


def test_absent_or_failing_cyclictest_is_one_sentence(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(FailedError, match="apt-get install rt-tests"):
        cyclictest.command(period_us=1000, priority=80, duration_s=5, bins=400)
    with pytest.raises(FailedError, match="cyclictest failed: no permission"):
        cyclictest.run(["sh", "-c", "echo no permission >&2; exit 1", "-h", "400"], 1)

    def hang(*_, **options):
        raise subprocess.TimeoutExpired("cyclictest", options["timeout"])

    monkeypatch.setattr("subprocess.run", hang)
    with pytest.raises(FailedError, match="did not end within 31 s"):
        cyclictest.run(["cyclictest", "-h", "400"], 1)


def test_figures_are_medians_over_blocks_and_keep_the_raw_data():
    comparison = jitter.BackEndBlocks(
        "thread", command=["cyclictest"], load=["ten clients"]
    )
    comparison.subject = [histogram([latency] * 10) for latency in (30, 12, 900)]
    comparison.reference = [histogram([latency] * 10) for latency in (20, 15, 1000)]
    result = comparison.result(99.9, "")
    assert result.name == "wake_latency_p99.9_us"
    assert (result.value, result.reference, result.ratio) == (30.0, 20.0, 1.5)
    assert result.raw["blocks_us"] == [30.0, 12.0, 900.0]
    low, high = result.raw["ratio_interval_95"]
    assert low <= 1.5 <= high
    assert comparison.raw["histograms"][2] == {"900": 10}
    assert comparison.raw["cyclictest_command"] == ["cyclictest"]
    assert comparison.result(50.0, "timerfd_").name == "timerfd_wake_latency_p50_us"


def test_interval_is_narrow_where_blocks_agree_and_wide_where_they_do_not():
    same = [histogram([20 + i % 2] * 10) for i in range(10)]
    torn = [histogram([20 if i % 2 else 1500] * 10) for i in range(10)]
    assert median_of_blocks_us(same, 50.0) == 20.5
    low, high = ratio_interval(same, same, 99.9)
    assert high - low < 0.2
    low, high = ratio_interval(torn, torn, 99.9)
    assert high / low > 10


@pytest.mark.long
def test_bare_pacing_against_the_real_cyclictest():
    parser = argparse.ArgumentParser()
    jitter.add_arguments(parser)
    words = "--subject pacing --backend thread --blocks 2 --block-s 1"
    results = jitter.run(parser.parse_args(words.split()))
    assert [r.name for r in results] == [
        f"wake_latency_p{p}_us" for p in ("50", "99", "99.9")
    ]
    for counts in (
        results[0].raw["histograms"] + results[0].raw["cyclictest_histograms"]
    ):
        assert 300 < sum(counts.values()) < 1300
    assert all(r.value > 0 and r.reference > 0 for r in results)
