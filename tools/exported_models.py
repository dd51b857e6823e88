"""Draws exported models in the initial view of MuJoCo's viewers, with the installed version of MuJoCo.

    magical-mj export FindDupe --out FOLDER ...
    python tools/exported_models.py FOLDER PICTURE.png

Needs mujoco, numpy and pillow, but not magical-mj.
"""

import sys
from pathlib import Path

import mujoco
from PIL import Image

SIDE, OVERSAMPLING = 360, 3  # pixels; rendered pixels per pixel and axis
STEPS = 100


def picture(path: Path) -> Image.Image:
    """A picture of a model by the free camera, after some steps without actions."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, STEPS)
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    with mujoco.Renderer(model, SIDE * OVERSAMPLING, SIDE * OVERSAMPLING) as renderer:
        renderer.update_scene(data, camera)
        return Image.fromarray(renderer.render()).reduce(OVERSAMPLING)


def main(folder: str, out: str) -> None:
    """Draws all models of the folder side by side."""
    pictures = [picture(path) for path in sorted(Path(folder).glob("*.xml"))]
    sheet = Image.new("RGB", (SIDE * len(pictures), SIDE))
    for index, model in enumerate(pictures):
        sheet.paste(model, (SIDE * index, 0))
    sheet.quantize(256, dither=Image.Dither.NONE).save(out, optimize=True)
    print(f"{out}: {len(pictures)} models, drawn by MuJoCo {mujoco.__version__}")


if __name__ == "__main__":
    main(*sys.argv[1:])
