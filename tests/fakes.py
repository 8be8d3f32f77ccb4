"""Small real things that several tests need: a table, an image, a clock one can turn."""

import itertools
import os

from hilserver.image import ProcessImage
from hilserver.signals import Ranges, robot_table

RANGES = Ranges(max_rpm=90.0, max_linear_m_s=0.8, max_angular_rad_s=3.0)
_numbers = itertools.count()


def make_table():
    return robot_table(RANGES)


def image_name():
    return f"test-{os.getpid()}-{next(_numbers)}"


def make_image(table=None, **options):
    settings = {"live": {}, "fixed": {}, "base_period_ns": 1_000_000, "ring_length": 16}
    return ProcessImage(image_name(), table or make_table(), **(settings | options))


class ManualClock:
    """Nanoseconds that pass only when told to."""

    def __init__(self, start_ns=1_000_000_000):
        self.now_ns = start_ns

    def __call__(self):
        return self.now_ns

    def pass_s(self, seconds):
        self.now_ns += round(seconds * 1e9)
