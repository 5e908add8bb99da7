"""Plans made of stages: what MoveIt Task Constructor does, in Python, small.

A task is a list of stages. Each is a generator of candidates for the states between stages; `search` tries them, the
preferred ones first, and keeps count of what failed where and why. See docs/task-pipeline.md.
"""

from __future__ import annotations
