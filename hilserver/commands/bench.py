"""Measure the figures that the README quotes, each with its reference in the same run.

What needs peers and rivals of hilserver is not installed with it; in a checkout it is here, too.
"""

EXAMPLE = "hilserver bench plant --json plant.json"
BENCHES = {
    "plant": "one step of four wheels and pose against the same recurrence in C",
    "jitter": "wake latency under OPC UA load against cyclictest",
    "loop": "set-point to pose and back over TCP, two processes",
}
