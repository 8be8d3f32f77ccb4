"""Small real things that several tests need: a table, an image, a clock one can turn."""

import itertools
import os
import time

from hilserver.core.inputs import InputGate
from hilserver.core.leases import Leases
from hilserver.image import ProcessImage, changes, leases
from hilserver.image.leases import show_outcome
from hilserver.image.queues import latch_rows
from hilserver.signals import SOURCES, Ranges, robot_table

RANGES = Ranges(max_rpm=90.0, max_linear_m_s=0.8, max_angular_rad_s=3.0)
_numbers = itertools.count()


def make_table():
    return robot_table(RANGES)


def image_name():
    return f"test-{os.getpid()}-{next(_numbers)}"


def make_image(table=None, **options):
    fixed = {
        leases.REGION: leases.words_needed(8),
        changes.REGION: changes.words_needed(1),
    }
    fixed["edition"] = 1  # what a recorder looks for
    settings = {
        "live": {},
        "fixed": fixed,
        "base_period_ns": 1_000_000,
        "ring_length": 16,
    }
    return ProcessImage(image_name(), table or make_table(), **(settings | options))


def make_gate(
    table, image, events, ramp_ticks=0, monotonic_ns=time.monotonic_ns, **options
):
    leases = Leases(image, ramp_ticks, monotonic_ns)
    options = {"named": (*SOURCES, "peer:a")} | options
    return InputGate(table, image, events, leases, monotonic_ns=monotonic_ns, **options)


def latch_inputs(image, tick=0):
    """Take what was pushed, and write into the frame what whoever drives commands."""
    latch_rows(tick, image.values, image.words)
    show_outcome(image.values, image.words)


class ManualClock:
    """Nanoseconds that pass only when told to."""

    def __init__(self, start_ns=1_000_000_000):
        self.now_ns = start_ns

    def __call__(self):
        return self.now_ns

    def pass_s(self, seconds):
        self.now_ns += round(seconds * 1e9)
