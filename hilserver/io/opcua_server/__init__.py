"""The robot as an OPC UA server: the signal table as an address space, writes through the gate.

`server.OpcUaServer` is all the daemon needs; clients take names from `model` and `method_table`.
Inside, `model` defines the address space, `values` keeps it up to date, and `application` serves
writes and calls. Sessions, subscriptions and limits are those of `hilserver.opcua`.
"""
