"""The operator page in the browser. `hilserver run` starts it; by hand it shows a running daemon.

Started by hand it lacks the secret that `hilserver run` hands over: its users then write as any
OPC UA client does.
"""

import argparse
import asyncio
import logging
import os
import socket
import sys

from hilserver.commands.options import add_config, add_image, add_patch, known_image
from hilserver.errors import EXIT_DONE
from hilserver.io.page.listening import listen, moved, url_of
from hilserver.io.page.server import PageServer
from hilserver.io.page.setup import Setup
from hilserver.program import event_loop
from hilserver.program.giving_back import give_back_code
from hilserver.tasks import first_of

EXAMPLE = "hilserver page -c config.yaml"
NICENESS = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    add_config(parser)
    add_image(parser)
    add_patch(parser)  # the one that the daemon runs with
    parser.add_argument("--beside", type=int, metavar="FD", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Serve until stopped, or until the daemon that started us has ended."""
    if args.beside is not None:
        setup = Setup.from_json(sys.stdin.readline())
        listener = socket.socket(fileno=args.beside)
    else:
        # A page that the daemon starts needs none of this.
        from hilserver.commands.page_setup import page_setup  # noqa: PLC0415
        from hilserver.commands.patching import assembled  # noqa: PLC0415
        from hilserver.commands.validation import check_page  # noqa: PLC0415

        assembly = assembled(args)
        check_page(assembly)
        image = args.image
        if image is None:
            image = known_image(assembly.config.image.name)
        setup = page_setup(assembly, image, assembly.config.opcua.endpoint)
        page = setup.page
        listener = listen(page.host, page.port)
        url = url_of(listener, page.host, is_encrypted=bool(page.certificate))
        logging.basicConfig(format="%(message)s")
        logging.getLogger("hilserver").setLevel(logging.INFO)
        why = moved(listener, page.port)
        where = f"operator page: {url} ({why})" if why else f"operator page: {url}"
        print(where, file=sys.stderr, flush=True)
    os.nice(NICENESS)
    server = PageServer(setup)
    give_back_code()
    return event_loop.run(
        _serve(server, listener, until_stdin_ends=args.beside is not None)
    )


async def _serve(
    server: PageServer, listener: socket.socket, *, until_stdin_ends: bool
) -> int:
    asked = event_loop.end_event()
    waiting = [server.run(listener), asked.wait()]
    if until_stdin_ends:
        waiting.append(_stdin_ends())
    await first_of(*waiting)
    return EXIT_DONE


async def _stdin_ends() -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()

    def look() -> None:
        if not os.read(sys.stdin.fileno(), 4096):
            loop.remove_reader(sys.stdin.fileno())
            ended.set()

    loop.add_reader(sys.stdin.fileno(), look)
    await ended.wait()
