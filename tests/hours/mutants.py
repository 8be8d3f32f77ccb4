"""Faults of the product that are planted on purpose."""

def plant(name: str) -> None:
    """Plant one of the faults."""
    raise SystemExit(f"no mutant '{name}'")
