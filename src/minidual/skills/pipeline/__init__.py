"""Search for a plan of a whole task, phase by phase. See docs/task-pipeline.md."""
