"""What a log is made from: everything is drawn from the seed, nothing else."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

WHEELS = ("fl", "rl", "fr", "rr")
OF_THE_DRIVER = frozenset({"manoeuvre", "charge"})
"""What `Recipe.manoeuvre_seed` draws."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Standard deviations of what the sensors add; the defaults are those of the reference logs."""

    position_white_m: float = 0.01
    position_m: float = 0.05
    position_correlation_s: float = 0.6
    yaw_rad: float = 0.015
    yaw_correlation_s: float = 2.0
    gyro_rad_s: float = 0.006
    speed_rpm: float = 0.12
    duty_pct: float = 0.15
    voltage_v: float = 0.02
    measured_position: bool = False
    """Position noise drawn in blocks from a real ultra-wideband recording (HIL_DATA_DIR)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorder:
    """How the log was taken.

    Attributes
    ----------
    row_jitter_s : float
        Standard deviation of a row's instant, on the controller's ticks; the stamp is true.
    stamp_jitter_s : float
        Standard deviation of the error of the stamp.
    missing : float
        Share of the samples of a sensor that are not there.
    missing_rows : float
        Share of the rows that are not there.
    """

    rate_hz: float = 50.0
    nav_hz: float = 20.0
    row_jitter_s: float = 0.001
    stamp_jitter_s: float = 0.0
    missing: float = 0.002
    missing_rows: float = 0.0
    channels: tuple[str, ...] = ("setpoint", "speed", "duty", "gyro", "nav", "battery")


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """How a channel's reading is rounded and limited: clip(round(truth + noise)).

    Attributes
    ----------
    step : float
        Readings are whole multiples of it; 0: not rounded.
    limit : float
        Largest reading, either sign.
    """

    step: float = 0.0
    limit: float = math.inf


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """One log.

    Attributes
    ----------
    causes : mapping of str to float
        ``cause`` or ``cause.part``: the parameters of spec "Diagnosis", and of `causes.OUTSIDE`.
    drive : str
        skid, or mecanum with a manoeuvre of `manoeuvres.TABLES`.
    manoeuvre_seed : int or None
        Of what the driver does and how full the battery is, for logs of one drive with several
        noises; None: `seed`.
    drift_from : mapping of str to float or None
        Values at the start of the log, when `causes` are those at its end.
    faults : mapping of str to object
        Faults of the data, see `faults.apply`.
    sensors : mapping of str to Sensor
        By a part of the channels' names (``speed_rpm``); other channels are exact but for noise.
    """

    kind: Literal["drive", "bench"] = "drive"
    seed: int = 0
    drive: Literal["skid", "mecanum"] = "skid"
    causes: Mapping[str, float] = field(default_factory=dict)
    drift_from: Mapping[str, float] | None = None
    drift_step: bool = False
    faults: Mapping[str, object] = field(default_factory=dict)
    duration_s: float | None = None
    manoeuvre: str = "mixed"
    manoeuvre_seed: int | None = None
    in_the_air: bool = False
    noise: Noise = field(default_factory=Noise)
    recorder: Recorder | None = None
    sensors: Mapping[str, Sensor] = field(default_factory=dict)

    @property
    def length_s(self) -> float:
        """Duration of the log; six minutes of driving or two on the bench if none is asked for."""
        return self.duration_s or (360.0 if self.kind == "drive" else 120.0)

    @property
    def taken(self) -> Recorder:
        """How the log was taken."""
        if self.recorder is not None:
            return self.recorder
        if self.kind == "drive":
            return Recorder()
        names = ("setpoint", "speed", "duty", "battery")
        return Recorder(rate_hz=500.0, row_jitter_s=0.0, missing=0.001, channels=names)

    def generator(self, purpose: str) -> np.random.Generator:
        """Return the random numbers for one purpose; independent of all others."""
        seed = self.seed
        if self.manoeuvre_seed is not None and purpose in OF_THE_DRIVER:
            seed = self.manoeuvre_seed
        return np.random.default_rng([seed, *purpose.encode()])
