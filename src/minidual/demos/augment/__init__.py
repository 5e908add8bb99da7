"""Demonstrations multiplied: recorded ones, moved to new starts and goals."""
