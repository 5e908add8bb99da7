"""How close motors come to their limits."""

from numba.core import types

from minidual.control.kernels import larger
from minidual.robot.compiled import VECTOR, kernel
from minidual.robot.pair import Array

_REAL = types.float64


@kernel(types.void(VECTOR, VECTOR, _REAL, VECTOR, VECTOR))
def strain(tau: Array, tau_max: Array, saturated: float, ticks: Array, worst: Array) -> None:
    """Count in `ticks` (n,) for how many calls |tau| / tau_max was saturated; update the largest ratio and count in `worst`.

    NaN stays.
    """
    for j in range(len(tau)):
        ratio = abs(tau[j]) / tau_max[j]
        ticks[j] = ticks[j] + 1.0 if ratio >= saturated else 0.0
        worst[0] = larger(ratio, worst[0])
        worst[1] = max(worst[1], ticks[j])
