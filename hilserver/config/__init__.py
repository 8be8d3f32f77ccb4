"""config.yaml as pydantic models; a wrong key, unit or value is one sentence with file and line."""
