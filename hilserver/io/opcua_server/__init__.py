"""OPC UA server: the signal table as an address space, writes through the input gate.

`OpcUaServer` is all the daemon needs. Inside, `model` says what the address space holds, `values`
keeps it up to date, `door` and `methods` let clients act, `access` decides who may.
"""

from hilserver.io.opcua_server.server import OpcUaServer

__all__ = ["OpcUaServer"]
