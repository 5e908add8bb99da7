"""Stages, checks, verdicts, fingerprints and the run store; no robotics."""
