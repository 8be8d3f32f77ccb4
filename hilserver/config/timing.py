"""The sections ``scheduler``, ``control``, ``image`` and ``snapshots``."""

from difflib import get_close_matches
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, field_validator, model_validator

from hilserver.config.section import Section
from hilserver.program.shared_memory import DEFAULT_IMAGE
from hilserver.signals import SOURCES, Source

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,39}$")]

COMMUNICATION_SLICES = ("publish", "supervise")
DEFAULT_SLICES = {"plant": 1.0, "sensors": 10.0, "publish": 20.0, "supervise": 100.0}
MAX_SLICES = 16
_MISSPELT = 0.8
"""Similarity (difflib) to a known slice from which a name counts as a spelling mistake."""
Period = Annotated[float, Field(le=3_600_000)]


class LimitsConfig(Section):
    """When overruns end in the safe state; null: never."""

    single_overrun_ms: float | None = Field(
        100.0,
        gt=0,
        description="A longer overrun leads to the safe state [ms]; null: never",
    )
    consecutive_overruns: int | None = Field(
        100,
        ge=1,
        description="More consecutive overruns lead to the safe state; null: never",
    )


class RealtimeConfig(Section):
    """What the pacing thread asks of the system; what it does not get, the audit names."""

    priority: int = Field(
        80, ge=0, le=99, description="SCHED_FIFO priority; 0: ordinary thread"
    )
    cpu: int | None = Field(
        None,
        ge=0,
        description="Core of the pacing thread; the rest of the daemon avoids it",
    )
    lock_memory: bool = Field(True, description="Lock and prefault memory")
    hold_latency_target: bool = Field(
        True, description="Hold /dev/cpu_dma_latency at 0"
    )


class SchedulerConfig(Section):
    """Base period, time slices, pacing and what happens when time runs out."""

    backend: Literal["thread", "timerfd", "virtual"] = Field(
        "thread",
        description="Pacing: own thread, asyncio's timerfd, or as fast as possible",
    )
    base_period_ms: float = Field(1.0, ge=0.05, le=1000, description="Base period [ms]")
    slices: dict[Name, Period] = Field(
        default=DEFAULT_SLICES,
        description="Period of every slice [ms], a multiple of the base period; more may be added",
    )
    policy: Literal["catch_up", "skip", "stretch", "fail"] = Field(
        "catch_up", description="What happens to ticks whose time has passed"
    )
    catch_up_limit: int = Field(
        50, ge=1, le=10_000, description="Largest number of ticks to catch up"
    )
    limits: LimitsConfig = LimitsConfig()
    realtime: RealtimeConfig = RealtimeConfig()
    communication_timeout_ms: float = Field(
        2000.0,
        ge=0,
        description="Safe state if the event loop does not respond for this long; 0: not watched",
    )

    @field_validator("slices", mode="before")
    @classmethod
    def _add_default_slices(cls, value: object) -> object:
        return DEFAULT_SLICES | value if isinstance(value, dict) else value

    @field_validator("slices")
    @classmethod
    def _limit_slices(cls, value: dict[str, float]) -> dict[str, float]:
        if len(value) > MAX_SLICES:
            raise ValueError(
                f"{len(value)} slices are too many; the limit is {MAX_SLICES}"
            )
        for name in value.keys() - DEFAULT_SLICES.keys():
            if near := get_close_matches(name, DEFAULT_SLICES, n=1, cutoff=_MISSPELT):
                raise ValueError(
                    f"'{name}' looks like '{near[0]}'; choose a different name"
                )
        return value

    @model_validator(mode="after")
    def _timeout_above_publishing(self) -> Self:
        publish_ms = self.slices["publish"]
        timeout_ms = self.communication_timeout_ms
        if 0 < timeout_ms < 2 * publish_ms:
            raise ValueError(
                f"communication_timeout_ms is {timeout_ms:g}, but values are published every"
                f" {publish_ms:g} ms: write at least {2 * publish_ms:g}, or 0"
            )
        return self


class ControlConfig(Section):
    """Who commands."""

    source: Source | None = Field(
        None,
        description="Source with control at the start; null: peer if there are peers, else shield"
        " if enabled, else ros2 if enabled, else opcua",
    )
    priority: tuple[Source, ...] = Field(
        SOURCES,
        description="Sources that may take control from one another, highest first",
    )
    fallback: Literal["nobody", "before"] = Field(
        "nobody",
        description="Who gets control when the source in control is gone; before: the previous"
        " source, except after a Stop, a lapsed command or the safe state",
    )
    after_reset: Literal["start", "continue"] = Field(
        "start",
        description="start: after a Stop or safe state, Reset lets only hands drive; peers, OPC UA"
        " clients, ROS 2 and shield wait for Start. continue: they drive on after Reset, as they"
        " always do in virtual time",
    )
    opcua_stale_after_ms: float | None = Field(
        None,
        gt=0,
        description="Safe state if the OPC UA client in control writes nothing for this long;"
        " null: never",
    )

    command_timeout_ms: float | None = Field(
        None,
        gt=0,
        le=1e6,
        description="Set-points become zero if none arrives for this long (500 ms in the shield of"
        " the real robot); null: never",
    )

    @model_validator(mode="after")
    def _source_in_priority(self) -> Self:
        if not self.priority:
            raise ValueError("priority is empty: name at least one source")
        twice = [name for name in self.priority if self.priority.count(name) > 1]
        if twice:
            raise ValueError(f"priority names '{twice[0]}' twice")
        if self.source is not None and self.source not in self.priority:
            raise ValueError(f"source '{self.source}' is not in priority")
        return self


class ImageConfig(Section):
    """The process image in shared memory."""

    name: str = Field(
        DEFAULT_IMAGE,
        pattern=r"^[A-Za-z0-9_.-]{1,60}$",
        description="Name in shared memory; 'auto' adds the process id",
    )
    ring_frames: int = Field(
        2048, ge=16, le=65536, description="Frames in the ring, a power of two"
    )

    @field_validator("ring_frames")
    @classmethod
    def _power_of_two(cls, value: int) -> int:
        below = 1 << (value.bit_length() - 1)
        if value != below:
            raise ValueError(
                f"{value} is not a power of two; the nearest are {below} and {2 * below}"
            )
        return value


class SnapshotConfig(Section):
    """Where snapshots lie."""

    folder: str = Field(
        "snapshots", description="Folder, relative to the configuration file"
    )
