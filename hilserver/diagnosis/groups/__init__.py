"""Groups of logs: one machine on several floors, or loaded and empty."""
