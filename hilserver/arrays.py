"""Types of arrays, once for all rooms."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Columns = NDArray[np.float32]
