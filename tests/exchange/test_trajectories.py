"""Poses as trajectories: what the files say, after the formats' own definitions."""

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from hilserver import commands
from hilserver.logs import read_log


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A drive of our own, on an arc, with a tag that measures every 50 ms."""
    folder = tmp_path_factory.mktemp("recording")
    (folder / "config.yaml").write_text("sensors: {nav: {enabled: true}}\n")
    (folder / "drive.yaml").write_text(
        "steps: [{at_s: 0.1, write: {wheels.setpoints_rpm: [40, 40, -30, -30]}}]\n"
    )
    path = folder / "drive.mcap"
    words = ["simulate", folder / "drive.yaml", "-c", folder / "config.yaml"]
    assert run(*words, "--duration", "0.8", "-o", path) == 0
    return path


@pytest.fixture
def table(tmp_path):
    def write(columns, rows):
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
        return tmp_path / "log.csv"

    return write


def run(*words):
    return commands.main([*map(str, words)])


def convert(log, out, kind, *more):
    assert run("convert", log, out, "--format", kind, *more) == 0
    return out


def yaw_of(z, w):
    return 2.0 * np.arctan2(z, w)


def test_tum_has_each_sample_once_at_its_time(recording, tmp_path):
    out = convert(recording, tmp_path / "out", "tum")
    log = read_log(recording)
    for name, every in (("pose", 1), ("nav", 50)):
        t_s, x, y, z, qx, qy, qz, qw = np.loadtxt(out / f"{name}.tum").T
        np.testing.assert_allclose(t_s, log.t_s[::every], atol=1e-9)
        np.testing.assert_array_equal(x, log.columns[f"{name}.x_m"][::every])
        np.testing.assert_array_equal(y, log.columns[f"{name}.y_m"][::every])
        assert not np.stack([z, qx, qy]).any()
        yaw = log.columns[f"{name}.yaw_rad"][::every]
        np.testing.assert_allclose(yaw_of(qz, qw), yaw, atol=1e-15)
    assert (out / "nav.tum").read_text().startswith("# timestamp tx ty tz qx qy qz qw")


def test_kitti_has_as_many_rows_for_each_pose_and_their_times_beside(
    recording, tmp_path
):
    out = convert(recording, tmp_path / "out", "kitti")
    log = read_log(recording)
    times = np.loadtxt(out / "times.txt")
    np.testing.assert_allclose(times, log.t_s[::50], atol=1e-9)
    for name in ("pose", "nav"):
        matrices = np.loadtxt(out / f"{name}.kitti").reshape(-1, 3, 4)
        assert len(matrices) == len(times)
        x, y, yaw = (
            log.columns[f"{name}.{n}"][::50] for n in ("x_m", "y_m", "yaw_rad")
        )
        none = np.zeros_like(x)
        np.testing.assert_allclose(matrices[:, :, 3], np.transpose([x, y, none]))
        ahead = np.transpose([np.cos(yaw), np.sin(yaw), none])
        np.testing.assert_allclose(matrices[:, :, 0], ahead, atol=1e-15)
        np.testing.assert_allclose(np.linalg.det(matrices[:, :, :3]), 1.0)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_odometry_in_a_bag_is_read_again_through_a_mapping(
    recording, tmp_path, storage
):
    out = convert(recording, tmp_path / "out", "odometry", "--storage", storage)
    lines = ["time: {stamp: received}", "channels:"]
    for name, path in (
        ("x_m", "position.x"),
        ("y_m", "position.y"),
        ("yaw_rad", "orientation.yaw"),
    ):
        lines += [
            f"  {source}.{name}: {{topic: /{source}, field: pose.pose.{path}}}"
            for source in ("pose", "nav")
        ]
    twist = "{topic: /pose, field: twist.twist.linear.x}"
    lines.append(f"  velocity.linear_m_s: {twist}")
    (tmp_path / "map.yaml").write_text("\n".join(lines) + "\n")
    words = ["convert", out, tmp_path / "again.csv"]
    assert run(*words, "--mapping", tmp_path / "map.yaml") == 0
    ours, again = read_log(recording), read_log(tmp_path / "again.csv")
    for name in ("pose.x_m", "pose.y_m", "velocity.linear_m_s"):
        np.testing.assert_array_equal(again.columns[name], ours.columns[name])
    yaw = again.columns["pose.yaw_rad"]
    np.testing.assert_allclose(yaw, ours.columns["pose.yaw_rad"], atol=1e-15)
    is_there = np.isfinite(again.columns["nav.x_m"])
    assert np.flatnonzero(is_there).tolist() == list(range(0, len(ours), 50))


def test_an_estimate_keeps_its_covariance_and_begins_with_its_first_fix(
    table, tmp_path
):
    names = ["x_m", "y_m", "yaw_rad", "linear_m_s", "angular_rad_s"]
    values = [1.0, 2.0, 0.5, 0.3, 0.1]
    names += [f"{name}_sd" for name in names] + ["x_y_cov", "x_yaw_cov", "y_yaw_cov"]
    values += [0.1, 0.2, 0.3, 0.4, 0.5, 0.01, 0.02, 0.03]
    columns = ["t_s", "estimate.state", *(f"estimate.{name}" for name in names)]
    rows = [[0.01 * i, 2.0 if i > 3 else 0.0, *values] for i in range(10)]
    out = convert(table(columns, rows), tmp_path / "out", "odometry")
    with AnyReader([out]) as reader:
        found = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
        ]
    assert len(found) == 6
    covariance = found[0].pose.covariance.reshape(6, 6)
    together = covariance[np.ix_((0, 1, 5), (0, 1, 5))]
    wanted = [[0.01, 0.01, 0.02], [0.01, 0.04, 0.03], [0.02, 0.03, 0.09]]
    np.testing.assert_allclose(together, wanted)
    assert found[0].twist.twist.linear.x == 0.3
    assert found[0].header.stamp.nanosec == 40_000_000


def test_what_a_robot_measured_counts_once_however_long_a_row_repeats_it(
    table, tmp_path
):
    columns = ["t_s", "sim.tick", "pose.x_m", "pose.y_m", "pose.yaw_rad"]
    columns += [f"measured.nav.{name}" for name in ("x_m", "y_m", "yaw_rad")]
    rows = [
        [0.001 * i, i, 0.001 * i, 0.0, 0.0, *(i // 20 * np.array([0.02, 0.1, 0.01])).tolist()]
        for i in range(400)
    ]  # fmt: skip
    out = convert(table(columns, rows), tmp_path / "out", "tum")
    own, measured = (np.loadtxt(out / f"{n}.tum") for n in ("pose", "measured.nav"))
    assert len(own) == 400
    np.testing.assert_allclose(measured[:, 0], 0.02 * np.arange(20), atol=1e-9)
    np.testing.assert_allclose(measured[:, 1], 0.02 * np.arange(20))


def test_each_segment_is_a_trajectory(table, tmp_path):
    rows = [[0.1 * (i % 5), i // 5, 1.0 * i, 0.0] for i in range(10)]
    log = table(["t_s", "segment", "nav.x_m", "nav.y_m"], rows)
    out = convert(log, tmp_path / "tum", "tum")
    assert sorted(file.name for file in out.iterdir()) == ["nav-0.tum", "nav-1.tum"]
    assert np.loadtxt(out / "nav-1.tum")[0, :2].tolist() == [0.0, 5.0]
    with AnyReader([convert(log, tmp_path / "bag", "odometry")]) as reader:
        assert set(reader.topics) == {"/nav/segment_0", "/nav/segment_1"}


def test_a_place_without_heading_is_said(table, tmp_path, capsys):
    log = table(["t_s", "nav.x_m", "nav.y_m"], [[0.1 * i, 1.0, 2.0] for i in range(5)])
    out = convert(log, tmp_path / "out", "tum")
    assert "nav, segment 0: 5 poses, without a heading" in capsys.readouterr().out
    assert (np.loadtxt(out / "nav.tum")[:, 7] == 1.0).all()


@pytest.mark.parametrize(
    ("columns", "start_s", "kind", "says"),
    [
        (["t_s", "wheel.fl.speed_rpm"], 0.0, "tum", "contains no pose"),
        (["t_s", "nav.x_m", "nav.y_m"], 1.7e12, "odometry", "do not fit into a bag"),
        (["t_s", "nav.x_m", "nav.y_m"], -5.0, "odometry", "do not fit into a bag"),
    ],
)
def test_what_is_no_trajectory_is_one_sentence_and_leaves_nothing(
    table, tmp_path, capsys, columns, start_s, kind, says
):
    log = table(columns, [[start_s + i, *[1.0] * (len(columns) - 1)] for i in range(5)])
    assert run("convert", log, tmp_path / "out", "--format", kind) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert line.startswith(f"hilserver: {log if kind == 'tum' else tmp_path / 'out'}: ")
    assert not (tmp_path / "out").exists()


def test_poses_of_other_times_have_no_rows_in_common(table, tmp_path, capsys):
    columns = ["t_s", "nav.x_m", "nav.y_m", "measured.nav.x_m", "measured.nav.y_m"]
    nan = float("nan")
    early = [(0.1 * i, 1.0, 2.0, nan, nan) for i in range(10)]
    late = [(2.0 + 0.1 * i, nan, nan, 1.0, 2.0) for i in range(10)]
    log = table(columns, early + late)
    assert run("convert", log, tmp_path / "out", "--format", "kitti") == 2
    assert "no time in common" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_name_of_a_file_is_not_given_to_a_folder(table, tmp_path, capsys):
    log = table(["t_s", "nav.x_m", "nav.y_m"], [[0.0, 1.0, 1.0]])
    assert run("convert", log, tmp_path / "poses.tum", "--format", "tum") == 2
    assert "choose a name without suffix" in capsys.readouterr().err
    assert not (tmp_path / "poses.tum").exists()


def test_all_signals_and_poses_alone_are_not_written_at_once(table, tmp_path, capsys):
    log = table(["t_s", "nav.x_m", "nav.y_m"], [[0.0, 1.0, 1.0]])
    assert run("convert", log, tmp_path / "out", "--bag", "--format", "tum") == 2
    assert "choose one" in capsys.readouterr().err
