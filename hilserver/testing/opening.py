"""From options and markers to a daemon on free ports."""

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from hilserver.config.loading import checked
from hilserver.config.root import Config, load_config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.faults.scenario import Play, Scenario, load_scenario
from hilserver.testing.hil import Hil, Mode

_DEFAULTS: dict[str, Any] = {
    "scheduler": {
        "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
        "communication_timeout_ms": 0,
    },
    "opcua": {"enabled": False},
    "metrics": {"enabled": False},
}
"""Default sections of a test: tolerant of a busy computer, and without servers (that of OPC UA
takes two seconds to start). A configuration file is used as it is."""


@asynccontextmanager
async def open_hil(
    config: Path | Mapping[str, Any] | None,
    mode: Mode,
    *,
    faults: Sequence[str] = (),
    scenario: Path | Mapping[str, Any] | None = None,
    test_folder: Path | None = None,
) -> AsyncIterator[Hil]:
    """Run a daemon for one test, whose file is in `test_folder`.

    Sections replace those of `_DEFAULTS`; `faults` are defects of the shield from the start.
    ConfigError has one sentence with file, line and key.
    """
    if isinstance(config, Path):
        read, folder = load_config(config), config.parent
    else:
        given = _DEFAULTS | dict(config or {})
        read, folder = checked(Config, given, "configuration of hil: "), None
    assembly = assemble_config(for_test(read, mode), folder)
    play = None
    if isinstance(scenario, Path):
        play = Play(load_scenario(scenario), scenario)
    elif scenario is not None:
        play = Play(checked(Scenario, scenario, "scenario of hil: "))
    daemon = Daemon(assembly, play=play, paused=mode == "virtual")
    hil = Hil(daemon, mode, test_folder)
    if faults:
        hil.inject(*faults)
    async with hil.running():
        yield hil


def for_test(config: Config, mode: Mode) -> Config:
    """Return the same configuration on free ports, paced for `mode`."""
    backend = "virtual" if mode == "virtual" else config.scheduler.backend
    if mode == "realtime" and backend == "virtual":
        backend = "thread"
    source = config.control.source or ("peer" if config.peers else "scenario")
    path = urlsplit(config.opcua.endpoint).path
    # nodes then follow the robot's time, as the robot waits for them
    follows = mode == "virtual" and config.ros2.enabled
    clock = {"publish": {"clock": True}} if follows else {}
    return config.changed(
        scheduler={"backend": backend},
        control={"source": source},
        image={"name": "auto"},
        opcua={"endpoint": f"opc.tcp://127.0.0.1:0{path}"},
        metrics={"host": "127.0.0.1", "port": 0},
        ros2=clock,
    )
