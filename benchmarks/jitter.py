"""`bench jitter` with other tasks of the daemon: page, body, ROS 2, shield, observer.

Each is a section of the configuration; for a link, a program at its other end keeps it busy.
"""

import argparse
import contextlib
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from typing import IO, Any, Final

from benchmarks.ros2_peers import arguments, build_fast_dds, published
from hilserver.bench import jitter
from hilserver.bench.jitter_subjects import Companion, Place
from hilserver.errors import FailedError
from hilserver.program.children import piped, python
from hilserver.ros.flavours import RPM
from hilserver.ros.types import known_types

run = jitter.run
BROWSERS: Final = 3
DOMAIN: Final = 102
RATE_HZ: Final = 50
LONGEST_S: Final = 3600
ON: Final = {"enabled": True}
START_WITHIN_S: Final = 60.0


def _shield(place: Place) -> dict[str, Any]:
    return {"enabled": True, "link": str(place.folder / "shield")}


def _ros2(_: Place) -> dict[str, Any]:
    extras = {"tf": True, "clock": True, "odom": True, "pose_stamped": True}
    return {"enabled": True, "domain": DOMAIN, "publish": extras}


def _computed(section: str, settings: Mapping[str, Any], words: str) -> Companion:
    """Return a companion without another end."""
    return Companion(
        section, lambda _: settings, lambda _: contextlib.nullcontext(words)
    )


@contextlib.contextmanager
def _browsers(place: Place) -> Iterator[str]:
    url = f"http://127.0.0.1:{place.port}/"
    _wait_for(lambda: _is_open(place.port), "the page")
    command = python("-m", "benchmarks.page_clients", url, str(BROWSERS))
    with piped(command, name="the browsers") as process:
        _say(process.stdin, "connect\n")
        if process.stdout is None or not process.stdout.readline():
            raise FailedError("the clients of the page have failed")
        yield f"{BROWSERS} clients of the page"


@contextlib.contextmanager
def _host(place: Place) -> Iterator[str]:
    line = place.folder / "shield"
    _wait_for(line.exists, "the shield")
    words = ("-m", "benchmarks.shield_host", str(line), str(RATE_HZ), str(LONGEST_S))
    with piped(python(*words), name="the shield's host") as process:
        yield f"a host on the serial line at {RATE_HZ} Hz"
        _still(process, "the shield's host")


@contextlib.contextmanager
def _peer(place: Place) -> Iterator[str]:
    program = build_fast_dds(place.folder)
    topics = [("r", topic, kind, quality) for topic, kind, quality in published()]
    endpoints = [("w", "rt/iotbot/rpm", RPM, "reliable"), *topics]
    command = [str(program), *arguments(DOMAIN, endpoints)]
    types = known_types()
    wheels = ("front_left_rpm", "front_right_rpm", "rear_left_rpm", "rear_right_rpm")
    cdr = types.encode(types.make(RPM, **dict.fromkeys(wheels, 20.0)))
    with piped(command, name="the ROS 2 host", stdout=subprocess.DEVNULL) as process:
        _say(
            process.stdin,
            f"0 {cdr.hex()} {LONGEST_S * RATE_HZ} {1_000_000 // RATE_HZ}\n",
        )
        yield f"a ROS 2 host that reads {len(topics)} topics and commands at {RATE_HZ} Hz"
        _still(process, "the ROS 2 host")


COMPANY: Final[Mapping[str, Companion]] = {
    "page": Companion("page", lambda place: {"port": place.port}, _browsers),
    "body": _computed("mechatronic", ON, "the mechatronic model"),
    "nav": _computed("sensors", {"nav": ON}, "a navigation"),
    "observer": _computed("observer", ON, "the observer"),
    "ros2": Companion("ros2", _ros2, _peer),
    "shield": Companion("shield", _shield, _host),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the bench, and the companions of the daemon."""
    jitter.add_arguments(parser)
    parser.add_argument(
        "--with",
        dest="beside",
        type=chosen,
        default=(),
        metavar="NAMES",
        help=f"what the daemon serves besides, of {','.join(COMPANY)}; it is also measured without",
    )


def chosen(text: str) -> tuple[Companion, ...]:
    """Return the companions named in a text such as ``page,ros2``.

    Raises
    ------
    argparse.ArgumentTypeError
        If a name is unknown.
    """
    names = tuple(dict.fromkeys(name for name in text.split(",") if name))
    if unknown := [name for name in names if name not in COMPANY]:
        raise argparse.ArgumentTypeError(
            f"'{unknown[0]}' is none of {', '.join(COMPANY)}"
        )
    return tuple(COMPANY[name] for name in names)


def _say(pipe: IO[str] | None, text: str) -> None:
    if pipe is not None:
        pipe.write(text)
        pipe.flush()


def _still(process: "subprocess.Popen[str]", name: str) -> None:
    """Fail if the load was not there until the end."""
    if process.poll() is not None:
        raise FailedError(
            f"{name} has ended with code {process.returncode}: the load was not there"
        )


def _is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _wait_for(condition: Callable[[], bool], name: str) -> None:
    deadline_s = time.monotonic() + START_WITHIN_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise FailedError(
                f"{name} of the daemon did not start within {START_WITHIN_S:.0f} s"
            )
        time.sleep(0.05)
