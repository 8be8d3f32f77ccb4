"""The whole of config.yaml."""

import hashlib
import json
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from hilserver.config.blocks import BlockConfig
from hilserver.config.doors import DoorRule, Right
from hilserver.config.edge import EdgeConfig
from hilserver.config.foxglove import FoxgloveConfig
from hilserver.config.loading import load
from hilserver.config.mechatronic import MechatronicConfig
from hilserver.config.monitoring import LoggingConfig, MetricsConfig, ShadowConfig
from hilserver.config.observer import ObserverConfig
from hilserver.config.page import FoldersConfig, PageConfig
from hilserver.config.peers import PeerConfig
from hilserver.config.plant import KinematicsConfig, PlantConfig, SensorsConfig
from hilserver.config.recalibration import RecalibrationConfig
from hilserver.config.recording import RecordingConfig
from hilserver.config.ros2 import Ros2Config
from hilserver.config.s7 import S7Config
from hilserver.config.section import Driver, LinkSection, Section
from hilserver.config.server import OpcUaConfig
from hilserver.config.shared_memory import SharedMemoryConfig
from hilserver.config.shield import ShieldConfig
from hilserver.config.timing import (
    ControlConfig,
    ImageConfig,
    SchedulerConfig,
    SnapshotConfig,
)
from hilserver.opcua.settings import Role
from hilserver.signals import AUTOMATIC, Source


class Config(Section):
    """Everything a run depends on; every section has working defaults."""

    plant: PlantConfig = Field(default_factory=PlantConfig)
    kinematics: KinematicsConfig = Field(default_factory=KinematicsConfig)
    sensors: SensorsConfig = Field(default_factory=SensorsConfig)
    mechatronic: MechatronicConfig = Field(default_factory=MechatronicConfig)
    scheduler: SchedulerConfig = Field(default_factory=SchedulerConfig)
    control: ControlConfig = Field(default_factory=ControlConfig)
    image: ImageConfig = Field(default_factory=ImageConfig)
    opcua: OpcUaConfig = Field(default_factory=OpcUaConfig)
    peers: tuple[PeerConfig, ...] = ()
    edge: EdgeConfig = Field(default_factory=EdgeConfig)
    s7: S7Config = Field(default_factory=S7Config)
    shared_memory: SharedMemoryConfig = Field(default_factory=SharedMemoryConfig)
    shield: ShieldConfig = Field(default_factory=ShieldConfig)
    ros2: Ros2Config = Field(default_factory=Ros2Config)
    blocks: tuple[BlockConfig, ...] = ()
    observer: ObserverConfig = Field(default_factory=ObserverConfig)
    shadow: ShadowConfig = Field(default_factory=ShadowConfig)
    recalibration: RecalibrationConfig = Field(default_factory=RecalibrationConfig)
    snapshots: SnapshotConfig = Field(default_factory=SnapshotConfig)
    folders: FoldersConfig = Field(default_factory=FoldersConfig)
    recording: RecordingConfig = Field(default_factory=RecordingConfig)
    metrics: MetricsConfig = Field(default_factory=MetricsConfig)
    page: PageConfig = Field(default_factory=PageConfig)
    foxglove: FoxgloveConfig = Field(default_factory=FoxgloveConfig)
    logging: LoggingConfig = Field(default_factory=LoggingConfig)

    @model_validator(mode="after")
    def _no_strangers_on_the_page(self) -> Self:
        page = self.page
        may = self.opcua.anonymous_role
        is_open = (
            page.enabled and page.is_open_to_network and not page.allow_insecure_network
        )
        if is_open and self.opcua.enabled and may not in (None, Role.OBSERVER):
            raise ValueError(
                f"page.host '{page.host}' is reachable from the network, and everyone who opens the"
                f" page would be {may.name.lower()} without a password: name opcua.users, set"
                " opcua.anonymous: observer, or listen on 127.0.0.1"
            )
        return self

    @model_validator(mode="after")
    def _held_commands_move_no_machine(self) -> Self:
        if not self.ros2.enabled or self.ros2.action != "hold":
            return self
        written = [
            f"peers.{peer.name}"
            for peer in self.peers
            if peer.write and not peer.is_local
        ]
        if self.shield.enabled and self.shield.device is not None:
            written.append(f"shield.device '{self.shield.device}'")
        if written:
            raise ValueError(
                "ros2.on_stale: a command that stands without being renewed must move no real"
                f" machine, and {written[0]} may be one: set ros2.on_stale to ramp or device"
            )
        return self

    @property
    def drivers(self) -> list[Driver]:
        """Sources that may drive over a link, whether or not it is enabled."""
        return [link.driver for link in self.links]

    @property
    def links(self) -> list[LinkSection]:
        """Sections of the links over which a source may drive, enabled or not."""
        values = (value if isinstance(value, tuple) else (value,) for _, value in self)
        sections = (section for found in values for section in found)
        return [section for section in sections if isinstance(section, LinkSection)]

    @property
    def sources(self) -> tuple[Source, ...]:
        """Kinds of sources that exist here, highest priority first.

        One with a section of its own exists if that is enabled.
        """
        by_driver = {driver.kind: driver.is_enabled for driver in self.drivers}
        by_hand = {
            "page": self.page.enabled or self.foxglove.enabled,
            "peer": True,
        }
        optional = by_driver | by_hand
        return tuple(
            source for source in self.control.priority if optional.get(source, True)
        )

    @property
    def first_source(self) -> Source:
        """Kind of source that has control at the start; that of the first link that drives."""
        if self.control.source is not None:
            return self.control.source
        watching = {
            door.source for door in self.doors if Right.COMMAND not in door.rights
        }
        kinds = (
            link.driver.kind
            for link in self.links
            if link.drives and link.driver.source not in watching
        )
        return next(kinds, "opcua")

    @property
    def waits_for_start(self) -> bool:
        """Whether automatic sources wait for Start after a Stop; in virtual time, nobody would."""
        return (
            self.control.after_reset == "start" and self.scheduler.backend != "virtual"
        )

    @property
    def after_reset(self) -> str:
        """What follows a Stop or a safe state, in a sentence."""
        automatic = ", ".join(kind for kind in self.sources if kind in AUTOMATIC)
        if self.waits_for_start:
            return f"after a Stop: Reset, then Start lets {automatic} drive (control.after_reset)"
        if self.control.after_reset == "continue":
            why = "control.after_reset"
        else:
            why = "virtual time"
        return f"after a Stop: {automatic} drive on after Reset, without Start ({why}: continue)"

    @property
    def doors(self) -> list[DoorRule]:
        """Doors without a log-in, open or not, with what they allow here."""
        sections = (self.foxglove, self.ros2, self.s7, self.edge, self.shared_memory)
        stranger = self.opcua.anonymous_role
        return [section.door._replace(stranger=stranger) for section in sections]

    @property
    def sha256(self) -> str:
        """Hash of the validated configuration; recordings and snapshots carry it."""
        text = json.dumps(self.model_dump(mode="json"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def without_passwords(config: Config) -> dict[str, Any]:
    """Return a configuration for recordings: valid, but without password hashes."""
    data = config.model_dump(mode="json")
    for user in data["opcua"]["users"]:
        user["password"] = "$scrypt$removed"  # noqa: S105
    return data


def load_config(path: Path | None) -> Config:
    """Return the configuration of a file, or the defaults; ConfigError: a line per complaint."""
    return Config() if path is None else load(path, Config)
