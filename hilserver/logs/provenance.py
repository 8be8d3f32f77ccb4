"""Origin of a recording: version, configuration, kernels, seed, audit.

The configuration is kept as YAML text, as it was after validation, without secrets.
"""

import base64
import json
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel, Field, ValidationError

from hilserver.logs.log import RecordedState

SCHEMA = "hilserver.recording/1"
_SECRET = re.compile(r"password|secret|token|passphrase|hash$", re.IGNORECASE)


def make_run(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return a recording's description of its run, from that of the process image."""
    run = dict(description["run"])
    configuration = run.pop("configuration", None)
    return {
        "schema": SCHEMA,
        **run,
        "configuration": None if configuration is None else as_yaml(configuration),
        "signals": [s for s in description["signals"] if len(s["slots"]) == 1],
        "layout": description["regions"],
    }


def as_yaml(configuration: Mapping[str, Any]) -> str:
    """Return a configuration as YAML text, with secrets masked."""
    return yaml.safe_dump(
        _without_secrets(configuration), sort_keys=False, allow_unicode=True
    )


def configuration_of(run: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the configuration of a run; ValueError if there is none."""
    try:
        found = yaml.safe_load((run or {}).get("configuration") or "")
    except Exception as error:  # with damaged tags the YAML reader may raise anything
        raise ValueError(f"the configuration is damaged: {error}") from error
    if not isinstance(found, dict):
        raise ValueError("there is no configuration")
    return found


def tag_ticks(run: Mapping[str, Any]) -> int | None:
    """Return the ticks between two samples of the navigation tag; None if a run does not say."""
    try:
        configuration = configuration_of(run)
        scheduler = configuration["scheduler"]
        nav = configuration["sensors"]["nav"]
        slice_ms = scheduler["slices"][nav["slice"]]
        period_ms = max(round(1e3 / (nav["rate_hz"] * slice_ms)), 1) * slice_ms
        return max(round(float(period_ms) / float(scheduler["base_period_ms"])), 1)
    except (ValueError, KeyError, TypeError):
        return None


def _without_secrets(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {
            key: "***" if isinstance(value, str) and _SECRET.search(str(key)) else
            _without_secrets(value)
            for key, value in node.items()
        }  # fmt: skip
    if isinstance(node, list | tuple):
        return [_without_secrets(value) for value in node]
    return node


def pack_meta(run: Mapping[str, Any], states: Sequence[RecordedState]) -> str:
    """Return run and states as JSON, for formats that have no room for them."""
    entries = [
        {"segment": s.segment, "tick": s.tick, "zlib_base64": _pack_words(s)}
        for s in states
    ]
    return json.dumps({**run, "states": entries}, indent=1)


def unpack_meta(text: str) -> tuple[dict[str, Any], list[RecordedState]]:
    """Return run and states from what `pack_meta` wrote.

    ValueError if the text is damaged or has another schema.
    """
    try:
        run: dict[str, Any] = json.loads(text)
        if run["schema"] != SCHEMA:
            raise ValueError(f"does not have schema {SCHEMA}")
        states = [_unpack_state(entry) for entry in run.pop("states")]
    except (KeyError, TypeError, AttributeError, RecursionError, zlib.error) as error:
        raise ValueError(f"is damaged: {error}") from None
    check_run(run)
    return run, states


class _Signal(BaseModel):
    """The part of a run's signal that is read."""

    name: str
    unit: str = "1"
    slots: list[int]
    direction: str


class FaultCommand(BaseModel):
    """Faults that began, or ended, at a tick; see `faults.book.Faults.watchers`."""

    segment: int
    tick: int
    inject: list[dict[str, Any]] = []
    start_tick: int | None = None
    clear: str | None = None


class _Run(BaseModel):
    """The part of a run that is read; other keys are for people."""

    base_period_ns: int = Field(gt=0, le=10**12)
    signals: list[_Signal]
    configuration: str | None = None
    config_folder: str = ""
    version: str = ""
    identity: dict[str, Any] = {}
    layout: dict[str, Any] = {}
    patch: dict[str, Any] | None = None
    not_replayable: list[str] = []
    faults: list[FaultCommand] = Field([], max_length=10_000)


def check_run(run: Mapping[str, Any], names: Iterable[str] = ()) -> None:
    """Refuse a run that does not fit its file.

    Parameters
    ----------
    names : iterable of str
        Columns of the file.

    Raises
    ------
    ValueError
        One clause that names the problem.
    """
    try:
        said = _Run.model_validate(run)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(map(str, first["loc"]))
        raise ValueError(f"is damaged: {key}: {first['msg'].lower()}") from None
    known = {signal.name for signal in said.signals}
    for name in names:
        if name not in known:
            raise ValueError(f"is damaged: it does not list the signal {name!r:.60}")


def _pack_words(state: RecordedState) -> str:
    return base64.b64encode(zlib.compress(state.words.astype("<i8").tobytes())).decode()


def _unpack_state(entry: Mapping[str, Any]) -> RecordedState:
    data = zlib.decompress(base64.b64decode(entry["zlib_base64"], validate=True))
    words = np.frombuffer(data, dtype="<i8").astype(np.int64)
    return RecordedState(int(entry["segment"]), int(entry["tick"]), words)
