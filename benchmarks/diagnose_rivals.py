"""The table of the diagnosis and its rivals, one column each, on the logs that all of them got."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from benchmarks.diagnose_table import Record

QUANTITIES: Final = {
    "position_m": "position", "yaw_rad": "yaw", "gyro_z_rad_s": "turn rate"
}  # fmt: skip
DIAGNOSIS, PYSINDY = "diagnosis", "PySINDy"


def rival_table(records: Sequence[Record]) -> list[str]:
    """Return the table; empty if no rival was run."""
    mine = [record for record in records if "gains" in record]
    if not mine:
        return []
    rivals = list(mine[0]["gains"])
    lines = [
        f"| measure | logs | {DIAGNOSIS} | {' | '.join(rivals)} |",
        "|---" * (len(rivals) + 3),
    ]
    lines[1] += "|"
    for group, measure, hit in (
        ("single", "right name, and no other", _right),
        ("single", "a wrong name", lambda answer: bool(answer["wrong"])),
        (
            "null",
            "findings without an effect",
            lambda answer: answer["outcome"] == "false_alarm",
        ),
    ):
        some = [record for record in mine if record["group"] == group]
        if some:
            counts = {
                DIAGNOSIS: sum(hit(record) for record in some),
                PYSINDY: sum(hit(record["pysindy"]) for record in some),
            }
            cells = [counts.get(name, "") for name in (DIAGNOSIS, *rivals)]
            lines.append(f"| {measure} | {len(some)} | {' | '.join(map(str, cells))} |")
    for group, title in (("single", "single cause"), ("null", "nothing hidden")):
        some = [record for record in mine if record["group"] == group]
        for key, quantity in QUANTITIES.items():
            columns = [[record["gain"].get(key, 1.0) for record in some]]
            columns += [
                [record["gains"][rival].get(key, 1.0) for record in some]
                for rival in rivals
            ]
            if some:
                cells = [f"{np.exp(np.mean(np.log(column))):.2f}" for column in columns]
                lines.append(
                    f"| gain in {quantity}, {title} | {len(some)} | {' | '.join(cells)} |"
                )
    return [*lines, ""]


def _right(answer: dict[str, Any]) -> bool:
    return bool(answer["outcome"] == "right" and not answer["wrong"])
