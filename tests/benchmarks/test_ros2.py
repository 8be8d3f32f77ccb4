"""What `bench ros2` makes of what its readers write."""

import argparse

import pytest

from benchmarks import ros2
from benchmarks.jitter import COMPANY, chosen


def test_losses_are_gaps_in_the_sequence_between_first_and_last():
    assert ros2.Stream(sequence=[5, 6, 7]).lost == 0
    assert ros2.Stream(sequence=[9, 5, 8]).lost == 2


def test_company_of_the_daemon_is_chosen_by_name():
    assert chosen("ros2,page,ros2") == (COMPANY["ros2"], COMPANY["page"])
    with pytest.raises(
        argparse.ArgumentTypeError, match=f"'cat' is none of {', '.join(COMPANY)}"
    ):
        chosen("page,cat")


@pytest.mark.long
def test_it_measures_next_to_two_other_programs():
    parser = argparse.ArgumentParser()
    ros2.add_arguments(parser)
    results = {r.name: r for r in ros2.run(parser.parse_args(["--seconds", "5"]))}
    for quality in ("reliable", "best_effort", "command"):
        latency = results[f"ros2_{quality}_latency_p50_us"]
        assert latency.value > 0
        assert latency.reference > 0
    assert results["ros2_reliable_lost_pct"].value == 0
