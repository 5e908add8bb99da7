"""Teleoperation and recorded episodes: schema, writing, validation, LeRobot conversion."""
