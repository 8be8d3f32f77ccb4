"""The `opcua:` section: our OPC UA server."""

from pydantic import Field

from hilserver.config.section import Section
from hilserver.opcua.settings import OpcUaPermissions, OpcUaSettings, RoleName


class RobotPermissions(OpcUaPermissions):
    """The lowest role that may write a variable or call a method; of several rows the last wins.

    Patterns are those of file names: ``*`` stands for any text. By default an operator writes
    inputs and starts and stops the simulation, an engineer calls every method.
    """

    call: dict[str, RoleName] = Field(
        default={
            "*": "engineer",
            "Start": "operator",
            "Stop": "operator",
            "Pause": "operator",
            "Step": "operator",
            "Reset": "operator",
            "SetSpeed": "operator",
            "*Scenario": "operator",
            "*Recording": "operator",
        },
        description="Pattern of method names: lowest role that may call",
    )


class _Switch(Section):
    enabled: bool = Field(default=True, description="Start the OPC UA server")


class OpcUaConfig(OpcUaSettings, _Switch):
    """Endpoint, security and limits of the OPC UA server."""

    permissions: RobotPermissions = Field(
        default_factory=RobotPermissions, description="Who may write and call what"
    )
    max_events_per_s: int = Field(
        default=10,
        ge=1,
        le=1000,
        description="Events sent per kind and second; the rest are counted",
    )

    @property
    def is_used(self) -> bool:
        """Whether the server starts."""
        return self.enabled
