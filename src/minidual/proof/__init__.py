"""Separating planes, certificates and audits."""
