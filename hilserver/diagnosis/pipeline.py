"""One diagnosis from files to documents, in this process: what a worker runs."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.compare.comparison import compare
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.memory import share_arenas
from hilserver.diagnosis.output import documents
from hilserver.diagnosis.report.summary import one_line, summary
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.errors import EXIT_DONE, UserError
from hilserver.measured.frames import Sampling
from hilserver.measured.proposal import FILE as PROPOSAL
from hilserver.measured.proposal import ForeignTable
from hilserver.measured.reading import read_measured

Progress = Callable[[str, float], None]
"""Called with the stage and the share of the whole that is done."""


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
    test : tuple of Path
        Not empty: the gain is measured on these, which take no part in selection or fit.
    jobs : int
        Threads or processes that the diagnosis itself may use; no result depends on it.
    """

    logs: tuple[Path, ...]
    config: Path | None
    mapping: str | None = None
    against: tuple[Path, ...] = ()
    seed: int = 0
    jobs: int = 1
    test: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came of a task: the documents, or the sentence why there are none.

    Beside a sentence `files` may hold what helps to go on: a proposed mapping file.
    """

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
    sampling = Sampling.of(assembly.config)
    log = read_measured(task.logs, task.mapping, sampling)
    if task.against:
        other = read_measured(task.against, task.mapping, sampling)
        return compare(log, other, assembly, seed=task.seed, jobs=task.jobs, progress=progress)
    test = read_measured(task.test, task.mapping, sampling) if task.test else None
    return diagnose(log, assembly, seed=task.seed, jobs=task.jobs, progress=progress, test=test)


def run(task: Task, progress: Progress | None = None) -> Outcome:
    """Judge a task; what a user can fix becomes a sentence."""
    share_arenas()
    try:
        diagnosis = judge(task, progress)
    except ForeignTable as error:
        files = {PROPOSAL: error.proposal} if error.proposal else {}
        return Outcome(error.exit_code, str(error), files=files)
    except UserError as error:
        return Outcome(error.exit_code, str(error))
    found = diagnosis.findings
    return Outcome(line=one_line(found), summary=summary(found), files=documents(diagnosis))
