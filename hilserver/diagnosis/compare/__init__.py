"""Whether one set of recordings differs from another, and how."""
