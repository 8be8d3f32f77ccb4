"""The services of a session (OPC 10000-4): each takes its parameters and returns its response.

Where a list of operations is asked for, each has a status code of its own; what concerns the whole
request is raised as ServiceError. Most give way between operations: they are generators.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from asyncua import ua

from hilserver.opcua import node_services as nodes
from hilserver.opcua import subscription_services as subscriptions
from hilserver.opcua.sessions import Session

_Ids = ua.ObjectIds


class Service(NamedTuple):
    """A service: how its parameters are called, and who answers."""

    parameters: type
    answer: Callable[[Session, Any], Any]


def _id(request: str) -> int:
    return int(getattr(_Ids, f"{request}Request_Encoding_DefaultBinary"))


SERVICES: dict[int, Service] = {
    _id("Write"): Service(ua.WriteParameters, nodes.write),
    _id("Call"): Service(ua.CallParameters, nodes.call),
    _id("Browse"): Service(ua.BrowseParameters, nodes.browse),
    _id("BrowseNext"): Service(ua.BrowseNextParameters, nodes.browse_next),
    _id("TranslateBrowsePathsToNodeIds"): Service(
        ua.TranslateBrowsePathsToNodeIdsParameters, nodes.translate_paths
    ),
    _id("RegisterNodes"): Service(ua.RegisterNodesParameters, nodes.register_nodes),
    _id("UnregisterNodes"): Service(ua.UnregisterNodesParameters, nodes.unregister_nodes),
    _id("CreateSubscription"): Service(
        ua.CreateSubscriptionParameters, subscriptions.create_subscription
    ),
    _id("ModifySubscription"): Service(
        ua.ModifySubscriptionParameters, subscriptions.modify_subscription
    ),
    _id("DeleteSubscriptions"): Service(
        ua.DeleteSubscriptionsParameters, subscriptions.delete_subscriptions
    ),
    _id("SetPublishingMode"): Service(
        ua.SetPublishingModeParameters, subscriptions.set_publishing_mode
    ),
    _id("TransferSubscriptions"): Service(
        ua.TransferSubscriptionsParameters, subscriptions.transfer_subscriptions
    ),
    _id("CreateMonitoredItems"): Service(
        ua.CreateMonitoredItemsParameters, subscriptions.create_monitored_items
    ),
    _id("ModifyMonitoredItems"): Service(
        ua.ModifyMonitoredItemsParameters, subscriptions.modify_monitored_items
    ),
    _id("DeleteMonitoredItems"): Service(
        ua.DeleteMonitoredItemsParameters, subscriptions.delete_monitored_items
    ),
    _id("SetMonitoringMode"): Service(
        ua.SetMonitoringModeParameters, subscriptions.set_monitoring_mode
    ),
    _id("SetTriggering"): Service(ua.SetTriggeringParameters, subscriptions.set_triggering),
}
REPUBLISH = Service(ua.RepublishParameters, subscriptions.republish)
