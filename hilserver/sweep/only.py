"""One machine of a sweep once more, through the whole daemon, with everything recorded.

The recording's margins are those of the table, bit by bit; configuration and scenario are files
that ``hilserver run`` takes.
"""

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hilserver.daemon.assembly import assemble
from hilserver.errors import FailedError
from hilserver.faults.scenario import MAX_STEPS, Play, Scenario, Step, as_yaml
from hilserver.replay.simulation import Simulation
from hilserver.sweep.batch import rig_for
from hilserver.sweep.configuration import machine_config
from hilserver.sweep.prepare import PreparedSweep, SentMachine
from hilserver.sweep.rig import MachineOutcome, judge_of, margins_of, scenario_of

CONFIG, SCENARIO = "config.yaml", "scenario.yaml"
RECORDING, MARGINS = "recording.mcap", "margins.json"


def drive_again(prepared: PreparedSweep, index: int, folder: Path) -> MachineOutcome:
    """Write configuration, scenario, recording and margins of one machine; return its outcome.

    FailedError if there is no such machine, or the daemon's drive differs from the sweep's.
    """
    machine = prepared.machine(index)
    if machine.p is None:
        raise FailedError(f"machine {index} cannot be built: {machine.refused}")
    rig = rig_for(prepared.job)
    outcome = rig.drive(machine)
    folder.mkdir(parents=True, exist_ok=True)
    data = machine_config(prepared.user_config, prepared.job.folder, machine)
    (folder / CONFIG).write_text(
        yaml.safe_dump(data, sort_keys=False), encoding="utf-8"
    )
    # The controller's commands are steps of the scenario.
    base = prepared.job.scenario
    period_s = prepared.assembly.base_period_ns * 1e-9
    steps = [
        Step(at_s=tick * period_s, write={n: _plain(v) for n, v in values.items()})
        for tick, values in rig.written
    ]
    whole = sorted((*base.steps, *steps), key=lambda step: step.at_s)
    if len(whole) > MAX_STEPS:
        raise FailedError(
            f"the controller commanded {len(steps)} times, but a scenario can hold only"
            f" {MAX_STEPS} steps;"
            " choose a longer every_ms or a shorter drive"
        )
    title = f"machine {machine.index} of {prepared.job.path.name}"
    scenario = scenario_of(base, machine)
    scenario = scenario.changed(scenario=title, steps=tuple(whole))
    text = as_yaml(scenario.model_dump(mode="json", exclude_defaults=True))
    (folder / SCENARIO).write_text(text, encoding="utf-8")
    margins = asyncio.run(_record(prepared, machine, scenario, folder))
    names = [r.name for r in prepared.sweep.require]
    about = {"index": index, "seed": machine.seed, "parameters": dict(machine.values)}
    about |= {"margins": dict(zip(names, margins, strict=True)), "error": outcome.error}
    (folder / MARGINS).write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    if not outcome.error and margins != outcome.margins:
        raise FailedError(
            f"machine {index} behaves differently in the daemon: margins {margins}, in the sweep"
            f" {outcome.margins}; please report it with {folder}"
        )
    return outcome


async def _record(
    prepared: PreparedSweep, machine: SentMachine, scenario: Scenario, folder: Path
) -> tuple[float, ...]:
    """Play the scenario with the written configuration; return the margins of the recording."""
    job = prepared.job
    assembly = assemble(folder / CONFIG)
    if (
        assembly.composition.parameters.numbers.tobytes()
        != np.array(machine.p).tobytes()
    ):
        raise FailedError(
            f"{folder / CONFIG} makes a different robot from machine {machine.index}"
        )
    judge, names = judge_of(job, assembly.table)
    kept: list[NDArray[np.float64]] = []
    async with Simulation(assembly, Play(scenario, folder / SCENARIO)) as simulation:
        slots = [simulation.table.slot(name) for name in names]
        with simulation.log(folder / RECORDING) as writer:
            async for batch in simulation.frames(job.n_ticks):
                writer.write(batch)
                kept.append(batch.frames.values[:, slots])
    columns = dict(zip(names, np.vstack(kept).T, strict=True))
    return margins_of(job, judge, assembly.base_period_ns, columns)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value
