"""What the outside sees: metrics, health, logs, and the audit of the system underneath."""
