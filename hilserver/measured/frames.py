"""Rows that the daemon wrote: which of them hold a new sample, and when it was taken.

A row holds the values at its instant. Sensors run in their own slices, and between two samples
their output stays the same: that is one sample, taken at the last tick of its slice.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from hilserver.arrays import Array, Indices, Mask
from hilserver.config.root import Config
from hilserver.logs import Log
from hilserver.logs.provenance import configuration_of
from hilserver.measured.channels import MODE, OF_MODE, SETPOINTS
from hilserver.measured.names import is_input, known_signals
from hilserver.measured.thresholds import ENOUGH_ROWS, FEWEST_VALUES
from hilserver.signals import MEASURED, SAMPLED
from hilserver.status import BAD, UNCERTAIN

TICK: Final = "sim.tick"
COMMAND: Final = "internal.command"
POSE_REQUEST: Final = "internal.pose_request"
SECTIONS: Final = ("scheduler", "sensors", "plant")
RARE: Final = 0.05  # share of the samples
# times the usual time between samples; from there one is missing
GAP_STEPS: Final = 1.5
OLDEST_S: Final = 1.0  # a stamp that makes a sample older than this is wrong


@dataclass(frozen=True)
class Sampling:
    """Which slice of a configuration makes which outputs."""

    base_period_s: float
    # ticks from one sample to the next, by the first part of the signals' names
    ticks: Mapping[str, int]

    @classmethod
    def of(cls, config: Config) -> "Sampling":
        """Return the sampling of a configuration."""
        scheduler, sensors = config.scheduler, config.sensors
        base_ms = scheduler.base_period_ms

        def every(name: str) -> int:
            return max(round(scheduler.slices[name] / base_ms), 1)

        robot = every(config.plant.slice)
        nav = every(sensors.nav.slice)
        samples = max(round(1e3 / (sensors.nav.rate_hz * nav * base_ms)), 1)
        ticks = {"wheel": robot, "pose": robot, "velocity": robot, "nav": nav * samples}
        for name in ("imu", "battery", "tof"):
            ticks[name] = every(getattr(sensors, name).slice)
        ticks["shield"] = ticks["lights"] = ticks["battery"]
        return cls(base_ms * 1e-3, ticks)

    def period(self, name: str) -> int:
        """Return the ticks between two samples of an output."""
        return self.ticks.get(name.partition(".")[0], 1)


@dataclass(frozen=True)
class Frames:
    """The samples in the rows of a recording."""

    columns: Mapping[str, Array]  # shape (n,); NaN where a row holds no new sample
    # shape (n,); how long before its row a sample was taken; 0 if the key is missing
    age_s: Mapping[str, Array]
    segment: Indices  # shape (n,); setting the pose begins a segment
    on_ticks: bool  # see `MeasuredLog`


class _Taken(NamedTuple):
    """When the source of a measured group took its samples."""

    fresh: Mask  # shape (n,); rows with a new one
    # shape (n,); not after a gap, in which the commands to the robot are unknown
    follows: Mask
    age_s: Array  # shape (n,)


def is_of_the_daemon(log: Log) -> bool:
    """Return whether the daemon wrote the rows: with a description of its run, or tick by tick."""
    return log.is_ours or TICK in log.columns


def own_sampling(log: Log) -> Sampling | None:
    """Return the sampling of the configuration in a recording; None without one."""
    try:
        data = configuration_of(log.run)
        sections = {key: data[key] for key in SECTIONS}
        return Sampling.of(Config.model_validate(sections))
    except (ValueError, KeyError):
        return None


def frames_of(log: Log, sampling: Sampling | None) -> Frames:
    """Return the samples of a recording of the daemon.

    Parameters
    ----------
    sampling : Sampling or None
        Of the configuration of its run; None if every row counts as a sample.
    """
    rows = {name: _usable(log, name) for name in log.columns}
    tick: Indices | None = None
    if TICK in log.columns and np.isfinite(log.columns[TICK]).all():
        tick = log.columns[TICK].astype(np.int64)
    elif sampling is not None:
        tick = np.rint(log.t_s / sampling.base_period_s).astype(np.int64)
    enough = np.ones(len(log), dtype=np.bool_) if tick is None else _enough(tick)
    taken = {} if sampling is None else _taken(rows, log.t_s, sampling)
    segment = log.segment.copy()
    if POSE_REQUEST in rows:
        request = rows[POSE_REQUEST]
        segment += np.cumsum(np.diff(request, prepend=request[:1]) != 0)

    measured = _measured(rows, np.arange(len(log)) if tick is None else tick, taken)
    columns: dict[str, Array] = dict(measured)
    age_s: dict[str, Array] = {}
    for name in measured:
        own = _of_group(taken, name)
        if own is not None:
            age_s[name] = own.age_s

    inputs, outputs = _inputs_and_outputs(rows)
    if SETPOINTS[0] in measured:
        inputs = {}  # the robot itself reports what it was asked for
    if measured:
        outputs = {}
    for name, values in (inputs | outputs).items():
        columns[name] = values
        if sampling is None or tick is None or is_input(name):
            continue
        period = sampling.period(name)
        fresh = _fresh(values, tick // period, segment)
        if fresh is None:
            continue
        if name.startswith("wheel."):
            fresh &= enough
        columns[name] = np.where(fresh, values, np.nan)
        if period > 1:
            late = tick % period
            age_s[name] = np.multiply(late, sampling.base_period_s, dtype=np.float64)
    return Frames(columns, age_s, segment, on_ticks=sampling is not None and not taken)


def _taken(
    rows: Mapping[str, Array], t_s: Array, sampling: Sampling
) -> dict[str, _Taken]:
    """Return the samples of the measured groups whose count and time are recorded.

    They arrived with the delay of their transport; their source's stamps place them when they were
    true. Those of the wheels lie on the robot's ticks, which are no whole number of ours away.
    """
    came: dict[str, tuple[Indices, Array]] = {}
    for group in SAMPLED:
        count = rows.get(f"internal.samples_{group}")
        stamp = rows.get(f"internal.taken_{group}_s")
        if count is None or stamp is None:
            continue
        at = np.flatnonzero(np.diff(count, prepend=count[:1]) > 0.0)
        if len(at) >= FEWEST_VALUES:
            age_s = t_s[at] - stamp[at]
            is_true = (age_s >= 0.0) & (age_s <= OLDEST_S)
            came[group] = at, np.where(is_true, stamp[at], t_s[at])
    if "wheel" in came:
        tick_s = sampling.period("wheel") * sampling.base_period_s
        since = came["wheel"][1] - t_s[0]
        mean = np.exp(2j * np.pi * since / tick_s).mean()
        phase = np.angle(mean) / (2.0 * np.pi)
        for group, (at, stamps) in came.items():
            came[group] = at, stamps - phase * tick_s
        at, stamps = came["wheel"]
        ticks = np.rint((stamps - t_s[0]) / tick_s)
        came["wheel"] = at, t_s[0] + tick_s * ticks
    return {group: _risen(t_s, *own) for group, own in came.items()}


def _of_group(taken: Mapping[str, _Taken], name: str) -> _Taken | None:
    """Return the samples of a channel's group; without a count of its own, those of the wheels."""
    return taken.get(name.partition(".")[0], taken.get("wheel"))


def _risen(t_s: Array, at: Indices, stamps: Array) -> _Taken:
    """Return samples by row, without those that are not newer than an earlier one.

    Of several messages with one stamp, the last one completes the sample.
    """
    last = np.append(np.diff(stamps) != 0.0, True)
    at = at[last]
    stamps = stamps[last]
    newest = np.maximum.accumulate(np.append(-np.inf, stamps))[:-1]
    is_newer = stamps > newest
    at = at[is_newer]
    stamps = stamps[is_newer]
    fresh, follows, age_s = np.zeros((3, len(t_s)))
    steps = np.diff(stamps, prepend=stamps[:1])
    fresh[at] = 1.0
    age_s[at] = t_s[at] - stamps
    follows[at] = steps < GAP_STEPS * np.median(steps)
    return _Taken(fresh > 0.0, follows > 0.0, age_s)


def _enough(tick: Indices) -> Mask:
    """Return which rows of noiseless wheels are enough: every n-th, if none is missing.

    The number is prime: in step with a controller's period they would always show the same part of
    its responses.
    """
    every = max(-(-len(tick) // ENOUGH_ROWS), 1)
    while any(every % k == 0 for k in range(2, every)):
        every += 1
    after_gap = np.diff(tick, prepend=tick[:1]) != 1
    nth = np.arange(len(tick)) % every == 0
    return np.asarray(after_gap | nth)


def _usable(log: Log, name: str) -> Array:
    """Return a column without bad values, and without uncertain ones that came from outside.

    The daemon's own outputs are what it computed, whatever their quality (in the safe state, or of
    a range finder beyond its range).
    """
    values = log.columns[name]
    if name not in log.status:
        return values
    unusable = BAD | UNCERTAIN if name.startswith(MEASURED) else BAD
    return np.where(log.status[name] & unusable, np.nan, values)


def _measured(
    rows: Mapping[str, Array], tick: Indices, taken: Mapping[str, _Taken]
) -> dict[str, Array]:
    """Return what came from outside, each sample once, named like the robot's own signals."""
    found: dict[str, Array] = {}
    for column, values in rows.items():
        name = column.removeprefix(MEASURED)
        if name == column or not np.nan_to_num(values).any():
            continue
        own = _of_group(taken, name)
        if own is None:
            found[name] = _first_of_each(values, tick)
        elif name in SETPOINTS:
            found[name] = np.where(own.fresh, values, np.nan)
        else:
            sampled = np.where(own.fresh & own.follows, values, np.nan)
            # In a channel that otherwise never repeats a value, a repeated one only accompanies
            # new samples of its group. A robot at rest repeats values for long, so only single
            # repeats count as missing.
            there = np.flatnonzero(np.isfinite(sampled))
            again = np.diff(sampled[there], prepend=np.nan) == 0.0
            before = np.append(False, again[:-1])
            after = np.append(again[1:], False)
            alone = again & ~before & ~after
            if again.mean() < RARE:
                sampled[there[alone]] = np.nan
            found[name] = sampled
    if not found.keys() >= set(SETPOINTS):  # the set-points of all wheels, or of none
        for name in SETPOINTS:
            found.pop(name, None)
    return found


def _inputs_and_outputs(
    rows: Mapping[str, Array],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the inputs that the robot acted on, and its own outputs."""
    known = known_signals()
    inputs = {n: rows[n] for n in rows if n in known and is_input(n)}
    if COMMAND in rows and rows[COMMAND].any():
        inputs[COMMAND] = rows[COMMAND]
    outputs = {n: rows[n] for n in rows if n in known and n not in inputs}
    if MODE in inputs:
        # Set-points of a mode that is not in force count for nothing.
        for mode, names in enumerate(OF_MODE):
            is_in_force = inputs[MODE] == mode
            for name in names:
                if name in inputs:
                    inputs[name] = np.where(is_in_force, inputs[name], np.nan)
    return inputs, outputs


def _fresh(values: Array, sample: Indices, segment: Indices) -> Mask | None:
    """Return the first row of every sample; None if values within one differ."""
    there = np.flatnonzero(np.isfinite(values))
    new_sample = np.diff(sample[there], prepend=-1) != 0
    new_segment = np.diff(segment[there], prepend=-1) != 0
    new = new_sample | new_segment
    if (np.diff(values[there])[~new[1:]] != 0.0).any():
        return None
    fresh = np.zeros(len(values), dtype=np.bool_)
    fresh[there[new]] = True
    return fresh


def _first_of_each(values: Array, tick: Indices) -> Array:
    """Return values from outside: each once, where it came, and repeated at the usual rate.

    Parameters
    ----------
    tick : ndarray of int64, shape (n,)
        Of every row: a recording may omit rows in which nothing changes.
    """
    there = np.flatnonzero(np.isfinite(values))
    first = np.flatnonzero(np.diff(values[there], prepend=np.nan) != 0.0)
    if len(first) < FEWEST_VALUES:
        return values
    ticks = tick[there]
    usual = max(int(np.median(np.diff(ticks[first]))), 1)
    lengths = np.diff(first, append=len(there))
    since = ticks - np.repeat(ticks[first], lengths)
    again = since % usual == 0
    result = np.full(len(values), np.nan)
    result[there[again]] = values[there[again]]
    return result
