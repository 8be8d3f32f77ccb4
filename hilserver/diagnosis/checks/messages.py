"""Messages that are in a log twice: all channels of a source stay the same for a row.

Rounded readings sometimes stay the same, each on its own. If those of a source only ever stay the
same all together, its message was repeated and carries no news. Repetitions with the rhythm of a
slower clock are left to `repetitions`.
"""

from collections.abc import Iterator
from itertools import groupby

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.checks.repetitions import changes_s, held
from hilserver.diagnosis.checks.runs import (
    Faults,
    RunFault,
    alternates,
    corrected,
    rate_fault,
    runs_of,
)
from hilserver.diagnosis.checks.support import (
    data_fault,
    listed,
    measured_channels,
    standing,
    subset,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_SAMPLES,
    HELD_SLOWEST_HZ,
    NEGLIGIBLE,
    SLOWER_CLOCK,
)
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find(log: MeasuredLog, _: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find repeated messages and leave them out: the first of each counts, with its stamp."""
    findings: list[Finding] = []
    changes = changes_s(log)
    for names in list(_sources(log)):
        found = repetitions([log[name] for name in names], standing(log, log[names[0]]))
        evenly = (held(log[name], runs_of(log[name]), changes) for name in names)
        if found is not None and None in evenly:  # `repetitions` handles clocks better
            again, share = found
            faults = {
                name: RunFault(subset(log[name], ~again), share) for name in names
            }
            findings.append(_finding(log, faults))
            log = corrected(log, faults)
    return log, findings


def _sources(log: MeasuredLog) -> Iterator[list[str]]:
    """Yield the channels that come in one message: of one kind, with the same stamps.

    Wheels that keep their speed to the bit are simulated.
    """

    def kind(name: str) -> tuple[str, str]:
        group, _, rest = name.partition(".")
        return group, rest.rpartition(".")[2] if group == "wheel" else ""

    for (group, _), of_kind in groupby(
        sorted(measured_channels(log.channels), key=kind), key=kind
    ):
        names = list(of_kind)
        alike = all(
            np.array_equal(log[name].t_s, log[names[0]].t_s) for name in names[1:]
        )
        if alike and (group != "wheel" or _are_noisy(log, names)):
            yield names


def _are_noisy(log: MeasuredLog, names: list[str]) -> bool:
    steps = [np.diff(log[name].values) for name in names]
    return any(alternates(one[one != 0.0]) for one in steps)


def repetitions(channels: list[Channel], stands: Mask) -> tuple[Mask, float] | None:
    """Return which samples of a source repeat the previous message, and their share; None if sound.

    Two equal columns count as one. A source that stays the same for long is at rest, or stuck; one
    that does so while the robot stands, or whose values are all zero or at a limit, is sound.

    Parameters
    ----------
    stands : ndarray of bool, shape (n,)
        Samples at which the robot stands.
    """
    t_s, span = channels[0].t_s, channels[0].span
    distinct: list[Array] = []
    for channel in channels:
        if not any(np.array_equal(channel.values, other) for other in distinct):
            distinct.append(channel.values)
    if len(distinct) < 2 or len(t_s) < FEWEST_SAMPLES:
        return None
    columns = np.stack(distinct)
    stays = np.zeros(columns.shape, dtype=bool)
    stays[:, 1:] = (np.diff(columns) == 0.0) & (np.diff(span) == 0)
    top = np.abs(columns).max(axis=1, keepdims=True)
    stays[:, ((columns == 0.0) | (np.abs(columns) == top)).all(axis=0)] = False
    again = np.asarray(stays.all(axis=0))
    alone = float((stays.any(axis=0) & ~again).mean())
    begins = np.flatnonzero(~again)
    length = np.diff(begins, append=len(t_s))
    short = t_s[begins + length - 1] - t_s[begins] < 1.0 / HELD_SLOWEST_HZ
    judged = np.repeat(short & ~np.logical_or.reduceat(stands, begins), length)
    again &= np.repeat(short, length)
    shown = float((again & judged).mean())
    if shown < NEGLIGIBLE or alone > NEGLIGIBLE * shown:
        return None
    return again, shown / float(judged.mean())


def _finding(log: MeasuredLog, faults: Faults) -> Finding:
    """Return the finding of one source: it is slow, or its messages are sometimes missing."""
    name, (_, share, _) = next(iter(faults.items()))
    if share > SLOWER_CLOCK:
        seconds = sum(span.end_s - span.start_s for span in log.spans)
        rate_hz = (1.0 - share) * len(log[name]) / seconds
        text = (
            "{names}: a new message arrives only {rate_hz} times a second and is repeated in the"
            " rows in between: leave these empty; the repetitions were dropped."
        )
        slow = {name: fault._replace(figure=rate_hz) for name, fault in faults.items()}
        return rate_fault("held_samples", slow, text)
    text = (
        f"{listed(list(faults))}: {100 * share:.2g} % of the messages appear twice in the log:"
        " leave rows without a new message empty; the repetitions were dropped."
    )
    return data_fault("dropouts", faults, share, (0.8 * share, 1.2 * share), "1", text)
