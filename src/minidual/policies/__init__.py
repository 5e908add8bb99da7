"""Learning: ACT training on demonstrations and the runtime that lets a checkpoint drive the arms.

Nothing here imports torch or LeRobot at module import time except the modules under `spatial_act`,
`backbone`, `train` and `policy`; import those lazily.
"""
