"""Stage `env-check`."""
