"""The evidence of several groups of logs as one: plots continue from group to group."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hilserver.config.patch import FittedIn
from hilserver.diagnosis.schema.decisions import ScreenRow
from hilserver.diagnosis.schema.evidence import ChannelSeries, Evidence
from hilserver.diagnosis.schema.findings import Interval

PATHS_EACH = 2  # paths of every group that are drawn


def merged(parts: Mapping[str, Evidence]) -> Evidence:
    """Return the evidence of all groups; tables name the group of a row, if there are any."""
    first = next(iter(parts.values()))
    if len(parts) == 1:
        return first
    many = parts.items()
    return Evidence(
        series=_series(parts.values()),
        paths=tuple(replace(p, group=g) for g, e in many for p in e.paths[:PATHS_EACH]),
        cuts=tuple(
            replace(r, channel=f"{r.channel} ({g})") for g, e in many for r in e.cuts
        ),
        screen=_screen(parts.values()),
        similarity=first.similarity,
        dependences=tuple(
            replace(d, channel=f"{d.channel} ({g})")
            for g, e in many
            for d in e.dependences
        ),
        courses=tuple(
            replace(c, cause=f"{c.cause} ({g})") for g, e in many for c in e.courses
        ),
        extension=first.extension,
        fitted=_range([e.fitted for e in parts.values()]),
        timings_s=first.timings_s,
        remarks=tuple(dict.fromkeys(f"{g}: {r}" for g, e in many for r in e.remarks)),
    )


def _series(parts: Iterable[Evidence]) -> tuple[ChannelSeries, ...]:
    """Return every channel over all groups, one after the other."""
    found: dict[str, ChannelSeries] = {}
    for item in (item for part in parts for item in part.series):
        known = found.get(item.name)
        if known is None:
            found[item.name] = item
            continue
        a, b = known.extended, item.extended
        found[item.name] = replace(
            known,
            t_s=np.concatenate([known.t_s, item.t_s]),
            measured=np.concatenate([known.measured, item.measured]),
            simulated=np.concatenate([known.simulated, item.simulated]),
            extended=None if a is None or b is None else np.concatenate([a, b]),
            run=np.concatenate(
                [known.run, item.run + int(known.run.max(initial=-1)) + 1]
            ),
        )
    return tuple(found.values())


def _screen(parts: Iterable[Evidence]) -> tuple[ScreenRow, ...]:
    """Return every cause as in the group that shows it most clearly."""
    rows: dict[str, ScreenRow] = {}
    for row in (row for part in parts for row in part.screen):
        if row.cause not in rows or abs(row.statistic) > abs(rows[row.cause].statistic):
            rows[row.cause] = row
    return tuple(rows.values())


def _range(parts: Sequence[FittedIn]) -> FittedIn:
    """Return what the machine did in all groups together."""

    def whole(name: str) -> Interval | None:
        ends = [end for p in parts for end in getattr(p, name) or ()]
        return (min(ends), max(ends)) if ends else None

    names = ("speed_m_s", "wheel_speed_rpm", "turn_rate_rad_s", "voltage_v")
    return FittedIn(**{name: whole(name) for name in names})
