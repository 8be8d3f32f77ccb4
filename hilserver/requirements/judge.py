"""Applies requirements to drives of one robot.

The margin of a requirement is its robustness in the sense of signal temporal logic. A sample's
margin is its distance to the bound, positive if the bound is kept. A requirement has to hold from
some start on, for a while; its margin is that of the worst sample after the best start (Donzé and
Maler, Robust Satisfaction of Temporal Logic over Real-Valued Signals, 2010). It is met when the
margin is not negative.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hilserver.arrays import Array
from hilserver.config.loading import place, placed
from hilserver.errors import ConfigError, FailedError, meant
from hilserver.program.own_python import described, load_callable
from hilserver.requirements.model import Requirement
from hilserver.signals import SignalTable

_ROUNDING = 1e-9  # of a tick: a time this close to a tick counts as that tick


def margin(requirement: Requirement, values: Array, period_s: float) -> float:
    """Return how far the samples of a drive are from failing, in the signal's unit.

    Parameters
    ----------
    values : ndarray of float64, shape (n,)
        One sample per tick, the first at 0 s.
    period_s : float
        Period of a tick [s].

    Returns
    -------
    float
        Negative: not met; -inf if a sample is not a number, or the drive ends too early.
    """
    samples = sample_margins(requirement, values)
    first = math.ceil(requirement.after_s / period_s - _ROUNDING)
    last = first
    if requirement.within_s is not None:
        last = math.floor(requirement.within_s / period_s + _ROUNDING)
    last = min(last, len(samples) - 1)
    if first > last:
        return -math.inf
    held = _held(requirement, samples[first:], period_s)
    within = held[: last - first + 1]
    return float(within.max(initial=-math.inf))


def sample_margins(requirement: Requirement, values: Array) -> Array:
    """Return the distance of each sample to the bound, shape (n,)."""
    samples = np.full(len(values), math.inf)
    if requirement.below is not None:
        samples = np.minimum(samples, requirement.below - values)
    if requirement.above is not None:
        samples = np.minimum(samples, values - requirement.above)
    if requirement.equals is not None:
        samples = requirement.tolerance - np.abs(values - requirement.equals)
    return np.where(np.isnan(samples), -math.inf, samples)


def _held(requirement: Requirement, samples: Array, period_s: float) -> Array:
    """Return, for each start, the worst margin while the requirement has to hold.

    Starts after which the drive is too short are left out.
    """
    if requirement.for_s is None:
        if requirement.within_s is not None and not requirement.always:
            return samples
        to_the_end: Array = np.minimum.accumulate(samples[::-1])[::-1]
        return to_the_end
    n = math.floor(requirement.for_s / period_s + _ROUNDING) + 1
    if n > len(samples):
        return samples[:0]
    if requirement.within_s is None:
        return np.array([samples[:n].min()])
    # The minimum of every `n` successive samples.
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - few requirements need it

    # scipy centres its window on a sample; the origin moves it to begin there
    filtered: Array = minimum_filter1d(samples, n, origin=-(n // 2), mode="nearest")
    return filtered[: len(samples) - n + 1]


class CheckError(FailedError):
    """A requirement's own function raised, or returned something invalid."""


@dataclass(frozen=True)
class Drive(Mapping[str, Array]):
    """Signals of one drive, one sample per tick, the first at 0 s."""

    period_s: float  # period of a tick [s]
    columns: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def n_ticks(self) -> int:
        """Samples of each signal."""
        return max((len(values) for values in self.columns.values()), default=0)

    @property
    def time_s(self) -> Array:
        """Time of each sample [s], shape (n,)."""
        times: Array = np.arange(self.n_ticks, dtype=np.float64) * self.period_s
        return times


class Judge:
    """Requirements, bound to the signals of a robot.

    Own functions are searched for beside `path`. `derived` are signals of a drive that are not in
    the table. ConfigError if a signal or function does not exist, or two have the same name.
    """

    def __init__(
        self,
        requirements: Sequence[Requirement],
        table: SignalTable,
        path: Path | None = None,
        derived: Collection[str] = (),
    ) -> None:
        self.requirements = tuple(requirements)
        folder = Path.cwd() if path is None else path.resolve().parent
        self._functions: dict[str, Callable[..., Any]] = {}
        known = [signal.name for signal in table if not signal.is_array]
        known += [name for name in derived if name not in known]
        signals: dict[str, None] = {}
        for index, requirement in enumerate(self.requirements):
            key = "python" if requirement.signal is None else "signal"
            where = place(path, ("require", index, key))
            if requirement.name in [other.name for other in self.requirements[:index]]:
                raise ConfigError(
                    f"{where}two requirements have the name '{requirement.name}'"
                )
            names = requirement.signals or known
            if requirement.python is not None:
                with placed(path, ("require", index, "python")):
                    found = load_callable(requirement.python, folder)
                self._functions[requirement.name] = found
            elif requirement.signal is not None:
                names = (requirement.signal,)
            for name in names:
                if name not in known:
                    hint = meant(name, known, "see 'hilserver signals'")
                    raise ConfigError(
                        f"{where}there is no scalar signal '{name}'; {hint}"
                    )
                signals[name] = None
        self.signals = tuple(signals)  # those to keep of a drive

    def margins(self, drive: Drive) -> dict[str, float]:
        """Return the margin of every requirement by its name.

        CheckError if an own function raised.
        """
        return {
            requirement.name: margin(
                requirement, self._values(requirement, drive), drive.period_s
            )
            for requirement in self.requirements
        }

    def _values(self, requirement: Requirement, drive: Drive) -> Array:
        if requirement.signal is not None:
            return drive[requirement.signal]
        try:
            found = self._functions[requirement.name](drive)
            values = np.asarray(found, dtype=np.float64)
        except Exception as error:
            raise CheckError(f"{requirement.python}: {described(error)}") from error
        if values.ndim == 0:  # one number judges the whole drive
            return np.full(drive.n_ticks, float(values))
        if values.shape != (drive.n_ticks,):
            raise CheckError(
                f"{requirement.python}: returned an array of shape {values.shape}; a number or one"
                f" value for each of the {drive.n_ticks} ticks is needed"
            )
        return values
