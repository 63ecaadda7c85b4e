"""What a loop that fits contacts has compiled, with the types that it calls it with.

`tests/test_compiling.py` tells those that are missing.
"""

from typing import Any

from numba import types

_N, _F, _B = types.int64, types.float64, types.bool_
_N1, _N2, _B1 = _N[::1], _N[:, ::1], _B[::1]
_I1, _I2, _S1 = types.int32[::1], types.int32[:, ::1], types.float32[::1]
_F1, _F2, _F3, _F4 = _F[::1], _F[:, ::1], _F[:, :, ::1], _F[:, :, :, ::1]
_F2_TURNED = _F[::1, :]
_FIXED_N2, _FIXED_F2, _FIXED_F3 = (
    types.Array(kind, dimensions, "C", readonly=True) for kind, dimensions in ((_N, 2), (_F, 2), (_F, 3))
)
_tuple: Any = types.Tuple
_SCATTERED = _tuple((_F1, _F1, _F1, _F3, _F, _F))
_TABLE = _tuple((_F4, _F1, _F1, _N1, _F, _F1, _F3))

SIGNATURES: tuple[tuple[str, tuple[types.Type, ...]], ...] = (
    ("contacts.information:_products", (_N2, _N1, _B1, _F1, _F1, _F1, _F1, _FIXED_N2, _F1, _F2, _F2)),
    ("contacts.kernels:all_onto", (_F2, _SCATTERED)),
    ("contacts.kernels:expected", (_F1, _F, _F1, _F1, _F)),
    ("contacts.kernels:peaks", (_F1, _F2, _N, _F, _F, _F)),
    ("contacts.kernels:refined", (_F2, _F2, _F1, _F, _F1, _F2, _N, _F, _F, _F, _F, _SCATTERED, _TABLE, _F)),
    ("contacts.misfit:_taken_off", (_F2, _F2, _F1)),
    ("contacts.regions:join_peaks", (_S1, _I2, _N1, _F, _I1, _I1)),
    ("contacts.solution:inverse", (_F2,)),
    ("drive.design:_gains", (_F4, _F4, _F3)),
    ("forward.response:_respond_at", (_F2, _TABLE, _F3)),
    ("forward.sensitivity:fill_pairs", (_FIXED_N2, _FIXED_F3, _F1, _FIXED_F2, _F2)),
    ("geometry.overlap:_areas", (_F3, _F)),
    ("inverse.modes:combined", (_N2, _F2, _N)),
    ("scan.coherence:_coherence", (_N2, _F2_TURNED, _F2, _N1, _F1, _F1, _F1, _F, _N)),
)
"""Module and name of each function, and the types of its arguments; none that the virtual skin has compiled."""
