"""The tasks of minidual for vla-eval."""

from .benchmark import MinidualBenchmark

__all__ = ["MinidualBenchmark"]
