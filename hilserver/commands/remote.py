"""One request to a running daemon over OPC UA, for ``call``, ``set`` and ``inject``."""

import argparse
import getpass
import json
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from hilserver.commands.options import add_config, config_path
from hilserver.errors import EXIT_DONE, FailedError, UsageError
from hilserver.io.opcua_server.model import SHELL
from hilserver.io.page.hand import Hand, RefusedError
from hilserver.io.page.setup import OpcUaAccess
from hilserver.program import event_loop
from hilserver.signals import Ranges, ValueType, robot_table
from hilserver.time_limit import time_limit

_WITHIN_S = 20.0
PARAMETERS = "parameters."  # prefix of parameter names over OPC UA


def add_connection(parser: argparse.ArgumentParser) -> None:
    """Add ``-c``, ``--endpoint`` and ``--user``."""
    add_config(parser)
    parser.add_argument(
        "--endpoint",
        metavar="URL",
        help="OPC UA server; default: that of the configuration",
    )
    parser.add_argument(
        "--user", default="", metavar="NAME", help="log in; asks for the password"
    )


def from_json(text: str) -> Any:
    """Return the JSON value of an argument; a plain word stands for itself."""
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        if text[:1] in tuple('{["'):
            raise UsageError(
                f"{text:.80}: is not JSON; put it in single quotes"
            ) from None
        return text


def ask(
    args: argparse.Namespace,
    request: Callable[[Hand], Awaitable[None]],
    parameters: Iterable[str] = (),
) -> int:
    """Connect, do `request`, disconnect; return 0, or FailedError with the daemon's sentence."""
    endpoint = args.endpoint or configured(args)
    password = getpass.getpass() if args.user else ""
    return event_loop.run(_ask(endpoint, args.user, password, request, parameters))


async def _ask(
    endpoint: str,
    user: str,
    password: str,
    request: Callable[[Hand], Awaitable[None]],
    parameters: Iterable[str],
) -> int:
    types = {
        signal.name: signal.type.value for signal in robot_table(Ranges(1.0, 1.0, 1.0))
    }
    types |= dict.fromkeys(parameters, ValueType.DOUBLE.value)
    hand = Hand(OpcUaAccess(endpoint, SHELL), types)
    try:
        async with time_limit(_WITHIN_S):
            await hand.connect(user, password)
            await request(hand)
    except RefusedError as error:
        raise FailedError(f"{endpoint}: {error}") from None
    finally:
        await hand.close()
    return EXIT_DONE


def configured(args: argparse.Namespace) -> str:
    """Return the endpoint of the configuration."""
    from hilserver.config.root import load_config  # noqa: PLC0415 - slow to import

    return load_config(config_path(args)).opcua.endpoint
