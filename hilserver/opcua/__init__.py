"""A hardened OPC UA server for any address space; it knows nothing of robots.

`server.HardenedServer` is used like asyncua's server, `settings.OpcUaSettings` says where it
listens and what clients may do, `application.Application` stands behind its nodes. How it holds
out: `frames` and `channel` judge what comes in, `transport` gives connections deadlines and
`rotation` all work its turns, `decoding` and `portions` bound a request, `places` and `access`
decide who gets in.

Nothing in `certificate`, `trust_list` and `passwords` knows a socket; clients of ours,
`hilserver certs` and the tests use them alike.
"""
