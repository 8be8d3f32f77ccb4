"""One diagnosis from files to documents, in this process: what a worker runs."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from hilserver.assembly import assemble
from hilserver.diagnosis.evidence import Diagnosis
from hilserver.diagnosis.output import documents
from hilserver.diagnosis.summary import one_line, summary
from hilserver.errors import EXIT_DONE, UserError

Progress = Callable[[str, float], None]
"""Told the stage and the share of the whole that is done."""
_ROOM: Final = "hilserver.diagnosis"


@dataclass(frozen=True)
class Task:
    """What to diagnose, and how; travels to other processes.

    Attributes
    ----------
    logs : tuple of Path
        Of one machine, pooled.
    against : tuple of Path
        Not empty: do these differ from `logs`, and in what?
    mapping : str or None
        Mapping file, or the name of a built-in one.
    jobs : int
        Threads or processes that the diagnosis itself may use; no result depends on it.
    """

    logs: tuple[Path, ...]
    config: Path | None
    mapping: str | None = None
    against: tuple[Path, ...] = ()
    seed: int = 0
    jobs: int = 1


@dataclass(frozen=True)
class Outcome:
    """What came of a task: the documents, or the sentence why there are none."""

    exit_code: int = EXIT_DONE
    error: str = ""
    line: str = ""
    summary: str = ""
    files: dict[str, str] = field(default_factory=dict)


def judge(task: Task, progress: Progress | None = None) -> Diagnosis:
    """Read, check and judge the logs of a task.

    Raises
    ------
    LogError
        If a log or the mapping cannot be read.
    ConfigError
        If the configuration cannot be used.
    """
    assembly = assemble(task.config)
    read = _stage("reading", "read_measured")
    log = read(task.logs, task.mapping)
    options = {"seed": task.seed, "jobs": task.jobs, "progress": progress}
    if task.against:
        other = read(task.against, task.mapping)
        compared: Diagnosis = _stage("compare", "compare")(log, other, assembly, **options)
        return compared
    judged: Diagnosis = _stage("engine", "diagnose")(log, assembly, **options)
    return judged


def run(task: Task, progress: Progress | None = None) -> Outcome:
    """Judge a task; what a user can mend becomes a sentence."""
    try:
        diagnosis = judge(task, progress)
    except UserError as error:
        return Outcome(error.exit_code, str(error))
    found = diagnosis.findings
    return Outcome(line=one_line(found), summary=summary(found), files=documents(diagnosis))


def _stage(module: str, function: str) -> Any:
    """Return a stage; only those that a task needs are loaded."""
    return getattr(import_module(f"{_ROOM}.{module}"), function)
