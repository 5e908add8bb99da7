"""`python -m minidual.cli`: the same as the `minidual` command."""

from minidual.cli import main

main()
