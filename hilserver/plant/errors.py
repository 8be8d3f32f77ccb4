"""The plant's one error."""

from hilserver.errors import ConfigError


class PlantError(ConfigError, ValueError):
    """Parameters the plant cannot run with; one sentence that names the key and the remedy.

    A `ValueError` too, so that a configuration model can raise it and add file and line.
    """
