"""The findings of a diagnosis and their evidence, as plain data with a JSON Schema."""
