"""Motion planning: inverse kinematics, collision, search, timing, closed chains, and the proof of every result.

Start at `minidual.planning.api.Planner` (goals for one or both arms) and
`minidual.planning.closed_chain.CarriedPlanner` (an object that both hands hold). Nothing is imported here, so that
naming the package costs nothing.
"""

import minidual.sim  # noqa: F401  (it chooses the OpenGL platform, which must stand before mujoco is imported)
