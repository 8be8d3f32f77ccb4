"""What the outside is told: metrics, health, logs, and the audit of the system underneath."""
