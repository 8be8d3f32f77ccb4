"""Sweeps whose truth is known, and their results.

The controller is a block that fails exactly where a given function of two of its three parameters
is negative, so the share of machines that pass, the decisive parameters and the failing region are
known without a simulation. Each truth is one line: the truth, and what the sweep found.
"""

import json
import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import norm

from hilserver.config.root import Config
from hilserver.plant.packing import pack
from hilserver.sweep.batch import fingerprint
from hilserver.sweep.campaign import LocalWorkers, outcomes
from hilserver.sweep.estimates import exact_interval, influences
from hilserver.sweep.journal import SweepJournal
from hilserver.sweep.prepare import PreparedSweep, prepare
from hilserver.sweep.rig import Rig
from hilserver.sweep.table import PASSED, MachineTable, table_of

MACHINES: Final = 10_000
SWEEPS, MACHINES_OF_EACH = 200, 200
BINOMIAL_DRAWS: Final = 100_000
BLOCK = """
from hilserver.plant.blocks import Output, block

@block(inputs=("x_m",), outputs=(Output("margin"), Output("speed_m_s")),
       parameters={"a": 0.0, "b": 0.0, "c": 0.0})
def limit(dt_s, u, y, x, p):
    y[0] = FUNCTION
    y[1] = 0.2
"""
CORRELATION, SD = 0.95, 0.02


def _sweep(folder: Path, function: str, machines: int) -> PreparedSweep:
    """Prepare a sweep of a block that passes where a function of p[0], p[1], p[2] is positive."""
    (folder / "limit.py").write_text(
        BLOCK.replace("FUNCTION", function), encoding="utf-8"
    )
    return _written(
        folder,
        {
            "machines": machines,
            "seed": 11,
            "from": {
                "population": {f"limit.{n}": {"uniform": [-1.0, 1.0]} for n in "abc"}
            },
            "drive": {"duration_s": 0.05},
            "controller": {
                "block": "limit.py:limit",
                "inputs": {"x_m": "pose.x_m"},
                "drives": {"speed_m_s": "twist.linear_m_s"},
            },
            "require": [
                {
                    "name": "limit",
                    "signal": "limit.margin",
                    "above": 0.0,
                    "after_s": 0.02,
                }
            ],
        },
    )


def _written(folder: Path, sweep: dict[str, Any]) -> PreparedSweep:
    path = folder / "sweep.yaml"
    path.write_text(json.dumps(sweep), encoding="utf-8")
    return prepare(path)


def _swept(prepared: PreparedSweep, folder: Path, workers: int = 2) -> MachineTable:
    journal, n = (
        SweepJournal(folder / "out", prepared.job.key, resume=False),
        prepared.sweep.machines,
    )
    machines = map(prepared.machine, range(n))
    with LocalWorkers(workers, prepared.sweep.limits.memory_mb) as pool:
        for computer, batch in outcomes(prepared.job, machines, pool):
            journal.add(batch, computer)
    journal.close()
    return table_of(prepared, journal, range(n))


def _line(name: str, truth: float, table: MachineTable, margin: str) -> dict[str, Any]:
    """Return the truth and the sweep's result."""
    passed = table.count(PASSED)
    low, high = exact_interval(passed, len(table))
    found = influences(dict(table.parameters), table.margins[margin])
    return {
        "truth": name,
        "machines": len(table),
        "share_true": truth,
        "share": passed / len(table),
        "interval": [low, high],
        "inside": low <= truth <= high,
        "ranked": [
            {
                "names": [n.removeprefix("blocks.limit.") for n in item.names],
                "strength": round(item.strength, 4),
                "rank_correlation": round(item.rank_correlation, 4),
            }
            for item in found
        ],
    }


def _of_block(
    name: str,
    function: str,
    margin: Callable[[Any, Any, Any], Any],
    truth: float,
    machines: int,
) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="hilserver-truth-") as folder:
        table = _swept(_sweep(Path(folder), function, machines), Path(folder))
    line = _line(name, truth, table, "limit")
    true = margin(*(table.parameters[f"blocks.limit.{n}"] for n in "abc")) >= 0.0
    # The map draws each machine at its parameters, in the colour of its margin.
    line["wrong_on_the_map"] = int((true != (np.array(table.status) == PASSED)).sum())
    return line


def linear(machines: int = MACHINES) -> dict[str, Any]:
    """Sweep a block that passes if a - 2 b + 0.3 is not negative, for any c: 0.575 of all."""
    return _of_block(
        "linear",
        "p[0] - 2.0 * p[1] + 0.3",
        lambda a, b, _: a - 2.0 * b + 0.3,
        0.575,
        machines,
    )


def not_monotone(machines: int = MACHINES) -> dict[str, Any]:
    """Sweep a block that passes if 0.25 - c^2 + 0.1 a is not negative: c fails at both ends."""
    truth = (0.35**1.5 - 0.15**1.5) / 0.3
    return _of_block(
        "not monotone",
        "0.25 - p[2] * p[2] + 0.1 * p[0]",
        lambda a, _, c: 0.25 - c * c + 0.1 * a,
        truth,
        machines,
    )


def correlated(machines: int = MACHINES) -> dict[str, Any]:
    """Sweep a robot that turns far enough or not; its gain is known jointly with a latency.

    The truth is the probability of the gains for which it does, found by bisection.
    """
    joint = {
        "parameters": ["rotation_gain", "nav_latency"],
        "value": [-0.3, 0.5],
        "covariance": [[SD**2, CORRELATION * SD**2], [CORRELATION * SD**2, SD**2]],
    }
    found = {
        "verdict": "findings",
        "logs": [],
        "seed": 0,
        "version": "0",
        "joint": joint,
    }
    with tempfile.TemporaryDirectory(prefix="hilserver-truth-") as name:
        folder = Path(name)
        text = json.dumps(found | {"config_sha256": Config().sha256})
        (folder / "findings.json").write_text(text, encoding="utf-8")
        write = "{control.mode: 1, twist.angular_rad_s: 1.0}"
        (folder / "course.yaml").write_text(f"steps: [{{at_s: 0.0, write: {write}}}]")
        prepared = _written(
            folder,
            {
                "machines": machines,
                "seed": 11,
                "from": {"findings": "findings.json"},
                "drive": {"scenario": "course.yaml", "duration_s": 0.4},
                "require": [
                    {
                        "name": "turns",
                        "signal": "pose.yaw_rad",
                        "above": 0.263,
                        "within_s": 0.39,
                    }
                ],
            },
        )
        truth = _probability(prepared)
        return _line("correlated", truth, _swept(prepared, folder), "turns")


def _probability(prepared: PreparedSweep) -> float:
    """Return the probability that a drawn gain passes."""
    rig, machine = Rig(prepared.job), prepared.machine(0)

    def margin(gain: float) -> float:
        values = {**machine.values, "terms.rotation_gain": gain}
        p = pack(replace(prepared.robot_with(values), seed=machine.seed)).numbers
        return rig.drive(replace(machine, p=p)).margins[0]

    low, high = -0.3 - 8 * SD, -0.3 + 8 * SD
    rising = margin(high) > margin(low)
    if (margin(low) >= 0.0) == (margin(high) >= 0.0):
        return math.nan
    while high - low > 1e-9:
        middle = (low + high) / 2.0
        low, high = (
            (low, middle) if (margin(middle) >= 0.0) == rising else (middle, high)
        )
    below = float(norm.cdf((low + 0.3) / SD))
    return 1.0 - below if rising else below


def coverage(sweeps: int = SWEEPS, machines: int = MACHINES_OF_EACH) -> dict[str, Any]:
    """Sweep repeatedly with other seeds: how often the interval contains the truth."""
    truth, held = 0.575, 0
    with tempfile.TemporaryDirectory(prefix="hilserver-truth-") as folder:
        prepared = _sweep(Path(folder), "p[0] - 2.0 * p[1] + 0.3", machines)
        rig = Rig(prepared.job)
        for seed in range(sweeps):
            other = replace(prepared, draws=replace(prepared.draws, seed=seed))
            passed = sum(rig.drive(other.machine(k)).passed for k in range(machines))
            low, high = exact_interval(passed, machines)
            held += low <= truth <= high
    return {"truth": "coverage", "sweeps": sweeps, "machines": machines, "held": held}


def binomial(draws: int = BINOMIAL_DRAWS) -> dict[str, Any]:
    """Draw shares and counts: how often the estimator's interval contains the share."""
    rng = np.random.default_rng(1)
    intervals = np.array([exact_interval(k, 200) for k in range(201)])
    truth = rng.uniform(0.0, 1.0, draws)
    low, high = intervals[rng.binomial(200, truth)].T
    held = int(((low <= truth) & (truth <= high)).sum())
    return {"truth": "binomial", "draws": draws, "held": held}


def lines() -> Iterator[dict[str, Any]]:
    """Yield every truth with the result, and the kernels used."""
    for make in (linear, not_monotone, correlated, coverage, binomial):
        yield make() | {"computer": fingerprint()}
