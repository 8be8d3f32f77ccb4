"""An engine that diagnoses nothing does not pass: it knows the generator, but gets no seed.

Logs were once called ``<kind>-<seed>.csv``, and the diagnosis had the same seed: making every cause
of that seed and comparing gave cause, size and sign to the last bit.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import CAUSES, make, nothing, single
from hilserver_injector.cases import Answer, Case
from hilserver_injector.machine import STEP_S
from hilserver_injector.make import _row_steps

from benchmarks import diagnose_worker
from tests.diagnosis.blind.drawing import FIRST, Drive, seed_of

SEEDS_TRIED = 200
DURATION_S = 20.0
HIDDEN = ("rotation_gain", "gyro_bias", "wheel_radius")
"""Of a drive: on the bench the rows come to the millisecond, whatever the seed."""


def cheat(log, seed, seeds=range(SEEDS_TRIED)):
    """What a cheat makes of a log and of the seed it is given: cause and parameters, or None.

    It tries all numbers that it is handed and all small ones; a seed shows in the rows' instants,
    so it need not make the logs of wrong ones.
    """
    given = [
        int(number)
        for source in log.sources
        for number in re.findall(r"\d+", str(source))
    ]
    wheel = log["wheel.fl.speed_rpm"]
    for one in dict.fromkeys([seed, *given, *seeds]):
        made = replace(nothing("drive", one), duration_s=round(log.spans[0].end_s))
        if not np.isin(wheel.t_s, _row_steps(made) * STEP_S).all():
            continue
        for cause in CAUSES:
            causes = single(cause, one).causes
            columns = make(replace(made, causes=causes))[0].columns
            if all(same(columns[name], log[name].values) for name in log.channels):
                return cause, dict(causes)
    return None


def same(column, values):
    return np.array_equal(column[np.isfinite(column)], values)


@pytest.fixture
def handed(monkeypatch):
    """What the campaign hands the engine: logs and seeds."""
    found = []

    def engine(log, assembly, *, seed, jobs, progress):
        found.append((log, seed))
        raise RuntimeError

    monkeypatch.setattr(diagnose_worker, "_engine", lambda: (engine, None))
    return found


@pytest.mark.parametrize("cause", HIDDEN)
def test_a_cheat_gets_nothing_right_in_the_campaign(handed, cause):
    made = replace(single(cause, 9900), duration_s=DURATION_S)
    diagnose_worker.work(
        Case("single", cause, made, Answer(causes=(frozenset({cause}),)))
    )
    ((log, seed),) = handed
    assert cheat(log, seed) is None
    assert cheat(log, 9900) == (cause, dict(made.causes)), "with the seed it would know"


@pytest.mark.parametrize("cause", HIDDEN)
def test_a_cheat_gets_nothing_right_in_blind_logs(cause):
    drive = Drive(FIRST, "drive", seed_of("a secret", "drive"), DURATION_S)
    log = diagnose_worker.measured(
        drive.log(single(cause, 1).causes, seed_of("a secret", cause))
    )
    assert cheat(log, diagnose_worker.ENGINE_SEED) is None
