"""Results of a campaign of attacks: its blocks, and the figures made from them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from benchmarks.attack_packets import STAGES, Packet
from benchmarks.poisson import block_ratio_interval, rate_ratio_interval
from hilserver.bench.report import Result

READ_DEADLINE_S = 2.0
NO_ANSWER = "no answer"
IDLE, ATTACK, CONTROL = "idle", "attack", "control"
"""Kinds of blocks; a control block attacks a daemon that is not the subject."""
_MOST_KEPT = 20


@dataclass
class Block:
    """One block: what happened in it.

    Attributes
    ----------
    stolen_s : float
        Processor time that the hypervisor gave to others.
    ages_ms : list of float
        Age of the peer's newest set-points, in the sampled ticks.
    safe_ticks : int
        How many of these were in the safe state.
    """

    kind: str
    name: str
    duration_s: float
    missed_ticks: int
    reads_ms: list[float]
    memory_mb: float
    stolen_s: float = 0.0
    ages_ms: list[float] = field(default_factory=list)
    safe_ticks: int = 0


@dataclass
class Campaign:
    """All blocks, and the fate of the packets."""

    blocks: list[Block] = field(default_factory=list)
    sent: dict[str, int] = field(default_factory=lambda: dict.fromkeys(STAGES, 0))
    outcomes: dict[str, int] = field(default_factory=dict)
    slowest_s: float = 0.0
    not_sent: int = 0
    unanswered: list[str] = field(default_factory=list)
    baseline_mb: float = 0.0
    plant_core: int | None = None
    pacing_priority: int = 0

    def count(self, packet: Packet, outcome: str, duration_s: float) -> None:
        """Count one packet."""
        self.sent[packet.stage] += 1
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1
        self.slowest_s = max(self.slowest_s, duration_s)
        if outcome == NO_ANSWER and len(self.unanswered) < _MOST_KEPT:
            self.unanswered.append(f"{packet.stage}: {packet.data[:400].hex()}")


def results(campaign: Campaign) -> list[Result]:
    """Return the figures of a campaign."""
    idle, busy, control = (
        [block for block in campaign.blocks if block.kind == kind]
        for kind in (IDLE, ATTACK, CONTROL)
    )
    raw = {
        "sent": campaign.sent,
        "outcomes": dict(sorted(campaign.outcomes.items(), key=lambda row: -row[1])),
        "not_sent": campaign.not_sent,
        "unanswered": campaign.unanswered,
        "slowest_s": campaign.slowest_s,
        "blocks": [
            {
                "kind": block.kind,
                "name": block.name,
                "duration_s": round(block.duration_s, 2),
                "missed_ticks": block.missed_ticks,
                "reads": len(block.reads_ms),
                "read_p99_ms": _percentile(block.reads_ms, 0.99),
                "peak_memory_mb": round(block.memory_mb, 1),
                "stolen_s": round(block.stolen_s, 2),
                "peer_age_p99_ms": round(_percentile(block.ages_ms, 0.99), 1),
                "safe_ticks": block.safe_ticks,
            }
            for block in campaign.blocks
        ],
    }
    growth = max(block.memory_mb for block in campaign.blocks) - campaign.baseline_mb
    found = [
        Result("malformed_packets", sum(campaign.sent.values()), "1", raw=raw),
        Result("unanswered_packets", campaign.outcomes.get(NO_ANSWER, 0), "1"),
        Result(
            "slowest_answer_s",
            campaign.slowest_s,
            "s",
            READ_DEADLINE_S,
            "read deadline",
        ),
        Result(
            "memory_growth_mb", growth, "MB", campaign.baseline_mb, "before the attack"
        ),
    ]
    for percent in (50, 99):
        value = _percentile(
            [ms for block in busy for ms in block.reads_ms], percent / 100
        )
        reference = _percentile(
            [ms for block in idle for ms in block.reads_ms], percent / 100
        )
        ratio = value / reference if reference else None
        found.append(
            Result(
                f"healthy_read_p{percent}_ms",
                value,
                "ms",
                reference,
                "idle blocks",
                ratio,
            )
        )
    ages = [[ms for block in blocks for ms in block.ages_ms] for blocks in (busy, idle)]
    value, reference = (_percentile(rows, 0.99) for rows in ages)
    ratio = value / reference if reference else None
    found.append(
        Result("peer_age_p99_ms", value, "ms", reference, "idle blocks", ratio)
    )
    found.append(
        Result("safe_ticks", sum(block.safe_ticks for block in campaign.blocks), "1")
    )
    placement = {"plant_core": campaign.plant_core, "policy": "SCHED_FIFO"}
    found.append(
        Result("pacing_priority", campaign.pacing_priority, "1", raw=placement)
    )
    found += _missed("missed_ticks", busy, idle, "idle blocks")
    if control:
        found += _missed(
            "missed_ticks_to_load", busy, control, "the same load elsewhere"
        )
    # No priority regains time that the hypervisor takes, and it takes more from a busy computer.
    calm_busy, calm_idle = (
        [b for b in blocks if b.stolen_s == 0] for blocks in (busy, idle)
    )
    if calm_busy and calm_idle:
        found += _missed(
            "missed_ticks_unstolen", calm_busy, calm_idle, "idle, nothing stolen"
        )
    return found


def _missed(
    name: str, busy: Sequence[Block], reference: Sequence[Block], reference_name: str
) -> list[Result]:
    """Compare rates of missed ticks.

    Ticks may be missed in bursts, which is no Poisson process: the wider of the exact interval for
    Poisson rates and the bootstrap interval over blocks is given.
    """
    rows = [
        [(b.missed_ticks, b.duration_s) for b in blocks] for blocks in (busy, reference)
    ]
    (count, time_s), (ref_count, ref_s) = [
        (sum(missed for missed, _ in row), sum(time for _, time in row)) for row in rows
    ]
    poisson = rate_ratio_interval(count, time_s, ref_count, ref_s)
    blocks = block_ratio_interval(rows[0], rows[1])
    low, high = min(poisson[0], blocks[0]), max(poisson[1], blocks[1])
    ratio = count / time_s / (ref_count / ref_s) if ref_count else None
    raw = {
        "counts": [count, ref_count],
        "times_s": [time_s, ref_s],
        "poisson": [min(bound, 1e9) for bound in poisson],
        "bootstrap": blocks,
    }
    interval = "95 % interval"
    return [
        Result(
            f"{name}_per_s",
            count / time_s,
            "1/s",
            ref_count / ref_s,
            reference_name,
            ratio,
            raw,
        ),
        Result(f"{name}_rate_ratio_low", low, "1", 1.0, interval),
        Result(f"{name}_rate_ratio_high", min(high, 1e9), "1", 1.0, interval),
    ]


def _percentile(values: list[float], part: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else 0.0
