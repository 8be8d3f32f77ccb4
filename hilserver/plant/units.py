"""Conversions and nominal values that several rooms need."""

import math
from typing import Final

RPM_PER_RAD_S: Final = 60.0 / (2.0 * math.pi)
RAD_S_PER_RPM: Final = 2.0 * math.pi / 60.0
STANDARD_GRAVITY_M_S2: Final = 9.80665
NOMINAL_V: Final = 19.2  # of the battery (4.2): sixteen cells of NiMH
