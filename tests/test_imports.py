"""What a process does not need it does not carry."""

import subprocess
import sys

import pytest

LOADED = "import sys, hilserver.commands.{}; print(*{} & sys.modules.keys())"
COMPILER = {"numba", "scipy"}


@pytest.mark.parametrize(
    ("command", "without"),
    [
        ("page", COMPILER | {"pydantic", "structlog", "yaml"}),
        *((command, COMPILER) for command in ("call", "set", "inject", "teleop")),
    ],
)
def test_commands_that_only_watch_or_ask_carry_little(command, without):
    words = [sys.executable, "-c", LOADED.format(command, without)]
    assert (
        subprocess.run(words, capture_output=True, text=True, check=True).stdout == "\n"
    )


CALLS_IT = """
import sys, numba, numpy
import hilserver.daemon.daemon
print(*{"scipy.linalg", "unittest", "numpy.f2py"} & sys.modules.keys())
print(numba.njit(lambda a: numpy.linalg.solve(a, a @ a))(2.0 * numpy.eye(2)).tolist())
"""


def test_the_daemon_carries_no_linear_algebra_until_it_is_called():
    words = [sys.executable, "-c", CALLS_IT]
    shown = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert shown.splitlines() == ["", "[[2.0, 0.0], [0.0, 2.0]]"]


def test_what_comes_from_the_cache_needs_no_knowledge_of_types():
    parts = {"numba.np.arrayobj", "numba.cpython.unicode", "cffi"}
    loaded = (
        f"import sys, hilserver.daemon.daemon; print(*{parts} & sys.modules.keys())"
    )
    words = [sys.executable, "-c", loaded]
    for _ in range(2):  # the first one may have to compile
        shown = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert shown == "\n"


def test_a_run_carries_what_its_configuration_asks_for():
    rooms = {
        "hilserver.fmu.calls",
        "hilserver.fmu.exchange",
        "hilserver.io.edge.credentials",
        "hilserver.io.opcua_client",
        "hilserver.io.recorder.recorder",
        "hilserver.io.shield.answer",
        "hilserver.logs.reading",
        "mcap",
    }
    loaded = (
        f"import sys, hilserver.commands.running; print(*{rooms} & sys.modules.keys())"
    )
    words = [sys.executable, "-c", loaded]
    assert (
        subprocess.run(words, capture_output=True, text=True, check=True).stdout == "\n"
    )
