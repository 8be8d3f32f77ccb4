"""What doors show of the recalibration and request from it; without one it refuses."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from hilserver.errors import ControlRefused
from hilserver.metrics import Metric, by_name, counter

LOOKS: Final = (
    "named",
    "nothing",
    "as_running",
    "too_small",
    "unexplained",
    "data_fault",
    "not_judged",
)
OUTCOMES: Final = ("accepted", "rejected", "postponed", "refused", "undone")
"""Labels of the counts, which exist before the first one."""

Table = Mapping[str, Mapping[str, float | str | bool | int | None]]


class Decisions:
    """Decisions of an engineer on proposals; without recalibration they are refused."""

    async def accept(self, number: int, who: str) -> None:
        """Refuse."""
        raise ControlRefused(
            f"there is no proposal {number} for {who}: recalibration.enabled is false"
        )

    reject = postpone = accept

    def refused(self, sentence: str) -> None:
        """Do nothing: the answer has the reason."""

    def table(self) -> Table:
        """Return nothing."""
        return {}

    def view(self) -> dict[str, Any] | None:
        """Return None: there is no recalibration."""
        return None


@dataclass
class Figures:
    """Figures of the metrics."""

    # by verdict
    looks: Counter[str] = field(
        default_factory=lambda: Counter(dict.fromkeys(LOOKS, 0))
    )
    # by outcome
    decisions: Counter[str] = field(
        default_factory=lambda: Counter(dict.fromkeys(OUTCOMES, 0))
    )
    # windows that could not be judged, lines that could not be written
    failures: int = 0
    waits: bool = False  # a proposal is open
    changed: bool = False  # the gap has left its usual range since the last look
    is_looking: bool = False  # a diagnosis runs
    # by quantity: gap before / gap after, of the last decision whose effect was measured
    effect: dict[str, float] = field(default_factory=dict)


RECALIBRATION_METRICS: Final[tuple[Metric[Figures], ...]] = (
    Metric(
        "hil_recalibration_looks_total",
        "Diagnosed windows, by result.",
        ("verdict",),
        lambda now: (((name,), counter(n)) for name, n in sorted(now.looks.items())),
    ),
    Metric(
        "hil_recalibration_decisions_total",
        "Decisions on proposals: accepted, rejected, postponed, refused to the user, or undone"
        " because the patch could not be loaded.",
        ("outcome",),
        lambda now: (
            ((name,), counter(n)) for name, n in sorted(now.decisions.items())
        ),
    ),
    Metric(
        "hil_recalibration_failures_total",
        "Windows that could not be diagnosed, and history lines that could not be written.",
        (),
        lambda now: [((), counter(now.failures))],
    ),
    Metric(
        "hil_recalibration_proposal_open",
        "1 while a proposal waits for an engineer, else 0; postponed ones do not count.",
        (),
        lambda now: [((), float(now.waits))],
    ),
    Metric(
        "hil_recalibration_gap_changed",
        "1 while the gap is outside its usual range and no look has followed yet, else 0.",
        (),
        lambda now: [((), float(now.changed))],
    ),
    Metric(
        "hil_recalibration_looking",
        "1 while a window is being diagnosed, else 0.",
        (),
        lambda now: [((), float(now.is_looking))],
    ),
    Metric(
        "hil_recalibration_effect_ratio",
        "Gap before the last accepted proposal divided by the gap after it; above 1: better.",
        ("quantity",),
        lambda now: by_name(now.effect),
    ),
)
