"""Dead-man and Stop, again and again: who drives, and beside what."""

SOURCES = ("page", "opcua", "ros2")
FLOODS = ("browse15", "browse20", "browse1000", "translate", "event_filter", "foxglove")
ATTACKS = ("idle", *FLOODS, "ctrl_s", "lock", "busy")
