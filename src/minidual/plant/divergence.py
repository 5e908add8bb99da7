"""What MuJoCo notes of a simulation that diverges."""

import mujoco

_NOT_FINITE = {
    int(mujoco.mjtWarning.mjWARN_BADQPOS): "positions",
    int(mujoco.mjtWarning.mjWARN_BADQVEL): "velocities",
    int(mujoco.mjtWarning.mjWARN_BADQACC): "accelerations",
    int(mujoco.mjtWarning.mjWARN_BADCTRL): "commands",
}
"""MuJoCo only counts these and resets the state or zeroes the commands."""


class DivergenceWatch:
    """Reads MuJoCo's warnings of values that are not finite."""

    def __init__(self, data: mujoco.MjData) -> None:
        self._counts = data.warning.number  # a view: counts by kind
        self._no_warnings = bytes(self._counts.nbytes)

    def kinds(self) -> list[str]:
        """Return what has not been finite since the data was reset, [] for nothing."""
        if self._counts.tobytes() == self._no_warnings:  # a tenth of the time of `any`
            return []
        return [kind for number, kind in _NOT_FINITE.items() if self._counts[number]]
