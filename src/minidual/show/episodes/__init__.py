"""Demonstrations of any origin for people: a page, and a recording for rerun."""
