"""Whether one set of recordings differs from another, and in what."""
