"""Faults of a recorded episode, each with its remedy."""

from typing import NamedTuple

_CHECK_RENDERER = (
    "check the renderer (minidual env-check), the lights, and that the camera looks at the table"
)

REMEDIES = {
    "file_missing": "check the folder, or record: minidual teleop-record",
    "cameras_wrong": "record with the cameras of the configuration, in its order",
    "not_finite": ("record the episode again; look for an unstable simulation or a lost sensor"),
    "timestamps_not_monotonic": (
        "stamp ticks with a monotonic clock (simulation time, or time.monotonic on hardware)"
    ),
    "action_equals_qpos": (
        "record the command sent at t (the one that leads to t + 1), not the reading"
    ),
    "rate_wrong": "declare the rate the recorder really ran at, or slow the recorder down",
    "timestamps_jitter": (
        "drive the recorder by simulation time, or free the machine of other load"
    ),
    "out_of_sync": ("stamp joints, images and action in the same tick, and pair the nearest ones"),
    "joints_wrong": "choose the arm that was recorded: --set robot.arm=NAME",
    "outside_joint_limits": (
        "check the joint order (left arm, then right arm), the units (rad) and the limits"
    ),
    "nothing_moves": "take the episode out; check that the recorder reads the robot",
    "state_jumps": (
        "unwrap the encoder, or take the episode out; a leader's readings are checked as they come"
    ),
    "images_changed": "copy the dataset again; its films are not those that were recorded",
    "images_black": _CHECK_RENDERER,
    "images_constant": _CHECK_RENDERER,
    "images_frozen": (
        "update the scene before each rendering; on hardware check the camera's stream"
    ),
    "cameras_identical": "check which camera each name renders",
    "cameras_swapped": (
        "check the order in which cameras are rendered and named; on hardware, the cables"
    ),
}
"""Remedies by fault; for any other fault: record the episode again."""


class EpisodeFault(NamedTuple):
    """One fault; `name` is stable."""

    name: str
    detail: str

    @property
    def remedy(self) -> str:
        """What to do."""
        return REMEDIES.get(self.name, "record this episode again")

    def __str__(self) -> str:
        return f"{self.name}: {self.detail} (remedy: {self.remedy})"
