"""Drive one controller on thousands of machines in virtual time: how many pass, and what decides.

The machines come from the findings of a diagnosis (how well one machine is known), from a
population (how machines scatter), or both. Results do not depend on the number of workers.
"""

import argparse
import os
import time
from contextlib import closing
from pathlib import Path

from hilserver.commands.options import PROCESSES, add_config
from hilserver.errors import EXIT_DONE, FailedError, UsageError
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.program.progress import Progress
from hilserver.sweep.batch import rig_for
from hilserver.sweep.campaign import DaskWorkers, LocalWorkers, outcomes
from hilserver.sweep.journal import SweepJournal
from hilserver.sweep.junit import write_junit
from hilserver.sweep.only import drive_again
from hilserver.sweep.prepare import PreparedSweep, prepare
from hilserver.sweep.report.page import write_report
from hilserver.sweep.table import MachineTable, read_table, table_of, write_table
from hilserver.sweep.words import compare, details, headline, plan

EXAMPLE = "hilserver sweep sweep.yaml -o result --workers 2"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "sweep", type=Path, nargs="?", metavar="SWEEP", help="sweep file (.yaml)"
    )
    parser.add_argument(
        "-o", "--out", type=Path, metavar="DIR", help="folder for results and report"
    )
    add_config(parser)
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=PROCESSES,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes; default: all cores",
    )
    where.add_argument(
        "--dask", metavar="ADDRESS", help="Dask cluster, as tcp://host:8786"
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--only",
        type=int,
        metavar="INDEX",
        help="run one machine again, with a full recording",
    )
    what.add_argument(
        "--dry-run", action="store_true", help="check, run one machine, estimate"
    )
    what.add_argument(
        "--resume", action="store_true", help="continue an interrupted sweep"
    )
    what.add_argument(
        "--compare",
        nargs=2,
        type=Path,
        metavar=("A", "B"),
        help="compare two finished sweeps of the same machines, pair by pair",
    )
    parser.add_argument(
        "--mixed",
        action="store_true",
        help="accept workers on computers whose results differ in the last bits",
    )
    parser.add_argument(
        "--junit", type=Path, metavar="FILE", help="also write a test report"
    )


def run(args: argparse.Namespace) -> int:
    """Sweep; return 0 however many pass."""
    if args.compare is not None:
        print(compare(*(read_table(folder) for folder in args.compare)))
        return EXIT_DONE
    if args.sweep is None:
        raise UsageError("name a sweep, or two finished ones with --compare")
    if args.out is None and not args.dry_run:
        raise UsageError("name a folder for the results with -o")
    if args.out is not None and args.out.exists() and not args.out.is_dir():
        raise FailedError(f"{args.out}: is a file; name a folder for the results")
    setup_logging("ERROR")
    with Progress(lambda: "stopped before any machine had finished"):
        prepared = prepare(args.sweep, args.config)
        if args.only is not None:
            return _only(prepared, args.only, args.out)
        # compiles once and reports mistakes before any worker
        rig = rig_for(prepared.job)
        if args.dry_run:
            began_s = time.monotonic()
            outcome = rig.drive(prepared.machine(0))
            print(plan(prepared, outcome, time.monotonic() - began_s, args.workers))
            return EXIT_DONE
    table = _sweep(prepared, args)
    print(f"{headline(table)}; {details(table)}")
    print(f"The report is {args.out / 'report.html'}")
    return EXIT_DONE


def _only(prepared: PreparedSweep, index: int, out: Path) -> int:
    if not 0 <= index < prepared.sweep.machines:
        raise UsageError(
            f"--only {index}: machines are 0 .. {prepared.sweep.machines - 1}"
        )
    folder = out / f"machine-{index}"
    outcome = drive_again(prepared, index, folder)
    names = (requirement.name for requirement in prepared.sweep.require)
    for name, margin in zip(names, outcome.margins, strict=False):
        print(f"{'met' if margin >= 0.0 else 'NOT MET':8}{margin:12.6g}  {name}")
    if outcome.error:
        print(f"NOT MET: {outcome.error}")
    print(
        f"recorded; to run it again: hilserver run -c {folder / 'config.yaml'}"
        f" --scenario {folder / 'scenario.yaml'}"
    )
    return EXIT_DONE


def _sweep(prepared: PreparedSweep, args: argparse.Namespace) -> MachineTable:
    indices = range(prepared.sweep.machines)
    journal = SweepJournal(args.out, prepared.job.key, resume=args.resume)

    def stopped() -> str:
        return f"stopped after {len(journal.done)} of {len(indices)} machines; go on with --resume"

    with Progress(stopped) as progress:
        with closing(journal):
            _drive(prepared, journal, args, progress)
        table = table_of(prepared, journal, indices)
        write_table(args.out, table)
        write_report(args.out, table)
    if args.junit is not None:
        write_junit(args.junit, table)
    return table


def _drive(
    prepared: PreparedSweep,
    journal: SweepJournal,
    args: argparse.Namespace,
    progress: Progress,
) -> None:
    job = prepared.job
    n = prepared.sweep.machines
    left = (index for index in range(n) if index not in journal.done)
    began_s = time.monotonic()
    before = len(journal.done)
    if before >= n:
        return
    memory_mb = job.sweep.limits.memory_mb
    with (
        DaskWorkers(args.dask)
        if args.dask
        else LocalWorkers(args.workers, memory_mb) as workers
    ):
        found = outcomes(job, map(prepared.machine, left), workers, mixed=args.mixed)
        for computer, batch in found:
            journal.add(batch, computer)
            done = len(journal.done)
            passed_s = time.monotonic() - began_s
            a_minute = 60.0 * (done - before) / max(passed_s, 1e-3)
            rest_s = 60.0 * (n - done) / max(a_minute, 1e-3)
            text = (
                f"{done} of {n} machines, {a_minute:.0f} a minute, {rest_s:.0f} s left"
            )
            progress(text, done / n)
