"""minidual: two Franka Pandas, from an empty folder to a measured comparison of methods."""

__version__ = "0.1.0"
