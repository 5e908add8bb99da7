"""Phases of handling an object, and what runs them."""
