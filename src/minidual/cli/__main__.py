"""`python -m minidual.cli`, the `minidual` command."""

from minidual.cli import main

main()
