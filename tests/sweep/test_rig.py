"""One machine after the other, whatever their controllers do."""

import pytest

from hilserver.errors import ConfigError
from hilserver.sweep.rig import Rig

BIAS = {"fault": "bias", "signal": "pose.y_m", "offset": 0.5, "from_s": 0.3}


def test_nothing_of_the_machine_before_is_left(made):
    prepared = made(faults=[{"share": 0.5, "fault": BIAS}])
    rig, other = Rig(prepared.job), Rig(prepared.job)
    machines = [prepared.machine(index) for index in range(6)]
    assert 0 < sum(bool(m.faults) for m in machines) < 6
    first = [rig.drive(machine) for machine in machines]
    assert [rig.drive(machine) for machine in reversed(machines)] == first[::-1]
    assert other.drive(machines[4]) == first[4]
    assert len({outcome.margins for outcome in first}) == 6
    for machine, outcome in zip(machines, first, strict=True):
        assert (outcome.margins[0] < -0.4) == bool(machine.faults)


def test_a_block_with_a_known_limit(made, limit):
    prepared = made(**limit)
    rig = Rig(prepared.job)
    for machine in map(prepared.machine, range(20)):
        a, b = (machine.values[f"blocks.limit.{name}"] for name in "ab")
        assert rig.drive(machine).margins == (a - 2.0 * b,)


def test_a_block_that_raises(made, limit):
    population = {"limit.raises": {"values": [0.0, 1.0]}}
    mode = {"at_s": 0.0, "write": {"control.mode": 1}}
    sections = limit | {
        "from": {"population": population},
        "drive": {"scenario": "m.yaml"},
    }
    path = made(**limit).job.path.parent / "m.yaml"
    path.write_text(f"steps: [{{at_s: 0.0, write: {mode['write']}}}]".replace("'", ""))
    prepared = made(**sections)
    rig = Rig(prepared.job)
    for machine in map(prepared.machine, range(6)):
        found = rig.drive(machine)
        if machine.values["blocks.limit.raises"]:
            assert "the block 'limit' raised an exception at 0." in found.error
        else:
            assert found.margins


def test_a_way_gives_a_distance(made):
    require = [{"name": "r", "signal": "path.error_m", "below": 0.05}]
    way = {"scenario": "course.yaml", "path": [[0.05, 0.02], [1.0, 0.02]]}
    prepared = made(drive=way, require=require)
    (margin,) = Rig(prepared.job).drive(prepared.machine(0)).margins
    assert margin == pytest.approx(0.05 - (0.05**2 + 0.02**2) ** 0.5, abs=1e-6)


HOSTILE = """
import os, sys, time

class Raises:
    def __call__(self, time_s, signals):
        if time_s > 0.1:
            raise RuntimeError("no idea")

class Hangs:
    def __call__(self, time_s, signals):
        while True:
            try:
                print("still here")
            except Exception:
                pass

class Sleeps:
    def __call__(self, time_s, signals):
        time.sleep(1e6)

class Ends:
    def __call__(self, time_s, signals):
        sys.exit(3)

class Allocates:
    def __call__(self, time_s, signals):
        raise MemoryError

class Returns:
    def __call__(self, time_s, signals):
        return ANSWER

def nothing():
    return 3
"""


@pytest.fixture
def outcome(made, tmp_path):
    def driven(name, answer=None):
        (tmp_path / "hostile.py").write_text(
            "nan = float('nan')\n" + HOSTILE.replace("ANSWER", repr(answer))
        )
        controller = {"python": f"hostile.py:{name}", "every_ms": 20}
        prepared = made(controller=controller, limits={"time_s": 0.5})
        rig = Rig(prepared.job)
        found = rig.drive(prepared.machine(1))
        assert not found.margins
        return found.error

    return driven


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Raises", "the controller raised RuntimeError: no idea (hostile.py:8)"),
        ("Hangs", "took longer than 0.5 s"),
        ("Sleeps", "took longer than 0.5 s"),
        ("Ends", "the controller raised SystemExit: 3 (hostile.py:24)"),
        ("Allocates", "needed more than 1000 MB of memory"),
        ("nothing", "the controller cannot be called with (time_s, signals)"),
    ],
)
def test_a_hostile_controller_fails_its_machine(outcome, name, says):
    assert says in outcome(name)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (3.0, "it must return a mapping of input signals to values"),
        ({"wheels.setpoints_rpm": ["a", "b", "c", "d"]}, "type mismatch"),
        ({"twist.linear_m_s": 1e9}, "out of range"),
        ({"pose.x_m": 1.0}, "not an input of the robot"),
        ({3: 1.0}, "not an input of the robot"),
        ({"twist.linear_m_s": float("nan")}, "not finite"),
    ],
)
def test_commands_that_no_robot_takes(outcome, answer, says):
    assert says in outcome("Returns", answer)


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        (
            {"controller": {"python": "my.py:None", "every_ms": 20}},
            "there is no 'None'",
        ),
        (
            {"faults": [{"share": 1, "fault": BIAS | {"signal": "pose.z"}}]},
            r"faults\[0\].fault",
        ),
    ],
)
def test_what_does_not_exist_is_refused_before_any_worker(made, sections, says):
    with pytest.raises(ConfigError, match=says):
        Rig(made(**sections).job)
