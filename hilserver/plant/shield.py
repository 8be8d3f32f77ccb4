"""The extension shield: its blinking lamps and its temperature.

The temperature follows the current with one time constant. How warm the real shield gets and how
fast its lamps blink are not published: the figures here are assumptions.
"""

import math
from typing import Final

from hilserver.compiled import inlined, part
from hilserver.plant.battery import drawn_current
from hilserver.plant.layout import Inputs, Outputs, Parameters, State, Status
from hilserver.status import GOOD

AMBIENT_DEGC: Final = 25.0
WARMING_DEGC_PER_A: Final = 2.5
WARMING_S: Final = 300.0
BLINK_S: Final = 0.8  # on for half of it
TURN_S: Final = 0.72  # once round the four lamps
WAVE_S: Final = 1.9

DIM, HIGH_BEAM, FLASH_ALL, FLASH_LEFT, FLASH_RIGHT, PULSATION, ROTATION, RUNNING = (
    range(1, 9)
)


@inlined
def brightness(pattern: float, lamp: int, time_s: float) -> float:
    """Return the brightness 0 .. 1 of a lamp (fl, fr, rl, rr) at a time since the pattern began."""
    blink = 1.0 if time_s % BLINK_S < 0.5 * BLINK_S else 0.0
    quarter = int(time_s % TURN_S * 4.0 / TURN_S)
    if pattern == DIM:
        return 0.35
    if pattern == HIGH_BEAM:
        return 1.0
    if pattern == FLASH_ALL:
        return blink
    if pattern == FLASH_LEFT:
        return blink if lamp % 2 == 0 else 0.0
    if pattern == FLASH_RIGHT:
        return blink if lamp % 2 == 1 else 0.0
    if pattern == PULSATION:
        return 0.5 - 0.5 * math.cos(2.0 * math.pi * time_s / WAVE_S)
    if pattern == ROTATION:
        turn = lamp if lamp < 2 else 5 - lamp  # fl, fr, rr, rl
        return 1.0 if turn == quarter else 0.0
    if pattern == RUNNING:
        return 1.0 if lamp % 2 == quarter % 2 else 0.0
    return 0.0


@part
def shield_step(p: Parameters, x: State, u: Inputs, y: Outputs, q: Status) -> None:
    """Publish lamps and temperature, and advance by one run."""
    pattern = u.light_pattern
    if pattern != x.light_pattern:
        x.light_pattern, x.light_time = pattern, 0.0
    y.light_pattern = pattern
    q.light_pattern = GOOD
    for lamp in range(4):
        share = brightness(pattern, lamp, x.light_time)
        for colour in range(3):
            y.lights[lamp, colour] = math.floor(u.light_colour[colour] * share + 0.5)
            q.lights[lamp, colour] = GOOD
    y.temperature = x.temperature
    q.temperature = GOOD
    x.light_time += p.shield_period
    warm = AMBIENT_DEGC + WARMING_DEGC_PER_A * drawn_current(p, y)
    x.temperature = warm + (x.temperature - warm) * p.shield_keep
