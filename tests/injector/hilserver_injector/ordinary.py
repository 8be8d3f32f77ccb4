"""Sensors as ordinary machines have them: rounded, limited, held, and none of them the same."""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from hilserver_injector.recipe import Noise, Recipe, Recorder, Sensor

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType({
    "speed_step_rpm": (0.05, 0.3),
    "speed_noise_rpm": (0.03, 0.12),
    "duty_noise_pct": (0.05, 0.15),
    "gyro_step_rad_s": (0.001, 0.0175),
    "gyro_limit_rad_s": (1.0, 1.25),
    "held_by_row": (0.1, 0.5),
})  # fmt: skip
"""What each log's sensors are drawn from; sealed: changed, no figure compares with an older one."""
HELD: Mapping[str, str] = MappingProxyType(
    {"speed_rpm": "speed", "gyro_z": "gyro", "nav.": "nav"}
)
"""What may be slower than the rows in every third log, by what its recorder takes."""
DUTY_STEPS_PCT = (0.0, 0.4, 1.0)
POSITION_STEPS_M = (0.0, 0.01, 0.02)
ON_A_STAND = Recorder(
    rate_hz=100.0,
    row_jitter_s=0.0,
    channels=("setpoint", "speed", "duty", "gyro", "battery"),
)


def ordinary(recipe: Recipe) -> Recipe:
    """Return a recipe whose machine has ordinary sensors, drawn from its seed."""
    rng = recipe.generator("ordinary sensors")

    def drawn(name: str) -> float:
        low, high = np.log(RANGES[name])
        return float(np.exp(rng.uniform(low, high)))

    limited = rng.random() < 0.5
    gyro = Sensor(
        step=drawn("gyro_step_rad_s"),
        limit=drawn("gyro_limit_rad_s") if limited else math.inf,
    )
    sensors = {
        "speed_rpm": Sensor(step=drawn("speed_step_rpm")),
        "duty_pct": Sensor(step=float(rng.choice(DUTY_STEPS_PCT)), limit=100.0),
        "gyro_z": gyro,
        "nav.x_m": (place := Sensor(step=float(rng.choice(POSITION_STEPS_M)))),
        "nav.y_m": place,
    }
    noise = Noise(speed_rpm=drawn("speed_noise_rpm"), duty_pct=drawn("duty_noise_pct"))
    return replace(recipe, sensors=sensors, noise=noise)


def held(recipe: Recipe) -> Recipe:
    """Return the recipe, in every third log with one reading repeated until the next is there.

    The tag keeps its own rate: it is a table without empty cells.
    """
    rng, taken = recipe.generator("held sensors"), recipe.taken
    if rng.random() >= 1.0 / 3.0:
        return recipe
    channel = str(
        rng.choice([name for name, part in HELD.items() if part in taken.channels])
    )
    low, high = np.log(RANGES["held_by_row"])
    rate_hz = float(np.exp(rng.uniform(low, high))) * taken.rate_hz
    if channel == "nav.":
        rate_hz = taken.nav_hz
    return replace(recipe, faults={"held_samples": (channel, rate_hz)})
