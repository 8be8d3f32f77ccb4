"""OPC UA server: the signal table as an address space, writes through the input gate.

`server.OpcUaServer` is all the daemon needs; clients take names from `model` and `method_table`.
Inside, `model` says what the address space holds, `values` keeps it up to date, `door` and
`methods` let clients act, `access` decides who may.
"""
