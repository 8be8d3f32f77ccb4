"""The robot as an OPC UA server: the signal table as an address space, writes through the gate.

`server.OpcUaServer` is all the daemon needs; clients take names from `model` and `method_table`.
Inside, `model` says what the address space holds, `values` keeps it up to date, `application` lets
clients act. Sessions, subscriptions and limits are those of `hilserver.opcua`.
"""
