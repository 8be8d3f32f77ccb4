"""The pytest plug-in: fixture `hil`, async generator tests, requirements, files of failed tests.

Projects that do not test a robot load this file, too: it imports only pytest, and affects only
tests that use `hil`.
"""

import asyncio
import functools
import inspect
import unittest
import warnings
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

try:
    import pytest_asyncio
except ImportError:  # a project without asynchronous tests
    _asynchronous: Any = None
else:
    _asynchronous = pytest_asyncio.fixture

if TYPE_CHECKING:
    from hilserver.testing.hil import Hil

MODES = ("virtual", "realtime")
LOOPS = ("asyncio", "uvloop")
_HIL: pytest.StashKey["Hil"] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options and their ini equivalents."""
    group = parser.getgroup("hilserver", "hardware in the loop (hilserver)")
    group.addoption(
        "--hil-config", metavar="FILE", help="configuration of the simulated robot"
    )
    group.addoption(
        "--hil-mode",
        choices=MODES,
        help="virtual: as fast as possible, in lockstep; or realtime",
    )
    group.addoption(
        "--hil-loop",
        choices=LOOPS,
        help="event loop of tests that use hil; the daemon's is uvloop",
    )
    group.addoption(
        "--hil-fault",
        action="append",
        metavar="NAME",
        help="defect of the simulated shield in every test, as shield.rpm_unsigned; may be"
        " repeated",
    )
    group.addoption(
        "--hil-scenario", metavar="FILE", help="timed scenario that runs in every test"
    )
    group.addoption(
        "--hil-keep", metavar="DIR", help="folder for the recordings of failed tests"
    )
    parser.addini(
        "hil_config", "configuration of the simulated robot, like --hil-config"
    )
    parser.addini("hil_mode", "virtual or realtime, like --hil-mode", default="virtual")
    parser.addini("hil_loop", "asyncio or uvloop, like --hil-loop", default="asyncio")
    parser.addini(
        "hil_keep", "folder for failed tests, like --hil-keep", default="hil-failures"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Describe the markers; choose the event loop."""
    loop = config.getoption("--hil-loop") or config.getini("hil_loop")
    if loop not in LOOPS:
        raise pytest.UsageError(
            f"the loop of hil is {' or '.join(LOOPS)}, not {loop!r}"
        )
    if loop == "uvloop":
        if not hasattr(config.hook, "pytest_asyncio_loop_factories"):
            raise pytest.UsageError("uvloop for hil needs pytest-asyncio 1.4 or newer")
        config.pluginmanager.register(_OnUvloop())
    config.addinivalue_line(
        "markers",
        "hil(config=..., mode=..., scenario=...): configuration (file or mapping), mode and"
        " scenario of the simulated robot in this test",
    )
    config.addinivalue_line(
        "markers",
        "requirement(id, ...): requirements that the test verifies, for the JUnit report",
    )


class _OnUvloop:
    """Lets tests that use `hil` run on uvloop, as the daemon does; others keep their loop."""

    @pytest.hookimpl(wrapper=True, optionalhook=True)
    def pytest_asyncio_loop_factories(
        self, item: pytest.Function
    ) -> Generator[None, Any, dict[str, Callable[[], asyncio.AbstractEventLoop]]]:
        """Name the loop of one test."""
        own = yield
        if "hil" not in item.fixturenames:
            return own or {"asyncio": asyncio.new_event_loop}
        import uvloop  # noqa: PLC0415 - most projects need none

        return {"uvloop": uvloop.new_event_loop}


# --- collection -----------------------------------------------------------------------------------


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_pycollect_makeitem(
    collector: pytest.Module | pytest.Class, name: str, obj: Any
) -> Generator[None, Any, Any]:
    """Let a test that is an async generator advance with the simulation.

    Tests that use `hil`, perhaps by a fixture of their own, run on asyncio in every mode of
    pytest-asyncio.
    """
    if not collector.config.pluginmanager.hasplugin("asyncio"):
        return (yield)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        made = yield
    tests = made if isinstance(made, list) else []
    uses_hil = any("hil" in getattr(test, "fixturenames", ()) for test in tests)
    is_generator = inspect.isasyncgenfunction(obj)
    if not (
        uses_hil and is_generator
    ):  # else pytest-asyncio has said that it will not run it
        for warning in said:
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )
    if not uses_hil:
        return made
    if inspect.isgeneratorfunction(obj):  # pytest 8 would leave it out
        raise pytest.Collector.CollectError(
            f"{name}: a test that yields is written 'async def'"
        )
    if is_generator:
        obj = advancing(obj, collector.config)
        # pytest fetches the function again by its name
        setattr(collector.obj, name, obj)
    elif not inspect.iscoroutinefunction(obj) or tests[0].get_closest_marker("asyncio"):
        return made
    return collector.ihook.pytest_pycollect_makeitem(
        collector=collector, name=name, obj=pytest.mark.asyncio(obj)
    )


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Refuse a test that would be called without running its body."""
    if "hil" not in getattr(item, "fixturenames", ()):
        return
    if not item.config.pluginmanager.hasplugin("asyncio"):
        _without_asyncio()
    if issubclass(getattr(item, "cls", None) or object, unittest.TestCase):
        pytest.fail(
            "hil works in functions and plain classes, not in a unittest.TestCase",
            pytrace=False,
        )


def advancing(
    test: Callable[..., AsyncGenerator[object, float]], config: pytest.Config
) -> Callable[..., Any]:
    """Return a coroutine function that runs `test` and advances wherever it yields.

    ``yield`` waits for the next tick, ``yield 10`` for ten; both give the simulated time [s].
    """

    @functools.wraps(test)
    async def drive(*args: Any, **kwargs: Any) -> None:
        __tracebackhide__ = True
        hil: Any = config.stash[_HIL]
        steps = test(*args, **kwargs)
        try:
            wish = await anext(steps)
            while True:
                try:
                    await hil.step(1 if wish is None else wish)
                except AssertionError as error:  # shown at the line that yields
                    wish = await steps.athrow(error)
                else:
                    wish = await steps.asend(hil.time_s)
        except StopAsyncIteration:
            pass
        finally:
            await steps.aclose()

    return drive


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, Any, Any]:
    """Fail a test that forgot to await."""
    done = yield
    if "hil" in pyfuncitem.fixturenames and _HIL in pyfuncitem.config.stash:
        pyfuncitem.config.stash[_HIL].check_awaited()
    return done


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Add the requirements that a test verifies to the report."""
    for item in items:
        for mark in item.iter_markers("requirement"):
            item.user_properties += [("requirement", str(name)) for name in mark.args]


# --- the fixture ----------------------------------------------------------------------------------


@pytest.fixture
def hil_config() -> None:
    """Override it if only your fixtures know the configuration, such as a controller's port."""


async def _hil(request: pytest.FixtureRequest, hil_config: Any) -> AsyncIterator["Hil"]:
    """Give a simulated robot: `read`, `write`, `step`, `wait_for`, `capture`, `inject`."""
    from hilserver.errors import UserError  # noqa: PLC0415 - heavy, and most projects need none
    from hilserver.testing.opening import open_hil  # noqa: PLC0415

    wishes = _wishes(request, hil_config)
    try:
        opened = open_hil(**wishes)
        hil = await opened.__aenter__()
    except (UserError, ValueError, AssertionError) as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from None
    try:
        request.config.stash[_HIL] = hil
        yield hil
    finally:
        request.config.stash.__delitem__(_HIL)
        await opened.__aexit__(None, None, None)


def _without_asyncio() -> None:
    """Fail, as pytest-asyncio is missing."""
    pytest.fail(
        "the fixture hil needs pytest-asyncio: install hilserver[test], and do not start pytest"
        " with -p no:asyncio",
        pytrace=False,
    )


if _asynchronous is None:
    hil = pytest.fixture(_without_asyncio, name="hil")
else:
    hil = _asynchronous(_hil, name="hil")


def _wishes(request: pytest.FixtureRequest, given: Any) -> dict[str, Any]:
    """Return the settings of markers (the nearest wins), fixture, options and ini file."""
    config = request.config
    marked: dict[str, Any] = {}
    for mark in request.node.iter_markers("hil"):
        if mark.args:
            pytest.fail(
                f"the marker hil takes names: write hil(config={mark.args[0]!r:.60})",
                pytrace=False,
            )
        marked = {**mark.kwargs, **marked}
    if unknown := set(marked) - {"config", "mode", "scenario"}:
        pytest.fail(f"the marker hil has no '{sorted(unknown)[0]}'", pytrace=False)
    mode = (
        marked.get("mode")
        or config.getoption("--hil-mode")
        or config.getini("hil_mode")
    )
    if mode not in MODES:
        pytest.fail(
            f"the mode of hil is {' or '.join(MODES)}, not {mode!r}", pytrace=False
        )
    here = request.path.parent
    return {
        "config": _config(marked.get("config") or given, config, here),
        "mode": mode,
        "test_folder": here,
        "faults": config.getoption("--hil-fault") or (),
        "scenario": _given("scenario", marked.get("scenario"), here)
        or _path(config.getoption("--hil-scenario"), config.invocation_params.dir),
    }


def _config(asked: Any, config: pytest.Config, here: Path) -> Any:
    return (
        _given("config", asked, here)
        or _path(config.getoption("--hil-config"), config.invocation_params.dir)
        or _path(config.getini("hil_config"), config.rootpath)
    )


def _given(key: str, value: Any, folder: Path) -> Any:
    """Return the mapping or the path that a marker or fixture gives."""
    if isinstance(value, str | Path):
        return _path(value, folder)
    if value is None or isinstance(value, Mapping):
        return value
    pytest.fail(
        f"{key} of hil is a file or a mapping, not {value!r:.60}", pytrace=False
    )


def _path(name: Any, folder: Path) -> Path | None:
    return folder / name if name else None


# --- failures -------------------------------------------------------------------------------------


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, Any]:
    """Keep recording, scenario and seed of a failed test, and report the place."""
    report: Any = yield
    if call.when == "call" and report.failed and _HIL in item.config.stash:
        from hilserver.testing.keep import command, keep  # noqa: PLC0415

        config = item.config
        folder = config.getoption("--hil-keep") or config.getini("hil_keep")
        hil = config.stash[_HIL]
        place = keep(hil, config.rootpath / folder, item.nodeid)
        text = (
            f"recording, scenario and configuration: {place}\nto repeat it:"
            f" {command(hil, place)}"
        )
        report.sections.append(("hilserver", text))
    return report
