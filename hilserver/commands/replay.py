"""Feed the inputs of a log through the plant, faster than real time, and write what comes out.

A recording of ours is reproduced bit for bit, from its first state on or from a snapshot. From a
log of others the set-points are taken; each holds until the next row.
"""

import argparse
import asyncio
import time
from contextlib import closing
from pathlib import Path
from typing import Final

from hilserver.commands.judging import DriveJudge
from hilserver.commands.options import (
    add_config,
    add_mapping,
    add_out,
    add_patch,
    number,
    warn,
)
from hilserver.commands.patching import assembled, patch_of
from hilserver.core.snapshot import read_snapshot
from hilserver.daemon.assembly import Assembly
from hilserver.errors import (
    EXIT_DONE,
    EXIT_FAILED,
    ConfigError,
    FailedError,
    LogError,
    UsageError,
    UserError,
    reason,
)
from hilserver.logs import Log, RecordedState, open_writer, read_log
from hilserver.logs.provenance import make_run
from hilserver.logs.writing import check_suffix
from hilserver.program.progress import Progress
from hilserver.replay import (
    Comparison,
    Engine,
    Plan,
    assembly_of,
    plan_exact,
    plan_inputs,
)
from hilserver.replay.origin import mapped_inputs

LONGEST_S: Final = 86_400.0
EXAMPLE = "hilserver replay run.mcap -o again.csv"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "log", type=Path, metavar="LOG", help="log to replay: .mcap, .csv, or a bag"
    )
    add_out(parser, "OUT", "file for all signals of the replay, .mcap or .csv")
    add_config(parser)
    add_patch(parser)
    add_mapping(parser)
    parser.add_argument(
        "--from",
        dest="start",
        type=Path,
        metavar="SNAPSHOT",
        help="start from this snapshot (.npz) of the recorded run",
    )
    parser.add_argument(
        "--as-inputs",
        action="store_true",
        help="use only the set-points of a recording, from a fresh start, as with a foreign log",
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="exit with code 1 if the outputs differ from those in the log by a single bit",
    )
    parser.add_argument(
        "--require",
        type=Path,
        metavar="FILE",
        help="requirements that the drive must meet, as in a sweep; exit code 1 if it does not",
    )
    parser.add_argument(
        "--between",
        type=number(0.0, LONGEST_S, f"time (0 .. {LONGEST_S:g} s)"),
        nargs=2,
        metavar="S",
        help="with --require: judge only from the first to the second simulated time [s]",
    )


AS_INPUTS: Final = {
    "as_inputs": True,
    "check": False,
    "start": None,
    "between": None,
}
"""Options of a replay of set-points alone."""


def run(args: argparse.Namespace) -> int:
    """Replay; return 0, or 1 if ``--check`` finds a difference."""
    check_suffix(args.out)
    if args.between is not None and args.require is None:
        raise UsageError("--between says what --require judges: give a file with it")
    if args.out.exists() and args.log.exists() and args.out.samefile(args.log):
        raise UsageError(
            f"{args.out}: is the log itself; choose another file for the replay"
        )
    log, assembly = _open(args)
    return asyncio.run(_Replay(args, log, assembly).run())


def _open(args: argparse.Namespace) -> tuple[Log, Assembly]:
    """Read the log and build the plant: from -c, else from the log, else by default."""
    if args.mapping is not None or args.log.is_dir() or args.log.suffix == ".db3":
        return mapped_inputs(args.log, args.mapping, assembled(args))
    if args.config is not None:
        assembly = assembled(args)
        return read_log(args.log, _names(assembly)), assembly
    log = read_log(args.log)
    if log.is_ours:
        return log, assembly_of(log, patch_of(args))
    assembly = assembled(args)
    return read_log(args.log, _names(assembly)), assembly


def _names(assembly: Assembly) -> list[str]:
    return [signal.name for signal in assembly.table.scalars]


class _Replay:
    """One replay from start to end."""

    def __init__(self, args: argparse.Namespace, log: Log, assembly: Assembly) -> None:
        self._args = args
        self._log = log
        self._assembly = assembly
        self._exact = log.is_ours and not args.as_inputs
        between_s = tuple(args.between or (0.0, LONGEST_S))
        if args.require is None:
            self._judge = None
        else:
            self._judge = DriveJudge(assembly, args.require, between_s)
        if args.start is not None and not self._exact:
            raise LogError(
                f"{log.path}: a snapshot only fits a recording of the same run"
            )

    async def run(self) -> int:
        async with Engine(self._assembly) as engine:
            plan = self._plan(engine)
            warn(*self._log.notices, *plan.notices)
            comparison = Comparison(
                self._log, engine.table, self._assembly.base_period_ns
            )
            try:
                seconds = await self._play(
                    engine, plan, comparison if self._exact else None
                )
            except OSError as error:
                raise FailedError(
                    f"{self._args.out}: replay ended: {reason(error)}"
                ) from None
        simulated = plan.n_ticks * self._assembly.base_period_ns * 1e-9
        print(
            f"replayed {plan.n_ticks} ticks ({simulated:.3f} s) in {seconds:.2f} s into"
            f" {self._args.out}"
        )
        code = self._tell(comparison)
        is_met = self._judge is None or self._judge.passed()
        return code if is_met else EXIT_FAILED

    def _plan(self, engine: Engine) -> Plan:
        log = self._log
        assembly = self._assembly
        if not self._exact:
            return plan_inputs(log, engine.table, assembly.base_period_ns)
        for why in (log.run or {}).get("not_replayable", ()):
            raise LogError(
                f"{log.path}: is not replayable: {why}; replay its set-points with --as-inputs"
            )
        # A recording's states contain the parameters of its run.
        recorded = (self._log.run or {}).get("patch") or {}
        named = self._assembly.patch
        if (
            self._args.patch is not None
            and named
            and named.sha256 != recorded.get("sha256")
        ):
            raise ConfigError(
                f"{self._log.path}: was recorded with {'another' if recorded else 'no'} patch;"
                " leave --patch out, or replay its set-points with --as-inputs"
            )
        identity = (log.run or {}).get("identity", {})
        start = None if self._args.start is None else self._snapshot(engine)
        for state in (start,) if start is not None else log.states:
            engine.check(str(log.path), identity, state.words)
        return plan_exact(
            log, engine.table, engine.image.layout, assembly.base_period_ns, start
        )

    def _snapshot(self, engine: Engine) -> RecordedState:
        path = self._args.start
        try:
            words, meta = read_snapshot(path)
        except UserError as error:
            raise LogError(f"{path}: {error}") from None
        engine.check(str(path), meta["identity"], words)
        return RecordedState(0, int(meta["tick"]), words)

    async def _play(
        self, engine: Engine, plan: Plan, comparison: Comparison | None
    ) -> float:
        run = make_run(engine.image.description) | {"replay_of": str(self._log.path)}
        writer = open_writer(self._args.out, run, range(engine.table.n_slots))
        done, began_s = 0, time.monotonic()
        engine.feed_state(in_rows=plan.feeds_state)

        def stopped() -> str:
            return f"stopped after {done} of {plan.n_ticks} ticks: {self._args.out} ends there"

        with closing(writer), Progress(stopped) as progress:
            for stretch in plan.stretches:
                writer.add_state(engine.start_of(stretch))
                async for batch in engine.play(stretch):
                    writer.write(batch)
                    if comparison is not None:
                        comparison.add(batch)
                    if self._judge is not None:
                        self._judge.add(batch)
                    done += len(batch.frames)
                    progress("replaying", done / plan.n_ticks)
        return time.monotonic() - began_s

    def _tell(self, comparison: Comparison) -> int:
        if comparison.difference is not None:
            print(f"the outputs differ, first {comparison.difference}")
            return EXIT_FAILED if self._args.check else EXIT_DONE
        if comparison.n_ticks:
            print(
                f"all {comparison.n_signals} recorded outputs of {comparison.n_ticks} ticks are"
                " equal, bit for bit"
            )
        elif self._args.check:
            raise LogError(
                f"{self._log.path}: contains no outputs of hilserver to compare with"
            )
        return EXIT_DONE
