"""Common to all links to peers, whatever their transport: `link` and what it needs.

`opcua_client` and `s7` add the conversation; `peers` makes a link for every configured peer.
"""
