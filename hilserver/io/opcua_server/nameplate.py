"""What identifies the robot as a device: the nameplate of DI (OPC 10000-100, 4.5.2).

Asset tools look for these names in the namespace of DI, at the device itself and in its group
Identification.
"""

from typing import Any, NamedTuple

from hilserver import __version__
from hilserver.compiled.cache import kernel_hash
from hilserver.config.root import Config

GROUP = "Identification"
STRING, LOCALIZED_TEXT, INT32 = 12, 21, 6


class Entry(NamedTuple):
    """A property of the nameplate; `kind` is the identifier of its data type."""

    name: str
    value: Any
    kind: int = STRING


def nameplate(config: Config, application_uri: str) -> tuple[Entry, ...]:
    """Return the nameplate of the configured robot.

    The serial number is the beginning of the configuration's hash: the same number, the same robot.
    The revision of the device is that of its compiled equations.
    """
    serial = config.sha256[:12]
    return (
        Entry("Manufacturer", "hilserver", LOCALIZED_TEXT),
        Entry("ManufacturerUri", "urn:hilserver"),
        Entry("Model", "Simulated four-wheeled robot", LOCALIZED_TEXT),
        Entry("ProductCode", "hilserver-robot"),
        Entry("HardwareRevision", "simulated"),
        Entry("SoftwareRevision", __version__),
        Entry("DeviceRevision", kernel_hash()),
        Entry("DeviceClass", "Mobile robot"),
        Entry("DeviceManual", "docs/index.md"),
        Entry("SerialNumber", serial),
        Entry("ProductInstanceUri", f"{application_uri}:{serial}"),
        Entry("RevisionCounter", -1, INT32),  # -1: it is not counted
    )
