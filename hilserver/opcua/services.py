"""The services of a session (OPC 10000-4): each takes its parameters and returns its response.

In a list of operations each has its own status code; an error of the whole request is raised as
ServiceError. Most services are generators, which yield between operations.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from asyncua import ua

from hilserver.opcua import node_services as nodes
from hilserver.opcua import subscription_services as subscriptions
from hilserver.opcua.encoding import binary_id
from hilserver.opcua.sessions import Session


class Service(NamedTuple):
    """A service: the type of its parameters, and the function that answers."""

    parameters: type
    answer: Callable[[Session, Any], Any]


SERVICES: dict[int, Service] = {
    binary_id(f"{name}Request"): Service(getattr(ua, f"{name}Parameters"), answer)
    for name, answer in {
        "Write": nodes.write,
        "Call": nodes.call,
        "Browse": nodes.browse,
        "BrowseNext": nodes.browse_next,
        "TranslateBrowsePathsToNodeIds": nodes.translate_paths,
        "RegisterNodes": nodes.register_nodes,
        "UnregisterNodes": nodes.unregister_nodes,
        "CreateSubscription": subscriptions.create_subscription,
        "ModifySubscription": subscriptions.modify_subscription,
        "DeleteSubscriptions": subscriptions.delete_subscriptions,
        "SetPublishingMode": subscriptions.set_publishing_mode,
        "TransferSubscriptions": subscriptions.transfer_subscriptions,
        "CreateMonitoredItems": subscriptions.create_monitored_items,
        "ModifyMonitoredItems": subscriptions.modify_monitored_items,
        "DeleteMonitoredItems": subscriptions.delete_monitored_items,
        "SetMonitoringMode": subscriptions.set_monitoring_mode,
        "SetTriggering": subscriptions.set_triggering,
    }.items()
}
REPUBLISH = Service(ua.RepublishParameters, subscriptions.republish)
