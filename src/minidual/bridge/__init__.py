"""What the plug-ins for LeRobot in `plugins/` are made of, without importing LeRobot (docs/lerobot.md)."""
