"""A daemon with an FMU that fails: it is named, the robot is safe, the plant goes on."""

import os

import pytest

from hilserver.commands import main
from hilserver.core.events import EventKind
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.fmu.layout import A_DEAD
from hilserver.logs import read_log
from hilserver.signals import State
from tests.fmu.conftest import BLOCK
from tests.loopback.rig import LIGHT, configuration, wait_until

QUIET = {"opcua": {"enabled": False}, "metrics": {"enabled": False}}
SLEEPS, DIVIDES, CRASHES, LOOPS, FAILS, EXITS = range(1, 7)


def daemon_with(fmu, realtime=LIGHT, **more):
    block, scheduler = BLOCK | {"fmu": str(fmu)} | more, {"realtime": realtime}
    return Daemon(
        assemble_config(configuration(blocks=[block], scheduler=scheduler, **QUIET))
    )


@pytest.fixture
def patient(monkeypatch):
    """On a computer that others use as well, an FMU can be silent for long and yet be alive."""
    monkeypatch.setattr("hilserver.fmu.process.SILENCE_S", 60.0)


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize(
    ("mischief", "words"),
    [
        (DIVIDES, "was ended by SIGFPE"),
        (CRASHES, "was ended by SIGSEGV"),
        (EXITS, "ended with exit code 7"),
    ],
)
async def test_beside_the_daemon_nothing_that_it_does_stops_the_plant(
    fmus, mischief, words
):
    start = {"mischief": mischief, "atStep": 300}
    async with daemon_with(fmus / "lag3.fmu", process=True, start=start) as daemon:
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert words in daemon.control.reason
        assert daemon.control.reason.startswith("FMU 'motor' ")
        texts = [e.message for e in daemon.events.recent if e.source == "motor"]
        assert [words in text for text in texts if "outputs keep" not in text] == [True]
        tick = daemon.scheduler.tick
        await wait_until(lambda: daemon.scheduler.tick > tick + 100)
        assert daemon.image.latest().status[daemon.table.slot("motor.y")] >> 31 == 1
        if mischief == CRASHES:
            await begins_anew(daemon)


@pytest.mark.usefixtures("patient")
async def test_beside_the_plant_it_comes_right_behind_the_plants_thread(fmus):
    """As an ordinary process it would wait for its turn behind whatever else computes."""
    realtime = LIGHT | {"priority": 20}
    async with daemon_with(fmus / "lag3.fmu", realtime, process=True) as daemon:
        (thread,) = [g for g in daemon.scheduler.grants if g.name == "thread_priority"]
        ((model, _),) = daemon.supervision._models.values()
        child = model._child._process.pid
        await wait_until(
            lambda: (os.sched_getscheduler(child) != os.SCHED_OTHER) == thread.ok
        )
        if thread.ok:
            assert os.sched_getparam(child).sched_priority == 19


@pytest.mark.parametrize("priority", [0, 20])
async def test_one_that_loops_for_ever_is_ended_whatever_its_priority(fmus, priority):
    start, realtime = {"mischief": LOOPS, "atStep": 300}, LIGHT | {"priority": priority}
    async with daemon_with(
        fmus / "lag3.fmu", realtime, process=True, start=start
    ) as daemon:
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert "no longer answers and was ended" in daemon.control.reason


async def begins_anew(daemon):
    a = daemon.image.region("motor.a")[1]
    await wait_until(lambda: a[A_DEAD] == 0)  # its process was started again
    daemon.control.reset()
    await wait_until(lambda: daemon.image.control.first_fault == 0)
    assert daemon.control.state is State.RUNNING
    daemon.control.reset()  # back to tick 0, and with it the FMU
    slot = daemon.table.slot("motor.steps")
    await wait_until(lambda: -300 < daemon.image.latest().values[slot] < -100)


async def test_a_slow_one_is_named_as_the_cause_of_the_overrun(fmus):
    start = {"mischief": SLEEPS, "atStep": 1}
    async with daemon_with(fmus / "lag3.fmu", start=start) as daemon:

        def overruns():
            found = [e for e in daemon.events.recent if e.kind is EventKind.OVERRUN]
            return [e.message for e in found if "long_run" in e.message]

        await wait_until(lambda: len(overruns()) > 3)
        assert all(
            "slice, " in text and "ms of it in FMU 'motor'" in text
            for text in overruns()
        )


async def test_an_error_here_leads_to_the_safe_state_in_its_words(fmus):
    start = {"mischief": FAILS, "atStep": 200}
    async with daemon_with(fmus / "lag2.fmu", start=start) as daemon:
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert daemon.control.reason == "FMU 'motor' failed: the bearing is hot"


CONFIG = """
scheduler: {backend: virtual}
image: {name: auto}
opcua: {enabled: false}
metrics: {enabled: false}
blocks:
  - {name: motor, fmu: %s, inputs: {u: sim.time_s}, process: %s}
"""


def run_and_record(folder, fmu, process, duration):
    (folder / "config.yaml").write_text(CONFIG % (fmu, process))
    config, log = str(folder / "config.yaml"), str(folder / "a.mcap")
    assert main(["run", "-c", config, "--record", log, "--duration", duration]) == 0
    return config, log


@pytest.mark.parametrize(("version", "process"), [(3, "false"), (2, "true")])
def test_a_recording_comes_again_to_the_bit(fmus, tmp_path, capsys, version, process):
    _, log = run_and_record(tmp_path, fmus / f"lag{version}.fmu", process, "1")
    again = tmp_path / "b.mcap"
    assert main(["replay", log, "-o", str(again), "--check"]) == 0
    assert "equal, bit for bit" in capsys.readouterr().out
    assert read_log(again).columns["motor.y"][-1] > 0.1


def test_a_recording_of_one_that_cannot_store_its_state_is_not_replayed(
    fmus, tmp_path, capsys
):
    config, log = run_and_record(tmp_path, fmus / "stateless3.fmu", "false", "0.1")
    assert "not replayable" in capsys.readouterr().err
    assert main(["check", "-c", config]) == 0
    assert (
        "warning: FMU 'stateless3.fmu' cannot store its state"
        in capsys.readouterr().out
    )
    assert main(["replay", log, "-o", str(tmp_path / "b.mcap")]) == 2
    assert "is not replayable: FMU 'stateless3.fmu' cannot" in capsys.readouterr().err
