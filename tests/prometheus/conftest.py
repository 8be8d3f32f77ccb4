"""A Prometheus beside a daemon and a real Node-RED."""

from tests.node_red.conftest import node_red

__all__ = ["node_red"]
