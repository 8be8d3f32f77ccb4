"""Data checks: every fault by its name, its value and the corrected data; never a false alarm."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.diagnosis.checks import check
from hilserver.diagnosis.schema.findings import Verdict
from hilserver.plant.layout import WHEELS
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

SPEEDS = tuple(f"wheel.{wheel}.speed_rpm" for wheel in WHEELS)
SENT = tuple(f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS)
NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")


@pytest.fixture(scope="module")
def table():
    return drive(7)


def fault(t, columns, **how):
    """Check a spoilt table; return its only finding and the corrected log."""
    checked = check(log_of(t, columns, **how), ROBOT)
    assert [f.causes for f in checked.findings] == [checked.findings[0].causes]
    (finding,) = checked.findings
    assert finding.verdict is Verdict.DATA_FAULT
    assert finding.block == "data"
    assert finding.explanation.endswith((".", "out."))
    assert "\n" not in finding.explanation
    (cause,) = finding.causes
    return cause, finding.parameters[cause], set(finding.regressors), checked.log


def scaled(columns, names, factor):
    return {
        name: values * (factor if name in names else 1)
        for name, values in columns.items()
    }


def quantised(columns, step):
    return {
        name: np.round(values / step) * step if name in SPEEDS else values
        for name, values in columns.items()
    }


NULL = {
    "plain": lambda rng, t, c: (t, c),
    "jitter": lambda rng, t, c: (t + 0.004 * rng.uniform(-1, 1, len(t)), c),
    "epoch": lambda rng, t, c: (t + 1.7e9, c),
    "rows missing": lambda rng, t, c: (
        t[keep := rng.random(len(t)) > 0.02],
        {name: values[keep] for name, values in c.items()},
    ),
    "coarse encoder": lambda rng, t, c: (t, quantised(c, 0.5)),
    "very coarse encoder": lambda rng, t, c: (t, quantised(c, 3.0)),
    "two decimals": lambda rng, t, c: (t, {n: np.round(v, 2) for n, v in c.items()}),
    "outliers": lambda rng, t, c: (
        t,
        {
            n: v + (rng.random(len(t)) < 0.04) * 1.5 if n in NAV[:2] else v
            for n, v in c.items()
        },
    ),
    "no navigation": lambda rng, t, c: (
        t,
        {n: v for n, v in c.items() if n not in NAV},
    ),
    "no set-points": lambda rng, t, c: (
        t,
        {n: v for n, v in c.items() if n not in SENT},
    ),
    "half the K_om": lambda rng, t, c: drive(3, k_om=0.53),
    "gyro of half the scale": lambda rng, t, c: (
        t,
        scaled(c, ("imu.gyro_z_rad_s",), 0.53),
    ),
    "loaded wheels": lambda rng, t, c: (t, scaled(c, SPEEDS, 0.4)),
    "noise-free": lambda rng, t, c: drive(4, noise=0.0),
    "noise-free, coarse": lambda rng, t, c: quantised_drive(),
    "20 Hz": lambda rng, t, c: drive(5, rate_hz=20.0),
    "steps held for seconds": lambda rng, t, c: drive(6, moves_s=6.0),
    "set-points sent at 12.5 Hz": lambda rng, t, c: drive(7, sent_hz=12.5),
    "set-points sent at 12.5 Hz, agile wheels": lambda rng, t, c: drive(
        7, sent_hz=12.5, lag_s=2e-3
    ),
    "set-points sent at 5 Hz, slow wheels": lambda rng, t, c: drive(
        8, sent_hz=5.0, lag_s=0.2
    ),
    "tag looks a little left": lambda rng, t, c: (
        t,
        {**c, NAV[2]: wrapped(c[NAV[2]] + 0.2)},
    ),
    "late tag": lambda rng, t, c: (
        t,
        {n: late(v, 10) if n in NAV[:2] else v for n, v in c.items()},
    ),
    "standing": lambda rng, t, c: (t, {n: 0.0 * v for n, v in c.items()}),
}


def quantised_drive():
    t, columns = drive(4, noise=0.0)
    return t, quantised(columns, 0.5)


def wrapped(angle):
    return np.angle(np.exp(1j * angle))


def late(values, rows):
    return np.concatenate([np.full(rows, np.nan), values[:-rows]])


@pytest.mark.parametrize("kind", NULL)
def test_a_sound_log_gives_no_finding(kind, table):
    t, columns = NULL[kind](np.random.default_rng(1), *table)
    log = log_of(t, columns)
    checked = check(log, ROBOT)
    assert [(f.causes, f.regressors) for f in checked.findings] == []
    assert {n: len(c) for n, c in checked.log.channels.items()} == {
        n: len(c) for n, c in log.channels.items()
    }


@pytest.mark.parametrize("seed", range(20, 26))
def test_a_sound_log_in_short_spans_gives_no_finding(seed):
    assert not check(log_of(*drive(seed, length_s=120.0), spans=60), ROBOT).findings


@pytest.mark.parametrize(
    ("names", "factor"),
    [
        (SPEEDS, math.pi / 30),
        (SPEEDS, 30 / math.pi),
        (SENT, math.pi / 30),
        (("imu.gyro_z_rad_s",), 180 / math.pi),
        (("imu.gyro_z_rad_s",), math.pi / 180),
        (NAV[:2], 1000.0),
        (NAV[:2], 100.0),
        (NAV[:1], 1000.0),
        (NAV[1:2], 100.0),
        (SPEEDS[:1], math.pi / 30),
        (SPEEDS[2:3], 6.0),
        (SPEEDS[:2], math.pi / 30),
        (SPEEDS, 0.085 * math.pi / 30 * 3.6),
        (SPEEDS, 0.085 * math.pi / 30),
        (SENT[3:], math.pi / 30),
    ],
)
def test_units(table, names, factor):
    t, columns = table
    cause, value, channels, log = fault(t, scaled(columns, names, factor))
    assert cause == "unit_error"
    assert value.value == pytest.approx(factor, rel=1e-6)
    assert value.ci95[0] <= factor <= value.ci95[1]
    assert channels == set(names)
    original = columns[names[0]][np.isfinite(columns[names[0]])]
    assert log[names[0]].values == pytest.approx(original)


def test_the_unit_of_one_wheel_is_judged_without_setpoints_as_well(table):
    t, columns = table
    without = {n: v for n, v in columns.items() if n not in SENT}
    cause, value, channels, _ = fault(t, scaled(without, SPEEDS[1:2], math.pi / 30))
    assert (cause, channels) == ("unit_error", {SPEEDS[1]})
    assert value.value == pytest.approx(math.pi / 30)


def test_all_wheels_and_setpoints_in_the_speed_of_the_rim_are_converted(table):
    t, columns = table
    spoilt = scaled(columns, SPEEDS + SENT, 0.085 * math.pi / 30 * 3.6)
    checked = check(log_of(t, spoilt), ROBOT)
    assert {f.causes for f in checked.findings} == {("unit_error",)}
    assert {n for f in checked.findings for n in f.regressors} == {*SPEEDS, *SENT}
    assert all("in km/h instead of rpm" in f.explanation for f in checked.findings)
    assert checked.log[SPEEDS[0]].values == pytest.approx(columns[SPEEDS[0]])


def test_a_position_in_degrees_is_left_out_with_the_remedy(table):
    t, columns = table
    degrees = {
        NAV[0]: 9.1 + columns[NAV[0]] / 73_470.0,
        NAV[1]: 48.7 + columns[NAV[1]] / 111_320.0,
    }
    checked = check(log_of(t, {**columns, **degrees}), ROBOT)
    assert not checked.findings
    assert not {NAV[0], NAV[1]} & set(checked.log.channels)
    assert (
        "nav.x_m, nav.y_m are latitude and longitude in degrees"
        in checked.log.notices[0]
    )


def test_units_of_a_heading(table):
    t, columns = table
    spoilt = {**columns, NAV[2]: np.degrees(columns[NAV[2]])}
    cause, value, channels, _ = fault(t, spoilt)
    assert (cause, channels) == ("unit_error", {NAV[2]})
    assert value.value == pytest.approx(180 / math.pi)


@pytest.mark.parametrize("k_om", [0.5, 1.0, 1.6])
def test_the_unit_of_a_gyro_is_told_without_navigation_whatever_k_om(k_om):
    t, columns = drive(8, k_om=k_om)
    without = {n: v for n, v in columns.items() if n not in NAV}
    cause, value, _, _ = fault(t, scaled(without, ("imu.gyro_z_rad_s",), 180 / math.pi))
    assert (cause, value.value) == ("unit_error", pytest.approx(180 / math.pi))


@pytest.mark.parametrize(
    "names",
    [("imu.gyro_z_rad_s",), (NAV[2],), (NAV[1],), (SPEEDS[3],), (SPEEDS[0], SPEEDS[1])],
)
def test_signs(table, names):
    t, columns = table
    cause, value, channels, log = fault(t, scaled(columns, names, -1))
    assert (cause, value.value, channels) == ("sign_flip", -1, set(names))
    original = columns[names[0]][np.isfinite(columns[names[0]])]
    assert log[names[0]].values == pytest.approx(original)


def test_a_base_that_turns_the_other_way_is_a_sign_and_no_gain(table):
    t, columns = table
    mirrored = scaled(columns, (NAV[1], NAV[2], "imu.gyro_z_rad_s"), -1)
    cause, _, channels, _ = fault(t, mirrored)
    assert cause == "sign_flip"
    assert channels == {NAV[1], NAV[2], "imu.gyro_z_rad_s"}


def test_a_side_that_runs_backward_is_told_by_the_tag(table):
    t, columns = table
    left = {n: v for n, v in scaled(columns, SPEEDS[:2], -1).items() if n not in SENT}
    assert fault(t, left)[::2] == ("sign_flip", set(SPEEDS[:2]))


@pytest.mark.parametrize("wheel", [0, 3])
def test_one_wheel_that_runs_backward_is_told_by_the_tag(table, wheel):
    """Without set-points; beside it the mean of its side would stand still."""
    t, columns = table
    one = {
        n: v
        for n, v in scaled(columns, SPEEDS[wheel : wheel + 1], -1).items()
        if n not in SENT
    }
    cause, _, channels, log = fault(t, one)
    assert (cause, channels) == ("sign_flip", {SPEEDS[wheel]})
    assert log[SPEEDS[wheel]].values == pytest.approx(columns[SPEEDS[wheel]])


def test_a_wheel_that_stands_still_does_not_hide_those_that_run_backward(table):
    t, columns = table
    spoilt = {n: v for n, v in scaled(columns, SPEEDS[:2], -1).items() if n not in SENT}
    findings = check(log_of(t, scaled(spoilt, SPEEDS[3:], 0)), ROBOT).findings
    flipped = [set(f.regressors) for f in findings if f.causes == ("sign_flip",)]
    assert flipped == [set(SPEEDS[:2])]


def test_sides_are_not_said_to_be_swapped_where_one_stands_still(table):
    t, columns = table
    spoilt = {n: v for n, v in columns.items() if n not in SENT} | {
        "wheel.fl.speed_rpm": columns["wheel.fr.speed_rpm"],
        "wheel.rl.speed_rpm": columns["wheel.rr.speed_rpm"],
    }
    findings = check(log_of(t, scaled(spoilt, SPEEDS[2:], 0)), ROBOT).findings
    assert ("swapped_sides",) not in [f.causes for f in findings]


@pytest.mark.parametrize("sign", [1, -1])
def test_swapped_sides(table, sign):
    t, columns = table
    spoilt = dict(columns)
    for left, right in (("fl", "fr"), ("rl", "rr")):
        a, b = f"wheel.{left}.speed_rpm", f"wheel.{right}.speed_rpm"
        spoilt[a], spoilt[b] = sign * columns[b], sign * columns[a]
    cause, _, channels, log = fault(t, spoilt)
    assert (cause, channels) == ("swapped_sides", set(SPEEDS))
    assert log[SPEEDS[2]].values == pytest.approx(columns[SPEEDS[2]])


@pytest.mark.parametrize("rate_hz", [43.0, 22.0])
def test_held_speeds_of_a_wheel_whose_large_steps_follow_its_setpoints(rate_hz):
    """Its held speeds were taken for responses to single set-points, and the encoder for slow."""
    rng = np.random.default_rng(8)
    t = np.arange(3000) / 100.0
    sent = np.repeat(rng.uniform(-80.0, 80.0, 60), 50)
    n = np.zeros(len(t))
    for k in range(1, len(t)):
        n[k] = n[k - 1] + 0.15 * (sent[k - 1] - n[k - 1])
    group = np.floor(t * rate_hz + 0.3)
    seen = (n + 0.1 * rng.standard_normal(len(t)))[np.searchsorted(group, group)]
    columns = {SENT[0]: sent, SPEEDS[0]: 0.1 * np.round(10.0 * seen)}
    cause, value, channels, _ = fault(t, columns)
    assert (cause, channels) == ("held_samples", {SPEEDS[0]})
    assert value.value == pytest.approx(rate_hz, rel=0.03)


def test_a_coarse_speed_that_jumps_with_every_setpoint_is_not_held():
    """Most jumps are large beside a step of the encoder, but by far not all."""
    t = np.arange(3000) / 20.0
    sent = np.repeat(np.random.default_rng(9).uniform(-80.0, 80.0, 300), 10)
    columns = {SENT[0]: sent, SPEEDS[0]: 5.0 * np.round(np.roll(sent, 1) / 5.0)}
    assert check(log_of(t, columns), ROBOT).findings == ()


@pytest.mark.parametrize(
    ("names", "rate_hz"), [(SPEEDS, 4.0), (("imu.gyro_z_rad_s",), 10.0)]
)
def test_held_samples(table, names, rate_hz):
    t, columns = table
    group = np.floor(t * rate_hz + 0.3)
    first = np.searchsorted(group, group)
    spoilt = {n: v[first] if n in names else v for n, v in columns.items()}
    cause, value, channels, log = fault(t, spoilt)
    assert (cause, channels) == ("held_samples", set(names))
    assert value.value == pytest.approx(rate_hz, rel=0.02)
    assert value.ci95[0] <= rate_hz <= value.ci95[1]
    real = t[np.unique(first)]
    assert np.isin(real[10:-10], log[names[0]].t_s).mean() > 0.99
    assert len(log[names[0]]) < 1.1 * len(real)


def test_held_readings_that_are_rounded_often_stay_the_same_for_several_periods():
    """Taken for current ones, they would make every other clock early."""
    t, columns = drive(6, moves_s=6.0)
    columns = quantised(columns, 1.0)
    first = np.searchsorted(np.floor(t * 5.7), np.floor(t * 5.7))
    spoilt = {n: v[first] if n in SPEEDS else v for n, v in columns.items()}
    cause, value, channels, _ = fault(t, spoilt)
    assert (cause, channels) == ("held_samples", set(SPEEDS))
    assert value.value == pytest.approx(5.7, rel=0.03)


@pytest.mark.parametrize("missing", [0.0, 0.01])
def test_no_reading_of_a_held_channel_is_stale(table, missing):
    """A coarse wheel may show one value for many periods while the others change."""
    t, columns = table
    columns, rng = quantised(columns, 0.25), np.random.default_rng(1)
    group = np.floor(t * 6.0 + 0.3)
    first = np.searchsorted(group, group)
    spoilt = dict(columns)
    for name in SPEEDS:
        gone = rng.random(len(t)) < missing
        spoilt[name] = np.where(gone[first], np.nan, columns[name][first])
    log = fault(t, spoilt)[3]
    for name in SPEEDS:
        kept = log[name]
        stale = kept.values != columns[name][np.searchsorted(t, kept.t_s)]
        assert stale.mean() < 0.02
        assert len(kept) > 0.95 * len(np.unique(group))


@pytest.mark.parametrize("rate_hz", [5.0, 12.5])
def test_setpoints_held_in_the_log_alone(rate_hz):
    t, columns = drive(9, lag_s=5e-3)
    group = np.floor(t * rate_hz + 0.3)
    first = np.searchsorted(group, group)
    spoilt = {n: v[first] if n in SENT else v for n, v in columns.items()}
    checked = check(log_of(t, spoilt), ROBOT)
    (finding,) = checked.findings
    assert (finding.causes, set(finding.regressors)) == (("held_samples",), set(SENT))
    assert finding.parameters["held_samples"].value == pytest.approx(rate_hz, rel=0.02)
    assert checked.lost_setpoints
    name = SENT[0]
    error, as_logged = (
        checked.log[name].values - columns[name],
        spoilt[name] - columns[name],
    )
    assert np.abs(error).mean() < 0.4 * np.abs(as_logged).mean()


@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_interpolated_setpoints_are_held_again(table, rate_hz):
    t, columns = table
    every = round(50 / rate_hz)
    spoilt = {
        n: np.interp(t, t[::every], v[::every]) if n in SENT else v
        for n, v in columns.items()
    }
    cause, value, channels, log = fault(t, spoilt)
    assert (cause, channels) == ("interpolated_setpoint", set(SENT))
    assert value.value == pytest.approx(rate_hz, rel=0.01)
    assert np.isin(t[::every], log[SENT[0]].t_s).mean() > 0.99
    assert len(log[SENT[0]]) < 1.05 * len(t) / every


@pytest.mark.parametrize("rows", [0, 3])
@pytest.mark.parametrize("noise_rpm", [0.0, 0.005])
def test_setpoints_recorded_as_measurement_are_left_out(table, rows, noise_rpm):
    t, columns = table
    spoilt = dict(columns)
    added = noise_rpm * np.random.default_rng(1).uniform(-1, 1, len(t))
    for sent, speed in zip(SENT, SPEEDS, strict=True):
        spoilt[speed] = (
            np.concatenate([np.zeros(rows), columns[sent]])[: len(t)] + added
        )
    cause, value, channels, log = fault(t, spoilt)
    assert (cause, channels) == ("setpoint_as_measurement", set(SPEEDS))
    assert value.value == pytest.approx(0.02 * rows)
    assert not set(SPEEDS) & set(log.channels)


def test_repeated_samples_are_dropouts_and_left_out(table):
    t, columns = table
    rng = np.random.default_rng(2)
    spoilt = {n: v.copy() for n, v in columns.items()}
    lost = np.zeros(len(t), dtype=bool)
    for k in rng.choice(len(t) - 100, 30, replace=False):
        lost[k + 1 : k + 15] = True
        for name in SPEEDS:
            spoilt[name][k : k + 15] = spoilt[name][k]
    cause, value, channels, log = fault(t, spoilt)
    assert (cause, channels) == ("dropouts", set(SPEEDS))
    assert value.value == pytest.approx(lost.mean(), rel=0.05)
    kept = np.isin(t, log[SPEEDS[0]].t_s)
    # of two bursts in one the second may be short
    assert np.mean(kept == ~lost) > 0.999


@pytest.mark.parametrize(("share", "found"), [(0.1, True), (0.002, False)])
def test_single_samples_that_repeat_the_one_before_are_dropouts(table, share, found):
    """Of values that never come twice one repetition is no chance; a few are not worth a word."""
    t, columns = table
    lost = np.random.default_rng(2).random(len(t)) < share
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(t))))
    spoilt = {n: v[last] if n in SPEEDS else v for n, v in columns.items()}
    if not found:
        assert not check(log_of(t, spoilt), ROBOT).findings
        return
    cause, value, channels, log = fault(t, spoilt)
    assert (cause, channels) == ("dropouts", set(SPEEDS))
    assert value.value == pytest.approx(share, rel=0.1)
    assert np.array_equal(log[SPEEDS[0]].t_s, t[~lost])


@pytest.mark.parametrize("seed", range(3))
def test_rounded_noise_that_repeats_itself_now_and_then_is_no_dropout(seed):
    t, columns = drive(seed, length_s=600.0)
    columns["imu.gyro_z_rad_s"] = 0.0011 * np.round(
        columns["imu.gyro_z_rad_s"] / 0.0011
    )
    assert not check(log_of(t, columns), ROBOT).findings


def test_rows_missing_in_bursts_are_dropouts(table):
    t, columns = table
    keep = np.ones(len(t), dtype=bool)
    for k in np.random.default_rng(3).choice(len(t) - 100, 40, replace=False):
        keep[k : k + 12] = False
    cause, value, _, _ = fault(t[keep], {n: v[keep] for n, v in columns.items()})
    assert cause == "dropouts"
    assert value.value == pytest.approx((~keep).mean(), rel=0.2)


@pytest.mark.parametrize("offset_s", [-0.2, 0.25])
def test_clock_of_the_tag(table, offset_s):
    t, columns = table
    log = log_of(t, columns)
    moved = {n: move(log[n], offset_s, 0.0) for n in NAV}
    (finding,) = check(log.with_channels(moved), ROBOT).findings
    value = finding.parameters["clock_offset"]
    assert value.value == pytest.approx(offset_s, abs=0.02)
    assert set(finding.regressors) == set(NAV)


def test_drifting_clock_of_the_tag():
    t, columns = drive(9, length_s=360.0)
    log = log_of(t, columns)
    moved = {n: move(log[n], 0.0, 5e-4) for n in NAV}
    checked = check(log.with_channels(moved), ROBOT)
    (finding,) = checked.findings
    value = finding.parameters["clock_drift"]
    assert value.value == pytest.approx(5e-4, rel=0.2)
    assert checked.log[NAV[0]].t_s == pytest.approx(log[NAV[0]].t_s, abs=0.04)


@pytest.mark.parametrize("names", [NAV[:2], NAV[2:]])
def test_one_late_source_of_the_tag_is_no_clock(table, names):
    t, columns = table
    log = log_of(t, columns)
    moved = {n: move(log[n], 0.2, 0.0) for n in names}
    assert not check(log.with_channels(moved), ROBOT).findings


def test_without_stamps_clocks_are_not_judged(table):
    t, columns = table
    log = log_of(t, columns, has_stamps=False)
    moved = {n: move(log[n], -0.2, 0.0) for n in NAV}
    assert not check(log.with_channels(moved), ROBOT).findings


@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                [*SPEEDS, *SENT, *NAV, "imu.gyro_z_rad_s", "wheel.fl.angle_rad"]
            ),
            st.lists(
                st.sampled_from([0.0, 1.0, -1.0, 3.2, 1e-9, 700.0]),
                min_size=1,
                max_size=40,
            ),
        ),
        min_size=1,
        max_size=8,
        unique_by=lambda pair: pair[0],
    ),
    st.integers(1, 3),
)
@settings(max_examples=150, deadline=None)
def test_no_log_is_too_odd_to_be_checked(channels, spans):
    columns = {name: np.array(values * 3)[:100] for name, values in channels}
    log = log_of(np.arange(120) / 50, {n: pad(v) for n, v in columns.items()}, spans)
    checked = check(log, ROBOT)
    made = {
        n.replace("angle_rad", "speed_rpm"): n for n in log.channels if "angle_rad" in n
    }
    assert set(checked.log.channels) <= {*log.channels, *made}
    for name, channel in checked.log.channels.items():
        assert np.isfinite(channel.values).all()
        before = log[name if name in log else made[name]]
        cuts = len(checked.log.spans) - spans  # a set-point holds on behind each
        assert 0 < len(channel) <= len(before) + cuts * (name in SENT)


def pad(values):
    return np.concatenate([values, np.full(120 - len(values), np.nan)])


def move(channel, offset_s, drift):
    return type(channel)(
        channel.t_s * (1 + drift) + offset_s, channel.values, channel.span
    )


@pytest.mark.parametrize("size", [2 * math.pi, 50.0, 6.4, 6.0, 5.5])
def test_wheel_angles_that_wrap_are_made_continuous(table, size):
    t, columns = table
    angle = np.cumsum(columns[SPEEDS[0]]) * 0.02 * math.pi / 30
    wheel = {**columns, "wheel.fl.angle_rad": angle % size}
    checked = check(log_of(t, wheel), ROBOT)
    assert not checked.findings
    found = checked.log["wheel.fl.angle_rad"].values
    assert found - found[0] == pytest.approx(angle - angle[0], abs=0.02)
    assert "the angle wraps at" in checked.log.notices[0]


@pytest.mark.parametrize(("ticks", "bits"), [(8000, 16), (1024, 8)])
def test_counters_that_flicker_about_zero_at_rest_are_made_continuous(
    table, ticks, bits
):
    t, columns = table
    rng = np.random.default_rng(5)
    turns = np.cumsum(np.where(t < 40.0, 0.0, columns[SPEEDS[0]])) * 0.02 / 60
    count = np.floor(ticks * turns + rng.uniform(-0.5, 0.5, len(t)))
    tick = 2 * math.pi / ticks
    seen = {**columns, "wheel.fl.angle_rad": count % 2**bits * tick}
    found = check(log_of(t, seen), ROBOT).log["wheel.fl.angle_rad"].values
    assert found - found[0] == pytest.approx((count - count[0]) * tick, abs=20 * tick)


@pytest.mark.parametrize("size", [2 * math.pi, 6.4])
def test_the_size_of_a_counter_is_measured_to_its_noise(table, size):
    """Many turns behind the start no error has grown: 6.4 rad are no turn, nor are 6.283."""
    rng = np.random.default_rng(4)
    t = np.arange(6000) * 0.02
    angle = np.cumsum(rng.normal(0.15, 0.01, len(t))) + rng.normal(0.0, 0.001, len(t))
    for seen in (angle % size, np.round(angle % size / 0.01) * 0.01):
        checked = check(
            log_of(t, {"wheel.fl.angle_rad": seen, SPEEDS[0]: 0 * t + 1}), ROBOT
        )
        found = checked.log["wheel.fl.angle_rad"].values
        assert found[-1] - found[0] == pytest.approx(angle[-1] - angle[0], rel=1e-3)


@pytest.mark.parametrize("size", [None, 2 * math.pi])
def test_angles_of_wheels_alone_are_differentiated(table, size):
    t, columns = table
    whole = np.cumsum(columns[SPEEDS[0]]) * 0.02 * math.pi / 30
    wheel = {n: c for n, c in columns.items() if n != SPEEDS[0]}
    seen = whole if size is None else whole % size
    checked = check(log_of(t, {**wheel, "wheel.fl.angle_rad": seen}), ROBOT)
    channel = checked.log[SPEEDS[0]]
    assert "wheel.fl.angle_rad" not in checked.log
    assert checked.log.made == {SPEEDS[0]}
    assert channel.values == pytest.approx(columns[SPEEDS[0]][1:], abs=0.05)
    assert channel.t_s == pytest.approx(t[1:] - 0.01)
    assert "no speed was recorded of wheel.fl.angle_rad" in checked.log.notices[-1]


def test_setpoints_above_the_top_speed_are_told(table):
    t, columns = table
    log = log_of(
        t,
        {**columns, SENT[1]: np.where(t > 10.0, 1.5 * ROBOT.max_rpm, columns[SENT[1]])},
    )
    (note,) = check(log, ROBOT).log.notices
    assert f"{SENT[1]} reaches 135 rpm, but plant.max_rpm is 90" in note
    assert not check(log, replace(ROBOT, max_rpm=140.0)).log.notices
    assert not check(replace(log, plant={"track_m": 0.5}), ROBOT).log.notices, (
        "not replayed"
    )
