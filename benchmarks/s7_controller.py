"""A controller with a 10 ms cycle: the server of python-snap7, which sends numbers to be echoed.

``python -m benchmarks.s7_controller server PORT SECONDS`` prints JSON: what it sent when, and the
time until each number came back [ms]. ``client PORT SECONDS`` is the reference at the other end:
the client of python-snap7, which reads the number and writes it back in the same period.
"""

import json
import struct
import sys
import time
from collections.abc import Iterator

PERIOD_NS = 10_000_000
LOOK_NS = 500_000
NUMBERS = 150
STEP = 0.5
BYTES = 16
COMING, GOING = 1, 2


def number(index: int) -> float:
    """Return the set-point [rpm] of a cycle; it repeats after `NUMBERS` cycles."""
    return (index % NUMBERS - NUMBERS // 2) * STEP


def _ticks(period_ns: int, seconds: float) -> Iterator[int]:
    begin_ns = time.monotonic_ns()
    for index in range(round(seconds * 1e9 / period_ns)):
        due_ns = begin_ns + index * period_ns
        time.sleep(max(0.0, (due_ns - time.monotonic_ns()) * 1e-9))
        yield index


def serve(port: int, seconds: float) -> dict[str, object]:
    """Run the controller; return what it sent and what came back."""
    import snap7  # noqa: PLC0415 -- of the tests, not of every checkout

    coming, going = bytearray(BYTES), bytearray(BYTES)
    area = snap7.type.SrvArea.DB
    server = snap7.server.Server()
    server.register_area(area, COMING, coming)
    server.register_area(area, GOING, going)
    server.start(tcp_port=port)
    sent_ns: list[int] = []
    open_ns: dict[float, int] = {}
    trips_ms, torn = [], 0
    for look in _ticks(LOOK_NS, seconds):
        head, echo, _, tail = struct.unpack(">IffI", going)
        now_ns = time.monotonic_ns()
        torn += head != tail
        if head == tail and echo in open_ns:
            trips_ms.append((now_ns - open_ns.pop(echo)) * 1e-6)
        if look % (PERIOD_NS // LOOK_NS) == 0:
            index = len(sent_ns)
            value = number(index)
            coming[:] = struct.pack(">IffI", index + 1, value, value, index + 1)
            sent_ns.append(now_ns)
            open_ns[value] = now_ns
    server.stop()
    return {"sent_ns": sent_ns, "trips_ms": trips_ms, "torn": torn}


def echo(port: int, seconds: float) -> dict[str, object]:
    """Read the number and write it back."""
    import snap7  # noqa: PLC0415 -- likewise

    client = snap7.client.Client()
    client.connect("127.0.0.1", 0, 1, port)
    for _ in _ticks(PERIOD_NS, seconds):
        client.db_write(GOING, 0, client.db_read(COMING, 0, BYTES))
    client.disconnect()
    return {}


if __name__ == "__main__":
    program = {"server": serve, "client": echo}[sys.argv[1]]
    print(json.dumps(program(int(sys.argv[2]), float(sys.argv[3]))))
