"""Plan a whole task phase by phase. See docs/task-pipeline.md."""
