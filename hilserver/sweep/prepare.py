"""From the file of a sweep to what a worker needs: checked once, before it is submitted."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import isnan
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from hilserver import __version__
from hilserver.arrays import Array
from hilserver.compiled import kernel_hash
from hilserver.config.blocks import BlockConfig
from hilserver.config.loading import load, place, placed
from hilserver.config.patch import Patch, load_patch
from hilserver.config.root import Config, load_config
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.diagnosis.schema.findings import Findings
from hilserver.errors import ConfigError, meant
from hilserver.faults import Fault, Scenario, load_scenario
from hilserver.parameters import (
    Parameter,
    check,
    geometric_gain,
    read,
    table_of,
    with_values,
)
from hilserver.parameters.table import BLOCK, TERM
from hilserver.plant.errors import PlantError
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import TERMS, main_part
from hilserver.replay.simulation import quiet
from hilserver.requirements import Judge
from hilserver.small_file import read_small
from hilserver.sweep.draws import Draws, JointDraw, root_of
from hilserver.sweep.model import MachineSource, Sweep, TestedController

PATH_ERROR = "path.error_m"
_MOST_BYTES = 50_000_000


@dataclass(frozen=True)
class SentMachine:
    """One machine, in the form that is sent to a worker."""

    index: int
    seed: int
    values: Mapping[str, float]  # drawn values, by full names
    faults: tuple[tuple[int, Fault], ...] = ()  # with their numbers in the file
    # all terms of its plant, drawn or not
    terms: Mapping[str, float | None] = field(default_factory=dict)
    # packed parameters; None for one that cannot be built, `refused` says why
    p: Array | None = None
    # nonzero words of its first state
    state: Mapping[int, float] = field(default_factory=dict)
    refused: str = ""


@dataclass(frozen=True)
class SweepJob:
    """What all machines of a sweep share, in the form that is sent to a worker."""

    key: str  # hash of all that decides a machine's result, except its index
    config: Config  # with the controller if it is a block; nothing listens or connects
    folder: Path  # of the configuration
    path: Path  # of the sweep; controllers and checks lie beside it
    scenario: Scenario
    scenario_path: Path | None
    sweep: Sweep
    n_ticks: int


@dataclass(frozen=True)
class PreparedSweep:
    """A sweep that can run."""

    job: SweepJob
    # the robot's configuration with the controller, as `hilserver run` takes it
    user_config: Config
    assembly: Assembly
    robot: RobotParameters
    table: Mapping[str, Parameter]
    draws: Draws
    left_out: tuple[str, ...]  # parameters of the findings that a robot does not have

    @property
    def sweep(self) -> Sweep:
        """The file."""
        return self.job.sweep

    def machine(self, index: int) -> SentMachine:
        """Return the machine with an index, the same on every computer."""
        values = self.draws.values(index)
        seed = self.draws.plant_seed(index)
        faults = tuple(self.draws.faults_of(index))
        try:
            robot = replace(self.robot_with(values), seed=seed)
            p = pack(robot).numbers
            x = initial_state(robot).numbers
        except PlantError as error:
            return SentMachine(index, seed, values, faults, refused=str(error))
        state = {int(i): float(x[i]) for i in np.flatnonzero(x)}
        return SentMachine(
            index, seed, values, faults, dict(robot.terms), np.array(p), state
        )

    def robot_with(self, values: Mapping[str, float]) -> RobotParameters:
        """Return the robot with drawn values.

        PlantError if there is no such robot; nothing is clipped.
        """
        checked = {
            name: check(self.table[name], value) for name, value in values.items()
        }
        own = {name: v for name, v in checked.items() if not name.startswith(BLOCK)}
        return with_values(self.robot, own, geometric_gain(self.robot))


def prepare(path: Path, config_path: Path | None = None) -> PreparedSweep:
    """Load a sweep and check all that it names; ConfigError has a line per complaint."""
    sweep = load(path, Sweep)
    path = path.resolve()
    if config_path is None and sweep.config is not None:
        config_path = path.parent / sweep.config
    config = load_config(config_path)
    folder = Path.cwd() if config_path is None else config_path.resolve().parent
    findings, patch = _findings(sweep.from_, path, config)
    with_controller = _with_controller(config, sweep.controller, path)
    # The robot with its controller, and nothing that listens or connects.
    with placed(path, () if sweep.controller is None else ("controller",)):
        assembly = assemble_config(quiet(with_controller), folder, patch)
    if any(block.model is not None for block in assembly.composition.blocks):
        raise ConfigError(
            f"{place(folder / 'config.yaml', ('blocks',))}a sweep cannot restart an FMU for"
            " every machine; leave it out"
        )
    table = table_of(
        (block.name, block.declaration) for block in assembly.composition.blocks
    )
    scenario, n_ticks = _drive(sweep, path, assembly)
    joint, left_out = _joint(findings, path)
    draws = _draws(sweep, path, assembly, table, joint)
    derived = () if sweep.drive.path is None else (PATH_ERROR,)
    Judge(sweep.require, assembly.table, path, derived)
    duration_s = n_ticks * assembly.base_period_ns * 1e-9
    for index, requirement in enumerate(sweep.require):
        if requirement.lasts_s > duration_s:
            raise ConfigError(
                f"{place(path, ('require', index))}'{requirement.name}' needs a drive of"
                f" {requirement.lasts_s:g} s, but this one ends after {duration_s:g} s"
            )
    job = SweepJob(
        _key(sweep, config, scenario, findings, path),
        assembly.config,
        folder,
        path,
        scenario,
        None if sweep.drive.scenario is None else path.parent / sweep.drive.scenario,
        sweep,
        n_ticks,
    )
    robot = assembly.robot
    return PreparedSweep(job, with_controller, assembly, robot, table, draws, left_out)


def _with_controller(
    config: Config, controller: TestedController | None, path: Path
) -> Config:
    config = config.changed(control={"source": "scenario"})
    if controller is None or controller.block is None:
        return config
    file, colon, function = controller.block.rpartition(":")
    where = str(path.parent / file) if file.endswith(".py") else file
    wanted = controller.model_dump(include={"slice", "inputs", "drives", "parameters"})
    try:
        name = controller.name or function
        block = BlockConfig(
            name=name,
            function=where + colon + function,
            **wanted,
        )
    except ValidationError as error:
        text = error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")
        raise ConfigError(f"{place(path, ('controller', 'block'))}{text}") from None
    return config.changed(blocks=(*config.blocks, block))


def _drive(sweep: Sweep, path: Path, assembly: Assembly) -> tuple[Scenario, int]:
    scenario = Scenario()
    if sweep.drive.scenario is not None:
        file = path.parent / sweep.drive.scenario
        scenario = load_scenario(file)
        for index, step in enumerate(scenario.steps):
            if step.set_:
                raise ConfigError(
                    f"{place(file, ('steps', index, 'set'))}a sweep draws the parameters of its"
                    " machines for the whole drive; leave 'set' out"
                )
            if sweep.controller is not None and sweep.controller.command:
                raise ConfigError(
                    f"{place(file, ('steps', index))}the controller is a program, and only it"
                    " may command; keep the faults and leave 'steps' out"
                )
    duration_s = sweep.drive.duration_s or scenario.lasts_s
    return scenario, max(round(duration_s * 1e9 / assembly.base_period_ns), 1)


# --- where the machines come from -----------------------------------------------------------------


def _findings(
    source: MachineSource, path: Path, config: Config
) -> tuple[tuple[Path, Findings] | None, Patch | None]:
    if source.findings is None:
        return None, None
    file = path.parent / source.findings
    where = place(path, ("from", "findings"))
    try:
        findings = Findings.model_validate_json(read_small(file, _MOST_BYTES))
    except OSError as error:
        raise ConfigError(
            f"{where}{file}: {(error.strerror or 'unreadable').lower()}"
        ) from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigError(
            f"{where}{file} is not a findings.json of hilserver: {key}: {first['msg']}"
        ) from None
    if findings.config_sha256 != config.sha256:
        raise ConfigError(
            f"{where}{file} is from another robot: it was made with configuration"
            f" {findings.config_sha256[:12]}, this one is {config.sha256[:12]}; give the"
            " configuration that was diagnosed with 'config' or -c, or diagnose again"
        )
    if findings.joint is None or not findings.joint.parameters:
        raise ConfigError(f"{where}{file} has no joint: nothing was fitted to its logs")
    patch = None
    if findings.model_patch is not None:
        patch = load_patch(file.parent / findings.model_patch)
    return (file, findings), patch


def _joint(
    found: tuple[Path, Findings] | None, path: Path
) -> tuple[JointDraw | None, tuple[str, ...]]:
    if found is None or found[1].joint is None:
        return None, ()
    joint = found[1].joint
    where = place(path, ("from", "findings"))
    causes = {term.cause for term in TERMS.values()}
    mine = [k for k, n in enumerate(joint.parameters) if n in TERMS or n in causes]
    left_out = tuple(n for k, n in enumerate(joint.parameters) if k not in mine)
    if not mine:
        raise ConfigError(
            f"{where}{found[0]}: its joint contains no parameter of a robot"
        )
    names = tuple(TERM + main_part(joint.parameters[k]) for k in mine)
    try:
        root = root_of(np.array(joint.covariance)[np.ix_(mine, mine)])
    except (ValueError, IndexError) as error:
        raise ConfigError(f"{where}{found[0]}: its covariance {error}") from None
    return JointDraw(names, np.array(joint.value)[mine], root), left_out


def _draws(
    sweep: Sweep,
    path: Path,
    assembly: Assembly,
    table: Mapping[str, Parameter],
    joint: JointDraw | None,
) -> Draws:
    nominal = read(assembly.robot)
    for block in assembly.composition.blocks:
        given = {**block.declaration.parameters, **block.parameters}
        nominal |= {
            f"{BLOCK}{block.name}.{name}": value for name, value in given.items()
        }
    population = {}
    for given_name, distribution in sweep.from_.population.items():
        where = place(path, ("from", "population", given_name))
        name = _full_name(given_name, table)
        if name is None:
            hint = meant(
                given_name, table, "all names are in docs/reference/parameters.md"
            )
            raise ConfigError(f"{where}there is no such parameter; {hint}")
        if name in population or (joint is not None and name in joint.names):
            raise ConfigError(f"{where}{name} is drawn twice; keep one")
        if table[name].when == "restart":
            raise ConfigError(
                f"{where}{name} is fixed once a robot is built; leave it out"
            )
        if (
            distribution.sd is not None
            and distribution.mean is None
            and isnan(nominal[name])
        ):
            raise ConfigError(
                f"{where}{name} is null in the configuration; write a mean"
            )
        population[name] = distribution
    nominal = {name: nominal[name] for name in population}
    return Draws(sweep.seed, population, nominal, joint, sweep.faults)


def _full_name(name: str, table: Mapping[str, Parameter]) -> str | None:
    """Return the full name of a parameter; its section, or a term's first part, may be missing."""
    bare = name.removeprefix(TERM)
    try:
        term = TERM + main_part(bare)
    except PlantError:
        term = ""
    tried = (name, term, f"sensors.{name}", f"plant.{name}", f"{BLOCK}{name}")
    return next((full for full in tried if full in table), None)


def _key(
    sweep: Sweep,
    config: Config,
    scenario: Scenario,
    findings: tuple[Path, Findings] | None,
    path: Path,
) -> str:
    """Return the hash of all that decides results; the number of machines does not."""
    digest = hashlib.sha256()
    said = sweep.model_dump(mode="json", by_alias=True, exclude={"machines"})
    parts = (
        said,
        config.sha256,
        scenario.model_dump(mode="json"),
        kernel_hash(),
        __version__,
    )
    digest.update(json.dumps(parts, sort_keys=True).encode())
    if findings is not None:
        digest.update(findings[0].read_bytes())
    controller = sweep.controller
    own = [r.python for r in sweep.require if r.python is not None]
    own += (
        []
        if controller is None
        else [c for c in (controller.block, controller.python) if c]
    )
    files = [
        name
        for name in (reference.rpartition(":")[0] for reference in own)
        if name[-3:] == ".py"
    ]
    files += [] if controller is None else controller.command
    for file in (path.parent / name for name in files):
        if file.is_file():
            digest.update(file.read_bytes())
    return digest.hexdigest()
