"""Logs with a hidden cause, made by another program than the plant.

Continuous time in steps of 0.1 ms by Heun's method, a controller of its own, tyre forces, sensors
with the noise of real ones. It imports nothing of hilserver, so that a diagnosis cannot be right
merely because both sides share a mistake.
"""

from hilserver_injector.causes import CAUSES, REQUIRED, nothing, single
from hilserver_injector.make import make
from hilserver_injector.recipe import Noise, Recipe, Recorder, Sensor
from hilserver_injector.table import Table, Truth

__all__ = [
    "CAUSES",
    "REQUIRED",
    "Noise",
    "Recipe",
    "Recorder",
    "Sensor",
    "Table",
    "Truth",
    "make",
    "nothing",
    "single",
]
