"""A simulated robot drives an experiment, in virtual time, and is recorded."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from hilserver.body.engine import mujoco
from hilserver.body.parameters import BodyParameters
from hilserver.config.mechatronic import BODY_PERIOD_MS
from hilserver.config.root import Config, load_config
from hilserver.daemon.assembly import Assembly, assemble, assemble_config
from hilserver.errors import FailedError, reason
from hilserver.experiment.thesis import Experiment
from hilserver.faults.scenario import Play, load_scenario
from hilserver.measured.channels import TAG
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.errors import PlantError
from hilserver.plant.parameters import RobotParameters
from hilserver.program.whole_file import writing
from hilserver.replay.simulation import Simulation

RECORDING: Final = "recording.mcap"
PLANAR: Final = ("pose.x_m", "pose.y_m", "pose.yaw_rad")
BODY: Final = ("mech.x_m", "mech.y_m", "mech.yaw_rad")
TICKS_A_POSE: Final = 20


def robot_of(path: Path) -> Assembly:
    """Return the robot of a configuration, without its body if MuJoCo is not installed."""
    config = load_config(path)
    if not config.mechatronic.enabled or missing_body() is None:
        return assemble(path)
    planar = {"enabled": False, "driven_by": "speed", "sensors": "planar"}
    return assemble_config(config.changed(mechatronic=planar), path.resolve().parent)


def missing_body() -> str | None:
    """Return the sentence that says how to install MuJoCo; None if it is there."""
    try:
        mujoco()
    except PlantError as error:
        return str(error)
    return None


def body_of(config: Config, plant: RobotParameters) -> BodyParameters | str:
    """Return the body that wheel speeds drive, or the sentence that says why there is none."""
    missing = missing_body()
    if missing is not None:
        return f"There is no mechatronic curve: it {missing.partition(': ')[2]}"
    try:
        body = config.mechatronic.body(plant, BODY_PERIOD_MS * 1e-3)
    except PlantError as error:
        return f"There is no mechatronic curve: {error}"
    return replace(body, torque=False)


def record(
    experiment: Experiment,
    robot: Assembly,
    out: Path,
    progress: Callable[[str, float], None],
) -> None:
    """Let the robot drive the experiment's scenario; write every signal of every tick to `out`."""
    play = Play(load_scenario(experiment.drive), experiment.drive)
    n_ticks = round(play.scenario.lasts_s * 1e9 / robot.base_period_ns)
    try:
        with writing(out, out.suffix) as partial:
            asyncio.run(_play(robot, play, n_ticks, partial, progress))
    except OSError as error:
        raise FailedError(f"{out}: the drive ended: {reason(error)}") from None


async def _play(
    robot: Assembly,
    play: Play,
    n_ticks: int,
    out: Path,
    progress: Callable[[str, float], None],
) -> None:
    done = 0
    async with Simulation(robot, play) as simulation:
        with simulation.log(out) as writer:
            async for batch in simulation.frames(n_ticks):
                writer.write(batch)
                done += len(batch.frames)
                progress("the simulated robot drives", done / n_ticks)


def as_it_was(log: MeasuredLog) -> MeasuredLog:
    """Return a simulated robot's recording with its true pose instead of what its tag showed.

    The noise of the tag is larger than what the models differ by. The pose is that of the body, if
    it has one.
    """
    pose = BODY if log.has(*BODY) else PLANAR
    true = {}
    kept = slice(None, None, TICKS_A_POSE)
    for name, source in zip(TAG, pose, strict=True):
        channel = log[source]
        true[name] = Channel(
            channel.t_s[kept], channel.values[kept], channel.span[kept]
        )
    return log.with_channels(true)
