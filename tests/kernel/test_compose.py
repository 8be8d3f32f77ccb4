"""The composed step: the block that was asked for, and no harm from one that goes astray."""

import math
from contextlib import closing

import numpy as np
import pytest

from hilserver.daemon.assembly import assemble
from hilserver.daemon.builder import build
from hilserver.scheduler.step import LATCH, PUBLISH
from hilserver.status import BAD_SENSOR_FAILURE, GOOD

BLOCKS = """
from hilserver.plant.blocks import Output, block

ONE = (Output("value"),)


@block(outputs=ONE)
def first(dt_s, u, y, x, p):
    y[0] = 1.0


@block(outputs=ONE)
def second(dt_s, u, y, x, p):
    y[0] = 2.0


@block(outputs=ONE)
def writes_outside(dt_s, u, y, x, p):
    y[0] = 3.0
    for i in range(1, 64):
        y[i] = 3.0


@block(outputs=ONE)
def writes_far_outside(dt_s, u, y, x, p):
    y[1_000_000_000] = 3.0


@block(outputs=ONE)
def raises(dt_s, u, y, x, p):
    y[0] = 3.0
    raise ValueError("not today")


def made(number):
    @block(outputs=ONE)
    def enclosing(dt_s, u, y, x, p):
        y[0] = number

    return enclosing


seven, eight = made(7.0), made(8.0)
"""


class Plant:
    """A composed step with the named blocks in the plant's slice, driven by hand."""

    def __init__(self, folder, *functions):
        (folder / "own.py").write_text(BLOCKS)
        entries = [
            f"{{name: b{n}, function: 'own.py:{f}'}}" for n, f in enumerate(functions)
        ]
        path = folder / "config.yaml"
        path.write_text(f"blocks: [{', '.join(entries)}]\n")
        assembly = assemble(path)
        core = build(assembly)
        self.table, self.image, self.step = assembly.table, core.image, core.step
        self.close = self.image.close
        self._index = list(assembly.composition.slices).index("plant")

    def tick(self, number=0):
        """Run one tick; return the answer of the slice."""
        arena = self.image.values, self.image.words
        self.step(LATCH, number, 0, *arena)
        answer = self.step(self._index, number, 0, *arena)
        self.step(PUBLISH, number, 0, *arena)
        return answer

    def output(self, block):
        frame, slot = self.image.latest(), self.table.slot(f"{block}.value")
        return frame.values[slot], frame.status[slot]


@pytest.mark.parametrize(
    ("function", "value"),
    [("first", 1.0), ("second", 2.0), ("seven", 7.0), ("eight", 8.0)],
)
def test_functions_of_one_file_are_not_taken_for_each_other(tmp_path, function, value):
    with closing(Plant(tmp_path, function)) as plant:
        assert plant.tick() == 0
        assert plant.output("b0") == (value, GOOD)


@pytest.mark.parametrize("function", ["writes_outside", "writes_far_outside", "raises"])
def test_a_block_that_goes_astray_is_a_fault_and_harms_nobody(tmp_path, function):
    astray = Plant(tmp_path, "first", function, "second")
    with (
        closing(astray) as plant,
        closing(Plant(tmp_path, "first", "second", "second")) as sound,
    ):
        for number in range(3):
            assert plant.tick(number) == 2, "the number of the block, counted from 1"
            assert sound.tick(number) == 0
        value, status = plant.output("b1")
        assert math.isnan(value)
        assert status == BAD_SENSOR_FAILURE
        assert plant.output("b0") == (1.0, GOOD)
        assert plant.output("b2") == (2.0, GOOD)
        for name in ("x", "p", "hall", "b0.y", "b2.y"):
            hurt, whole = plant.image.region(name)[1], sound.image.region(name)[1]
            np.testing.assert_array_equal(hurt, whole, err_msg=name)
