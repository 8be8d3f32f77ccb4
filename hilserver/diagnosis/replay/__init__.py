"""The plant driven by a recording: what the sensors would have shown."""
