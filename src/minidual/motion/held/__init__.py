"""Objects in both hands: inverse kinematics of a closed chain, search, path and time law. Start at `planner`."""
