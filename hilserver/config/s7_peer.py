"""Requirements on the data blocks of a peer with an endpoint ``s7://``."""

from collections.abc import Iterable
from typing import Annotated, Final, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from hilserver.config.s7 import FORMS, Address, BlockPlace, check_address, overlap
from hilserver.config.section import Section

ONE_PART: Final = 222  # bytes of data in the smallest message, which has 240 bytes
COUNTERS: Final = frozenset(FORMS) - {"BOOL", "REAL", "LREAL"}

Both = Annotated[
    tuple[
        Annotated[str, AfterValidator(check_address)],
        Annotated[str, AfterValidator(check_address)],
    ],
    Field(description="first and last address of the block"),
]


class Heartbeat(Section):
    """One counter at both ends of a block: where they differ, the block was read half-written."""

    read: Both | None = Field(
        None,
        description="their counter: a read in which its two copies differ is dropped",
    )
    write: Both | None = Field(
        None, description="our counter, incremented with every write"
    )

    @model_validator(mode="after")
    def _counts(self) -> Self:
        for which, pair in (("read", self.read), ("write", self.write)):
            kinds = {Address.parse(text).place.type for text in pair or ()}
            if len(kinds) > 1 or not kinds <= COUNTERS:
                raise ValueError(
                    f"{which}: both must be integers of the same type, as UDINT"
                )
        return self


class Block(NamedTuple):
    """Places in one data block that a peer reads or writes."""

    number: int
    places: dict[str, BlockPlace]  # by address as configured, with the heartbeat
    heartbeat: tuple[str, ...]  # its two addresses; empty without one

    @property
    def start(self) -> int:
        """First byte."""
        return min(place.byte for place in self.places.values())

    @property
    def end(self) -> int:
        """Byte after the last one."""
        return max(place.end for place in self.places.values())


def block_of(texts: Iterable[str], heartbeat: Both | None) -> Block | None:
    """Return the block of some addresses, None for none; ValueError if they do not form one."""
    pair = heartbeat or ()
    found = {text: Address.parse(text) for text in (*pair, *texts)}
    if not found:
        return None
    numbers = sorted({address.block for address in found.values()})
    if len(numbers) > 1:
        raise ValueError(
            f"DB{numbers[0]} and DB{numbers[1]} are two blocks: put everything into one, which is"
            f" then read as a whole"
        )
    places = {text: address.place for text, address in found.items()}
    twice = overlap(list(places.values()))
    if twice is not None:
        raise ValueError(f"byte {twice[1].byte} is named twice")
    block = Block(numbers[0], places, pair)
    if pair and (places[pair[0]].byte, places[pair[1]].end) != (block.start, block.end):
        raise ValueError(
            f"{pair[0]} and {pair[1]} must be the first and last of the block"
        )
    return block


def check_blocks(
    read: Iterable[str], write: Iterable[str], heartbeat: Heartbeat
) -> tuple[Block | None, Block | None]:
    """Return the blocks that are read and written; ValueError with one sentence if one is wrong."""
    blocks = []
    for which, texts, pair in (
        ("read", read, heartbeat.read),
        ("write", write, heartbeat.write),
    ):
        try:
            blocks.append(block_of(texts, pair))
        except ValueError as error:
            raise ValueError(f"{which}: {error}") from None
    coming, going = blocks
    if (
        coming is not None
        and not coming.heartbeat
        and coming.end - coming.start > ONE_PART
    ):
        raise ValueError(
            f"read: {coming.end - coming.start} bytes come in several parts, perhaps of two cycles:"
            " name heartbeat.read, a counter at both ends of the block"
        )
    return coming, going
