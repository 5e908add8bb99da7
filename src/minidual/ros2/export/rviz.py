"""moveit.rviz: the motion planning display on the table."""

from typing import Any

from minidual.ros2.export.description import ROOT_LINK
from minidual.ros2.names import image_topic


def rviz_config(cameras: tuple[str, ...]) -> dict[str, Any]:
    """Return moveit.rviz."""
    return {
        "Panels": [
            {"Class": "rviz_common/Displays", "Name": "Displays"},
            {"Class": "rviz_common/Views", "Name": "Views"},
        ],
        "Visualization Manager": {
            "Class": "",
            "Displays": [
                {"Class": "rviz_default_plugins/Grid", "Name": "Grid", "Enabled": True},
                _planning(),
                {"Class": "rviz_default_plugins/TF", "Name": "TF", "Enabled": False},
                *map(_picture, cameras),
            ],
            "Global Options": {"Fixed Frame": ROOT_LINK, "Frame Rate": 30},
            "Tools": [
                {"Class": "rviz_default_plugins/Interact"},
                {"Class": "rviz_default_plugins/MoveCamera"},
                {"Class": "rviz_default_plugins/Select"},
            ],
            "Views": {"Current": _view()},
        },
    }


def _picture(camera: str) -> dict[str, Any]:
    """Return the display of a camera's pictures, switched off."""
    return {
        "Class": "rviz_default_plugins/Image",
        "Name": f"Camera {camera}",
        "Enabled": False,
        "Topic": {"Value": image_topic(camera), "Reliability Policy": "Best Effort"},
    }


def _planning() -> dict[str, Any]:
    """Return the display of motion planning."""
    return {
        "Class": "moveit_rviz_plugin/MotionPlanning",
        "Name": "MotionPlanning",
        "Enabled": True,
        "Move Group Namespace": "",
        "Robot Description": "robot_description",
        "Planning Scene Topic": "/monitored_planning_scene",
        "Planning Request": {
            "Planning Group": "both_arms",
            "Query Goal State": True,
            "Query Start State": False,
        },
        "Planned Path": {
            "Trajectory Topic": "/display_planned_path",
            "Loop Animation": False,
            "Show Robot Visual": True,
            "State Display Time": "0.05 s",
        },
        "Scene Robot": {"Robot Alpha": 1.0, "Show Robot Visual": True},
    }


def _view() -> dict[str, Any]:
    """Return the view of the table."""
    return {
        "Class": "rviz_default_plugins/Orbit",
        "Name": "Current View",
        "Distance": 2.2,
        "Pitch": 0.5,
        "Yaw": 0.6,
        "Target Frame": "<Fixed Frame>",
        "Focal Point": {"X": 0.4, "Y": 0.0, "Z": 0.2},
    }
