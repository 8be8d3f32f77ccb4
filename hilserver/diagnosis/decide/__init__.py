"""Which causes explain the data: selection, rivals, drift, unknown structure."""
