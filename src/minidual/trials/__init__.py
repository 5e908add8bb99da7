"""Measuring methods against each other: what one trial showed, what many trials say, and how sure that is."""
