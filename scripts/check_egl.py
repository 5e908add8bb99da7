"""Say in one line whether pictures can be rendered here, before minutes of work end in a GL traceback."""

from __future__ import annotations

import os
import sys

from minidual.variables import rendering_remedy


def main() -> int:
    """Open and close an off-screen OpenGL context; return 4 (environment missing) if there is none."""
    try:
        import mujoco

        context = mujoco.GLContext(64, 64)
        context.make_current()
        context.free()
    except Exception as error:  # each GL backend raises errors of its own
        print(
            f"no off-screen OpenGL context (MUJOCO_GL={os.environ['MUJOCO_GL']}): "
            f"{type(error).__name__}: {error}\n"
            f"  remedy: {rendering_remedy(str(error))}   (Debian, Ubuntu; as root)",
            file=sys.stderr,
        )
        return 4
    return 0


if __name__ == "__main__":
    sys.exit(main())
