"""The server's log. asyncua's own lines are tamed where all logging is set up."""

import structlog

log = structlog.get_logger("hilserver.opcua")
