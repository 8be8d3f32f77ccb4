"""Write the robot as an FMU for co-simulation: FMI 3.0 or 2.0, without Python on the target."""

import argparse

from hilserver.commands.options import add_config, add_patch, out_file
from hilserver.commands.patching import assembled
from hilserver.errors import EXIT_DONE
from hilserver.fmu.export import COMPILERS, export

EXAMPLE = "hilserver fmu -c config.yaml --patch model_patch.yaml -o robot.fmu"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_config(parser)
    add_patch(parser)
    parser.add_argument(
        "-o", "--out", type=out_file, required=True, metavar="FILE", help="FMU to write"
    )
    parser.add_argument(
        "--fmi", type=int, choices=(3, 2), default=3, help="version; default: 3"
    )
    parser.add_argument(
        "--platforms",
        default="x86_64-linux",
        metavar="LIST",
        help=f"comma-separated, out of {', '.join(COMPILERS)}; none: only the sources; default:"
        f" x86_64-linux",
    )


def run(args: argparse.Namespace) -> int:
    """Export the FMU; print its contents."""
    assembly = assembled(args)
    named = [] if args.platforms == "none" else args.platforms.split(",")
    platforms = [name.strip() for name in named if name.strip()]
    robot = assembly.composition, assembly.robot, assembly.base_period_ns
    export(args.out, *robot, args.fmi, platforms)
    step_ms = assembly.base_period_ns * 1e-6
    made_for = ", ".join(platforms) or "any compiler"
    print(f"wrote {args.out}: FMI {args.fmi}.0 for {made_for}, step {step_ms:g} ms")
    return EXIT_DONE
