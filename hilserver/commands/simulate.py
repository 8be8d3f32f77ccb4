"""Play a scenario in virtual time and write every signal to a file: no daemon, no sockets.

Takes what 'hilserver run --scenario' and 'hilserver plan' take: a scenario with its faults, or a
log of set-points. The same input gives the same bits every time, as fast as the computer allows.
"""

import argparse
import asyncio
from pathlib import Path

from hilserver.commands import replay
from hilserver.commands.judging import DriveJudge
from hilserver.commands.options import (
    add_config,
    add_mapping,
    add_out,
    add_patch,
    number,
)
from hilserver.commands.patching import assembled
from hilserver.daemon.assembly import Assembly
from hilserver.errors import EXIT_DONE, EXIT_FAILED, FailedError, UsageError, reason
from hilserver.faults.scenario import Play, load_scenario
from hilserver.logs.writing import check_suffix
from hilserver.monitoring.logging_setup import setup_logging
from hilserver.program.progress import Progress
from hilserver.replay.simulation import Simulation

EXAMPLE = "hilserver simulate drive.yaml -o drive.mcap"
SCENARIOS = (".yaml", ".yml")
LONGEST_S = 86_400.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "scenario",
        type=Path,
        metavar="SCENARIO",
        help="scenario (.yaml), or log of set-points",
    )
    add_out(parser, "OUT", "file for all signals, .mcap or .csv")
    add_config(parser)
    add_patch(parser)
    add_mapping(parser)
    parser.add_argument(
        "--duration",
        type=number(1e-3, LONGEST_S, "duration (0.001 .. 86400 s)"),
        metavar="S",
        help="simulated time; default: until 1 s after the last step or fault, or that of the log",
    )
    parser.add_argument(
        "--require",
        type=Path,
        metavar="FILE",
        help="requirements that the drive must meet, as in a sweep; exit code 1 if it does not",
    )


def run(args: argparse.Namespace) -> int:
    """Simulate; return 0, or 1 if a requirement is not met."""
    if args.scenario.suffix not in SCENARIOS:
        if args.duration is not None:
            raise UsageError("--duration is for a scenario; a log has its own length")
        if args.require is not None:
            raise UsageError("--require needs a scenario; it does not judge logs")
        return replay.run(
            argparse.Namespace(**vars(args), **replay.AS_INPUTS, log=args.scenario)
        )
    check_suffix(args.out)
    play = Play(load_scenario(args.scenario), args.scenario)
    assembly = assembled(args)
    verdict = None if args.require is None else DriveJudge(assembly, args.require)
    setup_logging("ERROR")
    try:
        lasts_s = args.duration or play.scenario.lasts_s
        asyncio.run(
            _play(
                assembly,
                play,
                lasts_s,
                args.out,
                verdict,
            )
        )
    except OSError as error:
        raise FailedError(f"{args.out}: simulation ended: {reason(error)}") from None
    return EXIT_DONE if verdict is None or verdict.passed() else EXIT_FAILED


async def _play(
    assembly: Assembly,
    play: Play,
    duration_s: float,
    out: Path,
    verdict: DriveJudge | None,
) -> None:
    period_s = assembly.base_period_ns * 1e-9
    n_ticks = max(round(duration_s / period_s), 1)
    done = 0

    def stopped() -> str:
        return f"stopped after {done} of {n_ticks} ticks: {out} ends there"

    async with Simulation(assembly, play) as simulation:
        with simulation.log(out) as writer, Progress(stopped) as progress:
            async for batch in simulation.frames(n_ticks):
                writer.write(batch)
                if verdict is not None:
                    verdict.add(batch)
                done += len(batch.frames)
                progress("simulating", done / n_ticks)
    print(f"simulated {n_ticks} ticks ({n_ticks * period_s:.3f} s) into {out}")
