"""What a loop that fits contacts has compiled, with the types that it calls it with.

`tools/signatures.py` writes this file; `tests/test_compiling.py` says when that is due.
"""

from typing import Any

from numba import types

_tuple: Any = types.Tuple
_FLOAT64 = types.float64
_FLOAT64_2 = types.Array(_FLOAT64, 2, "C")
_FLOAT64_1 = types.Array(_FLOAT64, 1, "C")
_FLOAT64_3 = types.Array(_FLOAT64, 3, "C")
_T1 = _tuple((_FLOAT64_1, _FLOAT64_1, _FLOAT64_1, _FLOAT64_3, _FLOAT64, _FLOAT64))
_FLOAT64_2_FIXED = types.Array(_FLOAT64, 2, "C", readonly=True)
_INT64 = types.int64
_UINT64 = types.uint64
_UINT64_2 = types.Array(_UINT64, 2, "C")
_INT64_1 = types.Array(_INT64, 1, "C")
_T2 = _tuple((_UINT64_2, _FLOAT64_1, _FLOAT64_1, _FLOAT64_1, _INT64_1, _FLOAT64_1))
_FLOAT32 = types.float32
_FLOAT32_4 = types.Array(_FLOAT32, 4, "C")
_INT64_2_FIXED = types.Array(_INT64, 2, "C", readonly=True)
_T3 = _tuple((_FLOAT32_4, _FLOAT64_1, _FLOAT64_1, _INT64_1, _FLOAT64, _FLOAT64_1, _FLOAT64, _FLOAT64_3, _INT64_2_FIXED))
_T4 = _tuple((_T2, _FLOAT64_2, _FLOAT64_1, _FLOAT64))
_FLOAT32_2 = types.Array(_FLOAT32, 2, "C")
_BOOL = types.bool_
_FLOAT32_1 = types.Array(_FLOAT32, 1, "C")
_INT32 = types.int32
_INT32_2 = types.Array(_INT32, 2, "C")
_INT32_1 = types.Array(_INT32, 1, "C")
_INT64_2 = types.Array(_INT64, 2, "C")
_BOOL_1 = types.Array(_BOOL, 1, "C")
_T5 = _tuple(
    (_INT64_2, _INT64_1, _BOOL_1, _FLOAT64_1, _FLOAT64_1, _FLOAT64_1, _FLOAT64_1, _INT64_2_FIXED, _INT64, _BOOL)
)
_T6 = _tuple((_FLOAT64, _FLOAT64, _FLOAT64, _FLOAT64_2))
_FLOAT64_4 = types.Array(_FLOAT64, 4, "C")
_INT32_3 = types.Array(_INT32, 3, "C")
_FLOAT64_3_FIXED = types.Array(_FLOAT64, 3, "C", readonly=True)
_FLOAT64_2_F = types.Array(_FLOAT64, 2, "F")

SIGNATURES: tuple[tuple[str, tuple[types.Type, ...]], ...] = (
    ("contacts.kernels:all_onto", (_FLOAT64_2, _T1)),
    ("contacts.kernels:covering", (_FLOAT64_2, _FLOAT64_2_FIXED, _FLOAT64)),
    ("contacts.kernels:expected", (_FLOAT64_1, _FLOAT64, _FLOAT64_1, _FLOAT64_1, _FLOAT64)),
    ("contacts.kernels:peaks", (_FLOAT64_1, _FLOAT64_2, _INT64, _FLOAT64, _FLOAT64, _FLOAT64)),
    (
        "contacts.kernels:refined",
        (
            _FLOAT64_2,
            _T2,
            _FLOAT64_2,
            _FLOAT64_1,
            _FLOAT64,
            _FLOAT64_1,
            _FLOAT64_2,
            _INT64,
            _FLOAT64,
            _FLOAT64,
            _FLOAT64,
            _FLOAT64,
            _T1,
            _T3,
            _FLOAT64,
        ),
    ),
    (
        "contacts.kernels:responses",
        (
            _FLOAT64_2,
            _FLOAT32_4,
            _FLOAT64_1,
            _FLOAT64_1,
            _INT64_1,
            _FLOAT64,
            _FLOAT64_1,
            _FLOAT64,
            _FLOAT64_3,
            _INT64_2_FIXED,
        ),
    ),
    ("contacts.misfit:marginalise", (_T2, _FLOAT64_2, _FLOAT64_2, _FLOAT64_1, _FLOAT64_2)),
    ("contacts.misfit:normal_products", (_T2, _FLOAT64_2, _FLOAT64_2, _FLOAT64_2)),
    ("contacts.misfit:norms", (_T2, _FLOAT64_2, _FLOAT64_2)),
    ("contacts.misfit:pair_products", (_T2, _FLOAT64_2, _FLOAT64_2, _FLOAT64_2)),
    ("contacts.misfit:ridge_solution", (_T2, _FLOAT64_2, _FLOAT64_1, _FLOAT64)),
    ("contacts.misfit:signals", (_T2, _FLOAT64_2, _FLOAT64_1, _FLOAT64, _FLOAT64_1)),
    ("contacts.misfit:subtract", (_T2, _FLOAT64_2, _FLOAT64_1, _FLOAT64, _FLOAT64_1)),
    ("contacts.refit:refit", (_T4, _T4, _T4, _FLOAT64_2, _FLOAT64_1, _T1, _T3, _FLOAT32_2, _BOOL, _FLOAT64_1)),
    ("contacts.refit:shapes_of", (_FLOAT64_2, _FLOAT64, _FLOAT64, _T3)),
    ("contacts.refit:split_gains", (_T4, _FLOAT64_1, _FLOAT64, _T1, _T3)),
    ("contacts.regions:join_peaks", (_FLOAT32_1, _INT32_2, _INT64_1, _FLOAT64, _INT32_1, _INT32_1)),
    ("contacts.solution:inverse", (_FLOAT64_2,)),
    ("contacts.whitened:likelihood", (_T5, _T6, _FLOAT64_1, _FLOAT64)),
    ("contacts.whitened:powers", (_T2, _FLOAT32_2)),
    ("drive.design:_gains", (_FLOAT64_4, _INT64_2, _FLOAT64_3, _FLOAT64_3)),
    ("forward.assembly:fill", (_INT32_3, _FLOAT64_3_FIXED, _FLOAT64_1, _FLOAT64_1)),
    (
        "forward.cholesky:eliminate",
        (
            _INT64_1,
            _INT64_1,
            _FLOAT64_1,
            _INT64_1,
            _INT64_1,
            _INT64_1,
            _INT64_1,
            _INT64_1,
            _INT64_1,
            _INT64_1,
            _FLOAT64_1,
        ),
    ),
    (
        "forward.cholesky:substitute_down",
        (_INT64_1, _INT64_1, _INT64_1, _INT64_1, _INT64_1, _FLOAT64_1, _INT64, _FLOAT64_2, _FLOAT64_2),
    ),
    (
        "forward.cholesky:substitute_up",
        (_INT64_1, _INT64_1, _INT64_1, _INT64_1, _INT64_1, _FLOAT64_1, _INT64, _FLOAT64_2, _FLOAT64_2),
    ),
    ("forward.dissection:borders", (_INT64_1, _INT64_1, _INT64_1, _INT64_1, _INT64_1, _INT64_1)),
    ("forward.dissection:dissect", (_INT64_1, _INT64_1, _FLOAT64_2, _INT64, _INT64)),
    (
        "forward.sensitivity:fill_groups",
        (
            _INT64_2_FIXED,
            _FLOAT64_3_FIXED,
            _FLOAT64_1,
            _FLOAT64_2_FIXED,
            _INT64_1,
            _INT64_1,
            _FLOAT64_1,
            _INT64_2_FIXED,
            _FLOAT64_2,
        ),
    ),
    (
        "forward.sensitivity:fill_pairs",
        (_INT64_2_FIXED, _FLOAT64_3_FIXED, _FLOAT64_1, _FLOAT64_2_FIXED, _INT64_2_FIXED, _FLOAT64_2),
    ),
    ("forward.splines:respond_at", (_FLOAT64_2, _T3, _FLOAT64_3)),
    ("geometry.overlap:_areas", (_FLOAT64_2, _INT64_1, _FLOAT64_3, _FLOAT64_1, _FLOAT64, _FLOAT64)),
    ("inverse.modes:combined", (_INT64_2, _FLOAT64_2)),
    (
        "scan.coherence:_coherence",
        (_INT64_2, _FLOAT64_2_F, _FLOAT64_2, _INT64_1, _FLOAT64_1, _FLOAT64_1, _FLOAT64_1, _FLOAT64, _INT64),
    ),
    ("sensing.soundness:judged", (_FLOAT64_1, _FLOAT64_1, _INT64_2_FIXED, _INT64_1, _FLOAT64_2)),
)
"""Module, name and argument types of each function."""
