"""Write a log in another format, without loss: CSV, MCAP, MF4, ROS 2 bag, Parquet.

The suffix of OUT chooses: .csv, .mcap, .mf4, .parquet; without a suffix (or with --bag) it is the
folder of a bag. Signals keep every bit; EduArt's topics in a bag are float32, as on the real robot.
CSV and Parquet hold no status codes, Parquet no run to replay.

With --format, only the poses of the log are written, measured and estimated: TUM or KITTI files for
evo, or a bag of nav_msgs/Odometry; OUT is a new folder.
"""

import argparse
from pathlib import Path

from hilserver.commands.options import add_mapping, add_storage, warn
from hilserver.errors import EXIT_DONE, FailedError, LogError, UsageError, reason
from hilserver.exchange.trajectories import WRITERS, on_common_times, trajectories_of
from hilserver.logs import Log
from hilserver.logs.bag_writer import Storage
from hilserver.logs.mf4 import write_mf4
from hilserver.logs.writing import forget, write_log
from hilserver.measured.conversion import read_any, write_parquet
from hilserver.measured.names import signal_unit

EXAMPLE = "hilserver convert run.mcap run_bag"
SUFFIXES = (".csv", ".mcap", ".mf4", ".parquet")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    readable = f"log: {', '.join(SUFFIXES)}, or a bag"
    parser.add_argument("log", type=Path, metavar="IN", help=readable)
    parser.add_argument("out", type=Path, metavar="OUT", help="file or bag to write")
    add_mapping(parser)
    parser.add_argument(
        "--bag", action="store_true", help="write a bag, whatever OUT is called"
    )
    add_storage(parser)
    parser.add_argument(
        "--format",
        choices=tuple(WRITERS),
        help="write the poses alone, as trajectories: TUM or KITTI files, or a bag of odometry",
    )


def run(args: argparse.Namespace) -> int:
    """Convert; 0, or 2 when IN cannot be read."""
    is_bag = args.bag or args.out.suffix == ""
    if args.format and args.bag:
        raise UsageError("--bag writes all signals, --format the poses: choose one")
    if args.format and args.out.suffix:
        raise UsageError(
            f"{args.out}: will be a folder with a file for each pose; choose a name without suffix"
        )
    if not args.format and not is_bag and args.out.suffix not in SUFFIXES:
        raise UsageError(
            f"{args.out}: end the name in {', '.join(SUFFIXES)}, or in no suffix for a bag"
        )
    if args.out.exists():
        raise FailedError(f"{args.out}: already exists; choose another name")
    log = read_any(args.log, args.mapping)
    warn(*log.notices)
    if not len(log):
        raise LogError(f"{args.log}: contains no rows; there is nothing to convert")
    trajectories = trajectories_of(log) if args.format else []
    if args.format == "kitti":
        trajectories = on_common_times(trajectories)
    try:
        if args.format:
            WRITERS[args.format](trajectories, args.out, args.storage)
        else:
            _write(log, args.out, args.storage if is_bag else None)
    except BaseException as error:  # a signal, too, leaves no half of a file
        forget(args.out)
        if isinstance(error, OSError):
            raise FailedError(
                f"{args.out}: cannot be written: {reason(error)}"
            ) from None
        raise
    if not args.format:
        print(f"{len(log)} rows of {len(log.columns)} signals in {args.out}")
        return EXIT_DONE
    for one in trajectories:
        without = "" if one.has_yaw else ", without a heading: compare its places alone"
        print(f"{one.name}, segment {one.segment}: {len(one.t_s)} poses{without}")
    return EXIT_DONE


def _write(log: Log, out: Path, bag: Storage | None) -> None:
    if out.suffix == ".parquet" and bag is None:
        write_parquet(log, out)
        return
    if out.suffix == ".mf4" and bag is None:
        write_mf4(log, out, signal_unit)
        return
    write_log(log, out, bag)
