"""A link between leader and arms whose network is late and lossy, and which stays passive."""
