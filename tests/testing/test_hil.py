"""The fixture `hil` and tests as async generators, in virtual time and in real time alike."""

import asyncio

import numpy as np
import pytest

from hilserver.errors import ConfigError
from hilserver.status import GOOD_LOCAL_OVERRIDE
from hilserver.testing.hil import HilError

MODES = [
    pytest.param(mode, marks=pytest.mark.hil(mode=mode), id=mode)
    for mode in ("virtual", "realtime")
]
FL = "wheel.fl.setpoint_rpm"
SPEED = "wheel.fl.speed_rpm"


@pytest.mark.parametrize("mode", MODES)
async def test_what_is_written_arrives_and_moves_the_wheel(hil, mode):
    assert hil.mode == mode
    hil.write(FL, 30.0)
    async with hil.capture(SPEED, FL) as trace:
        await hil.run_for(0.5)
    assert hil.read(FL) == 30.0
    assert len(trace[SPEED]) >= 500
    assert np.all(np.diff(trace.tick) == 1)
    trace[SPEED].assert_settles(30.0, 1.5, within_s=0.45)
    trace[SPEED].assert_within(-0.1, 36.0)
    assert trace[SPEED].overshoot(30.0) < 0.2


@pytest.mark.parametrize("mode", MODES)
async def test_a_generator_advances_by_steps(hil, mode):
    before = hil.tick
    for i in range(20):
        hil.write(FL, float(i))
        now_s = yield 10
    yield
    assert now_s == pytest.approx(hil.time_s, abs=1.0 if mode == "realtime" else 0.0011)
    assert hil.tick - before >= 201
    if mode == "virtual":
        assert hil.tick - before == 201
    assert hil.read(FL) == 19.0


@pytest.mark.parametrize("mode", MODES)
async def test_wait_for_finds_the_moment_or_says_what_it_is(hil, mode):
    hil.write(FL, 40.0)
    sample = await hil.wait_for(SPEED, lambda rpm: rpm > 20.0, timeout_s=1.0)
    assert 20.0 < sample.value < 25.0
    with pytest.raises(HilError, match=r"did not get there in 0\.05 s; it is"):
        await hil.wait_for(SPEED, lambda rpm: rpm > 80.0, timeout=0.05)


@pytest.mark.hil(mode="realtime")
async def test_wait_for_ends_while_somebody_has_paused_it(hil, monkeypatch):
    monkeypatch.setattr("hilserver.testing.hil.LATE_S", 0.2)
    hil.daemon.control.pause()
    async with asyncio.timeout(60):
        with pytest.raises(
            HilError, match=r"0\.1 s did not pass in time; the daemon is paused"
        ):
            await hil.wait_for(SPEED, lambda rpm: rpm > 80.0, timeout_s=0.1)


@pytest.mark.parametrize("mode", MODES)
async def test_a_test_drives_on_after_a_stop_and_its_reset(hil, mode):
    assert mode
    hil.write(FL, 30.0)
    await hil.run_for(0.2)
    hil.daemon.control.stop()
    await hil.wait_for("drive.enable", lambda enabled: not enabled)
    hil.daemon.control.reset()
    await hil.run_for(0.1)
    hil.write(FL, 20.0)
    await hil.wait_for(SPEED, lambda rpm: rpm > 19.0)


@pytest.mark.parametrize("mode", MODES)
async def test_faults_and_forces_from_a_test(hil, mode):
    assert mode
    hil.inject({"fault": "bias", "signal": "pose.x_m", "offset": 2.0, "for_s": 0.05})
    hil.force("battery.voltage_v", 9.0)
    await hil.step(3)
    assert hil.read("pose.x_m") == 2.0
    assert hil.read("battery.voltage_v") == 9.0
    assert hil.status("battery.voltage_v") == GOOD_LOCAL_OVERRIDE
    await hil.wait_for("pose.x_m", lambda x: x == 0.0, timeout_s=0.2)
    hil.unforce("battery.voltage_v")
    await hil.step(3)
    assert hil.read("battery.voltage_v") > 10.0


async def test_lockstep_is_exact_and_time_stands_still_between_steps(hil):
    tick = hil.tick
    await hil.step(5000)
    assert hil.tick == tick + 5000
    assert hil.time_s == pytest.approx((tick + 5000) * 1e-3)
    async with hil.capture("sim.tick") as trace:
        await hil.step(4096)  # twice what the ring holds
    assert np.array_equal(trace["sim.tick"].values, np.arange(tick + 5000, tick + 9096))


async def test_refusals_are_one_sentence(hil):
    for action, sentence in (
        (lambda: hil.write(FL, 500.0), r"was refused: out of range, -90 \.\. 90 rpm"),
        (lambda: hil.write("pose.x_m", 1.0), "was refused: not writable"),
        (lambda: hil.write("nothing", 1.0), "there is no signal 'nothing'; see"),
        (lambda: hil.write("wheel.fl.setpont_rpm", 1.0), f"did you mean '{FL}'"),
        (lambda: hil.read("wheels.speeds_rpm"), "is an array"),
        (lambda: hil.inject("shield.rust"), "fault: 'shield.rust' is not valid"),
        (lambda: hil.clear_faults("x"), "there is no fault 'x'"),
    ):
        with pytest.raises(HilError, match=sentence):
            action()
    with pytest.raises(HilError, match=r"set opcua\.enabled"):
        _ = hil.endpoint
    with pytest.raises(HilError, match="whole number of ticks"):
        await hil.step(0)
    with pytest.raises(HilError, match="run_for is a time above 0 s, not -1"):
        await hil.run_for(-1)
    with pytest.raises(HilError, match=r"wait_for is a time above 0 s, not nan"):
        await hil.wait_for(SPEED, bool, timeout_s=float("nan"))
    with pytest.raises(HilError, match=r"a function of the value.* not 20\.0"):
        await hil.wait_for(SPEED, 20.0)
    assert len(hil.read_all("wheels.speeds_rpm")) == 4


@pytest.mark.hil(config={"control": {"command_timeout_ms": 50}})
class TestMarkers:
    async def test_the_configuration_of_a_class(self, hil):
        hil.write(FL, 20.0)
        yield 40
        assert hil.read(FL) == 20.0
        yield 30
        assert hil.read(FL) == 0.0

    @pytest.mark.hil(config={"plant": {"max_rpm": 50}})
    async def test_the_nearest_marker_wins(self, hil):
        with pytest.raises(HilError, match="out of range"):
            hil.write(FL, 60.0)
        hil.write(FL, 20.0)
        yield 200
        assert hil.read(FL) == 20.0


async def test_a_capture_is_judged_by_the_requirements_of_a_sweep(hil):
    hil.write(FL, 30.0)
    async with hil.capture(SPEED) as trace:
        await hil.run_for(0.5)
    rises = {
        "name": "rises",
        "signal": SPEED,
        "above": 20.0,
        "within_s": 0.4,
        "for_s": 0.05,
    }
    calm = {"name": "calm", "signal": SPEED, "below": 25.0}
    margins = trace.margins(rises, calm)
    assert margins["calm"] == 25.0 - trace[SPEED].values.max() < 0.0 < margins["rises"]
    trace.assert_meets(rises)
    with pytest.raises(AssertionError, match=r"not met: calm \(margin -"):
        trace.assert_meets(rises, calm)
    for wrong, sentence in (
        ({"name": "r", "signal": SPEED, "abov": 1}, "unknown key 'abov'; did you mean"),
        ({"signal": SPEED, "above": 1}, "requirement: key 'name' is missing"),
        (calm | {"name": ""}, "should be a text of 1 or more"),
        (5, "requirement: write 'key: value' lines, not 5"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            trace.assert_meets(wrong)
    with pytest.raises(AssertionError, match="there is nothing to judge"):
        trace.assert_meets()
    with pytest.raises(AssertionError, match=r"'pose\.x_m' was not captured"):
        trace.margins({"name": "r", "signal": "pose.x_m", "below": 1.0})


async def test_a_parameter_is_set_from_a_tick_on_or_refused_in_a_sentence(hil):
    await hil.step(5)
    assert await hil.set_parameter("terms.rotation_gain", -0.3) == hil.tick
    assert hil.daemon.core.parameters.differing == {"terms.rotation_gain": -0.3}
    assert await hil.set_parameter("plant.wheelbase_m", None) == hil.tick
    for name, value, text in (
        ("plant.controller.k_p", 1e6, "unstable"),
        ("plant.controller.kp", 1.0, "did you mean 'plant.controller.k_p'"),
        ("plant.wheel_radius_m", -1.0, "is outside"),
        ("mechatronic.mass_kg", 4.0, "needs a restart"),
    ):
        with pytest.raises(HilError, match=text):
            await hil.set_parameter(name, value)
