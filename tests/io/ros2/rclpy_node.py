"""A real ROS 2 node, run by a Python that has `rclpy`: what it is told on stdin it does.

One JSON object a line, in both directions. The argument lists what it publishes and subscribes:
``{"name": ..., "publish": {topic: type}, "subscribe": {topic: type}}``.
"""

import importlib
import json
import sys
import threading
import time
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data


def kind(name):
    package, folder, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), short)


def fill(message, fields):
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def plain(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {
            name: plain(getattr(value, name))
            for name in value.get_fields_and_field_types()
        }
    if isinstance(value, str | bool | int | float):
        return value
    return [plain(one) for one in value]


def tell(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def obey(node, publishers, clients, command):
    match command:
        case {"publish": topic, "fields": fields, "times": times}:
            message = fill(publishers[topic].msg_type(), fields)
            for _ in range(times):
                publishers[topic].publish(message)
                time.sleep(0.02 if times > 1 else 0.0)
        case {"play": path}:
            # beside this, as the node has to end when nothing more can be told to it
            threading.Thread(
                target=play, args=(node, publishers, path), daemon=True
            ).start()
        case {"client": service, "type": name}:
            clients[service] = node.create_client(kind(name), service)
        case {"call": service, "type": name, "fields": fields}:
            if service not in clients:
                clients[service] = node.create_client(kind(name), service)
            client = clients[service]
            if not client.wait_for_service(timeout_sec=30):
                tell(answer=None, why="no service")
                return
            client.call_async(fill(kind(name).Request(), fields)).add_done_callback(
                lambda done: tell(answer=plain(done.result()))
            )
        case {"graph": _}:
            nodes = node.get_node_names_and_namespaces()
            tell(nodes=[f"{space.rstrip('/')}/{name}" for name, space in nodes])


def play(node, publishers, path):
    """Publish a drive: a JSON object a line, ``{"at_s": ..., "topic": ..., "fields": ...}``."""
    begun_s = time.monotonic()
    with Path(path).open(encoding="utf-8") as drive:
        for line in drive:
            row = json.loads(line)
            time.sleep(max(0.0, begun_s + row["at_s"] - time.monotonic()))
            publisher = publishers[row["topic"]]
            message = fill(publisher.msg_type(), row["fields"])
            if hasattr(message, "header"):
                message.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(message)
    tell(played=True)


def main():
    about = json.loads(sys.argv[1])
    rclpy.init()
    node = rclpy.create_node(about["name"])
    publishers = {
        t: node.create_publisher(kind(k), t, 10) for t, k in about["publish"].items()
    }
    for topic, name in about["subscribe"].items():
        node.create_subscription(
            kind(name),
            topic,
            lambda message, topic=topic: tell(topic=topic, fields=plain(message)),
            qos_profile_sensor_data,
        )

    def listen():
        clients = {}
        for line in sys.stdin:
            obey(node, publishers, clients, json.loads(line))
        rclpy.shutdown()

    threading.Thread(target=listen, daemon=True).start()
    while not all(p.get_subscription_count() for p in publishers.values()):
        rclpy.spin_once(node, timeout_sec=0.05)
    tell(ready=True)
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        return


if __name__ == "__main__":
    main()
