"""A hardened OPC UA server for any address space, independent of robots.

`server.HardenedServer` is used like asyncua's server, `settings.OpcUaSettings` defines where it
listens and what clients may do, `application.Application` stands behind its nodes. A request goes
through the files in this order: `transport` gives its connection deadlines and `rotation` its
turns, `frames` and `channel` check what comes in, `decoding` and `portions` bound it, `processor`
finds the service, `login` with `places` and `access` decides who gets a session, `services` lists
what a session may request, and `subscriptions` with `monitored_items` sends what it monitors.

`certificate`, `trust_list` and `passwords` need no socket; our clients, `hilserver certs` and the
tests use them as well.
"""
