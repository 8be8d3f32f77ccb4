"""Models of others as own blocks: FMUs of FMI 2.0 and 3.0 (co-simulation).

`description` reads what an FMU says of itself, `library` loads and starts it, `calls` calls it from
the step, `process` does so in a process of its own.
"""
