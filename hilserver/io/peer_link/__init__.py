"""What all links to peers share, whatever their transport: `link` and what it needs.

`opcua_client` and `s7` add how they converse; `peers` makes a link for every configured peer.
"""
