"""Which causes the data name: selection, rivals, drift, unknown structure."""
