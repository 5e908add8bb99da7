"""The public Python surface: thin functions and dataclasses over the packages (docs/python.md).

Import these names from `minidual`.
"""
