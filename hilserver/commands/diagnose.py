"""Measured data in, findings out: what the simulation gets wrong, why, and the remedy.

Writes findings.json, report.html and, where the model can be extended, model_patch.yaml. Several
logs are taken for one machine and pooled, unless --each gives every log a report of its own;
--group says which belong together, and the report what they share.
"""

import argparse
import os
import re
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from hilserver.commands.options import (
    PROCESSES,
    SEED,
    add_config,
    add_mapping,
    add_out,
    comma_names,
    config_path,
)
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.many import on_cluster
from hilserver.diagnosis.output import REPORT, TRIED, write, write_files
from hilserver.diagnosis.pipeline import Task, TaskOutcome
from hilserver.diagnosis.pipeline import run as diagnose
from hilserver.diagnosis.power.attempts import (
    Attempt,
    AttemptOutcome,
    attempted,
    attempts_of,
    until,
)
from hilserver.diagnosis.power.table import (
    PowerRow,
    files_of,
    lines_of,
    rows_of,
)
from hilserver.errors import (
    EXIT_DONE,
    ConfigError,
    FailedError,
    LogError,
    UsageError,
    meant,
)
from hilserver.exchange import FORMATS
from hilserver.program.progress import Progress
from hilserver.program.workers import in_processes

EXAMPLE = "hilserver diagnose run1.csv run2.csv -c config.yaml -o diagnosis"
STOPPED = "stopped before the diagnosis was finished: no report was written"
MOST_MINUTES = 60.0
T = TypeVar("T")
R = TypeVar("R")
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")
_ERRORS = {2: LogError, 78: ConfigError}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG", help="logs of one machine"
    )
    add_config(parser)
    add_mapping(parser)
    add_out(parser, "DIR", "folder for the report")
    parser.add_argument(
        "--seed", type=SEED, default=0, help="seed of all random draws; default: 0"
    )
    parser.add_argument(
        "--jobs",
        type=PROCESSES,
        default=os.cpu_count() or 1,
        help="processes; default: all cores",
    )
    parser.add_argument(
        "--each",
        action="store_true",
        help="one report per log, in a folder named after it",
    )
    parser.add_argument(
        "--test",
        nargs="+",
        type=Path,
        metavar="LOG",
        help="other logs of the machine: the gain is measured on them, but nothing is fitted to"
        " them",
    )
    parser.add_argument(
        "--marks",
        type=Path,
        metavar="FILE",
        help="where the robot was at a few times, if the log holds no pose: marks.yaml",
    )
    parser.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="with --each or --try: use this Dask cluster, as tcp://host:8786",
    )
    parser.add_argument(
        "--try",
        dest="tries",
        action="store_true",
        help="put known effects into the log and report which of them would have been found",
    )
    parser.add_argument(
        "--causes",
        type=_causes,
        default=(),
        metavar="NAME,NAME",
        help="with --try: only these causes; default: all that the log can show",
    )
    parser.add_argument(
        "--minutes",
        type=_minutes,
        metavar="N",
        help=f"with --try: begin no effect after this time; default: {MOST_MINUTES:g}",
    )
    parser.add_argument(
        "--robot",
        type=Path,
        metavar="FILE",
        help="take the robot's dimensions from the YAML of a ros2_control controller or a URDF",
    )
    parser.add_argument(
        "--for",
        dest="formats",
        type=_formats,
        default=(),
        metavar="NAME,NAME",
        help=f"write the result for these programs, too: {', '.join(FORMATS)}",
    )
    parser.add_argument(
        "--group",
        action="append",
        type=_group,
        metavar="NAME=LOG,LOG",
        help="logs of one floor or load, in place of LOG; give two or more to see what they share",
    )
    parser.add_argument(
        "--compare",
        nargs="+",
        type=Path,
        metavar="A",
        help="logs before a change, in place of LOG",
    )
    parser.add_argument(
        "--against",
        nargs="+",
        type=Path,
        metavar="B",
        help="logs after it: what is different?",
    )


def _group(text: str) -> tuple[str, tuple[Path, ...]]:
    name, _, logs = text.partition("=")
    paths = tuple(Path(log) for log in logs.split(",") if log)
    if not _NAME.fullmatch(name) or not paths:
        raise argparse.ArgumentTypeError(
            f"{text} is not a group; write its name (letters, digits, - and _) and its logs, as"
            " sand=run1.csv,run2.csv"
        )
    return name, paths


def _formats(text: str) -> tuple[str, ...]:
    names = comma_names(text)
    for name in names:
        if name not in FORMATS:
            raise argparse.ArgumentTypeError(
                f"{name} is none of {', '.join(FORMATS)}; write names with commas between them"
            )
    return names


def _causes(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    for name in names:
        if name not in CAUSES:
            hint = meant(name, CAUSES, "findings.json lists them")
            raise argparse.ArgumentTypeError(f"there is no cause '{name}'; {hint}")
    return names


def _minutes(text: str) -> float:
    try:
        minutes = float(text)
    except ValueError:
        minutes = 0.0
    if not 0.0 < minutes <= 10_000.0:
        raise argparse.ArgumentTypeError(f"{text} is no time; write minutes, as 30")
    return minutes


def run(args: argparse.Namespace) -> int:
    """Diagnose; return 0 whatever was found, 2 if a log cannot be read."""
    _check(args)
    if args.each:
        return _each(args)
    task = Task(
        logs=tuple(args.compare or args.logs),
        against=tuple(args.against or ()),
        test=tuple(args.test or ()),
        config=config_path(args),
        mapping=args.mapping,
        seed=args.seed,
        jobs=args.jobs,
        groups=tuple(args.group or ()),
        robot=args.robot,
        formats=args.formats,
        marks=args.marks,
    )
    with Progress(lambda: STOPPED) as progress:
        outcome = diagnose(task, progress, lambda line: progress.say(line, sys.stderr))
    if outcome.error:
        raise _ERRORS.get(outcome.exit_code, FailedError)(
            outcome.error + _aid(args, outcome)
        )
    write(args.out, outcome.files)
    print(outcome.summary)
    print(f"The report is {args.out / REPORT}")
    if args.tries:
        _try(args, task)
    return EXIT_DONE


def _try(args: argparse.Namespace, task: Task) -> None:
    """Put known effects into the log; write and print which of them would have been found."""
    task = _absolute(replace(task, jobs=1, formats=()))
    results: dict[int, AttemptOutcome] = {}
    attempts: list[Attempt] = []

    def stopped() -> str:
        if not attempts:
            return "stopped before any effect was tried; the report is written"
        done = f"{len(results)} of {len(attempts)} effects"
        return f"stopped after {done}; {args.out / TRIED[-1]} holds their outcomes"

    with Progress(stopped) as progress:
        progress("trying: the recording as it is", 0.0)
        control = attempted(Attempt(task, label=""))
        if control.error:
            raise FailedError(control.error)
        attempts += attempts_of(task, control, args.causes)
        for cause in sorted({*args.causes} - {one.cause for one in attempts}):
            is_there = cause in control.causes
            why = "shows it already" if is_there else "does not show it"
            progress.say(f"{cause} is not tried: the recording {why}", sys.stderr)
        rows: list[PowerRow] = []
        write_files(args.out, files_of(rows, len(attempts)))
        limit_s = 60.0 * (args.minutes or MOST_MINUTES)
        with closing(_spread(attempted, attempts, args)) as outcomes:
            for index, outcome in until(outcomes, limit_s):
                results[index] = outcome
                rows = rows_of(attempts, results, control)
                write_files(args.out, files_of(rows, len(attempts)))
                share = len(results) / len(attempts)
                progress(f"trying: {len(results)} of {len(attempts)} effects", share)
    print("\n".join(lines_of(rows, len(attempts))))


def _aid(args: argparse.Namespace, outcome: TaskOutcome) -> str:
    """Write what helps after an error; return the words that say where it is."""
    if not outcome.files:
        return ""
    write_files(args.out, outcome.files)
    return "".join(
        f"; {args.out / name} is a first guess: check and complete it"
        for name in outcome.files
    )


def _check(args: argparse.Namespace) -> None:
    if bool(args.compare) != bool(args.against):
        raise UsageError(
            "--compare and --against belong together: logs before and after a change"
        )
    if args.compare and (args.logs or args.each):
        raise UsageError(
            "--compare A... --against B... cannot be combined with other logs or --each"
        )
    if args.compare and args.formats:
        raise UsageError("--for writes what one diagnosis found: leave --compare out")
    if args.group:
        _check_groups(args)
    elif not args.compare and not args.logs:
        raise UsageError(
            "name at least one log, or two sets with --compare and --against"
        )
    if args.test and (args.compare or args.each):
        raise UsageError("--test cannot be combined with --compare or --each")
    if args.marks and (args.compare or args.each or args.group or args.test):
        raise UsageError(
            "--marks cannot be combined with --compare, --each, --group or --test: its times are"
            " those of one set of logs"
        )
    _check_tries(args)
    if args.dask and not (args.each or args.tries):
        raise UsageError(
            "--dask distributes many diagnoses: use it with --each or --try"
        )
    if args.out.exists() and not args.out.is_dir():
        raise FailedError(f"{args.out}: is a file; name a folder for the report")


def _check_tries(args: argparse.Namespace) -> None:
    others = args.compare or args.each or args.group or args.test or args.marks
    if args.tries and others:
        raise UsageError(
            "--try cannot be combined with --compare, --each, --group, --test or --marks: it puts"
            " effects into one set of logs"
        )
    if args.causes and not args.tries:
        raise UsageError("--causes names what to try: use it with --try")
    if args.minutes is not None and not args.tries:
        raise UsageError("--minutes limits what is tried: use it with --try")


def _check_groups(args: argparse.Namespace) -> None:
    if args.logs or args.each or args.compare or args.test:
        raise UsageError(
            "--group cannot be combined with other logs, --each, --compare or --test"
        )
    names = [name for name, _ in args.group]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--group {twice} is given twice; put all its logs into one")
    if len(names) < 2:
        raise UsageError(
            "--group compares groups of logs: name two or more, or leave it out"
        )


def _absolute(task: Task) -> Task:
    """Return a task for a worker, which may run in another folder."""
    mapping = task.mapping
    if mapping is not None and Path(mapping).exists():
        mapping = str(Path(mapping).absolute())
    return replace(
        task,
        logs=tuple(log.absolute() for log in task.logs),
        config=None if task.config is None else task.config.absolute(),
        mapping=mapping,
        robot=None if task.robot is None else task.robot.absolute(),
    )


def _each(args: argparse.Namespace) -> int:
    one = Task(
        logs=(),
        config=config_path(args),
        mapping=args.mapping,
        seed=args.seed,
        robot=args.robot,
        formats=args.formats,
    )
    tasks = [_absolute(replace(one, logs=(log,))) for log in args.logs]
    folders = _folders(args.logs)
    code, done = EXIT_DONE, 0

    def stopped() -> str:
        return f"stopped after {done} of {len(tasks)} logs; their reports are kept"

    with (
        Progress(stopped) as progress,
        closing(_spread(diagnose, tasks, args)) as outcomes,
    ):
        for index, outcome in outcomes:
            done += 1
            progress(f"{done} of {len(tasks)} logs", done / len(tasks))
            if outcome.error:
                code = max(code, outcome.exit_code)
                progress.say(f"hilserver: {outcome.error}", sys.stderr)
                continue
            write(args.out / folders[index], outcome.files)
            progress.say(f"{folders[index]}: {outcome.line}", sys.stdout)
    return code


def _spread(
    function: Callable[[T], R], tasks: Sequence[T], args: argparse.Namespace
) -> Generator[tuple[int, R], None, None]:
    """Return the results of tasks from a cluster, or from processes of this computer."""
    if args.dask:
        return on_cluster(function, tasks, args.dask)
    return in_processes(function, tasks, args.jobs)


def _folders(logs: list[Path]) -> list[str]:
    """Return a folder name for every log: its stem, numbered where two are equal."""
    names: list[str] = []
    for log in logs:
        name, number = log.stem, 2
        while name in names:
            name, number = f"{log.stem}-{number}", number + 1
        names.append(name)
    return names
