"""How exactly a structured-light camera measures depth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FLOOR_M = 0.0012
SLOPE = 0.0019
FROM_M = 0.4


def depth_sigma_m(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the standard deviation along the axis, of the form of Nguyen, Izadi and Lovell (3DIMPVT 2012)."""
    beyond = depth_m - np.float32(FROM_M)
    return np.asarray(np.float32(FLOOR_M) + np.float32(SLOPE) * beyond * beyond, dtype=np.float32)
