"""A hardened OPC UA server for any address space; it knows nothing of robots.

`server.HardenedServer` is used like asyncua's server, `settings.OpcUaSettings` says where it
listens and what clients may do, `application.Application` stands behind its nodes. A request goes
through the files in this order: `transport` gives its connection deadlines and `rotation` its
turns, `frames` and `channel` judge what comes in, `decoding` and `portions` bound it, `processor`
finds the service, `login` with `places` and `access` decides who gets a session, `services` lists
what a session may ask, and `subscriptions` with `monitored_items` sends what it watches.

Nothing in `certificate`, `trust_list` and `passwords` knows a socket; clients of ours,
`hilserver certs` and the tests use them alike.
"""
