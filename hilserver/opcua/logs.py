"""The server's log. asyncua's own messages are limited where logging is set up."""

import structlog

log = structlog.get_logger("hilserver.opcua")
