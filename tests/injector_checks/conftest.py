"""Logs without noise, and drives of a single move."""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Noise, Recipe
from hilserver_injector.manoeuvres import DRIVES
from hilserver_injector.pilot import DRIVE

QUIET = Noise(
    position_white_m=0.0,
    position_m=0.0,
    yaw_rad=0.0,
    gyro_rad_s=0.0,
    speed_rpm=0.0,
    duty_pct=0.0,
    voltage_v=0.0,
)


def quiet(recipe: Recipe) -> Recipe:
    """Return the recipe with perfect sensors that miss nothing."""
    return replace(recipe, noise=QUIET, recorder=replace(recipe.taken, missing=0.0))


@pytest.fixture
def one_move(monkeypatch):
    """Return a maker of recipes that drive with constant rim speeds [rpm, forward positive]."""

    def recipe(left_rpm, right_rpm, duration_s=8.0, **causes):
        move = np.array([[DRIVE, left_rpm, right_rpm, 1e3, 1e6, 0.0, 0.0]])
        monkeypatch.setitem(DRIVES, "one move", lambda rng, duration_s: move)
        named = {name.replace("__", "."): value for name, value in causes.items()}
        return quiet(Recipe(manoeuvre="one move", duration_s=duration_s, causes=named))

    return recipe
