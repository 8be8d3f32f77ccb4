"""The extension shield on a serial line: the robot's own driver drives the simulated robot.

Read the files in the order of a request's way: `line` opens a pseudo-terminal or a serial line,
`wire` is the thread that reads it, `framing` finds requests in its bytes, `answer` writes the
response from the newest frame, `device` does what the request says, `link` runs all of it. What the
bytes mean stands in `protocol`.
"""
