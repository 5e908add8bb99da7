"""Offline report: page, JSON, figures."""
