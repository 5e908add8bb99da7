"""Trials of methods, their metrics and comparisons."""
