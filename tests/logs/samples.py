"""Frames without a plant: a small signal table and numbers that are hard to write."""

import numpy as np

from hilserver.image import FrameBatch
from hilserver.logs.provenance import SCHEMA
from hilserver.logs.writer import Segmented

NAMES = ("wheel.fl.setpoint_rpm", "internal.command", "wheel.fl.speed_rpm", "sim.tick")
PERIOD_NS = 1_000_000


def run_of(names=NAMES):
    signals = [
        {"name": n, "unit": "1", "type": "Double", "direction": "in" if i < 2 else "out",
         "slots": [i], "hidden": "internal" in n}
        for i, n in enumerate(names)
    ]  # fmt: skip
    return {
        "schema": SCHEMA,
        "version": "0",
        "kernels": "k",
        "config_sha256": "s",
        "config_folder": "/nowhere",
        "patch": None,
        "seed": 3,
        "base_period_ns": PERIOD_NS,
        "audit": [{"name": "governor", "ok": False}],
        "configuration": "plant: {}\n",
        "signals": signals,
        "layout": {},
    }


def batch_of(values, *, first=0, segment=0, status=None, first_tick=None):
    """Frames `first`, first + 1, ... with `values`, shape (n, n_signals)."""
    values = np.array(values, dtype=np.float64)
    n, n_slots = values.shape
    words = np.zeros((n, 3 + n_slots), dtype=np.int64)
    words[:, 0] = np.arange(n) + (first if first_tick is None else first_tick)
    words[:, 1] = (np.arange(n) + first) * PERIOD_NS + 7
    if status is not None:
        words[:, 3:] = status
    return Segmented(
        FrameBatch(first, words, values), np.full(n, segment, dtype=np.int64)
    )


def ramp(n, first=0):
    """Values that tell which frame they belong to."""
    numbers = np.arange(first, first + n, dtype=np.float64)
    return np.stack([numbers, -numbers, numbers / 3, numbers], axis=1)
