"""Run the embedded controller: ``python -m hilserver.controller --endpoint opc.tcp://...``."""

import argparse
import sys

from hilserver.controller.loop import FigureOfEight
from hilserver.controller.path import Eight, Robot
from hilserver.controller.server import ControllerServer
from hilserver.errors import EXIT_DONE
from hilserver.program import event_loop, harness
from hilserver.tasks import first_of

ENDPOINT = "opc.tcp://127.0.0.1:53880/UA/NodeRedAgv"


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    robot = Robot()
    eight = Eight()
    parser = argparse.ArgumentParser(
        prog="python -m hilserver.controller",
        description="Drives a figure of eight over OPC UA, in place of the IOT2050.",
        epilog=f"example: python -m hilserver.controller --endpoint {ENDPOINT}",
    )
    parser.add_argument(
        "--endpoint", default=ENDPOINT, help="address to serve (%(default)s)"
    )
    parser.add_argument("--wheel-radius-m", type=float, default=robot.wheel_radius_m)
    parser.add_argument("--k-om-per-m", type=float, default=robot.k_om_per_m)
    parser.add_argument("--yaw-sign", type=int, choices=(-1, 1), default=robot.yaw_sign)
    parser.add_argument("--max-rpm", type=float, default=robot.max_rpm)
    parser.add_argument("--speed-m-s", type=float, default=eight.speed_m_s)
    parser.add_argument(
        "--pattern",
        choices=("eight", "wheels"),
        default="eight",
        help="a figure of eight, or each wheel alone for 'hilserver wiring' (%(default)s)",
    )
    return parser.parse_args(argv)


async def serve(args: argparse.Namespace) -> int:
    """Serve and drive until SIGINT or SIGTERM."""
    robot = Robot(args.wheel_radius_m, args.k_om_per_m, args.yaw_sign, args.max_rpm)
    async with ControllerServer(args.endpoint) as server:
        controller = FigureOfEight(
            server, Eight(speed_m_s=args.speed_m_s), robot, pattern=args.pattern
        )
        asked = event_loop.end_event()
        print(f"controller listening on {server.endpoint}", flush=True)
        await first_of(controller.run(), asked.wait())
    return EXIT_DONE


def main() -> int:
    """Run and return the exit code."""
    return event_loop.run(serve(arguments()))


if __name__ == "__main__":
    sys.exit(harness.run(main))
