"""A network namespace for the peer, whose link can be made to swallow everything."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

OURS, THEIRS = "198.51.100.1", "198.51.100.2"  # TEST-NET-2


def run(*command: str) -> str:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stderr.strip()}"
    return done.stdout


@dataclass(frozen=True)
class PeerNetwork:
    name: str

    @property
    def prefix(self) -> tuple[str, ...]:
        """Put before a command, it runs on the peer's side."""
        return ("ip", "netns", "exec", self.name)

    def swallow(self) -> None:
        """Drop every packet in both directions, answering none of them."""
        run(*self.prefix, "nft", "add table inet hole")
        for hook in ("input", "output"):
            chain = f"{{ type filter hook {hook} priority 0; policy drop; }}"
            run(*self.prefix, "nft", f"add chain inet hole {hook} {chain}")

    def heal(self) -> None:
        run(*self.prefix, "nft", "delete table inet hole")


@contextmanager
def peer_network() -> Iterator[PeerNetwork]:
    assert os.geteuid() == 0, "a network namespace needs root: run the tests as root"
    name = f"hil{os.getpid()}"
    network = PeerNetwork(name)
    run("ip", "netns", "add", name)
    try:
        run("ip", "link", "add", f"{name}a", "type", "veth", "peer", "name", f"{name}b")
        run("ip", "link", "set", f"{name}b", "netns", name)
        run("ip", "addr", "add", f"{OURS}/30", "dev", f"{name}a")
        run("ip", "link", "set", f"{name}a", "up")
        run(*network.prefix, "ip", "addr", "add", f"{THEIRS}/30", "dev", f"{name}b")
        run(*network.prefix, "ip", "link", "set", f"{name}b", "up")
        run(*network.prefix, "ip", "link", "set", "lo", "up")
        yield network
    finally:
        run("ip", "netns", "delete", name)  # takes the veth pair with it
