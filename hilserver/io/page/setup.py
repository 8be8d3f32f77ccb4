"""What the page's process has to know about the daemon; passed as JSON at its start."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Serving:
    """The section `page` of the configuration, checked already: pydantic would take 7 MB here."""

    host: str = "127.0.0.1"
    port: int = 8080
    rate_hz: float = 30.0
    deadman_ms: float = 300.0
    max_clients: int = 20
    certificate: str = ""  # empty: no encryption
    key: str = ""


@dataclass(frozen=True)
class OpcUaAccess:
    """How the page reaches the daemon's OPC UA server."""

    endpoint: str = ""  # empty if the server is off: the page then only shows
    # marks the page's sessions; empty: they are like those of any client
    secret: str = field(default="", repr=False)
    needs_login: bool = False  # whether a name and a password are needed
    # whether users without a log-in may stop the robot
    anonymous_may_stop: bool = False
    # failed log-ins per name or address in a minute; the daemon counts the same
    max_failed_logins: int = 5
    # security policy, and the server's own certificate, which the page both trusts and presents;
    # empty without encryption
    policy: str = ""
    certificate: str = ""
    key: str = ""
    application_uri: str = ""


@dataclass(frozen=True)
class Setup:
    """Everything that does not change while the daemon runs."""

    image: str  # name of the process image
    page: Serving
    opcua: OpcUaAccess
    # name, unit, type, writable, labels, low, high, description and slot of every scalar
    signals: list[dict[str, Any]]
    robot: dict[str, Any]  # dimensions [m] and largest speeds
    walls: list[list[float]]  # x1, y1, x2, y2 [m] of each
    # absolute paths: recordings, scenarios, patches, reports, snapshots
    folders: dict[str, str]
    # of every kind of fault: name, description, required and optional parameters, target
    faults: list[dict[str, Any]] = field(default_factory=list)
    # name, unit, low, high, configured value, nullable, fixed and meaning of every parameter
    parameters: list[dict[str, Any]] = field(default_factory=list)
    # names of the built-in mappings for logs of others
    mappings: list[str] = field(default_factory=list)
    config_file: str = ""  # configuration for diagnoses; empty: the defaults

    def to_json(self) -> str:
        """Return one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Setup":
        """Return what `to_json` wrote."""
        data = json.loads(text)
        page, opcua = Serving(**data.pop("page")), OpcUaAccess(**data.pop("opcua"))
        return cls(page=page, opcua=opcua, **data)

    def folder(self, name: str) -> Path:
        """Return one of the folders."""
        return Path(self.folders[name])
