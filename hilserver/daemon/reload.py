"""SIGHUP: read the configuration again and apply what can change in a running robot.

Everything is checked before anything changes: a file with a mistake leaves the old configuration in
force. The plant, its parameters and the signal table stay as they are until a restart, because
snapshots and recordings name one set of parameters for the whole run.
"""

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import structlog

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble
from hilserver.daemon.builder import overrun_limits
from hilserver.daemon.daemon import Daemon
from hilserver.errors import UserError
from hilserver.monitoring.logging_setup import (
    Stream,
    notice,
    report_repeats,
    setup_logging,
)

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class ChangedKey:
    """A key of config.yaml whose value has changed, such as ``logging.level``."""

    key: str
    before: Any
    after: Any


def changes(before: Config, after: Config) -> list[ChangedKey]:
    """Return every key that differs; a list counts as one value."""
    old, new = (
        dict(_leaves(config.model_dump(mode="json"))) for config in (before, after)
    )
    keys = sorted(old.keys() | new.keys())
    return [
        ChangedKey(k, old.get(k), new.get(k)) for k in keys if old.get(k) != new.get(k)
    ]


def _leaves(section: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in section.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _use_logging(daemon: Daemon, config: Config, out: Stream | None) -> None:
    if daemon.limiter is not None:
        report_repeats(daemon.limiter, at_end=True)
    logging = config.logging
    daemon.limiter = setup_logging(
        logging.level, logging.format, logging.repeat_window_s, out
    )


def _use_limits(daemon: Daemon, config: Config, _out: Stream | None) -> None:
    daemon.scheduler.set_limits(overrun_limits(config.scheduler.limits))


def _use_operator_limit(daemon: Daemon, config: Config, _out: Stream | None) -> None:
    daemon.gate.leases.limit("opcua", config.control.opcua_stale_after_ms)


RELOADABLE: dict[str, Callable[[Daemon, Config, Stream | None], None]] = {
    "logging.": _use_logging,
    "scheduler.limits.": _use_limits,
    "control.opcua_stale_after_ms": _use_operator_limit,
}
"""Prefix of the keys that can change while running -> function that makes the change."""


class Reloader:
    """Re-reads the configuration file of a running daemon."""

    def __init__(self, daemon: Daemon, out: Stream | None = None) -> None:
        self._daemon = daemon
        self._out = out
        # has the file without options: those are not changes
        self._patches = daemon.desk.patches
        self._lock = asyncio.Lock()

    async def reload(self) -> bool:
        """Read the file and apply it; return False if it was refused as a whole."""
        path = self._daemon.assembly.path
        patch = self._daemon.assembly.patch
        at, group = (None, None) if patch is None else (patch.path, patch.group)
        if path is None:
            _log.warning("reload: the daemon runs without a configuration file")
            return False
        async with self._lock:
            try:
                new = (await asyncio.to_thread(assemble, path, at, group)).config
            except (UserError, OSError) as error:
                for line in str(error).splitlines():
                    _log.error(
                        "reload refused, the old configuration stays", reason=line
                    )
                return False
            self._apply(new)
            return True

    def _apply(self, new: Config) -> None:
        found = changes(self._patches.from_file, new)
        uses: set[str] = set()
        for change in found:
            begin = next(
                (key for key in RELOADABLE if change.key.startswith(key)), None
            )
            if begin is None:
                _log.warning(
                    "reload: needs a restart, the old value stays",
                    key=change.key,
                    running=change.before,
                    file=change.after,
                )
            else:
                uses.add(begin)
        for begin in sorted(uses):
            RELOADABLE[begin](self._daemon, new, self._out)
        for change in found:
            if any(change.key.startswith(begin) for begin in uses):
                notice(
                    "reload: changed",
                    key=change.key,
                    before=change.before,
                    now=change.after,
                )
        if not found:
            notice("reload: the configuration has not changed")
        self._patches.from_file = _reloaded(self._patches.from_file, new)
        self._daemon.config = _reloaded(self._daemon.config, new)


def _reloaded(config: Config, new: Config) -> Config:
    """Return `config` with the values of `new` that can change while running."""
    return config.changed(
        logging=new.logging,
        scheduler={"limits": new.scheduler.limits},
        control={"opcua_stale_after_ms": new.control.opcua_stale_after_ms},
    )
