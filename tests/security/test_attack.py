"""`hilserver bench attack` in small: a real daemon, 500 malformed packets and all floods."""

import asyncio
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from benchmarks.attack_figures import ATTACK, CONTROL, IDLE, Block, Campaign, results
from benchmarks.attack_floods import FLOODS
from benchmarks.attack_packets import STAGES, captures, packets
from benchmarks.poisson import block_ratio_interval, rate_ratio_interval
from benchmarks.wire import Wire
from tests.io.opcua_server.rig import Rig


def campaign(path: Path, *sizes: str, timeout_s: float) -> dict[str, dict]:
    """Run the bench; a crash of the daemon ends it with an error."""
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "bench",
        "attack",
        "--json",
        str(path),
        *sizes,
    ]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=timeout_s
    )
    assert done.returncode == 0, done.stderr
    return {row["name"]: row for row in json.loads(path.read_text())["results"]}


def check(found: dict[str, dict], count: int) -> None:
    raw = found["malformed_packets"]["raw"]
    assert found["malformed_packets"]["value"] == count
    assert set(raw["sent"]) == set(STAGES)
    assert raw["not_sent"] == 0
    assert raw["unanswered"] == []
    assert found["memory_growth_mb"]["value"] < 50
    names = {block["name"] for block in raw["blocks"]}
    assert names == {"idle", "packets", *FLOODS}
    if len(os.sched_getaffinity(0)) > 1:
        assert found["pacing_priority"]["raw"]["plant_core"] == max(
            os.sched_getaffinity(0)
        )
    # A healthy client was served beside them; the computer may hold it up for a short block.
    served = [block["reads"] > 0 for block in raw["blocks"]]
    assert sum(served) >= 0.8 * len(served)


def test_five_hundred_packets_and_the_floods(tmp_path: Path) -> None:
    sizes = (
        "--packets",
        "500",
        "--idle-s",
        "0.5",
        "--flood-s",
        "1",
        "--rounds",
        "1",
        "--no-control",
    )
    check(campaign(tmp_path / "attack.json", *sizes, timeout_s=800), 500)


MOST_TIMES = 2.0
"""So many times the missed ticks of the reference are shown to be too many."""
NONE_PER_S = 0.01
ROUNDS = 9
"""At a tick missed in 12 s, as measured, enough for an interval of 0.63 to 1.6 about 1."""


def no_more_ticks_missed(found: dict[str, dict], name: str) -> None:
    """The interval of the ratio holds no doubling; few ticks in 100 s need no interval."""
    low, high = (found[f"{name}_rate_ratio_{end}"]["value"] for end in ("low", "high"))
    per_s = found[f"{name}_per_s"]["value"]
    assert low <= 1.0, f"{name}: more, {low:.2f} to {high:.2f} times"
    assert high < MOST_TIMES or per_s < NONE_PER_S, (
        f"{name}: undecided, {low:.2f} to {high:.2f}"
    )


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_the_whole_campaign(tmp_path: Path) -> None:
    path = tmp_path / "attack.json"
    sizes = ("--rounds", str(ROUNDS), "--packets", "100000")
    found = campaign(path, *sizes, timeout_s=7100)
    check(found, 100_000)
    # Control comes before monitoring: the peer's set-points are hardly older, and none too old.
    assert found["safe_ticks"]["value"] == 0
    assert found["peer_age_p99_ms"]["ratio"] <= 2.0
    # The plant misses no more ticks than at rest (spec 3).
    no_more_ticks_missed(found, "missed_ticks")
    no_more_ticks_missed(found, "missed_ticks_to_load")


def test_a_campaign_of_this_size_notices_twice_and_two_and_a_half_times_as_much() -> (
    None
):
    def found(missed: tuple[int, ...]) -> dict[str, dict]:
        blocks = [
            block(kind, number, 0.0)
            for _ in range(ROUNDS * len(FLOODS) // 5)
            for kind, five in ((IDLE, (0, 1, 0, 1, 0)), (ATTACK, missed))
            for number in five
        ]
        rows = results(Campaign(blocks=blocks))
        return {row.name: {"value": row.value} for row in rows}

    no_more_ticks_missed(found((0, 1, 0, 1, 0)), "missed_ticks")
    no_more_ticks_missed(found((0, 0, 0, 0, 0)), "missed_ticks")
    for more in ((1, 1, 1, 1, 1), (1, 1, 0, 1, 1)):
        with pytest.raises(AssertionError, match=r"undecided|more"):
            no_more_ticks_missed(found(more), "missed_ticks")


def test_the_same_seed_makes_the_same_packets() -> None:
    first, again = list(packets(500, 7)), list(packets(500, 7))
    assert first == again
    assert first != list(packets(500, 8))
    assert {packet.stage for packet in first} == set(STAGES)
    valid = set(captures())
    changed = [packet for packet in first if packet.data not in valid]
    assert len(changed) > 0.9 * len(first)
    assert all(packet.data for packet in first)


@pytest.mark.asyncio
async def test_the_captures_are_valid(tmp_path: Path) -> None:
    """Unchanged, every request is answered in its session, so that mutations start from there."""
    rig = Rig(tmp_path)
    await rig.server.start()
    try:
        for data in captures():
            if data[:3] != b"MSG":
                continue
            async with Wire(rig.server.url) as wire:
                await wire.log_in()
                await wire.send(wire.message(data[24:]))
                kind, _ = await asyncio.wait_for(wire.receive(), 60)
                assert kind == b"MSG"
    finally:
        await rig.close()


@given(
    count=st.integers(0, 60), reference=st.integers(0, 60), factor=st.floats(0.2, 5.0)
)
def test_interval_is_that_of_clopper_and_pearson(
    count: int, reference: int, factor: float
) -> None:
    low, high = rate_ratio_interval(count, 10.0 * factor, reference, 10.0)
    total = count + reference
    p_low = stats.beta.ppf(0.025, count, total - count + 1) if count else 0.0
    p_high = stats.beta.ppf(0.975, count + 1, total - count) if reference else 1.0
    assert low == pytest.approx(p_low / (1 - p_low) / factor, rel=1e-6, abs=1e-12)
    if reference:
        assert high == pytest.approx(p_high / (1 - p_high) / factor, rel=1e-6)
    else:
        assert math.isinf(high)


def test_bursts_widen_the_interval_of_blocks_and_a_real_difference_is_still_found() -> (
    None
):
    burst, still = [(40, 5.0), *[(0, 5.0)] * 19], [(1, 5.0)] * 20
    low, high = rate_ratio_interval(40, 100.0, 20, 100.0)
    assert low > 1.0, "taken one by one, the ticks of the burst look like a difference"
    low, high = block_ratio_interval(burst, still)
    assert low < 1.0 < high
    low, high = block_ratio_interval([(4, 5.0), (6, 5.0)] * 10, still)
    assert 4.0 < low < 5.0 < high < 6.0
    low, high = block_ratio_interval([(0, 5.0)] * 5, [(0, 5.0)] * 5)
    assert low == high == 1.0


def block(kind: str, missed: int, stolen_s: float) -> Block:
    return Block(kind, kind, 5.0, missed, [1.0], 100.0, stolen_s)


def test_what_the_hypervisor_stole_is_told_apart() -> None:
    quiet = [block(kind, 1, 0.0) for kind in (IDLE, ATTACK, CONTROL)] * 10
    stolen = [block(ATTACK, 40, 0.05), block(CONTROL, 40, 0.05)] * 2
    found = {row.name: row for row in results(Campaign(blocks=quiet + stolen))}
    assert found["missed_ticks_per_s"].ratio == pytest.approx(90 / 60 / 0.2)
    assert found["missed_ticks_to_load_per_s"].ratio == 1.0
    assert found["missed_ticks_unstolen_per_s"].ratio == 1.0
    assert found["missed_ticks_unstolen_per_s"].raw["times_s"] == [50.0, 50.0]
    without = {row.name for row in results(Campaign(blocks=quiet[:2]))}
    assert "missed_ticks_to_load_per_s" not in without
