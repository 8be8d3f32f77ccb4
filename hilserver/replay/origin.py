"""The configuration that a recording carries, made into an assembly again."""

from pathlib import Path

import yaml

from hilserver.config.patch import Patch, patch_of
from hilserver.config.root import Config
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.errors import ConfigError, LogError
from hilserver.logs import Log

SECTIONS = ("plant", "kinematics", "mechatronic", "sensors", "scheduler", "observer", "blocks")
"""What the plant depends on; addresses and passwords of the run do not matter."""


def assembly_of(log: Log, patch: Patch | None = None) -> Assembly:
    """Build what the recorded run was built from, or the same with another patch.

    LogError if the recording has no configuration, or one of another version; ConfigError if a file
    that it names (hall, own block) is not there.
    """
    text = None if log.run is None else log.run["configuration"]
    if log.run is None or text is None:
        raise LogError(f"{log.path}: carries no configuration; name the one of its run with -c")
    try:
        data = yaml.safe_load(text)
        config = Config.model_validate({k: data[k] for k in SECTIONS if k in data})
        laid_over = patch or patch_of(log.run)
    except (yaml.YAMLError, ValueError, TypeError, KeyError):
        raise LogError(
            f"{log.path}: its configuration is not one of this version"
            f" ({log.run.get('version', 'unknown')} made it); name one with -c and --as-inputs"
        ) from None
    try:
        return assemble_config(config, Path(log.run["config_folder"]), laid_over)
    except ConfigError as error:
        raise ConfigError(
            f"{log.path}: its configuration cannot be used here: {error}; name it with -c"
        ) from None
