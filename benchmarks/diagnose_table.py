"""The table of the campaign: each row a count, its 95 % interval and its bound."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from benchmarks.binomial import clopper_pearson
from hilserver.bench.report import Result

Record = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """One row: `count` of `trials`.

    Attributes
    ----------
    least, most : float or None
        Bounds of the share; None: only reported.
    """

    name: str
    count: int
    trials: int
    least: float | None = None
    most: float | None = None

    @property
    def share(self) -> float:
        """Count divided by trials; NaN without trials."""
        return self.count / self.trials if self.trials else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of Clopper and Pearson."""
        return clopper_pearson(self.count, self.trials)

    @property
    def verdict(self) -> str:
        """Yes, no, or nothing if there is no bound or no trial."""
        if not self.trials or (self.least is None and self.most is None):
            return ""
        low, high = self.least or 0.0, 1.0 if self.most is None else self.most
        return "yes" if low <= self.share <= high else "no"

    def as_result(self) -> Result:
        """Return the row as the bench writes it."""
        bound = self.least if self.least is not None else self.most
        raw = {"count": self.count, "trials": self.trials, "ci95": self.interval}
        return Result(
            self.name,
            100.0 * self.share,
            "%",
            bound and 100.0 * bound,
            "bound",
            raw=raw,
        )


def rows(records: Sequence[Record]) -> list[Row]:
    """Return the rows of the specification's table that these records can fill."""

    def row(
        name: str,
        group: str,
        hit: Callable[[Record], bool],
        least: float | None = None,
        most: float | None = None,
    ) -> Row:
        trials = [
            r for r in records if group in {r["group"], "any"} and r["group"] != "size"
        ]
        return Row(name, sum(map(hit, trials)), len(trials), least, most)

    values = [
        v for r in records if r["group"] == "single" for v in r["values"].values()
    ]
    judged = [v for v in values if v["in_ci95"] is not None]
    held = [r["ellipsoid"]["inside"] for r in records if r.get("ellipsoid")]
    rival = [v for r in records for v in r.get("sysid", {}).values()]
    sized = [r for r in records if r["group"] == "size"]
    return [
        row(
            "findings without an effect",
            "null",
            lambda r: r["outcome"] == "false_alarm",
            most=0.0,
        ),
        row(
            "ordinary sensors: more than their faults",
            "sensors",
            _more_than_faults,
            most=0.0,
        ),
        row("right name, single cause", "single", _right, least=0.9),
        row("named alone", "single", lambda r: named_how(r) == "alone"),
        row(
            "named in a group of two",
            "single",
            lambda r: named_how(r) == "group of two",
        ),
        row(
            "named in a larger group",
            "single",
            lambda r: named_how(r) == "larger group",
        ),
        row(
            "named beside another finding",
            "single",
            lambda r: named_how(r) == "beside another",
        ),
        row(
            "missed: structure or nothing instead of a name",
            "single",
            _missed,
            most=0.05,
        ),
        Row(
            "value within its ci95",
            sum(v["in_ci95"] for v in judged),
            len(judged),
            least=0.9,
        ),
        Row(
            "value within 20 %",
            sum(v["within_20"] for v in values),
            len(values),
            least=0.9,
        ),
        Row("ellipsoid of 90 % holds the truth", sum(held), len(held), 0.85, 0.95),
        Row("mujoco.sysid: in its ci95", sum(v["in_ci95"] for v in rival), len(rival)),
        Row(
            "mujoco.sysid: within 20 %", sum(v["within_20"] for v in rival), len(rival)
        ),
        row(
            "confidently wrong, all tests", "any", lambda r: bool(r["wrong"]), most=0.02
        ),
        row("a patch makes a quantity worse, all logs", "any", _worse, most=0.0),
        row("diagnosis broke off, all tests", "any", _broken, most=0.0),
        row("outside the library flagged", "outside", _right, least=0.7),
        row("two effects: both named", "pair", _right, least=0.75),
        row("twins come out as a group", "twin", _right, least=0.9),
        row("faults of the data named", "fault", _right, least=0.9),
        row("drift named", "drift", _right, least=0.9),
        row("scenarios of the thesis", "scenario", _right, least=0.95),
        Row(
            "found at 1 x smallest size", sum(map(_right, sized)), len(sized), 0.7, 0.95
        ),
    ]


def named_how(record: Record) -> str:
    """Return how the truth of a log with one cause was named; empty if it was not."""
    if not _right(record) or not record["found"]:
        return ""
    groups = [found.partition(":")[2].split("|") for found in record["found"]]
    holding = [group for group in groups if record["name"] in group]
    if len(holding) < len(groups):
        return "beside another"
    return {1: "alone", 2: "group of two"}.get(max(map(len, holding)), "larger group")


def _alarmed(record: Record) -> bool:
    return bool(record["outcome"] == "false_alarm")


def _more_than_faults(record: Record) -> bool:
    """Return whether more than the true faults was found in a sound machine's log."""
    return bool(record["wrong"]) or any(
        "data_fault:" not in found for found in record["found"]
    )


def _worse(record: Record) -> bool:
    return bool(record.get("worse"))


def _broken(record: Record) -> bool:
    return bool(record["outcome"] == "crashed")


def _missed(record: Record) -> bool:
    return record["outcome"] in {"missed", "unknown"}


def _right(record: Record) -> bool:
    return bool(record["outcome"] == "right" and not (record["wrong"]))


def markdown(records: Sequence[Record], heading: Iterable[str]) -> str:
    """Return the table, the causes one by one, and which cause was taken for which."""
    lines = [*heading, "", "| measure | figure | ci95 | logs | bound | reached |"]
    lines.append("|---|---|---|---|---|---|")
    for row in rows(records):
        if not row.trials:
            continue
        low, high = row.interval
        bound = _bound(row)
        lines.append(
            f"| {row.name} | {100 * row.share:.1f} % ({row.count} of {row.trials}) "
            f"| {100 * low:.1f} .. {100 * high:.1f} % | {row.trials} | {bound} | {row.verdict} |"
        )
    lines += ["", *_seconds(records), "", *_each(records), "", *_confusion(records)]
    return "\n".join(lines) + "\n"


def _bound(row: Row) -> str:
    if row.least is not None and row.most is not None:
        return f"{100 * row.least:g} .. {100 * row.most:g} %"
    if row.least is not None:
        return f">= {100 * row.least:g} %"
    return "" if row.most is None else f"<= {100 * row.most:g} %"


def _seconds(records: Sequence[Record]) -> list[str]:
    taken = sorted(record["seconds"] for record in records)
    if not taken:
        return []
    lines = [
        f"Time per log: median {taken[len(taken) // 2]:.2f} s, longest {taken[-1]:.2f} s."
    ]
    widths = [r["ellipsoid"]["width"] for r in records if r.get("ellipsoid")]
    if widths:
        lines[0] += (
            f" Ellipsoids: median half axis {100 * median(widths):.1f} % of the effect."
        )
    return lines


def _each(records: Sequence[Record]) -> list[str]:
    outcomes = ("right", "missed", "vague", "unknown", "crashed")
    lines = [
        f"| class | case | logs | {' | '.join(outcomes)} | false name | value in ci95 | sysid |"
    ]
    lines.append("|---" * (len(outcomes) + 6) + "|")
    cases = sorted({(r["group"], r["name"]) for r in records if r["group"] != "pair"})
    for group, name in cases:
        mine = [r for r in records if (r["group"], r["name"]) == (group, name)]
        counted = Counter(r["outcome"] for r in mine)
        counts = " | ".join(str(counted[outcome]) for outcome in outcomes)
        wrong = sum(bool(r["wrong"]) for r in mine)
        inside = [_inside(mine, by) for by in ("values", "sysid")]
        cells = [group, name, len(mine), counts, wrong, *inside]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return lines


def _inside(records: Sequence[Record], by: str) -> str:
    """Return how many intervals contain the truth."""
    inside = [v["in_ci95"] for r in records for v in r.get(by, {}).values()]
    return f"{sum(map(bool, inside))} of {len(inside)}" if inside else ""


def _confusion(records: Sequence[Record]) -> list[str]:
    """Return the findings for each single cause, most frequent first."""
    lines = ["| hidden | said (times) |", "|---|---|"]
    for name in sorted(
        {r["name"] for r in records if r["group"] in {"single", "outside"}}
    ):
        said: Counter[str] = Counter()
        for record in records:
            if record["name"] == name and record["group"] in {"single", "outside"}:
                said.update(record["found"] or ["nothing"])
        answers = ", ".join(
            f"{what.replace('|', ' = ')} ({n})" for what, n in said.most_common(8)
        )
        lines.append(f"| {name} | {answers} |")
    return lines
