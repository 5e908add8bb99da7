"""Controllers, grippers, command arbiter and supervisor."""
