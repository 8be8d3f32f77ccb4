"""The observer in the daemon's step: signals, quality, both sources, snapshots, replay, metrics."""

from pathlib import Path

import numpy as np
import pytest

from hilserver.commands import main
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.errors import ConfigError
from hilserver.logs import read_log
from hilserver.observer.layout import N_HEAD, Shown
from hilserver.observer.metrics import METRICS, SAMPLES, counted
from hilserver.status import BAD_WAITING_FOR_INITIAL_DATA, GOOD, UNCERTAIN

NAV = {"enabled": True, "latency_s": 0.12, "yaw_latency_s": 0.08}
ESTIMATED = ("x_m", "y_m", "yaw_rad")


def assembled(nav=NAV, folder=None, **section):
    data = {"observer": {"enabled": True, **section}, "sensors": {"nav": nav}}
    return assemble_config(Config.model_validate(data), folder)


def value(core, name):
    return core.image.latest().values[core.table.slot(name)]


def status(core, name):
    return core.image.latest().status[core.table.slot(name)]


def drive(core, linear_m_s, angular_rad_s):
    twist = {"twist.linear_m_s": linear_m_s, "twist.angular_rad_s": angular_rad_s}
    assert core.gate.write("opcua", {"control.mode": 1, **twist}) == {}


def error(core):
    off = [value(core, f"estimate.{n}") - value(core, f"pose.{n}") for n in ESTIMATED]
    return np.hypot(*off[:2]), np.angle(np.exp(1j * off[2]))


def test_signals_lie_in_the_order_of_the_filter():
    table = assembled().table
    first = table.slot("estimate.x_m")
    begin = {
        "estimate.gyro_bias_rad_s": "gyro_bias",
        "estimate.x_m_sd": "deviations",
        "estimate.x_y_cov": "x_y",
        "estimate.nis": "nis",
        "estimate.state": "state",
        "estimate.rejected": "rejected",
    }
    places = {name: Shown.where(field).start for name, field in begin.items()}
    assert {name: table.slot(name) - first for name in begin} == places
    off = assemble_config(Config()).table
    assert "estimate.x_m" not in off
    assert "internal.samples_nav" not in off


async def test_the_simulated_robot_is_tracked_through_late_samples():
    async with build(assembled()) as core:
        drive(core, 0.5, 0.4)
        await core.scheduler.advance(6000)
        far, turned = error(core)
        assert far < 0.1
        assert abs(turned) < 0.03
        assert value(core, "estimate.state") == 2.0  # tracking
        assert status(core, "estimate.x_m") == GOOD
        assert value(core, "estimate.linear_m_s") == pytest.approx(0.5, abs=0.05)
        assert value(core, "estimate.rejected") == 0.0
        assert value(core, "estimate.x_m_sd") < 0.1


async def test_without_navigation_everything_is_uncertain():
    async with build(assembled(nav={"enabled": False})) as core:
        drive(core, 0.5, 0.4)
        await core.scheduler.advance(500)
        assert value(core, "estimate.state") == 0.0  # no fix
        assert status(core, "estimate.x_m") == UNCERTAIN
        assert value(core, "estimate.linear_m_s") == pytest.approx(0.5, abs=0.05)


async def feed(core, ticks, *, frozen=False):
    """Let the simulated robot be the real one, too: what it shows is measured, every 20 ms.

    The navigation has 10 samples in a second.
    """
    wheels = [f"wheel.{w}.speed_rpm" for w in ("fl", "rl", "fr", "rr")]
    for k in range(ticks // 20):
        await core.scheduler.advance(20)
        is_due = k % 5 == 0 and not frozen
        names = [
            *wheels,
            "imu.gyro_z_rad_s",
            *([f"nav.{n}" for n in ESTIMATED] if is_due else []),
        ]
        read = {f"measured.{n}": value(core, n) for n in names}
        now_ns = core.image.latest().planned_ns
        assert core.gate.write("ros2", read, received_ns=now_ns) == {}


def samples_of(core):
    head = counted(core.image.region("observer")[0])
    return {name: head[name] for name in SAMPLES}


async def test_the_measured_robot_is_tracked_and_dead_reckoning_is_said():
    async with build(assembled(source="measured")) as core:
        names = [f"measured.nav.{n}" for n in ESTIMATED]
        core.gate.expect("ros2", [*names, "measured.wheel.fl.speed_rpm"])
        await core.scheduler.advance(20)
        assert status(core, names[0]) == BAD_WAITING_FOR_INITIAL_DATA
        assert value(core, "estimate.state") == 0.0
        drive(core, 0.5, 0.4)
        await feed(core, 6000)
        far, turned = error(core)
        assert far < 0.15
        assert abs(turned) < 0.05
        assert status(core, "estimate.x_m") == GOOD
        samples = samples_of(core)
        assert samples["accepted"] == pytest.approx(2 * 60, abs=4)
        assert samples["rejected"] == 0
        await feed(core, 2000, frozen=True)
        assert value(core, "estimate.state") == 3.0  # dead reckoning
        assert samples_of(core) == samples


async def test_equal_samples_are_samples():
    """A robot that stands still sends the same numbers again: each of them counts."""
    async with build(assembled(source="measured")) as core:
        await core.scheduler.advance(20)
        still = {f"measured.wheel.{w}.speed_rpm": 0.0 for w in ("fl", "rl", "fr", "rr")}
        pose = {f"measured.nav.{n}": 1.0 for n in ESTIMATED}
        for _ in range(30):
            core.gate.write(
                "ros2", still | pose, received_ns=core.image.latest().planned_ns
            )
            await core.scheduler.advance(20)
        assert value(core, "internal.samples_nav") == 30.0
        samples = samples_of(core)
        assert samples["accepted"] + samples["late"] == 60
        await core.scheduler.advance(200)
        assert samples_of(core) == samples


@pytest.mark.parametrize("lie", [1e5, -1e5])
async def test_a_navigation_that_lies_is_left_out_and_counted(lie):
    async with build(assembled(source="measured", readmit_after=1000)) as core:
        await core.scheduler.advance(20)
        drive(core, 0.3, 0.2)
        await feed(core, 3000)
        for _ in range(20):
            await feed(core, 20, frozen=True)
            bad = dict.fromkeys((f"measured.nav.{n}" for n in ESTIMATED[:2]), lie)
            core.gate.write("ros2", bad, received_ns=core.image.latest().planned_ns)
        await core.scheduler.advance(20)
        assert value(core, "estimate.rejected") >= 20.0
        assert error(core)[0] < 0.3
        assert np.isfinite(core.image.latest().values).all()


async def test_a_filter_whose_numbers_are_no_longer_finite_begins_anew():
    async with build(assembled()) as core:
        drive(core, 0.3, 0.2)
        await core.scheduler.advance(3000)
        numbers = core.image.region("observer")[0]
        numbers[N_HEAD:] = np.nan
        await core.scheduler.advance(4000)
        assert counted(numbers).restarts == 1
        assert error(core)[0] < 0.2


async def test_a_restored_state_goes_on_to_the_bit():
    async with build(assembled()) as core:
        drive(core, 0.5, 0.4)
        await core.scheduler.advance(1503)
        tick = await core.snapshots.capture()
        state = core.image.shadow.copy()
        await core.scheduler.advance(501)
        once = core.image.live.copy()
        await core.snapshots.restore(state, tick)
        await core.scheduler.advance(501)
        assert core.image.live.tobytes() == once.tobytes()


STEPS = """steps:
- {at_s: 0.1, write: {control.mode: 1, twist.linear_m_s: 0.4, twist.angular_rad_s: 0.3}}
- {at_s: 0.5, write: {measured.nav.x_m: 0.1, measured.nav.y_m: 0.2, measured.nav.yaw_rad: 0.3}}
- {at_s: 0.8, write: {measured.nav.x_m: 0.1, measured.nav.y_m: 0.2, measured.nav.yaw_rad: 0.3}}
"""


@pytest.mark.parametrize("source", ["simulated", "measured"])
def test_a_recording_is_replayed_to_the_bit(tmp_path, monkeypatch, source):
    monkeypatch.chdir(tmp_path)
    nav = "nav: {enabled: true, latency_s: 0.12, yaw_latency_s: 0.08}"
    Path("config.yaml").write_text(
        f"observer: {{enabled: true, source: {source}}}\nsensors: {{{nav}}}\n"
    )
    Path("drive.yaml").write_text(STEPS)
    words = [
        "simulate",
        "drive.yaml",
        "-c",
        "config.yaml",
        "-o",
        "one.mcap",
        "--duration",
        "2",
    ]
    assert main(words) == 0
    log = read_log(Path("one.mcap"))
    assert log.columns["estimate.state"][-1] > 0.0
    if source == "measured":
        assert log.columns["internal.samples_nav"][-1] == 2.0
    assert main(["replay", "one.mcap", "-o", "again.mcap", "--check"]) == 0


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"noise": "none.json"}, "none.json: no such file"),
        ({"slice": "nowhere"}, "there is no plant-side slice 'nowhere'"),
    ],
)
def test_what_does_not_fit_gets_a_sentence(tmp_path, section, words):
    with pytest.raises(ConfigError, match=words):
        assembled(folder=tmp_path, **section)


def test_every_metric_has_its_reading():
    numbers = np.zeros(500)
    for metric in METRICS:
        assert list(metric.read([counted(numbers)]))
        assert not list(metric.read([]))
