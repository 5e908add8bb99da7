"""Learned policies: kinds in one table, training on demonstrations, and the runtime that drives the arms.

`kinds`, `demonstrations`, `records`, `policy` and `pilot` import neither torch nor LeRobot; a kind loads them when it is
used.
"""
