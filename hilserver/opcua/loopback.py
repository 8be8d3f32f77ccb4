"""Which addresses are on this computer."""

import ipaddress


def is_loopback(host: str) -> bool:
    """Whether only programs on this computer reach `host`; a name other than localhost is not."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
