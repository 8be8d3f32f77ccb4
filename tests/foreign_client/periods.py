"""Watches one variable and the events of the server with python-opcua, in many periods at once.

Usage: python periods.py <endpoint> <seconds> <JSON of [period ms, queue size]>; prints one JSON
object of arrival times [s] by "<kind> <period> <queue>".
"""

import json
import os
import sys
import time
import traceback

from opcua import Client, ua
from opcua.client.ua_client import UASocketClient

NAMESPACE = "urn:hilserver:robot"
PATIENCE_S = 60

_header = UASocketClient._create_request_header
# It asks for every answer within a second, which a busy computer refuses with BadTimeout.
UASocketClient._create_request_header = lambda self, timeout_ms: _header(
    self, timeout_ms and PATIENCE_S * 1000
)


class Notes:
    def __init__(self):
        self.at_s = []

    def datachange_notification(self, node, value, data):
        self.at_s.append(time.monotonic())

    def event_notification(self, event):
        self.at_s.append(time.monotonic())


def main(endpoint, seconds, rows):
    client = Client(endpoint, timeout=PATIENCE_S)
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
    code = 1
    try:
        main(sys.argv[1], sys.argv[2], json.loads(sys.argv[3]))
        code = 0
    finally:
        if code:
            traceback.print_exc()
        os._exit(code)  # its threads would go on for minutes
