"""Stage `env-check`: do the simulated arms exist, answer and see?"""
