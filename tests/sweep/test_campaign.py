"""Workers that die, machines that take theirs with them, and the same bits in every case."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from benchmarks.dask_cluster import cluster, worker_pids
from hilserver.errors import FailedError
from hilserver.logs import read_log
from hilserver.sweep import campaign
from hilserver.sweep.campaign import LocalWorkers, outcomes
from hilserver.sweep.only import drive_again
from hilserver.sweep.rig import Rig

KILLS = 10
CONTROLLER = """
import os, signal, time

class Controller:
    def __call__(self, time_s, signals):
        if signals.seed == SEED and time_s > 0.5:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"control.mode": 1, "twist.linear_m_s": 0.3 - signals["pose.x_m"]}
"""
PYTHON = {"controller": {"python": "killer.py:Controller", "every_ms": 20}}


@pytest.fixture
def sweep(made, tmp_path):
    def prepared(seed=-1, **sections):
        (tmp_path / "killer.py").write_text(CONTROLLER.replace("SEED", str(seed)))
        return made(**(PYTHON | sections))

    return prepared


def driven(prepared, workers, on_batch=lambda: None):
    found = {}
    machines = map(prepared.machine, range(prepared.sweep.machines))
    with workers:
        for _, batch in outcomes(prepared.job, machines, workers):
            found |= {outcome.index: outcome for outcome in batch}
            on_batch()
    return [found[index] for index in sorted(found)]


def here(prepared):
    rig = Rig(prepared.job)
    return [
        rig.drive(machine)
        for machine in map(prepared.machine, range(prepared.sweep.machines))
    ]


def test_a_machine_that_kills_its_worker_fails_alone(sweep, monkeypatch):
    monkeypatch.setattr(campaign, "LIVES", 2)
    victim = sweep().machine(2).seed
    prepared = sweep(seed=victim, machines=4)
    found = driven(prepared, LocalWorkers(1, 1000.0))
    assert "stopped its worker 2 times" in found[2].error
    expected = here(sweep(machines=4))
    assert [o.margins for o in found if o.index != 2] == [
        o.margins for o in expected if o.index != 2
    ]


class Killer(threading.Thread):
    """Kills a worker now and then, `KILLS` times."""

    def __init__(self, pids):
        super().__init__(daemon=True)
        self._pids, self._ended, self.kills = pids, threading.Event(), 0

    def run(self):
        while self.kills < KILLS and not self._ended.wait(1.0):
            with contextlib.suppress(OSError, TimeoutError):  # those that die right now
                for pid in self._pids()[:1]:
                    os.kill(pid, signal.SIGKILL)
                    self.kills += 1

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self.join()


def children(workers):
    return [process.pid for process in list(workers._pool._processes.values())]


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_same_bits_for_any_number_of_workers_and_while_they_are_killed(
    sweep, count
):
    prepared = sweep(machines=400, drive={"scenario": "course.yaml", "duration_s": 4.0})
    expected, now = here(prepared), []
    with Killer(lambda: children(now[-1])) as killer:
        while killer.kills < KILLS:
            now.append(LocalWorkers(count, 1000.0))
            assert driven(prepared, now[-1]) == expected


@pytest.mark.long
def test_the_same_bits_on_a_dask_cluster_while_its_workers_are_killed(sweep):
    pytest.importorskip("distributed")
    prepared = sweep(machines=400, drive={"scenario": "course.yaml", "duration_s": 4.0})
    expected = here(prepared)
    with cluster(2) as address, Killer(lambda: worker_pids(address)) as killer:
        while killer.kills < KILLS:
            assert driven(prepared, campaign.DaskWorkers(address)) == expected


PATIENT = """
scheduler:
  communication_timeout_ms: 0
  limits: {single_overrun_ms: null, consecutive_overruns: null}
image: {name: auto}
opcua: {enabled: false}
metrics: {enabled: false}
page: {enabled: false}
"""


@pytest.mark.long
def test_ten_machines_again_have_the_margins_of_the_table(made, tmp_path):
    """And the daemon drives them in real time, from the files that were written."""
    (tmp_path / "patient.yaml").write_text(PATIENT)
    fault = {"fault": "noise", "signal": "pose.y_m", "sd": 0.001}
    prepared = made(
        config="patient.yaml",
        machines=10,
        controller={"python": "my.py:Controller", "every_ms": 20},
        faults=[{"share": 0.5, "fault": fault}],
    )
    table = here(prepared)
    for index in range(10):
        folder = tmp_path / f"machine-{index}"
        assert drive_again(prepared, index, folder) == table[index]
        words = (
            "run -c config.yaml --scenario scenario.yaml --record run.mcap --duration 2"
        )
        command = [sys.executable, "-m", "hilserver", *words.split()]
        subprocess.run(command, cwd=folder, check=True, timeout=600)
        again, once = (
            read_log(folder / name) for name in ("run.mcap", "recording.mcap")
        )
        ticks = again.ticks(1_000_000)
        ticks = ticks[ticks < len(once)]  # a busy computer may lose some
        assert len(ticks) > len(once) / 2
        for name in ("pose.x_m", "pose.y_m", "wheel.fl.speed_rpm", "imu.gyro_z_rad_s"):
            a, b = again.columns[name][: len(ticks)], once.columns[name][ticks]
            assert a.tobytes() == b.tobytes(), name


def test_a_computer_with_other_bits_is_refused(sweep, monkeypatch):
    class Elsewhere:
        count = 1

        def submit(self, job, machines):
            done = campaign.Future()
            done.set_result(
                ("other", [Rig(job).drive(machine) for machine in machines])
            )
            return done

        def means_death(self, error):
            return False

    prepared = sweep(machines=2)
    machines = list(map(prepared.machine, range(2)))
    with pytest.raises(FailedError, match="are not bit-identical"):
        list(outcomes(prepared.job, machines, Elsewhere()))
    ((where, batch),) = outcomes(prepared.job, machines, Elsewhere(), mixed=True)
    assert where == "other"
    assert len(batch) == 2


@pytest.mark.long
def test_a_hang_in_compiled_code_ends_with_its_worker(
    made, limit, monkeypatch, tmp_path
):
    (tmp_path / "forever.py").write_text(
        "from hilserver.plant.blocks import Output, block\n\n"
        "@block(inputs=('x_m',), outputs=(Output('margin'), Output('speed_m_s')),"
        " parameters={'a': 0.0, 'b': 0.0, 'c': 0.0})\n"
        "def limit(dt_s, u, y, x, p):\n"
        "    while p[0] > 0.5:\n"
        "        y[0] += 1e-9\n"
        "    y[0] = p[0]\n"
    )
    controller = limit["controller"] | {"block": "forever.py:limit"}
    population = {"limit.a": {"values": [0.0, 1.0]}}
    sections = limit | {"controller": controller, "from": {"population": population}}
    prepared = made(machines=4, limits={"time_s": 0.2}, **sections)
    hangs = [m.values["blocks.limit.a"] > 0.5 for m in map(prepared.machine, range(4))]
    assert any(hangs)
    monkeypatch.setattr(campaign, "LIVES", 1)
    began_s = time.monotonic()
    found = driven(prepared, LocalWorkers(1, 1000.0))
    assert [bool(outcome.error) for outcome in found] == hangs
    assert time.monotonic() - began_s < 120.0


GREEDY = """
class Controller:
    def __call__(self, time_s, signals):
        if signals.seed == SEED:
            self.kept = [bytearray(10**7) for _ in range(10**6)]
        print("x" * 10_000)
        return {"control.mode": 1, "twist.linear_m_s": 0.3}
"""


def test_one_that_allocates_without_end_fails_alone(made, tmp_path):
    def prepared(seed=-1):
        (tmp_path / "greedy.py").write_text(GREEDY.replace("SEED", str(seed)))
        return made(
            machines=4, controller={"python": "greedy.py:Controller", "every_ms": 20}
        )

    victim = prepared().machine(2).seed
    expected = [outcome.margins for outcome in here(prepared())]
    found = driven(prepared(victim), LocalWorkers(1, 300.0))
    assert found[2].error == "needed more than 1000 MB of memory"
    expected[2] = ()
    assert [outcome.margins for outcome in found] == expected


@pytest.mark.parametrize("controller", ["python", "block"])
def test_one_machine_again_through_the_daemon(made, limit, tmp_path, controller):
    sections = {"controller": {"python": "my.py:Controller", "every_ms": 20}}
    if controller == "block":
        sections = limit | {"drive": {"duration_s": 0.5}}
    fault = {"fault": "noise", "signal": "pose.y_m", "sd": 0.01}
    prepared = made(faults=[{"share": 1, "fault": fault}], **sections)
    outcome = drive_again(prepared, 3, tmp_path / "again")  # raises if one bit differs
    assert outcome.margins
    names = sorted(path.name for path in (tmp_path / "again").iterdir())
    assert names == ["config.yaml", "margins.json", "recording.mcap", "scenario.yaml"]
