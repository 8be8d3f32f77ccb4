"""From a configuration to a running robot: what is built, and what watches over it."""
