"""The gate: stages, checks, verdicts, fingerprints and the run store. No robotics."""
