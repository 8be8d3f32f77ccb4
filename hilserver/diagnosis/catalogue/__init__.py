"""What can be wrong: causes, their parameters and bounds, as data."""
