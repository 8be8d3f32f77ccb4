"""A program that polls the shield at a steady rate; arguments: line, rate [Hz], time [s].

Prints the round trips [ms], request written to response complete, as JSON.
"""

import json
import os
import select
import struct
import sys
import time

from hilserver.io.shield.protocol import RESPONSE_BYTES, ShieldCommand, request

LONGEST_S = 1.0


def main(line: str, rate_hz: float, seconds: float) -> None:
    """Enable the motors, then poll; missing responses are left out."""
    host = os.open(line, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    round_trips_ms = [_ask(host, request(ShieldCommand.ENABLE))]
    speeds = request(
        ShieldCommand.SET_RPM, struct.pack("<4h", -2000, -2000, 2000, 2000)
    )
    begin_s = time.monotonic()
    for number in range(1, round(rate_hz * seconds) + 1):
        round_trips_ms.append(_ask(host, speeds))
        time.sleep(max(begin_s + number / rate_hz - time.monotonic(), 0.0))
    print(json.dumps([ms for ms in round_trips_ms[1:] if ms is not None]))


def _ask(host: int, data: bytes) -> float | None:
    begin_s, missing = time.monotonic(), RESPONSE_BYTES["iotbot"]
    os.write(host, data)
    while missing > 0:
        if not select.select([host], [], [], LONGEST_S)[0]:
            return None
        missing -= len(os.read(host, missing))
    return (time.monotonic() - begin_s) * 1e3


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
