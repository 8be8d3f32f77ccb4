"""The plant's only error."""

from hilserver.errors import ConfigError


class PlantError(ConfigError, ValueError):
    """Parameters that the plant cannot run with; one sentence that names the key and the remedy.

    Also a `ValueError`, so that a configuration model can raise it and add file and line.
    """
