"""The robot's server is the one that the protocol is tested with, beside `test_server`."""

from tests.io.opcua_server.conftest import client, rig

__all__ = ["client", "rig"]
