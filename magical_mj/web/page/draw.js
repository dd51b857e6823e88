// @ts-check
/**
 * Draws scenes on a canvas like magical_mj's renderer: flat outlines of one colour each, in drawing order.
 * @typedef {import("./scene.js").Scene} Scene
 * @typedef {{part: string, colour: string, loops: number[][]}} Layer
 * @typedef {{visible: number, anchor: number, paper: string, arenas: Record<string, Layer[]>, robots: Record<string, Layer[]>, pebble: Layer[],
 *   regions: {fill: Record<string, string>, border: Record<string, string>, line: number, dash: number},
 *   blocks: Record<string, number[][][]>, blockColours: Record<string, string>[],
 *   fingerRoots: Record<string, number[]>}} Look  written by magical_mj.web.page_data
 */

/**
 * Draws one view on a square canvas.
 * @param {HTMLCanvasElement} canvas
 * @param {Look} look
 * @param {Scene} scene
 * @param {"allo" | "ego"} view  from above, or as the robot sees it
 */
export function draw(canvas, look, scene, view) {
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const size = canvas.width, half = scene.half_width ?? 1, scale = size / (look.visible * half);
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.fillStyle = look.paper;
  context.fillRect(0, 0, size, size);
  if (view === "ego") {  // the robot is near the bottom in the centre, and heads up
    context.setTransform(scale, 0, 0, -scale, size / 2, size * (1 - look.anchor));
    context.rotate(-scene.robot.angle);
    context.translate(-scene.robot.x, -scene.robot.y);
  } else context.setTransform(scale, 0, 0, -scale, size / 2, size / 2);
  for (const layer of look.arenas[half]) fill(context, layer.loops, layer.colour);
  for (const stain of scene.stains ?? []) drawStain(context, stain);
  for (const region of scene.regions) drawRegion(context, look, region);
  for (const { x, y } of scene.pebbles ?? []) {
    context.save();
    transform(context, { x, y, angle: 0 });
    for (const { colour, loops } of look.pebble) fill(context, loops, colour);
    context.restore();
  }
  for (const block of scene.blocks) {
    context.save();
    transform(context, block);
    look.blocks[block.shape].forEach((loops, i) => fill(context, loops, look.blockColours[i][block.colour]));
    context.restore();
  }
  drawRobot(context, look, scene.robot);
}

/**
 * Outlines blocks in a view from above: a solid ring around those that moved, a dashed one around those that had to.
 * @param {HTMLCanvasElement} canvas @param {Look} look @param {Scene} scene @param {{moved: number[], intended: number[]}} which
 */
export function outline(canvas, { visible }, { blocks, half_width: half = 1 }, { moved, intended }) {
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")), size = canvas.width, scale = size / (visible * half);
  context.setTransform(scale, 0, 0, -scale, size / 2, size / 2);
  for (const [chosen, radius, dash] of /** @type {[number[], number, number[]][]} */ ([[moved, 0.18, []], [intended, 0.22, [0.07, 0.05]]])) {
    context.setLineDash(dash);
    for (const [colour, width] of /** @type {[string, number][]} */ ([["#ffffff", 0.036], ["#1b1b1f", 0.018]])) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      for (const i of chosen) {
        context.beginPath();
        context.arc(blocks[i].x, blocks[i].y, radius, 0, 2 * Math.PI);
        context.stroke();
      }
    }
  }
  context.setLineDash([]);
}

/**
 * Transforms the canvas to the frame of an object.
 * @param {CanvasRenderingContext2D} context
 * @param {{x: number, y: number, angle: number}} pose
 */
function transform(context, { x, y, angle }) {
  context.translate(x, y);
  context.rotate(angle);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number[][]} loops
 * @param {string} colour
 */
function fill(context, loops, colour) {
  context.fillStyle = colour;
  context.beginPath();
  for (const loop of loops) {
    context.moveTo(loop[0], loop[1]);
    for (let i = 2; i < loop.length; i += 2) context.lineTo(loop[i], loop[i + 1]);
    context.closePath();
  }
  context.fill();
}

/** A brownish spot with a soft edge. @param {CanvasRenderingContext2D} context @param {number[]} stain */
function drawStain(context, [x, y, radius, darkness]) {
  const gradient = context.createRadialGradient(x, y, 0, x, y, radius);
  for (const [stop, cover] of [[0.75, darkness], [1, 0]]) gradient.addColorStop(stop, `rgb(128 77 0 / ${cover})`);
  context.fillStyle = gradient;
  context.fillRect(x - radius, y - radius, 2 * radius, 2 * radius);
}

/**
 * Draws a region. The dashes start at the top left corner, and continue clockwise.
 * @param {CanvasRenderingContext2D} context
 * @param {Look} look
 * @param {import("./scene.js").Region} region
 */
function drawRegion(context, { regions }, { colour, x_min, y_min, x_max, y_max, border }) {
  context.fillStyle = regions.fill[colour];
  context.fillRect(x_min, y_min, x_max - x_min, y_max - y_min);
  context.strokeStyle = regions.border[colour];
  context.lineWidth = regions.line;
  context.setLineDash(border === "solid" ? [] : [regions.dash, regions.dash]);
  context.beginPath();
  for (const [x, y] of [[x_min, y_max], [x_max, y_max], [x_max, y_min], [x_min, y_min], [x_min, y_max]]) context.lineTo(x, y);
  context.stroke();
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Look} look
 * @param {import("./scene.js").Robot} robot
 */
function drawRobot(context, look, robot) {
  const turns = { left_finger: robot.fingers[0], right_finger: robot.fingers[1] };
  context.save();
  transform(context, robot);
  for (const { part, colour, loops } of look.robots[robot.body ?? "gripper"]) {
    context.save();
    if (part in turns) {
      const [x, y] = look.fingerRoots[part];
      transform(context, { x, y, angle: turns[/** @type {keyof turns} */ (part)] });
    }
    fill(context, loops, colour);
    context.restore();
  }
  context.restore();
}

/**
 * Sets the resolution of canvases to their pixels on the screen, now and whenever their size changes. This clears them.
 * @param {HTMLCanvasElement[]} canvases
 * @param {() => void} redraw
 */
export function fitToScreen(canvases, redraw) {
  const resized = new ResizeObserver((entries) => {
    for (const { target, contentRect, devicePixelContentBoxSize } of entries) {
      const canvas = /** @type {HTMLCanvasElement} */ (target);
      const side = devicePixelContentBoxSize?.[0].inlineSize ?? Math.round(contentRect.width * devicePixelRatio);
      canvas.width = canvas.height = Math.max(1, side);
    }
    redraw();
  });
  for (const canvas of canvases) {
    try {
      resized.observe(canvas, { box: "device-pixel-content-box" });  // also changes with the zoom
    } catch {
      resized.observe(canvas);
    }
  }
}
