"""Recorded episodes: the HDF5 schema, durable writing, validation, quality, and the LeRobot adapter."""
