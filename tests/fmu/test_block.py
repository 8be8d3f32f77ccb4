"""An FMU as an own block: it computes what it says, its state comes and goes, it fails in words."""

import math
import time

import numpy as np
import pytest

import hilserver.fmu.layout as at
from hilserver.fmu.exchange import adopt_beside, run_beside

BOTH = pytest.mark.parametrize("version", [2, 3])
PLACES = pytest.mark.parametrize("process", [False, True], ids=["here", "beside"])
N = 300


def lag(u, n, gain=2.0, lag_s=0.1, dt_s=0.001):
    """What `model.c` computes, operation by operation."""
    y, found = 0.0, []
    for _ in range(n):
        y += dt_s / (lag_s + dt_s) * (gain * u - y)
        found.append(y)
    return np.array(found)


@BOTH
@PLACES
async def test_it_computes_to_the_bit_what_the_model_says(robot, version, process):
    async with robot(f"lag{version}", process=process, start={"Gain": 3}) as r:
        await r.run(N, fl=10.0)
        expected = lag(10.0, N, gain=3.0)
        if process:  # one slice behind, beginning with its first outputs
            expected = np.concatenate([[0.0], expected[:-1]])
        assert r.output("y", N).tolist() == expected.tolist()
        assert r.output("steps") == -(N - process)
        assert r.output("positive") == 1.0
        assert r.table["motor.y"].unit == "N·m"
        assert (r.table["motor.y"].low, r.table["motor.y"].high) == (-1000.0, 1000.0)


@pytest.mark.parametrize(
    ("version", "process"),
    [
        pytest.param(2, False, id="here-2"),
        pytest.param(3, True, id="beside-3"),
        # Each pair is a step to compile; what differs by version or by place, the two show.
        pytest.param(2, True, id="beside-2", marks=pytest.mark.long),
        pytest.param(3, False, id="here-3", marks=pytest.mark.long),
    ],
)
async def test_parameters_of_one_type_are_set_in_one_call(robot, version, process):
    start = {"Gain": 3, "mischief": 0, "lag": 0.2}
    async with robot(f"together{version}", process=process, start=start) as r:
        await r.run(N, fl=10.0)
        assert r.fault == 0
        assert r.output("y") == lag(10.0, N - process, gain=3.0, lag_s=0.2)[-1]
        r.core.snapshots.reset()
        await r.run(N, fl=10.0)
        assert r.fault == 0


@BOTH
@PLACES
async def test_a_snapshot_holds_its_state(robot, version, process):
    async with robot(f"lag{version}", process=process) as r:
        await r.run(N, fl=10.0)
        await r.core.snapshots.save("middle")
        await r.run(N, fl=-5.0)
        first = r.output("y", N)
        await r.core.snapshots.load("middle")
        await r.run(N, fl=-5.0)
        assert r.output("y", N).tolist() == first.tolist()
        r.core.snapshots.reset()
        await r.run(N, fl=10.0)
        assert r.output("y") == lag(10.0, N - process)[-1]
        assert r.fault == 0


async def test_a_snapshot_of_one_robot_goes_on_in_another(robot):
    async with robot("lag3") as r:
        await r.run(N, fl=10.0)
        await r.core.snapshots.save("middle")
        await r.run(N)
        first = r.output("y", N)
    async with robot("lag3", process=False) as r:
        await r.core.snapshots.load("middle")
        await r.run(N)
        assert r.output("y", N).tolist() == first.tolist()


@BOTH
async def test_one_that_cannot_store_its_state_says_so_and_goes_on(robot, version):
    async with robot(f"stateless{version}") as r:
        why = [f"FMU 'stateless{version}.fmu' cannot store its state"]
        assert r.core.assembly.provenance["not_replayable"] == why
        await r.run(N, fl=10.0)
        r.core.snapshots.reset()
        await r.run(N, fl=10.0)
        assert r.output("y") == lag(10.0, 2 * N)[-1]
        assert r.fault == 0


@PLACES
async def test_an_error_of_its_own_is_a_fault_in_its_own_words(robot, process):
    start = {"mischief": 5, "atStep": 100}
    async with robot("lag3", process=process, start=start) as r:
        await r.run(99, fl=10.0)
        assert (r.fault, r.status("y")) == (0, 0)
        await r.run(2 + process)
        assert r.fault == 17
        assert math.isnan(r.output("y"))
        assert r.status("y") >> 31 == 1
        (model,) = r.core.foreign.values()
        a = r.image.region("motor.a")[1]
        (news,) = model.look(a)
        assert news == ("FMU 'motor' failed: the bearing is hot", True)
        assert model.look(a) == []
        r.image.control.first_fault = 0
        await r.run(10)
        assert r.fault == 0, "the outputs stay Bad, the robot may drive on"
        r.core.snapshots.reset()
        await r.run(50, fl=10.0)
        assert r.output("y") == lag(10.0, 50 - process)[-1]


async def test_a_slow_call_is_noted_with_its_tick(robot):
    async with robot("lag3", start={"mischief": 1, "atStep": 20}) as r:
        await r.run(21, fl=1.0)
        a = r.image.region("motor.a")[1]
        assert at.slow_call(a, 18) == 0
        assert 5_000_000 <= at.slow_call(a, 19) < 1_000_000_000
        assert at.slow_call(a, 20) >= 5_000_000


async def test_arrays_and_small_numbers(robot):
    inputs = {"v[1]": "sim.tick", "v[2]": "wheel.fl.setpoint_rpm", "small": "sim.tick"}
    shown = {"sum": "total", "small": "small"}
    async with robot("lag3", inputs=inputs, outputs=shown) as r:
        await r.run(5, fl=7.0)
        await r.run(1)
        assert r.output("total") == 4.0 + 10.0 * 7.0
        assert r.output("small") == 4.0


async def test_arrays_and_numbers_of_one_type_go_through_one_call(robot):
    inputs = {
        "u": "wheel.fl.setpoint_rpm",
        "v[1]": "sim.tick",
        "v[2]": "wheel.fl.setpoint_rpm",
    }
    async with robot("lag3", inputs=inputs) as r:
        await r.run(5, fl=7.0)
        assert r.output("sum") == 3.0 + 10.0 * 7.0
        assert r.output("y") == lag(7.0, 5)[-1]


async def test_restored_at_its_start_it_shows_its_first_outputs(robot):
    """Its sum is there before the first step, of inputs that nobody has wired yet."""
    inputs = {"v[1]": "wheel.fl.setpoint_rpm", "v[2]": "wheel.fl.setpoint_rpm"}
    async with robot("lag3", inputs=inputs, process=True) as r:
        await r.run(3, fl=2.0)
        first = r.output("sum", 3).tolist()
        r.core.snapshots.reset()
        await r.run(3, fl=2.0)
        assert r.output("sum", 3).tolist() == first == [33.0, 22.0, 22.0]


@pytest.mark.parametrize(("ago_s", "hurried"), [(0, 1), (100, 0)])
def test_who_is_late_is_told_from_a_plant_that_left_no_time(ago_s, hurried):
    """A slice of a minute: the one before was just now, or long ago."""
    silent = Silent(60.0)
    assert silent.run(1, ago_s) == 0
    a, x = silent.a, silent.x
    assert (a[at.A_LATE], a[at.A_HURRIED], x[at.X_OWED]) == (1, hurried, 1.0)


class Silent:
    """An FMU beside the plant that does not answer; it is given up after ten slices."""

    def __init__(self, dt_s):
        self.s, self.x = np.zeros(at.N_SHARED + 1, dtype=np.int64), np.zeros(at.X_STATE)
        self.a, self.y = np.zeros(at.ROWS, dtype=np.int64), np.zeros(1)
        self.s[at.S_ASKED] = 1  # and not done
        self.a[at.A_SHARED], self.a[at.A_SHARED_LENGTH] = (
            self.s.ctypes.data,
            self.s.size,
        )
        self.dt_s, self.a[at.A_LIMIT] = dt_s, round(10e9 * dt_s)

    def run(self, tick, ago_s):
        """Run a slice `ago_s` after the one before; return the fault."""
        self.a[at.A_RAN] = time.monotonic_ns() - ago_s * 10**9
        nothing = np.zeros(0)
        return run_beside(tick, self.dt_s, nothing, self.y, self.x, nothing, self.a)


def test_a_silent_one_is_given_up_once_it_has_had_the_time():
    silent = Silent(1.0)
    assert [silent.run(tick, 1) for tick in range(10)] == [0] * 9 + [at.SILENT]


def test_a_standstill_of_the_whole_computer_and_the_slices_caught_up_are_no_silence():
    """Of an hour that stood still one slice counts, and next to nothing of a minute caught up."""
    silent = Silent(1.0)
    assert not any(silent.run(tick, 0 if tick else 3600) for tick in range(60))


def test_a_reset_ends_the_silence_of_one_that_cannot_store_its_state():
    silent = Silent(1.0)
    for tick in range(9):
        silent.run(tick, 1)
    nothing = np.zeros(0)
    adopt_beside(nothing, silent.y, silent.x, nothing, silent.a)
    assert [silent.run(tick, 1) for tick in range(10)] == [0] * 9 + [at.SILENT]
