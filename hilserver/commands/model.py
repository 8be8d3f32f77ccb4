"""Write the robot as a file for other programs: URDF for RViz and Foxglove, MJCF for MuJoCo."""

import argparse

from hilserver.body.export import robot_mjcf, robot_urdf
from hilserver.commands.options import add_config, config_path, out_file, write_text
from hilserver.config.plant import check_apart
from hilserver.daemon.assembly import assemble
from hilserver.errors import EXIT_DONE

EXAMPLE = "hilserver model --format urdf -o robot.urdf"
_FORMATS = {"urdf": robot_urdf, "mjcf": robot_mjcf}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``-c``, ``--format`` and ``-o``."""
    add_config(parser)
    parser.add_argument("--format", choices=_FORMATS, required=True, help="file format")
    parser.add_argument(
        "-o", "--out", type=out_file, metavar="FILE", help="default: print it"
    )


def run(args: argparse.Namespace) -> int:
    """Write the robot of a configuration; needs no extra."""
    assembly = assemble(config_path(args))
    if args.format == "mjcf":  # its wheels touch what they meet
        check_apart(assembly.robot)
    text = _FORMATS[args.format](assembly.body)
    if args.out is None:
        print(text, end="")
    else:
        write_text(args.out, text)
    return EXIT_DONE
