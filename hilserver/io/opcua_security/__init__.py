"""Certificates, trust list, passwords and failed log-ins: what the OPC UA server decides with.

Nothing here knows a socket; the server, `hilserver certs` and the tests use it alike.
"""
