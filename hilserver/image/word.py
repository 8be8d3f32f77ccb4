"""Index of each control word by name; they are the first words of the arena.

Kernels write ``words[word.STATE]``; all other code writes ``image.control.state``, see
`reader.ControlWords`.
"""

MAGIC_WORD = 0
VERSION = 1
JSON_BYTES = 2
PID = 3
N_SLOTS = 4
RING_LENGTH = 5  # frames, a power of two
RING_STRIDE = 6
RING_BASE = 7
RING_HEAD = 8  # frames published so far
FRAME_BASE = 9  # working frame: values of this tick
STATUS_BASE = 10
NOW_BASE = 11  # rows for the next tick
NOW_CAPACITY = 12
NOW_HEAD = 13
NOW_TAIL = 14
TIMED_BASE = 15  # rows for given ticks, rising
TIMED_CAPACITY = 16
TIMED_HEAD = 17
TIMED_TAIL = 18
LIVE_BASE = 19  # the content of a snapshot, in one piece
LIVE_LENGTH = 20
SHADOW_BASE = 21
REQUEST = 22  # number of the newest snapshot or restore request
REQUEST_KIND = 23
REQUEST_DONE = 24
REQUEST_TICK = 25
# state of the daemon, latched for sim.state; negative: it comes in input rows (replay)
STATE = 26
FIRST_FAULT = 27  # first fault number since the last acknowledge
HEARTBEAT = 28  # incremented by the communication side
HEARTBEAT_SEEN = 29
HEARTBEAT_AGE = 30  # ticks since it changed
HEARTBEAT_LIMIT = 31  # ticks; 0: not watched
BASE_PERIOD_NS = 32
SAFE_TICKS = 33  # ticks since the safe state began
SAFE_RAMP = 36  # ticks after which the robot is at rest and the drive is disabled
LEASES = 37  # who drives, see `leases`; 0: no leases, rows write to the frame itself
PARAMETERS_BASE = 34  # the part of the state that a change of parameters replaces
PARAMETERS_LENGTH = 35
CHANGES_BASE = 38  # queue of these changes, see `changes`
CHANGES_HEAD = 39
CHANGES_TAIL = 40
MODIFIERS = 48  # base of the active faults and forces; 0: this image has none
MAIL_BASE = 49  # commands for them
MAIL_HEAD = 50
MAIL_TAIL = 51
SETPOINT_SLOTS = 52  # how many slots, from the first, are set-points
COMMAND_LIMIT = 53  # ticks without a set-point until they become zero; 0: never
COMMANDED = 54  # 1: a set-point was latched in this tick
STOP_REQUEST = 55  # time of the last press of Stop [ns], by any process
# the press that Reset acknowledged; if they differ, Stop is in force
STOP_ACKNOWLEDGED = 56
