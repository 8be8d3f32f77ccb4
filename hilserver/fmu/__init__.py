"""FMUs (FMI 2.0 and 3.0, co-simulation): foreign models as own blocks, the robot for other tools.

`description` reads the description of an FMU, `library` loads and starts it, `calls` calls it from
the step, `process` runs it in a process of its own. In the other direction, `export` combines
`variables`, the kernels as C (`machine_code`, `c_source`) and the C around them.
"""
