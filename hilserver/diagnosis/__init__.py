"""Given measured data: what the simulation gets wrong, why, and what the extended model gains.

One file per stage, in the order of a diagnosis: `reading`, `tables`, `mapping` (files to channels),
`checks` (faults of the data), `replay` (the daemon's plant under the measured inputs), `noise`,
`screen`, `selection`, `identifiability`, `unknown`, `gain`, `patch`, `report`. The daemon imports
nothing from here.
"""
