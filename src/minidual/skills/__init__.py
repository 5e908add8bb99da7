"""Phases of handling an object, and their execution."""
