"""The sections ``metrics:``, ``logging:`` and ``shadow:`` of the configuration."""

from ipaddress import ip_address
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from hilserver.config.section import Section


def _is_address(text: str) -> str:
    try:
        return str(ip_address(text))
    except ValueError:
        raise ValueError(
            "write an IP address of this computer, for example 127.0.0.1"
        ) from None


class MetricsConfig(Section):
    """Where metrics and health are served; without a password, so on loopback by default."""

    enabled: bool = Field(True, description="serve /metrics, /healthz and /readyz")
    host: Annotated[str, AfterValidator(_is_address)] = Field(
        "127.0.0.1",
        description="address to listen on; everyone who can reach it can read all metrics",
    )
    port: int = Field(9464, ge=0, le=65535, description="TCP port; 0 takes a free one")
    host_names: tuple[str, ...] = Field(
        (),
        max_length=20,
        description="names that scrapers use for this computer, besides its addresses, localhost"
        " and its host name; requests for other names are refused (DNS rebinding)",
    )


class LoggingConfig(Section):
    """What is logged to stderr, and how."""

    level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = Field(
        "INFO", description="DEBUG, INFO, WARNING or ERROR"
    )
    format: Literal["auto", "console", "json"] = Field(
        "auto", description="console, json, or auto: console on a terminal, else json"
    )
    repeat_window_s: float = Field(
        10.0,
        ge=0,
        le=3600,
        description="a repeated line is printed only once in this many seconds",
    )


class ShadowConfig(Section):
    """When the gap between the measured and the simulated robot is an alarm."""

    limits: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default_factory=dict,
        description="largest gap by signal, in its unit, such as pose.x_m: 0.3; empty: no alarm",
    )
    after_s: float = Field(
        1.0, ge=0, le=3600, description="a gap that lasts this long raises an alarm"
    )
