"""FMUs, FMI 2.0 and 3.0 for co-simulation: models of others as own blocks, the robot for others.

`description` reads what an FMU says of itself, `library` loads and starts it, `calls` calls it from
the step, `process` does so in a process of its own. The other way, `export` puts together
`variables`, the kernels as C (`machine_code`, `c_source`) and the C around them.
"""
