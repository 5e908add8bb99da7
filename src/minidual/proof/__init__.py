"""Separating planes, the certificate of a trajectory, and its audit."""
