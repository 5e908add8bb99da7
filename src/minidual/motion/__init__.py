"""Motion planning: inverse kinematics, search, timing and closed chains.

Start at `minidual.motion.api.Planner` (goals for one or both arms) and `minidual.motion.held.planner.HeldPlanner`
(an object that both hands hold). Nothing is imported here, so naming the package costs nothing.
"""
