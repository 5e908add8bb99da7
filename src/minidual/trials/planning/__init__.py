"""Planner query sets and their evaluation."""
