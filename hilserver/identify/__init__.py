"""The thesis's identifications on a log, with intervals that remain valid under autocorrelation.

`rotation`: K_om from unsteady and from steady speeds; `consistency`: "front = rear" and "sign";
`step_response`: Strejc's method; `update_rate`: how often the controller acts; `dead_zone`.
"""
