"""Load test kit and injector from this tree, whatever the installed package brings along."""

import gc
import logging
import os
import sys
from importlib.metadata import entry_points
from pathlib import Path

import hypothesis
import pytest
import structlog

from hilserver.program.shared_memory import path_of

ROOT = Path(__file__).parent
sys.path.insert(0, str(ROOT / "tests" / "injector"))

# Recordings of real machines are no part of the project; they may lie beside the checkout.
RECORDINGS = ROOT.parent / "shared" / "data"
if RECORDINGS.is_dir():
    os.environ.setdefault("HIL_DATA_DIR", str(RECORDINGS))

# How long a busy computer takes for an example says nothing about the code. The same examples every
# time, so that a run fails for its change alone; make test-long looks for new ones.
hypothesis.settings.register_profile("same", deadline=None, derandomize=True)
hypothesis.settings.register_profile("fresh", deadline=None, print_blob=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

_INSTALLED = any(point.name == "hilserver" for point in entry_points(group="pytest11"))
pytest_plugins = (
    ["pytester"] if _INSTALLED else ["pytester", "hilserver.testing.plugin"]
)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Keep the tests of the page in one process: they share a daemon and a browser."""
    from xdist.scheduler import LoadFileScheduling  # noqa: PLC0415 - where it is in use

    class OnePage(LoadFileScheduling):
        def _split_scope(self, nodeid):
            file = super()._split_scope(nodeid)
            return "tests/page" if file.startswith("tests/page/") else file

    return OnePage(config, log) if config.getoption("dist") == "loadfile" else None


@pytest.hookimpl(trylast=True)
def pytest_collection_finish():
    """Hide from the garbage collector what collecting has made: it stays to the end.

    With all tests collected, a full collection takes half a second in which no event loop of a test
    turns: robots went into their safe state, and servers refused what had used up its time.
    """
    gc.collect()
    gc.freeze()


def pytest_unconfigure():
    """Remove the images that tests of this process have left in shared memory."""
    left = path_of(f"test-{os.getpid()}-")
    for image in left.parent.glob(f"{left.name}*"):
        image.unlink()


@pytest.fixture(autouse=True)
def _process_as_before():
    """Forget the logging that a command set up here; let none leave its priority to the others."""
    priority = os.nice(0)
    loggers = logging.getLogger(), logging.getLogger("hilserver")
    before = [(logger, logger.level, logger.handlers[:]) for logger in loggers]
    yield
    structlog.reset_defaults()
    for logger, level, handlers in before:
        logger.setLevel(level)
        for handler in set(logger.handlers).difference(handlers):
            logger.removeHandler(handler)
    assert os.nice(0) == priority, "the test changed the priority of all tests after it"
