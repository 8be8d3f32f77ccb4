"""How late a robot stops: dead-man and Stop, idle, under every attack possible for a watcher, busy.

A client, a process of its own, drives over the page, OPC UA or ROS 2. Dead-man: it falls silent,
and time counts from its last message; only time beyond the configured deadline is late. Stop: time
counts from the press, over the page's open socket, for OPC UA by its method (while the interpreter
lock is held by the page, as everywhere else). Both end when the set-points begin to fall, read in
shared memory by another process. "busy" is two processes per core that take all the time they get,
as nice as the bench and its daemon: start it at nice 0. The whole bench takes an hour and a half.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hilserver.bench.report import Result
from tests.control.trials import ATTACKS, SOURCES

SEED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the choice and the number of trials."""
    parser.add_argument("--trials", type=int, default=200, help="for each figure")
    for name, known in (("source", SOURCES), ("attack", ATTACKS)):
        parser.add_argument(
            f"--{name}",
            action="append",
            choices=known,
            help="can be given again; default: all",
        )


def run(args: argparse.Namespace) -> list[Result]:
    """Run the trials; return the worst time of every row with its limit."""
    sources, attacks = args.source or SOURCES, args.attack or ATTACKS
    found: list[Result] = []
    pooled: dict[str, list[Any]] = {}
    for row in _rows(sources, attacks, args.trials):
        result = _result(row)
        print(
            f"{result.name}: {result.value:.1f} ms, {result.reference_name}",
            file=sys.stderr,
        )
        found.append(result)
        pooled.setdefault(row.what, []).append(row)
    return [*found, *(_pooled(what, rows) for what, rows in pooled.items())]


def _pooled(what: str, rows: list[Any]) -> Result:
    """Return the worst time of all sources and attacks; a row that failed has none."""
    late_ms = [one for row in rows for one in row.late_ms]
    worst_ms, limit_ms = max(late_ms, default=math.nan), rows[0].limit_ms
    failed = sum(bool(row.error) for row in rows)
    note = f"limit; {len(late_ms)} trials, {failed} rows failed"
    name, ratio = f"{what}_pooled", worst_ms / limit_ms
    return Result(
        name, worst_ms, "ms", reference=limit_ms, reference_name=note, ratio=ratio
    )


def _rows(sources: list[str], attacks: list[str], n: int) -> Iterator[Any]:
    from tests.control.clients import RefusedError  # noqa: PLC0415 - the clients of all sources
    from tests.control.robot import running_robot  # noqa: PLC0415
    from tests.control.trials import trials  # noqa: PLC0415
    from tests.control.trials.terminal import TerminalRobot  # noqa: PLC0415

    for source in sources:
        for attack in attacks:
            try:
                with (
                    tempfile.TemporaryDirectory() as folder,
                    running_robot(
                        Path(folder), TerminalRobot, **trials.SETTINGS
                    ) as robot,
                    trials.Trials(robot, source, attack, SEED) as tried,
                ):
                    for what in trials.WHATS:
                        yield tried.row(what, n)
            except (AssertionError, RefusedError, OSError) as error:
                # nobody got in: the other rows are worth having all the same
                why = f"{type(error).__name__}: {error}"
                for what in trials.WHATS:
                    yield trials.Row(what, source, attack, error=why)


def _result(row: Any) -> Result:
    note = f"limit; p50 {row.at(0.5):.1f}, p99 {row.at(0.99):.1f} of {len(row.late_ms)}"
    if row.n_stopped:
        note += f"; stopped before in {row.n_stopped}"
    if row.error:
        note += f"; {row.error}"
    worst_ms = row.at(1.0)
    return Result(
        f"{row.what}_{row.source}_{row.attack}",
        worst_ms,
        "ms",
        reference=row.limit_ms,
        reference_name=note,
        ratio=worst_ms / row.limit_ms,
        raw={
            "late_ms": row.late_ms,
            "stopped_before": row.n_stopped,
            "error": row.error,
        },
    )
