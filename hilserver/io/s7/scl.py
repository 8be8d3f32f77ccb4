"""Data blocks as SCL source text, for the controller's project: the same bytes at the same places.

A block with standard access has its members one after the other: bits fill a byte, members of two
bytes and more begin at an even one. If a layout leaves more room, a member `fill_n` fills it.
"""

import re
from collections.abc import Iterable, Iterator

from hilserver.config.peers import PeerConfig
from hilserver.config.root import Config
from hilserver.config.s7 import BlockPlace
from hilserver.config.s7_peer import Block

Member = tuple[BlockPlace, str, str]  # place, name, remark


def to_scl(config: Config) -> str:
    """Return every data block of a configuration: those of `s7.server`, and those of S7 peers."""
    return "\n".join(_blocks(config))


def _blocks(config: Config) -> Iterator[str]:
    server = config.s7.server
    for number, layout in sorted(({} if server is None else server.blocks).items()):
        members = [(field.place, field.signal, field.signal) for field in layout]
        yield _block(f"hilserver_DB{number}", members)
    for peer in config.peers:
        if peer.is_s7:
            coming, going = peer.blocks
            written = {text: signal for signal, text in peer.write.items()}
            for block, names in ((coming, _read(peer)), (going, written)):
                if block is not None:
                    yield _block(
                        f"{peer.name}_DB{block.number}", _members(block, names)
                    )


def _read(peer: PeerConfig) -> dict[str, str]:
    return {text: peer.inputs_of(text)[0] for text in peer.read}


def _members(block: Block, names: dict[str, str]) -> list[Member]:
    return [
        (
            place,
            names.get(text, "heartbeat"),
            names.get(text, "counts every cycle, at both ends"),
        )
        for text, place in block.places.items()
    ]


def _block(name: str, members: Iterable[Member]) -> str:
    lines = [f"      {line}\n" for line in _declared(members)]
    return (
        f"DATA_BLOCK \"{name}\"\n{{ S7_Optimized_Access := 'FALSE' }}\nVERSION : 0.1\nNON_RETAIN\n"
        f"   STRUCT\n{''.join(lines)}   END_STRUCT;\nBEGIN\nEND_DATA_BLOCK\n"
    )


def _declared(members: Iterable[Member]) -> Iterator[str]:
    taken: dict[str, int] = {}
    at = fills = 0
    for place, name, remark in sorted(members, key=lambda member: member[0].bits.start):
        for kind, end in _filling(at, place):
            fills, at = fills + 1, end
            yield f"fill_{fills} : {kind};"
        plain = re.sub(r"\W", "_", name)
        taken[plain] = taken.get(plain, 0) + 1
        unique = plain if taken[plain] == 1 else f"{plain}_{taken[plain]}"
        where = f"{place.byte}.{place.bit}"
        yield f"{unique} : {place.type};  // {where}  {remark}"
        at = place.bits.stop


def _filling(at: int, place: BlockPlace) -> Iterator[tuple[str, int]]:
    """Yield type and end [bits] of the members needed between `at` and a place."""
    start = place.bits.start
    if place.type == "BOOL" and place.byte <= -(-at // 8):  # or bits would share a byte
        for bit in range(at, start):
            yield "BOOL", bit + 1
        return
    byte, target = -(-at // 8), place.byte
    if byte % 2 and byte < target and not (place.size > 1 and byte + 1 == target):
        yield "BYTE", 8 * (byte + 1)
        byte += 1
    even = (target - byte) // 2 * 2
    if even > 0:
        yield f"ARRAY[0..{even - 1}] OF BYTE", 8 * (byte + even)
        byte += even
    if place.size == 1 and byte < target:
        yield "BYTE", 8 * (byte + 1)
        byte += 1
    if place.type == "BOOL":
        for bit in range(8 * byte, start):
            yield "BOOL", bit + 1
