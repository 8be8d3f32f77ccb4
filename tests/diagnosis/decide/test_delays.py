"""Delays in each other's place: where a delay is long, no slope leads from one to another."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.delays import EXCHANGED, SUPERFLUOUS, with_other_delays
from hilserver.diagnosis.decide.selection import both_at_once
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

N = 2400
LATE_S = 0.3
CHANNEL_OF = {"nav_latency": 0, "yaw_latency": 1}


def signal(t_s):
    """It swings about once in 0.4 s: from a delay of zero the slope leads away from 0.3 s."""
    return sum(
        2.0 * np.sin(2.0 * np.pi * t_s / period_s) for period_s in (0.4, 0.37, 0.53)
    )


class LateStage(toy.LinearStage):
    """Samples in turn of two channels of one source: late together, or one by itself."""

    memoryless = False

    def predict(self, terms, poses=None, *, keep=False):
        return signal(self.stack.t_s - delay(len(self.stack), terms))


def delay(n, terms):
    late_s = np.full(n, terms.get("clock_offset", 0.0))
    for cause, channel in CHANNEL_OF.items():
        late_s[channel::2] += terms.get(cause, 0.0)
    return late_s


def candidate(name):
    return replace(toy.candidate(name), step=(0.01,), low=(-1.5,), high=(1.5,))


def one_and_others(terms, model):
    """The fit of some delays to a log with others, and the library of all."""
    rng = np.random.default_rng(5)
    t_s = np.arange(N) * toy.PERIOD_S
    values = signal(t_s - delay(N, terms)) + rng.normal(size=N)
    names = ("nav_latency", "yaw_latency", "clock_offset")
    problem = Problem(LateStage(values, dict.fromkeys(names, np.zeros(N))))
    problem.noise = {toy.SIGNAL: toy.NoiseModel(1.0)}
    library, base = toy.library(problem)
    library.candidates = [candidate(name) for name in names]
    start = Model()
    for name, value in model.items():
        start = start.plus(candidate(name), (value,))
    return library, fit(problem, start, base)


def test_the_clock_takes_the_place_of_the_channel_that_came_first():
    library, point = one_and_others({"clock_offset": LATE_S}, {"nav_latency": LATE_S})
    from_zero = point.model.swapped(0, candidate("clock_offset"), (1e-3,))
    assert fit(library.problem, from_zero, point).model.theta()[0] < 0.1
    rows = []
    found = with_other_delays(library, point, rows)
    assert found.model.causes == ("clock_offset",)
    assert found.model.theta() == pytest.approx([LATE_S], abs=0.01)
    assert [(row.cause, row.action, row.reason) for row in rows] == [
        ("nav_latency", "swapped", EXCHANGED)
    ]


def test_a_channel_that_is_late_alone_keeps_its_name():
    library, point = one_and_others({"nav_latency": LATE_S}, {"nav_latency": LATE_S})
    rows = []
    assert with_other_delays(library, point, rows) is point
    assert not rows


def test_beside_the_clock_the_first_delay_goes():
    both = {"nav_latency": 0.001, "clock_offset": LATE_S}
    library, point = one_and_others({"clock_offset": LATE_S}, both)
    rows = []
    found = with_other_delays(library, point, rows)
    assert found.model.causes == ("clock_offset",)
    assert [(row.cause, row.action, row.reason) for row in rows] == [
        ("nav_latency", "dropped", SUPERFLUOUS)
    ]


def test_two_delays_that_differ_stay():
    both = {"nav_latency": 0.04, "clock_offset": LATE_S}
    library, point = one_and_others(both, both)
    assert with_other_delays(library, point, []) is point


@pytest.mark.parametrize(
    ("hidden", "found"),
    [(("clock_offset", "side_slip"), ("clock_offset", "side_slip")),
     (("nav_latency",), ("nav_latency",))],
)  # fmt: skip
def test_a_late_source_and_a_slip_take_the_place_of_the_latency_that_explains_a_part_of_both(
    hidden, found
):
    rng = np.random.default_rng(6)
    clock, slip, aside = (30.0 * toy.smooth(rng, N) for _ in range(3))
    columns = {
        "nav_latency": clock + slip + 0.3 * aside,
        "clock_offset": clock,
        "side_slip": slip,
    }
    values = 0.5 * sum(columns[name] for name in hidden) + rng.normal(size=N)
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    point = fit(problem, toy.model("nav_latency"), base)
    both = both_at_once(problem, point, library)
    assert both.model.causes == found
    assert both.model.theta() == pytest.approx([0.5] * len(found), abs=0.05)
