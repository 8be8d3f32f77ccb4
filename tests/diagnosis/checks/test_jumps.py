"""A tag that is suddenly elsewhere, and goes on from there, begins a new segment."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

CUTS_S = ((20.0, 32.0), (60.0, 73.0))


@pytest.fixture(scope="module")
def table():
    return drive(7, length_s=100.0)


def without_pauses(t, columns):
    """The table without some stretches, as if they had never been."""
    keep, stamps = np.ones(len(t), dtype=bool), t.copy()
    for begin, end in CUTS_S:
        keep &= (t < begin) | (t >= end)
        stamps[t >= end] -= end - begin
    return stamps[keep], {name: values[keep] for name, values in columns.items()}


def test_pauses_that_were_cut_out_end_segments(table):
    checked = check(log_of(*without_pauses(*table)), ROBOT)
    assert not checked.findings
    assert [span.start_s for span in checked.log.spans] == pytest.approx(
        [0.0, 20.0, 48.0], abs=0.06
    )
    assert "the position jumps 2 times" in checked.log.notices[-1]


def test_outliers_and_a_tag_that_fails_for_a_while_are_no_jumps(table):
    t, columns = table
    rng = np.random.default_rng(2)
    away = {"nav.x_m": 3.0 * (rng.random(len(t)) < 0.05), "nav.y_m": np.zeros(len(t))}
    spoilt = {n: v + away[n] if n in away else v for n, v in columns.items()}
    for name in ("nav.x_m", "nav.y_m", "nav.yaw_rad"):
        spoilt[name] = np.where((t > 50.0) & (t < 51.5), np.nan, spoilt[name])
    assert len(check(log_of(t, spoilt), ROBOT).log.spans) == 1
