"""Frames of the daemon: a row is the value at that instant, a held value is one sample."""

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.measured.channels import SETPOINTS
from hilserver.measured.frames import Sampling
from hilserver.measured.frames import _first_of_each as first_of_each
from hilserver.measured.reading import read_measured

SAMPLING = Sampling.of(Config.model_validate({"sensors": {"nav": {"enabled": True}}}))
SPEED, GYRO, NAV = "wheel.fl.speed_rpm", "imu.gyro_z_rad_s", "nav.x_m"
SETPOINT, TWIST = "wheel.fl.setpoint_rpm", "twist.linear_m_s"


def write_frames(path, columns, first=0, step=1, n=2000):
    """Write every `step`-th tick from `first` on; a column is a function of the tick."""
    ticks = range(first, n, step)
    names = ["t_s", "sim.tick", *columns]
    rows = [
        [f"{1e-3 * k!r}", str(k), *(repr(float(f(k))) for f in columns.values())]
        for k in ticks
    ]
    path.write_text("\n".join(",".join(row) for row in [names, *rows]) + "\n")
    return path


def held(period):
    """An output that shows the tick at which it was sampled."""
    return lambda tick: tick - tick % period


def read(path, **how):
    return read_measured([path], None, how.get("sampling", SAMPLING))


OWN = {SPEED: lambda tick: tick, GYRO: held(10), NAV: held(50)}


@pytest.mark.parametrize(
    ("first", "step"), [(0, 1), (7, 1), (0, 10), (0, 20), (7, 20), (13, 33)]
)
def test_a_sample_stands_once_and_at_its_own_tick(tmp_path, first, step):
    log = read(write_frames(tmp_path / "run.csv", OWN, first, step))
    for name in (SPEED, GYRO, NAV):
        channel = log[name]
        assert np.allclose(channel.values, 1e3 * channel.t_s, atol=1e-9)
        assert (np.diff(channel.t_s) > 0).all()
        assert channel.t_s[0] >= log.spans[0].start_s
    rows = len(range(first, 2000, step))
    assert rows - 1 <= len(log[SPEED]) <= rows
    assert len(log[NAV]) >= len(set(range(0, 2000, 50))) - 1 - first // 50
    assert log.on_ticks


def test_empty_between_samples_is_read_as_held(tmp_path):
    empty = {
        NAV: lambda tick: tick if tick % 50 == 0 else np.nan,
        SPEED: lambda tick: tick,
    }
    log = read(write_frames(tmp_path / "run.csv", empty))
    assert log[NAV].values.tolist() == list(range(0, 2000, 50))


def test_what_changes_within_a_sample_is_left_as_it_stands(tmp_path):
    log = read(write_frames(tmp_path / "run.csv", {GYRO: lambda tick: tick}))
    assert len(log[GYRO]) == 2000


def test_a_table_of_others_has_no_slices(tmp_path):
    path = write_frames(tmp_path / "log.csv", OWN)
    path.write_text(path.read_text().replace("sim.tick", "wheel.fl.angle_rad"))
    log = read(path)
    assert len(log[GYRO]) == 2000
    assert not log.on_ticks


def test_measured_columns_that_nobody_wrote_are_none(tmp_path):
    columns = {SPEED: lambda tick: tick, f"measured.{SPEED}": lambda _: 0.0}
    log = read(write_frames(tmp_path / "run.csv", columns))
    assert log[SPEED].values.tolist() == list(range(2000))


def test_measured_columns_count_once_where_a_value_came(tmp_path):
    columns = {
        SPEED: lambda tick: tick,
        f"measured.{SPEED}": lambda tick: 1.0 + tick // 20 + (tick % 20 < 7) * 0.0,
        f"measured.{NAV}": lambda _: 0.0,
    }
    log = read(write_frames(tmp_path / "run.csv", columns))
    assert NAV not in log
    assert log[SPEED].values.tolist() == [1.0 + i for i in range(100)]
    assert np.allclose(log[SPEED].t_s, 0.02 * np.arange(100))


def test_a_real_robot_at_rest_is_still_measured(tmp_path):
    columns = {f"measured.{SPEED}": lambda tick: min(tick // 20, 50), GYRO: held(10)}
    log = read(write_frames(tmp_path / "run.csv", columns))
    assert np.diff(log[SPEED].t_s).max() == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("mode", "there", "absent"), [(0, SETPOINT, TWIST), (1, TWIST, SETPOINT)]
)
def test_set_points_of_the_other_mode_are_none(tmp_path, mode, there, absent):
    columns = {
        SETPOINT: lambda tick: tick,
        TWIST: lambda tick: tick,
        "control.mode": lambda _: mode,
        SPEED: lambda tick: tick,
    }
    log = read(write_frames(tmp_path / "run.csv", columns))
    assert there in log
    assert absent not in log


def test_a_pose_that_is_set_begins_a_segment(tmp_path):
    columns = {
        SPEED: lambda tick: tick,
        "internal.pose_request": lambda tick: tick // 800,
    }
    log = read(write_frames(tmp_path / "run.csv", columns))
    assert [round(span.start_s, 3) for span in log.spans] == [0.0, 0.8, 1.6]


def test_the_safe_ramp_is_an_input(tmp_path):
    columns = {
        SETPOINT: lambda _: 5.0,
        "internal.command": lambda tick: 2.0 * (tick > 900),
    }
    log = read(write_frames(tmp_path / "run.csv", columns))
    assert "internal.command" in log


def test_long_recordings_of_the_simulation_keep_enough_rows(tmp_path):
    columns = {SPEED: lambda tick: tick, SETPOINT: lambda tick: tick, GYRO: held(10)}
    log = read(write_frames(tmp_path / "run.csv", columns, n=50_000))
    steps = np.rint(1e3 * np.diff(log[SPEED].t_s))
    assert set(steps) == {3.0}
    assert len(log[SETPOINT]) == 50_000  # at which tick a set-point came is not lost
    assert len(log[GYRO]) == 5000


def test_frames_left_out_in_which_nothing_changes_give_the_same_samples():
    rng = np.random.default_rng(3)
    ticks = np.arange(4000)
    arrives = np.concatenate([[0], np.cumsum(rng.integers(18, 23, 180))])
    sample = np.searchsorted(arrives, ticks, side="right")
    # some are the same as before
    values = np.round(rng.standard_normal(400)[sample], 1)
    commands = np.repeat(rng.standard_normal(400), 13)[: len(ticks)]
    changed = (np.diff(values, prepend=np.nan) != 0) | (
        np.diff(commands, prepend=np.nan) != 0
    )
    kept = changed | np.append(changed[1:], False)
    whole, thin = first_of_each(values, ticks), first_of_each(values[kept], ticks[kept])
    is_new = np.diff(values, prepend=np.nan) != 0
    np.testing.assert_array_equal(np.isfinite(thin) & is_new[kept], is_new[kept])
    extra = np.isfinite(thin) & ~is_new[kept]
    assert extra.sum() <= (np.isfinite(whole) & ~is_new).sum()


def taken(late_ticks, lie=lambda _: 0.0, n=100):
    """A robot that reports every 20 ms on ticks of its own, and when the rows come in."""
    rng = np.random.default_rng(1)
    came = 20 * np.arange(1, n + 1) + late_ticks + rng.integers(0, late_ticks + 1, n)
    which = np.searchsorted(came, np.arange(20 * n + 100), side="right")
    true_s = 0.02 * np.arange(n + 1) + 0.00037
    return {
        **dict.fromkeys((f"measured.{n}" for n in SETPOINTS), lambda tick: which[tick]),
        f"measured.{SPEED}": lambda tick: 0.5 * which[tick],
        f"measured.{NAV}": lambda tick: 1.0 + which[tick] // 5,
        SETPOINT: lambda _: 7.0,
        "control.mode": lambda _: 1.0,
        "internal.samples_wheel": lambda tick: which[tick],
        "internal.taken_wheel_s": lambda tick: true_s[which[tick]] + lie(which[tick]),
        "internal.samples_nav": lambda tick: which[tick] // 5,
        "internal.taken_nav_s": lambda tick: true_s[which[tick] // 5 * 5],
    }


@pytest.mark.parametrize("late_ticks", [0, 15])
def test_samples_lie_where_their_source_took_them(tmp_path, late_ticks):
    log = read(write_frames(tmp_path / "run.csv", taken(late_ticks), n=2040))
    for name, size in ((SETPOINT, 1.0), (SPEED, 0.5)):
        assert np.allclose(log[name].t_s, 0.02 / size * log[name].values, atol=1e-9)
        assert len(log[name]) >= 99
    assert np.allclose(log[NAV].t_s, 0.1 * (log[NAV].values - 1.0), atol=1e-9)
    assert not log.on_ticks
    # the robot says what it follows; ours is no input of it
    assert "control.mode" not in log


@pytest.mark.parametrize(
    ("lie", "left"),
    [
        (lambda k: 5.0 * (k > 50), 99),  # from the future: as it came
        (lambda k: -2.0 * (k > 50), 99),  # of long ago: as it came
        (lambda k: -0.3 * (k > 50), 84),  # back: what is no newer than before is none
    ],
)
def test_a_source_that_lies_about_time_makes_no_samples_of_it(tmp_path, lie, left):
    log = read(write_frames(tmp_path / "run.csv", taken(15, lie), n=2040))
    assert (np.diff(log[SETPOINT].t_s) > 0.0).all()
    assert left <= len(log[SETPOINT]) <= left + 1


def test_a_channel_that_was_missing_beside_others_has_no_sample(tmp_path):
    columns = taken(0)
    which, columns[f"measured.{SPEED}"] = columns[f"measured.{SETPOINT}"], None
    columns[f"measured.{SPEED}"] = lambda tick: which(tick) - (which(tick) == 60)
    log = read(write_frames(tmp_path / "run.csv", columns, n=2040))
    assert 60.0 not in log[SPEED].values
    assert (log[SPEED].values == 59.0).sum() == 1
    assert (log[SETPOINT].values == 60.0).sum() == 1


def test_a_robot_that_stands_for_a_moment_is_measured_all_along(tmp_path):
    columns = taken(0, n=200)
    which = columns[f"measured.{SETPOINT}"]
    # 4 of 200 samples: the robot stands, and shows exactly what it showed before
    columns[f"measured.{SPEED}"] = lambda tick: (
        min(which(tick), 60) + max(which(tick) - 64, 0)
    )
    log = read(write_frames(tmp_path / "run.csv", columns, n=4040))
    assert (log[SPEED].values == 60.0).sum() == 5
    assert np.diff(log[SPEED].t_s).max() == pytest.approx(0.02)


def test_a_sample_in_two_messages_is_complete_with_the_second(tmp_path):
    columns = taken(0)
    set_points = columns[f"measured.{SETPOINT}"]

    def speeds(tick):  # they come 3 ms behind the set-points of the same robot tick
        return set_points(max(tick - 3, 0))

    columns[f"measured.{SPEED}"] = lambda tick: 0.5 * speeds(tick)
    columns["internal.samples_wheel"] = lambda tick: set_points(tick) + speeds(tick)
    log = read(write_frames(tmp_path / "run.csv", columns, n=2040))
    for name, size in ((SETPOINT, 1.0), (SPEED, 0.5)):
        assert np.allclose(log[name].t_s, 0.02 / size * log[name].values, atol=1e-9)
        assert len(log[name]) >= 99


def test_what_is_not_counted_comes_with_the_wheels(tmp_path):
    voltage = "battery.voltage_v"
    columns = taken(0)
    which = columns[f"measured.{SPEED}"]
    columns[f"measured.{voltage}"] = lambda tick: 20.0 + which(tick)
    columns[f"measured.{SETPOINTS[0]}"] = lambda tick: which(
        max(tick - 3, 0)
    )  # a message of its own
    log = read(write_frames(tmp_path / "run.csv", columns, n=2040))
    assert np.array_equal(log[voltage].values - 20.0, log[SPEED].values)
    assert np.array_equal(log[voltage].t_s, log[SPEED].t_s)


def test_set_points_of_some_wheels_alone_are_not_what_the_robot_follows(tmp_path):
    columns = taken(0)
    del columns[f"measured.{SETPOINTS[3]}"]
    log = read(write_frames(tmp_path / "run.csv", columns, n=2040))
    # ours are not in force: it is a twist
    assert set(SETPOINTS) & log.channels.keys() == set()
    assert "control.mode" in log
