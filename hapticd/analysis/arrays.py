"""Names of the array types of `analysis`."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Flags = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]
