"""The `minidual` command, also `python -m minidual.cli`.

Importing it as a module of a program changes how that program takes Ctrl-C.
"""

import _signal  # `signal` takes a millisecond to import

# Until main() has its handlers, Ctrl-C ends the process as it ends any other: Python's own handler
# prints a traceback.
if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)

from minidual.cli.process import main

if __name__ == "__main__":
    main()
