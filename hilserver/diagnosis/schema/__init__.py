"""What a diagnosis says, and the evidence behind it, as plain data with a JSON Schema."""
