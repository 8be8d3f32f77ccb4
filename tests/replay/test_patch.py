"""A patch changes a replay while it is named, and leaves nothing behind in its process."""

import contextlib
import io
import time

import pytest
import yaml

from hilserver.commands import main
from hilserver.config.root import Config
from hilserver.logs import read_log
from hilserver.plant.layout import WHEELS
from tests.helpers.daemons import running_daemon
from tests.replay.test_recordings import outputs_from

PATCH = {
    "schema": "hilserver.model_patch/1",
    "made_from": {
        "findings_sha256": "",
        "config_sha256": Config().sha256,
        "version": "1",
    },
    "terms": {
        "rotation_gain": {
            "value": -0.47,
            "unit": "1",
            "fitted_in": {"turn_rate_rad_s": [-0.1, 0.1]},
        }
    },
}
ROWS = [(0.0, 0, 0), (0.1, 20, 20), (0.5, 60, 20), (1.0, 0, 0)]


def replay(*words, cwd, code=0):
    """`hilserver replay` in this process; returns what it says."""
    said = io.StringIO()
    with (
        contextlib.chdir(cwd),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        assert main(["replay", *words]) == code, said.getvalue()
    return said.getvalue()


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """The same set-points without, with and without the patch."""
    folder = tmp_path_factory.mktemp("patched")
    names = [f"wheel.{w}.setpoint_rpm" for w in WHEELS]
    lines = [",".join(["t_s", *names])]
    lines += [f"{t},{left},{left},{-right},{-right}" for t, left, right in ROWS]
    (folder / "in.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "patch.yaml").write_text(yaml.safe_dump(PATCH), encoding="utf-8")
    replay("in.csv", "-o", "before.mcap", cwd=folder)
    said = replay("in.csv", "-o", "with.mcap", "--patch", "patch.yaml", cwd=folder)
    replay("in.csv", "-o", "after.mcap", cwd=folder)
    assert "another configuration" not in said
    return folder


def test_without_it_the_old_outputs_are_back_to_the_bit(replayed):
    before, patched, after = (
        read_log(replayed / f"{name}.mcap") for name in ("before", "with", "after")
    )
    assert outputs_from(after) == outputs_from(before)
    gained = abs(patched.columns["pose.yaw_rad"][-1]) / abs(
        before.columns["pose.yaw_rad"][-1]
    )
    assert gained == pytest.approx(0.53, rel=1e-6)


@pytest.fixture(scope="module")
def recorded_with_it(replayed):
    """A second of the daemon under the patch."""
    words = ("--record", "run.mcap", "--patch", "patch.yaml")
    with running_daemon(replayed, *words) as daemon:
        time.sleep(1.0)
        assert daemon.stop() == 0
    (replayed / "config.yaml").unlink()
    return replayed


def test_what_is_recorded_with_it_comes_again_without_naming_it(recorded_with_it):
    said = replay("run.mcap", "-o", "again.mcap", "--check", cwd=recorded_with_it)
    assert "equal, bit for bit" in said
    told = read_log(recorded_with_it / "again.mcap").run["patch"]
    assert told["content"]["terms"]["rotation_gain"]["value"] == -0.47


def test_another_patch_over_a_recording_is_refused_with_the_mend(recorded_with_it):
    other = PATCH | {"terms": {"rotation_gain": {"value": 0.1, "unit": "1"}}}
    (recorded_with_it / "other.yaml").write_text(
        yaml.safe_dump(other), encoding="utf-8"
    )
    words = ("run.mcap", "-o", "other.mcap", "--patch", "other.yaml")
    assert "--as-inputs" in replay(*words, cwd=recorded_with_it, code=78)
    replay(*words, "--as-inputs", cwd=recorded_with_it)


def test_a_patch_for_another_configuration_is_warned_about(replayed):
    (replayed / "config.yaml").write_text("plant: {max_rpm: 80}\n", encoding="utf-8")
    words = ("in.csv", "-c", "config.yaml", "--patch", "patch.yaml", "-o", "warned.csv")
    assert "fitted to another configuration" in replay(*words, cwd=replayed)
