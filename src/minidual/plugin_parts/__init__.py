"""What the distributions in `plugins/` share; it imports neither LeRobot nor vla-eval (docs/lerobot.md)."""
