"""Typed configuration: models, profiles and the loader. Imports no domain code."""
