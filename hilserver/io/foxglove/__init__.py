"""An endpoint for viewers: the only room that imports `foxglove` (package foxglove-sdk)."""

from hilserver.io.foxglove.endpoint import Endpoint, View

__all__ = ["Endpoint", "View"]
