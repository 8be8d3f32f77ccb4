"""The pose of a map: it jumps where it is corrected, and must not be the wheels' odometry."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.measured.corrections import cut_at_corrections
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.measured.own_odometry import without_own_odometry
from hilserver.measured.reading import read_measured

RADIUS_M, TRACK_M = 0.1, 0.4
RPM = 30.0 / np.pi


def drive(
    wheel_noise_rpm=0.2, pose_m=0.0, pose_rad=0.0, of_encoders=False, jumps=(), seed=0
):
    """A drive of 100 s; the pose is that of the robot, or made of what the encoders say.

    The robot's wheels are 3 % larger than its driver knows, and it turns 10 % less.
    """
    rng = np.random.default_rng(seed)
    t_s = 0.02 * np.arange(5000)
    forward = 0.5 + 0.3 * np.sin(0.4 * t_s)
    turn = 0.7 * np.cos(0.23 * t_s)
    left, right = forward - 0.5 * TRACK_M * turn, forward + 0.5 * TRACK_M * turn
    shown = [
        v / RADIUS_M * RPM + wheel_noise_rpm * rng.standard_normal(len(t_s))
        for v in (left, right)
    ]
    v, w = 1.03 * forward, 0.9 * turn
    if of_encoders:
        left, right = (s / RPM * RADIUS_M for s in shown)
        v, w = 0.5 * (left + right), (right - left) / TRACK_M
    yaw = np.cumsum(w) * 0.02
    x, y = np.cumsum(v * np.cos(yaw)) * 0.02, np.cumsum(v * np.sin(yaw)) * 0.02
    for at_s, by_m in jumps:
        x = x + by_m * (t_s >= at_s)
    rows = slice(None, None, 2)
    pose = {
        "nav.x_m": x[rows] + pose_m * rng.standard_normal(2500),
        "nav.y_m": y[rows] + pose_m * rng.standard_normal(2500),
        "nav.yaw_rad": yaw[rows] + pose_rad * rng.standard_normal(2500),
    }
    span = np.zeros(5000, dtype=np.int64)
    channels = {
        name: Channel(t_s, sign * values, span)
        for name, sign, values in (
            ("wheel.fl.speed_rpm", 1.0, shown[0]),
            ("wheel.fr.speed_rpm", -1.0, shown[1]),
        )
    }
    channels |= {n: Channel(t_s[rows], v, span[rows]) for n, v in pose.items()}
    source = LogSource("slam.csv", "0" * 64)
    return MeasuredLog((source,), channels, (Span(0, None, 0.0, float(t_s[-1])),))


def test_odometry_between_corrections_is_no_evidence():
    log = drive(of_encoders=True, jumps=[(30.0, 0.2), (55.0, -0.3)])
    left = without_own_odometry(log)
    assert not {"nav.x_m", "nav.y_m", "nav.yaw_rad"} & set(left.channels)
    assert "repeats the noise of the wheel speeds" in left.notices[0]


def test_odometry_that_comes_a_row_late_or_on_other_stamps_is_known_as_well():
    log = drive(of_encoders=True)
    for late_s in (0.02, 0.033):
        late = {
            name: replace(log[name], t_s=log[name].t_s + late_s)
            for name in ("nav.x_m", "nav.y_m", "nav.yaw_rad")
        }
        left = without_own_odometry(log.with_channels(late))
        assert "nav.yaw_rad" not in left


@pytest.mark.parametrize(
    ("pose_m", "pose_rad"), [(0.0, 0.0), (1e-4, 1e-4), (0.01, 0.005)]
)
@pytest.mark.parametrize("wheel_noise_rpm", [0.02, 0.2])
def test_a_measured_pose_stays_however_exact(pose_m, pose_rad, wheel_noise_rpm):
    log = drive(wheel_noise_rpm, pose_m, pose_rad)
    assert without_own_odometry(log) is log


def test_the_log_is_cut_where_the_pose_jumps_and_stays():
    log = drive(pose_m=0.005, pose_rad=0.002, jumps=[(30.0, 0.2), (55.0, -0.3)])
    parts = cut_at_corrections(log)
    starts = [span.start_s for span in parts.spans]
    assert starts == pytest.approx([0.0, 30.0, 55.0], abs=0.05)
    assert "jumps 2 times, by up to 0." in parts.notices[0]


def test_wild_samples_and_noise_are_not_corrections():
    log = drive(pose_m=0.01, pose_rad=0.002)
    values = log["nav.x_m"].values.copy()
    values[[300, 900, 901]] += 2.0
    log = log.with_channels({"nav.x_m": log["nav.x_m"].with_values(values)})
    assert cut_at_corrections(log) is log


def test_a_mapping_says_that_a_map_shows_the_pose(tmp_path):
    log = drive(of_encoders=True)
    t_s = log["wheel.fl.speed_rpm"].t_s
    columns = [t_s]
    for channel in log.channels.values():
        column = np.full(len(t_s), np.nan)
        column[np.searchsorted(t_s, channel.t_s)] = channel.values
        columns.append(column)
    text = ",".join(["t_s", *log.channels])
    path = tmp_path / "slam.csv"
    np.savetxt(path, np.column_stack(columns), "%.9f", ",", header=text, comments="")
    mapped = "".join(f"  {name}: {{column: {name}}}\n" for name in log.channels)
    mapping = tmp_path / "map.yaml"
    mapping.write_text("reference: {by: map}\nchannels:\n" + mapped)
    found = read_measured([path], mapping)
    assert found.pose_errors_last
    assert "nav.yaw_rad" not in found
    assert any("odometry of these wheels" in note for note in found.notices)

    mapping.write_text("channels:\n" + mapped)
    assert "nav.yaw_rad" in read_measured([path], mapping)


def test_a_robot_that_starts_and_stops_at_once_does_not_jump():
    log = drive()
    t_s = log["nav.yaw_rad"].t_s
    starts = np.cumsum(np.where(t_s % 5.0 < 2.0, 0.1, 0.0))
    yaw = np.angle(np.exp(1j * starts))
    log = log.with_channels({"nav.yaw_rad": log["nav.yaw_rad"].with_values(yaw)})
    assert cut_at_corrections(log) is log


def short_moves(rate_hz, move_s, jump_m=0.0):
    """Return a log of moves with rests between; the map corrects itself during a rest."""
    rng = np.random.default_rng(0)
    t_s = 0.02 * np.arange(10_000)
    into_s = t_s % 8.0 - 3.0
    speed = np.where((into_s > 0.0) & (into_s < move_s), 0.5, 0.0)
    rpm = speed / RADIUS_M * RPM
    x = 0.02 * np.cumsum(speed) + jump_m * (t_s >= 105.0)
    rows = slice(None, None, 50 // rate_hz)
    noise = 0.003 * rng.standard_normal((3, len(t_s[rows])))
    span = np.zeros(len(t_s), dtype=np.int64)
    channels = {
        "wheel.fl.speed_rpm": Channel(t_s, rpm, span),
        "wheel.fr.speed_rpm": Channel(t_s, -rpm, span),
        "nav.x_m": Channel(t_s[rows], x[rows] + noise[0], span[rows]),
        "nav.y_m": Channel(t_s[rows], noise[1], span[rows]),
        "nav.yaw_rad": Channel(t_s[rows], noise[2] / 3.0, span[rows]),
    }
    source = LogSource("slam.csv", "0" * 64)
    return MeasuredLog((source,), channels, (Span(0, None, 0.0, float(t_s[-1])),))


@pytest.mark.parametrize(
    ("rate_hz", "move_s"), [(1, 2.0), (2, 1.0), (2, 1.5), (5, 0.6), (10, 0.3)]
)
def test_a_short_move_that_the_wheels_explain_is_no_correction(rate_hz, move_s):
    log = short_moves(rate_hz, move_s)
    assert cut_at_corrections(log) is log


@pytest.mark.parametrize("jump_m", [0.5, -0.2])
def test_a_jump_between_short_moves_is_a_correction(jump_m):
    parts = cut_at_corrections(short_moves(5, 0.6, jump_m))
    starts = [span.start_s for span in parts.spans]
    assert starts == pytest.approx([0.0, 105.0], abs=0.3)


def test_a_heading_that_jumps_alone_has_no_size_in_metres():
    log = drive(pose_m=0.002, pose_rad=0.001)
    yaw = log["nav.yaw_rad"]
    turned = yaw.with_values(yaw.values + 0.3 * (yaw.t_s >= 40.0))
    parts = cut_at_corrections(log.with_channels({"nav.yaw_rad": turned}))
    assert len(parts.spans) == 2
    assert "jumps 1 times, as where" in parts.notices[0]


def test_a_wheel_that_is_silent_in_a_segment_does_not_stop_the_reading():
    log = drive(of_encoders=True)
    t_s = log["wheel.fl.speed_rpm"].t_s
    parts = tuple(Span(i, None, 50.0 * i, 50.0 * i + 49.98) for i in range(2))
    channels = {
        name: replace(channel, span=(channel.t_s >= 50.0).astype(np.int64))
        for name, channel in log.channels.items()
    }
    fl = channels["wheel.fl.speed_rpm"]
    first = t_s < 50.0
    channels["wheel.rl.speed_rpm"] = Channel(
        t_s[first], fl.values[first], fl.span[first]
    )
    log = replace(log, channels=channels, spans=parts)
    assert "nav.yaw_rad" not in without_own_odometry(log)
