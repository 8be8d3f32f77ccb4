"""Two recordings, row by row: where they part, how the difference grows, what may be the cause."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.comparison import as_text, compare
from hilserver.errors import LogError
from hilserver.logs import Log

N = 400
PERIOD_S = 0.01


def log(columns, *, segment=None, t_s=None, run=None):
    n = len(next(iter(columns.values()))) if columns else 0
    return Log(
        Path("run.mcap"),
        np.arange(n) * PERIOD_S if t_s is None else t_s,
        np.zeros(n, dtype=np.int64) if segment is None else segment,
        {name: np.array(values, dtype=float) for name, values in columns.items()},
        run=run,
    )


def rows_of(whole, chosen):
    return log(
        {name: values[chosen] for name, values in whole.columns.items()},
        segment=whole.segment[chosen],
        t_s=whole.t_s[chosen],
        run=whole.run,
    )


def pieces(whole, cuts):
    edges = [0, *sorted(cuts), len(whole)]
    return [rows_of(whole, slice(begin, end)) for begin, end in pairwise(edges)]


def compared(a, b, *tolerances):
    return compare(iter([a]), iter([b]), tolerances)


def run_of(**configuration):
    signals = [
        {"name": "twist.linear_m_s", "direction": "in"},
        {"name": "pose.x_m", "direction": "out"},
    ]
    text = "\n".join(f"{key}: {value}" for key, value in configuration.items())
    return {"signals": signals, "version": "1", "configuration": text}


@pytest.fixture
def ramp():
    return log({"pose.x_m": np.arange(N) * 0.1, "pose.y_m": np.zeros(N)})


def parted(whole, name, at, by):
    columns = {key: values.copy() for key, values in whole.columns.items()}
    columns[name][at:] += by
    return log(columns, segment=whole.segment, t_s=whole.t_s, run=whole.run)


def test_what_is_equal_is_equal_to_the_bit(ramp):
    found = compared(ramp, ramp)
    assert found.is_equal
    assert (found.rows, found.equal_before, found.signals) == (N, N, 2)
    assert as_text(found) == f"Equal: {N} rows of 2 signals."


def test_the_last_bit_is_a_difference(ramp):
    values = ramp.columns["pose.x_m"].copy()
    values[300] = np.nextafter(values[300], np.inf)
    found = compared(ramp, log(ramp.columns | {"pose.x_m": values}))
    [parting] = found.partings
    assert (parting.signal, parting.rows, found.equal_before) == ("pose.x_m", 1, 300)
    assert parting.t_s == pytest.approx(3.0)


def test_two_values_never_read_the_same():
    a = log({"pose.x_m": [0.1, 0.3]})
    b = log({"pose.x_m": [0.1, np.nextafter(0.3, 1.0)]})
    first = as_text(compared(a, b)).splitlines()[1]
    assert first.startswith(
        "First: pose.x_m is 0.29999999999999999 in A, 0.30000000000000004 in B"
    )


def test_a_difference_grows_along_the_horizons(ramp):
    growing = np.zeros(N)
    growing[100:] = np.arange(N - 100) * PERIOD_S
    found = compared(ramp, log(ramp.columns | {"pose.y_m": growing + 0.0}))
    [parting] = found.partings
    assert parting.t_s == pytest.approx(1.01)
    expected = [0.01, 0.02, 0.11, 1.01, 2.99, 2.99, 2.99]
    assert parting.largest == pytest.approx(expected)


def test_first_is_what_parts_first_and_the_text_says_so(ramp):
    later = parted(parted(ramp, "pose.x_m", 200, 1.0), "pose.y_m", 150, 2.0)
    found = compared(ramp, later)
    assert [p.signal for p in found.partings] == ["pose.y_m", "pose.x_m"]
    first = as_text(found).splitlines()[:2]
    assert first[0] == "They differ from 1.5 s on; 150 rows before that are equal."
    assert first[1] == "First: pose.y_m is 0 in A, 2 in B [m]."


def test_inputs_are_told_from_outputs():
    a = log(
        {"twist.linear_m_s": np.zeros(N), "pose.x_m": np.zeros(N)}, run=run_of(seed=1)
    )
    output = parted(a, "pose.x_m", 10, 1.0)
    equal = "an output, while all inputs that both have were equal"
    assert equal in as_text(compared(a, output))
    without = log({"pose.x_m": output.columns["pose.x_m"]})
    assert "inputs" not in as_text(compared(a, without)), "none was compared"
    both = parted(output, "twist.linear_m_s", 10, 0.5)
    said = as_text(compared(a, both)).splitlines()[1]
    assert said.startswith("First: twist.linear_m_s is 0 in A, 0.5 in B [m/s]")
    assert said.endswith("what came in was not the same.")


def test_lost_frames_are_counted_and_the_others_compared(ramp):
    kept = np.array([i for i in range(N) if i % 7])
    found = compared(ramp, rows_of(ramp, kept))
    assert not found.partings
    assert found.rows == len(kept)
    assert found.alone == (N - len(kept), 0)
    assert not found.is_equal
    assert f"{N - len(kept)} rows are only in A." in as_text(found)


def test_segments_are_compared_with_their_own_kind(ramp):
    t_s = np.tile(np.arange(N // 2) * PERIOD_S, 2)
    segment = np.repeat([0, 1], N // 2)
    a = log(ramp.columns, segment=segment, t_s=t_s)
    b = rows_of(a, slice(N // 2, N))
    found = compared(a, b)
    assert (found.rows, found.alone) == (N // 2, (N // 2, 0))
    assert not found.partings


@pytest.mark.parametrize(("a", "b", "size"), [(3.1, -3.1, 0.0832), (0.5, -0.5, 1.0)])
def test_a_heading_wraps(a, b, size):
    found = compared(log({"pose.yaw_rad": [a]}), log({"pose.yaw_rad": [b]}))
    assert found.partings[0].largest[0] == pytest.approx(size, abs=1e-4)


def test_a_value_beside_none_is_a_difference_whatever_the_tolerance():
    a, b = log({"pose.x_m": [0.0, math.nan]}), log({"pose.x_m": [0.0, 1.0]})
    assert compared(a, a).is_equal
    [parting] = compared(a, b, ("pose.x_m", 10.0)).partings
    assert parting.largest[0] == math.inf


def test_zero_is_zero_whatever_its_sign():
    assert compared(log({"pose.x_m": [0.0]}), log({"pose.x_m": [-0.0]})).is_equal


def test_tolerances_by_pattern_the_last_counts(ramp):
    other = parted(parted(ramp, "pose.x_m", 0, 0.01), "pose.y_m", 0, 0.01)
    assert compared(ramp, other, ("pose.*", 0.02)).is_equal
    found = compared(ramp, other, ("pose.*", 0.02), ("pose.y_m", 0.001))
    assert [p.signal for p in found.partings] == ["pose.y_m"]


def test_a_tolerance_for_nothing_is_refused(ramp):
    with pytest.raises(LogError, match=r"pose.z_m: fits no signal of both; did you"):
        compared(ramp, ramp, ("pose.z_m", 1.0))


def test_changed_configuration_is_shown():
    a = log({"pose.x_m": [0.0]}, run=run_of(k_p=1.0, track=0.3))
    b = log({"pose.x_m": [1.0]}, run=run_of(k_p=1.0, track=0.4))
    assert as_text(compared(a, b)).splitlines()[-1] == "  track: 0.3 in A, 0.4 in B"


@pytest.mark.parametrize(
    ("a", "b", "why"),
    [
        ({"pose.x_m": []}, {"pose.x_m": [1.0]}, "the first recording has no rows"),
        ({"pose.x_m": [1.0]}, {"pose.y_m": [1.0]}, "no signal in common"),
    ],
)
def test_what_cannot_be_compared_is_a_sentence(a, b, why):
    with pytest.raises(LogError, match=why):
        compared(log(a), log(b))


def test_times_that_never_meet_are_a_sentence(ramp):
    late = log(ramp.columns, t_s=ramp.t_s + 0.005)
    with pytest.raises(LogError, match="no time in common"):
        compared(ramp, late)


CUTS = st.sets(st.integers(1, 49), max_size=8)


@given(cuts_a=CUTS, cuts_b=CUTS, lost=st.sets(st.integers(0, 49), max_size=20))
def test_pieces_make_no_difference(cuts_a, cuts_b, lost):
    whole = log({"pose.x_m": np.arange(50.0), "pose.y_m": np.zeros(50)})
    kept = np.array([i for i in range(50) if i not in lost])
    other = rows_of(parted(whole, "pose.y_m", 30, 1.0), kept)
    at_once = compared(whole, other)
    cuts_b = {cut for cut in cuts_b if cut < len(kept)}
    found = compare(iter(pieces(whole, cuts_a)), iter(pieces(other, cuts_b)))
    assert as_text(found) == as_text(at_once)
