"""Watches one variable and the events of the server with python-opcua, in many periods at once.

Usage: python periods.py <endpoint> <seconds> <JSON of [period ms, queue size]>; prints one JSON
object of arrival times [s] by "<kind> <period> <queue>".
"""

import json
import sys
import threading
import time

from opcua import Client, ua

NAMESPACE = "urn:hilserver:robot"


class Notes:
    def __init__(self):
        self.at_s = []

    def datachange_notification(self, node, value, data):
        self.at_s.append(time.monotonic())

    def event_notification(self, event):
        self.at_s.append(time.monotonic())


def main(endpoint, seconds, rows):
    client = Client(endpoint, timeout=60)
    client.connect()
    index = client.get_namespace_index(NAMESPACE)
    node = client.get_node(f"ns={index};s=pose.x_m")
    server = client.get_node(ua.ObjectIds.Server)
    notes = {}
    for period_ms, queue in rows:
        for kind in ("data", "events"):
            own = notes[f"{kind} {period_ms} {queue}"] = Notes()
            subscription = client.create_subscription(period_ms, own)
            if kind == "data":
                subscription.subscribe_data_change(node, queuesize=queue)
            else:
                subscription.subscribe_events(server, queuesize=queue)
    time.sleep(float(seconds))
    print(json.dumps({key: own.at_s for key, own in notes.items()}), flush=True)


if __name__ == "__main__":
    threading.excepthook = lambda args: None  # it has an error of its own at the end
    main(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
    sys.stdout.flush()
    import os

    os._exit(0)
