"""The outcomes of all attempts: as a table for the terminal, as CSV and as JSON."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.output import TRIED
from hilserver.diagnosis.power.attempts import (
    TIMES_SMALLEST,
    Attempt,
    AttemptOutcome,
    Outcome,
    outcome_of,
)

SCHEMA: Final = "hilserver.power/1"
POWER_NO_PROOF: Final = (
    "Power, no proof: each effect is the plant's own formula, put into this recording; a machine"
    " may differ in other ways."
)
OUTCOMES: Final[dict[Outcome, str]] = {
    "named": "named",
    "group": "in group",
    "seen": "no name",
    "nothing": "-",
    "failed": "failed",
}
CELL_WIDTH: Final = 10


@dataclass(frozen=True)
class PowerRow:
    """What became of one attempt."""

    attempt: Attempt
    outcome: Outcome
    wrong: tuple[str, ...]
    error: str

    def as_dict(self) -> dict[str, object]:
        """Return it with plain values."""
        attempt = self.attempt
        return {
            "cause": attempt.cause,
            "unit": attempt.unit,
            "smallest_detectable": attempt.smallest,
            "size": attempt.size,
            "parameter": attempt.value,
            "predicted_power": round(attempt.predicted, 4),
            "outcome": self.outcome,
            "wrong_names": list(self.wrong),
            "error": self.error,
        }


def rows_of(
    attempts: Sequence[Attempt],
    results: dict[int, AttemptOutcome],
    control: AttemptOutcome,
) -> list[PowerRow]:
    """Return the rows of the attempts that have results, in the order of the attempts."""
    rows = []
    for index, result in sorted(results.items()):
        outcome, wrong = outcome_of(attempts[index], result, control)
        rows.append(PowerRow(attempts[index], outcome, wrong, result.error))
    return rows


def files_of(rows: Sequence[PowerRow], planned: int) -> dict[str, str]:
    """Return the texts of the files, by name."""
    of_csv, of_json = TRIED
    plain = [row.as_dict() for row in rows]
    head = {"schema": SCHEMA, "says": POWER_NO_PROOF, "planned": planned}
    whole = json.dumps(head | {"attempts": plain}, indent=1) + "\n"
    if not plain:
        return {of_json: whole}
    out = io.StringIO()
    writer = csv.DictWriter(out, list(plain[0]), lineterminator="\n")
    writer.writeheader()
    for row, values in zip(rows, plain, strict=True):
        writer.writerow(values | {"wrong_names": " ".join(row.wrong)})
    return {of_csv: out.getvalue(), of_json: whole}


def lines_of(rows: Sequence[PowerRow], planned: int) -> list[str]:
    """Return the table for the terminal."""
    if not rows:
        return ["No effect could be tried on this recording."]
    sizes = sorted(TIMES_SMALLEST)
    causes = list(dict.fromkeys(row.attempt.cause for row in rows))
    first = max(len(cause) for cause in (*causes, "effect"))
    heads = "".join(f"{f'{times:g} x':>{CELL_WIDTH}}" for times in sizes)
    out = [f"{'effect':<{first}}  {'smallest detectable':>20}{heads}  wrong names"]
    for cause in causes:
        own = {row.attempt.times: row for row in rows if row.attempt.cause == cause}
        attempt = next(iter(own.values())).attempt
        cells = [OUTCOMES[own[one].outcome] if one in own else "" for one in sizes]
        shown = "".join(f"{cell:>{CELL_WIDTH}}" for cell in cells)
        wrong = sorted({name for row in own.values() for name in row.wrong})
        size = number(attempt.smallest, attempt.unit, digits=2)
        out.append(f"{cause:<{first}}  {size:>20}{shown}  {', '.join(wrong)}".rstrip())

    named = sum(row.outcome == "named" for row in rows)
    in_group = sum(row.outcome == "group" for row in rows)
    expected = sum(row.attempt.predicted for row in rows)
    wrong_in = sum(bool(row.wrong) for row in rows)
    out.append(
        f"{len(rows)} of {planned} tried: named in {named}, in a group in {in_group}; predicted for"
        f" both together {expected:.0f}. A wrong name in {wrong_in}."
    )
    return [*out, POWER_NO_PROOF]
