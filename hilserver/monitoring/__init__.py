"""Observability: metrics, health, logs, and the audit of the underlying system."""
