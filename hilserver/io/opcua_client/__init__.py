"""OPC UA clients: one `PeerLink` per peer reads its set-points and writes our outputs back.

Read the files in the order of a value's path: `session` connects and finds the nodes, after
`security` has judged the peer (`refusal` words what is wrong with it), `acquisition`
brings samples (subscribed or polled, each of them judged), `intake` hands one group to the input
gate, `staleness` and `latency` judge the stream, `writer` sends outputs back, and `link` runs all
of it in a loop that survives whatever the peer does.
"""

from hilserver.io.opcua_client.link import PeerLink
from hilserver.io.opcua_client.security import LinkSecurity

__all__ = ["LinkSecurity", "PeerLink"]
