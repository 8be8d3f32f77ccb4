"""Every kind of fault against what it is described as, tick by tick, on a signal known exactly."""

import numpy as np
import pytest

from hilserver.plant.layout import WHEELS
from hilserver.status import GOOD, GOOD_LOCAL_OVERRIDE, UNCERTAIN_NO_COMMUNICATION
from tests.faults.rig import Rig

# nothing in the plant reads it: what goes in comes out
INPUT = "measured.battery.voltage_v"
N = 60


async def run(*faults, n=N, signal=INPUT, ramp=True):
    """Return true and published values of n ticks while the faults act."""
    async with Rig() as rig:
        await rig.advance(1)
        rig.faults.inject(*faults)
        true = [float(i) * 0.1 if ramp else 5.0 for i in range(n)]
        for value in true:
            rig.write(measured__battery__voltage_v=value)
            await rig.advance(1)
        return np.array(true), rig.series(signal, first_tick=1)


async def test_bias_and_scale_act_in_the_order_they_came():
    true, seen = await run(
        {"fault": "bias", "signal": INPUT, "offset": 2.0},
        {"fault": "scale", "signal": INPUT, "factor": -3.0},
    )
    assert np.array_equal(seen, (true + 2.0) * -3.0)


async def test_stuck_keeps_the_value_of_its_first_tick():
    _, seen = await run({"fault": "stuck", "signal": INPUT, "from_s": 0.010})
    assert np.array_equal(seen[:10], np.arange(10) * 0.1)
    assert np.all(seen[10:] == seen[10])


async def test_stuck_at_a_value():
    _, seen = await run({"fault": "stuck", "signal": INPUT, "value": 7.0})
    assert np.all(seen == 7.0)


async def test_delay_shows_the_sample_of_so_many_ticks_ago():
    true, seen = await run({"fault": "delay", "signal": INPUT, "delay_s": 0.007})
    assert np.array_equal(seen[7:], true[:-7])
    assert np.all(seen[:7] == true[0])


async def test_jitter_keeps_the_order_and_its_limits():
    true, seen = await run(
        {
            "fault": "jitter",
            "signal": INPUT,
            "delay_s": 0.002,
            "jitter_s": 0.005,
            "seed": 3,
        }
    )
    late = np.rint((true - seen) / 0.1).astype(int)
    assert np.all(np.diff(seen) >= 0)
    assert set(late[10:]) <= set(range(2, 8))
    assert len(set(late[10:])) > 2


async def test_drop_shows_the_last_sample_that_came():
    true, seen = await run(
        {"fault": "drop", "signal": INPUT, "probability": 0.5, "seed": 1}
    )
    fresh = seen == true
    assert 15 < fresh.sum() < 45
    assert all(seen[i] == seen[i - 1] for i in range(1, N) if not fresh[i])


async def test_dropping_everything_and_nothing():
    _, nothing = await run({"fault": "drop", "signal": INPUT, "probability": 1.0})
    assert np.all(nothing == nothing[0])
    true, everything = await run({"fault": "drop", "signal": INPUT, "probability": 0.0})
    assert np.array_equal(everything, true)


async def test_reorder_brings_old_samples_after_newer_ones():
    true, seen = await run(
        {
            "fault": "reorder",
            "signal": INPUT,
            "probability": 0.3,
            "delay_s": 0.004,
            "seed": 2,
        }
    )
    late = np.rint((true - seen)[5:] / 0.1).astype(int)
    assert set(late) == {0, 4}
    assert np.any(np.diff(seen) < 0)


async def test_hold_samples_every_so_often():
    true, seen = await run({"fault": "hold", "signal": INPUT, "every_s": 0.010})
    assert np.array_equal(seen, np.repeat(true[::10], 10))


async def test_quantise_rounds_to_the_step():
    true, seen = await run({"fault": "quantise", "signal": INPUT, "step": 0.25})
    assert np.array_equal(seen, 0.25 * np.floor(true / 0.25 + 0.5))


async def test_noise_has_the_deviation_and_follows_its_seed():
    fault = {"fault": "noise", "signal": INPUT, "sd": 0.5, "seed": 11}
    _, first = await run(fault, n=2000, ramp=False)
    _, again = await run(fault, n=2000, ramp=False)
    _, other = await run(fault | {"seed": 12}, n=2000, ramp=False)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    # 4 sigma of the estimate of a standard deviation from 2000 samples: 0.5 * 4 / sqrt(4000)
    assert first.std() == pytest.approx(0.5, abs=0.032)


async def test_noise_with_a_sample_time_stays_for_it():
    _, seen = await run(
        {"fault": "noise", "signal": INPUT, "sd": 1.0, "every_s": 0.010},
        n=100,
        ramp=False,
    )
    assert 10 <= len(set(seen)) <= 11


async def test_spike_adds_its_size_now_and_then():
    true, seen = await run(
        {"fault": "spike", "signal": INPUT, "size": 9.0, "probability": 0.2},
        n=400,
        ramp=False,
    )
    assert set(seen - true) == {-9.0, 0.0, 9.0}
    assert 40 < np.count_nonzero(seen != true) < 130


async def test_a_fault_ends_and_the_true_value_is_back():
    true, seen = await run(
        {
            "fault": "bias",
            "signal": INPUT,
            "offset": 1.0,
            "from_s": 0.010,
            "until_s": 0.020,
        }
    )
    wrong = np.zeros(N)
    wrong[10:20] = 1.0
    assert np.allclose(seen - true, wrong, atol=1e-12)


async def test_disconnect_holds_the_value_and_says_so():
    async with Rig() as rig:
        rig.write(measured__battery__voltage_v=3.0)
        await rig.advance(1)
        rig.faults.inject({"fault": "disconnect", "signal": INPUT, "name": "plug"})
        await rig.advance(1)
        rig.write(measured__battery__voltage_v=4.0)
        await rig.advance(1)
        assert rig.series(INPUT)[-1] == 3.0
        assert rig.status(INPUT) == UNCERTAIN_NO_COMMUNICATION
        rig.faults.clear("plug")
        await rig.advance(1)
        assert rig.series(INPUT)[-1] == 4.0
        assert rig.status(INPUT) == GOOD


async def test_force_overrides_faults_sources_and_plant_and_shows_it():
    async with Rig() as rig:
        rig.faults.force("wheel.fl.setpoint_rpm", 30.0)
        rig.faults.force("pose.x_m", 42.0)
        rig.faults.inject(
            {"fault": "bias", "signal": "wheel.fl.setpoint_rpm", "offset": 5.0}
        )
        for _ in range(300):
            rig.write(wheel__fl__setpoint_rpm=-60.0)
            await rig.advance(1)
        assert rig.series("wheel.fl.setpoint_rpm")[-1] == 30.0
        assert rig.series("wheel.fl.speed_rpm")[-1] == pytest.approx(30.0, abs=3.0)
        assert rig.series("pose.x_m")[-1] == 42.0
        assert rig.status("pose.x_m") == GOOD_LOCAL_OVERRIDE
        assert rig.faults.forced == "wheel.fl.setpoint_rpm; pose.x_m"
        rig.faults.unforce("pose.x_m")
        rig.faults.clear()
        await rig.advance(1)
        assert abs(rig.series("pose.x_m")[-1]) < 1.0
        assert rig.status("pose.x_m") == GOOD
        assert rig.faults.forced == "wheel.fl.setpoint_rpm"


async def test_a_fault_on_an_output_leaves_plant_and_sensors_alone():
    async def pose(*faults):
        async with Rig() as rig:
            rig.faults.inject(*faults)
            rig.write(wheel__fl__setpoint_rpm=30.0, wheel__rl__setpoint_rpm=30.0)
            await rig.advance(500)
            return rig.series("pose.yaw_rad"), rig.series("imu.gyro_z_rad_s")

    yaw, gyro = await pose()
    wrong_yaw, same_gyro = await pose(
        {"fault": "bias", "signal": "pose.yaw_rad", "offset": 1.0}
    )
    assert np.array_equal(wrong_yaw, yaw + 1.0)
    assert np.array_equal(same_gyro, gyro)


async def test_whole_numbers_stay_whole_and_in_range():
    async with Rig() as rig:
        rig.faults.inject(
            {"fault": "noise", "signal": "lights.red", "sd": 300.0},
            {"fault": "bias", "signal": "drive.enable", "offset": 3.0},
        )
        await rig.advance(200)
        red = rig.series("lights.red")
        assert np.array_equal(red, np.rint(red))
        assert red.min() == 0
        assert red.max() == 255
        assert set(rig.series("drive.enable")) == {1.0}


async def test_an_array_is_faulted_in_all_its_scalars():
    async with Rig() as rig:
        rig.faults.inject(
            {"fault": "stuck", "signal": "wheels.speeds_rpm", "value": 12.0}
        )
        await rig.advance(2)
        assert [rig.series(f"wheel.{w}.speed_rpm")[-1] for w in WHEELS] == [12] * 4


async def test_a_paused_run_does_not_age_a_fault():
    """While paused, the latch runs again and again for the same tick."""
    fault = {"fault": "jitter", "signal": INPUT, "jitter_s": 0.010, "seed": 5}
    _, steady = await run(fault)
    async with Rig() as rig:
        await rig.advance(1)
        rig.faults.inject(fault)
        for i in range(N):
            rig.write(measured__battery__voltage_v=i * 0.1)
            for _ in range(3):
                rig.scheduler.pause()
                await rig.scheduler.wait_paused()
            await rig.advance(1)
        assert np.array_equal(rig.series(INPUT, first_tick=1), steady)
