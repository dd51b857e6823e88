"""What `doctor` runs in a process of its own for each OpenGL backend: draws a few frames and prints facts as JSON."""

from __future__ import annotations

import json
import sys
import time

import magical_mj

SIZE = 96  # pixels, as in the LoRes presets
FRAMES = 20


def main() -> None:
    """Prints the renderer's name and the milliseconds of the first and of a typical frame."""
    env = magical_mj.load("FindDupe", observations=())
    env.reset()
    times = []
    for _ in range(FRAMES):
        start = time.perf_counter()
        env.render("ego", SIZE)
        times.append(1000 * (time.perf_counter() - start))
    env.close()

    import mujoco

    context = mujoco.GLContext(SIZE, SIZE)
    context.make_current()
    from OpenGL import GL

    renderer = GL.glGetString(GL.GL_RENDERER)
    context.free()
    facts = {"renderer": renderer.decode(), "first": times[0], "typical": sorted(times)[FRAMES // 2]}
    sys.stdout.write(json.dumps(facts))


if __name__ == "__main__":
    main()
