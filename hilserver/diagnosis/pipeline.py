"""One diagnosis from files to documents, in this process: what a worker runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hilserver.daemon.assembled import Assembly
from hilserver.daemon.assembly import assemble, assemble_config
from hilserver.diagnosis.engine import compare, diagnose, diagnose_groups
from hilserver.diagnosis.for_others import configuration, user_files
from hilserver.diagnosis.memory import reuse_memory
from hilserver.diagnosis.output import documents
from hilserver.diagnosis.progress import Report
from hilserver.diagnosis.regression.stages import foretold
from hilserver.diagnosis.report.summary import one_line, summary
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.diagnosis.schema.findings import Overall
from hilserver.errors import EXIT_DONE, ConfigError, LogError, UserError
from hilserver.exchange import DescribedRobot, read_robot
from hilserver.measured.data import MeasuredLog
from hilserver.measured.frames import Sampling
from hilserver.measured.machine import doubts, machine
from hilserver.measured.marks import with_marks
from hilserver.measured.proposal import FILE as PROPOSAL
from hilserver.measured.proposal import ForeignLog
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters


@dataclass(frozen=True)
class Task:
    """What to diagnose, and how; travels to other processes."""

    logs: tuple[Path, ...]  # of one machine, pooled
    config: Path | None
    mapping: str | None = None  # mapping file, or the name of a built-in one
    against: tuple[Path, ...] = ()  # not empty: do these differ from `logs`, and how?
    seed: int = 0
    # threads or processes of the diagnosis itself; results do not depend on it
    jobs: int = 1
    # not empty: the gain is measured on these, which are not used for selection or fit
    test: tuple[Path, ...] = ()
    # not empty: groups of logs of one machine, by name, instead of `logs`
    groups: tuple[tuple[str, tuple[Path, ...]], ...] = ()
    # file of a controller, or URDF, that describes the robot in place of `config`
    robot: Path | None = None
    # programs whose files are written, too: keys of `exchange.FORMATS`
    formats: tuple[str, ...] = ()
    marks: Path | None = None  # places at known times, if `logs` hold no pose


@dataclass(frozen=True)
class TaskOutcome:
    """The outcome of a task: the documents, or a sentence that explains why there are none.

    With a sentence, `files` may hold something that helps: a proposed mapping file.
    """

    exit_code: int = EXIT_DONE
    error: str = ""
    line: str = ""
    summary: str = ""
    files: dict[str, str] = field(default_factory=dict)


def judge(
    task: Task, progress: Report | None = None, say: Callable[[str], None] | None = None
) -> Diagnosis:
    """Read, check and judge the logs of a task.

    Parameters
    ----------
    say : callable, optional
        Called with a line on what each set of logs can show, before it is judged.

    Raises
    ------
    LogError
        If a log or the mapping cannot be read.
    ConfigError
        If the configuration cannot be used.
    """
    described = read_robot(task.robot) if task.robot else None
    assembly = _assembled(task, described)
    sampling = Sampling.of(assembly.config)

    def read_in(paths: Sequence[Path], name: str = "") -> MeasuredLog:
        found = read_measured(paths, task.mapping, sampling)
        if task.marks is not None:
            found = with_marks(found, task.marks)
        robot = machine(found, assembly.robot)
        questions = doubts(robot)
        if say is not None:
            begin = f"{name}: " if name else ""
            known = [] if described is None else described.against(found.plant)
            for line in (foretold(found, robot), *known, *questions):
                say(begin + line)
        return found.noticed(*questions) if questions else found

    if task.groups:
        read = {name: read_in(paths, name) for name, paths in task.groups}
        refuse_twice(read)
        return diagnose_groups(
            read, assembly, seed=task.seed, jobs=task.jobs, progress=progress
        )
    log = read_in(task.logs)
    if task.against:
        other = read_measured(task.against, task.mapping, sampling)
        return compare(
            log, other, assembly, seed=task.seed, jobs=task.jobs, progress=progress
        )
    test = read_measured(task.test, task.mapping, sampling) if task.test else None
    return diagnose(
        log, assembly, seed=task.seed, jobs=task.jobs, progress=progress, test=test
    )


def opened(task: Task) -> tuple[MeasuredLog, RobotParameters]:
    """Read the logs of a task; return them, and the configured robot.

    Raises
    ------
    LogError, ConfigError
        See `judge`.
    """
    assembly = _assembled(task, read_robot(task.robot) if task.robot else None)
    sampling = Sampling.of(assembly.config)
    return read_measured(task.logs, task.mapping, sampling), assembly.robot


def _assembled(task: Task, described: DescribedRobot | None) -> Assembly:
    """Return what is configured, with the robot that a file describes in place of its own."""
    assembly = assemble(task.config)
    if described is None:
        return assembly
    config = assembly.config.changed(
        plant=described.plant, kinematics={"rotation_gain": described.rotation_gain}
    )
    try:
        return assemble_config(config, assembly.folder)
    except ConfigError as error:
        raise ConfigError(f"{task.robot}: {error}") from None


def refuse_twice(groups: Mapping[str, MeasuredLog]) -> None:
    """Refuse a log that is in two groups, with LogError."""
    seen: dict[str, tuple[str, str]] = {}
    for name, log in groups.items():
        for source in log.sources:
            if source.sha256 in seen:
                other, file = seen[source.sha256]
                raise LogError(
                    f"{source.file}: in group {name} is the same log as {file} in group {other};"
                    " list it in only one of them"
                )
            seen[source.sha256] = (name, source.file)


def run(
    task: Task, progress: Report | None = None, say: Callable[[str], None] | None = None
) -> TaskOutcome:
    """Judge a task, see `judge`; an error that the user can fix becomes a sentence."""
    reuse_memory()
    try:
        diagnosis = judge(task, progress, say)
    except ForeignLog as error:
        files = {PROPOSAL: error.proposal} if error.proposal else {}
        return TaskOutcome(error.exit_code, str(error), files=files)
    except UserError as error:
        return TaskOutcome(error.exit_code, str(error))
    found, files = diagnosis.findings, documents(diagnosis)
    difference = 0.0
    if task.robot:
        described = read_robot(task.robot)
        difference = described.wheel_radius_difference
        files |= configuration(described)
    is_judged = found.verdict is not Overall.NOT_JUDGED
    if task.formats and not is_judged and say is not None:
        say("no files for other programs: nothing about the robot could be judged")
    if task.formats and is_judged and diagnosis.robot is not None:
        files |= user_files(diagnosis, diagnosis.robot, task.formats, difference)
    return TaskOutcome(line=one_line(found), summary=summary(found), files=files)
