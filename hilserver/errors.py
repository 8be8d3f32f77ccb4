"""Errors that a user can mend: one sentence each, with the exit code of spec "Commands"."""

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_BAD_LOG = 2
EXIT_SAFETY_LIMIT = 3
EXIT_BAD_CONFIGURATION = 78


class UserError(Exception):
    """Something the user can mend; printed as one sentence, never as a traceback."""

    exit_code = EXIT_FAILED


class FailedError(UserError):
    """The system refused: port in use, device absent, file not writable."""


class LogError(UserError):
    """A log or mapping file that cannot be read."""

    exit_code = EXIT_BAD_LOG


class ConfigError(UserError):
    """A configuration or patch that cannot be used."""

    exit_code = EXIT_BAD_CONFIGURATION
