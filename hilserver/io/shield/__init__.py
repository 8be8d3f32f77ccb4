"""The extension shield on a serial line: the robot's own driver drives the simulated robot.

Read the files in the order of a request's path: `line` opens a pseudo-terminal or a serial line,
`wire` is the thread that reads it, `framing` finds requests in its bytes, `answer` writes the
response from the newest frame, `device` carries out the request, `link` runs all of it. `protocol`
defines the meaning of the bytes.
"""
