"""Learned policies: kinds, training and runtime.

`kinds`, `demonstrations`, `records`, `policy` and `pilot` import neither torch nor LeRobot; kinds load lazily.
"""
